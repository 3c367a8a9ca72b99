"""What noise does to columns: closed forms, and integrals over a normal law."""

import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from riecjax.equations.bases import Friction, RoofFunctions
from riecjax.equations.noisy_columns import AT_JUMPS, noisy_columns

STEP, LEVEL, KINK = 0.01, 0.1, 0.5
# Evenly over all arguments, so that a mean over samples is an integral over them.
AT = np.linspace(-3, 3, 6001)
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(60)
WEIGHTS = WEIGHTS / WEIGHTS.sum()


def columns_of(*terms, std=None, correlation=None, **signals):
    noise = rx.Noise.given({"z": LEVEL} if std is None else std, correlation)
    record = rx.Record({"z": AT} | signals, STEP).with_noise(noise)
    return noisy_columns(rx.Equation(*terms), record, 1)


def test_a_cube_is_corrected_exactly():
    found = columns_of(rx.Term("k", lambda s: s["z"] ** 3))
    np.testing.assert_allclose(found.columns.values[0, 1], AT**3 - 3 * LEVEL**2 * AT, atol=1e-12)
    slope = LEVEL * (3 * AT**2 - 3 * LEVEL**2)
    np.testing.assert_allclose(found.white["z"].values[0][0], slope, atol=1e-12)
    np.testing.assert_allclose(found.shift.values[0][0], 3 * LEVEL**2 * AT, atol=1e-12)


def test_a_known_term_and_derivatives_move_where_they_stand():
    found = columns_of(
        rx.Term("m", "z", derivative=1), -rx.Term(2.0, "u"), std={"z": 0.1, "u": 3.0}, u=AT
    )
    assert found.white["z"].rows == {1: (1,)}
    assert found.white["u"].rows == {0: (0,)}
    assert float(found.white["u"].values[0][0, 0]) == pytest.approx(6.0)
    assert not found.shift.values
    assert AT_JUMPS not in found.white


@pytest.mark.parametrize(
    ("function", "size"),
    [
        (lambda z: z * jnp.abs(z), 1.0),
        (lambda z: jnp.maximum(z - 0.5, 0.0), KINK),
        (lambda z: jnp.sin(3 * z), 1.0),
    ],
    ids=["drag", "kink", "sine"],
)
def test_the_mean_over_noise_of_a_corrected_column_is_the_column(function, size):
    """Beside a kink it is on average: what is left has no area."""
    noisy = AT[None, :] + LEVEL * NODES[:, None]
    each = [
        np.asarray(columns_of(rx.Term("k", lambda s: function(s["z"])), z=z).columns.values[0, 1])
        for z in noisy
    ]
    plain = np.sum(WEIGHTS[:, None] * np.asarray(function(noisy)), 0) - np.asarray(function(AT))
    left = WEIGHTS @ np.array(each) - np.asarray(function(AT))
    inner = slice(600, -600)
    assert abs(left[inner].mean()) < 0.02 * np.abs(plain[inner]).mean() + 1e-12
    if size != KINK:
        assert np.abs(left[inner]).mean() < 0.05 * np.abs(plain[inner]).mean()
    assert np.abs(plain).max() > 0.02 * size * LEVEL


def test_a_jump_scatters_as_its_integral_over_a_normal_law():
    """The variance of the corrected sign, and its covariance with the noise, add up over z."""
    found = columns_of(rx.Terms("F", Friction(), "z"))
    rows = np.asarray(found.white["z"].values[0]), np.asarray(found.white[AT_JUMPS].values[0])
    area = AT[1] - AT[0]
    products = sum(row @ row.T for row in rows) * area
    products = products - 2 * np.asarray(found.shift.values[0] @ found.shift.values[0].T) * area
    e = np.linspace(-6, 6, 4001) * LEVEL
    density = np.exp(-((e / LEVEL) ** 2) / 2)
    density /= density.sum()
    corrected = np.asarray(found.columns.values[0, 2])
    draws = np.interp(AT[:, None] + e[None, :], AT, corrected)
    mean = draws @ density
    variance = np.sum((draws - mean[:, None]) ** 2 @ density) * area
    covariance = np.sum((draws * e[None, :]) @ density) * area
    assert products[1, 1] == pytest.approx(variance, rel=0.02)
    assert products[0, 1] == pytest.approx(covariance, rel=0.02)


def test_correlated_noise_moves_a_difference_by_its_own_size():
    """Roof functions of x - y: of equal noise nothing is left, of opposite noise twice."""
    roofs = rx.Terms("F", RoofFunctions([-1.0, 0.0, 1.0]), lambda s: s["z"] - s["y"])
    for correlation, size in ((1.0, 0.0), (0.0, np.sqrt(2)), (-1.0, 2.0)):
        std = {"z": LEVEL, "y": LEVEL}
        found = columns_of(roofs, std=std, correlation={("z", "y"): correlation}, y=0 * AT)
        of = [m.values[0][1] for source, m in found.white.items() if source != AT_JUMPS]
        total = np.sum(np.square(of), axis=0)
        away = np.abs(np.abs(AT) - 0.5) < 0.15
        np.testing.assert_allclose(np.sqrt(total[away]), size * LEVEL, atol=2e-6)

"""What noise does to columns: closed forms, and integrals over a normal law."""

import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from riecjax.equations.bases import RoofFunctions
from riecjax.equations.noisy_columns import noisy_columns

STEP, LEVEL = 0.01, 0.1
# Evenly over all arguments, so that a mean over samples is an integral over them.
AT = np.linspace(-3, 3, 6001)
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(60)
WEIGHTS = WEIGHTS / WEIGHTS.sum()


def columns_of(*terms, std=None, correlation=None, **signals):
    noise = rx.Noise.given({"z": LEVEL} if std is None else std, correlation)
    record = rx.Record({"z": AT} | signals, STEP).with_noise(noise)
    return noisy_columns(rx.Equation(*terms), record, 1)


def products_of(found):
    """What noise adds to the products of columns at each sample."""
    squares = [(1.0, movement) for movement in found.white.values()] + [*found.curved]
    total = np.zeros((found.columns.values.shape[1],) * 2 + AT.shape)
    for times, movement in squares:
        values, rows = np.asarray(movement.values[0]), np.array(movement.rows[0])
        total[rows[:, None], rows] += times * values[:, None] * values[None]
    return total


def of_functions(*functions):
    """Means over normal noise of corrected columns and of their products, less what noise adds;
    and without any of it; and the functions themselves."""
    terms = [rx.Term(f"k{i}", lambda s, f=f: f(s["z"])) for i, f in enumerate(functions)]
    columns = np.zeros((len(functions), AT.size))
    products = np.zeros((len(functions), *columns.shape))
    plain = np.zeros_like(products)
    for node, weight in zip(NODES, WEIGHTS):
        found = columns_of(*terms, z=AT + LEVEL * node)
        values = np.asarray(found.columns.values[0, 1:])
        bare = np.stack([np.asarray(f(AT + LEVEL * node)) for f in functions])
        columns += weight * values
        products += weight * (values[:, None] * values[None] - products_of(found)[1:, 1:])
        plain += weight * bare[:, None] * bare[None]
    return columns, products, plain, np.stack([np.asarray(f(AT)) for f in functions])


def test_polynomials_and_their_products_are_corrected_exactly():
    """To fifth degree; the square of a cube, of sixth, keeps (1/6 + 0.6) D^3 z^6."""
    columns, products, _, true = of_functions(lambda z: z, lambda z: z**2, lambda z: z**3)
    np.testing.assert_allclose(columns, true, atol=1e-12)
    left = products - true[:, None] * true[None]
    left[2, 2] -= (1 / 6 + 0.6) * 90 * LEVEL**6
    np.testing.assert_allclose(left, 0.0, atol=1e-10)


def test_a_known_term_and_derivatives_move_where_they_stand():
    found = columns_of(
        rx.Term("m", "z", derivative=1), -rx.Term(2.0, "u"), std={"z": 0.1, "u": 3.0}, u=AT
    )
    assert found.white["z"].rows == {1: (1,)}
    assert found.white["u"].rows == {0: (0,)}
    assert float(found.white["u"].values[0][0, 0]) == pytest.approx(6.0)
    assert not found.curved


@pytest.mark.parametrize(
    ("function", "everywhere"),
    [
        (lambda z: z * jnp.abs(z), True),
        (lambda z: jnp.sin(3 * z), True),
        (lambda z: jnp.maximum(z - 0.5, 0.0), False),
        (lambda z: jnp.sign(z - 5e-4), False),
    ],
    ids=["drag", "sine", "kink", "jump"],
)
def test_means_over_noise_are_those_without(function, everywhere):
    """At a kink or jump they are on average over arguments: what is left has no area."""
    columns, products, plain, true = of_functions(lambda z: z, function)
    inner, exact = slice(600, -600), true[:, None] * true[None]
    left, added = (products - exact)[..., inner], (plain - exact)[..., inner]
    off, moved = (columns - true)[1, inner], np.abs(plain[0, 1] - exact[0, 1])[inner]
    sizes = np.maximum(np.abs(left), np.abs(added)).mean(-1)
    assert np.all(np.abs(left.mean(-1)) < 0.03 * sizes + 1e-9)
    assert abs(off.mean()) < 0.02 * moved.mean()
    if everywhere:
        assert np.all(np.abs(left).mean(-1) < 0.06 * np.abs(added).mean(-1) + 1e-9)


def test_terms_along_different_signals_have_no_curvature_in_common():
    """Of f(z) and g(y) with independent noise, noise adds nothing to the product."""
    terms = [rx.Term(n, lambda s, n=n: s[n] ** 2) for n in ("z", "y")]
    found = columns_of(*terms, std={"z": LEVEL, "y": LEVEL}, y=0.5 * AT)
    products = products_of(found)
    np.testing.assert_allclose(products[1, 2], 0.0, atol=1e-15)
    assert products[1, 1].mean() > 0.01


def test_correlated_noise_moves_a_difference_by_its_own_size():
    """Roof functions of x - y: of equal noise nothing is left, of opposite noise twice."""
    roofs = rx.Terms("F", RoofFunctions([-3.0, 0.0, 3.0]), lambda s: s["z"] - s["y"])
    for correlation, size in ((1.0, 0.0), (0.0, np.sqrt(2)), (-1.0, 2.0)):
        std = {"z": LEVEL, "y": LEVEL}
        found = columns_of(roofs, std=std, correlation={("z", "y"): correlation}, y=0 * AT)
        of = [m.values[0][1] for m in found.white.values()]
        total = np.sum(np.square(of), axis=0)
        away = np.abs(np.abs(AT) - 1.5) < 0.15
        np.testing.assert_allclose(3 * np.sqrt(total[away]), size * LEVEL, atol=2e-6)

"""Table 1 by the package and by hand, and the engine modes of Table 6."""

import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.paper.published import TABLE_1, TABLE_6
from riecjax.paper.tables import linear_source, table_1
from riecjax.simulation.linearisation import linearise, modes

# As printed: eigenvalue, frequency, damping ratio; velocities of wheel, body, engine minus body.
PRINTED = [
    ("-266", None, None, "1.00", "-0.17", "0.19"),
    ("-35.15+75.76j", "13.29", "0.42", "1.00", "-0.21-0.29j", "0.49+0.67j"),
    ("-26.21+78.75j", "13.21", "0.32", "1.00", "0.07-0.19j", "-0.29+0.41j"),
    ("-2.08+7.63j", "1.26", "0.26", "0.09+0.05j", "1.00", "0.01+0.01j"),
]


def by_hand(mount: float = 400e3, mount_damping: float = 4000.0) -> np.ndarray:
    """Eq. (19) linearised: masses 30, 200, 100 kg; 180, 20, 500 kN/m; 1500 N s/m."""
    k_t, k_s, k_c, c = 180e3, 20e3, 500e3, 1500.0
    matrix = np.zeros((7, 7))
    matrix[0, 2] = -1
    matrix[1, 2], matrix[1, 3] = 1, -1
    matrix[2, [0, 1, 6]] = np.array([k_t, -k_s, -c]) / 30
    matrix[3, [1, 3, 4, 5, 6]] = np.array([k_s, -mount_damping, -mount, mount_damping, c]) / 200
    matrix[4, 3], matrix[4, 5] = 1, -1
    matrix[5, [3, 4, 5]] = np.array([mount_damping, mount, -mount_damping]) / 100
    matrix[6, [2, 3, 6]] = np.array([1, -1, -1]) * k_c / c
    return matrix


def test_linearised_source_model_is_the_matrix_by_hand():
    np.testing.assert_allclose(linearise(linear_source())[0], by_hand(), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("row", range(4))
def test_published_table_holds_the_printed_numbers(row):
    published, printed = TABLE_1[row], PRINTED[row]
    assert published.eigenvalue == complex(printed[0])
    assert published.frequency == (None if printed[1] is None else float(printed[1]))
    assert published.damping_ratio == (None if printed[2] is None else float(printed[2]))
    shape = (published.wheel, published.body, published.engine_minus_body)
    assert shape == tuple(complex(text) for text in printed[3:])


@pytest.mark.parametrize("row", range(4))
def test_every_printed_digit_of_table_1_is_reproduced(row):
    comparison = table_1()[row]
    assert comparison.reproduced == TABLE_1[row]
    assert comparison.published == TABLE_1[row]
    assert comparison.agrees


def test_table_1_has_four_rows():
    assert len(table_1()) == 4


@pytest.mark.parametrize("row", range(4))
def test_the_matrix_by_hand_gives_the_printed_digits_without_the_package(row):
    values, vectors = np.linalg.eig(by_hand())
    upper = [i for i in np.argsort(np.real(values)) if np.imag(values[i]) >= 0]
    value, vector = complex(values[upper[row]]), vectors[:, upper[row]]
    printed = PRINTED[row]
    half = 0.5 if row == 0 else 0.005
    target = complex(printed[0])
    assert abs(value.real - target.real) <= half
    assert abs(value.imag - target.imag) <= half
    if printed[1] is not None and printed[2] is not None:
        assert abs(abs(value) / (2 * np.pi) - float(printed[1])) <= 0.005
        assert abs(-value.real / abs(value) - float(printed[2])) <= 0.005
    wheel, body, engine = vector[[2, 3, 5]]
    reference = max((wheel, body), key=abs)
    for part, text in zip((wheel, body, engine - body), printed[3:]):
        share = complex(part / reference)
        assert abs(share.real - complex(text).real) <= 0.005
        assert abs(share.imag - complex(text).imag) <= 0.005


@pytest.mark.parametrize("variant", TABLE_6)
def test_engine_modes_of_table_6_have_their_named_frequency(variant):
    mount = TABLE_6[variant]
    matrix = linearise(linear_source(mount.stiffness, mount.damping))[0]
    np.testing.assert_allclose(
        matrix, by_hand(mount.stiffness, mount.damping), rtol=1e-13, atol=1e-13
    )
    found = [mode for mode in modes(jnp.asarray(matrix)) if mode.frequency is not None]
    # The engine's mode is the one in which it moves most against the body, for a wheel's motion.
    engine = max(found, key=lambda mode: abs(mode.shape[5] - mode.shape[3]))
    assert engine.frequency is not None
    assert abs(engine.frequency - mount.frequency) < 0.1 * mount.frequency


def test_table_6_is_as_printed():
    assert {name: tuple(row) for name, row in TABLE_6.items()} == {
        "pathological": (13.0, 400e3, 4000.0),
        "included-mode": (6.0, 100e3, 2000.0),
        "higher-mode": (25.0, 1500e3, 7750.0),
    }

"""Table 1 by the package and by hand, and the engine modes of Table 6."""

import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.paper.published import TABLE_1, TABLE_6
from riecjax.paper.tables import linear_source, table_1
from riecjax.simulation.linearisation import linearise, modes

PRINTED = [-266, -35.15 + 75.76j, -26.21 + 78.75j, -2.08 + 7.63j]
TABLE_6_AS_PRINTED = {
    "pathological": (13.0, 400e3, 4000.0),
    "included-mode": (6.0, 100e3, 2000.0),
    "higher-mode": (25.0, 1500e3, 7750.0),
}


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


def test_every_printed_digit_of_table_1_is_reproduced():
    assert table_1() == [(row, row) for row in TABLE_1]
    assert [complex(row.eigenvalue) for row in TABLE_1] == PRINTED


@pytest.mark.parametrize("variant", TABLE_6)
def test_the_source_model_is_the_matrix_by_hand_and_engines_have_their_named_frequency(variant):
    mount = TABLE_6[variant]
    assert tuple(mount) == TABLE_6_AS_PRINTED[variant]
    by_package = linearise(linear_source(mount))[0]
    matrix = by_hand(mount.stiffness, mount.damping)
    np.testing.assert_allclose(by_package, matrix, rtol=1e-13, atol=1e-13)
    found = [mode for mode in modes(jnp.asarray(matrix)) if mode.frequency is not None]
    # The engine's mode is the one in which it moves most against the body, for a wheel's motion.
    engine = max(found, key=lambda mode: abs(mode.shape[5] - mode.shape[3]))
    assert engine.frequency is not None
    assert abs(engine.frequency - mount.frequency) < 0.1 * mount.frequency

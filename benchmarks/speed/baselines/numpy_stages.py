"""The paper's three stages, eqs (23)-(24), in NumPy, from rows of windows or of samples.

All equations read the same table: its columns are F_t, x1, x3', x4', x2 and R_1 to R_4 of x3 - x4.
"""

import numpy as np
from jaxtyping import Float, Int

from benchmarks.speed.baselines.numpy_windows import Signals, running_integrals, suspension_columns

PARAMETERS = ("K_t", "M_us", "M_s", "K_s", "F_1", "F_2", "F_3", "F_4")
TYRE_FORCE, EXTENSION, WHEEL, BODY = range(4)
MASSES, SUSPENSION = slice(WHEEL, BODY + 1), slice(BODY + 1, None)

Table = Float[np.ndarray, "rows 9"]


def sample_table(signals: Signals) -> Table:
    """DOLS, eq. (23): every sample; accelerations are signals."""
    return _table(np.column_stack([signals["dx3"], signals["dx4"]]), _integrands(signals))


def window_table(
    signals: Signals, step: float, start: Int[np.ndarray, " rows"], stop: Int[np.ndarray, " rows"]
) -> Table:
    """RIEC, eq. (24): integrals over windows; of accelerations, differences of velocities."""
    velocities, integrands = _velocities(signals), _integrands(signals)
    primitives = _table(velocities, running_integrals(integrands, step))
    return primitives[stop] - primitives[start]


def window_table_between_samples(
    signals: Signals,
    step: float,
    start: Float[np.ndarray, " rows"],
    stop: Float[np.ndarray, " rows"],
) -> Table:
    """The same for windows between samples, where signals are straight lines."""
    velocities, integrands = _velocities(signals), _integrands(signals)
    running = running_integrals(integrands, step)

    def primitives(position: Float[np.ndarray, " rows"]) -> Table:
        below = position.astype(int)
        share = (position - below)[:, None]
        low, high = integrands[below], integrands[below + 1]
        area = share * step * (low + 0.5 * share * (high - low))
        moved = share * (velocities[below + 1] - velocities[below])
        return _table(velocities[below] + moved, running[below] + area)

    return primitives(stop) - primitives(start)


def tyre_stiffness(table: Table) -> float:
    """K_t of F_t = K_t x1."""
    return float(_least_squares(table[:, [EXTENSION]], table[:, TYRE_FORCE])[0])


def masses(table: Table) -> Float[np.ndarray, " 2"]:
    """M_us and M_s of F_t = M_us x3' + M_s x4'."""
    return _least_squares(table[:, MASSES], table[:, TYRE_FORCE])


def suspension_by_body(table: Table, sprung: float) -> Float[np.ndarray, " 5"]:
    """K_s and F_1 to F_4 of M_s x4' = K_s x2 + sum F_i R_i."""
    return _least_squares(table[:, SUSPENSION], sprung * table[:, BODY])


def suspension_by_wheel(table: Table, unsprung: float) -> Float[np.ndarray, " 5"]:
    """K_s and F_1 to F_4 of F_t - M_us x3' = K_s x2 + sum F_i R_i."""
    target = table[:, TYRE_FORCE] - unsprung * table[:, WHEEL]
    return _least_squares(table[:, SUSPENSION], target)


def staged_by_body(table: Table) -> Float[np.ndarray, " 8"]:
    """All parameters in the order of `PARAMETERS`, masses identified (variant B_id)."""
    unsprung, sprung = masses(table)
    suspension = suspension_by_body(table, sprung)
    return np.array([tyre_stiffness(table), unsprung, sprung, *suspension])


def _velocities(signals: Signals) -> Float[np.ndarray, "n 2"]:
    return np.column_stack([signals["x3"], signals["x4"]])


def _integrands(signals: Signals) -> Float[np.ndarray, "n 7"]:
    return np.column_stack([signals["F_t"], signals["x1"], suspension_columns(signals)])


def _table(motion: Float[np.ndarray, "rows 2"], others: Float[np.ndarray, "rows 7"]) -> Table:
    return np.column_stack([others[:, :WHEEL], motion, others[:, WHEEL:]])


def _least_squares(matrix: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(matrix, target, rcond=None)[0]

"""Block bootstrap of the paper's three stages in NumPy, refitted from rows of windows, eq. (24)."""

import numpy as np
from jaxtyping import Float

from benchmarks.speed.baselines.numpy_windows import (
    Signals,
    random_windows,
    running_integrals,
    suspension_columns,
)

Table = Float[np.ndarray, "rows 9"]
"""Integrals over windows of F_t, x1, x3', x4', x2 and R_1 to R_4 of x3 - x4."""


def replicates(
    signals: Signals,
    step: float,
    count: int = 2000,
    seed: int = 0,
    *,
    windows: int = 8000,
    shortest: int = 10,
    longest: int = 100,
    block: int = 400,
) -> Float[np.ndarray, "replicates 8"]:
    """K_t, M_us, M_s, K_s and F_1 to F_4, from blocks of start times drawn with replacement.

    Windows are drawn once. Lengths of windows and blocks are in samples.
    """
    rng = np.random.default_rng(seed)
    samples = signals["x1"].size
    start, stop = random_windows(rng, samples, windows, shortest, longest)
    order = np.argsort(start)
    start, stop = start[order], stop[order]
    edges = np.searchsorted(start, np.arange(block, samples, block))
    primitives = running_table(signals, step)
    blocks = np.split(primitives[stop] - primitives[start], edges)
    found = np.empty((count, 8))
    for row in found:
        drawn = rng.integers(0, len(blocks), len(blocks))
        row[:] = staged_by_body(np.concatenate([blocks[i] for i in drawn]))
    return found


def running_table(signals: Signals, step: float) -> Table:
    """Integrals from the first sample to each; of accelerations, the velocities."""
    force, others = [signals["F_t"], signals["x1"]], suspension_columns(signals)
    running = running_integrals(np.column_stack([*force, others]), step)
    return np.column_stack([running[:, :2], signals["x3"], signals["x4"], running[:, 2:]])


def staged_by_body(table: Table) -> Float[np.ndarray, " 8"]:
    """F_t = K_t x1; F_t = M_us x3' + M_s x4'; M_s x4' = K_s x2 + sum F_i R_i (variant B_id)."""
    force, body = table[:, 0], table[:, 3]
    stiffness, masses = least_squares(table[:, [1]], force), least_squares(table[:, 2:4], force)
    suspension = least_squares(table[:, 4:], masses[1] * body)
    return np.concatenate([stiffness, masses, suspension])


def least_squares(matrix: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(matrix, target, rcond=None)[0]

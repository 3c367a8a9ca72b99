"""The body's equation over random windows, in NumPy: M_s x4' = K_s x2 + sum F_i R_i(x3 - x4)."""

from collections.abc import Mapping

import numpy as np
import scipy.integrate
from jaxtyping import Float, Int

BREAK_POINTS = np.array([-0.8, -0.3, 0.3, 0.8])
"""Velocities of the damper map in m/s (Table 2)."""

Signals = Mapping[str, Float[np.ndarray, " n"]]


def suspension_columns(signals: Signals) -> Float[np.ndarray, "n 5"]:
    """What K_s and F_1 to F_4 stand before: x2, and the roof functions of x3 - x4."""
    velocity = signals["x3"] - signals["x4"]
    # The end segments are continued outside the break points.
    below = np.searchsorted(BREAK_POINTS[1:-1], velocity, side="right")
    share = (velocity - BREAK_POINTS[below]) / np.diff(BREAK_POINTS)[below]
    columns = np.zeros((velocity.size, 5))
    row = np.arange(velocity.size)
    columns[:, 0] = signals["x2"]
    columns[row, 1 + below] = 1 - share
    columns[row, 2 + below] = share
    return columns


def columns_of(
    signals: Signals, sprung_mass: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 5"]]:
    """Momentum, whose differences are the targets, and the regressors to integrate."""
    return sprung_mass * signals["x4"], suspension_columns(signals)


def running_integrals(
    columns: Float[np.ndarray, "n columns"], step: float
) -> Float[np.ndarray, "n columns"]:
    """Integral of each column from the first sample to each, by trapezoids."""
    return scipy.integrate.cumulative_trapezoid(columns, dx=step, axis=0, initial=0)


def random_windows(
    rng: np.random.Generator, samples: int, count: int, shortest: int, longest: int
) -> tuple[Int[np.ndarray, " windows"], Int[np.ndarray, " windows"]]:
    """First and last sample of windows, redrawn where they reach beyond the record (eqs 14-15)."""

    def drawn(n: int) -> tuple[np.ndarray, np.ndarray]:
        return rng.integers(0, samples, n), rng.integers(shortest, longest + 1, n)

    start, length = drawn(count)
    while (outside := np.flatnonzero(start + length >= samples)).size:
        start[outside], length[outside] = drawn(outside.size)
    return start, start + length


def random_windows_fit(
    running: Float[np.ndarray, "n 5"],
    momentum: Float[np.ndarray, " n"],
    rng: np.random.Generator,
    count: int = 8000,
    shortest: int = 10,
    longest: int = 100,
) -> Float[np.ndarray, " 5"]:
    """K_s and F_1 to F_4 from one draw of windows, their lengths in samples."""
    start, stop = random_windows(rng, momentum.size, count, shortest, longest)
    matrix = running[stop] - running[start]
    return np.linalg.lstsq(matrix, momentum[stop] - momentum[start], rcond=None)[0]

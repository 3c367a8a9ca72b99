"""From the time stamps of a logger to a time step: even, even with pauses, or neither."""

import itertools
from typing import NamedTuple

import numpy as np

from riecjax.errors import DataError

STEP_TOLERANCE = 1e-3
"""Share of a step by which stamps of an even grid may be off."""
SHORTEST_PAUSE = 1.5
"""Steps between two samples past which one is missing between them."""


class TimeBase(NamedTuple):
    """An evenly sampled time axis.

    **Fields:** `step` in seconds; `start`, the first stamp; `pauses`, the samples before which
    the logger paused.
    """

    step: float
    start: float
    pauses: np.ndarray

    def pause_times(self, stamps: np.ndarray) -> np.ndarray:
        """The middle of each pause in seconds."""
        return 0.5 * (stamps[self.pauses - 1] + stamps[self.pauses])


def time_base(stamps: np.ndarray) -> TimeBase:
    """The time base behind time stamps in seconds, shape `(n,)`.

    Loggers round stamps, to 32-bit or to a number of digits; stamps within that rounding of an
    even grid are even. A step of more than 1.5 usual ones is a pause, before and after
    which the grid need not be the same but in its step.

    **Raises:** `DataError` for stamps that are missing, do not increase, or are unevenly spaced.
    """
    if stamps.size < 2:
        raise DataError("a record needs at least two samples.")
    if np.isnan(stamps).any():
        raise DataError(
            f"time is missing at {int(np.isnan(stamps).sum())} sample(s), the first at sample "
            f"{int(np.argmax(np.isnan(stamps)))}. Remove or repair those rows."
        )
    steps = np.diff(stamps)
    if (steps <= 0).any():
        first = int(np.argmax(steps <= 0)) + 1
        raise DataError(
            f"time must increase from sample to sample; at sample {first} it goes from "
            f"{stamps[first - 1]:.15g} to {stamps[first]:.15g} s. Sort the record or remove "
            f"repeated rows."
        )
    # The median alone would be the rounded step of rounded stamps (0.01 or 0.02 for 0.0167); the
    # mean of all steps that are no pauses telescopes, and so has the rounding of two stamps only.
    usual = float(np.mean(steps[steps <= SHORTEST_PAUSE * np.median(steps)]))
    rounding = _resolution(stamps, usual)
    # A step of an even grid comes out longer by the rounding at most.
    pauses = np.flatnonzero(steps > max(SHORTEST_PAUSE * usual, usual + rounding)) + 1
    inner = np.delete(steps, pauses - 1)
    step = float(inner.mean()) if inner.size else usual
    # Either no step differs much, while a slow clock may drift; or all stamps lie within their
    # rounding of a grid, while single steps differ by as much as a step.
    even_steps = inner.size == 0 or np.max(np.abs(inner - step)) <= STEP_TOLERANCE * step + 2 * (
        np.spacing(np.max(np.abs(stamps)))
    )
    if not even_steps and _distance_from_grid(stamps, pauses, step) > 1.01 * rounding:
        raise DataError(
            f"samples must be evenly spaced; steps range from {steps.min():g} to {steps.max():g} s."
            " Resample the record to a uniform rate (on the command line: --resample HZ)."
        )
    return TimeBase(step, float(stamps[0]), pauses)


def _distance_from_grid(stamps: np.ndarray, pauses: np.ndarray, step: float) -> float:
    """How far a stamp lies off the even grid of its own stretch, in seconds."""
    edges = np.concatenate([[0], pauses, [stamps.size]])
    return max(
        float(np.ptp(stamps[first:last] - step * np.arange(last - first))) / 2
        for first, last in itertools.pairwise(edges)
    )


def _resolution(stamps: np.ndarray, step: float) -> float:
    """The digit or the 32-bit spacing that the stamps are rounded to; at least 64-bit's."""
    largest = float(np.max(np.abs(stamps)))
    finest = 4 * float(np.spacing(largest))
    if np.array_equal(stamps, stamps.astype(np.float32).astype(float)):
        finest = max(finest, float(np.spacing(np.float32(largest))))
    for digits in range(9):
        digit = 10.0**-digits
        if digit < 0.9 * step and np.all(np.abs(stamps - np.round(stamps, digits)) <= finest):
            return max(finest, digit)
    return finest

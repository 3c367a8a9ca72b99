"""From the time stamps of a logger to a time step: even, even with pauses, or neither."""

import itertools
from typing import NamedTuple

import numpy as np

from riecjax.errors import DataError

STEP_TOLERANCE = 1e-3
"""Share of a step by which stamps of an even grid may be off."""
SHORTEST_PAUSE = 1.5
"""Steps between two samples past which one is missing between them."""


COARSE = 0.3
"""Share of rows that repeat a stamp from which stamps are coarse, and not some rows repeated."""
EPOCH = 1e9
"""Seconds since 1970 in 2001: no clock of a record that starts at 0 gets there."""
FEWEST_DIGITS, MOST_DIGITS = 4, 9
"""Significant digits that a logger may round its stamps to."""


class StampError(DataError):
    """Time stamps that make no time base."""


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

    Loggers round stamps, to 32-bit, to a number of decimals, or of significant digits, which are
    coarser the longer the record; stamps within that rounding of an even grid are even. A step of
    more than 1.5 usual ones is a pause, before and after which the grid need not be the same but
    in its step.

    **Raises:** `StampError`, a `DataError`, for stamps that are missing, do not increase, or are
    unevenly spaced.
    """
    if stamps.size < 2:
        raise StampError("a record needs at least two samples.")
    if np.isnan(stamps).any():
        raise StampError(
            f"time is missing at {int(np.isnan(stamps).sum())} sample(s), the first at sample "
            f"{int(np.argmax(np.isnan(stamps)))}. Remove or repair those rows."
        )
    steps = np.diff(stamps)
    if (steps <= 0).any():
        rounded = _rounded_grid(stamps)
        if rounded is not None:
            return rounded
        raise _not_rising(stamps, steps)
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
        rounded = _rounded_grid(stamps)
        if rounded is not None:
            return rounded
        raise StampError(
            f"samples must be evenly spaced; steps range from {steps.min():g} to {steps.max():g} s."
            " Resample the record to a uniform rate (on the command line: --resample HZ)."
        )
    return TimeBase(step, float(stamps[0]), pauses)


def _not_rising(stamps: np.ndarray, steps: np.ndarray) -> StampError:
    """Why stamps do not increase: rows out of order, or stamps too coarse for the rate."""
    first = int(np.argmax(steps <= 0)) + 1
    standing = float(np.mean(steps == 0))
    if (steps >= 0).all() and standing > COARSE and stamps[-1] > stamps[0]:
        narrow = np.array_equal(stamps, stamps.astype(np.float32).astype(float))
        size = float(np.min(steps[steps > 0]))
        why = "they were stored in 32-bit, which" if narrow and size > 1 else "they"
        return StampError(
            f"its stamps are too coarse for the samples: {why} advance by {size:g} s at a time, "
            f"and {standing:.0%} of rows repeat the stamp before. Give the seconds between samples "
            f"(--time-step, about {(stamps[-1] - stamps[0]) / (stamps.size - 1):.3g} here)."
        )
    if narrow_epoch(stamps):
        return StampError(
            f"all its stamps are {stamps[0]:.15g}: seconds since 1970 stored in 32-bit, which has "
            f"steps of {np.spacing(np.float32(stamps[0])):g} s there. Give the seconds between "
            f"samples (--time-step)."
        )
    return StampError(
        f"time must increase from sample to sample; at sample {first} it goes from "
        f"{stamps[first - 1]:.15g} to {stamps[first]:.15g} s. Sort the record or remove "
        f"repeated rows."
    )


def narrow_epoch(stamps: np.ndarray) -> bool:
    """Whether all stamps are one number that an epoch's seconds round to in 32-bit."""
    return bool((stamps == stamps[0]).all() and stamps[0] == np.float32(stamps[0]) > EPOCH)


def _rounded_grid(stamps: np.ndarray) -> TimeBase | None:
    """An even grid that these stamps are, rounded to significant digits; `None` if there is none.

    With k digits a stamp t is off by up to half of 10^(floor(log10 t) + 1 - k): the first stamps
    tell the step, which the last ones no longer resolve. So the grid is fitted with weights
    of the inverse squares of these, and no stamp may be off it by more than its own rounding.
    """
    decades = np.floor(np.log10(np.maximum(np.abs(stamps), np.finfo(float).tiny)))
    for digits in range(FEWEST_DIGITS, MOST_DIGITS + 1):
        unit = 10.0 ** (np.maximum(decades, decades[-1] - digits) + 1 - digits)
        if np.all(np.abs(stamps - np.round(stamps / unit) * unit) <= 4 * np.spacing(stamps)):
            break
    else:
        return None
    index = np.arange(stamps.size)
    step, start = np.polyfit(index, stamps, 1, w=1 / unit)
    off = np.abs(stamps - (start + step * index))
    resolved = unit.min() < 0.5 * step and unit.max() > unit.min()
    return (
        TimeBase(float(step), float(stamps[0]), index[:0])
        if (resolved and np.all(off <= 0.6 * unit))
        else None
    )


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

"""From the time stamps of a logger to a time step: even, even with pauses, or neither."""

from typing import NamedTuple

import numpy as np

from riecjax.errors import DataError

STEP_TOLERANCE = 1e-3
"""Share of a step by which stamps of an even grid may be off."""
JITTER = 0.05
"""Share of a step by which steps may be off if stamps jitter: by about 1 % of a step (r.m.s.).

A share j of a step moves a sample by j dt x', which acts as noise of 2 pi j / N of an amplitude at
N samples per period. At 20 samples per shortest period, 2000 samples, and 0.5 % of noise of the
sensors, a damper errs by 0.17 % without jitter, 0.22 % with 1 % of it, 0.33 % with 2 % and 0.74 %
with 5 %; at 50 samples per period 5 % of jitter add a third to the error. A delay of one of the
signals by 1 % of a step would bias the damper by as much as the jitter scatters it.
"""
SHORTEST_PAUSE = 1.5
"""Steps between two samples past which one is missing between them."""
PPM = 1e-6
"""A millionth of time, by which clocks are set."""
COARSE = 0.3
"""Share of rows that repeat a stamp from which stamps are coarse, and not some rows repeated."""
FEWEST_DIGITS, MOST_DIGITS = 4, 9
"""Significant digits that a logger may round its stamps to."""
FEWEST_ODD = 10
"""Steps of another length from which rounding makes them, and not rows lost or repeated."""
MOST_LOST = 0.05
"""Share of rows that may be lost between stamps of one digit for a step."""


class StampError(DataError):
    """Time stamps that make no time base."""


class TimeBase(NamedTuple):
    """An evenly sampled time axis.

    **Fields:** `step` in seconds; `pauses`, the samples before which the logger paused; `jitter` of
    the stamps about it, r.m.s. as a share of a step, where that exceeds their rounding; `digit` in
    seconds that they are rounded to, where that makes steps of two lengths.
    """

    step: float
    pauses: np.ndarray
    jitter: float = 0.0
    digit: float = 0.0

    @property
    def words(self) -> tuple[str, ...]:
        """What is said of jitter and rounding, of which stamps have one at most."""
        if self.jitter:
            return (f"time stamps jitter by {self.jitter:.2%} of a step (r.m.s.); taken as even",)
        if not self.digit:
            return ()
        return (
            f"time stamps are taken as {1 / self.step:.6g} Hz, rounded to {self.digit:g} s; if rows"
            f" are lost instead, bring them to {1 / self.digit:g} Hz (on the command line:"
            f" --resample {1 / self.digit:g})",
        )


def time_base(stamps: np.ndarray) -> TimeBase:
    """The time base behind time stamps in seconds, shape `(n,)`.

    Loggers round stamps, to 32-bit, to a number of decimals, or of significant digits, which are
    coarser the longer the record; stamps within that rounding of an even grid are even. A step of
    more than 1.5 usual ones is a pause, before and after which the grid need not be the same but
    in its step. Stamps that jitter by about 1 % of a step are even as well; a clock that drifts is
    none that jitters.

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
        # Rounding keeps the order.
        rounded = _rounded_grid(stamps) if (steps >= 0).all() else None
        if FEWEST_ODD <= (steps == 0).sum() <= COARSE * steps.size:
            rounded = rounded or _grid_of_decimals(stamps, np.zeros(0, dtype=int))
        if rounded is None:
            raise not_rising(stamps, steps)
        return rounded
    # The median alone would be the rounded step of rounded stamps (0.01 or 0.02 for 0.0167); the
    # mean of all steps that are no pauses telescopes, and so has the rounding of two stamps only.
    usual = float(np.mean(steps[steps <= SHORTEST_PAUSE * np.median(steps)]))
    rounding = _resolution(stamps, 0.9 * usual)
    # A step of an even grid comes out longer by the rounding at most.
    pauses = np.flatnonzero(steps > max(SHORTEST_PAUSE * usual, usual + rounding)) + 1
    if pauses.size >= FEWEST_ODD:
        # A grid rounded to a digit not much shorter than its step has steps of one digit or of two,
        # which are no pauses: of 1 or 2 ms at 700 Hz.
        short = float(np.mean(steps[steps <= 2 * SHORTEST_PAUSE * np.median(steps)]))
        longer = np.flatnonzero(steps > short + _resolution(stamps, short)) + 1
        rounded = _grid_of_decimals(stamps, longer) if longer.size < pauses.size else None
        if rounded is not None:
            return rounded
        coarse = _resolution(stamps, SHORTEST_PAUSE * usual) > 0.4 * usual
        if coarse and pauses.size > MOST_LOST * steps.size:
            raise StampError(
                f"its stamps are too coarse to tell lost rows from rounding: {pauses.size} of"
                f" {steps.size} steps are longer than {usual:g} s. Give the seconds between samples"
                f" (--time-step, about {short:.3g} here), or resample the record to a uniform rate"
                " (on the command line: --resample HZ)."
            )
    inner = np.delete(steps, pauses - 1)
    step = float(inner.mean()) if inner.size else usual
    # Either no step differs much, while a slow clock may drift; or all stamps lie within their
    # rounding of a grid, while single steps differ by as much as a step.
    most = STEP_TOLERANCE * step + _finest(stamps) / 2
    uneven = np.max(np.abs(inner - step), initial=0.0) > most
    if uneven and _distance_from_grid(stamps, pauses, step) > rounding:
        rounded = _rounded_grid(stamps)
        if rounded is not None:
            return rounded
        # Of jitter one step is as likely off to the other side of the next; of a drift to the same.
        off = inner / step - 1
        if np.max(np.abs(off)) <= JITTER and off[1:] @ off[:-1] < 0.5 * (off @ off):
            return TimeBase(step, pauses, float(np.sqrt(np.mean(off**2) / 2)))
        raise StampError(
            f"samples must be evenly spaced; steps range from {steps.min():g} to {steps.max():g} s."
            " Resample the record to a uniform rate (on the command line: --resample HZ)."
        )
    return TimeBase(step, pauses)


def not_rising(stamps: np.ndarray, steps: np.ndarray) -> StampError:
    """Why stamps do not increase: stamps too coarse for the rate, rows out of order, or two runs.

    To sort two runs would mix them.
    """
    standing, falls = float(np.mean(steps == 0)), np.flatnonzero(steps < 0)
    if not falls.size and standing > COARSE:
        spacing = np.spacing(np.float32(stamps[-1]))
        narrow = spacing > 1 and _are_narrow(stamps)
        why = f": stored in 32-bit, which has steps of {spacing:g} s there" if narrow else ""
        changes = np.flatnonzero(steps)
        first, last = changes[[0, -1]] if changes.size > 1 else (0, steps.size)
        mean = (stamps[last] - stamps[first]) / (last - first)
        about = f", about {mean:.3g} here" if mean else ""
        return StampError(
            f"its stamps are too coarse for the samples: {standing:.0%} of rows repeat the stamp "
            f"before{why}. Give the seconds between samples (--time-step{about}), or, if these "
            f"rows are copies or of several signals, write one row for each time."
        )
    # After a stamp that is wrong by itself, time leaps to where it was.
    usual = float(np.median(np.abs(steps)))
    after = steps[np.minimum(falls + 1, steps.size - 1)]
    begins = falls.size and (steps[falls] < -10 * usual).all() and (after <= 2 * usual).all()
    first = int(np.argmax(steps <= 0)) + 1
    remedy = (
        "A second recording begins there, or the clock was set back, as where summer time ends: "
        "split the file there, or give the seconds between samples (--time-step)."
        if begins
        else "Sort the record or remove repeated rows; if stamps are rounded, give the seconds "
        "between samples (--time-step)."
    )
    return StampError(
        f"time must increase from sample to sample; at sample {first} it goes from "
        f"{stamps[first - 1]:.15g} to {stamps[first]:.15g} s. {remedy}"
    )


def _grid_of_decimals(stamps: np.ndarray, pauses: np.ndarray) -> TimeBase | None:
    """An even grid that the stamps between pauses are, rounded to decimals; `None` if none is.

    All must lie within half a digit of it: rows that are lost here and there do not.
    """
    stretches = np.split(stamps, pauses)
    places = [np.arange(one.size) - (one.size - 1) / 2 for one in stretches]
    step = sum(map(np.dot, places, stretches)) / sum(place @ place for place in places)
    off = _distance_from_grid(stamps, pauses, float(step))
    digit = _digit(stamps)
    return TimeBase(float(step), pauses, digit=digit) if off <= 0.51 * digit else None


def _rounded_grid(stamps: np.ndarray) -> TimeBase | None:
    """An even grid that these stamps are, rounded to significant digits; `None` if there is none.

    With k digits a stamp t is off by up to half of 10^(floor(log10 t) + 1 - k): the first stamps
    tell the step, which the last ones no longer resolve. So the grid is fitted with weights
    of the inverse squares of these, and no stamp may be off it by more than its own rounding.
    """
    if stamps[0] == stamps[-1]:
        return None
    decades = np.floor(np.log10(np.maximum(np.abs(stamps), np.finfo(float).tiny)))
    units = (
        10.0 ** (np.maximum(decades, decades.max() - digits) + 1 - digits)
        for digits in range(FEWEST_DIGITS, MOST_DIGITS + 1)
    )
    finest = 4 * np.spacing(np.abs(stamps))
    if (unit := next((u for u in units if _are_multiples(stamps, u, finest)), None)) is None:
        return None
    index = np.arange(stamps.size)
    step, start = np.polyfit(index, stamps, 1, w=1 / unit)
    off = np.abs(stamps - (start + step * index))
    resolved = unit.min() < 0.5 * step and unit.max() > unit.min()
    return TimeBase(float(step), index[:0]) if resolved and np.all(off <= 0.6 * unit) else None


def _distance_from_grid(stamps: np.ndarray, pauses: np.ndarray, step: float) -> float:
    """How far a stamp lies off the even grid of its own stretch, in seconds."""
    parts = np.split(stamps, pauses)
    return max(float(np.ptp(part - step * np.arange(part.size))) / 2 for part in parts)


def _resolution(stamps: np.ndarray, below: float) -> float:
    """The digit or the 32-bit spacing that the stamps are rounded to; at least 64-bit's."""
    single = float(np.spacing(np.float32(np.max(np.abs(stamps))))) if _are_narrow(stamps) else 0.0
    return max(_finest(stamps), single, _digit(stamps, below))


def _are_narrow(stamps: np.ndarray) -> bool:
    """Whether all are numbers of 32 bits."""
    return np.array_equal(stamps, stamps.astype(np.float32).astype(float))


def _finest(stamps: np.ndarray) -> float:
    """What 64-bit numbers of this size and their arithmetic are rounded to, in seconds."""
    return 4 * float(np.spacing(np.max(np.abs(stamps))))


def _digit(stamps: np.ndarray, below: float = np.inf) -> float:
    """The coarsest digit below some seconds that all stamps are multiples of, 0 if none is."""
    finest = _finest(stamps)
    for digit in (10.0**-place for place in range(MOST_DIGITS + 1)):
        if finest < 0.1 * digit and digit < below and _are_multiples(stamps, digit, finest):
            return digit
    return 0.0


def _are_multiples(
    stamps: np.ndarray, unit: float | np.ndarray, finest: float | np.ndarray
) -> bool:
    """Whether all stamps are multiples of a unit, but for their own rounding."""
    return bool(np.all(np.abs(stamps - np.round(stamps / unit) * unit) <= finest))

"""Records at another rate, and channels of different rates on one."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy.interpolate

from riecjax.errors import DataError
from riecjax.records.preparation.band_limited import band_limited

LARGEST_GRID = 50_000_000
"""Samples, over all channels, that a common grid may have before it is refused."""
LONGEST_STEP = 3.0
"""Usual steps of a channel past which samples are missing between two of its stamps."""
SAME_RATE = 0.01
"""Share by which a channel may be faster than the grid without a low-pass."""
EVEN = 1e-4
"""Share of a step by which stamps may be off an even grid and still count as even."""
SAME_TIME = 1e-6
"""Share of a step within which a grid's time is a sample's time."""
FEWEST_KNOTS = 4


def on_grid(
    channels: Mapping[str, tuple[np.ndarray, np.ndarray]], rate: float
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Bring channels of different and uneven times to one even grid.

    The grid begins with the latest first sample among the channels and ends before the earliest
    last one, less what a low-pass cannot compute there: its first and its last row hold every
    channel. A channel passes unchanged where its samples lie on the grid; a slower or equally fast
    one is interpolated by a cubic spline through its true times; a faster one is low-passed without
    phase first (flat to 0.8 of half the new rate, 80 dB down from half of it on), which costs 26
    samples of the grid on both sides of a gap. Nothing is computed across a gap: a NaN, or a step
    of more than 3 of the channel's usual (median) ones.

    **Arguments:**

    - `channels`: name to time in seconds and values, both of shape `(n,)`, NaN where a value is
      missing; each channel has its own times and length.
    - `rate`: of the grid in Hz.

    **Returns:** time in seconds, shape `(m,)`, and name to values of shape `(m,)`, NaN where the
    channel has a gap.

    **Raises:** `DataError` for time that does not increase, values that are infinite, no common
    time, stretches that are all too short, or a grid of more than 50 million samples.
    """
    if not (np.isfinite(rate) and rate > 0):
        raise DataError(f"the rate must be a positive number of samples per second; got {rate:g}.")
    if not channels:
        raise DataError("there is no channel to bring to a common rate.")
    sampled = {name: _channel(name, *given) for name, given in channels.items()}
    grid = _common_grid(sampled, rate)
    columns = {name: _sampled_on(channel, grid, rate) for name, channel in sampled.items()}
    full = np.flatnonzero(np.logical_and.reduce([~np.isnan(v) for v in columns.values()]))
    if full.size < 2:
        worst = max(columns, key=lambda name: int(np.isnan(columns[name]).sum()))
        raise DataError(
            f"no stretch of '{worst}' is long enough for {rate:g} Hz: its longest lasts "
            f"{max(s.time[-1] - s.time[0] for s in sampled[worst].stretches):.3g} s without a gap. "
            f"Choose a higher rate, or leave this channel out."
        )
    rows = slice(full[0], full[-1] + 1)
    return grid[rows], {name: values[rows] for name, values in columns.items()}


class _Stretch(NamedTuple):
    """Samples without a gap among them."""

    time: np.ndarray
    values: np.ndarray


class _Channel(NamedTuple):
    stretches: list[_Stretch]
    step: float
    """Usual one, in seconds."""


def _channel(name: str, time: np.ndarray, values: np.ndarray) -> _Channel:
    time, values = np.asarray(time, float), np.asarray(values, float)
    if time.ndim != 1 or time.shape != values.shape:
        raise DataError(
            f"channel '{name}' needs one time for each value; it has {time.size} times and "
            f"{values.size} values."
        )
    if time.size < 2:
        raise DataError(f"channel '{name}' needs at least two samples; it has {time.size}.")
    for what, bad in (("time", ~np.isfinite(time)), ("value", np.isinf(values))):
        if bad.any():
            raise DataError(
                f"channel '{name}' has no finite {what} at {int(bad.sum())} sample(s), the first "
                f"at sample {int(np.argmax(bad))}. Remove or repair those samples."
            )
    steps = np.diff(time)
    if (steps <= 0).any():
        first = int(np.argmax(steps <= 0)) + 1
        raise DataError(
            f"time of channel '{name}' must increase from sample to sample; at sample {first} it "
            f"goes from {time[first - 1]:g} to {time[first]:g} s. Sort the channel or remove "
            f"repeated samples."
        )
    present = ~np.isnan(values)
    if not present.any():
        raise DataError(f"channel '{name}' holds no number at all.")
    step = float(np.median(steps))
    # A stretch ends at a missing value and before a step that is too long.
    number = np.cumsum(np.concatenate([[False], steps > LONGEST_STEP * step]) | ~present)
    edges = np.flatnonzero(np.diff(number[present])) + 1
    pieces = zip(np.split(time[present], edges), np.split(values[present], edges))
    return _Channel([_Stretch(*piece) for piece in pieces], step)


def _common_grid(channels: Mapping[str, _Channel], rate: float) -> np.ndarray:
    first = {name: channel.stretches[0].time[0] for name, channel in channels.items()}
    last = {name: channel.stretches[-1].time[-1] for name, channel in channels.items()}
    latest, earliest = max(first, key=first.__getitem__), min(last, key=last.__getitem__)
    start, duration = first[latest], last[earliest] - first[latest]
    if duration * rate < 1 - SAME_TIME:
        raise DataError(
            f"the channels have no time in common at {rate:g} Hz: '{latest}' begins at {start:g} s "
            f"and '{earliest}' ends at {last[earliest]:g} s. Leave one of them out."
        )
    if duration * rate * len(channels) > LARGEST_GRID:
        raise DataError(
            f"{len(channels)} channel(s) over {duration:g} s at {rate:g} Hz would be more than "
            f"{LARGEST_GRID} samples. Choose a lower rate, and check that time is in seconds."
        )
    return start + np.arange(int(duration * rate + SAME_TIME) + 1) / rate


def _sampled_on(channel: _Channel, grid: np.ndarray, rate: float) -> np.ndarray:
    """A channel's values at the grid's times, NaN in its gaps."""
    faster = channel.step * rate < 1 - SAME_RATE
    # Absolute times such as seconds since 1970 have few digits left for a share of a step.
    same_time = max(SAME_TIME * channel.step, 4 * float(np.spacing(np.max(np.abs(grid)))))
    found = np.full(grid.size, np.nan)
    for time, values in channel.stretches:
        a, b = np.searchsorted(grid, [time[0] - same_time, time[-1] + same_time])
        if faster:
            found[a:b] = _thinned(time, values, channel.step, grid[a:b], rate)
        else:
            found[a:b] = _interpolated(time, values, grid[a:b], same_time)
    return found


def _interpolated(
    time: np.ndarray, values: np.ndarray, grid: np.ndarray, same_time: float
) -> np.ndarray:
    """Cubic spline between samples; samples on the grid as they are."""
    if time.size >= FEWEST_KNOTS:
        found = scipy.interpolate.CubicSpline(time - time[0], values)(grid - time[0])
    else:
        found = np.full(grid.size, np.nan)
    nearest = np.clip(np.searchsorted(time, grid - same_time), 0, time.size - 1)
    same = np.abs(time[nearest] - grid) <= same_time
    found[same] = values[nearest[same]]
    return found


def _thinned(
    time: np.ndarray, values: np.ndarray, step: float, grid: np.ndarray, rate: float
) -> np.ndarray:
    """Low-passed samples; a spline through the true times evens out uneven ones before."""
    even_step = float(time[-1] - time[0]) / max(time.size - 1, 1)
    off = time - time[0] - even_step * np.arange(time.size)
    if np.max(np.abs(off)) > EVEN * even_step:
        if time.size < FEWEST_KNOTS:
            return np.full(grid.size, np.nan)
        # Twice as dense, lest the coarser spots of uneven times lose what the fine ones hold.
        even = np.arange(0, time[-1] - time[0], step / 2)
        values = scipy.interpolate.CubicSpline(time - time[0], values)(even)
        even_step = step / 2
    if not even_step:
        return np.full(grid.size, np.nan)
    return band_limited(values, (grid - time[0]) / even_step, 1 / (rate * even_step))

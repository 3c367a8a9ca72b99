"""Records at another rate, shifted in time, channels on one grid, and the noise that is on them.

A signal that is band-limited to half its rate is x(t) = sum_n x[n] sinc(t - n), with t in samples.
Evaluating it at a slower rate needs a low-pass first, so that nothing folds; filtering and
evaluating are one sum,

    x(t) = sum_n h(t - n) x[n] / sum_n h(t - n),   h(u) = sinc(c u) w(u / L).

c is the cut-off as a share of half the samples' rate, and the window w cuts the sum off at L
samples to each side: Kaiser's, whose shape and length follow from the attenuation and the width of
the transition (Kaiser, 1974). Dividing by the sum of the weights makes a constant pass exactly.
The cost is 2 L for each value, and weights are computed once for each distinct phase t - floor(t).
"""

import functools
import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from riecjax.errors import DataError
from riecjax.records.linear_op import (
    SAME_TIME,
    LinearOp,
    Operations,
    Places,
    convolved_with,
    longest_stretch,
    step,
)
from riecjax.records.noise_judgement import noise_of_level
from riecjax.records.record import Record
from riecjax.records.signal import (
    DIFFERENCE_ORDER,
    STRETCH,
    STRETCHES,
    Noise,
    Samples,
    Signal,
    Taps,
    shortened,
    usual_size,
)
from riecjax.records.time_base import PPM, not_rising
from riecjax.runtime import in_gigabytes, require_memory

LARGEST_BLOCK = 2**22
"""Weights held at once."""
PHASE_DIGITS = 9
"""Of a position in samples; positions equal in these digits share their weights."""
INTERPOLATION = (1.0, 130.0)
"""Cut-off, as a share of half the slower rate, and attenuation in dB of what lies above and of the
ripple below. To a faster rate: errors below 1e-6 of the amplitude up to 0.9 of half the samples'
rate. Its sinc is zero at all samples but one, so these pass unchanged. Reaches 44 samples to each
side."""
ANTI_ALIAS = (0.9, 80.0)
"""The same to a slower rate: flat to 0.8 of half the new rate within 1e-4, and 80 dB down from half
the new rate on, so that nothing folds into the record. Reaches 26 new samples to each side."""
TRANSITION = 0.2
"""Width of the transition in both, as a share of half the slower rate."""
KNOTS = 20
"""Samples to each side past which a spline through them no longer feels one: 0.27^20 = 4e-12."""
PHASES = 64
"""Places between samples that a grid is taken to have, at the most."""
LARGEST_GROWN, MOST_TIMES = 3_000_000, 16
"""Samples, over all channels, from which a new grid is refused that has more than so many times as
many as were recorded, which say no more."""
BYTES_OF_IDENTIFYING = 170.0
"""What a sample of one channel takes in `riecjax identify`, as measured from 12,000 on."""
LONGEST_STEP = 3.0
"""Usual steps of a channel past which samples are missing between two of its stamps."""
AROUND = 3
"""Steps to each side whose median is usual there."""
SAME_RATE = 0.01
"""Share by which a channel may be faster than the grid without a low-pass."""
EVEN = 1e-4
"""Share of a step by which stamps may be off an even grid and still count as even."""
FEWEST_KNOTS = 4
"""Samples of a stretch below which no cubic spline goes through them."""
POINTS = np.arange(-3, 5)
"""Samples around a place that a polynomial goes through, of degree 7 where all are there."""
MOST_PPM = 1e5
"""Millionths past which it is no clock that is off."""


@step
def resample(record: Record, rate: float) -> Operations:
    """Bring a record to another rate, without phase.

    To a faster rate, band-limited: errors below 1e-6 up to 0.9 of half the record's rate; 44
    samples are lost at both ends and beside gaps. To a slower rate, low-passed first: flat within
    1e-4 to 0.8 of half the new rate and 80 dB down from half of it on; 26 new samples are lost.
    A pause stays a pause, and a new grid begins after it.

    `record.every(count)` thins without a low-pass.

    **Arguments:** `rate` in Hz.

    **Raises:** `DataError` for an impossible rate, too many samples, or a signal whose
    stretches are all too short.
    """
    _check_rate(rate)
    yield from _spaced(record, f"resampled to {rate:g} Hz", 1.0 / (rate * float(record.time_step)))


@step
def upsample(record: Record, factor: int) -> Operations:
    """Insert `factor - 1` samples between every two, by band-limited interpolation.

    For records of few samples per period, where a trapezoid between samples is not the area under
    the signal: at 9 samples per period it loses 4 % of it. Signals pass up to 0.9 of half
    the record's rate, with errors below 1e-6 of their amplitude; recorded samples stay as they are.
    44 samples are lost at both ends and beside gaps.

    **Raises:** `DataError` for a factor below 1, too many samples, or a signal whose
    stretches are all too short.
    """
    if not 1 <= factor < np.inf or int(factor) != factor:
        raise DataError(f"the factor must be a whole number of at least 1; got {factor:g}.")
    yield from _spaced(record, f"band-limited up-sampling by {factor}", 1.0 / factor)


def _spaced(record: Record, words: str, spacing: float) -> Operations:
    """Operations that make samples so many of the old ones apart."""
    if abs(spacing - 1) < SAME_TIME:
        return
    recorded = len(record.arrays) * record.sample_count
    _require_room(
        recorded / spacing,
        recorded,
        f"{1 / (spacing * float(record.time_step)):g} Hz",
        "Choose a lower rate or factor, or a part of the record.",
    )
    op = LinearOp.of_stretches(
        words,
        lambda samples, places, first: band_limited(samples, places - first, spacing),
        noise=lambda noise: noise.of_each(lambda kernel: resampled_taps(kernel, spacing)),
        shortest=2 * reach_beyond(spacing) + 1,
        spacing=spacing,
    )
    yield from dict.fromkeys(record.arrays, op).items()


@step
def shift(record: Record, seconds: Mapping[str, float]) -> Operations:
    """Advance signals by so many seconds: those that are late by as much are in time then.

    By whole samples as they are; between samples as by [`set_clocks`][]. As many samples are lost
    as signals advance, rounded up; what is lost beside gaps joins them.

    **Arguments:** `seconds` by signal; negative ones delay it.

    **Raises:** `DataError` for a signal that the record lacks, a time that is no number, or a
    record or stretches too short for it.
    """
    for name, late in seconds.items():
        by = late / float(record.time_step)
        if not abs(by) < record.sample_count / 2:
            raise DataError(
                f"cannot shift '{name}' by {late:g} s, which is {by:.4g} samples of "
                f"{record.sample_count}. Give seconds, less than half the record."
            )
        words, whole = f"advanced: {{}} by {late:g} s", round(by)
        if abs(by - whole) < 2 * SAME_TIME:
            op = LinearOp.of_taps(words, np.ones(1), whole, noise=convolved_with(1.0))
        else:
            op = _advanced(record, name, np.full(record.sample_count, by), words)
        yield name, op


@step
def set_clocks(record: Record, ppm: Mapping[str, float]) -> Operations:
    """Bring signals to the record's time of which a clock runs slow or fast.

    What falls behind evenly, by so many millionths of the time since the recording's first sample,
    is in time then. As many samples are lost at the ends as it is advanced by there, rounded up;
    what is lost beside gaps joins them.

    Band-limited, within 44 samples of ends and gaps by polynomials through the samples within 4 of
    the place. These err by 2e-5 of the amplitude at 10 samples per period. Between the last two
    samples, where they are of fourth degree, it is 3e-3, 1e-4 at 20 samples per period, and noise
    grows by up to 1.3 times.

    **Arguments:** `ppm` by signal; negative ones of a signal that gets ahead.

    **Raises:** `DataError` for a signal that the record lacks, a clock that is off by more than
    10 %, or stretches too short for it.
    """
    for name, rate in ppm.items():
        if not abs(rate) < MOST_PPM:
            raise DataError(
                f"the clock of '{name}' is off by {rate:g} ppm, which is no clock. Give millionths "
                f"of the time, less than {MOST_PPM:g}."
            )
        late = PPM * rate * np.asarray(record.elapsed) / float(record.time_step)
        yield name, _advanced(record, name, late, f"clocks: {{}} by {rate:g} ppm")


def _advanced(record: Record, name: str, late: Places, words: str) -> LinearOp:
    """What brings a signal forward by so many samples, which change evenly along the record."""
    reach, phases = reach_beyond(1.0), np.unique(np.round(late % 1.0, 2))
    # A shift between samples leaves white noise nearly white, but a little less of it: what most
    # samples are weighted with says how much.
    if longest_stretch(record, name) >= 4 * reach:
        weights = response(np.arange(1 - reach, reach + 1) - phases[:, None], 1.0)
    else:
        weights = _polynomial(phases, np.full((phases.size, POINTS.size), True))
    begins, ends = late[[0, -1]]
    return LinearOp.of_stretches(
        words,
        lambda x, places, first: interpolated(x, places - first + late[places]),
        lost=(math.ceil(max(-begins, 0.0)), math.ceil(max(ends, 0.0))),
        noise=convolved_with(float(np.sqrt(np.mean(np.sum(weights**2, axis=1))))),
        shortest=FEWEST_KNOTS,
    )


def on_grid(
    channels: Mapping[str, tuple[np.ndarray, np.ndarray]],
    rate: float,
    deciding: Collection[str] = (),
) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """Bring channels of different and uneven times to one even grid.

    The grid begins with the latest first sample among the channels and ends before the earliest
    last one, less what a low-pass cannot compute there: its first and its last row hold every
    channel. A channel passes unchanged where its samples lie on the grid; a slower or equally fast
    one is interpolated by a cubic spline through its true times; a faster one is low-passed without
    phase first (flat to 0.8 of half the new rate, 80 dB down from half of it on), which costs 26
    samples of the grid on both sides of a gap. Nothing is computed across a gap: a NaN, or a step
    that is longer than 3 of the channel's usual (median) ones and than 3 of those around (the mean
    of two medians). So rows by event, as of each turn of a wheel, may come seldom for a while.

    **Arguments:**

    - `channels`: name to time in seconds and values, both of shape `(n,)`, NaN where a value is
      missing; each channel has its own times and length.
    - `rate`: of the grid in Hz.
    - `deciding`: the channels that the grid begins and ends with, by default all; the others are
      NaN where they have not begun or have ended.

    **Returns:** time in seconds, shape `(m,)`; name to values of shape `(m,)`, NaN where the
    channel has a gap; and in words what is left out.

    **Raises:** `DataError` for time that does not increase, values that are infinite, no common
    time, stretches that are all too short, or a grid of too many samples.
    """
    _check_rate(rate)
    if not channels:
        raise DataError("there is no channel to bring to a common rate.")
    sampled = {name: _channel(name, *given) for name, given in channels.items()}
    decide = {name: sampled[name] for name in sampled if name in deciding} or sampled
    first = {name: channel.stretches[0][0][0] for name, channel in decide.items()}
    last = {name: channel.stretches[-1][0][-1] for name, channel in decide.items()}
    latest, earliest = max(first, key=first.__getitem__), min(last, key=last.__getitem__)
    start, duration = first[latest], last[earliest] - first[latest]
    if duration * rate < 1 - SAME_TIME:
        begin = min(first.values())
        raise DataError(
            f"the channels have no time in common at {rate:g} Hz: '{latest}' begins at "
            f"{start - begin:g} s and '{earliest}' ends at {last[earliest] - begin:g} s, counted "
            f"from the first sample of all. Leave one of them out."
        )
    _require_room(
        len(decide) * duration * rate,
        sum(time.size for channel in decide.values() for time, _ in channel.stretches),
        f"{duration:g} s at {rate:g} Hz",
        "Choose a lower rate, and check that time is in seconds.",
    )
    grid = start + np.arange(int(duration * rate + SAME_TIME) + 1) / rate
    columns = {name: _sampled_on(channel, grid, rate) for name, channel in sampled.items()}
    full = np.flatnonzero(np.logical_and.reduce([~np.isnan(columns[n]) for n in decide]))
    if full.size < 2:
        worst = max(decide, key=lambda name: int(np.isnan(columns[name]).sum()))
        longest = max(time[-1] - time[0] for time, _ in sampled[worst].stretches)
        raise DataError(
            f"no stretch of '{worst}' is long enough for {rate:g} Hz: its longest lasts "
            f"{longest:.3g} s without a gap. "
            f"Choose a higher rate, or leave this channel out."
        )
    rows = slice(full[0], full[-1] + 1)
    gaps = {
        each.said: [n for n in decide if decide[n].said == each.said] for each in decide.values()
    }
    words = [f"{', '.join(names)}: {said}" for said, names in gaps.items() if said]
    ends = grid.size - (rows.stop - rows.start)
    if lost := grid.size - full.size:
        words.append(
            f"{lost / rate:.4g} s of {duration:.4g} s are left out at {rate:g} Hz: "
            f"{ends / rate:.4g} s at the ends, {(lost - ends) / rate:.4g} s in gaps and beside"
        )
    columns = {n: v[rows] for n, v in columns.items() if not np.isnan(v[rows]).all()}
    return grid[rows], columns, words


def on_grid_noise(
    channels: Mapping[str, tuple[np.ndarray, np.ndarray]],
    grid: np.ndarray,
    rate: float,
    given: Noise,
) -> Noise:
    """The noise of channels on the grid that [`on_grid`][] brought them to.

    **Arguments:** `given`, what is known of the channels as measured; the others are judged.
    """
    on_grid = {}
    for name, (time, values) in channels.items():
        noise = (
            given[name]
            if name in given.kernels
            else noise_of_level(name, uneven_level(time, values), Signal.of(values))
        )
        step = float(np.median(np.diff(time)))
        taps = (
            resampled_taps(np.ones(1), 1 / (rate * step))
            if step * rate < 1 - SAME_RATE
            else spline_taps(np.interp(grid, time, np.arange(time.size)))
        )
        on_grid[name] = noise.convolved(taps)
    return Noise.of(on_grid)


class _Channel(NamedTuple):
    """Times and values of stretches without a gap, the usual step in seconds, and what is said of
    steps that are gaps."""

    stretches: list[tuple[np.ndarray, np.ndarray]]
    step: float
    said: str


def _channel(name: str, time: np.ndarray, values: np.ndarray) -> _Channel:
    time, values = np.asarray(time, float), np.asarray(values, float)
    if time.ndim != 1 or time.shape != values.shape or time.size < 2:
        raise DataError(
            f"channel '{name}' needs at least two samples, and one time for each value; it has "
            f"{time.size} times and {values.size} values."
        )
    for what, bad in (("time", ~np.isfinite(time)), ("value", np.isinf(values))):
        if bad.any():
            raise DataError(
                f"channel '{name}' has no finite {what} at {int(bad.sum())} sample(s), the first "
                f"at sample {int(np.argmax(bad))}. Remove or repair those samples."
            )
    steps = np.diff(time)
    if (steps <= 0).any():
        raise DataError(f"channel '{name}': {not_rising(time, steps)}")
    present = ~np.isnan(values)
    if not present.any():
        raise DataError(f"channel '{name}' holds no number at all.")
    # A stretch ends at a missing value and at a gap.
    gaps = _are_gaps(steps)
    number = np.cumsum(np.concatenate([[False], gaps]) | ~present)
    edges = np.flatnonzero(np.diff(number[present])) + 1
    pieces = zip(np.split(time[present], edges), np.split(values[present], edges))
    longest, total = np.max(steps, where=gaps, initial=0.0), np.sum(steps[gaps])
    said = (
        f"{gaps.sum()} step(s) of up to {longest:.4g} s are far longer than those around, and count"
        f" as gaps, {total:.4g} s in all; what is written only when it changes was held there"
    )
    return _Channel([*pieces], float(np.median(steps)), said * bool(gaps.any()))


def _are_gaps(steps: np.ndarray) -> np.ndarray:
    """Which of a channel's steps no curve goes across: those longer than 3 of the usual ones, of
    the channel and around.

    Rows by event, as of a wheel's turns, come seldom for a while: their steps grow and shrink
    again, where a pause of a logger is longer than the steps on either side.
    """
    long = np.flatnonzero(steps > LONGEST_STEP * np.median(steps))
    padded = np.pad(steps, AROUND, mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)[long]
    before, after = (np.median(near[:, side], 1) for side in (slice(AROUND), slice(-AROUND, None)))
    are_gaps = np.zeros(steps.size, bool)
    are_gaps[long] = steps[long] > LONGEST_STEP * np.sqrt(before * after)
    return are_gaps


def _require_room(samples: float, recorded: int, how: str, remedy: str) -> None:
    """Refuse so many samples of a new grid, over all channels, that memory does not hold."""
    size = samples * BYTES_OF_IDENTIFYING
    if samples > max(LARGEST_GROWN, MOST_TIMES * recorded):
        raise DataError(
            f"{how} would make {samples:.3g} samples, over all signals, of {recorded} that were "
            f"recorded and say as much; to identify from them takes about {in_gigabytes(size)} of "
            f"memory. {remedy}"
        )
    require_memory(f"resampling to {samples:.2g} samples", size, remedy)


def band_limited(samples: np.ndarray, positions: np.ndarray, spacing: float) -> np.ndarray:
    """An evenly sampled signal at other places.

    **Arguments:**

    - `samples`: unit distance apart, shape `(n,)`.
    - `positions`: where to evaluate, in samples from the first one, shape `(m,)`.
    - `spacing`: usual distance of positions in samples; above 1 the signal is low-passed for it.

    **Returns:** values of shape `(m,)`, NaN where the weights would reach beyond the samples.
    """
    reach, positions = reach_beyond(spacing), np.round(positions, PHASE_DIGITS)
    values, offsets = np.full(positions.size, np.nan), np.arange(-reach + 1, reach + 1)
    inside = np.flatnonzero((positions >= reach) & (positions <= samples.size - 1 - reach))
    if not inside.size:
        return values
    neighbours = np.lib.stride_tricks.sliding_window_view(samples, offsets.size)
    for block in np.array_split(inside, math.ceil(inside.size * offsets.size / LARGEST_BLOCK)):
        before = np.floor(positions[block]).astype(int)
        phases, which = np.unique(
            np.round(positions[block] - before, PHASE_DIGITS), return_inverse=True
        )
        weights = _weights(offsets - phases[:, None], spacing)
        weights /= weights.sum(axis=1, keepdims=True)
        values[block] = np.einsum("ij,ij->i", weights[which], neighbours[before - reach + 1])
    return values


def interpolated(samples: Samples, positions: Places) -> Samples:
    """A signal at places between its samples, NaN before the first and behind the last.

    Band-limited where that reaches no end, else by polynomials through the samples within 4.
    """
    values = band_limited(samples, positions, 1.0)
    near = np.flatnonzero(np.isnan(values) & (positions >= 0) & (positions <= samples.size - 1))
    before = np.floor(positions[near]).astype(int)
    nodes = before[:, None] + POINTS
    inside = np.clip(nodes, 0, samples.size - 1)
    weights = _polynomial(positions[near] - before, nodes == inside)
    values[near] = np.sum(weights * samples[inside], axis=1)
    return values


def _polynomial(phases: Places, there: Bool[np.ndarray, "m 8"]) -> Float[np.ndarray, "m 8"]:
    """Weights, at phases behind a sample, of those of the samples around that are `there`."""
    others, own = POINTS[:, None] - POINTS, np.eye(POINTS.size, dtype=bool)
    factors = (phases[:, None] - POINTS)[:, None, :] / (others + own)
    return np.prod(np.where(there[:, None, :] & ~own, factors, 1.0), axis=2) * there


@functools.lru_cache(64)
def _windowed_sinc(spacing: float) -> tuple[float, float, float]:
    """For this distance of positions in samples: cut-off as a share of half the samples' rate,
    samples to each side that have a weight, and the shape of Kaiser's window."""
    cutoff, attenuation = ANTI_ALIAS if spacing > 1 else INTERPOLATION
    # Kaiser's formulas, for more than 50 dB.
    taps = math.ceil((attenuation - 7.95) / 2.285 / (np.pi * TRANSITION) + 1)
    shape = 0.1102 * (attenuation - 8.7)
    density = max(spacing, 1.0)
    return cutoff / density, 0.5 * taps * density, shape


def _weights(offsets: np.ndarray, spacing: float) -> np.ndarray:
    """Weight of samples that lie `offsets` samples away from a position."""
    cutoff, half_length, shape = _windowed_sinc(spacing)
    share = offsets / half_length
    window = scipy.special.i0(shape * np.sqrt(np.maximum(1 - share**2, 0.0)))
    return np.where(np.abs(share) < 1, np.sinc(cutoff * offsets) * window, 0.0)


def reach_beyond(spacing: float) -> int:
    """Samples that `band_limited` needs on each side of a position."""
    return math.ceil(_windowed_sinc(spacing)[1])


def response(offsets: np.ndarray, spacing: float) -> np.ndarray:
    """What `band_limited` makes of one sample of 1, so many samples away from it."""
    reach = reach_beyond(spacing)
    return _weights(offsets, spacing) / _weights(np.arange(-reach, reach + 1), spacing).sum()


def resampled_taps(kernel: Taps, spacing: float) -> Taps:
    """The kernel on new samples, `spacing` of the old ones apart, of one on the old.

    With h the response of the resampler, w of unit size on the old samples, gives
    e(t) = sum_j h(t - j) w[j], of autocovariance int h(u) h(u + t) du as h is band-limited to both
    rates. A source of unit size on the new samples has that with taps sqrt(spacing) h(i spacing).
    """
    half = kernel.size // 2
    reach = math.ceil((half + reach_beyond(spacing)) / spacing)
    places = spacing * np.arange(-reach, reach + 1)
    through = response(places[:, None] - np.arange(-half, half + 1), spacing)
    return shortened(math.sqrt(spacing) * through @ np.asarray(kernel))


def spline_taps(positions: Float[np.ndarray, " m"]) -> Taps:
    """The kernel that a cubic spline makes of white noise.

    Between samples a spline averages, on them it does not: the noise is not stationary. The kernel
    is the symmetric one with the mean of its autocovariances.

    **Arguments:** `positions` at which the spline is evaluated, in samples, mostly evenly spaced.
    """
    spacing = float(np.median(np.diff(positions)))
    knots = np.arange(-2 * KNOTS, 2 * KNOTS + 1)
    spline = scipy.interpolate.CubicSpline(knots, knots == 0, extrapolate=False)
    reach = math.ceil(2 * KNOTS / spacing)
    chosen = np.linspace(0, positions.size - 1, min(positions.size, PHASES)).astype(int)
    # By phase, lag and knot.
    places = np.mod(positions[chosen], 1.0)[:, None, None] - np.arange(-KNOTS, KNOTS + 1)
    through = np.nan_to_num(spline(places + spacing * np.arange(reach + 1)[:, None]))
    covariance = np.mean(np.sum(through[:, :1] * through, axis=2), axis=0)
    spectrum = np.fft.rfft(np.concatenate([covariance, covariance[:0:-1]]))
    kernel = np.fft.irfft(np.sqrt(np.maximum(spectrum.real, 0.0)), 2 * reach + 1)
    return shortened(np.fft.fftshift(kernel))


def uneven_level(time: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"]) -> np.ndarray:
    """Standard deviation of white noise on samples that need not be evenly spaced.

    From divided differences of sixth order, which are those of even samples where they are even.
    NaN where a value is missing.
    """
    count = values.size - DIFFERENCE_ORDER
    if count < 1:
        return np.zeros(())
    starts = np.unique(np.linspace(0, count - 1, min(count, STRETCHES * STRETCH)).astype(int))
    places = starts[:, None] + np.arange(DIFFERENCE_ORDER + 1)
    near = (time[places] - time[starts][:, None]) / np.median(np.diff(time))
    apart = near[:, :, None] - near[:, None, :] + np.eye(DIFFERENCE_ORDER + 1)
    weights = 1.0 / np.prod(apart, axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    return np.asarray(usual_size(np.sum(weights * values[places], axis=1)))


def _sampled_on(channel: _Channel, grid: np.ndarray, rate: float) -> np.ndarray:
    """A channel's values at the grid's times, NaN in its gaps.

    Between samples a cubic spline, and samples on the grid as they are; of a faster channel
    low-passed samples, which a spline through the true times makes even before if they are not.
    """
    # Absolute times such as seconds since 1970 have few digits left for a share of a step.
    same_time = max(SAME_TIME * channel.step, 4 * float(np.spacing(np.max(np.abs(grid)))))
    faster = channel.step * rate < 1 - SAME_RATE
    sampled = np.full(grid.size, np.nan)
    for time, values in channel.stretches:
        a, b = np.searchsorted(grid, [time[0] - same_time, time[-1] + same_time])
        there, since, few = grid[a:b], time - time[0], time.size < FEWEST_KNOTS
        step = float(since[-1]) / max(time.size - 1, 1)
        uneven = np.max(np.abs(since - step * np.arange(time.size))) > EVEN * step
        if not faster:
            if not few:
                sampled[a:b] = scipy.interpolate.CubicSpline(since, values)(there - time[0])
            nearest = np.clip(np.searchsorted(time, there - same_time), 0, time.size - 1)
            same = np.abs(time[nearest] - there) <= same_time
            sampled[a:b][same] = values[nearest[same]]
        elif step and not (uneven and few):
            if uneven:
                # Twice as dense, so that the denser parts of uneven times lose nothing.
                step = channel.step / 2
                values = scipy.interpolate.CubicSpline(since, values)(np.arange(0, since[-1], step))
            sampled[a:b] = band_limited(values, (there - time[0]) / step, 1 / (rate * step))
    return sampled


def _check_rate(rate: float) -> None:
    if not (np.isfinite(rate) and rate > 0):
        raise DataError(f"the rate must be a positive number of samples per second; got {rate:g}.")

"""Filters without phase, offsets, drifts and derivatives.

**Computed, not measured.** A derivative may be no sensor's, but computed from the signal:
differences, slopes of polynomials, or any other filter of some dozens of samples. Such a derivative
has the position's noise, many times as large and of one source with it. Taken for a sensor's own,
white and independent, it biases every estimate.
"""

from collections.abc import Collection, Mapping

import numpy as np
import scipy

from riecjax.arrays import is_concrete
from riecjax.errors import DataError
from riecjax.leaves import Leaf
from riecjax.records.faults.sampled_signal import ENOUGH
from riecjax.records.linear_op import LinearOp, Operations, convolved_with, longest_stretch, step
from riecjax.records.noise_judgement import blackman_harris, judged
from riecjax.records.record import Record, runs
from riecjax.records.relations import Pairs, Relation
from riecjax.records.signal import Noise, Samples, Taps

FILTER_ORDER = 4
FILTER_PADDING = 16
"""Samples by which SciPy extends each end of a stretch for a filter of this order."""
SETTLING_PERIODS = 5
"""Periods of the cut-off frequency after which a zero-phase filter has forgotten the ends."""
SLOPE = np.linalg.inv(np.vander(np.arange(-3, 4), increasing=True))[1]
"""Weights of samples around a place whose sum is a derivative of sixth order over a sample."""


@step
def low_pass(record: Record, cutoffs: Mapping[str, float]) -> Operations:
    """Filter signals by a zero-phase Butterworth low-pass of 4th order (run both ways).

    Five periods of the lowest cut-off are cut from both ends, where the filter still feels the
    record's ends. Five periods of a signal's own cut-off become missing on both sides of its gaps.

    **Arguments:** `cutoffs`: signal name to cut-off in Hz.

    **Raises:** `DataError` for a cut-off beyond half the sampling rate, a missing signal, or a
    record whose stretches are too short for the filter.
    """
    nyquist = 0.5 / float(record.time_step)
    for name, cutoff in cutoffs.items():
        if not 0 < cutoff < nyquist:
            raise DataError(
                f"cannot filter '{name}' at {cutoff:g} Hz: the cut-off must lie between 0 and half "
                f"the sampling rate, {nyquist:g} Hz."
            )
        lost = int(np.ceil(SETTLING_PERIODS / cutoff / float(record.time_step)))
        sections = scipy.signal.butter(FILTER_ORDER, cutoff / nyquist, output="sos")
        impulse = np.zeros(4 * lost + FILTER_PADDING + 1)
        impulse[impulse.size // 2] = 1.0

        def settled(samples: np.ndarray, *_: object, by=sections, lost=lost) -> np.ndarray:
            """Filtered both ways, NaN where the ends are still felt."""
            inner = scipy.signal.sosfiltfilt(by, samples)[lost:-lost]
            return np.pad(inner, lost, constant_values=np.nan)

        op = LinearOp.of_stretches(
            f"zero-phase {FILTER_ORDER}th-order Butterworth low-pass: {{}} at {cutoff:g} Hz",
            settled,
            lost=(lost, lost),
            noise=convolved_with(*scipy.signal.sosfiltfilt(sections, impulse)),
            shortest=max(2 * lost + 2, FILTER_PADDING) + 1,
        )
        yield name, op


@step
def unfilter(record: Record, lags: Mapping[str, float]) -> Operations:
    """Undo a first-order low-pass in front of a signal: s = z + tau z' of what it left, z.

    It raises noise above its cut-off, 1 / (2 pi tau), as the record's noise then says. Three
    samples are lost at both ends, and become missing beside gaps.

    **Arguments:** `lags`: signal name to the filter's time constant tau in seconds.

    **Raises:** `DataError` for a time constant that is not positive or longer than the record, a
    signal that it lacks, or stretches of fewer than seven samples.
    """
    for name, seconds in lags.items():
        if not 0 < seconds < float(record.duration):
            raise DataError(
                f"the time constant of the low-pass before '{name}' must be positive, in seconds, "
                f"and shorter than the record, {float(record.duration):.4g} s; got {seconds:g} s."
            )
        half = SLOPE.size // 2
        taps = seconds / float(record.time_step) * SLOPE + (np.arange(SLOPE.size) == half)
        yield name, LinearOp.of_taps(f"low-pass undone: {{}} of {seconds:g} s", taps, -half)


@step
def remove_line(
    record: Record, zeros: Mapping[str, float], slopes: Mapping[str, float]
) -> Operations:
    """Subtract a sensor's zero, and what it drifts by from the recording's first sample on.

    Unlike a mean or the straight line of the samples, which are the machine's as well as far as it
    does not come back to where it began.

    **Arguments:** `zeros`: signal name to a value in its unit; `slopes`: the same per second.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    elapsed = np.asarray(record.elapsed)
    for name in dict.fromkeys((*zeros, *slopes)):
        zero, slope = zeros.get(name, 0.0), slopes.get(name, 0.0)
        drift = f" and {slope:.6g} per second" if slope else ""
        words = f"{{}}: {zero:.6g}{drift} subtracted"
        values = record.signal(name).with_nan - (zero + slope * elapsed)
        yield name, LinearOp.of_values(words, values)


@step
def remove_offset(record: Record, *signals: str) -> Operations:
    """Subtract from each of these signals its mean over the samples that are not missing.

    Instruments add offsets, which an equation with a stiffness reads as a force.

    **Raises:** `DataError` for no signal, or one that the record lacks.
    """
    return _without_polynomial(record, signals, 0)


@step
def remove_drift(record: Record, *signals: str) -> Operations:
    """Subtract from each of these signals its least-squares straight line over time.

    Time is the true one: a pause counts as long as it lasted.

    **Raises:** `DataError` for no signal, or one that the record lacks.
    """
    return _without_polynomial(record, signals, 1)


def _without_polynomial(record: Record, signals: tuple[str, ...], degree: int) -> Operations:
    if not signals:
        raise DataError(
            f"name the signals to remove the {('offset', 'drift')[degree]} from; there are: "
            f"{', '.join(record.arrays)}."
        )
    time, words = np.asarray(record.time), f"{{}}: {('mean', 'straight line')[degree]} removed"
    for name in signals:
        values = record.signal(name).with_nan
        known = ~np.isnan(values)
        # `fit` maps time to [-1, 1], so that seconds since 1970 lose no digits.
        trend = np.polynomial.Polynomial.fit(
            time[known], values[known], min(degree, known.sum() - 1)
        )
        yield name, LinearOp.of_values(words, values - trend(time))


@step
def differentiate(record: Record, signal: str, name: str) -> Operations:
    """Add the time derivative of a signal, by central differences of second order.

    Differentiation raises noise in proportion to frequency; prefer an integral criterion, which
    needs one derivative less, and filter first where it cannot be avoided.

    At the ends and beside gaps the differences are one-sided, of second order too, so that nothing
    is lost there. A single sample between gaps becomes missing.

    **Raises:** `DataError` for a missing signal, or one without two samples in succession.
    """
    spacing = float(record.time_step)
    op = LinearOp.of_stretches(
        f"{{}}: central differences of {signal}",
        lambda x, *_: np.gradient(x, spacing, edge_order=2 if x.size > 2 else 1),
        noise=convolved_with(0.5 / spacing, 0.0, -0.5 / spacing),
        source=signal,
        unit="/s",
        shortest=2,
    )
    yield name, op


ORDER = 4
"""Of the polynomial: its slope in the middle errs with the fourth power of the width."""
NARROWEST = 3
"""Samples to each side."""
WIDEST = 0.05
"""Share of the longest stretch to each side."""
BIAS = 0.05
"""Error by smoothing the motion, r.m.s. in standard deviations of the noise left. An estimate
averages the noise, not this error: at 0.3, both would weigh the same in 11 samples."""
LONGEST = 2**16
"""Samples whose spectrum is looked at."""
SMOOTHED = 31
"""Frequencies over which a spectrum is averaged to tell motion from noise."""
INDEPENDENT = 1 / 3
"""Share of neighbouring frequencies, through the window, that say something of their own."""
BY_CHANCE = 1e-6
"""Probability that noise alone makes such a mean stand out; there are thousands of means, and one
of them far above the motion would make the polynomial as narrow as can be."""


def with_local_derivative(record: Record, signal: str, name: str) -> tuple[Record, float]:
    """Add the time derivative of a noisy signal: slopes of local polynomials of fourth order.

    Least squares over 2 m + 1 samples, as by Savitzky and Golay. Noise falls with the power -3/2
    of the width, and the motion's error grows with the fourth: the half width is the largest at
    which that error, by the signal's spectrum above its noise, is 0.05 of the noise's standard
    deviation, and at least 3 samples. m samples are cut off at both ends, and become missing beside
    gaps.

    **Arguments:** `name` of the derivative.

    **Returns:** the record, and the half width in seconds.

    **Raises:** `DataError` for a missing signal, or stretches that are all too short.
    """
    op = local_slope(record, signal)
    return record.through({name: op}), op.lost[0] * float(record.time_step)


def local_slope(record: Record, signal: str) -> LinearOp:
    """The operation of [`with_local_derivative`][]."""
    record, spacing = judged(record, "auto", signal), float(record.time_step)
    longest = longest_stretch(record, signal)
    count = _widest(record, signal, spacing) if longest > 2 * NARROWEST else NARROWEST
    words = f"{{}}: slope of {signal} by local polynomials, {count * spacing:.3g} s to each side"
    taps = derivative_taps(count, spacing)[::-1]
    return LinearOp.of_taps(words, taps, -count, source=signal, unit="/s")


def derivative_taps(count: int, step: float) -> Taps:
    """Taps of the slope in the middle of `count` samples to each side, `step` seconds apart."""
    powers = np.vander(np.arange(-count, count + 1) / count, ORDER, increasing=True)
    # Of what is convolved, the taps stand in reverse.
    return np.linalg.pinv(powers)[1, ::-1] / (count * step)


def _widest(record: Record, signal: str, step: float) -> int:
    """Samples to each side at which smoothing errs by its share of the noise."""
    stretch = max(record.segments([signal]), key=lambda part: part.stop - part.start)
    samples = np.asarray(record[signal])[stretch][:LONGEST]
    size = samples.size
    kernels = record.noise.kernels[signal].values()
    noise = sum((np.abs(_response(k, size)) ** 2 for k in kernels), np.zeros(size // 2 + 1))
    # Mean square of the motion at each frequency, up to the last that stands out of the noise.
    window, place = blackman_harris(size), np.arange(size)
    samples = samples - np.polyval(np.polyfit(place, samples, 1), place)
    density = np.abs(np.fft.rfft(window * samples)) ** 2 / np.sum(window**2)
    around = np.ones(min(SMOOTHED, max(density.size // 8, 1)))
    summed = (density, noise, np.ones(density.size))
    near, usual, number = (np.convolve(each, around, "same") for each in summed)
    freedom = 2 * np.maximum(INDEPENDENT * number, 1.0)
    out = np.flatnonzero(near > scipy.special.chdtri(freedom, BY_CHANCE) / freedom * usual)
    last = out[-1] if out.size else 0
    above = np.where(np.arange(density.size) <= last, 2 * (density - noise) / size, 0.0)
    slope = 2j * np.pi * np.fft.rfftfreq(size) / step

    def fits(count: int) -> bool:
        response = _response(derivative_taps(count, step), size)
        bias = np.sum(above * np.abs(response - slope) ** 2)
        return bool(bias <= BIAS**2 * np.mean(noise * np.abs(response) ** 2))

    fitting = np.unique(np.geomspace(NARROWEST, max(WIDEST * size, NARROWEST), 60).astype(int))
    while fitting.size > 1:
        middle = fitting.size // 2
        fitting = fitting[middle:] if fits(int(fitting[middle])) else fitting[:middle]
    return int(fitting[0])


def _response(taps: Leaf, size: int) -> np.ndarray:
    """Response of a kernel at the frequencies of a transform of so many samples."""
    taps = np.asarray(taps)
    wrapped = np.zeros(size)
    np.add.at(wrapped, np.arange(taps.size) - taps.size // 2, taps)
    return np.fft.rfft(wrapped)


HALVES = (1, 2, 5, 10, 30)
"""Samples to each side of filters that are tried, the longest first as the test of all."""
LEFT = 0.1
"""What such a filter leaves at most, in terms of the position's noise through it. A sensor's own
noise is left whole: a filter of the position cannot tell it."""
MOST_THROUGH = 2.0
"""Noise through a filter, in terms of all that there is of it and of motion, past which the filter
is none."""
LEAST_NOISE = 1e-5
"""Noise of differences, as a share of these, below which it matters to nothing: what looks like it
may be motion that no difference is of the order to take off."""
CONSTANT = 0.3
"""Share of its taps that a filter's sum may reach: a derivative of what is constant is zero. What
copies the position, or smooths it, is no derivative, and to take it for one would hide that."""
SHARPENED = 2
"""Order of the differences that are looked at, in which motion hides noise less."""


def without_computed(
    record: Record, pairs: Pairs, known: Collection[str] = ()
) -> tuple[Record, list[str]]:
    """Slopes of local polynomials in place of derivatives that are filters of their signals.

    A signal's own sensor is all that such a derivative knows of; the polynomials are as wide as its
    motion allows. Not under jit, where the record stays as it is.

    **Arguments:** `pairs` of a signal and its derivative; `known`, signals whose noise was given:
    a sensor's, then.

    **Returns:** the record, and what was done, in words.
    """
    if not is_concrete(record):
        return record, []
    words, judging = [], record
    for signal, derivative in (p for p in pairs if not isinstance(p, Relation)):
        noise = judging.noise
        judged = noise.kernels.get(signal) and {signal, derivative} <= {*record.arrays}
        # Some are made of their signals by a step of preparation.
        if derivative in known or not judged or noise.is_made_of(derivative, signal):
            continue
        # As they were recorded: the record has polynomials in place of some already.
        position, rate = (judging.signal(name).with_nan for name in (signal, derivative))
        taps = filter_between(position, rate, float(noise.std(signal)))
        if taps is None:
            continue
        judging = _with_noise_of(judging, signal, derivative, taps)
        said = f"{derivative}: computed from {signal}, by a filter of {taps.size} samples"
        try:
            record, width = with_local_derivative(record, signal, derivative)
            said = f"{said}; in its place slopes of local polynomials, {width:.3g} s to each side"
        except DataError:  # too short for them
            record = _with_noise_of(record, signal, derivative, taps)
        words.append(said)
    return record, words


def _with_noise_of(record: Record, signal: str, derivative: str, taps: np.ndarray) -> Record:
    """The record, of whose derivative the noise is the signal's through these taps."""
    return record.with_noise(Noise.of({derivative: record.noise[signal].convolved(taps)}))


@np.errstate(over="ignore", invalid="ignore")
def filter_between(signal: Samples, other: Samples, noise: float) -> Taps | None:
    """Taps of the shortest filter that makes one signal of another, whose noise has this standard
    deviation; `None` if none does."""
    stretches = runs(~(np.isnan(signal) | np.isnan(other))).T.tolist()
    first, stop = max(stretches, key=lambda ends: ends[1] - ends[0], default=(0, 1))
    # Differences are one-sided at the ends.
    position, rate = (each[first + 1 : stop - 1][:ENOUGH] for each in (signal, other))
    x, y = (np.diff(each, SHARPENED) for each in (position, rate))
    if position.size < 8 * HALVES[-1]:
        return None
    least, scale = LEAST_NOISE * np.std(np.diff(position)), np.std(x)
    # What is not finite squared, no sensor shows.
    if not (noise / np.sqrt(2) > least and np.isfinite(scale + np.std(y))):
        return None
    columns = np.lib.stride_tricks.sliding_window_view(x / scale, 2 * HALVES[-1] + 1)
    target = y[HALVES[-1] : y.size - HALVES[-1]]
    found = None
    for half in reversed(HALVES):
        inner = slice(HALVES[-1] - half, HALVES[-1] + half + 1)
        some = columns[:, inner]
        taps = np.linalg.lstsq(some.T @ some, some.T @ target, rcond=1e-14)[0]
        left = target - some @ taps
        through = noise / scale * np.linalg.norm(np.convolve(taps, [1, -2, 1]))
        # Taps that make more noise than there is fit motion alone, which few waves are.
        there = np.sqrt(np.mean(target**2))
        made = np.sqrt(np.mean(left**2)) < LEFT * through
        if not (made and through < MOST_THROUGH * there):
            break
        found = taps[::-1] / scale
    if found is not None and abs(found.sum()) > CONSTANT * np.abs(found).sum():
        return None
    return found

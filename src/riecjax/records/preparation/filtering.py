"""Filters without phase, offsets, drifts and derivatives."""

from collections.abc import Mapping

import numpy as np
import scipy

from riecjax.errors import DataError
from riecjax.leaves import Leaf
from riecjax.records.linear_op import LinearOp, Operations, convolved_with, longest_stretch, step
from riecjax.records.noise_judgement import blackman_harris, judged
from riecjax.records.record import Record
from riecjax.records.signal import Taps

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
        shortest = max(2 * lost + 2, FILTER_PADDING) + 1
        if record.sample_count < shortest:
            raise DataError(
                f"the record is too short to be filtered at {cutoff:g} Hz: {lost} "
                f"samples are lost at each end. Raise the cut-off, or record for longer."
            )
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
            shortest=shortest,
        )
        yield name, op


@step
def unfilter(record: Record, lags: Mapping[str, float]) -> Operations:
    """Undo a first-order low-pass in front of a signal: s = z + tau z' of what it left, z.

    It raises noise above its cut-off, 1 / (2 pi tau), as the record's noise then says. Three
    samples are lost at both ends, and become missing beside gaps.

    **Arguments:** `lags`: signal name to the filter's time constant tau in seconds.

    **Raises:** `DataError` for a time constant that is not positive, a signal that the record
    lacks, or stretches of fewer than seven samples.
    """
    for name, seconds in lags.items():
        if not 0 < seconds < np.inf:
            raise DataError(
                f"the time constant of the low-pass before '{name}' must be positive; got "
                f"{seconds:g} s."
            )
        yield name, lead(record, seconds)


def lead(record: Record, seconds: float) -> LinearOp:
    """What [`unfilter`][] does, with any time constant."""
    taps = seconds / float(record.time_step) * SLOPE
    taps[taps.size // 2] += 1.0
    return LinearOp.of_taps(f"low-pass undone: {{}} of {seconds:g} s", taps, -(taps.size // 2))


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
    if longest < 2 * count + 1 or record.sample_count < 2 * count + 2:
        raise DataError(
            f"'{signal}' has no derivative by local polynomials: they take {2 * count + 1} samples "
            f"in succession, and its longest stretch has {longest}. Repair the gaps."
        )
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

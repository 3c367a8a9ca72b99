"""Filters without phase, offsets, drifts and derivatives, each on unbroken stretches."""

from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from riecjax.errors import DataError
from riecjax.records.missing import gaps, hold
from riecjax.records.noise import Noise
from riecjax.records.noise_judgement import judged
from riecjax.records.record import Record, samples_with_nan

FILTER_ORDER = 4
FILTER_PADDING = 16
"""Samples by which SciPy extends each end of a stretch for a filter of this order."""
SETTLING_PERIODS = 5
"""Periods of the cut-off frequency after which a zero-phase filter has forgotten the ends."""
SLOPE = np.array([1, -9, 45, 0, -45, 9, -1]) / 60
"""Taps of a derivative of sixth order over a sample, the middle one for the same sample."""


def low_pass(record: Record, cutoffs: dict[str, float]) -> Record:
    """Filter signals by a zero-phase Butterworth low-pass of 4th order (run both ways).

    Five periods of the lowest cut-off are cut from both ends, where the filter still feels the
    record's ends. Five periods of a signal's own cut-off become missing on both sides of its gaps.

    **Arguments:** `cutoffs`: signal name to cut-off in Hz.

    **Raises:** `DataError` for a cut-off beyond half the sampling rate, a missing signal, or a
    record whose stretches are too short for the filter.
    """
    if not cutoffs:
        return record
    time_step = float(record.time_step)
    nyquist = 0.5 / time_step
    for name, cutoff in cutoffs.items():
        if not 0 < cutoff < nyquist:
            raise DataError(
                f"cannot filter '{name}' at {cutoff:g} Hz: the cut-off must lie between 0 and half "
                f"the sampling rate, {nyquist:g} Hz."
            )
    lost = {name: int(np.ceil(SETTLING_PERIODS / f / time_step)) for name, f in cutoffs.items()}
    cut = max(lost.values())
    if record.sample_count <= _shortest(cut):
        raise DataError(
            f"the record is too short to be filtered at {min(cutoffs.values()):g} Hz: {cut} "
            f"samples are lost at each end. Raise the cut-off, or record for longer."
        )

    from scipy.signal import butter, sosfiltfilt  # take half a second, which few records need

    record = judged(record, "auto", *cutoffs)
    noise = record.noise

    def filtered(name: str) -> np.ndarray:
        nonlocal noise
        sections = butter(FILTER_ORDER, cutoffs[name] / nyquist, output="sos")
        impulse = np.zeros(4 * lost[name] + FILTER_PADDING + 1)
        impulse[impulse.size // 2] = 1.0
        noise = noise.filtered(name, sosfiltfilt(sections, impulse))

        def step(samples: np.ndarray) -> np.ndarray:
            found = np.full(samples.size, np.nan)
            if samples.size > _shortest(lost[name]):
                inner = slice(lost[name], -lost[name])
                found[inner] = sosfiltfilt(sections, samples)[inner]
            return found

        return on_stretches(record, name, step)

    columns = {name: filtered(name) for name in cutoffs}
    result = with_gaps(record, columns, noise=noise).part(cut, record.sample_count - cut)
    for name, cutoff in cutoffs.items():
        if not result.segments([name]):
            raise DataError(
                f"no stretch of '{name}' without a gap is long enough to be filtered at "
                f"{cutoff:g} Hz: it takes more than {_shortest(lost[name])} samples, and the "
                f"longest has {longest_stretch(record, name)}. Raise the cut-off, or repair the "
                f"gaps."
            )
    return result


def unfilter(record: Record, lags: Mapping[str, float]) -> Record:
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
    return lead(record, lags)


def lead(record: Record, seconds: Mapping[str, float]) -> Record:
    """As [`unfilter`][], of any time constant, one that is not positive too."""
    columns, half = {}, SLOPE.size // 2
    for name, tau in seconds.items():
        taps = tau / float(record.time_step) * SLOPE
        taps[half] += 1.0

        columns[name] = through(record, name, taps[::-1], -half)
        if np.isnan(columns[name]).all():
            raise DataError(f"no stretch of '{name}' is long enough for its low-pass to be undone.")
        record = judged(record, "auto", name)
        record = record.with_noise(record.noise.filtered(name, taps))
    result = with_gaps(record, columns, noise=record.noise)
    return result.part(half, record.sample_count - half)


def remove_offset(record: Record, *signals: str) -> Record:
    """Subtract from each of these signals its mean over the samples that are not missing.

    Instruments add offsets, which an equation with a stiffness reads as a force.

    **Raises:** `DataError` for no signal, or one that the record lacks.
    """
    return _without_polynomial(record, signals, 0)


def remove_drift(record: Record, *signals: str) -> Record:
    """Subtract from each of these signals its least-squares straight line over time.

    Time is the true one: a pause counts as long as it lasted.

    **Raises:** `DataError` for no signal, or one that the record lacks.
    """
    return _without_polynomial(record, signals, 1)


def _without_polynomial(record: Record, signals: tuple[str, ...], degree: int) -> Record:
    if not signals:
        raise DataError(
            f"name the signals to remove the {('offset', 'drift')[degree]} from; there are: "
            f"{', '.join(record.arrays)}."
        )
    time = np.asarray(record.time)
    columns = {}
    for name in signals:
        values = samples_with_nan(record, name)
        there = ~np.isnan(values)
        # `fit` maps time to [-1, 1], so that seconds since 1970 lose no digits.
        trend = np.polynomial.Polynomial.fit(
            time[there], values[there], min(degree, there.sum() - 1)
        )
        columns[name] = values - trend(time)
    return with_gaps(record, columns, noise=record.noise)


def _shortest(lost: int) -> int:
    """Samples that are still too few to be filtered if `lost` of them go at each end."""
    return max(2 * lost + 2, FILTER_PADDING)


def differentiate(record: Record, signal: str, name: str) -> Record:
    """Add the time derivative of a signal, by central differences of second order.

    Differentiation raises noise in proportion to frequency; prefer an integral criterion, which
    needs one derivative less, and filter first where it cannot be avoided.

    At the ends and beside gaps the differences are one-sided, of second order too, so that nothing
    is lost there. A single sample between gaps becomes missing.

    **Raises:** `DataError` for a missing signal, or one without two samples in succession.
    """
    if longest_stretch(record, signal) < 2:
        raise DataError(
            f"'{signal}' has no derivative: nowhere are two of its samples next to each other. "
            f"Repair the gaps, or resample to a lower rate."
        )
    unit = dict(record.units).get(signal)
    units = {} if unit is None else {name: f"{unit}/s"}
    derivative = on_stretches(record, signal, lambda x: central_difference(x, record.time_step))
    taps = np.array([0.5, 0.0, -0.5]) / float(record.time_step)
    record = judged(record, "auto", signal)
    return with_gaps(record, {name: derivative}, units, record.noise.filtered(signal, taps, name))


def central_difference(samples: ArrayLike, time_step: ArrayLike) -> Float[np.ndarray, " n"]:
    """Second-order differences, one-sided at both ends.

    Two samples have one slope; one sample has none, and gives NaN.
    """
    values = np.asarray(samples)
    if values.size < 2:
        return np.full(values.shape, np.nan)
    return np.gradient(
        values, np.asarray(time_step).item(), edge_order=1 if values.size == 2 else 2
    )


def on_stretches(
    record: Record, signal: str, step: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """What `step` makes of each unbroken stretch of a signal, NaN elsewhere, shape `(n,)`."""
    samples = np.asarray(record[signal])
    found = np.full(samples.size, np.nan)
    for stretch in record.segments([signal]):
        found[stretch] = step(samples[stretch])
    return found


def through(
    record: Record, signal: str, taps: Float[np.ndarray, " taps"], first: int
) -> Float[np.ndarray, " n"]:
    """Weighted sums of a signal's samples, from `first` samples on; NaN where they reach beyond."""

    def sums(samples: np.ndarray) -> np.ndarray:
        found = np.full(samples.size, np.nan)
        if samples.size < taps.size:
            return found
        every = np.convolve(samples, taps[::-1], "valid")
        places = np.arange(every.size) - first
        there = (places >= 0) & (places < samples.size)
        found[places[there]] = every[there]
        return found

    return on_stretches(record, signal, sums)


def with_gaps(
    record: Record,
    columns: Mapping[str, np.ndarray],
    units: Mapping[str, str] | None = None,
    noise: Noise | None = None,
) -> Record:
    """A record with these signals added or replaced, missing where they are NaN."""
    missing = {name: jnp.asarray(mask) for name, mask in gaps(columns).items()}
    held = {name: jnp.asarray(hold(values)) for name, values in columns.items()}
    return record.with_signals(held, units, missing, noise)


def longest_stretch(record: Record, signal: str) -> int:
    """Samples in the longest unbroken stretch of a signal."""
    return max((part.stop - part.start for part in record.segments([signal])), default=0)

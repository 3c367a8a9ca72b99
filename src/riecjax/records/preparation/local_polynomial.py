"""Derivatives by local polynomials, which smooth noise as widely as the motion allows."""

import numpy as np
import scipy.special
from jaxtyping import Float

from riecjax.errors import DataError
from riecjax.leaves import Leaf
from riecjax.records.noise_judgement import judged
from riecjax.records.noise_spectrum import blackman_harris
from riecjax.records.preparation.filtering import longest_stretch, through, with_gaps
from riecjax.records.record import Record

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


def with_local_derivative(
    record: Record, signal: str, name: str, half_width: float | None = None
) -> tuple[Record, float]:
    """Add the time derivative of a noisy signal: slopes of local polynomials of fourth order.

    Least squares over 2 m + 1 samples, as by Savitzky and Golay. Noise falls with the power -3/2
    of the width, and the motion's error grows with the fourth: unless given, the half width is the
    largest at which that error, by the signal's spectrum above its noise, is 0.05 of the noise's
    standard deviation. m samples are cut off at both ends, and become missing beside gaps.

    **Arguments:** `half_width` in seconds, at least 3 samples; `name` of the derivative.

    **Returns:** the record, and the half width in seconds.

    **Raises:** `DataError` for a missing signal, a half width below 3 samples, or stretches that
    are all too short.
    """
    record, step = judged(record, "auto", signal), float(record.time_step)
    longest = longest_stretch(record, signal)
    if half_width is None:
        count = _widest(record, signal, step) if longest > 2 * NARROWEST else NARROWEST
    else:
        count = round(half_width / step) if np.isfinite(half_width) else 0
    if count < NARROWEST:
        raise DataError(
            f"the half width of a local polynomial of '{signal}' must be {NARROWEST} samples, "
            f"{NARROWEST * step:g} s, at the least; got {half_width:g} s."
        )
    if longest < 2 * count + 1 or record.sample_count < 2 * count + 2:
        raise DataError(
            f"'{signal}' has no derivative by local polynomials: they take {2 * count + 1} samples "
            f"in succession, and its longest stretch has {longest}. Give a smaller half width, or "
            f"repair the gaps."
        )
    taps = derivative_taps(count, step)
    unit = dict(record.units).get(signal)
    units = {} if unit is None else {name: f"{unit}/s"}
    noise = record.noise.filtered(signal, taps, name)
    added = with_gaps(record, {name: through(record, signal, taps[::-1], -count)}, units, noise)
    return added.part(count, record.sample_count - count), count * step


def derivative_taps(count: int, step: float) -> Float[np.ndarray, " taps"]:
    """Taps of the slope in the middle of `count` samples to each side, `step` seconds apart."""
    # The least-squares slope of c1 t + c3 t^3; even powers have none there.
    t = np.arange(-count, count + 1) / count
    s2, s4, s6 = (np.sum(t**k) for k in (2, 4, 6))
    # Of what is convolved, the taps stand in reverse.
    return -(s6 * t - s4 * t**3) / (s2 * s6 - s4**2) / (count * step)


def _widest(record: Record, signal: str, step: float) -> int:
    """Samples to each side at which smoothing errs by its share of the noise."""
    stretch = max(record.segments([signal]), key=lambda part: part.stop - part.start)
    samples = np.asarray(record[signal])[stretch][:LONGEST]
    size = samples.size
    kernels = record.noise.kernels[signal].values()
    noise = sum((np.abs(_response(k, size)) ** 2 for k in kernels), np.zeros(size // 2 + 1))
    above = _above(samples, noise)
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


def _above(samples: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Mean square of the motion at each frequency, up to the last that stands out of the noise.

    **Arguments:** `noise`, its density, that of white noise being its variance.
    """
    from scipy.signal import detrend

    window = blackman_harris(samples.size)
    density = np.abs(np.fft.rfft(window * detrend(samples))) ** 2 / np.sum(window**2)
    around = np.ones(min(SMOOTHED, max(density.size // 8, 1)))
    summed = (density, noise, np.ones(density.size))
    near, usual, number = (np.convolve(each, around, "same") for each in summed)
    freedom = 2 * np.maximum(INDEPENDENT * number, 1.0)
    out = np.flatnonzero(near > scipy.special.chdtri(freedom, BY_CHANCE) / freedom * usual)
    last = out[-1] if out.size else 0
    return np.where(np.arange(density.size) <= last, 2 * (density - noise) / samples.size, 0.0)

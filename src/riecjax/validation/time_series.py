"""Second-order statistics of an equation error: correlation, spectrum, and what chance would make.

Both are of the error as a series in time with gaps. Correlations say what it follows and for how
long; the spectrum over which frequencies it is spread, and whether it gathers in a peak.
"""

from typing import NamedTuple

import numpy as np
import scipy.fft
from jaxtyping import Bool, Float, Int

from riecjax import tails
from riecjax.validation.equation_errors import EquationError

LEVEL = 0.05
"""Probability that chance alone passes a bound."""

# Bounds of correlations. Of two independent series of n values, with autocovariances R_1 and R_2,
# the sum c = sum_t x_t y_(t+k) has mean zero and the variance
#
#     E c^2 = sum_(t,s) E(x_t x_s) E(y_(t+k) y_(s+k)) = sum_j (n - |j|) R_1(j) R_2(j),
#
# and the correlation c / (n s_1 s_2) therefore (1/n) sum_j r_1(j) r_2(j), to first order in 1/n:
# Bartlett's formula. For white noise it is 1/n. Two signals that oscillate at one frequency pass
# 1.96 / sqrt(n) all the time; n times the variance is how many samples tell as much as one
# independent sample, and correlations at lags closer than that are one test, not several.
#
# What the integrated autocorrelation says. A sum over m = lags + 1 successive values has the
# variance s^2 (m + 2 sum_(k < m) (m - k) r(k)): in units of m s^2, that of white noise, it is
# 1 + 2 sum (1 - k/m) r(k). It goes to zero where eq. (8) bounds the impulse of the error, since
# the variance then stays while m grows.


class Autocorrelation(NamedTuple):
    """Autocorrelation of an error.

    **Fields:**

    - `lag` in seconds and `values`, shape `(lags + 1,)`, 1 at lag zero.
    - `bound`: 95 % of the values of white noise lie within plus or minus this.
    - `correlation_time`: sum of the squared values over lags of both signs, in seconds: how long
      an error stays like itself, with either sign. One time step for white noise.
    - `integrated`: sum of the values themselves over lags of both signs, tapered to the longest,
      in seconds. One time step for white noise; near zero where only modes make the error.
    """

    lag: Float[np.ndarray, " lags"]
    values: Float[np.ndarray, " lags"]
    bound: float
    correlation_time: float
    integrated: float


class CrossCorrelation(NamedTuple):
    """Correlation of an error with one signal.

    **Fields:**

    - `signal`: its name.
    - `lag` in seconds and `values`, shape `(2 lags + 1,)`; at a positive lag the error comes later.
    - `bound`: two independent series with these autocorrelations stay below it at every lag of
      every signal of the equation, with 95 % probability.
    """

    signal: str
    lag: Float[np.ndarray, " lags"]
    values: Float[np.ndarray, " lags"]
    bound: float

    @property
    def largest(self) -> float:
        """The correlation of largest size."""
        return float(self.values[np.argmax(np.abs(self.values))])

    @property
    def largest_lag(self) -> float:
        """Its lag in seconds."""
        return float(self.lag[np.argmax(np.abs(self.values))])


def autocorrelation(
    values: Float[np.ndarray, " n"], present: Bool[np.ndarray, " n"], lags: int, time_step: float
) -> Autocorrelation:
    """Autocorrelation about the mean at lags from zero; zeros of a series that does not vary."""
    centred = _centred(values, present)
    forward = np.arange(lags + 1)
    found = _correlation(centred, centred, present, present, forward)
    taper = 1 - forward[1:] / (lags + 1)
    return Autocorrelation(
        forward * time_step,
        found,
        float(tails.normal(LEVEL / 2) / np.sqrt(max(present.sum(), 1))),
        time_step * float(1 + 2 * np.sum(found[1:] ** 2)),
        time_step * float(1 + 2 * np.sum(taper * found[1:])),
    )


def cross_correlation(
    error: Float[np.ndarray, " n"],
    signal: Float[np.ndarray, " n"],
    present: Bool[np.ndarray, " n"],
    lags: int,
    time_step: float,
    *,
    name: str = "",
    signals: int = 1,
) -> CrossCorrelation:
    """Correlation of an error with a signal about their means, at lags of both signs.

    The bound takes Bartlett's variance, and Bonferroni's correction for as many lags as are
    independent, of this and of all `signals`.
    """
    one, other = _centred(error, present), _centred(signal, present)
    both = np.arange(-lags, lags + 1)
    values = _correlation(one, other, present, present, both)
    variance = bartlett_variance(one, other)
    apart = max(both.size / max(variance * present.sum(), 1.0), 1.0)
    quantile = tails.normal(LEVEL / (2 * apart * signals))
    return CrossCorrelation(name, both * time_step, values, float(quantile * np.sqrt(variance)))


def bartlett_variance(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> float:
    """Variance of the correlation of two independent series: sum_k r_1(k) r_2(k) / n (Bartlett).

    Of series about their means, zero where a sample is missing; 0 of a silent one.
    """
    size = scipy.fft.next_fast_len(2 * one.size, real=True)
    power = [np.abs(np.fft.rfft(series, size)) ** 2 for series in (one, other)]
    first, second = (np.fft.irfft(p, size) for p in power)
    scale = first[0] * second[0]
    count = np.count_nonzero((one != 0) | (other != 0))
    return float(np.sum(first * second) / (scale * count)) if scale > 0 and count else 0.0


def moving_average(
    values: Float[np.ndarray, " n"], present: Bool[np.ndarray, " n"], count: int
) -> tuple[Float[np.ndarray, " m"], Bool[np.ndarray, " m"]]:
    """Means of `count` successive values, and a mask of those that are whole."""
    running = np.concatenate([[0.0], np.cumsum(np.where(present, values, 0.0))])
    absent = np.concatenate([[0], np.cumsum(~present)])
    whole = absent[count:] == absent[:-count]
    return np.where(whole, (running[count:] - running[:-count]) / count, 0.0), whole


def _centred(values: np.ndarray, present: np.ndarray) -> np.ndarray:
    mean = np.sum(values, where=present) / max(present.sum(), 1)
    return np.where(present, values - mean, 0.0)


def _correlation(
    one: np.ndarray,
    other: np.ndarray,
    one_valid: np.ndarray,
    other_valid: np.ndarray,
    lags: Int[np.ndarray, " lags"],
) -> Float[np.ndarray, " lags"]:
    """Mean product of the pairs that are valid at each lag, over the root mean squares."""
    pairs = np.round(_products(one_valid.astype(float), other_valid.astype(float), lags))
    squares = np.sum(one**2) / max(one_valid.sum(), 1) * np.sum(other**2)
    scale = np.sqrt(squares / max(other_valid.sum(), 1))
    if not scale > 0:
        return np.where(lags == 0, 1.0 if one is other else 0.0, 0.0)
    return np.where(pairs > 0, _products(one, other, lags) / np.maximum(pairs, 1) / scale, 0.0)


def _products(one: np.ndarray, other: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Sum over t of one[t + lag] other[t]."""
    size = scipy.fft.next_fast_len(2 * one.size, real=True)
    spectrum = np.fft.rfft(one, size) * np.conj(np.fft.rfft(other, size))
    return np.fft.irfft(spectrum, size)[lags % size]


# When a peak is no chance. One periodogram scatters by its own size. The mean over K segments under
# Hann windows that overlap by half scatters by sqrt((1 + 2 c^2) / K), where neighbouring segments
# correlate by c = 1/6, so c^2 = 1/36 between their powers. The three-point smoothing
# (1, 2, 1) / 4 leaves 0.78 of that, since Hann's neighbouring frequencies correlate by 4/9. So
# the 8 segments that are asked for scatter by 0.28, and a factor of 4, log 4 = 1.4, is five
# standard deviations.
#
# How wide a mode is. Under white excitation the power of a lightly damped mode is
# 1 / (1 + ((f - f_0) / h)^2) with h = zeta f_0. It is half at f_0 - h and f_0 + h, a width of
# 2 zeta f_0, and half of it lies between: (2 / pi) arctan(1).

SEGMENTS = 32
"""A segment of the spectrum is this part of the record; segments overlap by half."""
FEWEST_SEGMENTS = 8
"""Segments below which a spectrum is too rough to look for a peak."""
SHORTEST_SEGMENT = 64
"""Samples of a segment, unless the unbroken stretches are shorter."""
BAND_SHARE = 0.99
"""Share of the power common to target and explained part that the model's band holds."""
PROMINENCE = 4.0
"""How many times the spectrum of its surroundings, on either side, a peak is: 6 dB."""
PEAK_BAND = 0.9
"""Part of the model's band in which a peak is a mode's, and not the end of the excitation."""
PEAK_SHARE = 0.3
"""Share of the error's power in the model's band that a peak holds between its half-power points.
"""


class Peak(NamedTuple):
    """A peak of an error's spectrum.

    **Fields:** `frequency`, half-power points `low` and `high` in hertz; `share` of the error's
    power in the model's band that lies between them; `size`, root mean square of that part
    of the error relative to the target's.
    """

    frequency: float
    low: float
    high: float
    share: float
    size: float

    @property
    def bandwidth(self) -> float:
        """Width between the half-power points in hertz."""
        return self.high - self.low


class ErrorSpectrum(NamedTuple):
    """One-sided power spectral densities, in (unit of the equation)^2/Hz.

    **Fields:** `frequency` in hertz; densities of `error`, `explained` part and `target`; `common`,
    real part of the density between target and explained part, to which noise in only one of them
    adds nothing; all of shape `(frequencies,)`. `segments` averaged over.
    """

    frequency: Float[np.ndarray, " frequencies"]
    error: Float[np.ndarray, " frequencies"]
    explained: Float[np.ndarray, " frequencies"]
    target: Float[np.ndarray, " frequencies"]
    common: Float[np.ndarray, " frequencies"]
    segments: int

    @property
    def resolution(self) -> float:
        """Hertz from one frequency to the next."""
        return float(self.frequency[1])

    @property
    def band(self) -> float:
        """Hertz up to which 99 % of the power common to target and explained part lies.

        Sensor noise that differentiation raises towards half the sampling rate is in one of them
        only, so this is the band of the motion, whatever the noise above it.
        """
        running = np.cumsum(np.maximum(self.common, 0.0))
        if not running[-1] > 0:
            return float(self.frequency[-1])
        return float(self.frequency[np.searchsorted(running, BAND_SHARE * running[-1])])

    def peak(self) -> Peak | None:
        """The peak of the error that holds most power, if there is a genuine one.

        It stands out fourfold on both sides, is no wider than its frequency (a mode of half the
        critical damping), has both half-power points below nine tenths of the model's band, and
        holds 30 % of the error's power there. A rise towards half the sampling rate, as of
        differentiated noise, is no peak, nor one that only ends where the excitation does.
        """
        from scipy.signal import find_peaks  # half a second, which the first answer need not wait

        if self.segments < FEWEST_SEGMENTS or not np.any(self.error > 0):
            return None
        smooth = np.convolve(np.pad(self.error, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
        level = np.log(np.maximum(smooth, np.finfo(float).tiny))
        tops, _ = find_peaks(level, prominence=np.log(PROMINENCE))
        peaks = (self._peak_at(int(top), smooth) for top in tops)
        genuine = [
            p
            for p in peaks
            if p.bandwidth <= p.frequency
            and p.high < PEAK_BAND * self.band
            and p.share >= PEAK_SHARE
        ]
        return max(genuine, key=lambda p: p.share, default=None)

    def _peak_at(self, top: int, smooth: Float[np.ndarray, " frequencies"]) -> Peak:
        from scipy.signal import peak_widths

        # As prominence the whole height, so that half the prominence is half the power.
        height = np.array([smooth[top]]), np.array([0]), np.array([smooth.size - 1])
        edges = peak_widths(smooth, [top], prominence_data=height)
        low, high = (float(edge[0]) * self.resolution for edge in edges[2:])
        inside = (self.frequency >= low) & (self.frequency <= high)
        # The mean is no oscillation, so it does not count.
        total = np.sum(self.error, where=(self.frequency > 0) & (self.frequency <= self.band))
        power = np.sum(self.error, where=inside)
        whole = np.sum(self.target)
        return Peak(
            float(self.frequency[top]),
            low,
            high,
            float(power / total) if total > 0 else 0.0,
            float(np.sqrt(power / whole)) if whole > 0 else 0.0,
        )


def error_spectrum(
    error: EquationError, *, parts: int = SEGMENTS, detrend: bool = True
) -> ErrorSpectrum:
    """Welch's spectra of an equation error and of what the model explains.

    Hann windows on segments that overlap by half; none reaches over a gap. Not under jit.

    **Arguments:** `parts`: a segment is this part of the record, 64 samples at least; shorter
    where unbroken stretches are. `detrend`: take each segment's mean off.
    """
    from scipy.signal import csd

    runs = unbroken(np.asarray(error.present))
    length = segment_length([run.stop - run.start for run in runs], parts)
    left, explained, target = map(np.asarray, (error.error, error.explained, error.target))
    pairs = {
        "error": (left, left),
        "explained": (explained, explained),
        "target": (target, target),
        "common": (target, explained),
    }
    sums = {name: np.zeros(length // 2 + 1) for name in pairs}
    count = 0
    for run in runs:
        # A longer run of segments counts for more, as in one mean over all of them.
        segments = max((run.stop - run.start - length) // (length - length // 2) + 1, 0)
        count += segments
        for name, (one, other) in pairs.items() if segments else ():
            _, density = csd(
                one[run],
                other[run],
                fs=1 / float(error.time_step),
                nperseg=length,
                detrend="constant" if detrend else False,  # pyright: ignore[reportArgumentType]
            )
            sums[name] += segments * np.real(density)
    frequency = np.fft.rfftfreq(length, float(error.time_step))
    means = {name: total / max(count, 1) for name, total in sums.items()}
    return ErrorSpectrum(frequency, **means, segments=count)


def unbroken(present: Bool[np.ndarray, " n"]) -> list[slice]:
    """Stretches without a missing value."""
    edges = np.flatnonzero(np.diff(np.pad(present.astype(np.int8), 1)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2])]


def segment_length(stretches: list[int], parts: int) -> int:
    """Samples in a segment: as wanted, unless half of all samples lie in shorter stretches."""
    if not stretches:
        return SHORTEST_SEGMENT
    longest_first = np.sort(stretches)[::-1]
    running = np.cumsum(longest_first)
    typical = int(longest_first[np.searchsorted(running, running[-1] / 2)])
    return max(min(max(int(running[-1]) // parts, SHORTEST_SEGMENT), typical), 2)

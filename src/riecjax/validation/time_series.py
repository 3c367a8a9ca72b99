"""Second-order statistics of an equation error: correlation, spectrum, and what chance would make.

Both are of the error as a series in time with gaps. Correlations say what it follows and for how
long; the spectrum over which frequencies it is spread, and whether it gathers in a peak.
"""

from typing import NamedTuple

import numpy as np
import scipy.fft
import scipy.signal
from jaxtyping import Bool, Float, Int

from riecjax import tails
from riecjax.validation.equation_errors import EquationError

LEVEL = 0.05
"""Probability that chance alone passes a bound."""


class Autocorrelation(NamedTuple):
    """How alike an error is to itself some time later.

    **Fields:**

    - `lag` in seconds and `values`, shape `(lags + 1,)`, 1 at lag zero.
    - `bound`: 95 % of the values of white noise lie within plus or minus this.
    - `correlation_time`: sum of the squared values over lags of both signs, in seconds: how long
      an error stays like itself, with either sign. One time step for white noise.
    - `integrated`: sum of the values themselves over lags of both signs, tapered to the longest,
      in seconds. One time step for white noise; near zero where the error swings back, as eq. (8)
      says of an error that only modes make: its impulse stays bounded.
    """

    lag: Float[np.ndarray, " lags"]
    values: Float[np.ndarray, " lags"]
    bound: float
    correlation_time: float
    integrated: float


class CrossCorrelation(NamedTuple):
    """How an error follows one signal.

    **Fields:**

    - `signal`: its name.
    - `lag` in seconds and `values`, shape `(2 lags + 1,)`; at a positive lag the error comes later.
    - `bound`: what two independent series with these autocorrelations stay below at every lag of
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
    """Autocorrelation over lags from zero, about the mean; zeros of a silent series."""
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
    """Correlation of an error with a signal, over lags of both signs, about their means.

    The bound takes Bartlett's variance of the correlation of two independent series, the sum over
    all lags of the product of their autocorrelations over the number of values, and Bonferroni's
    correction for as many lags as are independent, of this and of all `signals`.
    """
    one, other = _centred(error, present), _centred(signal, present)
    both = np.arange(-lags, lags + 1)
    values = _correlation(one, other, present, present, both)
    variance = bartlett_variance(one, other)
    # Correlations at lags closer than the series' own memory, n times the variance, are one test.
    apart = max(both.size / max(variance * present.sum(), 1.0), 1.0)
    quantile = tails.normal(LEVEL / (2 * apart * signals))
    return CrossCorrelation(name, both * time_step, values, float(quantile * np.sqrt(variance)))


def bartlett_variance(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> float:
    """Variance of the correlation of two independent series, zero where a sample lacks.

    Bartlett: sum_k r_1(k) r_2(k) / n; at least that of no values at all, 0.
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
    """Means of `count` successive values, and where all of them are present."""
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
    one_there: np.ndarray,
    other_there: np.ndarray,
    lags: Int[np.ndarray, " lags"],
) -> Float[np.ndarray, " lags"]:
    """Mean product at each lag, of as many pairs as there are, over the root mean squares."""
    pairs = np.round(_products(one_there.astype(float), other_there.astype(float), lags))
    squares = np.sum(one**2) / max(one_there.sum(), 1) * np.sum(other**2)
    scale = np.sqrt(squares / max(other_there.sum(), 1))
    if not scale > 0:
        return np.where(lags == 0, 1.0 if one is other else 0.0, 0.0)
    return np.where(pairs > 0, _products(one, other, lags) / np.maximum(pairs, 1) / scale, 0.0)


def _products(one: np.ndarray, other: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Sum over t of one[t + lag] other[t]."""
    size = scipy.fft.next_fast_len(2 * one.size, real=True)
    spectrum = np.fft.rfft(one, size) * np.conj(np.fft.rfft(other, size))
    return np.fft.irfft(spectrum, size)[lags % size]


SEGMENTS = 32
"""Parts of the record that a segment of the spectrum is one of, halves of segments overlapping."""
FEWEST_SEGMENTS = 8
"""Segments below which a spectrum is too rough to look for a peak."""
SHORTEST_SEGMENT = 64
"""Samples of a segment, unless the unbroken stretches are shorter."""
BAND_SHARE = 0.99
"""Share of the power common to target and explained part that the model's band holds."""
PROMINENCE = 4.0
"""How many times the spectrum of its surroundings, on either side, a peak is: 6 dB."""
PEAK_BAND = 0.9
"""Part of the model's band in which a peak is one of its own, and not the excitation's end."""
PEAK_SHARE = 0.3
"""Share of the error's power in the model's band that a peak holds between its half-power points;
a resonance alone holds about a half there."""


class Peak(NamedTuple):
    """A peak of an error's spectrum.

    **Fields:** `frequency`, half-power points `low` and `high` in hertz; `share` of the error's
    power in the model's band that lies between them; `size`, root mean square of that part
    of the error against the target's.
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

        It stands out fourfold from both sides, is no wider than its frequency (a mode of half the
        critical damping), lies with its half-power points below nine tenths of the model's band,
        and holds 30 % of the error's power there. A rise towards half the sampling rate, as of
        differentiated noise, is none, nor one that only ends where the excitation does.
        """
        if self.segments < FEWEST_SEGMENTS or not np.any(self.error > 0):
            return None
        smooth = np.convolve(np.pad(self.error, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
        level = np.log(np.maximum(smooth, np.finfo(float).tiny))
        tops, _ = scipy.signal.find_peaks(level, prominence=np.log(PROMINENCE))
        peaks = [self._at(int(top), smooth) for top in tops]
        held = [
            p
            for p in peaks
            if p.bandwidth <= p.frequency
            and p.high < PEAK_BAND * self.band
            and p.share >= PEAK_SHARE
        ]
        return max(held, key=lambda p: p.share, default=None)

    def _at(self, top: int, smooth: Float[np.ndarray, " frequencies"]) -> Peak:
        edges = scipy.signal.peak_widths(smooth, [top], prominence_data=_from_zero(smooth, top))
        low, high = (float(edge[0]) * self.resolution for edge in edges[2:])
        inside = (self.frequency >= low) & (self.frequency <= high)
        # The mean is no oscillation: it is not part of the power that a share is taken of.
        swinging = (self.frequency > 0) & (self.frequency <= self.band)
        total = np.sum(self.error, where=swinging)
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
    runs = unbroken(np.asarray(error.present))
    series = {
        "error": np.asarray(error.error),
        "explained": np.asarray(error.explained),
        "target": np.asarray(error.target),
    }
    length = segment_length([run.stop - run.start for run in runs], parts)
    sums = {name: np.zeros(length // 2 + 1) for name in (*series, "common")}
    taken_off = "constant" if detrend else False
    count = 0
    for run in runs:
        segments = (run.stop - run.start - length) // (length - length // 2) + 1
        if segments < 1:
            continue
        pairs = {**{name: (name, name) for name in series}, "common": ("target", "explained")}
        for name, (one, other) in pairs.items():
            _, density = scipy.signal.csd(
                series[one][run],
                series[other][run],
                fs=1 / float(error.time_step),
                nperseg=length,
                detrend=taken_off,  # pyright: ignore[reportArgumentType]
            )
            sums[name] += segments * np.real(density)
        count += segments
    frequency = np.fft.rfftfreq(length, float(error.time_step))
    return ErrorSpectrum(
        frequency, **{k: v / max(count, 1) for k, v in sums.items()}, segments=count
    )


def unbroken(present: Bool[np.ndarray, " n"]) -> list[slice]:
    """Stretches in which everything is present."""
    edges = np.flatnonzero(np.diff(np.pad(present.astype(np.int8), 1)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2])]


def segment_length(stretches: list[int], parts: int) -> int:
    """Samples to a segment: as wanted, but half of all samples lie in stretches as long."""
    if not stretches:
        return SHORTEST_SEGMENT
    longest_first = np.sort(stretches)[::-1]
    running = np.cumsum(longest_first)
    typical = int(longest_first[np.searchsorted(running, running[-1] / 2)])
    return max(min(max(int(running[-1]) // parts, SHORTEST_SEGMENT), typical), 2)


def _from_zero(
    smooth: Float[np.ndarray, " frequencies"], top: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `peak_widths` takes as a peak's prominence: its whole height, so that half is half."""
    last = smooth.size - 1
    return np.array([smooth[top]]), np.array([0]), np.array([last])

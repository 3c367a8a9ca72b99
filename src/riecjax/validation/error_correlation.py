"""Correlation of an equation error with itself and with signals, and what chance would make."""

from typing import NamedTuple

import numpy as np
import scipy.fft
from jaxtyping import Bool, Float, Int

from riecjax import tails

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

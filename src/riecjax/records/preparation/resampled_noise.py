"""The noise of signals that are brought to another rate."""

import math

import numpy as np
from jaxtyping import Float

from riecjax.records.noise import DIFFERENCE_ORDER, STRETCH, STRETCHES, Noise, shortened, usual_size
from riecjax.records.preparation.band_limited import reach_beyond, response

KNOTS = 20
"""Samples to each side past which a spline through them no longer feels one: 0.27^20 = 4e-12."""
PHASES = 64
"""Places between samples that a grid is taken to have, at the most."""


def resampled_noise(noise: Noise, spacing: float) -> Noise:
    """The noise of a record whose samples are `spacing` of the old ones apart.

    With h the response of the resampler, w of unit size on the old samples, gives
    e(t) = sum_j h(t - j) w[j], of autocovariance int h(u) h(u + t) du as h is band-limited to both
    rates. A source of unit size on the new samples has that with taps sqrt(spacing) h(i spacing).
    """

    def taps(kernel: np.ndarray) -> np.ndarray:
        half = kernel.size // 2
        reach = math.ceil((half + reach_beyond(spacing)) / spacing)
        places = spacing * np.arange(-reach, reach + 1)
        through = response(places[:, None] - np.arange(-half, half + 1), spacing)
        return shortened(math.sqrt(spacing) * through @ kernel)

    kernels = {
        name: {source: taps(np.asarray(kernel)) for source, kernel in of.items()}
        for name, of in noise.kernels.items()
    }
    return Noise(kernels, noise.freedom)


def low_pass_taps(spacing: float) -> Float[np.ndarray, " taps"]:
    """The kernel, on the new samples, that a low-pass for a slower rate makes of white noise."""
    return np.asarray(resampled_noise(Noise({"": {"": np.ones(1)}}), spacing).kernels[""][""])


def spline_taps(positions: Float[np.ndarray, " m"]) -> Float[np.ndarray, " taps"]:
    """The kernel that a cubic spline makes of white noise.

    Between samples a spline averages, on them it does not: the noise is not stationary. The kernel
    is the symmetric one with the mean of its autocovariances.

    **Arguments:** `positions` at which the spline is evaluated, in samples, evenly spaced.
    """
    from scipy.interpolate import CubicSpline  # takes half a second, which few records need

    spacing = float(positions[1] - positions[0])
    knots = np.arange(-2 * KNOTS, 2 * KNOTS + 1)
    spline = CubicSpline(knots, (knots == 0).astype(float))

    def at(places: np.ndarray) -> np.ndarray:
        return np.where(np.abs(places) < KNOTS, spline(np.clip(places, -KNOTS, KNOTS)), 0.0)

    reach = math.ceil(2 * KNOTS / spacing)
    chosen = np.linspace(0, positions.size - 1, min(positions.size, PHASES)).astype(int)
    near = np.arange(-KNOTS, KNOTS + 1)
    first = np.mod(positions[chosen], 1.0)[:, None]
    here = at(first - near)
    covariance = np.array(
        [np.mean(np.sum(here * at(first + lag * spacing - near), 1)) for lag in range(reach + 1)]
    )
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

"""Inputs to excite a system with: band-limited noise, multisines, random roads, a pot-hole.

Velocities are positive downwards, as in eqs (19)-(20) of the paper: a hole starts with a positive
road velocity.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from riecjax.arrays import is_concrete
from riecjax.errors import ModelError


def band_limited_noise(
    key: Key[Array, ""],
    sample_count: int,
    time_step: float | Array,
    *,
    bandwidth: float | Array,
    rms: float | Array,
) -> Float[Array, " n"]:
    """Gaussian white noise between 0 Hz (excluded) and `bandwidth` Hz, of exactly this r.m.s.

    White noise whose Fourier components above the bandwidth are removed, as in Section 6 of the
    paper, with its mean removed too, since the criterion asks for regressors of zero mean. The
    r.m.s. over the record is exact, not expected.

    **Raises:** `ModelError` for fewer than 4 samples.
    """
    _check_count(sample_count)
    white = jax.random.normal(key, (sample_count,))
    noise = _filtered(white, time_step, lambda f: (f > 0) & (f <= bandwidth))
    power = jnp.mean(noise**2)
    # A band that holds no Fourier component is silence, not a division by zero.
    return noise * jnp.where(power > 0, rms / jnp.sqrt(jnp.where(power > 0, power, 1.0)), 0.0)


def low_passed(
    signal: Float[Array, " n"], time_step: float | Array, bandwidth: float | Array
) -> Float[Array, " n"]:
    """A signal without its Fourier components above `bandwidth` Hz (Section 6 of the paper)."""
    return _filtered(signal, time_step, lambda f: f <= bandwidth)


def _filtered(
    signal: Float[Array, " n"], time_step: float | Array, gain: Callable[[Array], Array]
) -> Float[Array, " n"]:
    """The sum of a signal's Fourier components, each times the gain at its frequency in Hz."""
    count = signal.shape[0]
    frequency = jnp.arange(count // 2 + 1) / (count * time_step)
    return jnp.fft.irfft(gain(frequency) * jnp.fft.rfft(signal), count)


def harmonics(
    sample_count: int, time_step: float, *, lowest: float, highest: float, count: int | None = None
) -> Float[np.ndarray, " k"]:
    """Frequencies in Hz of which a record holds whole periods: multiples of 1 / (n dt).

    **Arguments:** `lowest` and `highest` frequency in Hz, both included; `count`, about so many of
    them, in equal ratios, where they are not all wanted.

    **Raises:** `ModelError` for fewer than 4 samples, or a band that holds no such frequency below
    the Nyquist frequency.
    """
    _check_count(sample_count)
    duration = sample_count * time_step
    # A millionth of a spacing: ends that rounding puts beside the grid are on it.
    first = max(int(np.ceil(lowest * duration - 1e-6)), 1)
    last = min(int(np.floor(highest * duration + 1e-6)), (sample_count - 1) // 2)
    if first > last:
        raise ModelError(
            f"no multiple of {1 / duration:.4g} Hz lies between {lowest:g} and {highest:g} Hz and "
            f"below {0.5 / time_step:g} Hz."
        )
    numbers = np.arange(first, last + 1)
    if count is not None and count < len(numbers):
        numbers = np.unique(np.round(np.geomspace(first, last, count)).astype(int))
    return numbers / duration


def multisine(
    amplitudes: Float[Array, " k"],
    phases: Float[Array, " k"],
    frequencies: Float[Array, " k"] | Float[np.ndarray, " k"],
    sample_count: int,
    time_step: float | Array,
) -> Float[Array, " n"]:
    """Sum of harmonics, a_i cos(2 pi f_i t + phi_i), with t = 0 at the first sample.

    Differentiable in amplitudes and phases. On the grid of [`harmonics`][] its mean is zero and
    its mean square is half the sum of the squared amplitudes.

    **Arguments:** `amplitudes` in the unit of the input; `phases` in rad; `frequencies` in Hz.

    **Raises:** `ModelError` for fewer than 4 samples, or a frequency that so long a time step does
    not resolve (where both can be looked at).
    """
    _check_count(sample_count)
    if is_concrete(frequencies, time_step):
        nyquist = 0.5 / float(time_step)
        if not np.all((np.asarray(frequencies) >= 0) & (np.asarray(frequencies) < nyquist)):
            raise ModelError(f"frequencies of a multisine lie between 0 and {nyquist:g} Hz.")
    # Periods, less the whole ones: the angle of a long record would lose digits.
    periods = jnp.arange(sample_count)[:, None] * (jnp.asarray(frequencies) * time_step)[None, :]
    angle = 2 * jnp.pi * (periods - jnp.floor(periods))
    # Two products with a vector, whose derivatives are products again.
    return jnp.cos(angle) @ (amplitudes * jnp.cos(phases)) - jnp.sin(angle) @ (
        amplitudes * jnp.sin(phases)
    )


def robson_road(
    key: Key[Array, ""],
    sample_count: int,
    time_step: float | Array,
    *,
    speed: float | Array = 20.0,
    roughness: float | Array = 3e-5,
    bandwidth: float | Array = 30.0,
) -> Float[Array, " n"]:
    """Road velocity in m/s of a random road, eq. (27): S(f) = k U^1.5 f^-2.5.

    S is the displacement's spectral density, read here per rad/s, that is, divided by 2 pi as a
    density per Hz. Taken per Hz the road would lift the tyre 23 % of the time, far from what the
    paper shows. Components between 0 Hz (excluded) and `bandwidth` are Gaussian.

    **Arguments:** `speed` U in m/s; `roughness` k; `bandwidth` in Hz.

    **Raises:** `ModelError` for fewer than 4 samples.
    """
    _check_count(sample_count)

    def gain(frequency: Array) -> Array:
        inside = (frequency > 0) & (frequency <= bandwidth)
        f = jnp.where(inside, frequency, 1.0)
        # (2 pi f)^2 S(f) / (2 pi), the velocity's density per Hz.
        density = jnp.where(inside, 2 * jnp.pi * roughness * speed**1.5 * f**-0.5, 0.0)
        # A white record of unit variance has one-sided density 2 dt, and is given `density`.
        return jnp.sqrt(density / (2 * time_step))

    return _filtered(jax.random.normal(key, (sample_count,)), time_step, gain)


def pothole(
    sample_count: int,
    time_step: float | Array,
    *,
    depth: float | Array,
    length: float | Array,
    ramp: float | Array,
    speed: float | Array = 20.0,
    start: float | Array = 0.1,
) -> Float[Array, " n"]:
    """Road velocity in m/s of a pot-hole crossed at constant speed.

    The road falls by `depth` along a ramp, stays level, and rises again along another; each ramp is
    a raised-cosine step. Samples are the mean velocity between the midpoints around them, so that
    integrating them by trapezoids returns to the road's level exactly.

    **Arguments:** `depth` in m; `length` from the middle of one ramp to that of the other in m;
    `ramp` in m along the road; `speed` in m/s; `start` of the first ramp in s.

    **Raises:** `ModelError` for fewer than 4 samples.
    """
    _check_count(sample_count)
    midpoints = (jnp.arange(sample_count + 1) - 0.5) * time_step
    travelled = speed * (midpoints - start)

    def step_down(distance):
        share = jnp.clip(distance / ramp, 0.0, 1.0)
        return 0.5 * (1 - jnp.cos(jnp.pi * share))

    drop = depth * (step_down(travelled) - step_down(travelled - length))
    return jnp.diff(drop) / time_step


def _check_count(sample_count: int) -> None:
    if sample_count < 4:
        raise ModelError(f"an excitation needs at least 4 samples; got {sample_count}.")

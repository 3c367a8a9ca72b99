"""Gains of windows: how much of each frequency one window, or a range of lengths, lets through.

A window of length T passes an oscillation exp(i w t) with a gain |H|, the size of its weight's
Fourier integral. For the boxcar, eq. (13),

    |H| = |integral_0^T exp(i w t) dt| = |2 sin(w T / 2) / w|

which is largest at T = 1 / (2 f) for a given f (eq. 26) and zero at multiples of T = 1 / f. The hat
is the boxcar of T / 2 folded with itself, so its gain is the square of that one's. In the mean over
lengths, eq. (14), no frequency is left unseen: with x = w T / (2 s) and s the order of the
difference, |H| = (2 |sin x| / w)^s, and for T ~ U(alpha, beta)

    mean |H|^q = (2 / w)^(s q) (P(x_beta) - P(x_alpha)) / (x_beta - x_alpha)

where P is the integral of |sin|^(s q) from zero. The paper averages |H| (q = 1); least squares
sees the mean of its square (q = 2).
"""

import functools
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

NODES = 256
"""Window lengths in a mean by quadrature: two to a lobe of the gain where there are 128 lobes, and
so far out a smooth weight lets next to nothing through."""
SLOWEST = 5e-3
"""Periods to the longest window below which a motion is as good as constant."""

Gain = Callable[
    [Float[np.ndarray, " frequencies"], Float[np.ndarray, " lengths"]],
    Float[np.ndarray, "frequencies lengths"],
]


@functools.cache
def _nodes() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on -1 to 1; finding them takes longer than using them."""
    return np.polynomial.legendre.leggauss(NODES)


def mean_over_lengths(
    gain: Gain,
    frequency: Float[np.ndarray, " frequencies"],
    between: tuple[float, float],
    power: int,
) -> Float[np.ndarray, " frequencies"]:
    """Mean of a gain's power over lengths from a uniform law, by Gauss and Legendre."""
    alpha, beta = between
    nodes, weights = _nodes()
    total = np.zeros_like(frequency)
    # One length at a time: at all of them the spectra of a long record would make a large table.
    for node, weight in zip(nodes, weights):
        length = 0.5 * (alpha + beta + node * (beta - alpha))
        total += 0.5 * weight * gain(frequency, np.array([length]))[:, 0] ** power
    return total


def difference_gain(
    frequency: Float[np.ndarray, " frequencies"], length: Float[np.ndarray, " lengths"], order: int
) -> Float[np.ndarray, "frequencies lengths"]:
    """|H| of a difference of the order s, 1 for the boxcar and 2 for the hat.

    The weight is s boxcars of length T / s, folded: the gain is the power s of the gain of one.
    """
    part = length[None, :] / order
    return np.abs(part * np.sinc(frequency[:, None] * part)) ** order


def mean_difference_gain(
    frequency: Float[np.ndarray, " frequencies"],
    between: tuple[float, float],
    order: int,
    power: int,
) -> Float[np.ndarray, " frequencies"]:
    """Mean of |2 sin(w T / (2 s)) / w|^(s power), with s the order of the difference."""
    exponent = order * power
    # As good as at rest, and the difference of the primitives keeps its digits.
    omega = 2 * np.pi * np.maximum(frequency, SLOWEST / between[1])
    low, high = (omega * length / (2 * order) for length in between)
    mean = (_sine_primitive(high, exponent) - _sine_primitive(low, exponent)) / (high - low)
    return (2 / omega) ** exponent * mean


def _sine_primitive(x: Float[np.ndarray, " n"], exponent: int) -> Float[np.ndarray, " n"]:
    """Integral of |sin|^exponent from zero to x, for the exponents 1, 2 and 4."""
    if exponent == 1:
        return 2 * np.floor(x / np.pi) + 1 - np.cos(x % np.pi)
    if exponent == 2:
        return x / 2 - np.sin(2 * x) / 4
    return 3 * x / 8 - np.sin(2 * x) / 4 + np.sin(4 * x) / 32


def fourier_size(
    weight: Callable[[Array, Array], Array],
    frequency: Float[np.ndarray, " frequencies"],
    length: Float[np.ndarray, " lengths"],
) -> Float[np.ndarray, "frequencies lengths"]:
    """|H| of a smooth weight phi(tau, T), tau from -1 to 1, by Gauss and Legendre.

    |H| = T / 2 |integral_{-1}^{1} phi exp(i z tau) dtau| with z = w T / 2. n nodes integrate
    polynomials of degree 2 n - 1, and exp(i z tau) is one of degree little more than z but for
    rounding, so n nodes serve up to z = n. What a smooth weight lets through beyond is taken to be
    zero.
    """
    nodes, weights = _nodes()
    found = np.zeros((frequency.size, length.size))
    for place, seconds in enumerate(length):
        phi = weights * np.asarray(weight(jnp.asarray(nodes), jnp.asarray(seconds)))
        z = np.pi * frequency * seconds
        seen = z < NODES
        phase = np.outer(z[seen], nodes)
        size = np.hypot(np.cos(phase) @ phi, np.sin(phase) @ phi)
        found[seen, place] = 0.5 * seconds * size
    return found

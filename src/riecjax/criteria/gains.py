"""Gains of windows: how much of each frequency one window, or a range of lengths, lets through.

A window of length T passes an oscillation of frequency f with a gain |H|, the size of its weight's
Fourier integral: for the boxcar |2 sin(w T / 2) / w|, eq. (13), blind at multiples of 1 / T. The
paper averages the gain over T; least squares sees the mean of its square.
"""

import math
from collections.abc import Callable

import numpy as np
import scipy.special
from jaxtyping import Float

NODES = 256
"""Window lengths in a mean by quadrature: two to a lobe of the gain where there are 128 lobes, and
so far out a smooth weight lets next to nothing through."""
SLOWEST = 5e-3
"""Periods to the longest window below which a motion is as good as constant."""

Gain = Callable[
    [Float[np.ndarray, " frequencies"], Float[np.ndarray, " lengths"]],
    Float[np.ndarray, "frequencies lengths"],
]


def mean_over_lengths(
    gain: Gain,
    frequency: Float[np.ndarray, " frequencies"],
    between: tuple[float, float],
    power: int,
) -> Float[np.ndarray, " frequencies"]:
    """Mean of a gain's power over lengths from a uniform law, by Gauss and Legendre."""
    alpha, beta = between
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
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


def bump_gain(
    frequency: Float[np.ndarray, " frequencies"], length: Float[np.ndarray, " lengths"], p: int
) -> Float[np.ndarray, "frequencies lengths"]:
    """|H| of (1 - tau^2)^p, by Poisson's integral for Bessel's functions."""
    z = np.pi * (frequency[:, None] * length[None, :])
    order = p + 0.5
    swings = np.maximum(z, 1e-3)
    factor = math.sqrt(math.pi) * math.gamma(p + 1) * (2 / swings) ** order
    at_rest = math.sqrt(math.pi) * math.gamma(p + 1) / math.gamma(p + 1.5)
    # Below a thousandth of a radian the transform is what it is at rest, to 1e-7.
    transform = np.where(z > 1e-3, factor * scipy.special.jv(order, swings), at_rest)
    return 0.5 * length[None, :] * np.abs(transform)

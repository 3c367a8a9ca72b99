"""How much of each frequency a law of windows lets into an integral: eq. (13) and Fig. 3.

A window of length T passes a frequency with the gain |2 sin(w T / 2) / w| and is blind at
multiples of 1 / T. The paper averages the gain over T; least squares sees the mean of its square.
"""

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
import scipy.special
from jaxtyping import Float

from riecjax.criteria.bump import Bump
from riecjax.criteria.test_functions import AbstractTestFunction, Boxcar, Hat
from riecjax.errors import ModelError

NODES = 256
"""Window lengths in an average over bumps, whose gain falls too fast to need more."""
SLOWEST = 5e-3
"""Periods to the longest window below which a motion is as good as constant."""


def window_gain(
    frequency: Float[np.ndarray, " frequencies"],
    length: Float[np.ndarray, " lengths"],
    test_function: AbstractTestFunction,
) -> Float[np.ndarray, "frequencies lengths"]:
    """|H| of windows: size of the weighted integral of a unit oscillation.

    In seconds for the boxcar (eq. 13), T |sinc(f T)|, and for bumps; in s^2 for the hat, whose
    slope is 1, so that its gain is the square of that of a boxcar half as long.

    **Arguments:** `frequency` in hertz, `length` of the whole window in seconds.

    **Raises:** `ModelError` for another test function.
    """
    swings, whole = frequency[:, None] * length[None, :], length[None, :]
    if isinstance(test_function, Boxcar):
        return whole * np.abs(np.sinc(swings))
    if isinstance(test_function, Hat):
        return (0.5 * whole * np.sinc(0.5 * swings)) ** 2
    if isinstance(test_function, Bump):
        return 0.5 * whole * np.abs(_bump(test_function.p)(np.pi * swings))
    name = type(test_function).__name__
    raise ModelError(f"the gain of windows is known for Boxcar, Hat and Bump, not for {name}.")


def expected_gain(
    frequency: Float[np.ndarray, " frequencies"],
    alpha: float,
    beta: float,
    test_function: AbstractTestFunction,
    *,
    power: Literal[1, 2] = 1,
) -> Float[np.ndarray, " frequencies"]:
    """Mean of |H|^power over T ~ U(alpha, beta), eq. (14).

    `power=1` is what Fig. 3 draws; `power=2` is what least squares sees: times the density of an
    error, and integrated, it is the mean square of the windows' errors.

    **Arguments:** `frequency` in hertz; `alpha`, `beta` in seconds.

    **Raises:** as [`window_gain`][].
    """
    if isinstance(test_function, Boxcar | Hat):
        return _closed_form(frequency, (alpha, beta), test_function.smoothness, power)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    total = np.zeros_like(frequency)
    for node, weight in zip(nodes, weights):
        length = 0.5 * (alpha + beta + node * (beta - alpha))
        gain = window_gain(frequency, np.array([length]), test_function)[:, 0]
        total += 0.5 * weight * gain**power
    return total


def _closed_form(
    frequency: Float[np.ndarray, " frequencies"],
    between: tuple[float, float],
    smoothness: int,
    power: int,
) -> Float[np.ndarray, " frequencies"]:
    """Mean of |2 sin(w T / (2 s)) / w|^(s power), with s = 1 for the boxcar and 2 for the hat."""
    exponent = smoothness * power
    # As good as at rest, and the difference of the primitives keeps its digits.
    omega = 2 * np.pi * np.maximum(frequency, SLOWEST / between[1])
    low, high = (omega * length / (2 * smoothness) for length in between)
    mean = (_sine_primitive(high, exponent) - _sine_primitive(low, exponent)) / (high - low)
    return (2 / omega) ** exponent * mean


def _sine_primitive(x: Float[np.ndarray, " n"], exponent: int) -> Float[np.ndarray, " n"]:
    """Integral of |sin|^exponent from zero to x, for the exponents 1, 2 and 4."""
    if exponent == 1:
        return 2 * np.floor(x / np.pi) + 1 - np.cos(x % np.pi)
    if exponent == 2:
        return x / 2 - np.sin(2 * x) / 4
    return 3 * x / 8 - np.sin(2 * x) / 4 + np.sin(4 * x) / 32


def _bump(p: int) -> Callable[[np.ndarray], np.ndarray]:
    """Integral of (1 - tau^2)^p cos(z tau) from -1 to 1, by Poisson's for Bessel's functions."""
    order = p + 0.5
    at_rest = math.sqrt(math.pi) * math.gamma(p + 1) / math.gamma(p + 1.5)

    def transform(z: np.ndarray) -> np.ndarray:
        swings = np.maximum(z, 1e-3)
        factor = math.sqrt(math.pi) * math.gamma(p + 1) * (2 / swings) ** order
        # Below a thousandth of a radian the transform is what it is at rest, to 1e-7.
        return np.where(z > 1e-3, factor * scipy.special.jv(order, swings), at_rest)

    return transform

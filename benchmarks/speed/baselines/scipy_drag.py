"""The oscillator with drag by SciPy: `least_squares` over `solve_ivp`, initial state free too."""

from collections.abc import Callable

import numpy as np
import scipy.integrate
import scipy.optimize
from jaxtyping import Float

NAMES = ("m", "r", "r2", "k", "x0", "v0")
START = (1.0, 1.0, 1.0, 10.0, 0.0, 0.0)
SIZE = (1.0, 1.0, 1.0, 10.0, 0.1, 0.1)
"""Typical size of each of them."""
DIFFERENCE = 1e-4
"""Relative step of derivatives: SciPy's own lies below what noise the solver has left."""


def first_order_hold(values: Float[np.ndarray, " n"], rate: float) -> Callable[[float], float]:
    """Straight lines between samples; the interval is found by its number, not by a search."""
    # Lists of Python's own numbers are read faster than single elements of arrays.
    levels = values.tolist()
    rises = np.diff(values, append=values[-1]).tolist()

    def value(time: float) -> float:
        position = time * rate
        below = int(position)
        return levels[below] + (position - below) * rises[below]

    return value


def motion(
    parameters: Float[np.ndarray, " 6"], t: Float[np.ndarray, " n"], u: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "2 n"]:
    """Position and velocity at the samples of the force."""
    m, r, r2, k, x0, v0 = (float(value) for value in parameters)
    step = t[1] - t[0]
    force = first_order_hold(u, 1 / step)

    def derivative(time: float, state: np.ndarray) -> list[float]:
        x, v = state.tolist()
        return [v, (force(time) - (r + r2 * abs(v)) * v - k * x) / m]

    # The longest step is what rules, not the tolerance: steps that a tolerance chooses jump from
    # one parameter value to the next, and with that noise searches stop early.
    run = scipy.integrate.solve_ivp(
        derivative, (t[0], t[-1]), [x0, v0], t_eval=t, rtol=1e-4, atol=1e-6, max_step=step
    )
    return run.y


def residual(
    parameters: Float[np.ndarray, " 6"],
    t: Float[np.ndarray, " n"],
    x: Float[np.ndarray, " n"],
    v: Float[np.ndarray, " n"],
    u: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " m"]:
    """Position's and velocity's errors, each as a share of its own deviation."""
    position, velocity = motion(parameters, t, u)
    return np.concatenate([(position - x) / x.std(), (velocity - v) / v.std()])


def fit(
    t: Float[np.ndarray, " n"],
    x: Float[np.ndarray, " n"],
    v: Float[np.ndarray, " n"],
    u: Float[np.ndarray, " n"],
) -> dict[str, float]:
    """m, r, r2, k and the initial state."""
    found = scipy.optimize.least_squares(
        residual, START, diff_step=DIFFERENCE, x_scale=SIZE, args=(t, x, v, u)
    )
    return dict(zip(NAMES, found.x.tolist()))

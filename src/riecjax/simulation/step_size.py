"""How many steps a fixed-step method needs between samples."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from riecjax.leaves import Leaf
from riecjax.simulation.system import AbstractSystem

ANGLE = 0.15
"""Step times the largest eigenvalue, at most: the classical Runge-Kutta method then errs by
ANGLE^4 / 120, 4e-6, for each radian of the fastest motion."""
POINTS = 256
"""Points along a motion at which the system is looked at: a spring that hardens is fastest where it
is deflected most."""
MOST_STEPS = 64
"""Steps between samples that are taken without being asked for."""


def suitable_steps(
    system: AbstractSystem,
    states: Float[Array, "n states"] | Float[np.ndarray, "n states"],
    inputs: Float[Array, "n inputs"] | Float[np.ndarray, "n inputs"],
    time_step: float,
) -> int:
    """Steps between samples that resolve the system's fastest motion along these points.

    Looked at are the eigenvalues of the linearised system, at 256 of the points. What these do not
    tell, such as kinks or a sharp response to an input, shows when the steps are halved. Not under
    jit. 64 at most: a system that would need more is stiff, and better simulated by
    [`Adaptive`][] with an implicit solver.
    """
    chosen = spread_points(len(states))
    slopes = np.asarray(_slopes(system, np.asarray(states)[chosen], np.asarray(inputs)[chosen]))
    finite = slopes[np.isfinite(slopes).all(axis=(1, 2))]
    if not finite.size:
        return 1
    fastest = float(np.max(np.abs(np.linalg.eigvals(finite))))
    return int(np.clip(np.ceil(time_step * fastest / ANGLE), 1, MOST_STEPS))


def spread_points(count: int) -> Int[np.ndarray, " points"]:
    """Indices of the points to look at, of so many."""
    return np.unique(np.linspace(0, count - 1, min(POINTS, count)).astype(int))


@eqx.filter_jit
def _slopes(system: AbstractSystem, states: Leaf, inputs: Leaf) -> Array:
    return jax.vmap(jax.jacfwd(system.derivative))(states, inputs)

"""How many steps a fixed-step method needs between samples."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from riecjax.leaves import Leaf
from riecjax.simulation.system import AbstractSystem

ANGLE = 0.15
"""Step times the largest eigenvalue, at most: the classical Runge-Kutta method then errs by
ANGLE^4 / 120, 4e-6, for each radian of the fastest motion."""
POINTS = 8
"""Points at which the system is looked at."""
MOST_STEPS = 64


def suitable_steps(
    system: AbstractSystem,
    states: Float[Array, "n states"] | Float[np.ndarray, "n states"],
    inputs: Float[Array, "n inputs"] | Float[np.ndarray, "n inputs"],
    time_step: float,
) -> int:
    """Steps between samples that resolve the system's fastest motion at some of these points.

    Not under jit. 64 at most: a system that would need more is stiff, and better simulated by
    [`Adaptive`][] with an implicit solver.
    """
    chosen = np.unique(np.linspace(0, len(states) - 1, min(POINTS, len(states))).astype(int))
    slopes = np.asarray(_slopes(system, states[chosen], inputs[chosen]))
    finite = slopes[np.isfinite(slopes).all(axis=(1, 2))]
    if not finite.size:
        return 1
    fastest = float(np.max(np.abs(np.linalg.eigvals(finite))))
    return int(np.clip(np.ceil(time_step * fastest / ANGLE), 1, MOST_STEPS))


@eqx.filter_jit
def _slopes(system: AbstractSystem, states: Leaf, inputs: Leaf) -> Array:
    return jax.vmap(jax.jacfwd(system.derivative))(states, inputs)

"""A system linearised at a point: its modes, and the steps that they ask for.

How many steps? Near a point the motion is a sum of e^(mu t), mu the eigenvalues of the Jacobian A.
One step of length h of the classical Runge-Kutta method multiplies each by

    R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24,    z = h mu,    e^z - R(z) = z^5/120 + ...,

so that each radian |z| of the motion costs a relative error of |z|^4 / 120. Bounding the largest
|z| by `ANGLE` bounds the error of the fastest motion, which is far within the method's stability
(|z| < 2.8 on the imaginary axis). A sample of H seconds takes H max|mu| / ANGLE steps.

The eigenvalues are those along the recorded motion, not those at rest: the Jacobian of a spring
that hardens grows with its deflection. They know nothing of how fast inputs change a derivative, of
kinks, or of transients longer than their parts (A that is far from normal); halving the steps does.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from riecjax.compilation import kept_jit
from riecjax.leaves import Leaf
from riecjax.simulation.system import AbstractSystem

ANGLE = 0.15
"""Step times the largest eigenvalue, at most: an error of 4e-6 for each radian of that motion."""
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

    From the eigenvalues of the linearised system at 256 of the points. Not under jit. 64 at most: a
    system that would need more is stiff, and better simulated by [`Adaptive`][] with an implicit
    solver.
    """
    chosen = spread_points(len(states))
    slopes = jacobians(system, np.asarray(states)[chosen], np.asarray(inputs)[chosen])
    finite = slopes[np.isfinite(slopes).all(axis=(1, 2))]
    if not finite.size:
        return 1
    fastest = float(np.max(np.abs(np.linalg.eigvals(finite))))
    return int(np.clip(np.ceil(time_step * fastest / ANGLE), 1, MOST_STEPS))


def spread_points(count: int) -> Int[np.ndarray, " points"]:
    """Indices of at most 256 points, spread evenly over so many."""
    return np.unique(np.linspace(0, count - 1, min(POINTS, count)).astype(int))


def jacobians(
    system: AbstractSystem, states: Float[np.ndarray, "n states"], inputs: Float[np.ndarray, "n i"]
) -> Float[np.ndarray, "n states states"]:
    """Derivatives of the state's derivative by the state, at points. Not under jit."""
    return np.asarray(_slopes(system, states, inputs))


@kept_jit
def _slopes(system: AbstractSystem, states: Leaf, inputs: Leaf) -> Array:
    return jax.vmap(jax.jacfwd(system.derivative))(states, inputs)


@kept_jit
def linearise(
    system: AbstractSystem,
    state: Float[Array, " states"] | None = None,
    inputs: Float[Array, " inputs"] | None = None,
) -> tuple[Float[Array, "states states"], Float[Array, "states inputs"]]:
    """Jacobians (A, B) of the state derivative, at rest unless a point is given."""
    x = jnp.zeros(len(system.states)) if state is None else state
    u = jnp.zeros(len(system.inputs)) if inputs is None else inputs
    return jax.jacfwd(system.derivative, argnums=(0, 1))(x, u)


class Mode(NamedTuple):
    """One mode of a linear system: a real eigenvalue, or a pair by its upper half."""

    eigenvalue: complex
    """In rad/s; the imaginary part is not negative."""
    frequency: float | None
    """Undamped natural frequency |eigenvalue| / 2 pi in Hz; None for a real eigenvalue."""
    damping_ratio: float | None
    """-Re / |eigenvalue|; None for a real eigenvalue."""
    shape: Complex[np.ndarray, " states"]
    """Eigenvector in the order of the states, of unit length."""


def modes(matrix: Float[Array, "states states"]) -> list[Mode]:
    """Modes of x' = matrix x, fastest decay first, without the rigid ones at zero."""
    found = np.linalg.eig(np.asarray(matrix))
    values, vectors = found.eigenvalues.astype(complex), found.eigenvectors
    floor = 1e-9 * np.max(np.abs(values))
    order = np.argsort(np.real(values))
    pairs = [(complex(values[i]), vectors[:, i]) for i in order]
    return [_mode(v, shape) for v, shape in pairs if v.imag >= 0 and abs(v) > floor]


def _mode(value: complex, shape: np.ndarray) -> Mode:
    if value.imag == 0:
        return Mode(complex(value), None, None, shape)
    size = abs(value)
    return Mode(complex(value), size / (2 * np.pi), -value.real / size, shape)

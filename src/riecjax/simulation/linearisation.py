"""A system linearised at a point, and its modes."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from riecjax.simulation.system import AbstractSystem


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

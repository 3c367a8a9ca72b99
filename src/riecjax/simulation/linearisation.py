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

How fast small differences grow along a recorded motion, and the windows that this asks for.

A difference d of two motions obeys d' = A(t) d, A the Jacobian along the motion: over a window it
is multiplied by the product of e^(A dt) over its samples. Where the motion is unstable (a pendulum
held upright by its controller) the product grows without limit, and a simulation of the whole
recording shows little but its own first error, however right the model. Over windows in which
differences grow by no more than e^2.5 it shows the model.

Products over 1, 2, 4, ... samples are made by multiplying neighbours, in units of how far each
state moves. That asks the recorded motion itself: a pendulum that swings past its top is unstable
for moments, and no difference grows for long.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Complex, Float, Int

from riecjax.leaves import Leaf
from riecjax.records.record import Record
from riecjax.simulation.system import (
    AbstractSystem,
    Inputs,
    State,
    input_levels,
    measured_states,
)

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
    rates = np.abs(_eigenvalues(system, np.asarray(states), np.asarray(inputs)))
    fastest = np.max(rates, initial=0.0)
    return int(np.clip(np.ceil(time_step * fastest / ANGLE), 1, MOST_STEPS))


def _eigenvalues(
    system: AbstractSystem, states: np.ndarray, inputs: np.ndarray
) -> Complex[np.ndarray, "points states"]:
    """Of the linearised system at some of these points, of those where it is finite."""
    chosen = spread_points(len(states))
    slopes = np.asarray(jacobians(system, states[chosen], inputs[chosen]))
    return np.linalg.eigvals(slopes[np.isfinite(slopes).all(axis=(1, 2))])


def spread_points(count: int) -> Int[np.ndarray, " points"]:
    """Indices of at most 256 points, spread evenly over so many."""
    return np.unique(np.linspace(0, count - 1, min(POINTS, count)).astype(int))


@eqx.filter_jit
def jacobians(
    system: AbstractSystem, states: Leaf, inputs: Leaf
) -> Float[Array, "n states states"]:
    """Derivatives of the state's derivative by the state, at points."""
    return jax.vmap(jax.jacfwd(system.derivative))(states, inputs)


@eqx.filter_jit
def linearise(
    system: AbstractSystem, state: State | None = None, inputs: Inputs | None = None
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
    pairs = [(complex(values[i]), vectors[:, i]) for i in np.argsort(np.real(values))]
    return [
        Mode(v, abs(v) / (2 * np.pi), -v.real / abs(v), shape)
        if v.imag
        else Mode(v, None, None, shape)
        for v, shape in pairs
        if v.imag >= 0 and abs(v) > floor
    ]


FOLDS = 2.5
"""Times of growth by e that a window may last."""
MOST_GROWTH = 1e3
"""Growth of a difference up to which a recording is simulated whole."""
FEWEST_SAMPLES = 20
"""Samples that a window holds at least."""
STEEPEST = 300.0
"""Logarithm of the growth within a step that is computed at most: of two, numbers have room."""
MOST_POINTS = 2**14
"""Points of a long recording at which the Jacobian is formed."""


def growth_horizon(system: AbstractSystem, record: Record) -> float | None:
    """Seconds in which a system's small differences grow by e^2.5 along a recording; not under jit.

    **Returns:** `None` where they stay within a thousandfold, or where no Jacobian is finite.
    """
    states = np.asarray(measured_states(system, record))
    inputs = np.asarray(input_levels(system, record))
    duration = len(states) * float(record.time_step)
    rates = np.real(_eigenvalues(system, states, inputs))
    if not rates.size or np.max(rates) * duration < np.log(MOST_GROWTH):
        return None
    stride = -(-len(states) // MOST_POINTS)
    spread = np.std(states, axis=0)
    spread = np.where(spread > 0, spread, np.max(spread, initial=0.0) or 1.0)
    slopes = np.asarray(jacobians(system, states[::stride], inputs[::stride]))
    slopes = np.where(np.isfinite(slopes), slopes, 0.0) * (spread[None, :] / spread[:, None])
    step = stride * float(record.time_step)
    sizes = np.linalg.norm(slopes * step, 2, axis=(1, 2))
    slopes = slopes * np.minimum(1.0, STEEPEST / np.maximum(sizes, STEEPEST))[:, None, None]
    products = scipy.linalg.expm(slopes * step)
    # Filled up to a power of two, so that the last product is that of all samples.
    further = (1 << (len(products) - 1).bit_length()) - len(products)
    still = np.broadcast_to(np.eye(len(spread)), (further, *products.shape[1:]))
    products, scale = np.concatenate([products, still]), np.zeros(len(products) + further)
    # The logarithm of the largest growth over any block of 1, 2, 4, ... samples.
    logs = []
    while True:
        # The product's size is kept apart, so that no power of it overflows.
        size = np.linalg.norm(products, 2, axis=(1, 2))
        size = np.where(size > 0, size, 1e-300)
        products, scale = products / size[:, None, None], scale + np.log(size)
        logs.append(float(np.max(scale)))
        if len(products) == 1:
            break
        products, scale = products[1::2] @ products[::2], scale[1::2] + scale[::2]
    lengths, logs = 2.0 ** np.arange(len(logs)), np.array(logs)
    if np.max(logs) <= np.log(MOST_GROWTH):
        return None
    first = int(np.argmax(logs > FOLDS))
    below = first - 1 if first else 0
    share = np.interp(FOLDS, logs[[below, first]], lengths[[below, first]])
    return max(float(share) * stride, FEWEST_SAMPLES) * float(record.time_step)

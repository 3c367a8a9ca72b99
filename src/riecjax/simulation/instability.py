"""How fast small differences grow along a recorded motion, and the windows that this asks for.

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

import numpy as np
import scipy.linalg
from jaxtyping import Float

from riecjax.records.record import Record
from riecjax.simulation.linearisation import jacobians, spread_points
from riecjax.simulation.system import AbstractSystem, measured_states

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


class Growth(NamedTuple):
    """How differences grow: by the `factor` at most, by e^2.5 within the `horizon` in seconds."""

    factor: float
    horizon: float


def growth(system: AbstractSystem, record: Record) -> Growth | None:
    """How a system's small differences grow along a recording; not under jit.

    **Returns:** `None` where they stay within a thousandfold, or where no Jacobian is finite.
    """
    states = np.asarray(measured_states(system, record))
    levels = [np.asarray(record[name]) for name in system.input_names]
    inputs = np.stack(levels, axis=-1) if levels else np.zeros((len(states), 0))
    duration = len(states) * float(record.time_step)
    few = spread_points(len(states))
    rates = _growth_rates(jacobians(system, states[few], inputs[few]))
    if not rates.size or np.max(rates) * duration < np.log(MOST_GROWTH):
        return None
    stride = -(-len(states) // MOST_POINTS)
    spread = np.std(states, axis=0)
    spread = np.where(spread > 0, spread, np.max(spread, initial=0.0) or 1.0)
    slopes = jacobians(system, states[::stride], inputs[::stride])
    slopes = np.where(np.isfinite(slopes), slopes, 0.0) * (spread[None, :] / spread[:, None])
    step = stride * float(record.time_step)
    sizes = np.linalg.norm(slopes * step, 2, axis=(1, 2))
    slopes = slopes * np.minimum(1.0, STEEPEST / np.maximum(sizes, STEEPEST))[:, None, None]
    lengths, logs = _by_length(scipy.linalg.expm(slopes * step))
    if np.max(logs) <= np.log(MOST_GROWTH):
        return None
    first = int(np.argmax(logs > FOLDS))
    below = first - 1 if first else 0
    share = np.interp(FOLDS, logs[[below, first]], lengths[[below, first]])
    samples = max(float(share) * stride, FEWEST_SAMPLES)
    return Growth(float(np.exp(min(np.max(logs), 700.0))), samples * float(record.time_step))


def _growth_rates(slopes: Float[np.ndarray, "n s s"]) -> Float[np.ndarray, " m"]:
    finite = slopes[np.isfinite(slopes).all(axis=(1, 2))]
    return np.max(np.real(np.linalg.eigvals(finite)), axis=1) if len(finite) else np.zeros(0)


def _by_length(
    products: Float[np.ndarray, "n s s"],
) -> tuple[Float[np.ndarray, " levels"], Float[np.ndarray, " levels"]]:
    """Lengths in samples, and the logarithm of the largest growth over any block so long."""
    lengths, logs = [1.0], [float(np.max(np.log(np.linalg.norm(products, 2, axis=(1, 2)))))]
    scale = np.zeros(len(products))
    while len(products) > 1:
        even, rest = len(products) // 2 * 2, len(products) % 2
        # What is left over waits, so that the last product is that of all samples.
        waiting, waits = products[-1:][:rest], scale[-1:][:rest]
        products = np.concatenate([products[1:even:2] @ products[0:even:2], waiting])
        scale = np.concatenate([scale[1:even:2] + scale[0:even:2], waits])
        # The product's size is kept apart, so that no power of it overflows.
        size = np.linalg.norm(products, 2, axis=(1, 2))
        size = np.where(size > 0, size, 1e-300)
        products, scale = products / size[:, None, None], scale + np.log(size)
        lengths.append(2 * lengths[-1])
        logs.append(float(np.max(scale)))
    return np.array(lengths), np.array(logs)

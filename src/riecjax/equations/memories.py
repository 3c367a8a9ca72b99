"""Laws with a memory: hysteresis, whose force depends on the way that the motion came.

A state z, from -1 to 1, goes with the displacement: after a reversal it takes about a `width` of it
to turn round. Equations read z like a signal; recordings are given it from their velocity, and
simulations its rate.

**Dahl** (1968): z' = (v - |v| z) / width. Along a stroke in the direction s that is

    z = s + (z_0 - s) exp(-|dx| / width),

which holds over any step within which the motion does not turn, however long.

**Bouc and Wen** (1976; n = 1, beta = gamma = 1/2): z' = (v - (|v| z + v |z|) / 2) / width. Elastic
on the way back to zero, z = z_0 + dx / width, and as Dahl's from there on.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.errors import ModelError
from riecjax.records.noise import Noise
from riecjax.records.record import Record, samples_with_nan
from riecjax.records.signals import Signals


@dataclass(frozen=True)
class Memory:
    """A state that recordings lack, from -1 to 1; as an expression, its time derivative.

    **Arguments:** `state`, a name for it as a signal; `velocity`, the signal that drives it;
    `width`, in that signal's unit times seconds.

    **Raises:** `ModelError` unless the width is positive.
    """

    state: str
    velocity: str
    width: float

    def __post_init__(self):
        if not self.width > 0:
            raise ModelError(f"a width must be positive; got {self.width:g}.")

    def __call__(self, signals: Signals) -> Array:
        """The state's time derivative."""
        raise NotImplementedError

    def after(self, state: float, stroke: float) -> float:
        """The state after a stroke, in terms of the width."""
        raise NotImplementedError

    def _both(self, signals: Signals) -> tuple[Array, Array]:
        return signals[self.velocity], signals[self.state]


@dataclass(frozen=True)
class Dahl(Memory):
    """Dahl's friction: reverses within a width of displacement, elastic at first.

    Arguments and errors as of any [`Memory`][riecjax.equations.memories.Memory].
    """

    def __call__(self, signals: Signals) -> Array:
        """z' = (v - |v| z) / width."""
        v, z = self._both(signals)
        return (v - jnp.abs(v) * z) / self.width

    def after(self, state: float, stroke: float) -> float:
        """s + (z - s) exp(-|stroke|), s its direction."""
        end = math.copysign(1.0, stroke)
        return end + (state - end) * math.exp(-abs(stroke))


@dataclass(frozen=True)
class BoucWen(Memory):
    """Bouc and Wen's hysteresis: elastic on its way back to zero, then yielding.

    Arguments and errors as of any [`Memory`][riecjax.equations.memories.Memory].
    """

    def __call__(self, signals: Signals) -> Array:
        """z' = (v - (|v| z + v |z|) / 2) / width."""
        v, z = self._both(signals)
        return (v - 0.5 * (jnp.abs(v) * z + v * jnp.abs(z))) / self.width

    def after(self, state: float, stroke: float) -> float:
        """Straight back to zero, and as Dahl's from there."""
        end, left = math.copysign(1.0, stroke), abs(stroke)
        if state * end < 0:
            if left <= abs(state):
                return state + stroke
            left, state = left - abs(state), 0.0
        return end + (state - end) * math.exp(-left)


def course(memory: Memory, record: Record) -> Float[np.ndarray, " n"]:
    """The state along a record, from zero on; it stays where the velocity is missing."""
    v = np.nan_to_num(samples_with_nan(record, memory.velocity))
    strokes = 0.5 * (v[1:] + v[:-1]) * (float(record.time_step) / memory.width)
    found, state = [0.0], 0.0
    for stroke in strokes.tolist():
        state = memory.after(state, stroke)
        found.append(state)
    return np.array(found)


def with_memories(record: Record, memories: Iterable[Memory]) -> Record:
    """The record with the states that it lacks, as signals without noise of their own.

    What its velocity's noise does to a state is left out: it is summed over a width.

    **Raises:** `DataError` for a velocity that the record lacks.
    """
    missing = {one.state: one for one in memories if one.state not in record.arrays}
    if not missing:
        return record
    made: dict[str, Any] = {name: course(one, record) for name, one in missing.items()}
    return record.with_signals(made, noise=Noise({name: {} for name in made}))

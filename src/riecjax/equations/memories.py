"""States that recordings lack: of hysteresis, whose force depends on the way that the motion came.

A state z, from -1 to 1, goes with the displacement: after a reversal it takes about a `width` of it
to turn round. Equations read z like a signal; recordings are given it from their velocity, and
simulations its rate.

**Dahl** (1968): z' = (v - |v| z) / width. Along a stroke in the direction s that is

    z = s + (z_0 - s) exp(-|dx| / width),

which holds over any step within which the motion does not turn, however long.

**Bouc and Wen** (1976; n = 1, beta = gamma = 1/2): z' = (v - (|v| z + v |z|) / 2) / width. Elastic
on the way back to zero, z = z_0 + dx / width, and as Dahl's from there on.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.errors import ModelError
from riecjax.records.record import Record, Signals
from riecjax.records.signal import Signal, SignalNoise

TURNS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Widths within which hysteresis turns round, in strokes."""


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

    def after(self, state: np.ndarray | float, stroke: np.ndarray | float) -> np.ndarray:
        """The state after a stroke, in terms of the width."""
        raise NotImplementedError

    def course(self, record: Record) -> Float[np.ndarray, " n"]:
        """The state along a record, from zero on; it stays where the velocity has gaps."""
        pieces = pieces_of_way(self.velocity, record) / self.width
        moving = np.flatnonzero(pieces)
        if not moving.size:
            return np.zeros(pieces.size + 1)
        # Of pieces in one direction only the sum counts: a step is a stroke, not a sample.
        turns = np.flatnonzero(np.diff(np.sign(pieces[moving])))
        begins = np.concatenate([[0], moving[turns + 1]])
        way, lengths = np.cumsum(pieces), np.diff([*begins, pieces.size])
        starts, state = np.zeros(begins.size), np.zeros(())
        for i, stroke in enumerate(np.add.reduceat(pieces, begins)):
            starts[i] = state
            state = self.after(state, stroke)
        along = way - np.repeat(way[begins] - pieces[begins], lengths)
        held = np.repeat(starts, lengths)
        return np.concatenate([[0.0], np.where(along == 0, held, self.after(held, along))])


@dataclass(frozen=True)
class Dahl(Memory):
    """Dahl's friction: reverses within a width of displacement, elastic at first.

    Arguments and errors as of any [`Memory`][riecjax.equations.memories.Memory].
    """

    def __call__(self, signals: Signals) -> Array:
        """z' = (v - |v| z) / width."""
        v, z = signals[self.velocity], signals[self.state]
        return (v - xp.abs(v) * z) / self.width

    def after(self, state: np.ndarray | float, stroke: np.ndarray | float) -> np.ndarray:
        """s + (z - s) exp(-|stroke|), s its direction."""
        end = np.sign(stroke)
        return end + (state - end) * np.exp(-np.abs(stroke))


@dataclass(frozen=True)
class BoucWen(Memory):
    """Bouc and Wen's hysteresis: elastic on its way back to zero, then yielding.

    Arguments and errors as of any [`Memory`][riecjax.equations.memories.Memory].
    """

    def __call__(self, signals: Signals) -> Array:
        """z' = (v - (|v| z + v |z|) / 2) / width."""
        v, z = signals[self.velocity], signals[self.state]
        return (v - 0.5 * (xp.abs(v) * z + v * xp.abs(z))) / self.width

    def after(self, state: np.ndarray | float, stroke: np.ndarray | float) -> np.ndarray:
        """Straight back to zero, and as Dahl's from there."""
        end, left = np.sign(stroke), np.abs(stroke)
        back = np.where(state * end < 0, np.minimum(np.abs(state), left), 0.0)
        moved = state + end * back
        return end + (moved - end) * np.exp(back - left)


@dataclass(frozen=True)
class Elapsed(Memory):
    """The time since the start, in terms of the width, 1 s by default: of what drifts.

    **Arguments:** `state`, a name for it as a signal.
    """

    velocity: str = ""
    width: float = 1.0

    def __call__(self, signals: Signals) -> Array:
        """z' = 1 / width."""
        return xp.full_like(signals[self.state], 1 / self.width)

    def course(self, record: Record) -> Float[np.ndarray, " n"]:
        """Time from the first sample on."""
        return np.arange(record.sample_count) * (float(record.time_step) / self.width)


def pieces_of_way(velocity: str, record: Record) -> Float[np.ndarray, " n-1"]:
    """What is covered from each sample to the next."""
    v = np.nan_to_num(record.signal(velocity).with_nan)
    return 0.5 * (v[1:] + v[:-1]) * float(record.time_step)


def usual_widths(velocity: str, records: Iterable[Record]) -> Float[np.ndarray, " widths"]:
    """Widths within which hysteresis may turn round: shares of a usual stroke."""
    squares = []
    for record in records:
        pieces = pieces_of_way(velocity, record)
        turns = np.flatnonzero(pieces[1:] * pieces[:-1] < 0) + 1
        squares.append(np.square(np.add.reduceat(pieces, np.concatenate([[0], turns]))))
    stroke = float(np.sqrt(np.mean(np.concatenate(squares))))
    return np.array(TURNS) * (stroke or 1.0)


def with_memories(record: Record, memories: Iterable[Memory]) -> Record:
    """The record with the states that it lacks, as signals without noise of their own.

    What its velocity's noise does to a state is left out: it is summed over a width.

    **Raises:** `DataError` for a velocity that the record lacks.
    """
    lacking = {one.state: one for one in memories if one.state not in record.arrays}
    if not lacking:
        return record
    return record.with_signals(
        {name: Signal(one.course(record), noise=SignalNoise()) for name, one in lacking.items()}
    )

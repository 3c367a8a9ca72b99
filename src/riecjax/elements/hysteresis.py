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
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.equations.element import Attached, Element, Told
from riecjax.equations.equation import Equation
from riecjax.errors import ModelError
from riecjax.records.record import Record, Signals
from riecjax.records.signal import Signal, SignalNoise

TURNS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Widths within which hysteresis turns round, in strokes."""


class Memory(Element):
    """A state that recordings lack, from -1 to 1; as an expression, its time derivative.

    **Arguments:** `state`, a name for it as a signal; `velocity`, the signal that drives it;
    `width`, in that signal's unit times seconds.

    **Raises:** `ModelError` unless the width is positive.
    """

    state: str = eqx.field(static=True)
    velocity: str = eqx.field(static=True)
    width: float = eqx.field(static=True)
    is_of_motion: ClassVar[bool] = True
    """Whether a velocity drives it."""

    def __check_init__(self):
        if not self.width > 0:
            raise ModelError(f"a width must be positive; got {self.width:g}.")

    @property
    def described(self) -> str:
        """`a state dahl_state of dx, within 0.01`."""
        return f"{self.words} {self.state}, within {self.width:g} of {self.velocity}"

    @classmethod
    def widths(cls, velocity: str, records: Iterable[Record]) -> Float[np.ndarray, " widths"]:
        """Widths within which hysteresis may turn round: shares of a usual stroke."""
        squares = []
        for record in records:
            pieces = pieces_of_way(velocity, record)
            turns = np.flatnonzero(pieces[1:] * pieces[:-1] < 0) + 1
            squares.append(np.square(np.add.reduceat(pieces, np.concatenate([[0], turns]))))
        stroke = float(np.sqrt(np.mean(np.concatenate(squares))))
        return np.array(TURNS) * (stroke or 1.0)

    @property
    def source(self) -> str:
        """As it is written after `import riecjax as rx`."""
        return super().source.replace("rx.", "rx.elements.")

    @property
    def place(self) -> str:
        """The velocity."""
        return self.velocity

    def as_cause(self, equation: str, at: tuple[float, ...], size: float, unit: str = "") -> Told:
        """That what is left runs in loops."""
        width = f"{self.width:.2g} {unit}".rstrip()
        return Told(
            "hysteresis",
            f"{equation}: what the model leaves runs in loops over {self.velocity}: hysteresis is "
            f"missing, a state that turns round within about {width} of displacement "
            f"({type(self).__name__})",
            "Find its law (riecjax discover).",
            step="Find the law of the hysteresis: riecjax discover",
        )

    def with_states(self, record: Record) -> Record:
        """The record with the state, unless it holds it, as a signal without noise of its own.

        What its velocity's noise does to a state is left out: it is summed over a width.

        **Raises:** `DataError` for a velocity that the record lacks.
        """
        if self.state in record.arrays:
            return record
        state = Signal(self.course(record), noise=SignalNoise())
        return record.with_signals({self.state: state})

    def attached(self, equations: tuple[Equation, ...]) -> Attached:
        """The equations, and the state's rate."""
        return Attached(equations, {self.state: self})

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


class Dahl(Memory):
    """Dahl's friction: reverses within a width of displacement, elastic at first.

    Arguments and errors as of any [`Memory`][riecjax.elements.Memory].
    """

    kind: ClassVar = "dahl"
    words: ClassVar = "hysteresis, as Dahl's friction"

    def __call__(self, signals: Signals) -> Array:
        """z' = (v - |v| z) / width."""
        v, z = signals[self.velocity], signals[self.state]
        return (v - xp.abs(v) * z) / self.width

    def after(self, state: np.ndarray | float, stroke: np.ndarray | float) -> np.ndarray:
        """s + (z - s) exp(-|stroke|), s its direction."""
        end = np.sign(stroke)
        return end + (state - end) * np.exp(-np.abs(stroke))


class BoucWen(Memory):
    """Bouc and Wen's hysteresis: elastic on its way back to zero, then yielding.

    Arguments and errors as of any [`Memory`][riecjax.elements.Memory].
    """

    kind: ClassVar = "bouc_wen"
    words: ClassVar = "hysteresis, as of Bouc and Wen"

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


class Elapsed(Memory):
    """The time since the start, in terms of the width, 1 s by default: of what drifts.

    **Arguments:** `state`, a name for it as a signal.
    """

    velocity: str = eqx.field(static=True, default="")
    width: float = eqx.field(static=True, default=1.0)
    kind: ClassVar = "drift"
    words: ClassVar = "force that drifts"
    is_of_motion: ClassVar = False

    @property
    def described(self) -> str:
        """`time as a signal drift_state`."""
        return f"time as a signal {self.state}"

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

"""Whether what a model leaves is the ringing of a mode on one of its bodies.

A mass m on a spring and a damper, carried by a body of acceleration a, pulls at it with m times its
own acceleration, which is a behind a filter of the second order:

    H(s) = (w^2 + 2 z w s) / (s^2 + 2 z w s + w^2)

with the mode's angular frequency w and damping ratio z. So the column of a mode is that of the
body's inertia, of the body's motion behind H, and its coefficient is the mode's mass: the element's
best shape is found over w and z, first on a grid, then closer and closer around the best.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.doubts.columns import Asked, Doubt, folds_of
from riecjax.equations.hidden_elements import HiddenMode, accelerated
from riecjax.equations.term import Term
from riecjax.records.record import Record

FREQUENCIES = 14
"""From half of the frequency that the longest windows are a period of, to half of what samples
tell, evenly on a logarithmic scale."""
DAMPING = (0.02, 0.1, 0.4)
"""Damping ratios that are tried first."""
CLOSER = 6
"""Times that the steps between shapes are halved."""
MOST_DAMPED = 0.9
"""Damping ratio of what still rings."""


@dataclass(frozen=True)
class Ringing:
    """A state that recordings lack: a signal behind a mode's filter.

    **Fields:** `state`, its name as a signal; `of`, the signal; `on` which body; frequency in
    `hertz`, and the ratio of `damping`.
    """

    state: str
    of: str
    on: str
    hertz: float
    damping: float

    def course(self, record: Record) -> Float[np.ndarray, " n"]:
        """The state along a record, from rest on."""
        samples = np.asarray(record.arrays[self.of], float)
        size = 2 * samples.size
        s = 2j * np.pi * np.fft.rfftfreq(size, float(record.time_step))
        w = 2 * np.pi * self.hertz
        turn = 2 * self.damping * w * s
        there = np.fft.rfft(samples - samples.mean(), size)
        return np.fft.irfft(there * (w**2 + turn) / (s**2 + turn + w**2), size)[: samples.size]


class Mode(NamedTuple):
    """A mode that may be left out: frequency in `hertz` and `damping` ratio; share of the target's
    energy that it gains; its `doubt`, which is `asked` of one stage."""

    hertz: float
    damping: float
    gained: float
    doubt: Doubt
    asked: Asked


def best_mode(asked: Asked, records: Sequence[Record]) -> Mode | None:
    """The mode of positive mass that gains most, of all bodies; `None` where there is none."""
    found, seen = [], set[str]()
    equations = [
        (stage, name, equation)
        for stage, (names, some) in enumerate(zip(asked.model.equation_names, asked.model.stages))
        for name, equation in zip(names, some, strict=True)
    ]
    for stage, name, equation in equations:
        # Later stages that hold a body know its mass from the first.
        for on in (on for on in accelerated(equation) if on not in seen):
            seen.add(on)
            term = HiddenMode(on).term_in(equation)
            if term is None or term.signal is None:
                continue
            signals = (str(term.signal), *term.measured)
            order = term.derivative - len(term.measured)
            if order >= 0 and all(signals[-1] in record.arrays for record in records):
                body = _Body(asked._replace(stages=[stage]), records, name, on, signals[-1], order)
                found += [mode] if (mode := body.best()) is not None else []
    return max(found, key=lambda mode: mode.gained, default=None)


class _Body(NamedTuple):
    """A body whose inertia is the derivative of an `order` of a signal, in an equation."""

    asked: Asked
    records: Sequence[Record]
    equation: str
    on: str
    signal: str
    order: int

    def best(self) -> Mode | None:
        """The mode on it that gains most."""
        windows, step = self.asked.criterion.windows, float(self.records[0].time_step)
        assert windows is not None
        grid = np.geomspace(0.5 / float(windows.beta), 0.25 / step, FREQUENCIES)
        shapes = np.array([(hertz, damping) for hertz in grid for damping in DAMPING]).T
        best = self._best_of(*shapes)
        apart = np.log([grid[1] / grid[0], DAMPING[1] / DAMPING[0]])
        around = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]).T
        for closer in 0.5 ** np.arange(1, CLOSER + 1):
            if best is None:
                break
            near = np.exp(around * closer * apart[:, None])
            hertz, damping = np.array([[best.hertz], [best.damping]]) * near
            best = self._best_of(hertz, np.minimum(damping, MOST_DAMPED))
        return best

    def _best_of(self, hertz: np.ndarray, damping: np.ndarray) -> Mode | None:
        doubts = []
        for number, shape in enumerate(zip(hertz.tolist(), damping.tolist())):
            state = Ringing(f"mode {number}", self.signal, self.on, *shape)
            term = Term(state.state, state.state, derivative=self.order)
            doubts.append(Doubt(state.state, "mode", (), None, term, self.equation, "", state))
        names = [doubt.name for doubt in doubts]
        folds = folds_of(self.asked, self.records, doubts, "")
        beside = folds.beside([n for n in folds.parameters if n not in names], names)
        gained = np.where(beside.value > 0, beside.gained, -1.0)
        at = int(np.argmax(gained))
        if not gained[at] > 0:
            return None
        shape = float(hertz[at]), float(damping[at])
        return Mode(*shape, float(gained[at]) / folds.energy, doubts[at], self.asked)

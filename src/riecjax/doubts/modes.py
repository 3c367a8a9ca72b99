"""Whether what a model leaves is the ringing of a mode on one of its bodies.

A mass m on a spring and a damper, carried by a body of acceleration a, pulls at it with m times its
own acceleration, which is a behind a filter of the second order:

    H(s) = (w^2 + 2 z w s) / (s^2 + 2 z w s + w^2)

with the mode's angular frequency w and damping ratio z. A model without the mode carries m with
the body. What it leaves is the rest, m (H - 1) a: the column of a mode is that of the body's
inertia, of its motion behind H - 1, and its coefficient is the mode's mass. So the body's own
coefficient stays that of all that it carries. The best shape is found over w and z, first on a
grid, then closer and closer around the best.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from riecjax.doubts.columns import Asked, Doubt, Ringing, folds_of
from riecjax.equations.hidden_elements import HiddenMode, accelerated
from riecjax.equations.term import AbstractTerm
from riecjax.records.record import Record

FREQUENCIES = 14
"""From half of the frequency that the longest windows are a period of, to that which the shortest
first let nothing through of, or half of what samples tell; evenly on a logarithmic scale."""
PASSES = 0.05
"""Share of a slow motion's gain that is as good as nothing."""
DAMPING = (0.02, 0.1, 0.4)
"""Damping ratios that are tried first."""
CLOSER = 6
"""Times that the steps between shapes are halved."""
AT_END = 1.1
"""Ratio to an end of the band, within which a frequency lies beyond it."""


class Mode(NamedTuple):
    """A mode that may be left out: its `shape` and its `doubt`, which is `asked` of one stage; the
    share of the target's energy that it has `gained`."""

    shape: Ringing
    doubt: Doubt
    asked: Asked
    gained: float


def elsewhere(mode: Mode, records: Sequence[Record]) -> list[tuple[Doubt, Asked]]:
    """The same mode in equations of other stages that hold its body, each with what is asked of
    that stage: they take the body's mass for that of both."""
    found = []
    for stage, names in enumerate(mode.asked.model.equation_names):
        for name, equation in zip(names, mode.asked.model.stages[stage], strict=True):
            if name == mode.doubt.equation or stage in mode.asked.stages:
                continue
            on_body = _recorded(HiddenMode(mode.shape.on).term_in(equation), mode.asked, records)
            if on_body is not None:
                signal, order, sign = on_body
                shape = replace(mode.shape, signal=signal, order=order, sign=sign)
                doubt = replace(mode.doubt, equation=name, mode=shape)
                found.append((doubt, mode.asked._replace(stages=[stage])))
    return found


def _recorded(
    term: AbstractTerm | None, asked: Asked, records: Sequence[Record]
) -> tuple[str, int, float] | None:
    """Of a body's inertia the lowest derivative that was recorded, whose order the test function
    takes off, that order, and the sign; `None` where there is none."""
    if term is None or term.signal is None:
        return None
    orders = range(term.derivative, -1, -1)
    recorded = [
        (signal, order)
        for signal, order in zip((str(term.signal), *term.measured), orders)
        if order <= asked.criterion.smoothness
        and all(signal in record.arrays for record in records)
    ]
    return (*recorded[0], float(np.sign(float(np.asarray(term.factor))))) if recorded else None


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
            recorded = _recorded(HiddenMode(on).term_in(equation), asked, records)
            if recorded is not None:
                on_body = Ringing(on, *recorded, np.nan, np.nan)
                mode = _on_body(asked._replace(stages=[stage]), records, name, on_body)
                found += [] if mode is None else [mode]
    return max(found, key=lambda mode: mode.gained, default=None)


def _on_body(
    asked: Asked, records: Sequence[Record], equation: str, on_body: Ringing
) -> Mode | None:
    """The mode on a body of an equation that gains most, of any frequency and damping."""

    def best_of(hertz: np.ndarray, damping: np.ndarray) -> Mode | None:
        shapes = [replace(on_body, hertz=f, damping=z) for f, z in zip(hertz, damping)]
        doubts = [
            Doubt(f"mode {number}", "mode", equation=equation, mode=shape)
            for number, shape in enumerate(shapes)
        ]
        names = [doubt.name for doubt in doubts]
        folds = folds_of(asked, records, doubts, "")
        told = folds.beside([n for n in folds.parameters if n not in names], names)
        gained = [one.gained / folds.energy if one.value > 0 else 0.0 for one in told]
        at = int(np.argmax(gained))
        return Mode(shapes[at], doubts[at], asked, gained[at]) if gained[at] > 0 else None

    windows, step = asked.criterion.windows, float(records[0].time_step)
    assert windows is not None
    slowest = 0.5 / float(windows.beta)
    tried = np.arange(slowest, 0.25 / step, 0.5 * slowest)
    gains = asked.criterion.test_function.gain(tried, np.array([float(windows.alpha)]))[:, 0]
    passed = np.minimum.accumulate(gains) > PASSES * gains[:1]
    fastest = max(tried[passed][-1] if passed.any() else 0.0, 2 * slowest)
    grid = np.geomspace(slowest, fastest, FREQUENCIES)
    best = best_of(*np.array([(hertz, damping) for hertz in grid for damping in DAMPING]).T)
    apart = np.log([grid[1] / grid[0], DAMPING[1] / DAMPING[0]])
    around = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]).T
    for closer in 0.5 ** np.arange(1, CLOSER + 1):
        if best is None:
            return None
        near = np.exp(around * closer * apart[:, None])
        hertz, damping = np.array([[best.shape.hertz], [best.shape.damping]]) * near
        hertz = np.clip(hertz, slowest, fastest)
        found = best_of(hertz, np.minimum(damping, 1.0))  # what rings is no more than critical
        best = max(best, found or best, key=lambda mode: mode.gained)
    # At an end of the band it is something slower or faster.
    inside = best is not None and AT_END * slowest < best.shape.hertz < fastest / AT_END
    return best if inside else None

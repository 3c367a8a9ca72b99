"""Whether what a model leaves is what an element would do that it has not.

An element of shape N / D that acts on a term c a makes c N / D a of it, and a model without it has
c a. What it leaves is the rest, c (N / D - 1) a: the column of the element is that of the term, of
its motion behind N / D - 1. So the coefficients stay those of the model: a body's own is that of
all that it carries. The best shape is found by its coordinates, first on a grid, then closer and
closer around the best.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.doubts.columns import Asked, Doubt, Lacked, folds_of
from riecjax.elements.catalogue import doubted_kinds
from riecjax.equations.element import Element
from riecjax.equations.equation import Equation
from riecjax.equations.term import AbstractTerm
from riecjax.records.record import Record

PASSES = 0.05
"""Share of a slow motion's gain that is as good as nothing."""
CLOSER = 6
"""Times that the steps between shapes are halved."""
AT_END = 1.1
"""Ratio to an end of the band, within which a first coordinate lies beyond it."""


class Candidate(NamedTuple):
    """An element that may be left out: its `doubt`, which is `asked` of one stage; the share of the
    target's energy that it has `gained`."""

    shape: Lacked
    doubt: Doubt
    asked: Asked
    gained: float


def elsewhere(best: Candidate, records: Sequence[Record]) -> list[tuple[Doubt, Asked]]:
    """The same element in equations of other stages that hold what it acts on, each with what is
    asked of that stage: they take its coefficient for that of both."""
    found, lacked = [], best.shape
    for stage, name, equation in best.asked.equations:
        if name == best.doubt.equation or stage in best.asked.stages:
            continue
        of = _recorded(lacked.element.term_in(equation), best.asked, records)
        if of is not None:
            shape = Lacked(lacked.element, *of, lacked.at)
            doubt = replace(best.doubt, equation=name, lacked=shape)
            found.append((doubt, best.asked._replace(stages=[stage])))
    return found


def _recorded(
    term: AbstractTerm | None, asked: Asked, records: Sequence[Record]
) -> tuple[str, int, float] | None:
    """Of a term the lowest derivative that was recorded, whose order the test function takes off,
    that order, and the sign; `None` where there is none."""
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


def best_element(asked: Asked, records: Sequence[Record]) -> Candidate | None:
    """The element of positive size that gains most, of all places; `None` where there is none."""
    # Later stages that hold a body know its mass from the first.
    first: dict[Element, tuple[int, str, Equation]] = {}
    for of in asked.equations:
        for kind in doubted_kinds():
            for place in kind.places(of[2], asked.model.equations):
                first.setdefault(kind.at(place), of)
    found = []
    for element, (stage, name, equation) in first.items():
        if (recorded := _recorded(element.term_in(equation), asked, records)) is not None:
            lacked = Lacked(element, *recorded, ())
            found.append(_of_element(asked._replace(stages=[stage]), records, name, lacked))
    return max(filter(None, found), key=lambda one: one.gained, default=None)


def _of_element(
    asked: Asked, records: Sequence[Record], equation: str, of: Lacked
) -> Candidate | None:
    """The element in an equation that gains most, of any shape."""

    def best_of(shapes: Float[np.ndarray, "shapes coordinates"]) -> Candidate | None:
        lacked = [replace(of, at=tuple(map(float, at))) for at in shapes]
        doubts = [
            Doubt(f"{of.element.kind} {number}", "element", equation=equation, lacked=one)
            for number, one in enumerate(lacked)
        ]
        names = [doubt.name for doubt in doubts]
        folds = folds_of(asked, records, doubts, "")
        told = folds.beside([n for n in folds.parameters if n not in names], names)
        gained = [one.gained / folds.energy if one.value > 0 else 0.0 for one in told]
        at = int(np.argmax(gained))
        return Candidate(lacked[at], doubts[at], asked, gained[at]) if gained[at] > 0 else None

    windows, step = asked.criterion.windows, float(records[0].time_step)
    assert windows is not None
    # From half of the frequency that the longest windows are a period of, to that which the
    # shortest first let nothing through of, or half of what samples tell.
    slowest = 0.5 / float(windows.beta)
    tried = np.arange(slowest, 0.25 / step, 0.5 * slowest)
    gains = asked.criterion.test_function.gain(tried, np.array([float(windows.alpha)]))[:, 0]
    passed = np.minimum.accumulate(gains) > PASSES * gains[:1]
    fastest = max(tried[passed][-1] if passed.any() else 0.0, 2 * slowest)
    axes = of.element.rough_axes(slowest, fastest)
    best = best_of(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes)))
    apart = np.log([axis[1] / axis[0] for axis in axes])
    sides = np.meshgrid(*([(-1, 0, 1)] * len(axes)), indexing="ij")
    around = np.stack(sides, axis=-1).reshape(-1, len(axes))
    around = around[np.any(around != 0, axis=1)]
    # A ratio of damping beyond one, which is critical, is no shape of its own.
    most = np.array([fastest, 1.0])[: len(axes)]
    least = np.array([slowest, 0.0])[: len(axes)]
    for closer in 0.5 ** np.arange(1, CLOSER + 1):
        if best is None:
            return None
        found = best_of(np.clip(best.shape.at * np.exp(around * closer * apart), least, most))
        best = max(best, found or best, key=lambda one: one.gained)
    # At an end of the band it is something slower or faster.
    inside = best is not None and AT_END * slowest < best.shape.at[0] < fastest / AT_END
    return best if inside else None

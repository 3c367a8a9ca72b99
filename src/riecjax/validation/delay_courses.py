"""How a signal's delay against an equation changes along a record: two clocks, or lost rows.

Sums over windows are kept by block of time, so that those of parts of a record need no pass of
their own. Parameters theta and a delay of each part are found in turn: theta from all parts, each
at its delay; each part's delay where it leaves least of theta. Delays that grow evenly are of two
clocks, those that jump of rows that one signal lost.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.records.faults.derivative_pairs import Course, changing
from riecjax.validation.least_left import Search, Solved, between, energy, solve, total

PARTS = 16
"""Parts of a record whose delays are told."""
FEWEST = 8
TURNS = 8
"""Times that parameters and delays are found in turn."""
PERHAPS, CERTAIN = 2.0, 40.0
"""F-statistic of a course against a steady delay, to look for more, and to name it."""
SLIGHT = 0.05
"""Change in samples, as far as one to either side tells it, below which no more are tried."""
LEAST = {"clocks": 0.1, "rows": 0.5}
"""Samples by which the delay changes at the least."""
FARTHEST = 20
"""Samples to either side of the delay of all that those of parts are looked for."""


class FoundCourse(NamedTuple):
    """A course, and what was found with each part at its own delay."""

    course: Course
    solved: Solved


def course_of(search: Search, middle: int, samples: float) -> FoundCourse | None:
    """The course of a delay, if it is none that stays.

    **Arguments:** `search` of the delay of one record; `middle`, whole samples of the delay of all
    of it; `samples` to a block.
    """
    blocks = np.sort(np.concatenate(search.groups))
    if blocks.size // 2 < FEWEST:
        return None
    parts = np.array_split(blocks, min(PARTS, blocks.size // 2))
    found = _found(search, parts, range(middle - 1, middle + 2), samples)
    # Parts whose delays are far from the middle one are not told by three delays next to it.
    if found is not None and (found[1] < PERHAPS or abs(found[0].course.change) < SLIGHT):
        return None
    first, last = max(middle - FARTHEST, 1 - search.most), min(middle + FARTHEST, search.most - 1)
    found = _found(search, parts, range(first, last + 1), samples)
    if found is None or found[1] < CERTAIN:
        return None
    course = found[0].course
    return found[0] if abs(course.change) > LEAST[course.kind] else None


def _found(
    search: Search, parts: Sequence[np.ndarray], counts: range, samples: float
) -> tuple[FoundCourse, float] | None:
    """The best course with delays among these, and its F-statistic against a steady one."""
    sums = [[[total(s, only=part) for s in search.sums(k)] for part in parts] for k in counts]
    at, bend = np.full(len(parts), len(counts) // 2, float), np.ones(len(parts))
    solved = None
    for _ in range(TURNS):
        solved = _solved(search, sums, at)
        if not np.isfinite(solved.left):
            return None
        at, bend = _delays(search, sums, solved.values)
    assert solved is not None
    edges = [round(samples * float(edge)) for edge in (0, *(part[-1] + 1 for part in parts))]
    ends = np.array(list(itertools.pairwise(edges)), float).T
    told = bend > 0
    delays = np.stack([at + counts[0], 1 / np.sqrt(np.where(told, bend, 1.0)), *ends])[:, told]
    if delays.shape[1] < FEWEST:
        return None
    course, left = changing(delays, edges)
    weight = delays[1] ** -2.0
    steady = float(weight @ (delays[0] - weight @ delays[0] / weight.sum()) ** 2)
    statistic = (steady - left) / max(left / (delays.shape[1] - 3), 1e-12 * steady, 1e-300)
    return FoundCourse(course, _without_worst(search, sums, at)), statistic


def _solved(search: Search, sums: list, at: Float[np.ndarray, " parts"]) -> Solved:
    each = [_at(sums, i, float(place)) for i, place in enumerate(at)]
    every = [
        stages[0]._replace(clean=sum(s.clean for s in stages), noise=sum(s.noise for s in stages))
        for stages in zip(*each)
    ]
    return solve(every, search.estimate.known, search.reading)


def _without_worst(search: Search, sums: list, at: Float[np.ndarray, " parts"]) -> Solved:
    """What is found of all parts but the one that leaves most: a jump within it is not undone."""
    values = _solved(search, sums, at).values
    left = [energy(_at(sums, i, float(p)), values, search.reading) for i, p in enumerate(at)]
    kept = np.flatnonzero(np.arange(at.size) != np.argmax(left))
    return _solved(search, [[row[i] for i in kept] for row in sums], at[kept])


def _at(sums: list, part: int, place: float) -> list:
    """Sums of a part at a place between the delays."""
    nearest = int(np.clip(round(place), 1, len(sums) - 2))
    three = [sums[nearest + k][part] for k in (-1, 0, 1)]
    return between(three, place - nearest)


def _delays(
    search: Search, sums: list, values: Mapping[str, float]
) -> tuple[Float[np.ndarray, " parts"], Float[np.ndarray, " parts"]]:
    """Where each part leaves least, and how sharply; not sharply at all where it is at an end."""
    left = np.array([[energy(stages, values, search.reading) for stages in row] for row in sums])
    lowest = np.clip(np.argmin(left, axis=0), 1, len(sums) - 2)
    parts = np.arange(left.shape[1])
    low, here, high = (left[lowest + k, parts] for k in (-1, 0, 1))
    bend = low - 2 * here + high
    moved = 0.5 * (low - high) / np.where(bend > 0, bend, 1.0)
    inside = (bend > 0) & (np.abs(moved) < (3.0 if len(sums) == 3 else 1.0))
    reach = 3.0 if len(sums) == 3 else 1.0
    return lowest + np.clip(moved, -reach, reach), np.where(inside, bend, 0.0)

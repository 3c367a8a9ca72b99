"""How much of a fault to undo so that a fit leaves least, from sums of three records.

A fault of a sensor that is undone by an amount a, in units, changes every moment of the windows as
a smooth function of a, a parabola to the accuracy of the motion's sampling. With sums M made for
k - 1, k and k + 1 units,

    M(a) = M(k - 1) a (a - 1) / 2 + M(k) (1 - a^2) + M(k + 1) a (a + 1) / 2,   a from k,

so that the estimate theta(a) and what it leaves follow without another pass over the samples: the
amount is where it leaves least, found to a small part of a unit. Its scatter is that of amounts
without each block of time in turn. Noise is taken off the moments as ever.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.equations.procedure import Procedure
from riecjax.estimation.estimate import Estimate
from riecjax.records.record import Record
from riecjax.summaries.summarise import summed
from riecjax.summaries.summary import Summary
from riecjax.summaries.task import Task, record_keys

GROUPS = 32
"""Blocks of time that are left out in turn at most."""
LOST = 0.03
"""Energy left, as a share, from which the amount may be too large to be found by going downhill."""
FOUND = 0.1
"""Share of that energy which an amount leaves at most to be taken without trying others."""
COARSE = 3
"""Units between the amounts that are then tried."""
STEPS = 5
"""Times that the middle of the three amounts is moved to where least is left."""
Blocks = Float[np.ndarray, "blocks q q"]


class StageSums(NamedTuple):
    """Sums of a stage by block of time, less noise; and those of noise."""

    names: tuple[str, ...]
    clean: Blocks
    noise: Blocks


class Solved(NamedTuple):
    """Values of all parameters; energy left beyond noise over the target's, and that of noise;
    and which parameters are `free`."""

    values: dict[str, float]
    left: float
    noise: float
    free: tuple[str, ...] = ()


class Lowest(NamedTuple):
    """Where the least is left.

    **Fields:** `at`, how much was undone; `without`, the same with each block of time left out in
    turn; `before` and `after`, what was found of the records as they are, and there.
    """

    at: float
    without: Float[np.ndarray, " groups"]
    before: Solved
    after: Solved

    @property
    def error(self) -> float:
        """Its standard error, by the jackknife."""
        count = self.without.size
        return float(np.std(self.without) * np.sqrt(count - 1))


@dataclasses.dataclass
class Search:
    """The search for how much of a fault to undo, so that a fit leaves least.

    **Fields:** `undone`, the records with k times a unit of it taken off, all of one length;
    `most`, the largest k; `kept`, sums by k, of which those of 0 may be another search's.
    """

    procedure: Procedure
    estimate: Estimate
    undone: Callable[[int], list[Record]]
    most: int
    kept: dict[int, list[StageSums]]

    def __post_init__(self) -> None:
        zero, one = self.sums(0), self.sums(1)
        differ = (np.any(a.clean != b.clean) for a, b in zip(zero, one))
        self.reading = [i for i, other in enumerate(differ) if other]
        rows = zero[0].clean[:, 0, 0]
        count = min(int(self.estimate.block_count), GROUPS)
        self.groups = np.array_split(np.flatnonzero(rows != 0), count)

    def sums(self, count: int) -> list[StageSums]:
        """Of the records with so much undone."""
        if count not in self.kept:
            summary = sums_like(self.procedure, self.undone(count), self.estimate)
            self.kept[count] = _stages(summary)
        return self.kept[count]

    # Values too large to be squared leave no finite sum, and nothing is found.
    @np.errstate(over="ignore", invalid="ignore")
    def found(self) -> Lowest | None:
        """Where least is left, if that is found."""
        before = self.solved(0, 0.0)
        middle, moved = self.descended(0)
        after = self.solved(middle, moved)
        if before.left > LOST and not after.left < FOUND * before.left:
            every = range(1 - self.most, self.most, COARSE)
            middle, moved = self.descended(min(every, key=lambda k: self.solved(k, 0.0).left))
            after = self.solved(middle, moved)
        if not np.isfinite(after.left):
            return None
        without = np.array([self.lowest(middle, group, moved) for group in self.groups])
        return Lowest(middle + moved, without, before, after)

    def descended(self, middle: int) -> tuple[int, float]:
        """The nearest amount that leaves least, as whole units and a part; NaN if not found."""
        moved = float("nan")
        for _ in range(STEPS):
            moved = self.lowest(middle)
            if not np.isfinite(moved) or abs(moved) <= 0.75:
                break
            middle = round(np.clip(middle + moved, 1 - self.most, self.most - 1))
        return middle, moved if abs(moved) <= 1 else float("nan")

    def lowest(self, middle: int, left_out: np.ndarray | None = None, near: float = 0.0) -> float:
        """Units from the middle amount to where least is left; NaN if there is no minimum."""
        every = self.around(middle, left_out)
        at, steps = near, (1.0, 0.3, 0.1) if left_out is None else (0.1, 0.1)
        for h in steps:
            low, here, high = (self.solve(every, at + k * h).left for k in (-1, 0, 1))
            bend = low - 2 * here + high
            if not bend > 0:
                return float("nan")
            at = float(np.clip(at + h / 2 * (low - high) / bend, -self.most, self.most))
            if abs(at) > 1.5:
                break  # a parabola through the three reaches no further
        return at

    def around(self, middle: int, left_out: np.ndarray | None = None) -> list[list[StageSums]]:
        """Sums over all blocks, but some, at an amount and one unit to either side of it."""
        every = (self.sums(middle + k) for k in (-1, 0, 1))
        return [[total(stage, left_out) for stage in stages] for stages in every]

    def solve(self, three: Sequence[Sequence[StageSums]], at: float) -> Solved:
        """Values and what is left at an amount from the middle one of three."""
        return solve(between(three, at), self.estimate.known, self.reading)

    def solved(self, middle: int, at: float) -> Solved:
        """Values and what is left at an amount, as energy that is not below zero."""
        found = self.solve(self.around(middle), at)
        return found._replace(left=float(np.maximum(found.left, 0.0)), noise=max(found.noise, 0.0))


def sums_like(procedure: Procedure, records: list[Record], estimate: Estimate) -> Summary:
    """A Summary of other records, made by the functions that were compiled for an estimate's."""
    made, criterion = estimate.summary, estimate.criterion
    assert made is not None
    windows = criterion.windows
    own = None
    if windows is not None:
        own = criterion.test_function.edges(float(windows.alpha), float(windows.beta))
    bins = None if own is not None or made.edges is None else np.asarray(made.edges)
    surveyed = made.recordings[0].stages[0][0].survey is not None
    task = Task(procedure, records, criterion, record_keys(None, len(records)))
    return summed(task, bins=bins, survey=surveyed)


def _stages(summary: Summary) -> list[StageSums]:
    found = []
    for stage in summary.equations():
        names = tuple(dict.fromkeys(name for e in stage for name in e.parameters))
        size, blocks = 1 + len(names), stage[0].count.size
        clean, noise = np.zeros((2, blocks, size, size))
        for equation in stage:
            place = [0, *(1 + names.index(name) for name in equation.parameters)]
            among = np.ix_(range(blocks), place, place)
            shape = (blocks, len(place), len(place))
            clean[among] += np.asarray(equation.clean).reshape(shape)
            if equation.noise is not None:
                noise[among] += np.asarray(equation.noise).reshape(shape)
        found.append(StageSums(names, clean, noise))
    return found


def total(
    stage: StageSums, left_out: np.ndarray | None = None, only: np.ndarray | None = None
) -> StageSums:
    """The sum over all blocks, over all but some, or over some only."""

    def of(blocks: Blocks) -> Float[np.ndarray, "q q"]:
        if only is not None:
            return blocks[only].sum(0)
        every = blocks.sum(0)
        return every if left_out is None else every - blocks[left_out].sum(0)

    return StageSums(stage.names, of(stage.clean), of(stage.noise))


def between(parts: Sequence[Sequence[StageSums]], at: float) -> list[StageSums]:
    """Sums at an amount between three."""
    shares = at * (at - 1) / 2, 1 - at**2, at * (at + 1) / 2

    def mixed(of: Callable[[StageSums], np.ndarray], stages: Sequence[StageSums]) -> np.ndarray:
        return sum((w * of(s) for w, s in zip(shares, stages)), np.zeros(()))

    return [
        StageSums(three[0].names, mixed(lambda s: s.clean, three), mixed(lambda s: s.noise, three))
        for three in zip(*parts)
    ]


def solve(stages: Sequence[StageSums], known: Mapping, reading: Sequence[int]) -> Solved:
    """Values of all stages in turn, and what those that the fault reaches leave, as energy."""
    values, left, noise = {n: float(v) for n, v in known.items()}, 0.0, 0.0
    for i, (names, clean, noisy) in enumerate(stages):
        free = [name for name in names if name not in values]
        mix = np.zeros((1 + len(free), 1 + len(names)))
        mix[0] = [1.0, *(-values.get(name, 0.0) for name in names)]
        for row, name in enumerate(free, 1):
            mix[row, 1 + names.index(name)] = 1.0
        moments = mix @ clean @ mix.T
        if not np.isfinite(moments).all():
            return Solved(values, float("nan"), 0.0)
        sizes = np.diagonal(moments)
        scale = 1 / np.sqrt(np.where(sizes > 0, sizes, 1.0))
        scaled = moments * scale[:, None] * scale
        theta = np.linalg.lstsq(scaled[1:, 1:], scaled[1:, 0], rcond=1e-12)[0]
        theta = theta * scale[1:] / scale[0]
        values |= dict(zip(free, theta.tolist()))
        if i in reading and free:
            row = np.array([1.0, *-theta]) @ mix
            target = (mix[0] @ (clean + noisy) @ mix[0]) or 1.0
            left += float(row @ clean @ row / target)
            noise += float(row @ noisy @ row / target)
    return Solved(values, left, noise, tuple(n for n in values if n not in known))


def energy(
    stages: Sequence[StageSums], values: Mapping[str, float], reading: Sequence[int]
) -> float:
    """What stages leave beyond noise with these values, in the squares of their units."""
    rows = {i: np.array([1.0, *(-values[n] for n in stages[i].names)]) for i in reading}
    return float(sum(row @ stages[i].clean @ row for i, row in rows.items()))

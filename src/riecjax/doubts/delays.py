"""How late signals are against equations: the delay's column, undone and taken again.

A signal recorded tau late shows z(t) = s(t - tau). Its column is right to first order in tau, so
that the delay that it finds is taken off the record, and the column of what is left of it taken
again, until nothing is: there the answer is exact. Delays beyond the column's reach are looked for
from starts that lie so near to each other that one of them is within it.

Behind a first-order low-pass of time constant tau a sensor shows z with s = z + tau z': to first
order in tau that is the same column, and what is left of the second order tells them apart.

**A delay that changes.** Delays that grow evenly along a record are of two clocks, those that jump
of rows that one signal lost. Sums by fold of time of the record with a signal advanced by whole
samples hold a delay of each fold: parameters from all folds, each at its delay; each fold's delay
where it leaves least of them, in turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax import tails
from riecjax.doubts.causes import LEVEL
from riecjax.doubts.columns import Asked, Doubt, folds_of, longest_delay
from riecjax.errors import DataError
from riecjax.folds import Folds, Told, solved
from riecjax.records.preparation.filtering import unfilter
from riecjax.records.preparation.resampling import shift
from riecjax.records.record import Record

TURNS = 8
"""Times that a delay is undone and taken again at the most."""
SETTLED = 0.1
"""Standard errors of a step that is the last."""
SMALLEST = 0.02
"""Samples below which a delay is the quadrature's, which has no more accuracy."""
TURN = 1.0
"""Radians of the usual motion that a step of a delay is at the most."""


class Course(NamedTuple):
    """How a delay changes along the record.

    **Fields:** `kind`: "clocks" for one that grows evenly, "rows" for a sudden change; `change`
    over the record in samples; `place` of a sudden change, first and last sample; `first`, the
    delay at the start; F-statistic against a steady delay.
    """

    kind: str
    change: float
    place: tuple[int, int]
    first: float
    statistic: float = 0.0

    @property
    def last(self) -> float:
        """The delay at the end."""
        return self.first + self.change


class Settled(NamedTuple):
    """How much of a doubt there is, once that is undone.

    **Fields:** `size` in the unit of its column, seconds of a delay, or of the time constant of a
    first-order low-pass where it is `low_passed`; standard `error` and `reach`, half an interval at
    the level of an answer; what is `left` beyond noise, as a share of the target's energy; `values`
    of parameters by stage and name; seconds between samples, `step`; whether delay and low-pass are
    told apart for `certain`; `course` of a delay that changes, which has no size.
    """

    size: float
    error: float
    reach: float
    left: float
    values: dict[str, float]
    step: float
    low_passed: bool = False
    certain: bool = True
    course: Course | None = None

    @property
    def samples(self) -> float:
        """A delay in samples."""
        return self.size / self.step


def settled(
    asked: Asked,
    records: Sequence[Record],
    doubt: Doubt,
    most: float,
    start: float = 0.0,
    lagged: bool = False,
) -> Settled | None:
    """A doubt of a sensor near a start, or the time constant of a low-pass in place of a delay;
    `None` where no step settles it, or it is larger than `most`."""
    size, step = start, float(records[0].time_step)
    farthest = _reach(records, doubt)
    for turn in range(TURNS):
        undone = _undone(records, doubt, size, lagged)
        if undone is None:
            return None
        folds = folds_of(asked, undone, [doubt])
        names = tuple(name for name in folds.parameters if name != doubt.name)
        told = folds.told((*names, doubt.name), doubt.name)
        if not (np.isfinite(told.value) and np.isfinite(told.error)):
            return None
        if abs(told.value) <= max(SETTLED * told.error, 1e-9 * most) or turn == TURNS - 1:
            left = float(folds.left(names).motion.sum())
            return settled_at(size, told, folds, names, left, step)._replace(low_passed=lagged)
        asked = asked.with_values(folds.values((*names, doubt.name)))
        size += float(np.clip(told.value, -farthest, farthest))
        if abs(size) > most or (lagged and size <= 0):
            return None
    return None


def settled_at(
    size: float, told: Told, folds: Folds, names: Sequence[str], left: float, step: float
) -> Settled:
    """So much of a doubt, of which a column was `told` beside those of these names, which leave
    an energy of the motion."""
    values = folds.values(names)
    reach = float(tails.student(LEVEL / 2, told.freedom)) * told.error
    return Settled(size, told.error, reach, left / folds.energy, values, step)


def low_pass_of(asked: Asked, records: Sequence[Record], delay: Doubt, size: float) -> Told:
    """How much of a low-pass there is in a delay that settled at this size: 1 is all, 0 none.

    Behind a low-pass of time constant tau a sensor shows s - tau s' + tau^2 s'' - ..., and tau late
    s - tau s' + tau^2 / 2 s'' - .... So once the delay is undone, half of tau^2 s'' is left.
    """
    undone = _undone(records, delay, size, False)
    assert undone is not None
    bend = Doubt(
        "bend", "gain", delay.signals, lambda _, rate, time: np.gradient(rate, time[1] - time[0])
    )
    folds = folds_of(asked, undone, [delay, bend])
    return folds.told(folds.parameters, bend.name).times(2 / size**2)


def _undone(
    records: Sequence[Record], doubt: Doubt, size: float, lagged: bool
) -> list[Record] | None:
    """The records without so much of a doubt; `None` where nothing is left of them."""
    if not size:
        return [*records]
    if doubt.kind == "delay":
        by = dict.fromkeys(doubt.signals, size)
        try:
            return [(unfilter if lagged else shift)(one, by) for one in records]
        except DataError:
            return None
    by, less = (1 / (1 + size), 0.0) if doubt.kind == "gain" else (1.0, size)
    return [
        one.with_signals({name: one.signal(name) * by - less for name in doubt.signals})
        for one in records
    ]


def _reach(records: Sequence[Record], doubt: Doubt) -> float:
    """How large a step of a doubt's size its column tells: a part of a turn of the usual motion,
    the usual deviation from the mean of a zero, and half of a gain."""
    if doubt.kind == "delay":
        return TURN / _rate(records, doubt.signals)
    deviations = [float(np.std(one.arrays[name])) for one in records for name in doubt.signals]
    return max(deviations) if doubt.kind == "zero" else 0.5


def _rate(records: Sequence[Record], signals: Sequence[str]) -> float:
    """The usual angular frequency of the fastest of some signals, in radians per second."""
    every = [(one, np.asarray(one.arrays[name], float)) for one in records for name in signals]
    rates = (
        float(np.std(np.diff(samples))) / (float(np.std(samples)) or 1.0) / float(one.time_step)
        for one, samples in every
    )
    return max(*rates, 1e-12)


FEWEST_PARTS = 8
"""Folds of a record whose delays are told, at the least."""
ROUNDS = 8
"""Times that parameters and delays are found in turn."""
PERHAPS, CERTAIN = 2.0, 40.0
"""F-statistic of a course against a steady delay, to look for more, and to name it."""
SLIGHT = 0.05
"""Change in samples, as far as one to either side tells it, below which no more are tried."""
LEAST = {"clocks": 0.1, "rows": 0.5}
"""Samples by which the delay changes at the least."""
FARTHEST = 20
"""Samples to either side of the delay of all that those of parts are looked for."""


def changing(delays: Float[np.ndarray, "4 parts"], edges: Sequence[int]) -> tuple[Course, float]:
    """The course that explains the delays best, and the chi-square that it leaves."""
    first, last = delays[2:]
    ones, size = np.ones(first.size), first.size
    left, (start, change) = _left(delays, np.array([ones, 0.5 * (first + last) / edges[-1]]))
    best = Course("clocks", change, (0, edges[-1]), start), left
    # The change lies between two parts, or within one, which then says nothing; two are behind it.
    for k, stop in ((k, k + within) for k in range(2, size - 1) for within in (0, 1)):
        if stop <= size - 2:
            rows = np.array([ones, np.arange(size) >= stop, *np.eye(size)[k:stop]])
            left, (start, change, *_) = _left(delays, rows)
            if left + 4 < best[1]:
                best = Course("rows", change, (int(first[stop - 1]), int(last[k])), start), left
    return best


def _left(delays: np.ndarray, rows: np.ndarray) -> tuple[float, Float[np.ndarray, " rows"]]:
    """Chi-square that a weighted least-squares fit leaves; its coefficients."""
    values, errors = delays[:2]
    coefficients = np.linalg.pinv((rows / errors).T) @ (values / errors)
    left = (values - coefficients @ rows) / errors
    return float(left @ left), coefficients


@dataclass
class Shifts:
    """Sums by fold of records, some signals of which are advanced by whole samples; whether the
    equations are `exact` but for noise."""

    asked: Asked
    records: Sequence[Record]
    signals: tuple[str, ...]
    exact: bool = False
    known: dict[int, Folds] = field(default_factory=dict)

    def __post_init__(self):
        self.reach = longest_delay(self.records)
        step = float(self.records[0].time_step)
        self.apart = max(int(TURN / _rate(self.records, self.signals) / step), 1)

    def sums(self, count: int) -> Folds:
        """With so many samples undone."""
        if count not in self.known:
            moved = [advanced(one, self.signals, count, self.reach) for one in self.records]
            # A shift leaves noise what it was.
            found = folds_of(self.asked, moved, [], "" if self.known else "all")
            first = next(iter(self.known.values()), found)
            motion = found.samples - (first.samples - first.motion)
            self.known[count] = found._replace(motion=motion)
        return self.known[count]

    @property
    def every(self) -> range:
        """Shifts within a column's reach of each other."""
        return range(-self.reach + self.reach % self.apart, self.reach + 1, self.apart)

    def start(self) -> int:
        """The shift of these that leaves least."""

        def left(count: int) -> float:
            folds = self.sums(count)
            return float(folds.left(folds.parameters).motion.sum()) / folds.energy

        return min(self.every, key=left)

    def course(self, middle: int, large: bool) -> Settled | None:
        """The course of a delay about this one, of any size if it may be `large`, if it is none
        that stays."""
        first, last = max(middle - 1, -self.reach), min(middle + 1, self.reach)
        near = self._among(range(first, last + 1))
        if near is None or not self._changes(near, SLIGHT):
            # Parts whose delays are far from the middle one are not told by three next to it.
            far, middle = self._among(self.every), 0
            if far is not None and not self._changes(far, 1.0):
                return None
        most = self.reach if large else FARTHEST
        first, last = max(middle - most, -self.reach), min(middle + most, self.reach)
        best = self._among(range(first, last + 1))
        if best is None or best.course is None:
            return None
        chance = float(tails.student(LEVEL / 2, self.sums(middle).number - 3)) ** 2
        if best.course.statistic < (chance if self.exact else CERTAIN):
            return None
        return best if abs(best.course.change) > LEAST[best.course.kind] else None

    def _changes(self, found: Settled, least: float) -> bool:
        course = found.course
        return course is not None and course.statistic > PERHAPS and abs(course.change) > least

    def _among(self, counts: range) -> Settled | None:
        """The best course with delays among these, each part at its own."""
        every = [self.sums(count) for count in counts]
        folds, names = every[0].number, every[0].parameters
        if folds < FEWEST_PARTS or len(every) < 3 or any(one.number != folds for one in every):
            return None
        motion, samples = (
            np.stack([getattr(one, of) for one in every]) for of in ("motion", "samples")
        )
        parts, either = np.arange(folds), np.array([[-1], [0], [1]])

        def at(places: Float[np.ndarray, " parts"]) -> Float[np.ndarray, "counts parts"]:
            """Weights of delays for each part at its place between them: of parabolas."""
            nearest = np.clip(np.round(places).astype(int), 1, len(counts) - 2)
            aside = places - nearest
            weights = np.zeros((len(counts), folds))
            three = np.array([aside * (aside - 1) / 2, 1 - aside**2, aside * (aside + 1) / 2])
            weights[nearest + either, parts] = three
            return weights

        def row(weights: Float[np.ndarray, "counts parts"]) -> Float[np.ndarray, " columns"]:
            total = np.tensordot(weights, motion, 2)
            return np.array([1.0, *(-solved(total[1:, 1:], total[1:, 0]))])

        places, bend = np.full(folds, len(counts) // 2, float), np.ones(folds)
        reach = 3.0 if len(counts) == 3 else 1.0
        for _ in range(ROUNDS):
            v = row(at(places))
            if not np.all(np.isfinite(v)):
                return None
            # Where each part leaves least, and how sharply; not sharply at all where that is at an
            # end.
            left = np.einsum("i,kfij,j->kf", v, motion, v)
            lowest = np.clip(np.argmin(left, axis=0), 1, len(counts) - 2)
            low, here, high = left[lowest + either, parts]
            bend = low - 2 * here + high
            moved = 0.5 * (low - high) / np.where(bend > 0, bend, 1.0)
            bend = np.where((bend > 0) & (np.abs(moved) < reach), bend, 0.0)
            places = lowest + np.clip(moved, -reach, reach)
        edges = np.linspace(0, self.records[0].sample_count, folds + 1).round().astype(int).tolist()
        told = bend > 0
        errors = 1 / np.sqrt(np.where(told, bend, 1.0))
        samples_late = counts[0] + counts.step * places
        delays = np.stack([samples_late, counts.step * errors, edges[:-1], edges[1:]])[:, told]
        if delays.shape[1] < FEWEST_PARTS:
            return None
        # Errors are known up to a factor, which the course that leaves least tells.
        _, uneven = changing(delays, edges)
        delays[1] *= np.sqrt(max(uneven, 1e-12) / max(delays.shape[1] - 3, 1))
        course, uneven = changing(delays, edges)
        weight = delays[1] ** -2.0
        steady = float(weight @ (delays[0] - weight @ delays[0] / weight.sum()) ** 2)
        statistic = (steady - uneven) / max(uneven / (delays.shape[1] - 3), 1e-12 * steady, 1e-300)
        # Of all parts but the one that leaves most: a jump within it is not undone.
        weights = at(places)
        v = row(weights)
        weights[:, np.argmax(np.einsum("kf,i,kfij,j->f", weights, v, motion, v))] = 0.0
        v = row(weights)
        left = float(np.einsum("kf,i,kfij,j->", weights, v, motion, v))
        energy = float(np.sum(weights * samples[:, :, 0, 0]))
        values, step = dict(zip(names, (-v[1:]).tolist())), float(self.records[0].time_step)
        course = course._replace(statistic=statistic)
        return Settled(0.0, np.nan, np.nan, left / energy, values, step, course=course)


def advanced(record: Record, signals: Sequence[str], count: int, reach: int) -> Record:
    """A record without `reach` samples at either end, some signals advanced by whole samples."""
    n = record.sample_count
    moved = record.select(*signals).part(reach + count, n - reach + count)
    return record.part(reach, n - reach).with_signals(moved.by_name)

"""Whether a signal is late against an equation: a delay estimated as a parameter, from sums.

A signal recorded tau late shows z(t) = s(t - tau), so that s(t) = z(t + tau): the equation holds of
the recording with that signal advanced by tau, and least squares leave least there; `Search`
finds where. Behind a first-order low-pass of time constant tau it shows z with s = z + tau z':
to first order in tau that is the same, and which of the two leaves less tells them apart.

**Late, or something else.** A mode that was left out, friction or a wrong stiffness make some delay
significant as well. They are no delay: with one, what was left beyond noise hardly becomes less.
Only a delay that explains nearly all of it is told.

How a signal's delay against an equation changes along a record: two clocks, or lost rows.

Sums over windows are kept by block of time, so that those of parts of a record need no pass of
their own. Parameters theta and a delay of each part are found in turn: theta from all parts, each
at its delay; each part's delay where it leaves least of theta. Delays that grow evenly are of two
clocks, those that jump of rows that one signal lost.

How much of a fault to undo so that a fit leaves least, from sums of three records.

A fault of a sensor that is undone by an amount a, in units, changes every moment of the windows as
a smooth function of a, a parabola to the accuracy of the motion's sampling. With sums M made for
k - 1, k and k + 1 units,

    M(a) = M(k - 1) a (a - 1) / 2 + M(k) (1 - a^2) + M(k + 1) a (a + 1) / 2,   a from k,

so that the estimate theta(a) and what it leaves follow without another pass over the samples: the
amount is where it leaves least, found to a small part of a unit. Its scatter is that of amounts
without each block of time in turn. Noise is taken off the moments as ever.
"""

import dataclasses
import itertools
import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from riecjax import tails
from riecjax.equations.hidden_elements import accelerated
from riecjax.equations.model import Model
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding, option_for
from riecjax.linear_algebra import unit_diagonal
from riecjax.records.faults.derivative_pairs import Course, changing
from riecjax.records.preparation.filtering import SLOPE, lead
from riecjax.records.record import Record
from riecjax.summaries.normal_equations import NormalEquations, sum_of_equations
from riecjax.summaries.summarise import summed
from riecjax.summaries.task import Task, record_keys, signals_read

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
FINE = 0.1
"""Unit of the last parabola."""
Stages = Sequence[NormalEquations]
"""Of each stage, by block of time or over some of them."""
Blocks = Int[np.ndarray, " blocks"]
Undo = Callable[[Record, Sequence[str], float, int], Record]


class Solved(NamedTuple):
    """Values of all parameters; energy left beyond noise over the target's, and that of noise;
    and which parameters are `free`."""

    values: dict[str, Any]
    left: Any
    noise: Any
    free: tuple[str, ...] = ()


@dataclasses.dataclass
class Search:
    """The search for how much of a fault to undo, so that a fit leaves least.

    **Fields:** `undo` takes k times `unit` seconds off `signals` of the `records`, and `reach`
    samples off their ends; `most`, the largest k; `kept`, sums by k, of which those of 0 may be
    another search's.
    """

    model: Model
    estimate: Estimate
    records: Sequence[Record]
    signals: tuple[str, ...]
    undo: Undo
    unit: float
    reach: int
    most: int
    kept: dict[int, Stages]

    def __post_init__(self) -> None:
        self.step = float(self.records[0].time_step)
        changes = zip(self.sums(0), self.sums(1))
        self.reading = [i for i, (a, b) in enumerate(changes) if np.any(a.clean != b.clean)]
        self.blocks = np.flatnonzero(self.sums(0)[0].clean[:, 0, 0])

    def sums(self, count: int) -> Stages:
        """Of the records with so much undone."""
        if count not in self.kept:
            criterion = self.estimate.criterion
            samples = count * self.unit / self.step
            records = [self.undo(each, self.signals, samples, self.reach) for each in self.records]
            task = Task(self.model, records, criterion, record_keys(None, len(records)))
            stages = summed(task).equations()
            self.kept[count] = [sum_of_equations(stage).flattened() for stage in stages]
        return self.kept[count]

    # Values too large to be squared leave no finite sum, and nothing is found.
    @np.errstate(over="ignore", invalid="ignore")
    def delay(self, level: float) -> "SignalDelay | None":
        """Where least is left, if that is found, with its reach at a level of chance."""
        before = self.solved(0, 0.0)
        middle, moved, after = self.descended(0)
        if before.left > LOST and not after.left < FOUND * before.left:
            every = range(1 - self.most, self.most, COARSE)
            start = min(every, key=lambda k: self.solved(k, 0.0).left)
            middle, moved, after = self.descended(start)
        if not np.isfinite(after.left):
            return None
        groups = np.array_split(self.blocks, min(int(self.estimate.block_count), GROUPS))
        without = [np.setdiff1d(self.blocks, group) for group in groups]
        amounts = self.lowest(middle, without, moved, (FINE, FINE))
        # The jackknife's standard error.
        error = self.unit * float(np.std(amounts) * np.sqrt(len(groups) - 1))
        reach = float(tails.student(level / 2, len(groups) - 1)) * error
        seconds = (middle + moved) * self.unit
        delay = SignalDelay(self.signals, seconds, error, reach, self.step, before.left**0.5)
        return delay.leaving(before, after)

    def descended(self, middle: int) -> tuple[int, float, Solved]:
        """The nearest amount that leaves least, as whole units and a part, NaN if not found; and
        what is found there."""
        moved = float("nan")
        for _ in range(STEPS):
            moved = float(self.lowest(middle, [self.blocks], 0.0, (1.0, 0.3, FINE))[0])
            if not np.isfinite(moved) or abs(moved) <= 0.75:
                break
            middle = round(np.clip(middle + moved, 1 - self.most, self.most - 1))
        moved = moved if abs(moved) <= 1 else float("nan")
        return middle, moved, self.solved(middle, moved)

    def lowest(
        self, middle: int, groups: Sequence[Blocks], start: float, units: Sequence[float]
    ) -> Float[np.ndarray, " groups"]:
        """Where each group of blocks leaves least, in units from the middle amount, by parabolas so
        wide; NaN if there is no minimum."""
        three, at = self.around(middle, groups), np.full(len(groups), start)
        far = np.zeros(at.size, bool)
        for h in units:
            beside = (mixed(three, parabola(at + k * h)) for k in (-1, 0, 1))
            low, here, high = (self.solve(stages).left for stages in beside)
            bend = low - 2 * here + high
            moved = at + h / 2 * (low - high) / np.where(bend > 0, bend, np.nan)
            at = np.where(far, at, np.clip(moved, -self.most, self.most))
            far |= np.abs(at) > 1.5  # a parabola through the three reaches no further
        return at

    def over(self, count: int, groups: Sequence[Blocks]) -> Stages:
        """Sums over groups of blocks, one after the other, with so much undone."""
        stages = self.sums(count)
        member = np.zeros((len(groups), stages[0].count.size))
        for row, group in zip(member, groups):
            row[group] = 1.0
        return [stage.in_blocks(lambda v: np.tensordot(member, v, 1)) for stage in stages]

    def around(self, middle: int, groups: Sequence[Blocks]) -> list[Stages]:
        """The same at an amount and one unit to either side of it."""
        return [self.over(middle + k, groups) for k in (-1, 0, 1)]

    def solved(self, middle: int, at: float) -> Solved:
        """Values and what is left over all blocks, as energy that is not below zero."""
        solved = self.solve(weighed(self.around(middle, [self.blocks]), parabola(at)))
        return solved._replace(left=float(np.maximum(solved.left, 0.0)), noise=max(solved.noise, 0))

    def solve(self, stages: Stages) -> Solved:
        """Values of all stages in turn, and what those that the fault reaches leave, as energy; of
        each of some groups of blocks, if sums are of several."""
        known = self.estimate.known
        values: dict[str, Any] = {n: float(v) for n, v in known.items()}
        left, noise = np.zeros(np.shape(stages[0].count)), np.zeros(np.shape(stages[0].count))
        for i, stage in enumerate(stages):
            equations = stage.fix(values)
            clean = np.asarray(equations.clean)
            finite = np.all(np.isfinite(clean), axis=(-2, -1), keepdims=True)[..., 0]
            scaled, scale = unit_diagonal(np.where(finite[..., None], clean, 0.0))
            inverse = np.linalg.pinv(scaled[..., 1:, 1:], 1e-12)
            theta = np.einsum("...ij,...j->...i", inverse, scaled[..., 1:, 0])
            theta = np.where(finite, theta * scale[..., 1:] / scale[..., :1], np.nan)
            values |= dict(zip(equations.parameters, np.moveaxis(theta, -1, 0)))
            if i in self.reading and equations.parameters:
                row = np.concatenate([np.ones(finite.shape), -theta], axis=-1)
                target = np.where(equations.energy, equations.energy, 1.0)
                left = left + np.einsum("...i,...ij,...j->...", row, clean, row) / target
                if equations.noise is not None:
                    of_noise = np.einsum("...i,...ij,...j->...", row, equations.noise, row)
                    noise = noise + np.where(finite[..., 0], of_noise / target, 0.0)
        return Solved(values, left, noise, tuple(n for n in values if n not in known))

    def energy(self, stages: Stages, values: Mapping[str, float]) -> Float[np.ndarray, " groups"]:
        """What stages leave beyond noise with these values, in the squares of their units."""
        # As `fix` of them all does, without another set of normal equations for each of thousands.
        equations = [stages[i] for i in self.reading]
        rows = [np.array([1.0, *(-values[name] for name in e.parameters)]) for e in equations]
        return sum((row @ e.clean @ row for row, e in zip(rows, equations)), np.zeros(()))


def parabola(at: float | np.ndarray) -> Float[np.ndarray, "3 *at"]:
    """Weights of what is known at -1, 0 and 1, for a place between."""
    return np.array([at * (at - 1) / 2, 1 - at**2, at * (at + 1) / 2])


def weighed(sums: Sequence[Stages], weights: Float[np.ndarray, "amounts *groups"]) -> Stages:
    """The sum over amounts and groups of blocks, each of which counts so much."""
    weights = weights.reshape(len(sums), -1)
    return _combined(sums, lambda values: np.tensordot(weights, values, 2))


def mixed(sums: Sequence[Stages], weights: Float[np.ndarray, "amounts groups"]) -> Stages:
    """The sum over amounts, of each group of blocks by itself."""
    return _combined(sums, lambda values: np.einsum("ag,ag...->g...", weights, values))


def _combined(sums: Sequence[Stages], how: Callable[[np.ndarray], np.ndarray]) -> Stages:
    """Of each stage what is made of its sums with every amount, which are stacked for that."""

    def made(of: Sequence[Any]) -> Any:
        return None if of[0] is None else how(np.stack([np.asarray(each) for each in of]))

    return [
        NormalEquations(
            made([each.moments for each in stages]),
            made([each.count for each in stages]),
            stages[0].parameters,
            made([each.noise for each in stages]),
        )
        for stages in zip(*sums)
    ]


PARTS, FEWEST = 16, 8
"""Parts of a record whose delays are told, at the most and at the least."""
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


class Followed(NamedTuple):
    """The course of a delay, what is found with each part at its own delay, and the course's
    F-statistic against a steady one."""

    course: Course
    solved: Solved
    statistic: float


def course_of(search: Search, middle: int, samples: float) -> Followed | None:
    """The course of a delay, if it is none that stays.

    **Arguments:** `search` of the delay of one record; `middle`, whole samples of the delay of all
    of it; `samples` to a block.
    """
    if search.blocks.size // 2 < FEWEST:
        return None
    parts = np.array_split(search.blocks, min(PARTS, search.blocks.size // 2))
    near = _course_among(search, parts, range(middle - 1, middle + 2), samples)
    # Parts whose delays are far from the middle one are not told by three delays next to it.
    if near is not None and (near.statistic < PERHAPS or abs(near.course.change) < SLIGHT):
        return None
    first, last = max(middle - FARTHEST, 1 - search.most), min(middle + FARTHEST, search.most - 1)
    best = _course_among(search, parts, range(first, last + 1), samples)
    if best is None or best.statistic < CERTAIN:
        return None
    return best if abs(best.course.change) > LEAST[best.course.kind] else None


def _course_among(
    search: Search, parts: Sequence[Blocks], counts: range, samples: float
) -> Followed | None:
    """The best course with delays among these."""
    sums = [search.over(k, parts) for k in counts]
    every, either = np.arange(len(parts)), np.array([[-1], [0], [1]])

    def at(places: Float[np.ndarray, " parts"]) -> Float[np.ndarray, "counts parts"]:
        """Weights of delays for each part at its place between them."""
        nearest = np.clip(np.round(places).astype(int), 1, len(counts) - 2)
        weights = np.zeros((len(counts), every.size))
        weights[nearest + either, every] = parabola(places - nearest)
        return weights

    places, bend = np.full(every.size, len(counts) // 2, float), np.ones(every.size)
    reach = 3.0 if len(counts) == 3 else 1.0
    for _ in range(TURNS):
        solved = search.solve(weighed(sums, at(places)))
        if not np.isfinite(solved.left):
            return None
        # Where each part leaves least, and how sharply; not sharply at all where it is at an end.
        left = np.array([search.energy(stages, solved.values) for stages in sums])
        lowest = np.clip(np.argmin(left, axis=0), 1, len(counts) - 2)
        low, here, high = left[lowest + either, every]
        bend = low - 2 * here + high
        moved = 0.5 * (low - high) / np.where(bend > 0, bend, 1.0)
        bend = np.where((bend > 0) & (np.abs(moved) < reach), bend, 0.0)
        places = lowest + np.clip(moved, -reach, reach)
    edges = [round(samples * float(edge)) for edge in (0, *(part[-1] + 1 for part in parts))]
    ends = np.array(list(itertools.pairwise(edges)), float).T
    told = bend > 0
    delays = np.stack([places + counts[0], 1 / np.sqrt(np.where(told, bend, 1.0)), *ends])[:, told]
    if delays.shape[1] < FEWEST:
        return None
    course, left = changing(delays, edges)
    weight = delays[1] ** -2.0
    steady = float(weight @ (delays[0] - weight @ delays[0] / weight.sum()) ** 2)
    statistic = (steady - left) / max(left / (delays.shape[1] - 3), 1e-12 * steady, 1e-300)
    # Of all parts but the one that leaves most: a jump within it is not undone.
    weights = at(places)
    values = search.solve(weighed(sums, weights)).values
    left_of_parts = np.sum(weights * [search.energy(stages, values) for stages in sums], axis=0)
    weights[:, np.argmax(left_of_parts)] = 0.0
    return Followed(course, search.solve(weighed(sums, weights)), statistic)


LEVEL = 1e-3
"""Probability by chance, over all signals, below which a delay is told."""
SMALLEST = 0.02
"""Samples below which a delay is the quadrature's, which has no more accuracy."""
UNEXPLAINED = 0.1
"""Share of the energy left beyond noise that a delay leaves at most if it is the cause."""
OF_NOISE = 0.07
"""The same as a share of what noise leaves: no closer is known how much that is."""
MOVES = 1.0
"""Standard errors by which it moves some parameter at the least."""
LONGEST = 32
"""Samples of the longest delay that is looked for."""
LONGEST_SHARE = 20
"""It is at most this part of a record."""
MOST_SAMPLES = 2**17
"""Samples of each record that are looked at: a delay needs no more."""
FEWEST_GROUPS = 6
"""Blocks of time below which their scatter says too little."""
VISIBLE = 0.003
"""Rms left beyond noise, over the target, from which a delay that changes is looked for."""
CLEARER = 4.0
"""Times as much energy that the other of delay and low-pass leaves where one of them is named."""
MOST_LAGS = 4
"""Multiples of the delay up to which a low-pass is looked for."""


class SignalDelay(NamedTuple):
    """How late signals are against the equations that read them.

    **Fields:**

    - `signals`, which one clock samples: a motion and its derivatives go together.
    - `seconds` that they are late; negative if all others are. `error`: its standard error;
      `reach`, half an interval of level 1 - `LEVEL`.
    - `time_step` in seconds.
    - `left` and `left_as_recorded`: what the fit leaves beyond noise, rms over the target's, with
      the signals advanced by `seconds` and as they are; `noise`, what noise leaves.
    - `moved`: how much larger each parameter is with the signals advanced, over its value as it is.
    - `low_passed`: whether they are rather behind a first-order low-pass of that time constant;
      `otherwise`, what the other of the two leaves.
    - `course`: how the delay changes along a single record, where that is what explains most;
      `left` and `moved` are then of each part at its own delay.
    """

    signals: tuple[str, ...]
    seconds: float
    error: float
    reach: float
    time_step: float
    left_as_recorded: float
    left: float = 0.0
    noise: float = 0.0
    moved: Mapping[str, float] = {}
    low_passed: bool = False
    otherwise: float = 0.0
    course: Course = Course()

    def leaving(self, before: Solved, after: Solved) -> "SignalDelay":
        """The same with what is found of the signals as they are, and once it is undone."""
        moved = {n: after.values[n] / before.values[n] - 1 for n in after.free if before.values[n]}
        left = max(after.left, 0.0)
        return self._replace(left=left**0.5, noise=after.noise**0.5, moved=moved)

    @property
    def samples(self) -> float:
        """The delay in samples."""
        return self.seconds / self.time_step

    @property
    def significant(self) -> bool:
        """Whether it is more than chance and quadrature make."""
        large = abs(self.seconds) > self.reach and abs(self.samples) > SMALLEST
        return large or self.course.kind != "steady"

    @property
    def explains(self) -> bool:
        """Whether the fit leaves hardly more than noise with the signals advanced."""
        most = max(UNEXPLAINED * self.left_as_recorded**2, OF_NOISE * self.noise**2)
        return self.left**2 <= most

    @property
    def certain(self) -> bool:
        """Whether it is told apart what makes them late, a delay or a low-pass."""
        least = max(CLEARER * self.left**2, OF_NOISE * self.noise**2)
        return self.otherwise**2 > least


def signal_delays(model: Model, records: Sequence[Record], estimate: Estimate) -> list[SignalDelay]:
    """The delay of each input, and of each motion against the first (not under jit).

    Of one that is late it is told whether a first-order low-pass explains it better. None are
    looked for in models with hidden elements or parameters of each recording, with windows
    drawn at random, and in records too short for their blocks to scatter.

    **Raises:** as `summarise`.
    """
    criterion, step = estimate.criterion, float(records[0].time_step)
    own = any(estimate.table[name].recording is not None for name in estimate.parameters)
    if model.has_hidden or own or criterion.all_windows is None or estimate.summary is None:
        return []
    records = [each.part(0, min(each.sample_count, MOST_SAMPLES)) for each in records]
    reach = min(LONGEST, min(each.sample_count for each in records) // LONGEST_SHARE)
    read = {n for each in records for n in signals_read(model, each, criterion, summed=True)}
    groups = _clocks(model, read)
    if reach < 3 or int(estimate.block_count) < FEWEST_GROUPS or not groups:
        return []
    level, unmoved = LEVEL / len(groups), {}
    every: list[tuple[SignalDelay, Search]] = []
    for signals in groups:
        # Without a shift all are the same records. Filters describe their noise otherwise.
        search = Search(
            model, estimate, records, signals, advanced, step, reach, reach, {**unmoved}
        )
        unmoved = {0: search.sums(0)}
        late = search.delay(level)
        if late is not None and late.significant and late.seconds > 0:
            lagged = Search(
                model, estimate, records, signals, unfiltered, late.seconds, reach, MOST_LAGS, {}
            ).delay(level)
            if lagged is not None:
                nearer, other = sorted((late, lagged), key=lambda each: each.left)
                late = nearer._replace(low_passed=nearer is lagged, otherwise=other.left)
        every += [] if late is None else [(late, search)]
    every.sort(key=lambda each: each[0].left)
    delays = [late for late, _ in every]
    if len(records) == 1 and delays and not delays[0].explains and delays[0].left > VISIBLE:
        best, search = every[0]
        followed = course_of(search, round(best.samples), criterion.block_samples(records[0]))
        if followed is not None:
            best = best._replace(course=followed.course, low_passed=False)
            delays[0] = best.leaving(search.solved(0, 0.0), followed.solved)
    return delays


def late_signals(model: Model, records: Sequence[Record], estimate: Estimate) -> list[Finding]:
    """`late_signal`, `low_passed`, `two_clocks` or `lost_rows`: what explains most of what is left.

    **Raises:** as [`signal_delays`][].
    """
    cause = late_cause(model, records, estimate)
    return [finding_of(cause, records[0])] if cause is not None else []


def late_cause(model: Model, records: Sequence[Record], estimate: Estimate) -> SignalDelay | None:
    """The delay that explains nearly all of what is left, if one does.

    **Raises:** as [`signal_delays`][].
    """
    delays = signal_delays(model, records, estimate)
    errors = dict(zip(estimate.parameters, np.asarray(estimate.standard_errors, float)))

    def matters(one: SignalDelay) -> bool:
        """Whether it moves some parameter by more than chance does."""
        changes = {name: share * float(estimate[name]) for name, share in one.moved.items()}
        return any(abs(change) > MOVES * errors[name] for name, change in changes.items())

    causes = [one for one in delays if one.significant and one.explains and matters(one)]
    # One equation blames either of its signals; all together, the one that they read.
    return max(causes, key=lambda one: one.left_as_recorded**2 - one.left**2, default=None)


def finding_of(one: SignalDelay, record: Record) -> Finding:
    """What is told of a delay, seen in a record and others."""
    names, course, then = " and ".join(one.signals), one.course, ""
    lasts = course.lasts
    milliseconds = f"{1e3 * abs(one.seconds):.3g} ms"
    size = f"{milliseconds} ({abs(one.samples):.3g} samples, +-{1e3 * one.reach:.2g} ms)"
    time = np.asarray(record.elapsed)
    if course.kind == "clocks":
        # Clocks go on through pauses.
        samples = float(time[-1] - time[0]) / one.time_step / (time.size - 1)
        rate = 1e6 * course.change / (course.place[1] - course.place[0]) / samples
        code, start = "two_clocks", float(time[0])
        remedy = course.by_one_clock(one.signals, rate, one.time_step, start)
        what = (
            f"{names} {course.way} the others evenly, {lasts}: its clock differs by {rate:.3g} ppm"
        )
        step = f"Set the clock of {names}, or record it by that of the others"
    elif course.kind == "rows":
        first, last = (time[min(place + LONGEST, time.size - 1)] for place in course.place)
        code, remedy = "lost_rows", course.in_time(first, last)
        what = (
            f"the delay of {names} jumps {lasts} between {first:.4g} and {last:.4g} s: "
            f"{'all others have' if course.change > 0 else 'it has'} lost rows there"
        )
        step = "Use the part of the record in which it is in time"
    elif one.low_passed and one.certain:
        code, remedy = "low_passed", option_for("--unfilter", one.signals, f"{one.seconds:.4g}")
        what = (
            f"{names}: behind a first-order low-pass with a time constant of {size}, a cut-off at "
            f"{1 / (2 * np.pi * one.seconds):.3g} Hz"
        )
        then = f"Record it without that filter, or undo it ({shlex.join(remedy)})."
        step = f"Undo the low-pass of {names}"
    else:
        code, remedy = "late_signal", option_for("--shift", one.signals, f"{one.seconds:.4g}")
        verb = "Delay"
        way = "earlier than the equation says: all others are late, or low-passed"
        if one.seconds > 0:
            verb = "Advance"
            way = f"later than the equation says{'' if one.certain else ', or low-passed'}"
        what = f"{names} come{'s' * (len(one.signals) == 1)} {size} {way}"
        then = f"Shift it (on the command line: {shlex.join(remedy)}), or record all by one clock."
        step = f"{verb} {names} by {milliseconds}"
    if course.kind == "steady":
        most = max(one.moved, key=lambda name: abs(one.moved[name]))
        then = f", and {most} changes by {100 * one.moved[most]:+.2g} %. {then}"
    else:
        then = f". {step}{f' ({shlex.join(remedy)})' if remedy else ''}."
    return Finding(
        code,
        f"{what}. With that taken off, the model leaves {100 * one.left:.2g} % of the target "
        f"beyond noise instead of {100 * one.left_as_recorded:.2g} %{then}",
        one.signals,
        tuple(one.moved),
        doubts={name: abs(share) for name, share in one.moved.items()},
        remedy=remedy,
        step=step,
    )


def _clocks(model: Model, read: set[str]) -> list[tuple[str, ...]]:
    """Signals that are shifted together: inputs one by one, a motion with its derivatives.

    All at once cannot be late against an equation, so that the first body's motion is left out, or
    the first signal.
    """
    groups: list[set[str]] = [{name} for name in sorted(read)]
    for equation in model.equations:
        for pair in equation.derivatives:
            one = set().union(*(g for g in groups if g & {*pair}))
            groups = [g for g in groups if not g & {*pair}] + ([one] if one else [])
    bodies = [name for e in model.equations for name in accelerated(e)]
    groups.sort(key=lambda g: (not g & {*bodies[:1]}, sorted(g)))
    return [tuple(sorted(g)) for g in groups[1:]]


def advanced(record: Record, signals: Sequence[str], shift: float, reach: int) -> Record:
    """A record without `reach` samples at either end, some signals advanced by whole samples."""
    shift = round(shift)
    n = record.sample_count
    moved = record.select(*signals).part(reach + shift, n - reach + shift)
    return record.part(reach, n - reach).with_signals(moved.by_name)


def unfiltered(record: Record, signals: Sequence[str], lag: float, reach: int) -> Record:
    """The same with a first-order low-pass of a time constant in samples taken off them."""
    near = record.part(reach - SLOPE.size // 2, record.sample_count - reach + SLOPE.size // 2)
    return near.through(lead(near, lag * float(record.time_step)), *signals)

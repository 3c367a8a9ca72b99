"""Rows of a model's equations over windows, with a column for each thing that may be amiss.

The residual of an equation is `r = y - sum_j theta_j D^k phi_j(s)`. A sensor that shows `s + a d`
in place of `s`, where `a` is how much and `d` a course in time, adds to first order

    a c,    c = D^k (d phi / d s) d

to it: a column that is known, since `theta` is. So a zero has `d = 1`, a gain `d = s`, a drift
`d = t`, a delay `d = -s'` (per second), two clocks `d = -s' t`, rows that were lost at `t0`
`d = -s' [t > t0]`; a term that the model lacks is its own column. The slope `d phi / d s` is a
difference of the equation's own columns, taken for one signal after the other, and the derivatives
stay on the test function.

Rows are integrals over windows that are spread evenly over starts and lengths: a few thousand tell
as much as all windows do, since these overlap. Their products by folds of time are all that is
tested. What noise adds to them is measured: noise as each sensor's is put through the same columns,
to first order, and its products are subtracted.

Parameters are free in each stage, those that an earlier stage has found too, as far as the stage
tells them apart: so no error of an earlier stage is taken for a fault of a sensor.

Plausible sizes, beyond which a doubt of a sensor is no cause, are shares of what a signal does: a
zero or drift of `REACH` times its range, a delay of `LONGEST` samples or of `LONGEST_TIME`, and of
a part of the record.
"""

import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Int

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.windows import WindowSet
from riecjax.equations.element import Element
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.equations.noisy_columns import Columns, sampled_columns
from riecjax.equations.term import AbstractTerm
from riecjax.estimation.estimate import Estimate
from riecjax.folds import FOLDS, Folds
from riecjax.linear_algebra import unit_diagonal
from riecjax.records.record import Record

ROWS = 4096
"""Windows of all records together."""
MOST_SAMPLES = 2**17
"""Samples of each record that are looked at: no doubt needs more; and of columns at once, which a
processor's cache holds."""
PROBES = {"": 0, "plain": 2, "all": 8}
"""Noises that are put through the columns, by whose noise is taken off."""
BLOCK = 2
"""Longest windows to a fold of time at least."""
GOLDEN = 0.5 * (5**0.5 - 1)
"""Multiples of it lie evenly between whole numbers (Weyl), however many there are."""
APART = 1e-4
"""Least eigenvalue of a stage's correlations with which parameters of earlier stages are free."""
STATES = "hysteresis"
"""The kind of a state of some width, of which the best is a cause. Dry friction is one of no width,
so that a state explains as much as that does, and is named in the place of nothing."""
SLIGHT = 1e-3
"""Share of a signal's deviation over which slopes are taken, where there is less noise."""

Samples = Float[np.ndarray, " n"]
Values = Float[np.ndarray, "orders n"]
Windowed = Float[np.ndarray, "columns rows"]
Course = Callable[[Samples, Samples, Samples], Samples]
"""Of a signal's samples, their rate and their time in seconds from the record's middle, how a fault
of unit size changes them."""


@dataclass(frozen=True)
class Lacked:
    """What an element that an equation lacks makes of a term, from rest on: a filtered signal.

    **Fields:** `element`; the signal whose derivative of an `order` its term is of, and the `sign`
    of that in the equation; where its shape is on the element's `rough_axes`.
    """

    element: Element
    signal: str
    order: int
    sign: float
    at: tuple[float, ...]

    def response(self, s: Complex[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
        """Of the element's filter as Laplace transforms it, less the signal itself."""
        shape = self.element.rough_shape(self.at)
        less = np.asarray(shape.numerator) - np.asarray(shape.denominator)
        below = np.polyval(np.asarray(shape.denominator)[::-1], s)
        return self.sign * np.polyval(less[::-1], s) / below


@dataclass(frozen=True, eq=False)
class Doubt:
    """What may be amiss: a column.

    **Fields:** `name`, of its column; `kind`; the `signals` that it changes, all by one `course`;
    or the `term` that an `equation` may lack, by its `meaning`, with `elements`, whose states
    it reads and recordings lack; or what is `lacked` of an element of it.
    """

    name: str
    kind: str
    signals: tuple[str, ...] = ()
    course: Course | None = None
    term: AbstractTerm | None = None
    equation: str = ""
    meaning: str = ""
    lacked: Lacked | None = None
    elements: tuple[Element, ...] = ()


class _Part(NamedTuple):
    """What is looked at of one record: windows by ascending start, the fold of time that each
    belongs to, and noisy `copies`."""

    record: Record
    drawn: WindowSet
    fold: Int[np.ndarray, " rows"]
    copies: Sequence[tuple[Record, Record]]


def _parts(criterion: AbstractCriterion, records: Sequence[Record], probes: int) -> list[_Part]:
    """Of each record windows of all lengths, spread evenly; in folds of two longest ones."""
    assert criterion.windows is not None
    multiple = criterion.test_function.length_multiple
    spans = [record.sample_count * float(record.time_step) for record in records]
    longest = BLOCK * float(criterion.windows.beta)
    folds = int(np.clip(sum(spans) / longest, 1, FOLDS))
    found, before = [], 0.0
    for record, span in zip(records, spans):
        size = record.sample_count
        first, last = criterion.windows.every.lags(record, multiple)
        count = max(int(ROWS * span / sum(spans)), 1)
        at = np.arange(count)
        length = multiple * (int(first) + (at * GOLDEN % 1 * (last - first + 1)).astype(int))
        start = ((at + 0.5) / count * (size - length)).astype(int)
        order = np.argsort(start, kind="stable")
        start, length = start[order], length[order]
        time = before + start * float(record.time_step)
        fold = np.minimum((time / sum(spans) * folds).astype(int), folds - 1)
        copies = [_noisy_copies(record, number) for number in range(probes)]
        found.append(_Part(record, WindowSet(start, start + length), fold, copies))
        before += span
    return found


def _noisy_copies(record: Record, number: int) -> tuple[Record, Record]:
    """The record with noise as each sensor's added, and with the same noise subtracted."""
    rng = np.random.default_rng(number)
    white = {s: rng.standard_normal(record.sample_count) for s in record.noise.sources}
    above, below = {}, {}
    for name, kernels in record.noise.kernels.items():
        if name not in record.arrays or not kernels:
            continue
        signal = record.signal(name)
        noise = sum(np.convolve(white[s], taps, mode="same") for s, taps in kernels.items())
        above[name] = replace(signal, values=signal.values + noise)
        below[name] = replace(signal, values=signal.values - noise)
    return record.with_signals(above), record.with_signals(below)


class _Rows(NamedTuple):
    """Of one equation: names of columns behind the target, rows by window, and what noise adds to
    their products by fold of time."""

    names: tuple[str, ...]
    rows: Windowed
    noise: Float[np.ndarray, "folds columns columns"]

    def among(self, names: Sequence[str], known: Mapping[str, float]) -> "_Rows":
        """Rows of these columns, zero where there is none, with what is known in the target."""
        mix = np.zeros((1 + len(names), 1 + len(self.names)))
        mix[0] = [1.0, *(-known.get(name, 0.0) for name in self.names)]
        there = [name for name in names if name in self.names]
        at, own = ([1 + among.index(name) for name in there] for among in (names, self.names))
        mix[at, own] = 1.0
        rows = np.zeros((1 + len(names), self.rows.shape[1]))
        rows[0], rows[at] = mix[0] @ self.rows, self.rows[own]
        return _Rows(tuple(names), rows, mix @ self.noise @ mix.T)


def _products(
    rows: Windowed, fold: Int[np.ndarray, " windows"], count: int
) -> Float[np.ndarray, "folds columns columns"]:
    """Sums of products of rows by fold of their windows, in which these ascend; of one equation
    after the other."""
    edges = np.searchsorted(fold, np.arange(count + 1)).tolist()
    of_equations = rows.reshape(len(rows), -1, fold.size)
    parts = (of_equations[:, :, a:b].reshape(len(rows), -1) for a, b in itertools.pairwise(edges))
    return np.stack([part @ part.T for part in parts])


class Asked(NamedTuple):
    """What is doubted: a `model` with `values` of all parameters, some of them `known`, by all
    windows of a `criterion`; the columns of parameters, where it is known which are free, `base`;
    some of the `stages` alone.
    """

    model: Model
    criterion: AbstractCriterion
    values: Mapping[str, float]
    known: Mapping[str, float]
    base: Collection[str] = ()
    stages: Collection[int] = ()

    @property
    def equations(self) -> Iterator[tuple[int, str, Equation]]:
        """Each equation of the model, with its stage and its name."""
        of_stages = zip(self.model.equation_names, self.model.stages)
        for number, both in enumerate(of_stages):
            yield from ((number, *one) for one in zip(*both, strict=True))

    @property
    def resting_on_earlier(self) -> set[str]:
        """Names of equations that take what earlier stages found as known: what these leave may be
        an error of those."""
        resting, earlier = set[str](), set[str]()
        for number, (names, stage) in enumerate(zip(self.model.equation_names, self.model.stages)):
            for name, equation in zip(names, stage, strict=True):
                taken = earlier & {*equation.parameters} - {*self.known}
                if any(f"{number}.{one}" not in self.base for one in taken):
                    resting.add(name)
            earlier |= {name for equation in stage for name in equation.parameters}
        return resting

    def with_values(self, found: Mapping[str, float]) -> "Asked":
        """The same with the values of columns, each parameter's in the first stage that has it."""
        values = dict(self.values)
        for column, value in reversed([*found.items()]):
            _, stage, name = column.rpartition(".")
            if stage and name in values:
                values[name] = float(value)
        return self._replace(values=values)

    @classmethod
    def of(cls, model: Model, estimate: Estimate) -> "Asked":
        """A model's estimate."""
        values = {name: float(value) for name, value in estimate.values.items()}
        known = {name: float(value) for name, value in estimate.known.items()}
        return cls(model, estimate.criterion, values, known)


def _rows(
    asked: Asked,
    plain: Equation,
    larger: Equation,
    doubts: Sequence[Doubt],
    noise: str,
    part: _Part,
    folds: int,
) -> _Rows:
    """Rows of one equation on one record, and what the noise of its copies makes of them.

    **Arguments:** the equation as it is, `plain`, and `larger` by terms that it may lack; `doubts`
    of sensors, and of its elements; whose `noise` is taken off.
    """
    record, criterion, smoothness = part.record, asked.criterion, asked.criterion.smoothness
    read, every = plain.signals_read(record, smoothness), noise == "all"
    sensors = [one for one in doubts if one.course is not None and read & {*one.signals}]
    filters = [one.lacked for one in doubts if one.lacked is not None]
    touched = sorted({name for doubt in sensors for name in doubt.signals if name in read})
    slopes = {name: _slope(asked, plain, record, name) for name in touched}
    time = np.asarray(record.elapsed, float)
    time = time - 0.5 * (time[0] + time[-1])
    own, terms = [criterion.noisy_columns(plain, record).columns], larger.terms[len(plain.terms) :]
    lacked = plain.of_terms(*terms) if terms else None
    if lacked is not None:
        noisy = criterion.noisy_columns(lacked, record) if every else None
        own.append(noisy.columns if noisy else sampled_columns(lacked, record, smoothness))
    masks = [each.present for each in own if each.present is not None]
    present = np.all(masks, axis=0) if masks else None

    def by_column(*of: Columns) -> Iterator[Values]:
        for number, each in enumerate(of):  # of the first its target, too
            yield from np.moveaxis(each.values, 1, 0)[min(number, 1) :]

    def changed(of: Record) -> Iterator[Values]:
        samples = {name: np.asarray(of.arrays[name], float) for name in touched}
        rates = {name: np.gradient(samples[name], float(of.time_step)) for name in touched}
        for doubt in sensors:
            own, course = [name for name in doubt.signals if name in slopes], doubt.course
            assert course is not None
            parts = (slopes[n] * course(samples[n], rates[n], time) for n in own)
            yield sum(parts, start=np.zeros(time.size))

    def filtered(of: Record) -> Iterator[Values]:
        # Twice as long, so that no end of the response comes round.
        size = 2 * int(scipy.fft.next_fast_len(time.size, real=True) or time.size)
        s = 2j * np.pi * np.fft.rfftfreq(size, float(of.time_step))
        samples = {name: np.asarray(of.arrays[name]) for name in {f.signal for f in filters}}
        spectra = {name: np.fft.rfft(x - x.mean(), size) for name, x in samples.items()}
        for one in filters:
            column = np.zeros((1 + smoothness, time.size))
            behind = np.fft.irfft(spectra[one.signal] * one.response(s), size)
            column[one.order] = behind[: time.size]
            yield column

    def integrated(columns: Iterable[Values]) -> Windowed:
        rows, columns = [], iter(columns)
        while some := [*itertools.islice(columns, max(MOST_SAMPLES // time.size, 1))]:
            values, names = np.stack(some, axis=1), ("",) * (len(some) - 1)
            made = Columns(values, present, own[0].time_step, names)
            found, valid = criterion.test_function.integrals(made, part.drawn)
            rows.append(found if valid is None else np.where(valid, found, 0.0))
        return np.concatenate(rows)

    def read_of(side: Record) -> Iterator[Values]:
        equations = [plain, *([lacked] if lacked and every else [])]
        yield from by_column(*(sampled_columns(e, side, smoothness) for e in equations))
        yield from itertools.chain(changed(side), filtered(side)) if every else ()

    columns = [name for each in own for name in each.parameters]
    columns += [one.name for one in (*sensors, *(one for one in doubts if one.lacked))]
    rows = integrated(itertools.chain(by_column(*own), changed(record), filtered(record)))
    added = np.zeros((folds, len(rows), len(rows)))
    if any(record.noise.kernels.get(name) for name in read):
        for sides in part.copies:
            made = integrated(0.5 * (high - low) for high, low in zip(*map(read_of, sides)))
            at = slice(len(made))
            added[:, at, at] += _products(made, part.fold, folds) / len(part.copies)
    return _Rows(tuple(columns), rows, added)


def _slope(asked: Asked, equation: Equation, record: Record, name: str) -> Values:
    """How the residual changes with a signal."""
    signal = record.signal(name)
    size = max(float(record.noise.std(name)), SLIGHT * float(np.std(signal.values))) or 1.0
    sides = (replace(signal, values=signal.values + size * sign) for sign in (1, -1))
    records = (record.with_signals({name: side}) for side in sides)
    smoothness = asked.criterion.smoothness
    high, low = (sampled_columns(equation, each, smoothness).values for each in records)
    row = np.array([1.0, *(-asked.values[name] for name in equation.parameters)])
    return np.einsum("j,ojn->on", row, high - low) / (2 * size)


def folds_of(
    asked: Asked,
    records: Sequence[Record],
    doubts: Sequence[Doubt],
    noise: Literal["", "plain", "all"] = "all",
) -> Folds:
    """Products of target, parameters and doubts by folds of time, all stages together, each over
    the size of its target.

    Parameters of a stage are called `stage.parameter`, and doubts by their names.

    **Arguments:** `noise` that is taken off the products of `all` columns, of the `plain` ones of
    parameters alone, or of none.
    """
    model, values, terms = asked.model, asked.values, dict[str, list[AbstractTerm]]()
    for doubt in doubts:
        if doubt.term is not None:
            terms.setdefault(doubt.equation, []).append(doubt.term)
    records = [each.part(0, min(each.sample_count, MOST_SAMPLES)) for each in records]
    for element in (*model.elements, *(each for doubt in doubts for each in doubt.elements)):
        records = [element.with_states(record) for record in records]
    parts = _parts(asked.criterion, records, PROBES[noise])
    fold = np.concatenate([each.fold for each in parts])
    count = 1 + int(fold[-1])
    earlier, stages = dict[str, float](), list[_Rows]()
    larger = model.with_terms(terms) if terms else model
    for number, (equations, further) in enumerate(zip(model.stages, larger.stages, strict=True)):
        if not asked.stages or number in asked.stages:
            rows = []
            names = model.equation_names[number]
            for name, plain, with_all in zip(names, equations, further, strict=True):
                some = [one for one in doubts if one.lacked is None or one.equation == name]
                own = (_rows(asked, plain, with_all, some, noise, one, count) for one in parts)
                rows.append(_joined([*own]))
            stages.append(_of_stage(rows, f"{number}.", asked, earlier, {d.name for d in doubts}))
        earlier |= {n: values[n] for e in equations for n in e.parameters if n in values}
    names = tuple(dict.fromkeys(name for stage in stages for name in stage.names))
    samples = np.zeros((count, 1 + len(names), 1 + len(names)))
    added = np.zeros_like(samples)
    for stage in stages:
        energy = float(np.mean(stage.rows[0] ** 2)) or 1.0
        at = np.array([0, *(1 + names.index(name) for name in stage.names)])
        samples[:, at[:, None], at] += _products(stage.rows, fold, count) / energy
        added[:, at[:, None], at] += stage.noise / energy
    return Folds(samples, samples - added, names)


def _joined(parts: Sequence[_Rows]) -> _Rows:
    """Rows of one equation on one record after the other."""
    rows = np.concatenate([part.rows for part in parts], axis=1)
    return _Rows(parts[0].names, rows, np.sum([part.noise for part in parts], axis=0))


def _of_stage(
    parts: Sequence[_Rows],
    prefix: str,
    asked: Asked,
    earlier: Mapping[str, float],
    doubts: Collection[str],
) -> _Rows:
    """Rows of all equations of a stage.

    Parameters that `earlier` stages found are free where the stage tells them from its own, and
    something is left for it to explain.
    """
    every = list(dict.fromkeys(name for part in parts for name in part.names))

    def with_known(known: Mapping[str, float]) -> _Rows:
        free = [name for name in every if name not in known]
        return _joined([part.among(free, known) for part in parts])

    free = [name for name in every if f"{prefix}{name}" not in asked.base]
    known = {name: earlier[name] for name in free if name in earlier} | {**asked.known}
    found = with_known(known if asked.base else asked.known)
    if known.keys() - asked.known and not asked.base:
        at = [i for i, name in enumerate(found.names, 1) if name not in doubts]
        gram = found.rows[at] @ found.rows[at].T - found.noise.sum(0)[np.ix_(at, at)]
        apart = np.all(np.diagonal(gram) > 0) and bool(np.any(found.rows[0]))
        if not apart or np.linalg.eigvalsh(unit_diagonal(gram)[0])[0] < APART:
            found = with_known(known)
    names = tuple(name if name in doubts else f"{prefix}{name}" for name in found.names)
    return found._replace(names=names)


LONGEST, LONGEST_TIME = 32, 0.02
"""Samples of the longest delay that is looked for, and seconds where these are more."""
LONGEST_SHARE = 20
"""It is at most this part of a record."""
REACH = 3.0
"""Ranges of a signal, its mean included, that its zero is off by at the most."""
GAIN = 0.5
"""The most that a gain is off by: other units and signs are seen before. That of a whole target,
whose column explains the target by itself, is one."""
JUMPS = 7
"""Places along a record at which rows may have been lost."""


def clocks_of(model: Model, read: set[str]) -> list[tuple[str, ...]]:
    """Signals that are shifted together: inputs one by one, a motion with its derivatives.

    All at once cannot be late against an equation, so that the first body's motion is left out, or
    the first signal.
    """
    groups: list[set[str]] = [{name} for name in sorted(read)]
    for equation in model.equations:
        for pair in equation.derivatives:
            one = set().union(*(g for g in groups if g & {*pair}))
            groups = [g for g in groups if not g & {*pair}] + ([one] if one else [])
    bodies = [name for e in model.equations for name in e.accelerated]
    groups.sort(key=lambda g: (not g & {*bodies[:1]}, sorted(g)))
    return [tuple(sorted(g)) for g in groups[1:]]


def longest_delay(records: Sequence[Record]) -> int:
    """Samples of the longest delay that is looked for in records."""
    longest = max(LONGEST, int(LONGEST_TIME / float(records[0].time_step)))
    return min(longest, min(each.sample_count for each in records) // LONGEST_SHARE)


def delay_of(signals: tuple[str, ...]) -> Doubt:
    """That signals come late, in seconds."""
    name = f"delay of {' and '.join(signals)}"
    return Doubt(name, "delay", signals, lambda samples, rate, time: -rate)


def zero_of(name: str) -> Doubt:
    """That a signal is off by a constant."""
    return Doubt(f"zero of {name}", "zero", (name,), lambda samples, *_: np.ones_like(samples))


def drift_of(name: str) -> Doubt:
    """That a signal drifts by one along a record."""
    return Doubt(f"drift of {name}", "drift", (name,), lambda *of: _share(of[-1]))


def courses_of(signals: tuple[str, ...]) -> Iterator[Doubt]:
    """That their delay changes along a record, steadily or by a jump: by one second over it."""
    name = " and ".join(signals)
    yield Doubt(f"clock of {name}", "clock", signals, lambda _, rate, time: -rate * _share(time))
    for place in np.linspace(-0.5, 0.5, JUMPS + 2)[1:-1]:

        def jump(samples: Samples, rate: Samples, time: Samples, place: float = place) -> Samples:
            return np.where(_share(time) > place, -rate, 0.0)

        yield Doubt(f"rows of {name} at {place:.3f}", "clock", signals, jump)


def _share(time: Samples) -> Samples:
    """Of the record's time, from -1/2 to 1/2."""
    return time / np.ptp(time)


def sensors(model: Model, records: Sequence[Record], read: set[str]) -> list[Doubt]:
    """What may be amiss with the sensors of the signals that are read, inputs first."""
    found, is_single = list[Doubt](), len(records) == 1
    for signals in clocks_of(model, read):
        found += [delay_of(signals), *(courses_of(signals) if is_single else ())]
    known = {t.signal for e in model.equations for t in e.terms if not t.parameters}
    for name in sorted(read, key=lambda name: (name not in known, name)):
        gain = Doubt(f"gain of {name}", "gain", (name,), lambda samples, *_: samples)
        found += [zero_of(name), gain, *([drift_of(name)] if is_single else ())]
    return found


def plausible(doubts: Sequence[Doubt], records: Sequence[Record]) -> Mapping[str, float]:
    """The largest size of each doubt of a sensor."""
    step, sizes = float(records[0].time_step), {}
    for doubt in doubts:
        samples = [np.asarray(r.arrays[s], float) for r in records for s in doubt.signals]
        if doubt.kind in ("zero", "drift"):
            sizes[doubt.name] = REACH * max(np.ptp(one) + abs(np.mean(one)) for one in samples)
        elif doubt.kind == "gain":
            sizes[doubt.name] = GAIN
        elif doubt.signals:
            sizes[doubt.name] = longest_delay(records) * step
    return sizes

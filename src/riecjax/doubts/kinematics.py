"""Sensors of one motion: each signal whose derivative is recorded is an equation of its own.

That v is the derivative of x, or x3 - x4 that of x2, is an equation without unknown parameters,

    x2' = g3 x3 - g4 x4,

in which each g is 1. Summed over hat windows right after reading, no sample differentiated, it is
asked what may be amiss as any other: whether a signal is late, behind a low-pass, by another
clock, short of rows, off by a zero or a drift. What is found is undone and the equation summed
again, until nothing more is; then the g say what is off in size. Wrong units, signs and channels
are sizes too.

A pair shows differences alone: whether v is late or x early, whether v has an offset or x drifts,
it cannot tell, nor what both have in common, as a delay of both against the force.
"""

import itertools
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from riecjax.criteria.criterion import RIEC
from riecjax.criteria.test_functions import Hat
from riecjax.criteria.windows import AllWindows
from riecjax.doubts.causes import CLEARER, LEVEL, UNEXPLAINED, Causes
from riecjax.doubts.causes import FEWEST as FEWEST_FOLDS
from riecjax.doubts.columns import (
    MOST_SAMPLES,
    Asked,
    Doubt,
    courses_of,
    delay_of,
    drift_of,
    folds_of,
    zero_of,
)
from riecjax.doubts.delays import SMALLEST, Settled, settled_at
from riecjax.doubts.equation_faults import Cause, Equated, Weighing, finding_of
from riecjax.equations.equation import Equation
from riecjax.equations.model import as_model
from riecjax.equations.term import Term
from riecjax.errors import DataError
from riecjax.findings import SMOOTH, Finding, in_percent
from riecjax.folds import Folds, Told
from riecjax.records.faults.rows import cut_rows
from riecjax.records.faults.spikes import repair_outliers
from riecjax.records.noise_judgement import judged_surely
from riecjax.records.preparation.steps import undone
from riecjax.records.reading.units import readings
from riecjax.records.record import Record
from riecjax.records.relations import Pairs, Relation, relations, summed, with_sum

SHORTEST, FEWEST = 8, 24
"""Samples of the longest windows at the least, of which the shortest are an eighth; and how many of
them a record has. They are as long as a period of the usual motion, if that is longer."""
START, SMALL = 16, 3e-5
"""Samples of the longest windows that are tried first, and the share of noise that is small."""
MOST_NOISE = 0.5
"""Share of the derivative's energy that must be motion for anything to be told."""
TINY = 1e-70
"""Deviation of a signal whose products are numbers still."""
MOVING = 0.01
"""Energy that is left of a fold of time, over that of the one with most, where it counts."""
ALIKE = 0.9
"""Share of its energy that a signal explains of the derivative that it is."""
ROUGHLY = 0.5
"""Size over that of an integral, and correlation with it, from which one is looked at closely."""
ROUGH = 0.5
"""Mean square of a signal's steps, over its variance, past which none is looked at in a sum: of
white noise it is 2, of noise up to an eighth of the sampling rate 0.2. What is too fast has an
integral that depends on what it does between samples."""
MOST = 3
"""Causes that are undone one after the other."""
GROSS = 0.1
"""Share by which sensors of one motion may differ in gain: more than any calibration leaves."""
GAIN = 0.01
"""Share by which a gain must be off; more than a calibration leaves is 2 %."""
OFFSET = 0.002
"""Share of the derivative's rms past which its offset, or its drift over the record, matters."""
UNRELATED = 0.25
"""Share of the derivative's energy that must be explained for signals to belong to one motion."""
CLEAR = 4.0
"""Standard errors by which gains differ from what they should be where it is not these that are
wrong."""
LOGGED = (
    *("mm", "cm", "um", "in", "ft", "deg", "mrad", "mm/s", "cm/s", "in/s", "ft/s", "km/h", "mph"),
    *("deg/s", "rpm", "mm/s2", "g", "deg/s2"),
)
"""Units of motion that loggers write beside those of SI."""
CALIBRATED = 0.03
"""Share by which a gain may be off that of a unit."""


class Compared(NamedTuple):
    """How the signals of a relation fit each other.

    **Fields:** `found` amiss in time and zero; how much each signal that is not in time is `late`;
    `sizes` of the terms once these are undone, 1 where they are right, `None` where not all could
    be; the share of the derivative's energy that is `explained`.
    """

    relation: Relation
    found: tuple[Finding, ...]
    late: Mapping[str, Settled]
    sizes: Mapping[str, Told] | None
    explained: float


@np.errstate(all="ignore")
def compare(record: Record, relation: Relation) -> Compared | None:
    """Hold the signals of a relation against each other; `None` where the record does not tell.

    Not under jit.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    prepared = _prepared(record, relation)
    if prepared is None:
        return None
    found, late = dict[tuple[str, tuple[str, ...]], Finding](), dict[str, Settled]()
    weighing = _weighed(relation, prepared)
    first, folds = weighing.causes, weighing.causes.folds
    if not folds.motion[:, 0, 0].sum() > MOST_NOISE * folds.energy:
        return None
    is_undone, before_parts = True, None
    while is_undone and len(found) < MOST:
        causes = _causes(weighing, relation)
        # What few folds tell is proposed, and not carried out at reading.
        is_shown = bool(causes)
        causes = causes or _of_few(weighing)
        told = [_told(cause, relation, weighing) for cause in causes]
        # What is certain is undone first: it may be what the rest is not told from.
        certain = [*filter(lambda each: each[1].remedy, zip(causes, told))]
        causes, told = zip(*certain) if certain else (causes, told)
        if not told or any((one.code, one.signals) in found for one in told):
            break
        if before_parts is None and any(cause.is_part for cause in causes):
            before_parts = found.copy(), late.copy()
        found |= {(one.code, one.signals): one for one in told}
        late |= {
            name: cause.undone
            for cause in causes
            if is_shown and cause.undone is not None and cause.undone.course is None
            if cause.doubt.kind == "delay"
            for name in cause.doubt.signals
        }
        is_undone = all(one.remedy for one in told)
        if is_undone:
            try:
                prepared = undone(prepared, [one.remedy for one in told])
                weighing = _weighed(relation, prepared)
            except DataError:  # too little of it is left
                is_undone = False
    # A part of what is amiss is none where the rest is not found.
    if before_parts is not None and not first.is_little(weighing.causes.before):
        (found, late), is_undone = before_parts, False
    folds, names = weighing.causes.folds, weighing.causes.base
    explained = 1 - float(folds.unexplained(names).sum() / folds.motion[:, 0, 0].sum())
    sizes = _sizes(folds, relation) if is_undone else None
    off = {n: one.value - 1 for n, one in (sizes or {}).items() if abs(one.value - 1) > GAIN}
    if off:
        # Of what is as fast as samples the size depends on its course between them.
        others = _sizes(_by_trapezoids(weighing.asked, weighing.records[0]), relation)
        if not others or any(not (others[n].value - 1) * by > 0 for n, by in off.items()):
            sizes = None
    return Compared(relation, tuple(found.values()), late, sizes, explained)


def _sizes(folds: Folds, relation: Relation) -> dict[str, Told] | None:
    """Of the terms of a relation, 1 where they are right; `None` where no error can be given."""
    names = folds.parameters[: len(relation.of)]
    sizes = {name: folds.told(names, f"0.{name}").times(1 / by) for name, by in relation.of}
    return sizes if np.isfinite([one.error for one in sizes.values()]).all() else None


def _by_trapezoids(asked: Asked, record: Record) -> Folds:
    """The same sums with what is between samples on straight lines."""
    windows = asked.criterion.all_windows
    assert windows is not None
    return folds_of(asked._replace(criterion=RIEC(windows, Hat(2))), [record], [], "plain")


def _prepared(record: Record, relation: Relation) -> Record | None:
    """The signals alone, their spikes repaired; `None` where none is looked at."""
    some = record.select(*relation.names)
    if some.sample_count < 4 * SHORTEST:
        return None
    some = repair_outliers(some.part(0, min(some.sample_count, MOST_SAMPLES)))
    samples = {name: signal.with_nan for name, signal in some.by_name.items()}
    # What is not finite squared, no sensor shows.
    if not all(TINY < float(np.nanstd(one)) < 1 / TINY for one in samples.values()):
        return None
    rates = [samples[name] for name in relation.terms]
    rough = (np.nanmean(np.diff(v) ** 2) > ROUGH * np.nanvar(v) for v in rates)
    return None if len(rates) > 1 and any(rough) else some


def _weighed(relation: Relation, record: Record, by: Sequence[str] = ()) -> Weighing:
    """What may be amiss with the terms of a relation, or `by` some of its signals."""
    record = judged_surely(record)
    step, terms = float(record.time_step), relation.terms
    longest = max(_longest(record, relation.signal), SHORTEST)
    windows = AllWindows(max(longest // SHORTEST, 2) * step, longest * step)
    doubts = list[Doubt]()
    for name in by or (relation.names if len(terms) > 1 else terms):
        doubts += [delay_of((name,)), *courses_of((name,))]
    # Of a sum it is moot whose zero is off.
    for name in reversed(terms if not by else ()):
        doubts += [zero_of(name), drift_of(name)]
    values, every = dict(relation.of), [Term(name, name) for name in terms]
    # A parameter for the size of each term.
    model = as_model(Equation(*every, -Term(1.0, relation.signal, derivative=1)))
    asked = Asked(model, RIEC(windows, Hat(6)), values, {}, [f"0.{name}" for name in terms])

    def is_moot(rough: Causes) -> bool:
        other = _by_trapezoids(asked, record)
        left = float(other.left(rough.base).motion.sum())
        return rough.before < CLEARER * abs(rough.before - left)

    return Weighing.of(asked, [record], doubts, is_exact=True, is_moot=is_moot)


def _longest(record: Record, signal: str) -> int:
    """Samples of the longest windows: no more than make noise a small share of what they see."""
    most = min(_usual_period(each.with_nan) for each in record.by_name.values())
    most, size = min(most, record.sample_count // FEWEST), START
    area, noise = np.cumsum(record.arrays[signal]), float(record.noise.std(signal))
    while size < most:
        # A hat's row of x' is the mean of x over its second half less that over its first one.
        half = size // 2
        seen = (area[2 * half :] - 2 * area[half:-half] + area[: -2 * half]) / half
        if 2 * noise**2 / half < SMALL * float(np.mean(seen**2)):
            break
        size = size * 3 // 2
    return min(size, most)


def _usual_period(values: np.ndarray) -> int:
    """Samples in a period of the usual motion: increments over a sixth of a sine's have its
    variance."""
    lag, variance = 2, np.nanvar(values)
    while lag < values.size // 4 and np.nanmean((values[lag:] - values[:-lag]) ** 2) < variance:
        lag *= 2
    return 6 * lag


def _causes(weighing: Weighing, relation: Relation) -> list[Cause]:
    """What the data demand of a relation's signals that matters."""

    def matters(cause: Cause) -> bool:
        if cause.doubt.kind not in ("zero", "drift"):
            return True
        samples = weighing.records[0].arrays[cause.doubt.signals[0]]
        return abs(cause.size) > OFFSET * float(np.std(samples))

    causes = [cause for cause in weighing.found() if matters(cause)]
    # A signal alone that comes early has the one late, or filtered, that it is the derivative of.
    delays = [cause for cause in causes if cause.undone and cause.doubt.kind == "delay"]
    if len(relation.terms) == 1 and any(cause.size < 0 for cause in delays):
        other = _weighed(relation, weighing.records[0], [relation.signal])
        return other.found() or causes
    return causes


def _of_few(weighing: Weighing) -> list[Cause]:
    """The delay that explains what is left where that is in few folds, as that of a step:
    with nothing to hold it against, since the relation is exact but for noise."""
    causes, delays = weighing.causes, [d for d in weighing.causes.every if d.kind == "delay"]
    folds, base = causes.folds, causes.base
    of_each = folds.unexplained(base)
    if np.sum(of_each > MOVING * of_each.max()) >= FEWEST_FOLDS or not delays:
        return []
    before = float(of_each.sum())
    with_delays = [float(folds.unexplained([*base, one.name]).sum()) for one in delays]
    place = int(np.argmin(with_delays))
    left, best = with_delays[place], delays[place]
    # Beyond what noise may be taken for.
    if not (before > causes.noise and left < UNEXPLAINED * before):
        return []
    # As its column says: a step behind a mean is late by the mean's first moment, whatever delay
    # leaves least of the rest.
    told, left = folds.told([*base, best.name], best.name), max(left, 0.0)
    step = float(weighing.records[0].time_step)
    undone = settled_at(told.value, told, folds, base, left, step)
    if not abs(undone.samples) > SMALLEST:
        return []
    return [Cause(best, told.value, causes.rms(before), causes.rms(left), {}, undone)]


def _told(cause: Cause, relation: Relation, weighing: Weighing) -> Finding:
    """The finding of a cause: all signals but those that are late may be the wrong ones."""
    (name,) = cause.doubt.signals
    says = relation.words(name)[0 if name == relation.signal else 1]
    against = Equated(f"{says} says", "the signals differ by", "the motion", "velocity_offset")
    cause = cause._replace(moved={}, own={})
    finding = finding_of(cause, weighing.asked.model, weighing.records, against)
    is_late = cause.undone is not None and cause.undone.course is None
    others = () if is_late else [n for n in relation.names if n != name]
    message = finding.message
    if finding.code in ("velocity_offset", "drifting_signal"):
        message = f"{message} Or {relation.signal} drifts."
    return finding._replace(
        message=message,
        signals=(name, *others),
        parameters=(),
        doubts={},
        doubt=min(cause.before, 1.0),
    )


def check_kinematics(record: Record, pairs: Pairs) -> list[Finding]:
    """What is amiss between signals and their recorded derivatives.

    Each pair names a signal and the signal that holds its derivative, or is a relation with several
    whose sum does. Codes: `not_its_derivative`, `lost_rows`, `two_clocks`, `late_signal`,
    `low_passed`, `wrong_gain`, `drifting_signal` and `velocity_offset`. A derivative that was
    computed from the signal is not compared. Not under jit.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    findings: dict[tuple[str, tuple[str, ...]], Finding] = {}
    for relation in relations(pairs):
        if any(record.noise.is_made_of(name, relation.signal) for name in relation.terms):
            continue
        compared = compare(record, relation)
        for finding in () if compared is None else findings_of(record, compared):
            key = finding.code, finding.signals
            findings[key] = findings.pop(key, finding)
    return list(findings.values())


def findings_of(record: Record, compared: Compared) -> Iterator[Finding]:
    """What is amiss between the signals of a relation that were compared."""
    relation, found = compared.relation, compared.found
    if "lost_rows" not in {one.code for one in found} and (
        cut := cut_rows(*with_sum(record, relation))
    ):
        yield cut._replace(signals=relation.names)
        return
    if compared.explained < UNRELATED and not found:
        yield _unrelated(relation, compared.explained)
        return
    sizes = [] if compared.sizes is None else [*_of_sizes(record, relation, compared.sizes)]
    # What another unit or channel does in time is told once that is put right.
    if not any(one.code == "not_its_derivative" for one in sizes):
        yield from found
    yield from sizes


def _unrelated(relation: Relation, explained: float) -> Finding:
    derivative, signal = summed(relation.of), relation.signal
    return Finding(
        "not_its_derivative",
        f"{derivative}, which is read as the derivative of {signal}, does not move with {signal} "
        f"({in_percent(max(explained, 0))} of that derivative's energy is explained). {CHECK}",
        relation.names,
        doubt=1.0,
        remedy=SMOOTH,
        step=f"Identify from {signal} alone, without {derivative}",
    )


CHECK = (
    "Check which columns they are, their units and signs, and that time is in seconds (on the "
    "command line: --map, --unit and --scale)."
)


def _of_sizes(record: Record, relation: Relation, sizes: Mapping[str, Told]) -> Iterator[Finding]:
    """What is wrong in size: the signal alone that says best why terms are not 1."""
    values = np.array([one.value for one in sizes.values()])
    errors = np.maximum([one.error for one in sizes.values()], TINY)
    common = float(np.average(values, weights=errors**-2.0))
    suspects = {
        name: (value, error, float(np.sum(np.delete((values - 1) / errors, place) ** 2)))
        for place, (name, value, error) in enumerate(zip(sizes, values.tolist(), errors.tolist()))
    }
    if len(sizes) > 1:
        left = float(np.sum(((values - common) / errors) ** 2))
        error = float(np.sum(errors**-2.0)) ** -0.5 / common**2
        suspects[relation.signal] = 1 / common, error, left
    suspect = min(suspects, key=lambda name: suspects[name][2])
    size, error, least = suspects[suspect]
    alike = [n for n, one in suspects.items() if n != suspect and one[2] < least + CLEAR**2]
    off = next(iter(sizes.values()))._replace(value=size - 1, error=error)
    if not (abs(off.value) > GAIN and off.chance < LEVEL):
        return
    several, gross, gain = len(sizes) > 1, abs(size - 1) > GROSS, 1 / size
    if gross and not several:
        yield _not_its_derivative(record, relation, size)
        return
    derivative, motion = relation.words(suspect)
    or_else = f" Or {' or '.join(alike)} is, which explains it as well." if alike else ""
    said = f"{derivative} is {gain:.4g} ± {error * gain**2:.1g} times {motion}."
    remedy = ("--scale", f"{suspect}={size:.5g}")
    how = shlex.join(remedy)
    yield Finding(
        "not_its_derivative" if gross else "wrong_gain",
        f"{said} {suspect} is calibrated wrongly, or has another "
        f"{'sign or unit' if gross else 'unit'}: scale it ({how}).{or_else}"
        if several
        else f"{said} Which of the two is calibrated wrongly they cannot tell: scale that one "
        f"({how}, or --scale {relation.signal}={gain:.5g}).",
        (suspect,) if several else (derivative, relation.signal),
        # A term may hold the signal squared, as drag does.
        doubt=min(max(gain**2, gain**-2) - 1, 1.0),
        remedy=remedy,
        step=f"Scale {suspect}"
        if several
        else f"Scale {derivative} or {relation.signal}, whichever sensor is off",
    )


def _not_its_derivative(record: Record, relation: Relation, size: float) -> Finding:
    """Of a pair so unlike in size, with the units in which it would fit."""
    signal, (derivative,) = relation.signal, relation.terms
    # Columns that a logger may have written in another unit, and no one converted.
    factors = {derivative: size, signal: 1 / size}
    stated = {name: readings(record.signal(name).unit).values() for name in factors}
    units = [
        f"{name}={unit}"
        for name, factor in factors.items()
        for unit in LOGGED
        for one in readings(unit).values()
        for known in stated[name]
        if known.powers == one.powers and abs(factor * known.factor / one.factor - 1) < CALIBRATED
    ]
    likely = ""
    if units:
        likely = f" It fits where {' or '.join(u.replace('=', ' is in ') for u in units)}."
    elif abs(size + 1) < CALIBRATED:
        likely = f" One of them points the other way: scale {derivative} or {signal} by -1."
    remedy = ("--unit", *units) if len(units) == 1 else ()
    return Finding(
        "not_its_derivative",
        f"{derivative}, which is read as the derivative of {signal}, does not fit its size, sign "
        f"or time: {signal} changes by {size:.4g} times the integral of {derivative}.{likely} "
        f"{CHECK}",
        (signal, derivative),
        doubt=min(max(size**2, size**-2) - 1, 1.0),
        remedy=remedy,
        step="Convert " + " from ".join(units[0].split("="))
        if remedy
        else f"Scale {derivative} or {signal}, whichever sensor is off",
    )


def is_derivative(record: Record, signal: str, others: Sequence[str]) -> bool:
    """Whether one of the other signals is the recorded derivative of this one."""
    every = (compare(record, Relation(signal, ((other, 1.0),))) for other in others)
    fitting = (one.sizes for one in every if one and one.explained > ALIKE and one.sizes)
    return any(all(abs(one.value - 1) < GROSS for one in sizes.values()) for sizes in fitting)


def implied(record: Record, names: Sequence[str], known: Collection[Relation]) -> list[Relation]:
    """Signals that are derivatives of others by what they show, though nothing `known` says so."""
    together = [{*one.names} for one in known]
    return [
        Relation(signal, ((other, 1.0),))
        for signal, other in itertools.permutations(names, 2)
        if not any({signal, other} <= each for each in together)
        and _looks_like(record, signal, other)
        and is_derivative(record, signal, [other])
    ]


@np.errstate(all="ignore")
def _looks_like(record: Record, signal: str, other: str) -> bool:
    """Whether a signal changes roughly by the integral of another, and units do not forbid it."""
    units = [record.signal(name).unit for name in (signal, other)]
    if all(units):
        rates = [one.powers for one in readings(f"{units[0]}/s").values()]
        if not any(one.powers in rates for one in readings(units[1]).values()):
            return False
    position, rate = (np.nan_to_num(record.signal(name).with_nan) for name in (signal, other))
    lag = max(_usual_period(position) // 6, 1)
    area = np.cumsum(rate - rate.mean()) * float(record.time_step)
    changes, areas = (each[lag:] - each[:-lag] for each in (position, area))
    size, alike = np.std(changes) / np.std(areas), np.corrcoef(changes, areas)[0, 1]
    return bool(ROUGHLY < size < 1 / ROUGHLY and alike > ROUGHLY)

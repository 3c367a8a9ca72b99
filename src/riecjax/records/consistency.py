"""Whether a recorded derivative fits its signal: wrong units, signs and channels show here.

Findings of what is amiss between a signal and its derivative, and what puts it right.
"""

import shlex
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from riecjax.findings import Finding, option_for
from riecjax.records.derived import line_taken_off
from riecjax.records.faults.derivative_pairs import Pair, compare
from riecjax.records.faults.relations import Pairs, Relation, relations, with_sum
from riecjax.records.faults.rows import cut_rows
from riecjax.records.noise import noise_level
from riecjax.records.reading.unit_expressions import readings
from riecjax.records.record import Record, samples_with_nan
from riecjax.records.remembered import remembered

SHORTEST, LONGEST_SHARE = 4, 8
"""Lags: from this many samples to this part of the record, each four times the one before."""
FEWEST_LAGS = 50
"""Pairs of samples below which nothing is said."""
EXTREME = 0.99
"""Quantile past which increments are cut off, so that single spikes do not decide."""
ALIKE = 0.95
"""Correlation of increments, of either sign, past which they belong to one motion."""
UNRELATED = 0.5
"""Correlation below which two signals do not belong to each other."""
TOLD = 10.0
"""Standard errors that a gain has to be for one signal to explain what is amiss with several."""
GAIN = 0.1
"""Share by which sensors of one motion may differ in gain: more than any calibration leaves."""
LOGGED = (
    *("mm", "cm", "um", "in", "ft", "deg", "mrad", "mm/s", "cm/s", "in/s", "ft/s", "km/h", "mph"),
    *("deg/s", "rpm", "mm/s2", "g", "deg/s2"),
)
"""Units of motion that loggers write beside those of SI."""
CALIBRATED = 0.03
"""Share by which a gain may be off that of a unit."""


def check_derivatives(record: Record, pairs: Pairs) -> list[Finding]:
    """Compare the increments of signals with the integrals of their derivatives.

    Each pair names a signal and the signal that holds its derivative, or is a relation with
    several whose sum does. The comparison is made over
    the lag at which they agree best: noise hides short increments of a position, and an offset
    that drifts spoils long integrals of a velocity. Constant offsets do not matter. Where they
    agree but for little, a fit over frequencies tells how little. Codes: `not_its_derivative`,
    `lost_rows`, `two_clocks`, `late_signal`, `low_passed`, `wrong_gain`, `drifting_signal` and
    `velocity_offset`. A derivative that was computed from the signal is not compared. Not under
    jit.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    found: list[Finding] = []
    for relation in relations(pairs):
        if any(record.noise.is_made_of(name, relation.signal) for name in relation.terms):
            continue
        wrong, pair = compared(record, relation)
        found += [wrong] if wrong is not None else []
        found += [] if pair is None else pair_findings(record, pair)
    return list({(one.code, one.signals): one for one in reversed(found)}.values())[::-1]


def compared(record: Record, relation: Relation) -> tuple[Finding | None, Pair | None]:
    """What is grossly wrong with a relation, or else how its signals fit each other.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    if relation.is_plain:
        wrong = disagreement(record, relation.signal, relation.terms[0])
        return wrong, compare(record, relation) if wrong is None else None
    pair = compare(record, relation)
    if pair is not None and abs(pair.fit.gain) > TOLD * pair.fit.errors[1]:
        return None, pair
    wrong = disagreement(*with_sum(record, relation))
    return wrong and wrong._replace(signals=relation.names), None


def _pair(record: Record, signal: str, derivative: str) -> tuple[Any, ...]:
    names, units = (signal, derivative), dict(record.units)
    both = (samples_with_nan(record, name) for name in names)
    return *names, *both, float(record.time_step), *(units.get(name, "") for name in names)


# Values too large to be squared are for the fit to refuse.
@remembered(32, _pair)
@np.errstate(over="ignore", invalid="ignore")
def disagreement(record: Record, signal: str, derivative: str) -> Finding | None:
    """`not_its_derivative` of a signal and what is read as its derivative, if they do not fit."""
    values, rates = samples_with_nan(record, signal), samples_with_nan(record, derivative)
    best = _best_lag(values, rates, float(record.time_step))
    if best is None:
        return None
    units, likely = [], ""
    if abs(best.correlation) < ALIKE and best.correlation < UNRELATED:
        what = (
            f"does not move with {signal} (the increments of {signal} and the integral of "
            f"{derivative} correlate by {best.correlation:.2f} at best)"
        )
        doubt = 1.0
    elif best.is_off:
        what = (
            f"does not fit the size, sign or time of {signal}: {signal} changes by "
            f"{best.gain:.4g} times the integral of {derivative}"
        )
        units = _units_that_fit(record, signal, derivative, best.gain)
        if units:
            likely = f" It fits where {' or '.join(map(_in_unit, units))}."
        elif abs(best.gain + 1) < CALIBRATED:
            likely = f" One of them points the other way: scale {derivative} or {signal} by -1."
        # A term may hold the signal squared, as drag does.
        doubt = min(max(best.gain**2, best.gain**-2) - 1, 1.0)
    else:
        return None
    remedy = ("--unit", *units) if len(units) == 1 else ()
    return Finding(
        "not_its_derivative",
        f"{derivative}, which is read as the derivative of {signal}, {what}.{likely} Check which "
        f"columns they are, their units and signs, and that time is in seconds (on the command "
        f"line: --map, --unit and --scale).",
        (signal, derivative),
        doubt=doubt,
        remedy=remedy,
        step="Convert " + " from ".join(units[0].split("=")) if remedy else "",
    )


def _units_that_fit(record: Record, signal: str, derivative: str, gain: float) -> list[str]:
    """`NAME=UNIT` of a column that a logger may have written in this unit, and no one converted."""
    found = []
    for name, factor in ((derivative, gain), (signal, 1 / gain if gain else 0.0)):
        own = {u.powers: u.factor for u in readings(dict(record.units).get(name, "")).values()}
        found += [
            f"{name}={unit}"
            for unit in LOGGED
            for one in readings(unit).values()
            if one.powers in own and abs(factor * own[one.powers] / one.factor - 1) < CALIBRATED
        ]
    return found


def _in_unit(assignment: str) -> str:
    name, unit = assignment.split("=")
    return f"{name} is in {unit}"


def is_motion(record: Record, signal: str, others: Iterable[str]) -> bool:
    """Whether one of the other signals is the recorded derivative of this one."""
    values, step = samples_with_nan(record, signal), float(record.time_step)
    for other in others:
        best = _best_lag(values, samples_with_nan(record, other), step)
        if best is not None and best.correlation > ALIKE and abs(best.gain - 1) < GAIN:
            return True
    return False


class _Regression(NamedTuple):
    """Of a signal's increments on the integrals of its derivative, at one lag."""

    correlation: float
    gain: float
    """Standard deviation of the increments over that of the integrals, with their common sign."""

    @property
    def is_off(self) -> bool:
        """Whether no share of noise in either signal explains a gain that is not 1.

        Noise in the integrals lowers the slope of increments on integrals, cov / var(integrals) =
        gain x correlation, below the true gain; noise in the increments raises the inverse of the
        other regression's slope, var(increments) / cov = gain / correlation, above it. So the two
        enclose the true gain whatever the shares.
        """
        if self.gain < 0:
            return True
        return self.gain * self.correlation > 1 + GAIN or self.gain / self.correlation < 1 - GAIN


def _best_lag(values: np.ndarray, rates: np.ndarray, step: float) -> _Regression | None:
    """The regression at the lag with the highest correlation; `None` if there are too few pairs.

    Increments at all lags are differences of the same two columns, the values and the running
    integral of the rates, so that each lag costs one pass.
    """
    unknown = np.isnan(values) | np.isnan(rates)
    unknown_before = np.concatenate([[0], np.cumsum(unknown)])
    rates = np.where(unknown, 0.0, rates)
    area = np.concatenate([[0.0], np.cumsum(0.5 * step * (rates[1:] + rates[:-1]))])
    found = []
    lag, noise = SHORTEST, float(noise_level(np.where(unknown, 0.0, values), ~unknown))
    while lag <= values.size // LONGEST_SHARE:
        whole = unknown_before[lag + 1 :] == unknown_before[: values.size - lag]
        if whole.sum() >= FEWEST_LAGS:
            increments = _winsorised((values[lag:] - values[:-lag])[whole])
            integrals = _winsorised((area[lag:] - area[:-lag])[whole])
            size, other = np.std(increments), np.std(integrals)
            # Increments that are mostly noise tell nothing of the motion.
            if size > 2 * noise and other > 0 and np.isfinite(size) and np.isfinite(other):
                correlation = float(np.mean(increments / size * integrals / other))
                found.append(_Regression(correlation, float(np.sign(correlation) * size / other)))
        lag *= 4
    return max(found, key=lambda each: abs(each.correlation), default=None)


def _winsorised(increments: np.ndarray) -> np.ndarray:
    """Increments about their mean, those past the quantile `EXTREME` of their size cut to it."""
    centred = increments - np.median(increments)
    limit = np.quantile(np.abs(centred), EXTREME)
    cut = np.clip(centred, -limit, limit)
    return cut - np.mean(cut)


def pair_findings(record: Record, pair: Pair) -> Iterator[Finding]:
    """What is amiss with a pair; codes as in the docs of [`check_derivatives`][].

    The doubt is the share of the derivative that is wrong: of a delay, the turn of its phase.
    """
    if pair.course.kind != "rows" and (cut := _cut(record, pair)):
        yield cut
        return
    # The usual frequency, from how much better a gain is known than a delay.
    turn = pair.fit.errors[1] / max(pair.fit.errors[0], 1e-300)
    if pair.course.kind != "steady":
        yield _uneven(record, pair, min(turn * abs(pair.course.change), 1.0))
    if pair.is_late:
        yield _late(pair, turn)
    if pair.gain_is_off:
        yield _gain(pair)
    if pair.drift or pair.offset:
        yield _zero(record, pair)


def _cut(record: Record, pair: Pair) -> Finding | None:
    found = cut_rows(*with_sum(record, pair.relation))
    return found and found._replace(signals=pair.relation.names)


def _sides(pair: Pair, forward: bool) -> tuple[tuple[str, ...], str, str]:
    """Names of the suspect's side or of the other, that side in words, and what it is held
    against.
    """
    mine, others = pair.relation.side(pair.suspect)
    late, other = (mine, others) if forward else (others, mine)
    return late, " and ".join(late), " and ".join(other)


def _else(pair: Pair) -> str:
    """Which other signals may be the wrong one."""
    return f" Or {' or '.join(pair.alike)} is, which explains it as well." if pair.alike else ""


def _late(pair: Pair, turn: float) -> Finding:
    """Of the one of the two that comes later."""
    by, error = pair.fit.delay + pair.fit.lag, pair.fit.errors[0]
    names, late, other = _sides(pair, by > 0)
    are = "are" if len(names) > 1 else "is"
    samples, seconds = abs(by), abs(by) * pair.step
    size = f"{samples:.3g} \u00b1 {error:.1g} samples ({1e3 * seconds:.3g} ms)"
    advance = option_for("--shift", names, f"{seconds:.4g}")
    doubt = min(turn * samples, 1.0)
    if pair.lagged:
        undo = option_for("--unfilter", names, f"{seconds:.4g}")
        return Finding(
            "low_passed",
            f"{late} went through a first-order low-pass that {other} did not, with a time "
            f"constant of {size}, a cut-off at {1 / (2 * np.pi * seconds):.3g} Hz: it lags, and "
            f"loses what is fast. Record both alike, or undo it ({shlex.join(undo)}).{_else(pair)}",
            names,
            doubt=doubt,
            remedy=undo,
            step=f"Undo the low-pass of {late}",
        )
    return Finding(
        "late_signal",
        f"{late} {are} {size} late against {other}.{_else(pair)} {shlex.join(advance)} brings it "
        f"forward, as --align auto does when the file is read. Whether both are late against "
        f"other signals the two cannot tell.",
        names,
        doubt=doubt,
        remedy=advance,
        step=f"Bring {late} forward by {seconds:.3g} s",
    )


def _gain(pair: Pair) -> Finding:
    gain, relation = pair.fit.gain, pair.relation
    derivative, motion = relation.words(pair.suspect)
    size = f"{derivative} is {gain:.4g} \u00b1 {pair.fit.errors[1]:.1g} times {motion}."
    # A term may hold the signal squared, as drag does.
    doubt = min(max(gain**2, gain**-2) - 1, 1.0)
    if len(relation.of) == 1:
        remedy = ("--scale", f"{derivative}={1 / gain:.5g}")
        return Finding(
            "wrong_gain",
            f"{size} Which of the two is calibrated wrongly they cannot tell: scale that one "
            f"({shlex.join(remedy)}, or --scale {pair.signal}={gain:.5g}).",
            (derivative, pair.signal),
            doubt=doubt,
            remedy=remedy,
            step=f"Scale {derivative} or {pair.signal}, whichever sensor is off",
        )
    remedy = ("--scale", f"{pair.suspect}={pair.scaling:.5g}")
    gross = pair.is_gross
    return Finding(
        "not_its_derivative" if gross else "wrong_gain",
        f"{size} {pair.suspect} is calibrated wrongly, or has another "
        f"{'sign or unit' if gross else 'unit'}: scale it ({shlex.join(remedy)}).{_else(pair)}",
        (pair.suspect,),
        doubt=doubt,
        remedy=remedy,
        step=f"Scale {pair.suspect}",
    )


def _zero(record: Record, pair: Pair) -> Finding:
    """Of a drift, or else of an offset."""
    names = pair.relation.names
    derivative, factor = pair.zeroed
    signal = pair.signal if len(names) == 2 else pair.relation.words(derivative)[1]
    value, unit = pair.drift or pair.offset, dict(record.units).get(derivative, "")
    share = abs(value) * pair.step / pair.scale / pair.rms
    size = f"{value * factor:.3g} {unit}".rstrip()
    # Whose it is one relation cannot tell.
    others = " or ".join(n for n in names if n not in (derivative, pair.signal))
    whose = f" Or {others} has it, or {pair.signal} drifts." if others else ""
    both, doubt = (derivative, *(n for n in names if n != derivative)), min(share, 1.0)
    time, per = np.asarray(record.time), factor * pair.scale / pair.step
    change = pair.fit.drift * per if pair.drift else 0.0
    remedy = line_taken_off(derivative, time, pair.fit.offset * per, change)
    rest = (
        f"{100 * share:.2g} % of its rms. Take it off (on the command line: {shlex.join(remedy)})."
    )
    if pair.drift:
        return Finding(
            "drifting_signal",
            f"{derivative} drifts by {size} over {float(time[-1] - time[0]):.4g} s against "
            f"{signal}, {rest}{whose}",
            both,
            doubt=doubt,
            remedy=remedy,
            step=f"Take the straight line off {derivative}",
        )
    return Finding(
        "velocity_offset",
        f"{derivative} has an offset of {size} against {signal}, {rest}"
        f"{whose or f' Or {signal} drifts by that per second.'}",
        both,
        doubt=doubt,
        remedy=remedy,
        step=f"Take the offset off {derivative}",
    )


def _uneven(record: Record, pair: Pair, doubt: float) -> Finding:
    """Of a delay that changes along the record."""
    course, step, time = pair.course, pair.step, np.asarray(record.elapsed)
    lasts = f"from {course.first:.3g} to {course.first + course.change:.3g} samples"
    names, mine, others = _sides(pair, True)
    both = (*names, *(name for name in pair.relation.names if name not in names))
    if course.kind == "clocks":
        per = 1e6 * step / float(time[-1] - time[0])
        rate, start = per * course.change, float(time[0])
        remedy = course.by_one_clock(names, rate, step, start)
        reverse = course._replace(first=-course.first)
        other = reverse.by_one_clock(_sides(pair, False)[0], -rate, step, start)
        return Finding(
            "two_clocks",
            f"{mine} {course.way} {others} evenly, {lasts} over the record: their clocks differ by "
            f"{rate:.3g} \u00b1 {per * course.error:.1g} ppm. Record both by one logger, or set "
            f"the clock that is off ({shlex.join(remedy)}, or {shlex.join(other)}).{_else(pair)}",
            both,
            doubt=doubt,
            remedy=remedy,
            step=f"Set the clock of {mine}, if it is the one that is off",
        )
    first, last = (time[min(place, time.size - 1)] for place in course.place)
    jumping = others if course.change > 0 else mine
    return Finding(
        "lost_rows",
        f"The delay of {mine} against {others} jumps {lasts} between {first:.4g} "
        f"and {last:.4g} s: {jumping} has lost {abs(course.change):.3g} \u00b1 {course.error:.1g} "
        f"samples ({1e3 * abs(course.change) * step:.3g} ms) there. Use the record up to there "
        f"(--to {first:.4g}) or from there on (--from {last:.4g}), where both agree in time."
        f"{_else(pair)}",
        both,
        doubt=doubt,
        remedy=course.in_time(first, last),
        step="Use the part of the record in which both agree in time",
    )

"""Findings of what is amiss between a signal and its derivative, and what puts it right."""

import shlex
from collections.abc import Iterator

import numpy as np

from riecjax.findings import Finding, option_for
from riecjax.records.derived import line_taken_off
from riecjax.records.faults.cut_rows import cut_rows
from riecjax.records.faults.derivative_pairs import Pair
from riecjax.records.faults.relations import with_sum
from riecjax.records.record import Record


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

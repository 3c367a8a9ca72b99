"""Whether a recorded derivative fits its signal, and what puts it right if not: wrong units, signs
and channels show in increments, what is less than that in a fit over frequencies.

It may be no sensor's, but computed from the signal: differences, slopes of polynomials, or any
other filter of some dozens of samples. Such a derivative has the position's noise, many times as
large and of one source with it. Taken for a sensor's own, white and independent, it biases every
estimate.
"""

import shlex
from collections.abc import Collection, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.errors import DataError
from riecjax.findings import Finding, line_taken_off, option_for
from riecjax.leaves import is_concrete
from riecjax.records.faults.derivative_pairs import (
    GROSS,
    PPM,
    Pair,
    Pairs,
    Relation,
    compare,
    relations,
    with_sum,
)
from riecjax.records.faults.rows import cut_rows
from riecjax.records.faults.sampled_signal import ENOUGH
from riecjax.records.preparation import with_local_derivative
from riecjax.records.reading.units import readings
from riecjax.records.record import Record, runs
from riecjax.records.remembered import remembered
from riecjax.records.signal import Noise, noise_level

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
    findings: dict[tuple[str, tuple[str, ...]], Finding] = {}
    for relation in relations(pairs):
        if not any(record.noise.is_made_of(name, relation.signal) for name in relation.terms):
            wrong, pair = compared(record, relation)
            every = [wrong] if wrong else [] if pair is None else pair_findings(record, pair)
            for finding in every:
                key = finding.code, finding.signals
                findings[key] = findings.pop(key, finding)
    return list(findings.values())


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


# Values too large to be squared are for the fit to refuse.
@remembered(
    lambda record, signal, derivative: (
        signal,
        derivative,
        *(record.signal(name).with_nan for name in (signal, derivative)),
        *(record.signal(name).unit for name in (signal, derivative)),
        float(record.time_step),
    ),
)
@np.errstate(over="ignore", invalid="ignore")
def disagreement(record: Record, signal: str, derivative: str) -> Finding | None:
    """`not_its_derivative` of a signal and what is read as its derivative, if they do not fit."""
    values, rates = record.signal(signal).with_nan, record.signal(derivative).with_nan
    best = _best_lag(values, rates, float(record.time_step))
    if best is None:
        return None
    (correlation, gain), units, likely = best, [], ""
    # No share of noise in either signal explains every gain that is not 1. Noise in the integrals
    # lowers the slope of increments on integrals, cov / var(integrals) = gain x correlation, below
    # the true gain; noise in the increments raises the inverse of the other regression's slope,
    # var(increments) / cov = gain / correlation, above it. So the two enclose the true gain.
    if abs(correlation) < ALIKE and correlation < UNRELATED:
        what = (
            f"does not move with {signal} (the increments of {signal} and the integral of "
            f"{derivative} correlate by {correlation:.2f} at best)"
        )
        doubt = 1.0
    elif gain < 0 or gain * correlation > 1 + GROSS or gain / correlation < 1 - GROSS:
        what = (
            f"does not fit the size, sign or time of {signal}: {signal} changes by "
            f"{gain:.4g} times the integral of {derivative}"
        )
        # Columns that a logger may have written in another unit, and no one converted.
        factors = {derivative: gain, signal: 1 / gain if gain else 0.0}
        stated = {name: readings(record.signal(name).unit).values() for name in factors}
        units = [
            f"{name}={unit}"
            for name, factor in factors.items()
            for unit in LOGGED
            for one in readings(unit).values()
            for known in stated[name]
            if known.powers == one.powers
            and abs(factor * known.factor / one.factor - 1) < CALIBRATED
        ]
        if units:
            likely = f" It fits where {' or '.join(u.replace('=', ' is in ') for u in units)}."
        elif abs(gain + 1) < CALIBRATED:
            likely = f" One of them points the other way: scale {derivative} or {signal} by -1."
        # A term may hold the signal squared, as drag does.
        doubt = min(max(gain**2, gain**-2) - 1, 1.0)
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


def is_motion(record: Record, signal: str, others: Iterable[str]) -> bool:
    """Whether one of the other signals is the recorded derivative of this one."""
    values, step = record.signal(signal).with_nan, float(record.time_step)
    lags = (_best_lag(values, record.signal(other).with_nan, step) for other in others)
    return any(lag and lag.correlation > ALIKE and abs(lag.gain - 1) < GROSS for lag in lags)


class _Regression(NamedTuple):
    """Of a signal's increments on the integrals of its derivative, at one lag.

    **Fields:** `correlation`; `gain`, the standard deviation of the increments over that of the
    integrals, with their common sign.
    """

    correlation: float
    gain: float


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
    lag, noise = SHORTEST, float(noise_level(np.where(unknown, np.nan, values)))
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
    relation, fit, step = pair.relation, pair.fit, pair.step
    if pair.course.kind != "rows" and (cut := cut_rows(*with_sum(record, relation))):
        yield cut._replace(signals=relation.names)
        return
    # Which other signals may be the wrong one.
    or_else = f" Or {' or '.join(pair.alike)} is, which explains it as well." if pair.alike else ""
    # The usual frequency, from how much better a gain is known than a delay.
    turn = fit.errors[1] / max(fit.errors[0], np.finfo(float).tiny)
    if pair.course.kind != "steady":
        yield _uneven(record, pair, min(turn * abs(pair.course.change), 1.0), or_else)
    if pair.is_late:
        names, late, other = _sides(pair, fit.delay > 0)
        samples, seconds = abs(fit.delay), abs(fit.delay) * step
        size = f"{samples:.3g} \u00b1 {fit.errors[0]:.1g} samples ({1e3 * seconds:.3g} ms)"
        remedy = option_for("--unfilter" if fit.lagged else "--shift", names, f"{seconds:.4g}")
        how = shlex.join(remedy)
        said, next_step = (
            (
                f"{late} went through a first-order low-pass that {other} did not, with a time "
                f"constant of {size}, a cut-off at {1 / (2 * np.pi * seconds):.3g} Hz: it lags, "
                f"and loses what is fast. Record both alike, or undo it ({how}).{or_else}",
                f"Undo the low-pass of {late}",
            )
            if fit.lagged
            else (
                f"{late} {'are' if len(names) > 1 else 'is'} {size} late against {other}.{or_else} "
                f"{how} brings it forward, as --align auto does when the file is read. Whether "
                f"both are late against other signals the two cannot tell.",
                f"Bring {late} forward by {seconds:.3g} s",
            )
        )
        yield Finding(
            "low_passed" if fit.lagged else "late_signal",
            said,
            names,
            doubt=min(turn * samples, 1.0),
            remedy=remedy,
            step=next_step,
        )
    if pair.gain_is_off:
        gain, gross = fit.gain, pair.is_gross
        derivative, motion = relation.words(pair.suspect)
        size = f"{derivative} is {gain:.4g} \u00b1 {fit.errors[1]:.1g} times {motion}."
        several = len(relation.of) > 1
        scaling = f"{pair.scaling if several else 1 / gain:.5g}"
        remedy = ("--scale", f"{pair.suspect if several else derivative}={scaling}")
        how = shlex.join(remedy)
        yield Finding(
            "not_its_derivative" if several and gross else "wrong_gain",
            f"{size} {pair.suspect} is calibrated wrongly, or has another "
            f"{'sign or unit' if gross else 'unit'}: scale it ({how}).{or_else}"
            if several
            else f"{size} Which of the two is calibrated wrongly they cannot tell: scale that one "
            f"({how}, or --scale {relation.signal}={gain:.5g}).",
            (pair.suspect,) if several else (derivative, relation.signal),
            # A term may hold the signal squared, as drag does.
            doubt=min(max(gain**2, gain**-2) - 1, 1.0),
            remedy=remedy,
            step=f"Scale {pair.suspect}"
            if several
            else f"Scale {derivative} or {relation.signal}, whichever sensor is off",
        )
    if not (value := pair.drift or pair.offset):
        return
    names, time = relation.names, np.asarray(record.time)
    derivative, factor = pair.zeroed
    signal = relation.signal if len(names) == 2 else relation.words(derivative)[1]
    share = abs(value) / pair.rms
    size = f"{value * factor:.3g} {record.signal(derivative).unit}".rstrip()
    lasts, change = f"over {time[-1] - time[0]:.4g} s", fit.drift * factor if pair.drift else 0.0
    what = f"drifts by {size} {lasts}" if pair.drift else f"has an offset of {size}"
    whose = "" if pair.drift else f" Or {signal} drifts by that per second."
    # Whose it is one relation cannot tell.
    if others := " or ".join(n for n in names if n not in (derivative, relation.signal)):
        whose = f" Or {others} has it, or {relation.signal} drifts."
    remedy = line_taken_off(derivative, time, fit.offset * factor, change)
    yield Finding(
        "drifting_signal" if pair.drift else "velocity_offset",
        f"{derivative} {what} against {signal}, {100 * share:.2g} % of its rms. Take it off (on "
        f"the command line: {shlex.join(remedy)}).{whose}",
        (derivative, *(n for n in names if n != derivative)),
        doubt=min(share, 1.0),
        remedy=remedy,
        step=f"Take the {'straight line' if pair.drift else 'offset'} off {derivative}",
    )


def _sides(pair: Pair, forward: bool) -> tuple[tuple[str, ...], str, str]:
    """Names of the suspect's side or of the other, that side in words, and what it is held
    against.
    """
    mine, others = pair.relation.side(pair.suspect)
    late, other = (mine, others) if forward else (others, mine)
    return late, " and ".join(late), " and ".join(other)


def _uneven(record: Record, pair: Pair, doubt: float, or_else: str) -> Finding:
    """Of a delay that changes along the record."""
    course, step, time = pair.course, pair.step, np.asarray(record.elapsed)
    lasts = f"from {course.first:.3g} to {course.first + course.change:.3g} samples"
    names, mine, others = _sides(pair, True)
    both = tuple(dict.fromkeys((*names, *pair.relation.names)))
    if course.kind == "clocks":
        per = step / PPM / float(time[-1] - time[0])
        rate, start = per * course.change, float(time[0])
        remedy = course.by_one_clock(names, rate, step, start)
        reverse = course._replace(first=-course.first)
        other = reverse.by_one_clock(_sides(pair, False)[0], -rate, step, start)
        return Finding(
            "two_clocks",
            f"{mine} {course.way} {others} evenly, {lasts} over the record: their clocks differ by "
            f"{rate:.3g} \u00b1 {per * course.error:.1g} ppm. Record both by one logger, or set "
            f"the clock that is off ({shlex.join(remedy)}, or {shlex.join(other)}).{or_else}",
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
        f"{or_else}",
        both,
        doubt=doubt,
        remedy=course.in_time(first, last),
        step="Use the part of the record in which both agree in time",
    )


HALVES = (1, 2, 5, 10, 30)
"""Samples to each side of filters that are tried, the longest first as the test of all."""
LEFT = 0.1
"""What such a filter leaves at most, in terms of the position's noise through it. A sensor's own
noise is left whole: a filter of the position cannot tell it."""
MOST_NOISE = 2.0
"""Noise through a filter, in terms of all that there is of it and of motion, past which the filter
is none."""
LEAST = 1e-5
"""Noise of differences, as a share of these, below which it matters to nothing: what looks like it
may be motion that no difference is of the order to take off."""
CONSTANT = 0.3
"""Share of its taps that a filter's sum may reach: a derivative of what is constant is zero. What
copies the position, or smooths it, is no derivative, and to take it for one would hide that."""
ROUNDS, FAR = 3, 10.0
"""Fits, each without rows that the one before left so many times its median."""
SHARPENED = 2
"""Order of the differences that are looked at, in which motion hides noise less."""


def without_computed(
    record: Record, pairs: Pairs, known: Collection[str] = ()
) -> tuple[Record, list[str]]:
    """Slopes of local polynomials in place of derivatives that are filters of their signals.

    A signal's own sensor is all that such a derivative knows of; the polynomials are as wide as its
    motion allows. Not under jit, where the record stays as it is.

    **Arguments:** `pairs` of a signal and its derivative; `known`, signals whose noise was given:
    a sensor's, then.

    **Returns:** the record, and what was done, in words.
    """
    if not is_concrete(record):
        return record, []
    computed, words, judging = [], [], record
    for signal, derivative in (p for p in pairs if not isinstance(p, Relation)):
        noise = judging.noise
        judged = noise.kernels.get(signal) and {signal, derivative} <= {*record.arrays}
        # Some are made of their signals by a step of preparation.
        if derivative in known or not judged or noise.is_made_of(derivative, signal):
            continue
        position, rate = (record.signal(name).with_nan for name in (signal, derivative))
        taps = filter_between(position, rate, float(noise.std(signal)))
        if taps is not None:
            judging = _with_noise_of(judging, signal, derivative, taps)
            computed.append((signal, derivative, taps))
    for signal, derivative, taps in computed:
        said = f"{derivative}: computed from {signal}, by a filter of {taps.size} samples"
        try:
            record, width = with_local_derivative(record, signal, derivative)
            said = f"{said}; in its place slopes of local polynomials, {width:.3g} s to each side"
        except DataError:  # too short for them
            record = _with_noise_of(record, signal, derivative, taps)
        words.append(said)
    return record, words


def _with_noise_of(record: Record, signal: str, derivative: str, taps: np.ndarray) -> Record:
    """The record, of whose derivative the noise is the signal's through these taps."""
    return record.with_noise(Noise.of({derivative: record.noise[signal].convolved(taps)}))


@remembered(lambda signal, other, noise: (signal, other, noise))
@np.errstate(over="ignore", invalid="ignore")
def filter_between(
    signal: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"], noise: float
) -> Float[np.ndarray, " taps"] | None:
    """Taps of the shortest filter that makes one signal of another, whose noise has this standard
    deviation; `None` if none does."""
    stretches = runs(~(np.isnan(signal) | np.isnan(other))).T.tolist()
    first, stop = max(stretches, key=lambda ends: ends[1] - ends[0], default=(0, 1))
    # Differences are one-sided at the ends.
    position, rate = (each[first + 1 : stop - 1][:ENOUGH] for each in (signal, other))
    x, y = (np.diff(each, SHARPENED) for each in (position, rate))
    if position.size < 8 * HALVES[-1] or not noise / np.sqrt(2) > LEAST * np.std(np.diff(position)):
        return None
    scale = np.std(x)
    # What is not finite squared, no sensor shows.
    if not (noise > 0 and np.isfinite(scale + np.std(y))):
        return None
    columns = np.lib.stride_tricks.sliding_window_view(x / scale, 2 * HALVES[-1] + 1)
    target = y[HALVES[-1] : y.size - HALVES[-1]]
    found = None
    for half in reversed(HALVES):
        inner = slice(HALVES[-1] - half, HALVES[-1] + half + 1)
        # Least squares, and what is left where no spike was repaired in one of the two.
        kept, left, taps = np.ones(target.size, bool), target, np.zeros(0)
        for _ in range(ROUNDS):
            some = columns[kept, inner]
            taps = np.linalg.lstsq(some.T @ some, some.T @ target[kept], rcond=1e-14)[0]
            left = target - columns[:, inner] @ taps
            kept = np.abs(left) <= FAR * np.median(np.abs(left[kept]))
        through = noise / scale * np.linalg.norm(np.convolve(taps, [1, -2, 1]))
        # Taps that make more noise than there is fit motion alone, which few waves are.
        there = np.sqrt(np.mean(target**2))
        if not (
            np.sqrt(np.mean(left[kept] ** 2)) < LEFT * through and through < MOST_NOISE * there
        ):
            break
        found = taps[::-1] / scale
    if found is not None and abs(found.sum()) > CONSTANT * np.abs(found).sum():
        return None
    return found

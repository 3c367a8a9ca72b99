"""What is amiss between a signal and its recorded derivative, in time, size and zero.

A pair shows differences alone: whether v is late or x early, whether v has an offset or x drifts,
it cannot tell, nor what both have in common, as a delay of both against the force.
"""

import itertools
import shlex
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.findings import Finding
from riecjax.records.faults.cut_rows import cut_rows
from riecjax.records.faults.delay_course import SURE, Course, delay_course
from riecjax.records.faults.pair_fit import SHORTEST_PIECE, PairFit, Piece, fit_pair
from riecjax.records.record import Record, samples_with_nan
from riecjax.records.remembered import remembered

LATE = 0.01
"""Samples of delay past which it matters."""
GAIN = 0.01
"""Share by which a gain must be off; more than a calibration leaves is 2 %."""
OFFSET = 0.002
"""Share of the derivative's rms past which its offset, or its drift over the record, matters."""
LIKELIER = 12.0
"""Gain in log-likelihood past which a delay is a filter's lag."""
FEWEST_CYCLES, CYCLES_OF_WINDOW = 1.0, 1.5
"""Of the motion, in a record and in a part of it: on less, offset, drift and delay are alike."""
WINDOWS, SHORTEST_WINDOW = 12, 250
"""Parts of the record whose delays are compared, and the fewest samples of one."""
MOST_SAMPLES, LONGEST_PIECE = 2**15, 2**13
"""Of a long record, samples that are looked at, in pieces evenly spread."""
SHORT_GAP = 5
"""Missing samples in a row that are filled in."""
SPIKE = 5.0
"""Times that a spike leaves the median of five samples further than its neighbours range."""
MOST_SPIKES = 0.05
"""Share of samples past which these are no spikes."""


class Pair(NamedTuple):
    """How a recorded derivative follows its signal.

    **Fields:** `signal`, `derivative`; `fit`, in samples and units of the signal's `scale`;
    `lagged` where a low-pass describes it better than a delay; `course` of the delay; `rms` of the
    derivative, in the fit's unit; `step` of time in seconds.
    """

    signal: str
    derivative: str
    fit: PairFit
    lagged: bool
    course: Course
    scale: float
    rms: float
    step: float

    @property
    def delay(self) -> float:
        """Seconds by which the derivative is surely late and steadily so, else 0."""
        return self.fit.delay * self.step if self.is_late and not self.lagged else 0.0

    @property
    def is_late(self) -> bool:
        """Whether the derivative is surely late, or early, or lags, throughout the record."""
        by, error = self.fit.delay + self.fit.lag, self.fit.errors[0]
        return self.course.kind == "steady" and abs(by) > max(LATE, SURE * error)

    @property
    def gain_is_off(self) -> bool:
        """Whether the derivative's size is surely wrong."""
        return self.course.kind == "steady" and abs(self.fit.gain - 1) > max(
            GAIN, SURE * self.fit.errors[1]
        )

    @property
    def offset(self) -> float:
        """Of the derivative, in its unit, 0 unless it surely matters."""
        sure = abs(self.fit.offset) > max(OFFSET * self.rms, SURE * self.fit.errors[2])
        return self.fit.offset * self.scale / self.step if sure else 0.0

    @property
    def drift(self) -> float:
        """Of the derivative over the record, in its unit, 0 unless it surely matters."""
        sure = abs(self.fit.drift) > max(2 * OFFSET * self.rms, SURE * self.fit.errors[3])
        return self.fit.drift * self.scale / self.step if sure else 0.0


def _compared(record: Record, signal: str, derivative: str) -> tuple[Any, ...]:
    signals = (samples_with_nan(record, name) for name in (signal, derivative))
    return signal, derivative, *signals, np.asarray(record.elapsed), float(record.time_step)


@remembered(32, _compared)
@np.errstate(all="ignore")
def compare_pair(record: Record, signal: str, derivative: str) -> Pair | None:
    """Fit a recorded derivative to its signal; `None` if the record does not tell. Not under jit.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    x, v = samples_with_nan(record, signal), samples_with_nan(record, derivative)
    step, count = float(record.time_step), x.size
    centre = np.nanmedian(x) if not np.isnan(x).all() else 0.0
    scale = float(np.nanquantile(np.abs(x - centre), 0.9)) if np.isfinite(centre) else 0.0
    if not (np.isfinite(scale) and scale > 0):
        return None
    x, v = (x - centre) / scale, v / scale * step
    breaks = _pauses(record)
    pieces = list(_pieces(x, v, 0, count, breaks, MOST_SAMPLES))
    rms = float(np.sqrt(np.mean(np.concatenate([p.v for p in pieces]) ** 2))) if pieces else 0.0
    cycles = rms * count / (2 * np.pi)
    if not (np.isfinite(cycles) and cycles > FEWEST_CYCLES):
        return None
    fit = fit_pair(pieces, count)
    if fit is None or not np.isfinite(fit.errors).all():
        return None
    windows = min(WINDOWS, count // SHORTEST_WINDOW, int(cycles / CYCLES_OF_WINDOW))
    course, spread = Course(), 1.0
    if windows > 1:
        edges = np.linspace(0, count, windows + 1).astype(int)
        parts = [
            list(_pieces(x, v, a, b, breaks, MOST_SAMPLES // windows))
            for a, b in itertools.pairwise(edges)
        ]
        course, spread = delay_course(parts, edges.tolist(), count, fit)
    fit = fit._replace(errors=fit.errors * spread)
    pair = Pair(signal, derivative, fit, False, course, scale, rms, step)
    if pair.is_late and (lag := _low_pass(pieces, count, fit)) is not None:
        pair = pair._replace(fit=lag, lagged=True)
    return pair


def _pauses(record: Record) -> Float[np.ndarray, " pauses"]:
    """Samples that follow a pause."""
    steps = np.diff(np.asarray(record.elapsed))
    return np.flatnonzero(steps > 1.5 * float(record.time_step)) + 1


def _pieces(
    x: np.ndarray, v: np.ndarray, start: int, stop: int, breaks: np.ndarray, most: int
) -> Iterator[Piece]:
    """Unbroken stretches of both, short gaps and spikes filled in; of many samples some."""
    ranges = [(start, stop)]
    if stop - start > most:
        starts = np.linspace(start, stop - LONGEST_PIECE, most // LONGEST_PIECE).astype(int)
        ranges = [(first, first + LONGEST_PIECE) for first in starts]
    for first, last in ranges:
        both = [_filled(column[first:last]) for column in (x, v)]
        known = ~np.isnan(both[0]) & ~np.isnan(both[1])
        cuts = np.flatnonzero(np.diff(known)) + 1
        within = breaks[(breaks > first) & (breaks < last)] - first
        for piece in np.split(np.arange(last - first), np.union1d(cuts, within)):
            if piece.size >= SHORTEST_PIECE and known[piece[0]]:
                yield Piece(first + piece[0], *(column[piece] for column in both))


def _filled(values: np.ndarray) -> np.ndarray:
    """Spikes and short gaps replaced by local cubics."""
    from scipy.interpolate import Akima1DInterpolator

    found = values.copy()
    if values.size > 9:
        around = np.lib.stride_tricks.sliding_window_view(values, 9)
        off = np.abs(values[4:-4] - np.median(around[:, 2:7], axis=1))
        near = around[:, [0, 1, 2, 6, 7, 8]]
        spikes = np.flatnonzero(off > SPIKE * np.ptp(near, axis=1)) + 4
        if spikes.size <= MOST_SPIKES * values.size:
            found[spikes] = np.nan
    missing = np.isnan(found)
    if missing.any() and np.sum(~missing) > 4:
        at = np.arange(found.size)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]])))
        short = np.zeros(found.size, bool)
        for first, last in edges.reshape(-1, 2):
            short[first:last] = last - first <= SHORT_GAP
        found[short] = Akima1DInterpolator(at[~missing], found[~missing])(at[short])
    return found


def _low_pass(pieces: Sequence[Piece], count: int, delayed: PairFit) -> PairFit | None:
    """The fit of a low-pass, if it describes the pair better than a delay."""
    lag = fit_pair(pieces, count, lagged=True)
    if lag is None or not np.isfinite(lag.errors).all() or abs(lag.lag) < SURE * lag.errors[0]:
        return None
    # The likelihood of noise whose power is what is left.
    power, counted = (
        np.interp(delayed.left.omega, lag.left.omega, column)
        for column in (lag.left.smoothed, lag.counted)
    )
    both = delayed.counted & (counted > 0.5)
    return lag if np.sum(np.log(delayed.left.smoothed / power)[both]) > LIKELIER else None


def pair_findings(record: Record, pair: Pair) -> Iterator[Finding]:
    """What is amiss with a pair; codes as in the docs of [`check_derivatives`][].

    The doubt is the share of the derivative that is wrong: of a delay, the turn of its phase.
    """
    if pair.course.kind != "rows" and (cut := cut_rows(record, pair.signal, pair.derivative)):
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


def _late(pair: Pair, turn: float) -> Finding:
    """Of the one of the two that comes later."""
    by, error = pair.fit.delay + pair.fit.lag, pair.fit.errors[0]
    late, other = (pair.derivative, pair.signal) if by > 0 else (pair.signal, pair.derivative)
    samples, seconds = abs(by), abs(by) * pair.step
    size = f"{samples:.3g} \u00b1 {error:.1g} samples ({1e3 * seconds:.3g} ms)"
    advance, doubt = ("--shift", f"{late}={seconds:.4g}"), min(turn * samples, 1.0)
    if pair.lagged:
        return Finding(
            "low_passed",
            f"{late} went through a first-order low-pass that {other} did not, with a time "
            f"constant of {size}, a cut-off at {1 / (2 * np.pi * seconds):.3g} Hz: it lags, and "
            f"loses what is fast. Record both alike; {' '.join(advance)} takes off the lag alone.",
            (late,),
            doubt=doubt,
            remedy=advance,
            step=f"Take the lag of {late} off",
        )
    return Finding(
        "late_signal",
        f"{late} is {size} late against {other}. {' '.join(advance)} brings it forward, as "
        f"--align auto does when the file is read. Whether both are late against other signals "
        f"the two cannot tell.",
        (late,),
        doubt=doubt,
        remedy=advance,
        step=f"Bring {late} forward by {seconds:.3g} s",
    )


def _gain(pair: Pair) -> Finding:
    gain, signal, derivative = pair.fit.gain, pair.signal, pair.derivative
    remedy = ("--scale", f"{derivative}={1 / gain:.5g}")
    return Finding(
        "wrong_gain",
        f"{derivative} is {gain:.4g} \u00b1 {pair.fit.errors[1]:.1g} times the derivative of "
        f"{signal}. Which of the two is calibrated wrongly they cannot tell: scale that one "
        f"({' '.join(remedy)}, or --scale {signal}={gain:.5g}).",
        (derivative, signal),
        # A term may hold the signal squared, as drag does.
        doubt=min(max(gain**2, gain**-2) - 1, 1.0),
        remedy=remedy,
        step=f"Scale {derivative} or {signal}, whichever sensor is off",
    )


def _zero(record: Record, pair: Pair) -> Finding:
    """Of a drift, or else of an offset."""
    signal, derivative = pair.signal, pair.derivative
    value, unit = pair.drift or pair.offset, dict(record.units).get(derivative, "")
    share = abs(value) * pair.step / pair.scale / pair.rms
    size = f"{value:.3g} {unit}".rstrip()
    both, doubt = (derivative, signal), min(share, 1.0)
    formula = _without_zero(record, pair)
    remedy = ("--derive", f"{derivative}={formula}") if derivative.isidentifier() else ()
    rest = (
        f"{100 * share:.2g} % of its rms. Take it off (on the command line: {shlex.join(remedy)})."
    )
    if pair.drift:
        return Finding(
            "drifting_signal",
            f"{derivative} drifts by {size} over {float(record.elapsed[-1]):.4g} s against "
            f"{signal}, {rest}",
            both,
            doubt=doubt,
            remedy=remedy,
            step=f"Take the straight line off {derivative}",
        )
    return Finding(
        "velocity_offset",
        f"{derivative} has an offset of {size} against {signal}, {rest} Or {signal} drifts by "
        f"that per second.",
        both,
        doubt=doubt,
        remedy=remedy,
        step=f"Take the offset off {derivative}",
    )


def _without_zero(record: Record, pair: Pair) -> str:
    """A formula of the derivative less its offset and drift, which is not less its mean or line.

    Those of a record are also the machine's, as far as it does not come back to where it began.
    """
    time, unit = np.asarray(record.time), pair.scale / pair.step
    rate = pair.fit.drift * unit / float(record.elapsed[-1])
    line = f"-({rate:.6g})*(t-{0.5 * (time[0] + time[-1]):.15g})" if pair.drift else ""
    return f"{pair.derivative}-({pair.fit.offset * unit:.6g}){line}"


def _uneven(record: Record, pair: Pair, doubt: float) -> Finding:
    """Of a delay that changes along the record."""
    course, step, time = pair.course, pair.step, np.asarray(record.elapsed)
    lasts = f"from {course.first:.3g} to {course.first + course.change:.3g} samples"
    both = (pair.derivative, pair.signal)
    if course.kind == "clocks":
        rate = 1e6 * course.change / max(time.size - 1, 1)
        return Finding(
            "two_clocks",
            f"{pair.derivative} falls behind {pair.signal} evenly, {lasts} over the record: their "
            f"clocks differ by {rate:.3g} \u00b1 {1e6 * course.error / time.size:.1g} ppm. Give "
            f"each its own time and --resample both, or record both by one logger.",
            both,
            doubt=doubt,
            step=f"Record {pair.derivative} and {pair.signal} by one clock",
        )
    first, last = (time[min(place, time.size - 1)] for place in course.place)
    jumping = pair.signal if course.change > 0 else pair.derivative
    return Finding(
        "lost_rows",
        f"The delay of {pair.derivative} against {pair.signal} jumps {lasts} between {first:.4g} "
        f"and {last:.4g} s: {jumping} has lost {abs(course.change):.3g} \u00b1 {course.error:.1g} "
        f"samples ({1e3 * abs(course.change) * step:.3g} ms) there. Use the record up to there "
        f"(--to {first:.4g}) or from there on (--from {last:.4g}), where both agree in time.",
        both,
        doubt=doubt,
        remedy=course.in_time(first, last),
        step="Use the part of the record in which both agree in time",
    )

"""Faults of sensors, converters and loggers, found in the samples alone.

A signal may sit at one value: at the end of its range, as of a converter, as a sensor that is
stuck does while the rest of the record moves, or until the next message of a slow bus comes. No
check fires on what machines do: axes at rest, relays and steps, encoders that show one value for a
while, bumps in a road.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from riecjax.errors import DataError
from riecjax.findings import Finding, class_of
from riecjax.records.faults.hum import hum
from riecjax.records.faults.rows import copied
from riecjax.records.faults.sampled_signal import (
    ENOUGH,
    FEW_LEVELS,
    LONGEST_REST,
    Found,
    SampledSignal,
    Signals,
    fault,
    percent,
    spread_of,
)
from riecjax.records.faults.spikes import outliers
from riecjax.records.linear_op import LinearOp, Operations, step
from riecjax.records.record import Record, runs

PILE_UP = 5.0
"""Times more often than at the next four levels that a clipped signal sits at its extreme. The
crest of a quantised signal, a parabola, sits there at most 3.2 times as often."""
REPEATS = 2.5
"""The same for a signal that is not quantised, in which no value comes twice but by a period."""
FEWEST_VISITS = 3
"""Times that a signal must have run into its limits, both together, to count as clipped; once where
no other value of it comes twice."""
FOLLOWED = 0.98
"""Share of a signal that others must explain to tell what it does at its limit."""
LAGS = range(-2, 3)
BEYOND = 0.1
"""Standard deviations beyond a limit where others must surely not say that a signal goes on."""
STEEP = 10.0
"""Quanta by which a steep approach lies off the extreme two samples before. A crest that stays
within its last quantum for 3 samples comes from less than 9."""


class Visits(NamedTuple):
    """Times that a signal sits at an extreme where it does not just turn round."""

    sign: float
    """1 of the maximum, -1 of the minimum."""
    extreme: float
    starts: np.ndarray
    samples: int
    steep: int
    """Visits that came from far off, and left for far off."""


@fault(
    "clipped",
    "Record with a larger range, or leave them out (on the command line: {option}), unless the "
    "limit is real, as of a command or of a wheel that lifts.",
    "--leave-out",
)
def clipped(signal: SampledSignal, signals: Signals) -> Iterator[Found]:
    """Runs into an extreme from far off, which a crest never does, and sits there.

    Unless other signals say that the limit is real, as the motion of a wheel that lifts does of the
    force on its tyre.
    """
    for side in limits(signal):
        said = (
            f"sits at its {'maximum' if side.sign > 0 else 'minimum'} of "
            f"{signal.with_unit(side.extreme)} in {side.starts.size} place(s), "
            f"{percent(side.samples, signal.sample_count)} of the samples, first at "
            f"{signal.time[side.starts[0]]:.4g} s, as a converter at the end of its range does."
        )
        yield Found(
            "" if is_real(signal, side, signals.beside(signal.name)) else said,
            doubt=side.samples / signal.sample_count,
            samples=side.sign * (signal.values - side.extreme) >= -signal.rounding,
            step="Leave out what {} shows at the end of its range",
        )


def limits(signal: SampledSignal) -> list[Visits]:
    """Extremes into which a signal ran, real ones too."""
    if signal.is_command:
        return []
    sides = [side for sign in (1.0, -1.0) if (side := _visits(signal, sign)) and side.steep]
    unique = not signal.resolution and np.mean(signal.counts == 1) > 0.999
    return sides if sum(s.steep for s in sides) >= (1 if unique else FEWEST_VISITS) else []


def _visits(signal: SampledSignal, sign: float) -> Visits | None:
    """Visits to one extreme; `None` where it is a crest, or where the signal rests."""
    outermost = slice(None, -6, -1) if sign > 0 else slice(5)
    extreme, (samples, *others) = signal.levels[outermost][0], signal.counts[outermost].tolist()
    ratio = PILE_UP if signal.resolution else REPEATS
    if not ratio * np.mean(others) < samples <= LONGEST_REST * signal.sample_count:
        return None
    visits = np.abs(signal.run_values - extreme) <= signal.rounding
    starts, lengths = signal.run_starts[visits], signal.run_lengths[visits]
    quantum = max(signal.resolution, signal.rounding)
    steep = np.ones(starts.size, bool)
    inside = np.pad(sign * (extreme - signal.values), 4, constant_values=np.nan)
    for edges, outward in ((starts, -1), (starts + lengths - 1, 1)):
        near, far = (inside[4 + edges + k * outward] for k in (2, 4))
        # At a deceleration a, k samples before the extreme seems reached, the distance is
        # a (k + s)^2 / 2, where the last quantum q = a s^2 / 2 hides the end for s samples. Hence
        # sqrt(far / near) = (4 + s) / (2 + s) = 2 - sqrt(q / near), and more where the deceleration
        # falls. On a straight approach far / near is 2 to 3.
        hidden = np.sqrt(np.minimum(quantum / np.maximum(near, quantum), 1.0))
        steep &= (near > STEEP * quantum) & ~(near * (2 - hidden) ** 2 <= far)
    return Visits(sign, float(extreme), starts, samples, int(steep.sum()))


def is_real(signal: SampledSignal, side: Visits, others: Sequence[SampledSignal]) -> bool:
    """Whether other signals, at lags of two samples, stay at the limit with the signal.

    Of a sensor at the end of its range all that follows the signal goes on beyond. Of a real limit
    one balance may break there, such as that of a spring that parts, so that one signal and two are
    left out in turn; the others, such as the masses that it moves, keep to it.
    """
    rows = [np.stack([np.roll(s.values, lag) for lag in LAGS]) for s in others if s.levels.size > 1]
    if len(rows) < 2:
        return False
    target = signal.values
    known = np.all(~np.isnan(np.concatenate([target[None], *rows])), axis=0)
    known[[0, 1, -2, -1]] = False
    held = known & (np.abs(target - side.extreme) <= signal.rounding)
    free = np.flatnonzero(known & ~held)
    free = free[:: max(free.size // ENOUGH, 1)]
    if not held.any() or free.size < 100:
        return False
    size = float(np.std(target[free]))
    columns = np.concatenate([*rows, np.ones((1, target.size)), target[None] / size])
    columns[:-1] /= np.maximum(
        np.max(np.abs(columns[:-1, known]), axis=1, keepdims=True), np.finfo(float).tiny
    )
    # Columns Q R leave the same of each other as those of R do, which are few and short.
    triangle, there = np.asarray(np.linalg.qr(columns[:, free].T, mode="r")), columns[:, held]
    signal_of_row = np.repeat(np.arange(len(rows)), len(LAGS))
    for left_out in (*combinations(range(len(rows)), 1), *combinations(range(len(rows)), 2)):
        kept = np.append(np.flatnonzero(~np.isin(signal_of_row, left_out)), signal_of_row.size)
        weights = np.linalg.lstsq(triangle[:, kept], triangle[:, -1], rcond=1e-10)[0]
        # About zero: the constant is among them.
        error = float(np.linalg.norm(triangle[:, -1] - triangle[:, kept] @ weights))
        beyond = side.sign * (weights @ there[kept] - side.extreme / size)
        surely = np.mean(beyond) + 2 * np.std(beyond) / np.sqrt(side.starts.size)
        if error**2 < (1 - FOLLOWED) * free.size and surely < BEYOND:
            return True
    return False


STUCK_SAMPLES = 20
"""Samples of one value that may be a stuck sensor."""
STUCK_RATIO = 10.0
"""Times that a stuck run is longer than what is usual (19 of 20 runs) in the signal."""
ABRUPT = 0.1
"""Share of the usual step past which a run begins or ends abruptly. What comes to rest at a finite
deceleration takes a last step far below."""
ABRUPT_QUANTA = 3.0
"""The same in quanta of the signal."""
STEADY, JUMP = 0.99, 2.0
"""Share of a signal's steps that are usual; times such a step past which it jumps."""
SHORT, PLACES = 3, 3
"""Samples of one value, and places with it, that may be where a signal drops out: at 0, or at a
number that its logger writes for none."""
TURNING = 0.5
"""Usual steps below which motion goes on so slowly that it turns there, and an encoder shows no
change."""
UNIQUE = 0.95
"""Share of values that come once in a signal that is not quantised."""
MOVES = 0.3
"""Share of its usual sample-to-sample change past which another signal moves meanwhile."""


@fault(
    "stuck_sensor",
    "Leave them out (on the command line: {option}), and check the sensor, its cable and the "
    "logger.",
    "--leave-out",
)
def stuck(signal: SampledSignal, signals: Signals) -> Iterator[Found]:
    """A long run of one value, begun or left by a jump, while another signal moves on; or short
    ones of the same value, all begun and left by jumps."""
    if signal.is_command:
        return
    others = signals.beside(signal.name)
    number = np.repeat(np.arange(signal.run_lengths.size), signal.run_lengths)
    for still, long in ((dropouts(signal), False), (long_runs(signal, others), True)):
        if not still.size:
            continue
        starts, lengths = signal.run_starts[still], signal.run_lengths[still]
        value, samples = signal.with_unit(float(signal.run_values[still[0]])), int(lengths.sum())
        first, share = f"{signal.time[starts[0]]:.4g} s", percent(samples, signal.sample_count)
        one = value if np.unique(signal.run_values[still]).size == 1 else "one value"
        yield Found(
            f"stays at exactly {value} for {lengths[0]} samples from {first} on while the rest of "
            f"the record {_rest_of_record(others, starts[0], lengths[0])} ({samples} samples in "
            f"{still.size} place(s), {share})."
            if long
            else f"drops out: it shows exactly {one} for {int(np.median(lengths))} samples "
            f"(median) in {still.size} places, and goes on elsewhere, first at {first} ({share} of "
            f"the samples).",
            # What drops out is far off: each sample counts for several.
            doubt=samples / signal.sample_count if long else 1.0,
            samples=np.isin(number, still),
            step=f"Leave out what {{}} showed while it {'was stuck' if long else 'dropped out'}",
        )


def _edges(signal: SampledSignal) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Steps into each run and out of it, the usual step, and the step past which a signal jumps."""
    steps = np.abs(np.diff(signal.values))
    moving, padded = steps[steps > 0], np.pad(steps, 1, constant_values=np.nan)
    into, out = padded[signal.run_starts], padded[signal.run_starts + signal.run_lengths]
    return into, out, float(np.median(moving)), JUMP * float(np.quantile(moving, STEADY))


def dropouts(signal: SampledSignal) -> np.ndarray:
    """Runs of a value that is entered and left by jumps, several times, and shown in no other way.

    A motion that comes to rest, or runs into a limit, gets there by steps as small as any other.
    """
    lengths, values = signal.run_lengths, signal.run_values
    into, out, usual, jump = _edges(signal)
    several = np.flatnonzero(lengths >= SHORT)
    found = [np.zeros(0, int)]
    # An encoder has thousands of values: those are looked at that are entered or left by jumps.
    for value in np.unique(values[several[np.maximum(into, out)[several] > jump]]):
        long = several[values[several] == value]
        # A signal that was near the value may enter it gently at one end, and not mostly at both.
        if long.size >= PLACES and np.median(np.fmin(into, out)[long]) > usual:
            found.append(long)
    # Of a signal whose values come once, another one each time: the last is written again.
    again = np.flatnonzero(lengths > SHORT)
    if (
        np.mean(signal.counts == 1) > UNIQUE
        and np.unique(values[again]).size >= PLACES
        and np.nanmedian(out[again]) > TURNING * usual
    ):
        found.append(again)
    return np.unique(np.concatenate(found))


def long_runs(signal: SampledSignal, others: Sequence[SampledSignal]) -> np.ndarray:
    """Which of the signal's runs a stuck sensor showed."""
    starts, lengths, values = signal.run_starts, signal.run_lengths, signal.run_values
    into, out, usual, jump = _edges(signal)
    long = np.flatnonzero(
        lengths >= max(STUCK_SAMPLES, STUCK_RATIO * float(np.quantile(lengths, 0.95)))
    )
    least, edges = max(ABRUPT * usual, ABRUPT_QUANTA * signal.resolution), np.fmax(into, out)
    # What is held at an extreme and entered and left by no more than usual steps is clipped.
    ends = np.abs(values[:, None] - signal.levels[[0, -1]]).min(axis=1) <= signal.rounding
    edges = np.where(ends & (edges <= jump), 0.0, edges)
    # A machine comes to rest and leaves it gently, and rests in the same place more than once.
    stuck = [
        np.sum(values[long] == values[run]) == 1
        and edges[run] > least
        and bool(_rest_of_record(others, starts[run], lengths[run]))
        for run in long
    ]
    return long[stuck]


def _rest_of_record(others: Sequence[SampledSignal], start: int, length: int) -> str:
    """What the other sensors do during a run, if it suggests a fault; else empty.

    Either one of them changes from sample to sample, or every one shows one value to the last
    digit, as when a logger writes one row again and again. Quiet sensors suggest no fault.
    """
    sensors = [s for s in others if s.levels.size > FEW_LEVELS]
    still = []
    for other in sensors:
        steps = np.diff(other.values)
        meanwhile = steps[start : start + length - 1]
        if np.isnan(meanwhile).all():
            continue
        if np.nanstd(meanwhile) > MOVES * np.nanstd(steps):
            return "moves"
        still.append(not np.nanmax(np.abs(meanwhile)))
    if not sensors:
        return "moves"
    return "stands as still" if still and all(still) else ""


FEWEST_MESSAGES = 20
"""Values, each held, that tell of messages."""
QUANTA = 3.0
"""Quanta from value to value (median) up to which it is an encoder at an even speed."""
FOLLOWS = 1.0
"""Mean square of a value's change, in their variance, past which values do not follow each other as
those of a motion do, but are the steps of a command."""


@fault(
    "held_signal",
    "Use the rows at which it is new (on the command line: {option}), or log each message once, "
    "unless it is a command, which the machine is held at as well.",
    "--every",
)
def held(signal: SampledSignal, signals: Signals) -> Iterator[Found]:
    """Each value is held for a while, as of messages on a bus."""
    there = ~np.isnan(signal.run_values)
    lengths, values = signal.run_lengths[there], signal.run_values[there]
    if lengths.size < FEWEST_MESSAGES or signal.levels.size <= FEW_LEVELS:
        return
    every = round(float(np.median(lengths)))
    steps, size = np.abs(np.diff(values)), spread_of(values)
    change = float(np.sqrt(np.mean((steps / size) ** 2)))
    if every > 1 and np.median(steps) > QUANTA * signal.resolution and change**2 < FOLLOWS:
        yield Found(
            f"shows each value for {every} samples, as of a message that comes so seldom: at the "
            f"last of them it is {(every - 1) * signal.time_step:.4g} s old, and between them it "
            f"changes by {percent(change, 1.0)} of its deviation (rms).",
            doubt=min(change / 2, 1.0),
            step=f"Use the rows at which {{}} is new, one of {every}",
            value=f"{every}",
        )


COARSE = 0.01
"""Share of a signal's rms past which its resolution matters."""


@fault(
    "missing_samples",
    "Choose windows and filters much shorter than that.",
    computed=True,
    short=True,
)
def missing(signal: SampledSignal, signals: Signals) -> Iterator[Found]:
    """The same samples of this signal and of others, as in a logger's pause, told of the first."""
    mask = np.isnan(signal.values)
    every = (signals.by_name[name] for name in signals.names)
    names = tuple(each.name for each in every if np.array_equal(np.isnan(each.values), mask))
    starts, stops = runs(mask)
    if not starts.size or signal.name != names[0]:
        return
    # One sample, halfway, stands for all of a logger's pause.
    time, step = signal.time, signal.time_step
    inside = (starts > 0) & (stops < mask.size)
    before, after = time[np.maximum(starts - 1, 0)], time[np.minimum(stops, mask.size - 1)]
    passed = np.where(inside, np.round((after - before) / step) - 1, 0).astype(int)
    lost = np.maximum(stops - starts, passed)
    first = float(before[0] + step if starts[0] > 0 else time[0])
    count = int(lost.sum())
    total = count + signal.sample_count
    longest = int(np.max(np.diff(runs(~mask), axis=0), initial=1))
    yield Found(
        f"{', '.join(names)}: {percent(count, total)} of the samples ({count} of {total}) are "
        f"missing in {lost.size} gap{'s' * (lost.size > 1)}, first at {first:.4g} s; the longest "
        f"unbroken stretch lasts {(longest - 1) * step:.4g} s.",
        signals=names,
    )


@fault(
    "constant_signal",
    "Check that the channel was connected and is the right one.",
    computed=True,
    short=True,
)
def constant(signal: SampledSignal, signals: Signals) -> Iterator[Found]:
    """One value, whatever the others do."""
    if signal.levels.size == 1:
        value = signal.with_unit(signal.levels[0])
        yield Found(f"never varies from {value}, so nothing can be identified from it.")


@fault(
    "quantised",
    "Do not differentiate it without a low-pass, and prefer longer windows or a finer range.",
    computed=True,
)
def quantised(signal: SampledSignal, signals: Signals) -> Iterator[Found]:
    """A resolution that is coarse against the signal's rms."""
    rms = spread_of(signal.values)
    steps = np.abs(np.diff(signal.values))
    steps = steps[~np.isnan(steps)]
    # Few levels are a command's.
    if signal.levels.size <= FEW_LEVELS or signal.resolution <= COARSE * rms:
        return
    change = float(np.sqrt(np.mean((steps / signal.resolution) ** 2)))
    yield Found(
        f"its resolution of {signal.with_unit(signal.resolution)} is "
        f"{percent(signal.resolution, rms)} of its rms, and it changes by {change:.2g} such steps "
        f"from sample to sample (rms)."
    )


FAULTS = (missing, constant, clipped, stuck, held, outliers, quantised, copied, hum)
"""What may be wrong with one signal by itself, in the order in which it is told."""


# Values too large to be squared are for the fit to refuse; here they only compare as infinite.
@np.errstate(over="ignore", invalid="ignore")
def check_signals(
    record: Record,
    names: Iterable[str],
    *,
    computed: Collection[str] = (),
    pairs: Iterable[tuple[str, str]] = (),
) -> list[Finding]:
    """Look for faults of sensors, converters and loggers in these signals.

    Codes are those of `FAULTS`. A signal that is constant, or has fewer than 50 samples, is not
    looked at further. Not under jit.

    **Arguments:** `computed`, signals that no sensor recorded, of which only what a computation
    keeps is reported; `pairs` of a signal and its derivative, which tell hum from motion.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    signals = Signals.of(record, names, computed, pairs)
    return [one for n in signals.names for each in FAULTS for one in each.findings(n, signals)]


def holding(record: Record, names: Collection[str]) -> set[str]:
    """Those of these signals that hold a value for a while, stuck, at a limit or by a message."""
    signals = Signals.of(record, names) if names else Signals({}, ())
    faults = [each for each in FAULTS if class_of(each.code).holds]
    return {n for n in signals.names for each in faults if any(each.findings(n, signals))}


@step
def leave_out(record: Record, *signals: str) -> Operations:
    """Mark as missing what a stuck sensor showed, or one at the end of its range.

    These are the samples of which `stuck_sensor` and `clipped` speak: a long run of one value, and
    a limit into which the signal ran, a real one too. Windows that touch one count no more.

    **Raises:** `DataError` for no signal, one that the record lacks, or one of which nothing would
    be left.
    """
    if not signals:
        raise DataError(f"name the signals to leave out of; there are: {', '.join(record.arrays)}.")
    every = Signals.of(record, signals)
    for name in every.names:
        values = every.by_name[name].values.copy()
        for each in (each for each in FAULTS if each.option == "--leave-out"):
            for found in each.find(every.by_name[name], every):
                values[found.samples] = np.nan
        if np.isnan(values).all():
            raise DataError(f"nothing would be left of '{name}': it is at its limit throughout.")
        yield name, LinearOp.of_values("{}: left out where it is stuck or at its limit", values)

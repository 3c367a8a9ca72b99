"""A signal that does not change while the rest of the record moves."""

import shlex
from collections.abc import Iterator, Sequence

import numpy as np

from riecjax.findings import Finding
from riecjax.records.faults.sampled_signal import (
    FEW_LEVELS,
    LONGEST_REST,
    SampledSignal,
    percent,
)

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


def stuck(signal: SampledSignal, others: Sequence[SampledSignal]) -> Iterator[Finding]:
    """A long run of one value, begun or left by a jump, while another signal moves on; or short
    ones of the same value, all begun and left by jumps."""
    remedy = ("--leave-out", signal.name)
    how = (
        f"Leave them out (on the command line: {shlex.join(remedy)}), and check the sensor, its "
        f"cable and the logger."
    )
    if (runs := dropouts(signal)).size:
        starts, lengths = signal.run_starts[runs], signal.run_lengths[runs]
        shown = np.unique(signal.run_values[runs])
        value = signal.with_unit(float(shown[0])) if shown.size == 1 else "one value"
        yield signal.finding(
            "stuck_sensor",
            f"drops out: it shows exactly {value} for {int(np.median(lengths))} samples (median) "
            f"in {runs.size} places, and goes on elsewhere, first at "
            f"{signal.time[starts[0]]:.4g} s ({percent(int(lengths.sum()), signal.sample_count)} "
            f"of the samples). {how}",
            # They are far off: each counts for several.
            doubt=1.0,
            remedy=remedy,
            step=f"Leave out what {signal.name} showed while it dropped out",
        )
    if (runs := long_runs(signal, others)).size:
        starts, lengths = signal.run_starts[runs], signal.run_lengths[runs]
        samples = int(lengths.sum())
        yield signal.finding(
            "stuck_sensor",
            f"stays at exactly {signal.with_unit(float(signal.run_values[runs[0]]))} for "
            f"{lengths[0]} samples from {signal.time[starts[0]]:.4g} s on while the rest of "
            f"the record {_rest_of_record(others, starts[0], lengths[0])} ({samples} samples in "
            f"{runs.size} place(s), {percent(samples, signal.sample_count)}). {how}",
            doubt=samples / signal.sample_count,
            remedy=remedy,
            step=f"Leave out what {signal.name} showed while it was stuck",
        )


def stuck_runs(signal: SampledSignal, others: Sequence[SampledSignal]) -> np.ndarray:
    """Which of the signal's runs no sensor measured."""
    return np.union1d(long_runs(signal, others), dropouts(signal))


def dropouts(signal: SampledSignal) -> np.ndarray:
    """Runs of a value that is entered and left by jumps, several times, and shown in no other way.

    A motion that comes to rest, or runs into a limit, gets there by steps as small as any other.
    """
    starts, lengths, values = signal.run_starts, signal.run_lengths, signal.run_values
    several, none = np.flatnonzero(lengths >= SHORT), np.zeros(0, int)
    if not several.size:
        return none
    steps = np.abs(np.diff(signal.values))
    moving = _moving(signal, steps, several, beside=1)
    if not moving.size:
        return none
    usual = float(np.quantile(moving, STEADY))
    padded = np.pad(steps, 1, constant_values=np.inf)
    into, out = padded[starts], padded[starts + lengths]
    least, most = np.fmin(into, out), np.where(np.isfinite(into + out), np.fmax(into, out), 0.0)
    found = []
    # An encoder has thousands of values: those are looked at that are entered or left by jumps.
    for value in np.unique(values[several[most[several] > JUMP * usual]]):
        own = np.flatnonzero(values == value)
        long = own[lengths[own] >= SHORT]
        # A signal that was near the value may enter it gently at one end, and not mostly at both.
        jumps = np.median(most[long]) > JUMP * usual and np.median(least[long]) > np.median(moving)
        if long.size >= PLACES and jumps and 2 * long.size > own.size:
            found.append(long)
    # Of a signal whose values come once, another one each time: the last is written again.
    if np.mean(signal.counts == 1) > UNIQUE:
        again = np.flatnonzero(lengths > SHORT)
        own = np.isin(values[again], values[np.setdiff1d(np.arange(lengths.size), again)])
        ends = padded[starts + lengths][again]
        if (
            np.unique(values[again]).size >= PLACES
            and not own.any()
            and np.median(ends) > TURNING * np.median(moving)
        ):
            found.append(again)
    return np.unique(np.concatenate(found)) if found else none


def long_runs(signal: SampledSignal, others: Sequence[SampledSignal]) -> np.ndarray:
    """Which of the signal's runs a stuck sensor showed."""
    starts, lengths, values = signal.run_starts, signal.run_lengths, signal.run_values
    usual, none = float(np.quantile(lengths, 0.95)), np.zeros(0, int)
    long = np.flatnonzero(lengths >= max(STUCK_SAMPLES, STUCK_RATIO * usual))
    if not long.size:
        return none
    steps = np.abs(np.diff(signal.values))
    moving = _moving(signal, steps, long)
    if not moving.size:
        return none
    least = max(ABRUPT * float(np.median(moving[moving > 0])), ABRUPT_QUANTA * signal.resolution)
    # The larger one of the steps into and out of each run.
    padded = np.pad(steps, 1, constant_values=np.nan)
    edges = np.fmax(padded[starts], padded[starts + lengths])
    # What is held at an extreme and entered and left by no more than usual steps is clipped.
    usual = float(np.quantile(moving, STEADY))
    ends = np.abs(values[:, None] - signal.levels[[0, -1]]).min(axis=1) <= signal.rounding
    edges = np.where(ends & (edges <= JUMP * usual), 0.0, edges)
    # A machine comes to rest and leaves it gently, and rests in the same place more than once.
    found = [
        run
        for run in long
        if np.sum(values[long] == values[run]) == 1
        and edges[run] > least
        and _rest_of_record(others, starts[run], lengths[run])
    ]
    return np.array(found, int)


def _moving(
    signal: SampledSignal, steps: np.ndarray, runs: np.ndarray, beside: int = 0
) -> np.ndarray:
    """The steps outside of some runs, and not so many beside them, in a signal that moves; none of
    a command, or of what mostly rests."""
    if signal.is_command:
        return steps[:0]
    inside = np.zeros(steps.size + 1, int)
    starts, stops = signal.run_starts[runs], signal.run_starts[runs] + signal.run_lengths[runs] - 1
    np.add.at(inside, np.maximum(starts - beside, 0), 1)
    np.add.at(inside, np.minimum(stops + beside, steps.size), -1)
    moving = steps[(np.cumsum(inside[:-1]) == 0) & ~np.isnan(steps)]
    return moving if moving.size and np.mean(moving == 0) <= LONGEST_REST else steps[:0]


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

"""A signal that does not change while the rest of the record moves."""

import shlex
from collections.abc import Iterator, Sequence

import numpy as np

from riecjax.findings import Finding
from riecjax.records.faults.sampled_signal import (
    FEW_LEVELS,
    LONGEST_REST,
    SampledSignal,
    is_piecewise_linear,
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
MOVES = 0.3
"""Share of its usual sample-to-sample change past which another signal moves meanwhile."""


def stuck(signal: SampledSignal, others: Sequence[SampledSignal]) -> Iterator[Finding]:
    """A long run of one value, begun or left by a jump, while another signal moves on."""
    runs = stuck_runs(signal, others)
    if not runs.size:
        return
    starts, lengths, first = signal.run_starts, signal.run_lengths, int(runs[0])
    samples, remedy = int(lengths[runs].sum()), ("--leave-out", signal.name)
    yield signal.finding(
        "stuck_sensor",
        f"stays at exactly {signal.with_unit(signal.run_values[first])} for {lengths[first]} "
        f"samples from {signal.time[starts[first]]:.4g} s on while the rest of the record "
        f"{_rest_of_record(others, starts[first], lengths[first])} ({samples} samples in "
        f"{runs.size} place(s), {percent(samples, signal.sample_count)}). Leave them out (on the "
        f"command line: {shlex.join(remedy)}), and check the sensor, its cable and the logger.",
        doubt=samples / signal.sample_count,
        remedy=remedy,
        step=f"Leave out what {signal.name} showed while it was stuck",
    )


def stuck_runs(signal: SampledSignal, others: Sequence[SampledSignal]) -> np.ndarray:
    """Which of the signal's runs a stuck sensor showed."""
    starts, lengths, values = signal.run_starts, signal.run_lengths, signal.run_values
    usual, none = float(np.quantile(lengths, 0.95)), np.zeros(0, int)
    long = np.flatnonzero(lengths >= max(STUCK_SAMPLES, STUCK_RATIO * usual))
    if not long.size or signal.levels.size <= FEW_LEVELS or is_piecewise_linear(signal):
        return none
    steps = np.abs(np.diff(signal.values))
    elsewhere = np.ones(steps.size, bool)
    for run in long:
        elsewhere[starts[run] : starts[run] + lengths[run] - 1] = False
    moving = steps[elsewhere & ~np.isnan(steps)]
    if not moving.size or np.mean(moving == 0) > LONGEST_REST:
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

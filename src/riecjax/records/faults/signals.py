"""Faults of sensors, converters and loggers, found in the samples alone.

No check fires on what machines do: axes at rest, relays and steps, encoders that show one value for
a while, bumps in a road. The message says what to do about a fault.
"""

from collections.abc import Collection, Iterable, Iterator

import numpy as np

from riecjax.findings import Finding
from riecjax.records.faults.held_values import clipped, stuck
from riecjax.records.faults.rows import copied_signals
from riecjax.records.faults.sampled_signal import (
    FEW_LEVELS,
    SampledSignal,
    percent,
    sampled_signal,
)
from riecjax.records.faults.spikes import outliers
from riecjax.records.preparation.hum import hum
from riecjax.records.record import Record, runs

COARSE = 0.01
"""Share of a signal's rms past which its resolution matters."""
FEWEST_SAMPLES = 50
"""Present samples below which only missing and constant signals are reported."""


def missing_samples(record: Record, signals: Iterable[SampledSignal]) -> Iterator[Finding]:
    """One finding for all signals that lack the same samples, as they do in a logger's pause."""
    alike: dict[bytes, list[SampledSignal]] = {}
    for signal in signals:
        mask = np.isnan(signal.values)
        if mask.any():
            alike.setdefault(mask.tobytes(), []).append(signal)
    for group in alike.values():
        mask = np.isnan(group[0].values)
        time, step = group[0].time, float(record.time_step)
        starts, stops = runs(mask)
        # One sample, halfway, stands for all of a logger's pause.
        inside = (starts > 0) & (stops < mask.size)
        before, after = time[np.maximum(starts - 1, 0)], time[np.minimum(stops, mask.size - 1)]
        passed = np.where(inside, np.round((after - before) / step) - 1, 0).astype(int)
        lost = np.maximum(stops - starts, passed)
        first = float(before[0] + step if starts[0] > 0 else time[0])
        count = int(lost.sum())
        total = count + int((~mask).sum())
        longest = max((s.stop - s.start for s in record.segments([group[0].name])), default=1)
        names = tuple(signal.name for signal in group)
        yield Finding(
            "missing_samples",
            f"{', '.join(names)}: {percent(count, total)} of the samples ({count} of {total}) are "
            f"missing in {lost.size} gap{'s' * (lost.size > 1)}, first at {first:.4g} s; the "
            f"longest unbroken stretch lasts {(longest - 1) * step:.4g} s. Choose windows and "
            f"filters much shorter than that.",
            names,
        )


def quantised(signal: SampledSignal) -> Iterator[Finding]:
    """A resolution that is coarse against the signal's rms."""
    # Of the largest value's size, or squares of small numbers would be none.
    most = float(np.nanmax(np.abs(signal.values), initial=np.finfo(float).tiny))
    rms = most * float(np.nanstd(signal.values / most))
    steps = np.abs(np.diff(signal.values))
    steps = steps[~np.isnan(steps)]
    # Few levels that are held for long are a command's.
    held = signal.levels.size <= FEW_LEVELS and np.mean(steps == 0) > 0.95
    if signal.levels.size < 5 or held or signal.resolution <= COARSE * rms:
        return
    change = float(np.sqrt(np.mean((steps / signal.resolution) ** 2)))
    yield signal.finding(
        "quantised",
        f"its resolution of {signal.with_unit(signal.resolution)} is "
        f"{percent(signal.resolution, rms)} of its rms, and it changes by {change:.2g} such steps "
        f"from sample to sample (rms). Do not differentiate it without a low-pass, and prefer "
        f"longer windows or a finer range.",
    )


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

    Codes: `missing_samples`, `constant_signal`, `clipped`, `stuck_sensor`, `outliers`,
    `quantised`, `copied_signal` and `hum`. A signal that is constant, or has fewer than 50 samples,
    is not looked at further. Not under jit.

    **Arguments:** `computed`, signals that no sensor recorded, of which only what a computation
    keeps is reported; `pairs` of a signal and its derivative, which tell hum from motion.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    names = tuple(dict.fromkeys(names))
    every = {
        name: sampled_signal(record, name) for name in {**dict.fromkeys(names), **record.arrays}
    }
    findings = list(missing_samples(record, [every[name] for name in names]))
    for name in names:
        signal = every[name]
        if signal.levels.size == 1:
            findings.append(
                signal.finding(
                    "constant_signal",
                    f"never varies from {signal.with_unit(signal.levels[0])}, so nothing can be "
                    f"identified from it. Check that the channel was connected and is the right "
                    f"one.",
                )
            )
        elif signal.sample_count >= FEWEST_SAMPLES:
            rest = [other for other in every.values() if other is not signal]
            if name not in computed:
                findings += clipped(signal, rest)
                findings += stuck(signal, rest)
            findings += outliers(signal, rest)
            findings += quantised(signal)
    recorded = {
        name: signal
        for name, signal in every.items()
        if name not in computed and signal.sample_count >= FEWEST_SAMPLES
    }
    findings += copied_signals([recorded[name] for name in names if name in recorded])
    findings += hum(recorded, [p for p in pairs if {*p} <= {*recorded}], names)
    return findings

"""Samples that a record lacks."""

from collections.abc import Iterable, Iterator

import numpy as np

from riecjax.findings import Finding
from riecjax.records.faults.sampled_signal import (
    SampledSignal,
    percent,
)
from riecjax.records.record import Record


def missing_samples(record: Record, signals: Iterable[SampledSignal]) -> Iterator[Finding]:
    """One finding for all signals that lack the same samples, as they do in a logger's pause."""
    alike: dict[bytes, list[SampledSignal]] = {}
    for signal in signals:
        mask = np.isnan(signal.values)
        if mask.any():
            alike.setdefault(mask.tobytes(), []).append(signal)
    for group in alike.values():
        mask = np.isnan(group[0].values)
        lost, first = _in_gaps(mask, group[0].time, float(record.time_step))
        count, present = int(lost.sum()), int((~mask).sum())
        longest = max((s.stop - s.start for s in record.segments([group[0].name])), default=0)
        seconds = max(longest - 1, 0) * float(record.time_step)
        gaps = "gap" if lost.size == 1 else "gaps"
        names = tuple(signal.name for signal in group)
        yield Finding(
            "missing_samples",
            f"{', '.join(names)}: {percent(count, count + present)} of the samples ({count} of "
            f"{count + present}) are missing in {lost.size} {gaps}, first at {first:.4g} s; the "
            f"longest unbroken stretch lasts {seconds:.4g} s. Choose windows and filters much "
            f"shorter than that.",
            names,
        )


def _in_gaps(mask: np.ndarray, time: np.ndarray, step: float) -> tuple[np.ndarray, float]:
    """How many samples each gap lacks, and the time of the first that is lacking.

    One sample, halfway, stands for all of a logger's pause.
    """
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    starts, stops = edges[::2], edges[1::2]
    inside = (starts > 0) & (stops < mask.size)
    before, after = time[np.maximum(starts - 1, 0)], time[np.minimum(stops, mask.size - 1)]
    passed = np.where(inside, np.round((after - before) / step) - 1, 0).astype(int)
    first = before[0] + step if starts[0] > 0 else time[0]
    return np.maximum(stops - starts, passed), float(first)

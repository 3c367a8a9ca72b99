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
        starts = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0) == 1)
        longest = max((s.stop - s.start for s in record.segments([group[0].name])), default=0)
        seconds = max(longest - 1, 0) * float(record.time_step)
        gaps = "gap" if starts.size == 1 else "gaps"
        names = tuple(signal.name for signal in group)
        yield Finding(
            "missing_samples",
            f"{', '.join(names)}: {percent(mask.sum(), mask.size)} of the samples ({mask.sum()} of "
            f"{mask.size}) are missing in {starts.size} {gaps}, first at "
            f"{group[0].time[starts[0]]:.4g} s; the longest unbroken stretch lasts {seconds:.4g} "
            f"s. Choose windows and filters much shorter than that.",
            names,
        )

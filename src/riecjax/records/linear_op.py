"""Linear operations on signals: what one makes of samples, gaps, noise and unit, and its words.

An operation works within unbroken stretches and never reaches across a missing sample or a pause.
What it cannot compute near a gap becomes missing there, in the signal that it makes; what it cannot
compute near the record's two ends is cut off, for all signals. A signal of which nothing is left is
a `DataError`.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from riecjax.errors import DataError
from riecjax.records.noise import Noise, shortened
from riecjax.records.noise_judgement import judged
from riecjax.records.record import Record, gaps, hold, runs, samples_with_nan

Samples = Float[np.ndarray, " n"]
Places = Float[np.ndarray, " m"]
Taps = Float[np.ndarray, " taps"]
SAME_TIME = 1e-6
"""Share of a step within which a new time is a sample's time."""


@dataclass(frozen=True)
class LinearOp:
    """What makes a signal of a record's signal, its gaps and its noise.

    **Fields:**

    - `words`: what it does, with `{}` for the signal that it makes.
    - `at`: of samples, shape `(n,)` and NaN where they are missing, the values at places, shape
      `(m,)` and counted in samples; NaN where they reach beyond an unbroken stretch.
    - `lost`: samples cut off at the record's start and at its end.
    - `noise`: of a kernel of the signal's noise that of what is made; `None` where the noise stays,
      as what is taken off is none of it.
    - `source`: the signal that it reads, where that is another than it makes.
    - `unit`: what is put behind the source's unit.
    - `aim`, `shortest`, `remedy`: what for, and how many samples it takes in succession, and what
      to do where there are not so many.
    - `step`: seconds between samples of the new time base, where it makes one, for all signals;
      `spacing`, the same in terms of the old step.
    """

    words: str
    at: Callable[[Samples, Places], Samples]
    lost: tuple[int, int] = (0, 0)
    noise: Callable[[Taps], Taps] | None = None
    source: str = ""
    unit: str = ""
    aim: str = ""
    shortest: int = 1
    remedy: str = "Repair the gaps."
    step: float | None = None
    spacing: float = 1.0

    @classmethod
    def of_taps(cls, words: str, taps: Taps, first: int, **fields: Any) -> "LinearOp":
        """Weighted sums of samples, the first of which lies so many samples on.

        Where the middle one is at the place itself, noise goes through the same sums.
        """

        def sums(samples: Samples, *_: Any) -> Samples:
            valid = np.convolve(samples, taps[::-1], "valid")
            places = np.arange(valid.size) - first
            there = (places >= 0) & (places < samples.size)
            made = np.full(samples.size, np.nan)
            made[places[there]] = valid[there]
            return made

        fields = {"noise": convolved_with(taps[::-1]), "shortest": taps.size, **fields}
        lost = max(-first, 0), max(first + taps.size - 1, 0)
        return cls.of_stretches(words, sums, lost=lost, **fields)

    @classmethod
    def of_stretches(
        cls, words: str, function: Callable[[Samples, Places, int], Samples], **fields: Any
    ) -> "LinearOp":
        """What a function makes of each unbroken stretch that is long enough for it.

        **Arguments:** `function` of a stretch's samples, of the places in it as counted from the
        record's first sample, and of the stretch's first sample.
        """

        def at(samples: Samples, places: Places) -> Samples:
            made = np.full(places.size, np.nan)
            for first, stop in runs(~np.isnan(samples)).T.tolist():
                rows = slice(*np.searchsorted(places, [first - SAME_TIME, stop]))
                if stop - first >= fields.get("shortest", 1):
                    made[rows] = function(samples[first:stop], places[rows], first)
            return made

        return cls(words, at, **fields)

    @classmethod
    def of_values(cls, words: str, values: Samples) -> "LinearOp":
        """Values that differ from the samples by what is none of their noise: a mean, a line, a
        spike; NaN where they are left out."""
        return cls(words, lambda *_: values)


def convolved_with(taps: Taps) -> Callable[[Taps], Taps]:
    """Of a kernel of noise that of the noise through a filter, the middle tap for the same sample.

    What the filter's ends add to hardly anything is left out.
    """
    return lambda kernel: shortened(np.convolve(kernel, taps))


def words_of(ops: Mapping[str, LinearOp]) -> Iterator[str]:
    """What operations do, those in one sentence whose words begin alike before the signal."""
    signals: dict[str, list[str]] = {}
    for name, op in ops.items():
        before, signal, after = op.words.partition("{}")
        alone = not before or not signal
        said = signals.setdefault(op.words.format(name) if alone else before, [])
        said += [] if alone else [f"{name}{after}"]
    return (before + ", ".join(each) for before, each in signals.items())


def through(record: Record, ops: Mapping[str, LinearOp]) -> Record:
    """A record with the signals that operations make, by their name. Not under jit.

    The noise of a signal that is filtered is judged before.

    **Raises:** `DataError` for a signal that the record lacks, or of which no stretch is long
    enough.
    """
    if not ops:
        return record
    sources = {name: op.source or name for name, op in ops.items()}
    samples = {source: samples_with_nan(record, source) for source in sources.values()}
    if changed := [sources[name] for name, op in ops.items() if op.noise is not None]:
        record = judged(record, "auto", *changed)
    noise, stated = record.noise, dict(record.units)
    kernels = {
        name: {s: op.noise(np.asarray(taps)) for s, taps in noise.kernels[sources[name]].items()}
        for name, op in ops.items()
        if op.noise is not None
    }
    noise = noise.joined(Noise(kernels, noise.freedom))
    units = {n: stated[sources[n]] + op.unit for n, op in ops.items() if sources[n] in stated}
    every, count = tuple(ops.values()), record.sample_count
    if every[0].step is None:
        columns = {n: op.at(samples[sources[n]], np.arange(count)) for n, op in ops.items()}
        first, stop = max(op.lost[0] for op in every), count - max(op.lost[1] for op in every)
        _require_samples(record, ops, {n: values[first:stop] for n, values in columns.items()})
        held = {name: hold(values) for name, values in columns.items()}
        made = record.with_signals(held, units, gaps(columns), noise)
        return made.part(first, stop) if (first, stop) != (0, count) else made
    # Stretches of one even grid lie between pauses, which no signal spans.
    missing = np.all([np.isnan(values) for values in samples.values()], axis=0)
    even = ~missing if record.stamps is not None else np.ones(count, bool)
    stamps, columns = [], {name: [] for name in ops}
    for run in runs(even).T.tolist():
        time, signals = _resampled(record, slice(*run), samples, ops)
        stamps.append(time)
        for name, values in signals.items():
            columns[name].append(values)
    # One missing sample between each two is the pause.
    stamps, *joined = (
        np.concatenate([np.append(part, np.nan) for part in parts if part.size] or [[np.nan] * 2])[
            :-1
        ]
        for parts in (stamps, *columns.values())
    )
    columns = dict(zip(columns, joined))
    _require_samples(record, ops, columns)
    pauses = np.flatnonzero(np.isnan(stamps))
    stamps[pauses] = 0.5 * (stamps[pauses - 1] + stamps[pauses + 1])
    return Record(
        {name: hold(values) for name, values in columns.items()},
        every[0].step,
        stamps[0],
        units,
        gaps(columns),
        stamps if pauses.size else None,
        record.skipped + (stamps[0] - record.time[0]),
        noise,
    )


def _resampled(
    record: Record, run: slice, samples: Mapping[str, Samples], ops: Mapping[str, LinearOp]
) -> tuple[Samples, dict[str, Samples]]:
    """Times and signals of one run on its new grid, NaN in gaps, less the rows at its ends where
    nothing could be computed."""
    op = next(iter(ops.values()))
    old_time = np.asarray(record.time)[run]
    # Stamps may be rounded; together they tell the run's start more precisely than its first.
    start = float(np.mean(old_time - float(record.time_step) * np.arange(old_time.size)))
    places = op.spacing * np.arange(int((old_time.size - 1) / op.spacing + SAME_TIME) + 1)
    columns = {name: op.at(samples[name][run], places) for name, op in ops.items()}
    some = np.flatnonzero(~np.all([np.isnan(values) for values in columns.values()], axis=0))
    rows = slice(some[0], some[-1] + 1) if some.size else slice(0)
    time = start + float(op.step or 0.0) * np.arange(places.size)
    return time[rows], {name: values[rows] for name, values in columns.items()}


def _require_samples(
    record: Record, ops: Mapping[str, LinearOp], columns: Mapping[str, Samples]
) -> None:
    for name, op in ops.items():
        if np.isnan(columns[name]).all():
            source = op.source or name
            raise DataError(
                f"no stretch of '{source}' without a gap is long enough {op.aim}: it takes "
                f"{op.shortest} samples, and the longest has {longest_stretch(record, source)}. "
                f"{op.remedy}"
            )


def longest_stretch(record: Record, signal: str) -> int:
    """Samples in the longest unbroken stretch of a signal."""
    return max((part.stop - part.start for part in record.segments([signal])), default=0)


def require_named(record: Record, signals: Collection[str], purpose: str) -> None:
    """**Raises:** `DataError` for no signal."""
    if not signals:
        raise DataError(f"name the signals to {purpose}; there are: {', '.join(record.arrays)}.")

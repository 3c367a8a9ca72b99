"""Linear operations on signals: what one makes of samples, gaps, noise and unit, and its words.

An operation works within unbroken stretches and never reaches across a missing sample or a pause.
What it cannot compute near a gap becomes missing there, in the signal that it makes; what it cannot
compute near the record's two ends is cut off, for all signals. A signal of which nothing is left is
a `DataError`.
"""

import functools
import inspect
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ParamSpec, Protocol, TypeAlias, get_origin

import numpy as np
from jaxtyping import Float

from riecjax.errors import DataError, require
from riecjax.records.noise_judgement import judged
from riecjax.records.record import Record, runs
from riecjax.records.signal import Samples, Signal, SignalNoise, Taps

Places = Float[np.ndarray, " m"]
SAME_TIME = 1e-6
"""Share of a step within which a new time is a sample's time."""


@dataclass(frozen=True)
class LinearOp:
    """What makes a signal of a record's signal: of its values, gaps, noise and unit.

    **Fields:**

    - `words`: what it does, with `{}` for the signal that it makes.
    - `at`: of samples, shape `(n,)` and NaN where they are missing, the values at places, shape
      `(m,)` and counted in samples; NaN where they reach beyond an unbroken stretch.
    - `lost`: samples cut off at the record's start and at its end.
    - `noise`: of a signal's noise that of what is made, to be judged before; `None` where it stays,
      as what is taken off is none of it.
    - `source`: the signal that it reads, where that is another than it makes.
    - `unit`: what is put behind the source's unit.
    - `shortest`: samples in succession that it takes.
    - `spacing`: of samples of the new time base, in terms of the old, where it makes one, for all
      signals.
    """

    words: str
    at: Callable[[Samples, Places], Samples]
    lost: tuple[int, int] = (0, 0)
    noise: Callable[[SignalNoise], SignalNoise] | None = None
    source: str = ""
    unit: str = ""
    shortest: int = 1
    spacing: float | None = None

    @classmethod
    def of_taps(cls, words: str, taps: Taps, first: int, **fields: Any) -> "LinearOp":
        """Weighted sums of samples, the first of which lies so many samples on.

        Noise goes through the same sums.
        """
        last = first + taps.size - 1
        lost = max(-first, 0), max(last, 0)

        def sums(samples: Samples, *_: Any) -> Samples:
            padded = np.pad(samples, lost, constant_values=np.nan)
            return np.convolve(padded, taps[::-1], "valid")[max(first, 0) :][: samples.size]

        # The middle tap of a kernel is for the same sample.
        room = max(lost) - last, max(lost) + first
        fields = {
            "noise": lambda noise: noise.convolved(np.pad(taps[::-1], room)),
            "shortest": taps.size,
            **fields,
        }
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

    def carry_out(self, ops: "Mapping[str, LinearOp]", record: Record) -> Record:
        """What [`Record.through`][] does with operations of this one's time base."""
        kept = [] if self.spacing is None else [name for name in record.arrays if name not in ops]
        if kept or any(op.spacing != self.spacing for op in ops.values()):
            raise DataError(
                f"operations that make a new time base must make the same for all signals: "
                f"{', '.join(record.arrays)}."
            )
        sources = {name: op.source or name for name, op in ops.items()}
        filtered = [sources[name] for name, op in ops.items() if op.noise is not None]
        record = judged(record, "auto", *filtered) if filtered else record
        signals = {name: record.signal(source) for name, source in sources.items()}
        samples = {name: signal.with_nan for name, signal in signals.items()}
        times: list[Samples] = []
        if self.spacing is None:
            rows = np.arange(record.sample_count)
            columns = {name: op.at(samples[name], rows) for name, op in ops.items()}
        else:
            # Stretches of one even grid lie between pauses, which no signal spans. Of each, rows
            # at its ends where nothing could be computed are left out.
            old_time, step = np.asarray(record.time), float(record.time_step)
            missing = np.all([np.isnan(values) for values in samples.values()], axis=0)
            pieces = [np.zeros((len(ops), 0))]
            for begin, end in runs(~missing | (record.stamps is None)).T.tolist():
                size = end - begin
                # Stamps may be rounded; together they tell the start more precisely than its first.
                start = np.mean(old_time[begin:end] - step * np.arange(size))
                places = np.arange(int((size - 1) / self.spacing + SAME_TIME) + 1) * self.spacing
                made = np.array([op.at(samples[n][begin:end], places) for n, op in ops.items()])
                some = np.flatnonzero(~np.isnan(made).all(0))
                if some.size:
                    # One missing sample between each two is the pause, its time the middle of it.
                    pieces += [made[:, some[0] : some[-1] + 1], np.full((len(ops), 1), np.nan)]
                    times.append(start + self.spacing * step * np.arange(some[0], some[-1] + 2))
            for stretch, following in itertools.pairwise(times):
                stretch[-1] = 0.5 * (stretch[-2] + following[0])
            columns = {name: column[:-1] for name, column in zip(ops, np.hstack(pieces))}
        first, after = (max(lost) for lost in zip(*(op.lost for op in ops.values())))
        for name, op in ops.items():
            if np.isnan(columns[name][first : columns[name].size - after]).all():
                raise DataError(
                    f"no stretch of '{sources[name]}' without a gap is long enough for a step of "
                    f"preparation ({op.words.format(name)}): it takes {op.shortest} samples, and "
                    f"the longest has {longest_stretch(record, sources[name])}. Repair the gaps, "
                    f"change or leave out this step, or record for longer."
                )
            known = signals[name]
            noise = op.noise(known.noise) if op.noise and known.noise else known.noise
            unit = f"{known.unit}{op.unit}" if known.unit else dict(record.units).get(name, "")
            signals[name] = Signal.of(columns[name], unit, noise)
        if self.spacing is None:
            made = record.with_signals(signals)
            return made.part(first, made.sample_count - after) if first or after else made
        stamps = np.concatenate(times)[:-1]
        step, skipped = self.spacing * record.time_step, stamps[0] - record.time[0]
        return Record(
            signals, step, stamps[0], stamps if len(times) > 1 else None, record.skipped + skipped
        )


def convolved_with(*taps: float) -> Callable[[SignalNoise], SignalNoise]:
    """Of a signal's noise that behind a filter, the middle tap for the same sample."""
    return lambda noise: noise.convolved(np.array(taps))


Asked = ParamSpec("Asked")
Operations: TypeAlias = Iterator[tuple[str, LinearOp]]
"""What makes a record's signals, with the signal that each makes."""


class Step(Protocol[Asked]):
    """A step of preparation: what its operations, by the signal that each makes, make of a
    record."""

    ops: Callable[Asked, Operations]

    def __call__(self, *args: Asked.args, **kwargs: Asked.kwargs) -> Record:
        """The record after it."""
        ...


def step(operations: Callable[Asked, Operations]) -> Step[Asked]:
    """The step of preparation that takes a record first, by its operations."""

    signature = inspect.signature(operations)
    by_signal = {n for n, p in signature.parameters.items() if get_origin(p.annotation) is Mapping}

    @functools.wraps(operations)
    def step_taken(*args: Asked.args, **kwargs: Asked.kwargs) -> Record:
        asked = signature.bind(*args, **kwargs).arguments
        require(
            "the record", asked["record"], Record, "recording.record, of a recording", DataError
        )
        for name in by_signal:
            require(name, asked[name], Mapping, "{'x': ...}, by signal", DataError)
        return asked["record"].through(dict(operations(*args, **kwargs)))

    taken: Any = step_taken
    taken.ops, taken.__annotations__["return"] = operations, Record
    return taken


def words_of(ops: Mapping[str, LinearOp]) -> Iterator[str]:
    """What operations do, those in one sentence whose words begin alike before the signal."""
    signals: dict[str, list[str]] = {}
    for name, op in ops.items():
        before, signal, after = op.words.partition("{}")
        alone = not before or not signal
        said = signals.setdefault(op.words.format(name) if alone else before, [])
        said += [] if alone else [f"{name}{after}"]
    return (before + ", ".join(each) for before, each in signals.items())


def longest_stretch(record: Record, signal: str) -> int:
    """Samples in the longest unbroken stretch of a signal."""
    return max((part.stop - part.start for part in record.segments([signal])), default=0)

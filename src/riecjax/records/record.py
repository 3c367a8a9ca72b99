"""A recording: uniformly sampled, named signals."""

import dataclasses
import functools
import os
from collections import UserDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.errors import DataError, MissingSignalError, require
from riecjax.extensions import require_packages
from riecjax.leaves import PlainMethods
from riecjax.records.signal import Noise, Signal, SignalNoise, both
from riecjax.records.time_base import time_base
from riecjax.shows import Drawn


class Operation(Protocol):
    """What makes signals of a record's: a [`LinearOp`][riecjax.records.LinearOp]."""

    def carry_out(self, ops: Mapping[str, Any], record: "Record") -> "Record":
        """The record with what operations of one time base make, by the signal that each makes."""
        ...


class Signals(UserDict[str, Array]):
    """The signals of a record by name; asking for one that is missing says which ones exist.

    `read` collects the names that were asked for: which signals an expression depends on.
    """

    def __init__(self, arrays: Mapping[str, Array]):
        super().__init__(arrays)
        self.read: set[str] = set()

    def __getitem__(self, name: str) -> Array:
        if name not in self:
            raise MissingSignalError(name, tuple(self.data))
        self.read.add(name)
        return super().__getitem__(name)


class Record(PlainMethods, Drawn, eqx.Module):
    """Uniformly sampled, named signals of one recording.

    A record is a pytree: its arrays trace, vmap and differentiate. Build one from user data with
    [`Record.from_samples`][], which checks everything once; code downstream trusts a record.

    No window and no filter reaches across samples that are missing. A pause, however long, takes
    one sample.

    **Fields:**

    - `by_name`: signal name to the [`Signal`][riecjax.Signal], all of one length.
    - `time_step`: seconds between samples, scalar.
    - `start_time`: time of the first sample in seconds, scalar.
    - `stamps`: time of each sample in seconds where the record has pauses, else `None`.
    - `skipped`: seconds of the recording that were cut off before the first sample, scalar.
    """

    by_name: dict[str, Signal]
    time_step: Float[Array, ""]
    start_time: Float[Array, ""]
    stamps: Float[Array, " n"] | None
    skipped: Float[Array, ""]

    def __init__(
        self,
        by_name: Mapping[str, Signal | ArrayLike | Array],
        time_step: ArrayLike | Array,
        start_time: ArrayLike | Array = 0.0,
        stamps: ArrayLike | Array | None = None,
        skipped: ArrayLike | Array = 0.0,
    ):
        require("what a record is made of", by_name, Mapping, WRITE_RECORD, DataError)
        self.by_name = {}
        for name, given in by_name.items():
            signal = _signal(name, given)
            values = _owned(_numbers(name, signal.values), float)
            present = None if signal.present is None else _owned(signal.present, bool)
            self.by_name[name] = Signal(values, present, signal.unit, signal.noise)
        # Of a batch of records, signals and time steps have the batch's axes in front.
        axes = max((values.ndim for values in self.arrays.values()), default=1) - 1
        if np.ndim(time_step) > axes:
            raise DataError(
                "the time step must be one number of seconds; got an array. For the time of each "
                'sample write rx.Record.from_samples({"x": x}, time=t).'
            )
        if xp.is_concrete(time_step):
            try:
                time_step = np.asarray(time_step, float)
            except (TypeError, ValueError):
                require("the time step", time_step, (), WRITE_RECORD, DataError)
                raise
            if not (np.isfinite(time_step) & (time_step > 0)).all():
                least = np.min(time_step)
                raise DataError(
                    f"the time step must be a positive number of seconds; got {least:g}."
                )
        self.time_step = xp.asarray(time_step, float)
        self.start_time = xp.asarray(start_time, float)
        self.stamps = None if stamps is None else _owned(stamps, float)
        self.skipped = xp.asarray(skipped, float)

    def __check_init__(self):
        lengths = {name: values.shape for name, values in self.arrays.items()}
        if not lengths:
            raise DataError("a record needs at least one signal.")
        masks = {f"{name}.present": signal.present for name, signal in self.by_name.items()}
        beside = {"stamps": self.stamps, **masks}.items()
        samples = {name: each.shape[-1:] for name, each in beside if each is not None}
        rows = {shape[-1:] for shape in lengths.values()} | {*samples.values()}
        if len(set(lengths.values())) > 1 or len(rows) > 1:
            listed = ", ".join(f"{name} {shape}" for name, shape in (lengths | samples).items())
            raise DataError(f"all signals of a record must have the same length; got {listed}.")

    @classmethod
    def from_samples(
        cls,
        signals: Mapping[str, ArrayLike],
        time: ArrayLike | None = None,
        *,
        time_step: float | None = None,
        units: Mapping[str, str] | None = None,
    ) -> "Record":
        """Check user data and make a record of it.

        **Arguments:**

        - `signals`: name to samples, each of shape `(n,)`; NaN where a sample is missing.
        - `time`: time of each sample in seconds, shape `(n,)`; or give `time_step` in seconds.
          Between evenly sampled stretches there may be pauses, and stamps may jitter by 1 % of a
          step.
        - `units`: name to unit, for those that are known.

        **Raises:** `DataError` for fewer than two samples, infinity, a signal without any sample, a
        unit of no signal, unequal lengths, and time that does not increase or is not evenly spaced.
        """
        require("what a record is made of", signals, Mapping, WRITE_RECORD, DataError)
        arrays = {name: _samples(name, values) for name, values in signals.items()}
        if (time is None) == (time_step is None):
            raise DataError("give either the time of each sample or the time step, not both.")
        if time is not None and np.ndim(time) == 0:
            raise DataError(
                f"time must hold the time of each sample; got {time}. Write {WRITE_RECORD}."
            )
        every = arrays if time is None else {**arrays, "t": _samples("t", time)}
        if len({values.size for values in every.values()}) > 1:
            listed = ", ".join(f"{name} {values.size}" for name, values in every.items())
            raise DataError(f"all signals and the time must have the same length; got {listed}.")
        step: Any = time_step
        start, stamps = 0.0, None
        if time is not None:
            given = every["t"]
            (step, pauses, *_), start = time_base(given), given[0]
            if pauses.size:
                # The middle of each pause.
                stamps = np.insert(given, pauses, 0.5 * (given[pauses - 1] + given[pauses]))
                arrays = {k: np.insert(v, pauses, np.nan) for k, v in arrays.items()}
        if min((values.size for values in arrays.values()), default=2) < 2:
            raise DataError("a record needs at least two samples.")
        known = units or {}
        if unknown := [name for name in known if name not in arrays]:
            raise DataError(
                f"a unit is given for '{unknown[0]}', and there is no such signal; there are: "
                f"{', '.join(arrays)}."
            )
        by_name = {name: Signal.of(v, known.get(name, "")) for name, v in arrays.items()}
        return cls(by_name, step, start, stamps)

    @property
    def arrays(self) -> dict[str, Float[Array, " n"]]:
        """The samples of each signal by name."""
        arrays: Any = {name: signal.values for name, signal in self.by_name.items()}
        return arrays

    @property
    def units(self) -> tuple[tuple[str, str], ...]:
        """(signal name, unit) pairs for those signals whose unit is known, by name."""
        known = {name: signal.unit for name, signal in self.by_name.items() if signal.unit}
        return tuple(sorted(known.items()))

    @property
    def noise(self) -> Noise:
        """What is known of the signals' noise."""
        return Noise.of({n: s.noise for n, s in self.by_name.items() if s.noise is not None})

    def signal(self, name: str) -> Signal:
        """A signal; of a missing one, an error that says which ones exist."""
        return _named(self.by_name, name)

    @property
    def signals(self) -> Signals:
        """The signals by name, with a helpful error for a missing one."""
        return Signals(self.arrays)

    def __getitem__(self, name: str) -> Float[Array, " n"]:
        samples: Any = _named(self.by_name, name).values
        return samples

    @property
    def sample_count(self) -> int:
        """Number of samples n."""
        return next(iter(self.by_name.values())).values.shape[-1]

    @property
    def duration(self) -> Float[Array, ""]:
        """Seconds recorded, pauses left out: t_max of eq. (15)."""
        return xp.multiply(self.time_step, self.sample_count - 1)

    @property
    def time(self) -> Float[Array, " n"]:
        """Time of each sample in seconds."""
        if self.stamps is not None:
            return self.stamps
        return xp.add(self.start_time, xp.multiply(self.time_step, np.arange(self.sample_count)))

    @property
    def elapsed(self) -> Float[Array, " n"]:
        """Time of each sample in seconds from the recording's first, cut off or not.

        The clock of cuts, messages and figures: small numbers, also where `time` is of an epoch.
        """
        if self.stamps is not None:
            return self.skipped + (self.stamps - self.stamps[0])
        return xp.add(self.skipped, xp.multiply(self.time_step, np.arange(self.sample_count)))

    def to_frame(self) -> Any:
        """A pandas data frame of the signals, NaN where one lacks its sample; time in s is its
        index.

        **Raises:** `DataError` if pandas is not installed.
        """
        require_packages("frame")
        import pandas

        columns = {name: signal.with_nan for name, signal in self.by_name.items()}
        return pandas.DataFrame(columns, index=pandas.Index(np.asarray(self.time), name="t"))

    def present(self, names: Iterable[str]) -> Bool[Array, " n"] | None:
        """True where none of these signals lacks its sample; `None` where none ever does."""
        known = [name for name in sorted(set(names)) if name in self.by_name]
        mask: Any = functools.reduce(both, (self.by_name[name].present for name in known), None)
        return mask

    def with_signals(self, signals: Mapping[str, Signal | ArrayLike | Array]) -> "Record":
        """A record with these signals added or replaced.

        Of bare arrays nothing is known of their noise; a signal that they replace leaves them its
        unit. A NaN of NumPy's is a missing sample; in JAX's arrays, traced or not, all are present.
        """
        units = {name: signal.unit for name, signal in self.by_name.items()}
        given = {n: _signal(n, samples, units.get(n, "")) for n, samples in signals.items()}
        return dataclasses.replace(self, by_name={**self.by_name, **given})

    def through(self, op: Operation | Mapping[str, Operation], *names: str) -> "Record":
        """A record with what operations make of its signals: values, gaps, noise and unit.

        Not under jit.

        **Arguments:** `op` on the signals of these `names`; or operations by the signal that each
        makes.

        **Raises:** `DataError` for a signal that the record lacks, or of which no stretch is long
        enough; for no name at all; and for new time bases that differ or leave a signal out.
        """
        ops = op if isinstance(op, Mapping) else dict.fromkeys(names, op)
        if not ops and not isinstance(op, Mapping):
            raise DataError(
                "the signals that the operation makes have no names. Write "
                'record.through(op, "x", "dx").'
            )
        return next(iter(ops.values())).carry_out(ops, self) if ops else self

    def with_noise(self, noise: Noise) -> "Record":
        """The same samples; of the noise of the signals that it names, this is known.

        **Raises:** `DataError` for a signal that the record lacks.
        """
        require(
            "what is known of the noise", noise, Noise, "rx.Noise.given({'x': 0.01})", DataError
        )
        for name in noise.kernels:
            self.signal(name)
        signals = {}
        for name, signal in self.by_name.items():
            if name in noise.kernels or signal.noise is not None:
                before = signal.noise or SignalNoise()
                # A source that is said anew is so for all that is made of it.
                freedom = {**before.freedom, **noise.freedom}
                known = SignalNoise(noise.kernels.get(name, before.kernels), freedom)
                signals[name] = dataclasses.replace(signal, noise=known)
        return self.with_signals(signals)

    def select(self, *names: str) -> "Record":
        """A record of only these signals, in this order."""
        return dataclasses.replace(self, by_name={n: _named(self.by_name, n) for n in names})

    def part(self, start: int, stop: int) -> "Record":
        """The samples from `start` up to, not including, `stop`."""
        if not 0 <= start < stop <= self.sample_count:
            raise DataError(
                f"samples {start} to {stop} do not lie in a record of {self.sample_count} samples."
            )
        return self._rows(lambda values: values[..., start:stop], start)

    def stretch(self, first: Int[Array, ""], count: int) -> "Record":
        """`count` samples from `first` on, which may be traced; both must lie in the record."""
        return self._rows(lambda values: xp.cut(values, first, count), first)

    def every(self, count: int) -> "Record":
        """Every `count`-th sample, without filtering first.

        **Raises:** `DataError` unless 1 <= count and two samples remain.
        """
        if count < 1 or (self.sample_count - 1) // count < 1:
            raise DataError(
                f"cannot take every {count}th of {self.sample_count} samples: too few would remain."
            )

        # Thinning must not lose a gap between two samples that stay: a gap then widens to one.
        def thin(mask: Array) -> Array:
            room = [(0, 0)] * (mask.ndim - 1) + [(0, -mask.shape[-1] % count)]
            padded = xp.pad(mask, room, constant_values=True)
            return padded.reshape(*mask.shape[:-1], -1, count).all(-1)

        return self._rows(lambda values: values[..., ::count], 0, count, thin)

    def segments(self, names: Iterable[str] | None = None) -> list[slice]:
        """Unbroken stretches, in which none of these signals (or of all) lacks a sample.

        Not under jit.
        """
        present = self.present(self.arrays if names is None else names)
        if present is None:
            return [slice(0, self.sample_count)]
        return [slice(a, b) for a, b in runs(np.asarray(present)).T.tolist()]

    def _rows(
        self,
        cut: Callable[[Any], Array],
        first: int | Int[Array, ""],
        count: int = 1,
        thin: Callable[[Any], Array] | None = None,
    ) -> "Record":
        """What `cut` leaves, from the row `first` on, so many steps apart; `thin` of masks."""
        stamps = None if self.stamps is None else cut(self.stamps)
        earlier = first * self.time_step
        known = [signal.noise for signal in self.by_name.values() if signal.noise is not None]
        wide = {s for noise in known for s, taps in noise.kernels.items() if taps.shape[-1] > 1}

        by_name = {
            name: Signal(
                cut(signal.values),
                None if signal.present is None else (thin or cut)(signal.present),
                signal.unit,
                signal.noise and signal.noise.thinned(count, wide),
            )
            for name, signal in self.by_name.items()
        }
        return Record(
            by_name,
            self.time_step * count,
            self.start_time + earlier if stamps is None else stamps[..., 0],
            stamps,
            self.skipped + earlier if stamps is None else self.elapsed[first],
        )


# Asked of the record, each would cost a look at all of its arrays by Equinox.
def _named(by_name: Mapping[str, Signal], name: str) -> Signal:
    if name not in by_name:
        raise MissingSignalError(name, tuple(by_name))
    return by_name[name]


WRITE_RECORD = 'rx.Record.from_samples({"x": x}, time_step=0.005), samples by name'


class HasRecord(Protocol):
    """Something around a record, such as a [`Recording`][riecjax.Recording]."""

    @property
    def record(self) -> Record:
        """The signals."""
        ...


Records: TypeAlias = Record | HasRecord | Sequence[Record | HasRecord]
"""One record or several, bare or with where they came from."""


def as_records(records: Records) -> list[Record]:
    """One record or several as a list; of recordings, their records.

    **Raises:** `ModelError` for anything else, saying what to write; `DataError` for none at all.
    """
    single = (
        f"rx.read_recording('{records}')"
        if isinstance(records, str | os.PathLike)
        else "rx.Record.from_samples({'x': samples, ...}, time_step=...) of samples by name, or "
        "rx.from_dataframe(frame); the model comes first, then its records"
    )
    several = isinstance(records, list | tuple)
    listed: Any = records if several else [records]
    given = [xp.hosted(getattr(each, "record", each), double=True) for each in listed]
    kinds = Record if several else (Record, list, tuple)
    for record in given:
        require("one of the records" if several else "the record", record, kinds, single)
    if not given:
        raise DataError("at least one record is needed.")
    return given


def stack_records(records: list[Record]) -> Record:
    """Records of equal length as one batched record, to `jax.vmap` over its leading axis."""
    return xp.stacked(records)


def _owned(values: Any, dtype: Any) -> Array:
    """An array that no one else writes to, of NumPy and in double precision unless it is traced."""
    if xp.is_traced(values):
        return jnp.asarray(values, dtype)
    # One that was owned before, as of a record with another signal.
    known = type(values) is np.ndarray and values.base is None and not values.flags.writeable
    owned = np.array(values, dtype, copy=None if known else True)
    owned.flags.writeable = False
    return owned


def _numbers(name: str, values: Any) -> Any:
    """Samples that are real numbers, as an array of NumPy or JAX.

    **Raises:** `DataError` for anything else: text, times, complex numbers; and for a name that is
    no text.
    """
    require("a signal's name", name, str, WRITE_RECORD, DataError)
    if not name.strip():
        raise DataError(f"a signal's name is empty. Write {WRITE_RECORD}.")
    try:
        if isinstance(values, np.ma.MaskedArray):
            values = np.ma.filled(values.astype(float), np.nan)
        samples = values if isinstance(values, jax.Array) else np.asarray(values)
        samples = samples.astype(float) if samples.dtype.kind == "O" else samples
    except (TypeError, ValueError):
        raise DataError(f"signal '{name}' is not a list of numbers.") from None
    if samples.dtype.kind == "c":
        raise DataError(
            f"signal '{name}' holds complex numbers, and a record real ones. Give its real or "
            f"imaginary part, or both as two signals."
        )
    if samples.dtype.kind in "USMm":
        raise DataError(
            f"signal '{name}' is not a list of numbers but of {samples.dtype.name}; convert it "
            f"first."
        )
    return samples


def _signal(name: str, values: Any, unit: str = "") -> Signal:
    """A signal as it is; of bare samples NumPy's are missing where they are NaN or masked."""
    if isinstance(values, Signal):
        return values
    samples = _numbers(name, values)
    if isinstance(samples, jax.Array):
        return Signal(samples, unit=unit)
    return Signal.of(samples, unit)


def _samples(name: str, values: ArrayLike) -> np.ndarray:
    samples = np.asarray(_numbers(name, values), float)
    if samples.ndim != 1:
        raise DataError(
            f"signal '{name}' must be one column of samples; it has shape {samples.shape}."
        )
    infinite = np.isinf(samples)
    if infinite.any():
        raise DataError(
            f"signal '{name}' has {int(infinite.sum())} infinite value(s), the first at sample "
            f"{int(np.argmax(infinite))}. Remove or repair those samples."
        )
    if samples.size and np.isnan(samples).all():
        raise DataError(f"signal '{name}' holds no number at all.")
    return samples


def runs(mask: np.ndarray) -> np.ndarray:
    """First samples of all stretches in which a mask, shape `(n,)`, is True, and their ends.

    Shape `(2, stretches)`; an end is the sample behind the last.
    """
    return np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).reshape(-1, 2).T


def run_lengths(mask: np.ndarray) -> np.ndarray:
    """Of each sample how many there are in its stretch in which a mask is True, 0 outside."""
    starts, stops = runs(mask)
    lengths = np.zeros(mask.size, int)
    lengths[mask] = np.repeat(stops - starts, stops - starts)
    return lengths


def deviation(records: Iterable[Record], name: str) -> float:
    """Standard deviation of a signal within records, r.m.s. over them."""
    return float(np.sqrt(np.mean([np.var(np.asarray(record[name])) for record in records])))


TO_A_DOUBLING = 4
"""Lengths that [`shared_length`][] has between one power of two and the next."""


def shared_length(samples: int) -> int:
    """How many samples a record is filled up to, to be simulated: a quarter more at most.

    So records of many lengths share compiled functions.
    """
    step = max(2 ** (samples - 1).bit_length() // (2 * TO_A_DOUBLING), 1)
    return -(-samples // step) * step

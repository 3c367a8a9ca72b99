"""A recording: uniformly sampled, named signals."""

import dataclasses
import functools
import os
from collections import UserDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import ArrayLike

from riecjax.errors import DataError, MissingSignalError, require
from riecjax.leaves import is_concrete, namespace
from riecjax.records.noise import Noise
from riecjax.records.time_base import time_base
from riecjax.shows import Drawn, framed

if TYPE_CHECKING:
    from riecjax.records.linear_op import LinearOp


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


class Record(Drawn, eqx.Module):
    """Uniformly sampled, named signals of one recording.

    A record is a pytree: its arrays trace, vmap and differentiate. Build one from user data with
    [`Record.from_samples`][], which checks everything once; code downstream trusts a record.

    Samples that are not there (a NaN in the file, a pause of the logger) are marked in `missing`
    and hold the last value before them, so that every array is finite. No window and no filter
    reaches across them. A pause, however long, takes one sample.

    **Fields:**

    - `arrays`: signal name to its samples, shape `(n,)`, all of one length.
    - `time_step`: seconds between samples, scalar.
    - `start_time`: time of the first sample in seconds, scalar.
    - `units`: (signal name, unit) pairs for those signals whose unit is known.
    - `missing`: signal name to a mask, True where its sample is missing; only signals that lack
      some are named.
    - `stamps`: time of each sample in seconds where the record has pauses, else `None`.
    - `skipped`: seconds of the recording that were cut off before the first sample, scalar.
    - `noise`: what is known of the signals' noise; what made one signal of another says how that
      changed it.
    """

    arrays: dict[str, Float[Array, " n"]]
    time_step: Float[Array, ""]
    start_time: Float[Array, ""]
    units: tuple[tuple[str, str], ...] = eqx.field(static=True)
    missing: dict[str, Bool[Array, " n"]]
    stamps: Float[Array, " n"] | None
    skipped: Float[Array, ""]
    noise: Noise

    def __init__(
        self,
        arrays: Mapping[str, ArrayLike | Array],
        time_step: ArrayLike | Array,
        start_time: ArrayLike | Array = 0.0,
        units: Mapping[str, str] | tuple[tuple[str, str], ...] = (),
        missing: Mapping[str, ArrayLike | Array] | None = None,
        stamps: ArrayLike | Array | None = None,
        skipped: ArrayLike | Array = 0.0,
        noise: Noise | None = None,
    ):
        require("what a record is made of", arrays, Mapping, WRITE_RECORD, DataError)
        dtype = jnp.result_type(float)
        self.arrays = {name: _owned(_numbers(name, v), dtype) for name, v in arrays.items()}
        # Of a batch of records, signals and time steps have the batch's axes in front.
        axes = max((values.ndim for values in self.arrays.values()), default=1) - 1
        self.time_step = jnp.asarray(_checked_step(time_step, axes), dtype)
        self.start_time = jnp.asarray(start_time, dtype)
        pairs = units.items() if isinstance(units, Mapping) else units
        self.units = tuple(sorted((name, unit) for name, unit in pairs if name in arrays))
        self.missing = {
            name: _owned(mask, bool) for name, mask in (missing or {}).items() if name in arrays
        }
        self.stamps = None if stamps is None else _owned(stamps, dtype)
        self.skipped = jnp.asarray(skipped, dtype)
        self.noise = (noise or Noise()).of(*self.arrays)

    def __check_init__(self):
        lengths = {name: values.shape for name, values in self.arrays.items()}
        if not lengths:
            raise DataError("a record needs at least one signal.")
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} {shape}" for name, shape in lengths.items())
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
          Between evenly sampled stretches there may be pauses.
        - `units`: name to unit, for those that are known.

        **Raises:** `DataError` for fewer than two samples, infinity, a signal without any sample,
        unequal lengths, and time that does not increase or is not evenly spaced.
        """
        require("what a record is made of", signals, Mapping, WRITE_RECORD, DataError)
        arrays = {name: _samples(name, values) for name, values in signals.items()}
        if (time is None) == (time_step is None):
            raise DataError("give either the time of each sample or the time step, not both.")
        if time is not None and np.ndim(time) == 0:
            raise DataError(
                f"time must hold the time of each sample; got {time}. Write {WRITE_RECORD}."
            )
        given = np.zeros(0) if time is None else _samples("t", time)
        every = arrays if time is None else {**arrays, "t": given}
        if len({values.size for values in every.values()}) > 1:
            listed = ", ".join(f"{name} {values.size}" for name, values in every.items())
            raise DataError(f"all signals and the time must have the same length; got {listed}.")
        step = time_step
        start = 0.0
        stamps = None
        if time is not None:
            step, start, pauses = time_base(given)
            if pauses.size:
                # The middle of each pause.
                middles = 0.5 * (given[pauses - 1] + given[pauses])
                stamps = np.insert(given, pauses, middles)
                arrays = {k: np.insert(v, pauses, np.nan) for k, v in arrays.items()}
        step = float(_checked_step(step, 0))
        if min((values.size for values in arrays.values()), default=2) < 2:
            raise DataError("a record needs at least two samples.")
        filled = {name: hold(values) for name, values in arrays.items()}
        return cls(filled, step, start, units or {}, gaps(arrays), stamps)

    @property
    def signals(self) -> Signals:
        """The signals by name, with a helpful error for a missing one."""
        return Signals(self.arrays)

    def __getitem__(self, name: str) -> Float[Array, " n"]:
        return self.signals[name]

    @property
    def sample_count(self) -> int:
        """Number of samples n."""
        return next(iter(self.arrays.values())).shape[-1]

    @property
    def duration(self) -> Float[Array, ""]:
        """Seconds recorded, pauses left out: t_max of eq. (15)."""
        return namespace(self.time_step).multiply(self.time_step, self.sample_count - 1)

    @property
    def time(self) -> Float[Array, " n"]:
        """Time of each sample in seconds."""
        if self.stamps is not None:
            return self.stamps
        xp = namespace(self.start_time, self.time_step)
        return xp.add(self.start_time, xp.multiply(self.time_step, xp.arange(self.sample_count)))

    @property
    def elapsed(self) -> Float[Array, " n"]:
        """Time of each sample in seconds from the recording's first, cut off or not.

        The clock of cuts, messages and figures: small numbers, also where `time` is of an epoch.
        """
        if self.stamps is not None:
            return self.skipped + (self.stamps - self.stamps[0])
        xp = namespace(self.skipped, self.time_step)
        return xp.add(self.skipped, xp.multiply(self.time_step, xp.arange(self.sample_count)))

    def to_frame(self) -> Any:
        """A pandas data frame of the signals, NaN where one lacks its sample; time in s is its
        index.

        **Raises:** `DataError` if pandas is not installed.
        """
        return framed(self)

    def present(self, names: Iterable[str]) -> Bool[Array, " n"] | None:
        """True where none of these signals lacks its sample; `None` where none ever does."""
        masks = [self.missing[name] for name in sorted(set(names)) if name in self.missing]
        return ~functools.reduce(jnp.logical_or, masks) if masks else None

    def with_signals(
        self,
        signals: Mapping[str, ArrayLike | Array],
        units: Mapping[str, str] | None = None,
        missing: Mapping[str, ArrayLike | Array] | None = None,
        noise: Noise | None = None,
    ) -> "Record":
        """A record with these signals added or replaced, `missing` where they have no sample.

        Nothing is known of their noise but what `noise` says.
        """
        others = {name: mask for name, mask in self.missing.items() if name not in signals}
        return dataclasses.replace(
            self,
            arrays={**self.arrays, **signals},
            units={**dict(self.units), **(units or {})},
            missing={**others, **(missing or {})},
            noise=self.noise.without(*signals).joined(noise or Noise()),
        )

    def through(self, ops: "Mapping[str, LinearOp]") -> "Record":
        """A record with the signals that operations make, by their name: values, gaps, noise and
        unit. Not under jit.

        **Raises:** `DataError` for a signal that the record lacks, or of which no stretch is long
        enough.
        """
        from riecjax.records.linear_op import through

        return through(self, ops)

    def with_noise(self, noise: Noise) -> "Record":
        """The same samples, of whose noise this is known."""
        return dataclasses.replace(self, noise=noise)

    def select(self, *names: str) -> "Record":
        """A record of only these signals, in this order."""
        return dataclasses.replace(self, arrays={name: self[name] for name in names})

    def part(self, start: int, stop: int) -> "Record":
        """The samples from `start` up to, not including, `stop`."""
        if not 0 <= start < stop <= self.sample_count:
            raise DataError(
                f"samples {start} to {stop} do not lie in a record of {self.sample_count} samples."
            )
        return self._rows(lambda values: values[..., start:stop], start)

    def stretch(self, first: Int[Array, ""], count: int) -> "Record":
        """`count` samples from `first` on, which may be traced; both must lie in the record."""

        def cut(values: Array) -> Array:
            return jax.lax.dynamic_slice_in_dim(values, first, count, axis=-1)

        return self._rows(cut, first)

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
            padded = jnp.pad(mask, [(0, 0)] * (mask.ndim - 1) + [(0, -mask.shape[-1] % count)])
            return padded.reshape(*mask.shape[:-1], -1, count).any(-1)

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
        cut: Callable[[Array], Array],
        first: int | Int[Array, ""],
        count: int = 1,
        thin: Callable[[Array], Array] | None = None,
    ) -> "Record":
        """What `cut` leaves, from the row `first` on, so many steps apart; `thin` of masks."""
        stamps = None if self.stamps is None else cut(self.stamps)
        earlier = first * self.time_step
        return Record(
            {name: cut(values) for name, values in self.arrays.items()},
            self.time_step * count,
            self.start_time + earlier if stamps is None else stamps[..., 0],
            self.units,
            {name: (thin or cut)(mask) for name, mask in self.missing.items()},
            stamps,
            self.skipped + earlier if stamps is None else self.elapsed[first],
            self.noise.thinned(count),
        )


WRITE_RECORD = 'rx.Record.from_samples({"x": x}, time_step=0.005), samples by name'


def _checked_step(time_step: Any, axes: int) -> Any:
    """The time step, with so many axes at most; a positive number where it is known.

    **Raises:** `DataError` otherwise.
    """
    if np.ndim(time_step) > axes:
        raise DataError(
            "the time step must be one number of seconds; got an array. For the time of each "
            'sample write rx.Record.from_samples({"x": x}, time=t).'
        )
    if is_concrete(time_step):
        try:
            step = np.asarray(time_step, float)
        except (TypeError, ValueError):
            require("the time step", time_step, (), WRITE_RECORD, DataError)
            raise
        if not (np.isfinite(step) & (step > 0)).all():
            raise DataError(
                f"the time step must be a positive number of seconds; got {np.min(step):g}."
            )
    return time_step


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
    given = [getattr(each, "record", each) for each in listed]
    kinds = Record if several else (Record, list, tuple)
    for record in given:
        require("one of the records" if several else "the record", record, kinds, single)
    if not given:
        raise DataError("at least one record is needed.")
    return given


def stack_records(records: list[Record]) -> Record:
    """Records of equal length as one batched record, to `jax.vmap` over its leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *records)


def _owned(values: Any, dtype: Any) -> Array:
    """An array that no one else writes to: JAX may take up memory of NumPy's as it is.

    NumPy copies, since JAX compiles a conversion for each length that is new.
    """
    if isinstance(values, jax.Array):
        return jnp.asarray(values, dtype)
    # What 32-bit does not hold is infinite there.
    with np.errstate(over="ignore"):
        return jnp.asarray(np.array(values, dtype))


def _numbers(name: str, values: Any) -> Any:
    """Samples that are real numbers, as an array of NumPy or JAX.

    **Raises:** `DataError` for anything else: text, times, complex numbers; and for a name that is
    no text.
    """
    require("a signal's name", name, str, WRITE_RECORD, DataError)
    try:
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


def _samples(name: str, values: ArrayLike) -> np.ndarray:
    samples = np.asarray(_numbers(name, values), float)
    if samples.ndim != 1:
        raise DataError(
            f"signal '{name}' must be one column of samples; it has shape {samples.shape}."
        )
    infinite = np.abs(samples) > float(jnp.finfo(jnp.result_type(float)).max)
    if infinite.any():
        raise DataError(
            f"signal '{name}' has {int(infinite.sum())} infinite value(s), the first at sample "
            f"{int(np.argmax(infinite))}. Remove or repair those samples."
        )
    if samples.size and np.isnan(samples).all():
        raise DataError(f"signal '{name}' holds no number at all.")
    return samples


def samples_with_nan(record: Record, name: str) -> np.ndarray:
    """A signal's samples, shape `(n,)`, NaN where they are missing."""
    values = np.array(record[name], float)
    if name in record.missing:
        values[np.asarray(record.missing[name])] = np.nan
    return values


def runs(mask: np.ndarray) -> np.ndarray:
    """First samples of all stretches in which a mask, shape `(n,)`, is True, and their ends.

    Shape `(2, stretches)`; an end is the sample behind the last.
    """
    return np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).reshape(-1, 2).T


def gaps(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Masks, shape `(n,)`, True where a column is NaN; only of columns that hold a NaN."""
    masks = {name: np.isnan(values) for name, values in columns.items()}
    return {name: mask for name, mask in masks.items() if mask.any()}


def hold(values: np.ndarray) -> np.ndarray:
    """NaN replaced by the last value before it, at the start by the first after, else by 0.

    Shapes `(n,)`.
    """
    present = ~np.isnan(values)
    if present.all():
        return values
    if not present.any():
        return np.zeros(values.size)
    last = np.maximum.accumulate(np.where(present, np.arange(values.size), -1))
    return values[np.where(last < 0, np.argmax(present), last)]


TO_A_DOUBLING = 4
"""Lengths that [`shared_length`][] has between one power of two and the next."""


def shared_length(samples: int) -> int:
    """How many samples a record is filled up to, to be simulated: a quarter more at most.

    So records of many lengths share compiled functions.
    What is simulated behind its end takes its time; to sum takes little, so that what is only
    summed is filled up further.
    """
    step = max(2 ** (samples - 1).bit_length() // (2 * TO_A_DOUBLING), 1)
    return -(-samples // step) * step


def filled_up(record: Record, length: int, begin: int = 0, stop: int | None = None) -> Record:
    """Samples from `begin` to `stop`, and the last of them again and again behind."""
    stop = record.sample_count if stop is None else stop
    behind = length - (stop - begin)

    def filled(values: Array) -> np.ndarray:
        part = np.asarray(values)[begin:stop]
        return np.concatenate([part, np.repeat(part[-1:], behind)]) if behind else part

    stamps = record.stamps
    earlier = begin * float(record.time_step)
    if stamps is not None:
        earlier = float(stamps[begin]) - float(stamps[0])
        stamps = filled(stamps)
    return Record(
        {name: filled(values) for name, values in record.arrays.items()},
        record.time_step,
        missing={name: filled(mask) for name, mask in record.missing.items()},
        stamps=stamps,
        skipped=earlier,
        noise=record.noise,
    )

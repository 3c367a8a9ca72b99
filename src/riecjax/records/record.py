"""A recording: uniformly sampled, named signals."""

from collections.abc import Iterator, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from riecjax.errors import DataError, MissingSignalError

# Logged time stamps are rounded; steps may differ by this share before the grid counts as uneven.
TIME_STEP_TOLERANCE = 1e-3


class Signals(Mapping[str, Array]):
    """The signals of a record by name; asking for one that is missing says which ones exist."""

    def __init__(self, arrays: Mapping[str, Array]):
        self._arrays = dict(arrays)

    def __getitem__(self, name: str) -> Array:
        try:
            return self._arrays[name]
        except KeyError:
            raise MissingSignalError(name, tuple(self._arrays)) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __contains__(self, name: object) -> bool:
        return name in self._arrays


class Record(eqx.Module):
    """Uniformly sampled, named signals of one recording.

    A record is a pytree: its arrays trace, vmap and differentiate. Build one from user data with
    [`Record.from_samples`][], which checks everything once; code downstream trusts a record.

    **Fields:**

    - `arrays`: signal name to its samples, shape `(n,)`, all of one length.
    - `time_step`: seconds between samples, scalar.
    - `start_time`: time of the first sample in seconds, scalar.
    - `units`: (signal name, unit) pairs for those signals whose unit is known.
    """

    arrays: dict[str, Float[Array, " n"]]
    time_step: Float[Array, ""]
    start_time: Float[Array, ""]
    units: tuple[tuple[str, str], ...] = eqx.field(static=True)

    def __init__(
        self,
        arrays: Mapping[str, ArrayLike | Array],
        time_step: ArrayLike | Array,
        start_time: ArrayLike | Array = 0.0,
        units: Mapping[str, str] | tuple[tuple[str, str], ...] = (),
    ):
        dtype = jnp.result_type(float)
        self.arrays = {name: jnp.asarray(values, dtype) for name, values in arrays.items()}
        self.time_step = jnp.asarray(time_step, dtype)
        self.start_time = jnp.asarray(start_time, dtype)
        pairs = units.items() if isinstance(units, Mapping) else units
        self.units = tuple(sorted((name, unit) for name, unit in pairs if name in arrays))

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
        *,
        time: ArrayLike | None = None,
        time_step: float | None = None,
        units: Mapping[str, str] | None = None,
    ) -> "Record":
        """Check user data and make a record of it.

        **Arguments:**

        - `signals`: name to samples, each of shape `(n,)`.
        - `time`: time of each sample in seconds, shape `(n,)`; or give `time_step` in seconds.
        - `units`: name to unit, for those that are known.

        **Raises:** `DataError` for fewer than two samples, NaN or infinity, unequal lengths, and
        time that does not increase or is not evenly spaced.
        """
        arrays = {name: _finite_samples(name, values) for name, values in signals.items()}
        if (time is None) == (time_step is None):
            raise DataError("give either the time of each sample or the time step, not both.")
        if time is not None:
            step, start = _uniform_grid(_finite_samples("t", time))
        else:
            step, start = float(time_step or 0.0), 0.0
        if not (np.isfinite(step) and step > 0):
            raise DataError(f"the time step must be a positive number of seconds; got {step:g}.")
        lengths = {values.size for values in arrays.values()}
        if time is not None:
            lengths.add(np.size(np.asarray(time)))
        if len(lengths) > 1:
            listed = ", ".join(f"{name} {values.size}" for name, values in arrays.items())
            raise DataError(f"all signals and the time must have the same length; got {listed}.")
        if lengths and min(lengths) < 2:
            raise DataError("a record needs at least two samples.")
        return cls(arrays, step, start, units or {})

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
        """Time from the first to the last sample in seconds: t_max of eq. (15)."""
        return self.time_step * (self.sample_count - 1)

    @property
    def time(self) -> Float[Array, " n"]:
        """Time of each sample in seconds."""
        return self.start_time + self.time_step * jnp.arange(self.sample_count)

    def with_signals(
        self, signals: Mapping[str, Array], units: Mapping[str, str] | None = None
    ) -> "Record":
        """A record with these signals added or replaced."""
        return Record(
            {**self.arrays, **signals},
            self.time_step,
            self.start_time,
            {**dict(self.units), **(units or {})},
        )

    def select(self, *names: str) -> "Record":
        """A record of only these signals, in this order."""
        return Record(
            {name: self[name] for name in names}, self.time_step, self.start_time, self.units
        )

    def part(self, start: int, stop: int) -> "Record":
        """The samples from `start` up to, not including, `stop`."""
        if not 0 <= start < stop <= self.sample_count:
            raise DataError(
                f"samples {start} to {stop} do not lie in a record of {self.sample_count} samples."
            )
        arrays = {name: values[..., start:stop] for name, values in self.arrays.items()}
        return Record(arrays, self.time_step, self.start_time + start * self.time_step, self.units)


def stack_records(records: list[Record]) -> Record:
    """Records of equal length as one batched record, to `jax.vmap` over its leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *records)


def _finite_samples(name: str, values: ArrayLike) -> np.ndarray:
    try:
        samples = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise DataError(f"signal '{name}' is not a list of numbers.") from None
    if samples.ndim != 1:
        raise DataError(
            f"signal '{name}' must be one column of samples; it has shape {samples.shape}."
        )
    bad = ~np.isfinite(samples)
    if bad.any():
        first = int(np.argmax(bad))
        raise DataError(
            f"signal '{name}' has {int(bad.sum())} value(s) that are not finite numbers, the first "
            f"at sample {first}. Remove or repair those samples."
        )
    return samples


def _uniform_grid(time: np.ndarray) -> tuple[float, float]:
    if time.size < 2:
        raise DataError("a record needs at least two samples.")
    steps = np.diff(time)
    if (steps <= 0).any():
        first = int(np.argmax(steps <= 0)) + 1
        raise DataError(
            f"time must increase from sample to sample; at sample {first} it goes from "
            f"{time[first - 1]:g} to {time[first]:g} s. Sort the record or remove repeated rows."
        )
    step = float((time[-1] - time[0]) / (time.size - 1))
    if np.max(np.abs(steps - step)) > TIME_STEP_TOLERANCE * step + 4 * np.spacing(
        np.max(np.abs(time))
    ):
        raise DataError(
            f"samples must be evenly spaced; steps range from {steps.min():g} to {steps.max():g} s."
            " Resample the record to a uniform rate, or cut it at its gaps."
        )
    return step, float(time[0])

"""Steps on the unbroken stretches of a record."""

from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np

from riecjax.errors import DataError
from riecjax.records.record import Record


def on_stretches(
    record: Record, signal: str, step: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """What `step` makes of each unbroken stretch of a signal, NaN elsewhere, shape `(n,)`."""
    samples = np.asarray(record[signal])
    found = np.full(samples.size, np.nan)
    for stretch in record.segments([signal]):
        found[stretch] = step(samples[stretch])
    return found


def with_gaps(
    record: Record, columns: Mapping[str, np.ndarray], units: Mapping[str, str] | None = None
) -> Record:
    """A record with these signals added or replaced, missing where they are NaN."""
    missing = {name: jnp.asarray(mask) for name, mask in gaps(columns).items()}
    held = {name: jnp.asarray(hold(values)) for name, values in columns.items()}
    return record.with_signals(held, units, missing)


def gaps(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Where a column is NaN, for those columns that are so somewhere."""
    masks = {name: np.isnan(values) for name, values in columns.items()}
    return {name: mask for name, mask in masks.items() if mask.any()}


def hold(values: np.ndarray) -> np.ndarray:
    """NaN replaced by the last value before, at the start by the first one after, else by 0."""
    present = ~np.isnan(values)
    if not present.any():
        return np.zeros(values.size)
    last = np.maximum.accumulate(np.where(present, np.arange(values.size), -1))
    return values[np.where(last < 0, np.argmax(present), last)]


def longest_stretch(record: Record, signal: str) -> int:
    """Samples in the longest unbroken stretch of a signal."""
    return max((part.stop - part.start for part in record.segments([signal])), default=0)


def require_samples(record: Record, signal: str, problem: str) -> None:
    """Raise `DataError` with `problem` if a signal has no sample that is not missing."""
    if not record.segments([signal]):
        raise DataError(problem)


def split(record: Record, share: float) -> tuple[Record, Record]:
    """Hold out the last `share` of a record's samples, 0 < share < 1.

    The end, and not samples drawn here and there: neighbours of a sample in the estimation part
    tell it almost exactly, so that validating on it would prove nothing.

    **Returns:** the part to estimate from, and the part to validate on.

    **Raises:** `DataError` for another share, or one that leaves a part without two samples or
    without any sample of a signal.
    """
    if not 0 < share < 1:
        raise DataError(f"the share to hold out must lie between 0 and 1; got {share:g}.")
    return _split(record, record.sample_count - round(share * record.sample_count))


def split_at(record: Record, seconds: float) -> tuple[Record, Record]:
    """Split a record before the first sample at or after this time, on the record's own clock.

    **Returns:** the part to estimate from, and the part to validate on.

    **Raises:** `DataError` for a time that leaves a part without two samples or without any sample
    of a signal.
    """
    # A time in decimals stands for the sample nearest to it within rounding.
    rounding = 1e-6 * float(record.time_step)
    return _split(record, int(np.searchsorted(np.asarray(record.time), seconds - rounding)))


def _split(record: Record, at: int) -> tuple[Record, Record]:
    if min(at, record.sample_count - at) < 2:
        raise DataError(
            f"splitting {record.sample_count} samples into {at} and {record.sample_count - at} "
            f"leaves a part without two samples. The record lasts from "
            f"{float(record.time[0]):.12g} to {float(record.time[-1]):.12g} s."
        )
    parts = record.part(0, at), record.part(at, record.sample_count)
    for part, which in zip(parts, ("estimation", "validation")):
        for name in part.arrays:
            if not part.segments([name]):
                raise DataError(
                    f"the {which} part holds no sample of '{name}'. Split elsewhere, or leave that "
                    f"signal out."
                )
    return parts

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

"""Rows that stand in a recording twice, as a logger leaves them that writes a buffer again."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.findings import Finding
from riecjax.records.preparation.filtering import with_gaps
from riecjax.records.record import Record, samples_with_nan

FEWEST = 20
"""Rows in succession that are the same again; noise repeats not one of them by chance."""
MOST = 0.5
"""Share of rows past which repetition is how the motion is, simulated without noise, or at rest."""


class Repetition(NamedTuple):
    """Rows that are others again: the first of both, and how many there are."""

    first: int
    again: int
    rows: int


def repetitions(columns: Sequence[Float[np.ndarray, " rows"]]) -> list[Repetition]:
    """Stretches of rows that stand elsewhere before, to the bit.

    **Arguments:** `columns`, NaN where a sample is missing; such rows are no others'.
    """
    # Rows that differ anywhere differ in a combination of columns, but for one in 1e16.
    keys = np.zeros(len(columns[0]))
    for column, weight in zip(columns, np.random.default_rng(0).uniform(1, 2, len(columns))):
        size = float(np.max(np.abs(column), where=~np.isnan(column), initial=0.0))
        keys += weight * column / (size or 1.0)
    # Mostly no row comes twice, and to sort them is all that it takes.
    if np.all(np.diff(np.sort(keys)) != 0):
        return []
    _, where, counts = np.unique(keys, return_inverse=True, return_counts=True)
    twice = ~np.isnan(keys) & (counts[where] == 2)
    if not twice.any() or np.mean(counts[where] > 1) > MOST:
        return []
    places = np.flatnonzero(twice)
    places = places[np.argsort(where[places], kind="stable")].reshape(-1, 2)
    lags = np.zeros(len(keys), int)
    lags[places[:, 1]] = places[:, 1] - places[:, 0]
    edges = np.flatnonzero(np.diff(lags, prepend=0, append=0))
    return [
        Repetition(int(start - lags[start]), int(start), int(stop - start))
        for start, stop in itertools.pairwise(edges)
        if lags[start] and stop - start >= FEWEST
    ]


def without_repetitions(record: Record) -> tuple[Record, list[Finding]]:
    """The record with rows that stand in it again as missing, and what is said of them."""
    columns = {name: samples_with_nan(record, name) for name in record.arrays}
    found = repetitions([*columns.values()])
    if not found:
        return record, []
    time, step = np.asarray(record.elapsed), float(record.time_step)
    for values in columns.values():
        for one in found:
            values[one.again : one.again + one.rows] = np.nan
    first = found[0]
    more = f", and {len(found) - 1} more such stretches" if len(found) > 1 else ""
    said = Finding(
        "repeated_rows",
        f"all signals show from {time[first.again]:.6g} s on, for {first.rows * step:.4g} s, what "
        f"they showed from {time[first.first]:.6g} s on, to the last digit{more}: the logger wrote "
        f"those rows again. What stood there is lost; they count as missing. Check the logger.",
    )
    return with_gaps(record, columns, noise=record.noise), [said]

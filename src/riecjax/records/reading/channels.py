"""What a file holds, before it is a record: named columns of numbers, with what was decided."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.limits import MOST_COLUMNS

TIME_COLUMNS = ("t", "time", "Time", "T", "time_s", "t_s", "TIME", "timestamp", "Timestamp")
"""Column names taken as time, in this order of preference; `--map t=COLUMN` names another."""
WIDEST_MATRIX = 1000
"""Columns of a matrix past which it is no set of channels, but a picture."""
MOST_LISTED = 30
"""Names in a message past which the rest is counted."""


@dataclass(frozen=True)
class Channels:
    """Named columns of numbers, as a file holds them.

    **Fields:**

    - `columns`: name to samples, each a vector of 64-bit floats; NaN where a sample is missing.
      Lengths may differ.
    - `units`: column to its unit, where the file states one.
    - `time_of`: column to the column with its time, in files with several time axes.
    - `left_out`: name to the reason why this part of the file is no column.
    - `notes`: what was decided on reading, in words.
    """

    columns: dict[str, np.ndarray]
    units: dict[str, str] = field(default_factory=dict)
    time_of: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def listed(names: Iterable[str]) -> str:
    """Names for a message, the first thirty of them."""
    every = list(names)
    more = len(every) - MOST_LISTED
    return ", ".join(every[:MOST_LISTED]) + (f" and {more} more" if more > 0 else "")


def check_names(names: Iterable[str]) -> None:
    """Refuse a file in which two columns have one name, with a `DataError`."""
    seen = set()
    for name in names:
        if name in seen:
            raise DataError(f"two columns are called '{name}'.")
        seen.add(name)


def vectors(arrays: Mapping[str, object]) -> Channels:
    """Numeric arrays as columns: vectors by their name, matrices as `name[0]`, `name[1]`, ...

    The long side of a matrix is that of the samples. Scalars are left out silently; square
    matrices, text and objects with the reason.
    """
    columns: dict[str, np.ndarray] = {}
    left_out: dict[str, str] = {}
    for name, values in arrays.items():
        array = np.asarray(values)
        if array.dtype.kind not in "fiub":
            left_out[name] = "it holds no real numbers"
            continue
        if array.size < 2:
            continue
        sides = [side for side in array.shape if side > 1]
        if len(sides) == 1:
            columns[name] = array.reshape(-1).astype(float)
        elif len(sides) == 2 and sides[0] != sides[1] and min(sides) <= WIDEST_MATRIX:
            matrix = array.reshape(sides)
            by_channel = matrix if sides[0] < sides[1] else matrix.T
            columns |= {f"{name}[{i}]": row.astype(float) for i, row in enumerate(by_channel)}
        else:
            left_out[name] = f"its shape {array.shape} is not that of channels over time"
        if len(columns) > MOST_COLUMNS:
            raise DataError(f"has more than {MOST_COLUMNS} columns.")
    return Channels(columns, left_out=left_out)


def with_structure_times(channels: Channels) -> Channels:
    """Tell each column `a.b.values` its time: `a.b.time`, or else `a.time`, of the same length."""
    time_of = {}
    for name, values in channels.columns.items():
        parts = name.split(".")
        for depth in range(len(parts) - 1, 0, -1):
            own = [".".join([*parts[:depth], time]) for time in TIME_COLUMNS]
            found = next((c for c in own if c in channels.columns), None)
            if found and channels.columns[found].size == values.size:
                time_of[name] = found
                break
    return replace(channels, time_of=time_of)

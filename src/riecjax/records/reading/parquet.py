"""Reading Parquet files."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.types as types
from pyarrow import parquet

from riecjax.records.reading.channels import Channels, check_declared
from riecjax.records.reading.child_process import apart
from riecjax.records.reading.literals import compute, floats, of_texts
from riecjax.records.reading.times import TIME_COLUMNS, unwrapped
from riecjax.runtime import require_memory

BESIDE = 6
"""Columns of numbers that PyArrow holds beside those that are read, at most: with time stamps."""
UNNAMED_INDEX = "__index_level_0__"
"""What pandas calls the index of a frame when it has no name."""


@apart("Parquet")
def read_parquet(file: Path) -> Channels:
    """Read a Parquet file: numbers, and time stamps and durations as seconds, also as text.

    Stamps count from the first. A unit is taken from a column's metadata `unit`.

    **Raises:** `DataError` for a damaged file or one that unpacks to too much; `MemoryError`.
    """
    # Not by its name, by which PyArrow would look for partitions in folders beside it.
    with (
        file.open("rb") as stream,
        parquet.ParquetFile(stream, page_checksum_verification=True) as source,
    ):
        schema, metadata = source.schema_arrow, source.metadata
        groups = map(metadata.row_group, range(metadata.num_row_groups))
        size = sum(group.total_byte_size for group in groups)
        # Run-length coding packs without bound: what counts is the table that is made of it.
        made = 8 * metadata.num_rows * max(len(schema), 1)
        check_declared(metadata.num_columns, max(size, made))
        kinds = {
            field.name: field.type.value_type if types.is_dictionary(field.type) else field.type
            for field in schema
        }
        checks = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal,
                  types.is_timestamp, types.is_duration, types.is_time)  # fmt: skip
        names = [f.name for f in schema if any(check(kinds[f.name]) for check in checks)]
        check_declared(names=names)

        def column(name: str) -> Any:
            return compute.cast(source.read(columns=[name]).column(0), kinds[name])

        # Numbers are held here and, once handed over, there.
        held = 8.0 * metadata.num_rows * (2 * len(names) + BESIDE)
        require_memory("reading its columns", held, "Read a part of the file.")
        # One after the other: a table of all takes as much again as their numbers.
        found = Channels({})
        for name in names:
            unit = (schema.field(name).metadata or {}).get(b"unit", b"")
            found.take(name, _numbers(column(name)), unit.decode(errors="replace"))
        for name in [name for name in kinds if name not in found.columns]:
            read = None, ""
            if types.is_string(kinds[name]) or types.is_large_string(kinds[name]):
                read = of_texts(compute.cast(column(name), pa.string()))
            found.take(name, *read, why=f"it holds {schema.field(name).type}, not numbers")
        described = json.loads((schema.metadata or {}).get(b"pandas", b"{}"))
    found.note_left_out("column")
    # The only time in the file may be the index of a frame of pandas.
    if (
        UNNAMED_INDEX in described.get("index_columns", ())
        and UNNAMED_INDEX in found.columns
        and not any(name in found.columns for name in TIME_COLUMNS)
        and not types.is_integer(schema.field(UNNAMED_INDEX).type)
    ):
        found.columns["time"] = found.columns.pop(UNNAMED_INDEX)
        found.notes.append("the frame's index taken as time")
    return found


def _numbers(column: Any) -> np.ndarray:
    kind = column.type
    if not types.is_temporal(kind):
        return floats(compute.cast(column, pa.float64(), safe=False))
    ticks = np.timedelta64(1, "s") / np.timedelta64(1, kind.unit)
    if types.is_time32(kind):
        column = compute.cast(column, pa.int32())
    counts = compute.cast(column, pa.int64())
    first = compute.min(counts).as_py() if types.is_timestamp(kind) else 0
    since = (
        floats(compute.cast(compute.subtract(counts, first or 0), pa.float64(), safe=False)) / ticks
    )
    return unwrapped(since) if types.is_time(kind) else since

"""Reading Parquet files: in this process, for PyArrow survives damaged ones."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.types as types
from pyarrow import parquet

from riecjax.records.reading.channels import Channels, check_declared, foreign_reader
from riecjax.records.reading.literals import compute, floats, of_texts
from riecjax.records.reading.times import TIME_COLUMNS, unwrapped
from riecjax.runtime import require_memory

UNNAMED_INDEX = "__index_level_0__"
"""What pandas calls the index of a frame when it has no name."""


@foreign_reader("Parquet")
def read_parquet(file: Path) -> Channels:
    """Read a Parquet file: numbers, and time stamps and durations as seconds, also as text.

    Stamps count from the first. A unit is taken from a column's metadata `unit`.

    **Raises:** `DataError` for a damaged file or one that unpacks to too much; `MemoryError`.
    """
    # Not by its name, by which PyArrow would look for partitions in folders beside it.
    with (
        pa.OSFile(os.fsencode(file)) as stream,
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
        texts = [n for n, k in kinds.items() if types.is_string(k) or types.is_large_string(k)]
        check_declared(names=names)
        # PyArrow's columns and these, and one to convert each.
        held = 8.0 * metadata.num_rows * (2 * len(names) + 1)
        require_memory("reading its columns", held, "Read a part of the file.")
        found = Channels({})
        table = source.read(columns=names)
        for name in names:
            unit = (schema.field(name).metadata or {}).get(b"unit", b"")
            values = _numbers(compute.cast(table.column(name), kinds[name]))
            found.take(name, values, unit.decode(errors="replace"))
        del table
        with parquet.ParquetFile(
            stream, metadata=metadata, read_dictionary=texts, page_checksum_verification=True
        ) as source:
            for name in [name for name in kinds if name not in found.columns]:
                read = of_texts(_text(source, name)) if name in texts else (None, "")
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


def _text(source: parquet.ParquetFile, name: str) -> Any:
    """A column of strings, of which a file of any size may hold any number, each of them once."""
    column = source.read(columns=[name]).column(name)
    if types.is_dictionary(column.type):
        lengths = (
            compute.take(compute.binary_length(chunk.dictionary), chunk.indices)
            for chunk in column.chunks
        )
        check_declared(unpacked=sum(compute.sum(each).as_py() or 0 for each in lengths))
    return compute.cast(column, pa.string())


def _numbers(column: Any) -> np.ndarray:
    kind = column.type
    if not types.is_temporal(kind):
        numbers = compute.cast(column, pa.float64(), safe=False)
        # A copy takes as long as reading does. Nothing writes to columns.
        is_whole = numbers.num_chunks == 1 and not numbers.null_count
        return np.from_dlpack(numbers.chunk(0)) if is_whole else floats(numbers)
    ticks = np.timedelta64(1, "s") / np.timedelta64(1, kind.unit)
    if types.is_time32(kind):
        column = compute.cast(column, pa.int32())
    counts = compute.cast(column, pa.int64())
    if types.is_timestamp(kind):
        counts = compute.subtract(counts, compute.min(counts))
    seconds = floats(compute.cast(counts, pa.float64(), safe=False)) / ticks
    return unwrapped(seconds) if types.is_time(kind) else seconds

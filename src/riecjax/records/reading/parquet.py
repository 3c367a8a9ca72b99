"""Reading Parquet files."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.memory import require_memory
from riecjax.records.reading.channels import (
    Channels,
    check_column_count,
    check_names,
    check_unpacked,
    foreign_reader,
)
from riecjax.records.reading.child_process import read_apart
from riecjax.records.reading.numerals import compute, floats
from riecjax.records.reading.times import TIME_COLUMNS, of_text_column, unwrapped

BESIDE = 6
"""Columns of numbers that PyArrow holds beside those that are read, at most: with time stamps."""
UNNAMED_INDEX = "__index_level_0__"
"""What pandas calls the index of a frame when it has no name."""


def read_parquet(file: Path) -> Channels:
    """Read a Parquet file: numbers, and time stamps and durations as seconds, also as text.

    Stamps count from the first. A unit is taken from a column's metadata `unit`.

    **Raises:** `DataError` for a damaged file or one that unpacks to too much; `MemoryError`.
    """
    return read_apart(_read, file, "Parquet")


def _read(file: Path) -> Channels:
    with foreign_reader("Parquet"):
        import pyarrow as pa
        import pyarrow.types as types
        from pyarrow import parquet

        # Not by its name, by which PyArrow would look for partitions in folders beside it.
        with (
            file.open("rb") as stream,
            parquet.ParquetFile(stream, page_checksum_verification=True) as source,
        ):
            schema, metadata = source.schema_arrow, source.metadata
            check_column_count(metadata.num_columns)
            groups = map(metadata.row_group, range(metadata.num_row_groups))
            check_unpacked(sum(group.total_byte_size for group in groups))
            # Run-length coding packs without bound: what counts is the table that is made of it.
            check_unpacked(8 * metadata.num_rows * max(len(schema), 1))
            names = [field.name for field in schema if _is_numeric(field.type)]
            left_out = {
                field.name: f"it holds {field.type}, not numbers"
                for field in schema
                if not _is_numeric(field.type)
            }
            check_names(names)
            # Numbers are held here and, once handed over, there.
            held = 8.0 * metadata.num_rows * (2 * len(names) + BESIDE)
            require_memory("reading its columns", held, "Read a part of the file.")
            # One after the other: a table of all takes as much again as their numbers.
            columns = {name: _numbers(source.read(columns=[name]).column(0)) for name in names}
            stated = {name: (schema.field(name).metadata or {}).get(b"unit") for name in names}
            units = {name: unit.decode(errors="replace") for name, unit in stated.items() if unit}
            for name in list(left_out):
                kind = schema.field(name).type
                kind = kind.value_type if types.is_dictionary(kind) else kind
                if not (types.is_string(kind) or types.is_large_string(kind)):
                    continue
                texts = compute().cast(source.read(columns=[name]).column(0), pa.string())
                found, stamped = of_text_column(texts)
                if found is not None:
                    columns[name] = found
                    units |= {name: "s"} if stamped else {}
                    del left_out[name]
            described = json.loads((schema.metadata or {}).get(b"pandas", b"{}"))
    notes = [f"column '{name}' left out: {why}" for name, why in left_out.items()]
    # The only time in the file may be the index of a frame of pandas.
    if (
        UNNAMED_INDEX in described.get("index_columns", ())
        and UNNAMED_INDEX in columns
        and not any(name in columns for name in TIME_COLUMNS)
        and not types.is_integer(schema.field(UNNAMED_INDEX).type)
    ):
        columns["time"] = columns.pop(UNNAMED_INDEX)
        notes.append("the frame's index taken as time")
    return Channels(columns, units, {}, left_out, notes)


def _is_numeric(kind: Any) -> bool:
    import pyarrow.types as types

    if types.is_dictionary(kind):
        return _is_numeric(kind.value_type)
    checks = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal,
              types.is_timestamp, types.is_duration, types.is_time)  # fmt: skip
    return any(check(kind) for check in checks)


def _numbers(column: Any) -> np.ndarray:
    import pyarrow as pa
    import pyarrow.types as types

    pc = compute()
    if types.is_dictionary(column.type):
        column = pc.cast(column, column.type.value_type)
    kind = column.type
    if not (types.is_timestamp(kind) or types.is_duration(kind) or types.is_time(kind)):
        return floats(pc.cast(column, pa.float64(), safe=False))
    ticks = np.timedelta64(1, "s") / np.timedelta64(1, kind.unit)
    if types.is_time32(kind):
        column = pc.cast(column, pa.int32())
    counts = pc.cast(column, pa.int64())
    first = pc.min(counts).as_py() if types.is_timestamp(kind) else 0
    since = floats(pc.cast(pc.subtract(counts, first or 0), pa.float64(), safe=False)) / ticks
    return unwrapped(since) if types.is_time(kind) else since

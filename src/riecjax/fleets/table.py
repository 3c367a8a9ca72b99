"""Rows of a fleet's recordings in Parquet files: parts of a run, and what is left of it.

Pages carry checksums, which are verified; what tells where they lie is held against the number of
rows. A file stands under its name only once it is whole. What it was made for is its order's
digest: rows of another order are none.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from riecjax.errors import DataError, ModelError, RiecjaxError
from riecjax.fleets.groups import Entry
from riecjax.fleets.sums import Row
from riecjax.records.writing import write_whole

ORDER, SCHEMA_KEY, SCHEMA = b"riecjax.order", b"riecjax.fleet", b"2"
COUNT = b"riecjax.rows"
ROWS = 64
"""Rows to a group of a file, which are read together."""
LIGHT = tuple(name for name in Row._fields if name not in ("sums", "lengths"))
"""Columns that are small."""


def _schema(metadata: Mapping[bytes, bytes]) -> Any:
    import pyarrow as pa

    kinds = {str: pa.string(), float: pa.float64(), int: pa.int64(), bytes: pa.binary()}
    fields = [pa.field(name, kinds[kind]) for name, kind in Row.__annotations__.items()]
    return pa.schema(fields, metadata={SCHEMA_KEY: SCHEMA, **metadata})


def write_rows(
    file: Path, rows: Iterator[Row] | Sequence[Row], metadata: Mapping[bytes, bytes]
) -> None:
    """Write rows to a file, a few at a time, whole or not at all.

    **Raises:** `DataError` where it cannot be written.
    """
    import itertools

    import pyarrow as pa
    from pyarrow import parquet

    schema, given = _schema(metadata), iter(rows)

    def fill(temporary: Path) -> None:
        writer = parquet.ParquetWriter(
            temporary, schema, compression="zstd", write_page_checksum=True, use_dictionary=False
        )
        with writer:
            count = 0
            while some := list(itertools.islice(given, ROWS)):
                columns = [
                    pa.array(values, field.type) for values, field in zip(zip(*some), schema)
                ]
                writer.write_batch(pa.record_batch(columns, schema=schema))
                count += len(some)
            writer.add_key_value_metadata({COUNT: str(count).encode()})

    write_whole(file, fill)


def read_rows(file: str | os.PathLike[str], columns: Sequence[str] = ()) -> Iterator[Row]:
    """Rows of a file in their order, of which only a few are held at a time.

    **Arguments:** `columns` that are read, all if none is named; others are empty.

    **Raises:** `DataError` for a file that is not there, is damaged or holds something else.
    """
    from pyarrow import ArrowException, parquet

    try:
        with parquet.ParquetFile(file, page_checksum_verification=True) as source:
            _require_rows(source.schema_arrow.metadata, file)
            if tuple(source.schema_arrow.names) != Row._fields:
                raise TypeError("columns are missing")
            wanted = list(columns or Row._fields)
            empty = {name: kind() for name, kind in Row.__annotations__.items()}
            left = int((source.metadata.metadata or {})[COUNT])
            for batch in source.iter_batches(ROWS, columns=wanted):
                left -= batch.num_rows
                for one in batch.to_pylist():
                    yield Row(**(empty | one))
            if left:
                raise TypeError(f"{left} rows are missing")
    except RiecjaxError:
        raise
    # What is damaged may be no text either.
    except (OSError, ArrowException, TypeError, ValueError, KeyError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DataError(f"{Path(file).name}: no readable table of a fleet: {said}") from None


def write_entries(file: Path, entries: Sequence[Entry]) -> None:
    """Write estimates to a Parquet file, whole or not at all.

    **Raises:** `DataError` where it cannot be written.
    """
    import pyarrow as pa
    from pyarrow import parquet

    numbers = ("start", "end", "value", "std_error", "low95", "high95")
    schema = pa.schema(
        [(name, pa.float64() if name in numbers else pa.string()) for name in Entry._fields]
    )
    columns = [
        pa.array([entry[i] for entry in entries], field.type) for i, field in enumerate(schema)
    ]
    table = pa.table(columns, schema=schema)

    def fill(temporary: Path) -> None:
        parquet.write_table(table, temporary, compression="zstd", write_page_checksum=True)

    write_whole(file, fill)


def metadata_of(file: str | os.PathLike[str]) -> dict[bytes, bytes]:
    """What stands beside the rows of a file.

    **Raises:** `DataError` as [`read_rows`][].
    """
    from pyarrow import ArrowException, parquet

    try:
        metadata = dict(parquet.read_schema(file).metadata or {})
    except (OSError, ArrowException, ValueError) as error:
        raise DataError(f"{Path(file).name}: no readable table of a fleet: {error}") from None
    _require_rows(metadata, file)
    return metadata


def is_table(path: str | os.PathLike[str]) -> bool:
    """Whether a path is that of a file of rows."""
    if not os.fspath(path).endswith(".parquet") or not os.path.isfile(path):
        return False
    try:
        metadata_of(path)
    except ModelError:
        return True
    except DataError:
        return False
    return True


def _require_rows(metadata: Mapping[bytes, bytes] | None, file: str | os.PathLike[str]) -> None:
    found = (metadata or {}).get(SCHEMA_KEY)
    if found is None:
        raise DataError(f"{Path(file).name}: it is no summaries.parquet of 'riecjax fleet'.")
    if found != SCHEMA:
        raise ModelError(
            f"{Path(file).name}: it was written with schema {found.decode()}, this version reads "
            f"{SCHEMA.decode()}: sum the recordings anew."
        )

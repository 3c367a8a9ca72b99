"""Rows that a run has made so far, on disk, so that the next one goes on where it ended."""

import contextlib
import itertools
import os
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from riecjax.errors import DataError, ModelError, RiecjaxError
from riecjax.fleets.groups import Entry
from riecjax.fleets.sums import DONE, Row
from riecjax.records.writing import write_whole
from riecjax.whole_files import no_folder, sweep

ORDER, SCHEMA_KEY, SCHEMA = b"riecjax.order", b"riecjax.fleet", b"2"
COUNT = b"riecjax.rows"
ROWS = 64
"""Rows to a group of a file, which are read together."""
LIGHT = tuple(name for name in Row._fields if name not in ("sums", "lengths"))
"""Columns that are small."""


def make_folder(folder: Path) -> None:
    """Make a folder that is to be written to.

    **Raises:** `DataError` where that cannot be.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(no_folder(folder, error)) from None


def write_rows(
    file: Path, rows: Iterator[Row] | Sequence[Row], metadata: Mapping[bytes, bytes]
) -> None:
    """Write rows to a file, a few at a time, whole or not at all.

    **Raises:** `DataError` where it cannot be written.
    """
    import pyarrow as pa
    from pyarrow import parquet

    kinds = {str: pa.string(), float: pa.float64(), int: pa.int64(), bytes: pa.binary()}
    fields = [pa.field(name, kinds[kind]) for name, kind in Row.__annotations__.items()]
    schema, given = pa.schema(fields, metadata={SCHEMA_KEY: SCHEMA, **metadata}), iter(rows)

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


PARTS, SUMMARIES = "summaries.parts", "summaries.parquet"
ESTIMATES = "estimates.parquet"
RESULTS = (SUMMARIES, ESTIMATES, "results.json")
MOST_WAITING, LONGEST_WAIT = 256, 5.0
"""Rows, and seconds, that are lost at most when a run is killed."""


def is_result(folder: Path, path: str) -> bool:
    """Whether a path is one of those that a run writes into a folder, and no recording."""
    below = os.path.relpath(path, folder).replace(os.sep, "/")
    return below in RESULTS or below.startswith(f"{PARTS}/")


class Kept:
    """Rows of one order, by the piece that they are of, in files of a folder.

    What is damaged and recordings that failed are made anew.
    """

    def __init__(self, folder: Path, order: str, metadata: dict[bytes, bytes]):
        """Take up what a folder holds.

        **Raises:** `DataError` where that is of another order, which may have taken hours.
        """
        self._folder, self._parts = folder, folder / PARTS
        self._metadata = {ORDER: order.encode(), **metadata}
        self._file: dict[str, Path] = {}
        self._rows: dict[str, list[Row]] = {}
        self._waiting: dict[str, list[Row]] = {}
        self._written = time.monotonic()
        self._parts.mkdir(parents=True, exist_ok=True)
        sweep(self._parts)
        self._number, is_anothers = 0, False
        for file in [folder / SUMMARIES, *sorted(self._parts.glob("*.parquet"))]:
            with contextlib.suppress(RiecjaxError):
                is_anothers |= not self._take_up(file, order)
            if file.stem.isdigit():
                self._number = max(self._number, int(file.stem) + 1)
        if is_anothers:
            raise DataError(
                f"'{folder}' holds sums by another model, criterion, version or way of reading. "
                f"Give another folder, or delete its {SUMMARIES} and {PARTS}."
            )

    def _take_up(self, file: Path, order: str) -> bool:
        """Its rows, if they are of this order."""
        if metadata_of(file)[ORDER] != order.encode():
            return False
        found: dict[str, list[Row]] = {}
        # All of it is read, and so seen to be sound.
        for row in read_rows(file):
            found.setdefault(row.piece, []).append(row._replace(sums=b"", lengths=b""))
        for piece, rows in found.items():
            if all(row.status == DONE for row in rows):
                self._rows[piece], self._file[piece] = rows, file
        return True

    def __contains__(self, piece: str) -> bool:
        return piece in self._rows

    def add(self, rows: Iterable[Row]) -> None:
        """Keep all rows of some pieces.

        **Raises:** `DataError` where they cannot be written.
        """
        for row in rows:
            self._waiting.setdefault(row.piece, []).append(row)
        waited = time.monotonic() - self._written
        if len(self._waiting) >= MOST_WAITING or waited > LONGEST_WAIT:
            self.write()

    @contextlib.contextmanager
    def to_the_last(self) -> Iterator[None]:
        """Write what was added, also where it ends early, as by Ctrl-C.

        **Raises:** `DataError` where it cannot be written.
        """
        try:
            yield
        except BaseException:
            with contextlib.suppress(DataError):
                self.write()
            raise
        self.write()

    def write(self) -> None:
        """Write what is not written yet.

        **Raises:** `DataError` where it cannot be.
        """
        if not self._waiting:
            return
        file = self._parts / f"{self._number:08}.parquet"
        write_rows(file, [row for rows in self._waiting.values() for row in rows], self._metadata)
        self._number += 1
        for piece, rows in self._waiting.items():
            self._rows[piece] = [row._replace(sums=b"", lengths=b"") for row in rows]
            self._file[piece] = file
        self._waiting, self._written = {}, time.monotonic()

    def light(self, pieces: Iterable[str]) -> Iterator[Row]:
        """Rows of these pieces, in this order, without their sums."""
        for piece in pieces:
            yield from self._rows[piece]

    def whole(self, pieces: Sequence[str]) -> Iterator[Row]:
        """Rows of these pieces, in this order, of which few are held at a time.

        **Raises:** `DataError` where a file was damaged meanwhile.
        """
        # In a file pieces follow one another about as they are asked for: what comes before the one
        # that is asked for is held until its turn, and each file is read once.
        wanted: dict[Path, set[str]] = {}
        for piece in pieces:
            wanted.setdefault(self._file[piece], set()).add(piece)
        # The rows of each piece stand together in a file.
        streams = {
            file: itertools.groupby(read_rows(file), lambda row: row.piece) for file in wanted
        }
        held: dict[str, list[Row]] = {}
        for piece in pieces:
            file = self._file[piece]
            while piece not in held:
                name, rows = next(streams[file], ("", None))
                if rows is None:
                    raise DataError(f"{file.name}: it has changed meanwhile; run it again.")
                if name in wanted[file]:
                    held[name] = list(rows)
            yield from held.pop(piece)

    def finish(self, pieces: Sequence[str]) -> Path:
        """Write the rows of these pieces, in this order, to one file in place of all parts.

        **Raises:** `DataError` where it cannot be written.
        """
        file = self._folder / SUMMARIES
        write_rows(file, self.whole(pieces), self._metadata)
        shutil.rmtree(self._parts, ignore_errors=True)
        self._file = dict.fromkeys(pieces, file)
        return file

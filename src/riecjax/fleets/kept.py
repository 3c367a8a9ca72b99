"""Rows on disk: what a run has summed so far, so that the next one goes on where it ended."""

import contextlib
import functools
import hashlib
import itertools
import os
import shutil
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import pyarrow as pa
from pyarrow import parquet

from riecjax.errors import DataError, ModelError, RiecjaxError
from riecjax.fleets.engine import batches
from riecjax.fleets.order import DONE, Order, Row
from riecjax.fleets.sources import in_words
from riecjax.whole_files import no_folder, write_file

PARTS, SUMMARIES = "summaries.parts", "summaries.parquet"
ESTIMATES = "estimates.parquet"
RESULTS = (SUMMARIES, ESTIMATES, "results.json")
SCHEMA_KEY, SCHEMA = b"riecjax.fleet", b"3"
ORDER, DIGEST = b"riecjax.order", b"riecjax.digest"
ROWS, HELD = 256, 16
"""Rows of a batch, which are read together, at most; and batches that are held."""

Batch = TypeVar("Batch", bound=Sequence[tuple[Any, ...]])


def is_result(folder: Path, path: str) -> bool:
    """Whether a path is one of those that a run writes into a folder, and no recording."""
    below = os.path.relpath(path, folder).replace(os.sep, "/")
    return below in RESULTS or below.startswith(f"{PARTS}/")


def make_folder(folder: Path) -> None:
    """Make a folder that is to be written to.

    **Raises:** `DataError` where that cannot be.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(no_folder(folder, error)) from None


def write_batches(
    file: Path,
    kind: type[NamedTuple],
    written: Iterable[Sequence[tuple[Any, ...]]],
    metadata: Mapping[bytes, bytes],
) -> None:
    """Write rows of a kind to a Parquet file, whole or not at all, batch by batch.

    The format's checksums guard its pages, and a digest in the metadata the rest of a file of rows.

    **Raises:** `DataError` where it cannot be written.
    """
    types = {str: pa.string(), float: pa.float64(), int: pa.int64(), bytes: pa.binary()}
    types |= {known | None: arrow for known, arrow in types.items()}
    schema = pa.schema([(name, types[known]) for name, known in kind.__annotations__.items()])

    def fill(temporary: Path) -> None:
        digest = _digest_of(metadata)
        with parquet.ParquetWriter(
            temporary, schema, compression="zstd", write_page_checksum=True, use_dictionary=False
        ) as writer:
            for batch in _digested(written, digest):
                columns = [pa.array(each, field.type) for each, field in zip(zip(*batch), schema)]
                writer.write_batch(pa.record_batch(columns, schema=schema))
            writer.add_key_value_metadata({**metadata, DIGEST: digest.hexdigest().encode()})

    write_file(file, fill)


def _digest_of(metadata: Mapping[bytes, bytes]) -> Any:
    ours = sorted(each for each in metadata.items() if each[0] in (SCHEMA_KEY, ORDER))
    return hashlib.sha256(repr(ours).encode())


def _digested(batches: Iterable[Batch], digest: Any) -> Iterator[Batch]:
    """The batches, each once all that it holds is in the digest."""
    for batch in batches:
        for value in itertools.chain.from_iterable(batch):
            digest.update(value if isinstance(value, bytes) else repr(value).encode())
        yield batch


@contextlib.contextmanager
def _opened(file: str | os.PathLike[str]) -> Iterator[tuple[Any, dict[bytes, bytes]]]:
    """A file of rows and its metadata.

    **Raises:** `DataError` for a file that is not there, holds something else, or is found to be
    damaged while it is read; `ModelError` for one of another schema.
    """
    name = Path(file).name
    # A damaged file leads to anything, such as a name that is no text.
    with (
        in_words(f"{name}: no readable table of a fleet"),
        parquet.ParquetFile(file, page_checksum_verification=True) as source,
    ):
        metadata = source.metadata.metadata or {}
        if SCHEMA_KEY not in metadata:
            raise DataError(f"{name}: it is no summaries.parquet of 'riecjax fleet'.")
        if metadata[SCHEMA_KEY] != SCHEMA:
            raise ModelError(
                f"{name}: it was written with schema {metadata[SCHEMA_KEY].decode()}, this "
                f"version reads {SCHEMA.decode()}: sum the recordings anew."
            )
        yield source, metadata


def _sound(source: Any, metadata: Mapping[bytes, bytes]) -> Iterator[list[Row]]:
    """Rows of an opened file, some at a time; whether they are sound is known at the end."""
    digest = _digest_of(metadata)
    numbers = range(source.num_row_groups)
    yield from _digested((_batch(source, number) for number in numbers), digest)
    if metadata.get(DIGEST) != digest.hexdigest().encode():
        raise ValueError("its checksum differs")


def _batch(source: Any, number: int) -> list[Row]:
    return [Row(**row) for row in source.read_row_group(number).to_pylist()]


def read_rows(file: Path) -> Iterator[Row]:
    """Rows of a file in their order, of which few are held at a time.

    **Raises:** `DataError` for a file that is not there, is damaged or holds something else;
    `ModelError` for one of another schema.
    """
    with _opened(file) as opened:
        yield from itertools.chain.from_iterable(_sound(*opened))


def is_table(path: str | os.PathLike[str]) -> bool:
    """Whether a path is that of a file of rows, also of another schema."""
    try:
        with _opened(path):
            return True
    except RiecjaxError as error:
        return isinstance(error, ModelError)


class SumStore:
    """Rows of one order, by the piece that they are of, in files of a folder.

    What is damaged and recordings that failed are made anew.
    """

    def __init__(self, folder: Path, order: Order):
        """Take up what a folder holds.

        **Raises:** `DataError` where that is of another order, which may have taken hours.
        """
        self._folder, self._parts = folder, folder / PARTS
        self._metadata = {SCHEMA_KEY: SCHEMA, ORDER: order.digest.encode()}
        # Where the rows of each piece lie: the file, and numbers of its batches, mostly one.
        self._places: dict[str, tuple[Path, dict[int, None]]] = {}
        self._parts.mkdir(parents=True, exist_ok=True)
        is_anothers = False
        for file in [folder / SUMMARIES, *sorted(self._parts.glob("*.parquet"))]:
            with contextlib.suppress(RiecjaxError), _opened(file) as (source, metadata):
                # All of it is read, and so seen to be sound.
                light = [[row.without_sums for row in batch] for batch in _sound(source, metadata)]
                if metadata[ORDER] != self._metadata[ORDER]:
                    is_anothers = True
                    continue
                self._take_up(file, light)
                for row in itertools.chain.from_iterable(light):
                    if row.status != DONE:
                        self._places.pop(row.piece, None)
        if is_anothers:
            raise DataError(
                f"'{folder}' holds sums by another model, criterion, version or way of reading. "
                f"Give another folder, or delete its {SUMMARIES} and {PARTS}."
            )

    def __contains__(self, piece: str) -> bool:
        return piece in self._places

    def _take_up(self, file: Path, written: Iterable[Iterable[Row]]) -> None:
        places: dict[str, tuple[Path, dict[int, None]]] = {}
        for number, batch in enumerate(written):
            for row in batch:
                places.setdefault(row.piece, (file, {}))[1][number] = None
        self._places |= places

    def add(self, rows: Iterable[Row]) -> None:
        """Keep all rows of some pieces.

        **Raises:** `DataError` where they cannot be written.
        """
        file, together = self._parts / f"{uuid.uuid4().hex}.parquet", [*_in_batches(rows)]
        write_batches(file, Row, together, self._metadata)
        self._take_up(file, together)

    def finish(self, pieces: Sequence[str]) -> Path:
        """Write the rows of these pieces, in this order, to one file in place of all parts.

        **Raises:** `DataError` where it cannot be written, or a part was damaged meanwhile.
        """

        @functools.lru_cache(HELD)
        def batch(file: Path, number: int) -> list[Row]:
            with _opened(file) as (source, _):
                return _batch(source, number)

        rows = (
            row
            for piece in pieces
            for number in self._places[piece][1]
            for row in batch(self._places[piece][0], number)
            if row.piece == piece
        )
        file = self._folder / SUMMARIES
        write_batches(file, Row, _in_batches(rows), self._metadata)
        shutil.rmtree(self._parts, ignore_errors=True)
        return file


def _in_batches(rows: Iterable[Row]) -> Iterator[list[Row]]:
    return batches(rows, lambda row: len(row.sums) + len(row.lengths), ROWS)

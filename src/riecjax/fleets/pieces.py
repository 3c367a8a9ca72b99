"""What is summed at a time: a source, or a stretch of a long one with what its windows reach."""

# Rows of a Parquet source can be read in parts. A stretch holds the starts of its own windows and,
# beside them, the samples that these reach and that a derivative or a spike is judged by. So every
# window counts once, also one that lies across the boundary of two files of a data set.

import bisect
import contextlib
import itertools
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from riecjax.errors import DataError
from riecjax.fleets.sources import Source, opened

STRETCH = 2**20
"""Starts of a stretch, about."""
LONG = 2**26
"""Bytes of a Parquet file past which it is read in stretches: a million rows of eight columns."""
BESIDE = 2**10
"""Samples on both sides of a stretch that preparation looks at."""
BATCH = 2**16
"""Rows that are unpacked at a time."""

Keys = tuple[tuple[str, str], ...]


class Piece(NamedTuple):
    """A source, or some rows of it.

    **Fields:** `source`; windows start in rows from `first` to before `stop`, which is 0 for a
    source as a whole; `low` and `high`, first row of the recording and one beyond its last;
    `keys`, what columns hold in all of these rows; `before`, rows of the recording in files before
    the source's first, and `ends`, rows up to the end of each of its files, where they are known.
    """

    source: Source
    first: int = 0
    stop: int = 0
    low: int = 0
    high: int = 0
    keys: Keys = ()
    before: int = 0
    ends: tuple[int, ...] = ()

    @property
    def identity(self) -> str:
        """What tells it from all others, and from itself once its files have changed."""
        return f"{self.source.name}\0{self.source.state}\0{self.first}\0{self.stop}"

    @property
    def part(self) -> str:
        """Which recording of its source it is of, by what its columns say and where it begins."""
        said = [f"{key}={value}" for key, value in self.keys]
        return ", ".join([*said, f"from row {self.low} on"] if self.low else said)

    def reach(self, window: int) -> tuple[int, int]:
        """First row to read, and one beyond the last, for windows of so many samples."""
        return max(self.first - BESIDE, self.low), min(self.stop + window + BESIDE, self.high)

    def within(self, window: int) -> "Piece":
        """The same with only those files that it reads: of weeks in thousands the others would be
        sent along with each piece, and opened."""
        low, high = self.reach(window)
        first, last = bisect.bisect_right(self.ends, low), bisect.bisect_left(self.ends, high)
        source = self.source._replace(urls=self.source.urls[first : last + 1])
        before = self.ends[first - 1] if first else self.before
        return self._replace(source=source, before=before, ends=self.ends[first : last + 1])


def is_long(source: Source) -> bool:
    """Whether a source is read by rows: it is large, or its files are one recording together."""
    return source.is_parquet and (source.size > LONG or len(source.urls) > 1)


def stretches(piece: Piece, starts: int, window: int) -> Iterator[Piece]:
    """A recording's rows in pieces of so many starts; the last may have half as many more.

    **Arguments:** `window`, samples of the longest one.
    """
    first = piece.first
    while piece.stop - first > 1.5 * starts:
        yield piece._replace(first=first, stop=first + starts).within(window)
        first += starts
    yield piece._replace(first=first).within(window)


def recordings_of(
    source: Source, columns: Sequence[str], storage: Mapping[str, Any]
) -> list[Piece]:
    """Rows of a Parquet source that follow one another and agree in these columns.

    **Raises:** `DataError` where a column is in none of its files; `OSError`.
    """
    found: list[Piece] = []
    ends: list[int] = []
    before = 0
    for url in source.urls:
        with opened(url, storage) as stream:
            file = _parquet(stream)
            if missing := {*columns} - {*file.schema_arrow.names}:
                raise DataError(f"there is no column '{min(missing)}' to group by.")
            for keys, count in _runs(file, columns):
                if found and found[-1].keys == keys:
                    found[-1] = found[-1]._replace(stop=before + count, high=before + count)
                else:
                    found.append(
                        Piece(source, before, before + count, before, before + count, keys)
                    )
                before += count
            ends.append(before)
    if not (some := [piece for piece in found if piece.stop > piece.first]):
        raise DataError("it holds no rows.")
    every = tuple(ends)
    return [piece._replace(ends=every) for piece in some]


def _runs(file: Any, columns: Sequence[str]) -> Iterator[tuple[Keys, int]]:
    """What columns hold, and in how many rows that follow one another."""
    if not columns:
        yield (), file.metadata.num_rows
        return
    for batch in file.iter_batches(BATCH, columns=list(columns)):
        rows = zip(*(batch.column(name).to_pylist() for name in columns))
        for values, same in itertools.groupby(rows):
            yield tuple(zip(columns, map(str, values))), len(list(same))


@contextlib.contextmanager
def rows_at_hand(piece: Piece, low: int, high: int, storage: Mapping[str, Any]) -> Iterator[Path]:
    """Rows of a recording as a Parquet file of this machine, of its source's name.

    **Raises:** `OSError` where it cannot be read or written.
    """
    from pyarrow import Table, concat_tables, parquet

    parts: list[Any] = []
    before = piece.before
    for url in piece.source.urls:
        with opened(url, storage) as stream:
            file = _parquet(stream)
            rows = file.metadata.num_rows
            if max(low, before) < min(high, before + rows):
                parts += _some_rows(file, max(low - before, 0), min(high - before, rows))
            before += rows
        if before >= high:
            break
    table = concat_tables(Table.from_batches([part]) for part in parts)
    with tempfile.TemporaryDirectory(prefix="riecjax-") as folder:
        here = (Path(folder) / Path(piece.source.name).name).with_suffix(".parquet")
        parquet.write_table(table, here, compression="none", use_dictionary=False)
        yield here


def _parquet(stream: Any) -> Any:
    from pyarrow import ArrowException, parquet

    try:
        return parquet.ParquetFile(stream, page_checksum_verification=True)
    except ArrowException as error:
        raise DataError(f"not a readable Parquet file: {str(error).splitlines()[0]}") from None


def _some_rows(file: Any, low: int, high: int) -> Iterator[Any]:
    """Rows of one file, of which only the groups of rows are read that hold some."""
    counts = [file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)]
    ends = list(itertools.accumulate(counts))
    wanted = [i for i, end in enumerate(ends) if end > low and end - counts[i] < high]
    before = ends[wanted[0]] - counts[wanted[0]]
    for batch in file.iter_batches(BATCH, row_groups=wanted):
        first, stop = max(low - before, 0), min(high - before, batch.num_rows)
        if first < stop:
            yield batch.slice(first, stop - first)
        before += batch.num_rows

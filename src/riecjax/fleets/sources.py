"""What a fleet's recordings lie in: files found by patterns, here or in a store.

A folder called `*.parquet` is a data set, as Spark, Dask and pandas write them: its files, in the
order of their names, are one recording. Folders called `key=value`, as Hive partitions data, are
keys of all that lies beneath.
"""

import contextlib
import hashlib
import itertools
import json
import os
import posixpath
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from pyarrow import concat_tables, parquet

from riecjax.errors import DataError, RiecjaxError, reason_of
from riecjax.records.reading import endings, foreign_reader

DATA_SET = ".parquet"
"""Ending of a folder whose files are one recording."""
STATES = ("ETag", "etag", "mtime", "LastModified", "last_modified", "updated", "created", "md5Hash")
"""What stores call what changes with a file."""
OTHERS = ("_", ".")
"""Beginnings of names of files beside the data, as `_SUCCESS` and `.crc`."""
LONG = 2**26
"""Bytes of a Parquet file past which it is read in stretches: a million rows of eight columns."""

Keys = tuple[tuple[str, str], ...]
Infos = dict[str, Mapping[str, Any]]
"""What the store says of files, by their URLs."""


class Source(NamedTuple):
    """What one recording, or several, are read from.

    **Fields:** `name`, its path below the folder that all have in common; `urls` of its files, one
    after the other in time; `keys` of its path, as Hive has them; `state`, another one once a file
    has changed; `size` in bytes.
    """

    name: str
    urls: tuple[str, ...]
    keys: Keys
    state: str
    size: int

    @property
    def is_parquet(self) -> bool:
        """Whether its rows can be read in parts."""
        return all(url.lower().endswith(DATA_SET) for url in self.urls)

    @property
    def is_long(self) -> bool:
        """Whether it is read by rows: it is large, or its files are one recording together."""
        return self.is_parquet and (self.size > LONG or len(self.urls) > 1)


def find_sources(
    patterns: Sequence[str | os.PathLike[str]],
    is_other: Callable[[str], bool] = lambda _: False,
) -> list[Source]:
    """All that match a path, a folder (with all that it holds) or a pattern, sorted by name.

    **Arguments:** `patterns`: also URLs of a file system that fsspec knows, `s3://bucket/drives/*`;
    `is_other`, which paths are no recordings.

    **Raises:** `DataError` for a pattern that nothing matches, and a store that does not answer.
    """
    files: Infos = {}
    roots = []
    for pattern in [os.fspath(pattern) for pattern in patterns]:
        root, matching = _files(pattern)
        matching = {url: info for url, info in matching.items() if not is_other(url)}
        if not matching:
            raise DataError(f"nothing that can be read matches '{pattern}'.")
        files |= matching
        roots.append(root)
    sets: dict[str, list[str]] = {}
    for url in sorted(files):
        whole = _recording_of(url)
        if whole == url or url.lower().endswith(DATA_SET):
            sets.setdefault(whole, []).append(url)
    # Not of what is found: a name must not change with the files beside.
    common = posixpath.commonprefix(roots)
    root = common[: common.rfind("/") + 1]

    def source(url: str, urls: Sequence[str]) -> Source:
        infos = [files[each] for each in urls]
        states = [[str(info.get(key)) for key in ("size", *STATES)] for info in infos]
        state = hashlib.sha256(repr(states).encode()).hexdigest()[:32]
        name = url.removeprefix(root) or posixpath.basename(url)
        size = sum(int(info.get("size") or 0) for info in infos)
        folder = url if url.lower().endswith(DATA_SET) else posixpath.dirname(url)
        pairs = (part.partition("=") for part in folder.split("/"))
        keys = tuple((unquote(key), unquote(value)) for key, _, value in pairs if key and value)
        return Source(name, tuple(urls), keys, state, size)

    return sorted(source(url, urls) for url, urls in sets.items())


def _files(pattern: str) -> tuple[str, Infos]:
    """The folder that a pattern looks into, and what the store says of all files that match."""
    import fsspec

    with in_words(f"'{pattern}' cannot be looked at"):
        fs, path = fsspec.core.url_to_fs(pattern)
        fs.invalidate_cache()  # what changes while others are summed must be seen
        matched = fs.glob(path, detail=True) if fsspec.core.has_magic(path) else {}
        if not matched and fs.exists(path):  # also where a name holds such a sign
            matched = {path: fs.info(path)}
        files: Infos = {}
        for place, info in matched.items():
            inner = fs.find(place, detail=True) if info["type"] == "directory" else {}
            for inside, its_info in inner.items():
                parts = inside[len(place) :].strip("/").split("/")
                is_known = posixpath.splitext(parts[-1])[1].lower() in endings()
                if is_known and not any(part.startswith(OTHERS) for part in parts):
                    files[inside] = its_info
            files |= {place: info} if info["type"] == "file" else {}
        # Of a pattern, as far as it is a path.
        root = path if path in matched else re.split(r"[*?\[]", path, maxsplit=1)[0]
        if matched.get(root, {}).get("type") != "directory" or _recording_of(f"{root}/") == root:
            root = posixpath.dirname(root)
    is_local = "file" in (fs.protocol if isinstance(fs.protocol, tuple) else (fs.protocol,))
    url = (lambda place: place) if is_local else fs.unstrip_protocol
    return url(root) + "/", {url(place): info for place, info in files.items()}


@contextlib.contextmanager
def in_words(what: str) -> Iterator[None]:
    """Make a `DataError` of whatever a store's client, or a damaged file, leads to.

    What reads the data within raises as it does.
    """
    try:
        yield
    except (RiecjaxError, MemoryError):
        raise
    except Exception as error:
        raise DataError(f"{what}: {reason_of(error).rstrip('.')}.") from None


def _recording_of(url: str) -> str:
    """The data set's folder that a file is part of, or the file itself."""
    folder = posixpath.dirname(url)
    inside = any(part.lower().endswith(DATA_SET) for part in folder.split("/"))
    return folder if inside else url


# Rows of a Parquet source can be read in parts. A stretch holds the starts of its own windows and,
# beside them, the samples that these reach and that a derivative or a spike is judged by. So every
# window counts once, also one that lies across the boundary of two files of a data set.


BESIDE = 2**10
"""Samples on both sides of a stretch that preparation looks at."""
BATCH = 2**16
"""Rows that are unpacked at a time."""


class Piece(NamedTuple):
    """A source, or some rows of it.

    **Fields:** `source`; windows start in rows from `first` to before `stop`, which is 0 for a
    source as a whole; `low` and `high`, first row of the recording and one beyond its last;
    `keys`, what columns hold in all of these rows; `files`, URLs with the first row of each and one
    beyond its last, in order.
    """

    source: Source
    first: int = 0
    stop: int = 0
    low: int = 0
    high: int = 0
    keys: Keys = ()
    files: tuple[tuple[str, int, int], ...] = ()

    @property
    def identity(self) -> str:
        """What tells it from all others, and from itself once its files have changed."""
        return f"{self.source.name}\0{self.source.state}\0{self.first}\0{self.stop}"

    @property
    def part(self) -> str:
        """Which recording of its source it is of, by what its columns say and where it begins."""
        labels = [f"{key}={value}" for key, value in self.keys]
        return ", ".join([*labels, f"from row {self.low} on"] if self.low else labels)

    @property
    def labels(self) -> str:
        """JSON of what its path and columns say."""
        return json.dumps(dict((*self.source.keys, *self.keys)))

    def reach(self, window: int) -> tuple[int, int]:
        """First row to read, and one beyond the last, for windows of so many samples."""
        return max(self.first - BESIDE, self.low), min(self.stop + window + BESIDE, self.high)


def stretches(piece: Piece, starts: int, window: int) -> Iterator[Piece]:
    """A recording's rows in pieces of so many starts; the last may have half as many more.

    **Arguments:** `window`, samples of the longest one.
    """
    first = piece.first
    while first < piece.stop:
        last = first + starts if piece.stop - first > 1.5 * starts else piece.stop
        stretch = piece._replace(first=first, stop=last, source=piece.source._replace(urls=()))
        # Of weeks in thousands of files the others would be sent along with each piece.
        low, high = stretch.reach(window)
        yield stretch._replace(files=tuple(f for f in piece.files if f[1] < high and f[2] > low))
        first = last


def recordings_of(source: Source, columns: Sequence[str]) -> list[Piece]:
    """Rows of a Parquet source that follow one another and agree in these columns.

    **Raises:** `DataError` where a column is in none of its files; `OSError`.
    """
    runs: list[tuple[Keys, int]] = []
    files, stop = [], 0
    for url in source.urls:
        with _parquet(url) as file:
            if lacking := {*columns} - {*file.schema_arrow.names}:
                raise DataError(f"there is no column '{min(lacking)}' to group by.")
            runs += _runs(file, columns)
            files.append((url, stop, stop + file.metadata.num_rows))
            stop = files[-1][2]
    pieces: list[Piece] = []
    last = 0
    for keys, same in itertools.groupby(runs, key=lambda run: run[0]):
        first, last = last, last + sum(count for _, count in same)
        pieces.append(Piece(source, first, last, first, last, keys, tuple(files)))
    if not last:
        raise DataError("it holds no rows.")
    return pieces


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
def at_hand(piece: Piece, rows: tuple[int, int]) -> Iterator[Path]:
    """A source's one file as a file of this machine, brought here if it lies in a store; of a
    recording in a Parquet source, some rows, as a file of its source's name.

    **Raises:** `DataError` where it cannot be read; `OSError` where it cannot be written.
    """
    import fsspec

    whole = "" if piece.stop else piece.source.urls[0]
    if whole and "://" not in whole:
        yield Path(whole)
        return
    low, high = rows
    tables: list[Any] = []
    offsets: list[int] = []
    for url, begin, stop in piece.files:
        if begin < high and stop > low:
            with _parquet(url) as file:
                # Only groups of rows are read that hold some.
                counts = [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)]
                edges = begin + np.cumsum([0, *counts])
                wanted = np.flatnonzero((edges[:-1] < high) & (edges[1:] > low))
                tables.append(file.read_row_groups(wanted.tolist()))
                offsets.append(low - int(edges[wanted[0]]))
    with tempfile.TemporaryDirectory(prefix="riecjax-") as folder:
        here = Path(folder) / posixpath.basename(whole or piece.source.name)
        if whole:
            with in_words(f"'{whole}' cannot be read"):
                fs, path = fsspec.core.url_to_fs(whole)
                fs.get_file(path, str(here))
        else:
            table = concat_tables(tables).slice(offsets[0], high - low)
            here = here.with_suffix(".parquet")
            parquet.write_table(table, here, compression="none", use_dictionary=False)
        yield here


@contextlib.contextmanager
def _parquet(url: str) -> Iterator[Any]:
    """A Parquet file of a source, to be read in pieces.

    **Raises:** `DataError` where it cannot be.
    """
    import fsspec

    with in_words(f"'{url}' cannot be read"), fsspec.open(url, "rb") as stream:
        with foreign_reader("Parquet"):
            file = parquet.ParquetFile(stream, page_checksum_verification=True)
        yield file

"""What a fleet's recordings lie in: files found by patterns, here or in a store.

A folder called `*.parquet` is a data set, as Spark, Dask and pandas write them: its files, in the
order of their names, are one recording. Folders called `key=value`, as Hive partitions data, are
keys of all that lies beneath.
"""

import bisect
import contextlib
import hashlib
import itertools
import os
import posixpath
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

from riecjax.errors import DataError, RiecjaxError, require
from riecjax.records.reading import endings

DATA_SET = ".parquet"
"""Ending of a folder whose files are one recording."""
STATES = ("ETag", "etag", "mtime", "LastModified", "last_modified", "updated", "created", "md5Hash")
"""What stores call what changes with a file."""
OTHERS = ("_", ".")
"""Beginnings of names of files beside the data, as `_SUCCESS` and `.crc`."""


class Source(NamedTuple):
    """What one recording, or several, are read from.

    **Fields:** `name`, its path below the folder that all have in common; `urls` of its files, one
    after the other in time; `keys` of its path, as Hive has them; `state`, another one once a file
    has changed; `size` in bytes.
    """

    name: str
    urls: tuple[str, ...]
    keys: tuple[tuple[str, str], ...]
    state: str
    size: int

    @property
    def is_parquet(self) -> bool:
        """Whether its rows can be read in parts."""
        return all(url.lower().endswith(DATA_SET) for url in self.urls)


def find_sources(
    patterns: Sequence[str | os.PathLike[str]],
    storage: Mapping[str, Any] | None = None,
    without: Callable[[str], bool] = lambda _: False,
) -> list[Source]:
    """All that match a path, a folder (with all that it holds) or a pattern, sorted by name.

    **Arguments:** `patterns`: also URLs of a file system that fsspec knows, `s3://bucket/drives/*`;
    `storage`: what fsspec needs to know of it; `without`, which paths are no recordings.

    **Raises:** `DataError` for a pattern that nothing matches, and a store that does not answer.
    """
    require("the patterns", patterns, (list, tuple), "['drives/*.csv']")
    files: dict[str, Mapping[str, Any]] = {}
    roots = []
    for pattern in patterns:
        root, found = _files(os.fspath(pattern), storage or {})
        found = {url: info for url, info in found.items() if not without(url)}
        if not found:
            raise DataError(f"nothing that can be read matches '{os.fspath(pattern)}'.")
        files |= found
        roots.append(root)
    sets: dict[str, list[str]] = {}
    for url in sorted(files):
        whole = _recording_of(url)
        if whole == url or url.lower().endswith(DATA_SET):
            sets.setdefault(whole, []).append(url)
    # Not of what is found: a name must not change with the files beside.
    common = posixpath.commonprefix(roots)
    root = common[: common.rfind("/") + 1]
    return sorted(
        Source(
            url.removeprefix(root) or posixpath.basename(url),
            tuple(urls),
            tuple(_keys(url)),
            _state([files[one] for one in urls]),
            sum(int(files[one].get("size") or 0) for one in urls),
        )
        for url, urls in sets.items()
    )


def _files(pattern: str, storage: Mapping[str, Any]) -> tuple[str, dict[str, Mapping[str, Any]]]:
    """The folder that a pattern looks into, and URL to what the store says, of all that match."""
    import fsspec

    with _in_words(f"'{pattern}' cannot be looked at"):
        fs, path = fsspec.core.url_to_fs(pattern, **storage)
        fs.invalidate_cache()  # what changes while others are summed must be seen
        matched = fs.glob(path, detail=True) if fsspec.core.has_magic(path) else {}
        if not matched and fs.exists(path):  # also where a name holds such a sign
            matched = {path: fs.info(path)}
        found: dict[str, Mapping[str, Any]] = {}
        for each, info in matched.items():
            inner = fs.find(each, detail=True) if info["type"] == "directory" else {}
            for inside, about in inner.items():
                *folders, name = inside[len(each) :].strip("/").split("/")
                known = posixpath.splitext(name)[1].lower() in endings()
                if known and not any(part.startswith(OTHERS) for part in (*folders, name)):
                    found[inside] = about
            found |= {each: info} if info["type"] == "file" else {}
        # Of a pattern, as far as it is a path.
        root = path if path in matched else re.split(r"[*?\[]", path, maxsplit=1)[0]
        if matched.get(root, {}).get("type") != "directory" or _recording_of(f"{root}/") == root:
            root = posixpath.dirname(root)
    local = "file" in (fs.protocol if isinstance(fs.protocol, tuple) else (fs.protocol,))
    url = (lambda each: each) if local else fs.unstrip_protocol
    return url(root) + "/", {url(each): info for each, info in found.items()}


@contextlib.contextmanager
def _in_words(what: str) -> Iterator[None]:
    """Make a `DataError` of what a store's client raises, which each has exceptions of its own for.

    What reads the data within raises as it does.
    """
    try:
        yield
    except (RiecjaxError, MemoryError):
        raise
    except Exception as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise DataError(f"{what}: {said[:300].rstrip('.')}.") from None


def _recording_of(url: str) -> str:
    """The data set's folder that a file is part of, or the file itself."""
    folder = posixpath.dirname(url)
    inside = any(part.lower().endswith(DATA_SET) for part in folder.split("/"))
    return folder if inside else url


def _keys(url: str) -> Iterator[tuple[str, str]]:
    folders = (url if url.lower().endswith(DATA_SET) else posixpath.dirname(url)).split("/")
    for part in folders:
        key, equals, value = part.partition("=")
        if key and equals and value:
            yield unquote(key), unquote(value)


def _state(infos: Iterable[Mapping[str, Any]]) -> str:
    said = [[str(info.get(key)) for key in ("size", *STATES)] for info in infos]
    return hashlib.sha256(repr(said).encode()).hexdigest()[:32]


@contextlib.contextmanager
def opened(url: str, storage: Mapping[str, Any]) -> Iterator[Any]:
    """A file of a source, to be read in pieces.

    **Raises:** `DataError` where it cannot be.
    """
    import fsspec

    with _in_words(f"'{url}' cannot be read"), fsspec.open(url, "rb", **storage) as stream:
        yield stream


@contextlib.contextmanager
def at_hand(source: Source, storage: Mapping[str, Any]) -> Iterator[Path]:
    """A source's one file as a file of this machine, brought here if it lies in a store.

    **Raises:** `DataError` where it cannot be.
    """
    import fsspec

    (url,) = source.urls
    if "://" not in url:
        yield Path(url)
        return
    with tempfile.TemporaryDirectory(prefix="riecjax-") as folder:
        here = Path(folder) / posixpath.basename(url)
        with _in_words(f"'{url}' cannot be read"):
            fs, path = fsspec.core.url_to_fs(url, **storage)
            fs.get_file(path, str(here))
        yield here


# Rows of a Parquet source can be read in parts. A stretch holds the starts of its own windows and,
# beside them, the samples that these reach and that a derivative or a spike is judged by. So every
# window counts once, also one that lies across the boundary of two files of a data set.


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

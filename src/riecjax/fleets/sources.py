"""What a fleet's recordings lie in: files found by patterns, here or in a store.

A folder called `*.parquet` is a data set, as Spark, Dask and pandas write them: its files, in the
order of their names, are one recording. Folders called `key=value`, as Hive partitions data, are
keys of all that lies beneath.
"""

import contextlib
import hashlib
import os
import posixpath
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

from riecjax.errors import DataError, RiecjaxError, require
from riecjax.records.reading.read import READERS

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
    root = _common_folder(roots)
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
            found |= {k: v for k, v in inner.items() if _is_data(k[len(each) :])}
            found |= {each: info} if info["type"] == "file" else {}
        root = _fixed(path) if path not in matched else path
        if matched.get(root, {}).get("type") != "directory" or _recording_of(f"{root}/") == root:
            root = posixpath.dirname(root)
    local = "file" in (fs.protocol if isinstance(fs.protocol, tuple) else (fs.protocol,))
    url = (lambda each: each) if local else fs.unstrip_protocol
    return url(root) + "/", {url(each): info for each, info in found.items()}


def _fixed(path: str) -> str:
    """A pattern as far as it is a path."""
    return re.split(r"[*?\[]", path, maxsplit=1)[0]


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


def _is_data(below: str) -> bool:
    """Whether a file below a folder is one of data, by its path from there."""
    parts = below.strip("/").split("/")
    known = posixpath.splitext(parts[-1])[1].lower() in READERS
    return known and not any(part.startswith(OTHERS) for part in parts)


def _recording_of(url: str) -> str:
    """The data set's folder that a file is part of, or the file itself."""
    folder = posixpath.dirname(url)
    inside = any(part.lower().endswith(DATA_SET) for part in folder.split("/"))
    return folder if inside else url


def _common_folder(folders: Sequence[str]) -> str:
    common = posixpath.commonprefix([*folders])
    return common[: common.rfind("/") + 1]


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

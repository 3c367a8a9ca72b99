"""Files that appear whole or not at all.

What is written stands under a temporary name until it is whole. The process that writes it holds a
lock on it, which the system takes away with the process, however that ends: so the next one that
writes beside it knows what was left behind, and removes it.
"""

# This module imports little: it is there before all that takes long.

import contextlib
import os
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

try:
    import fcntl
except ImportError:  # on Windows, where an open file can be neither renamed nor removed
    fcntl = None

LEFT_BEHIND = re.compile(r"\.riecjax-[0-9a-f]{32}(\.\w+)?")
"""Temporary names."""
OLD = 86400.0
"""Seconds after which, where there are no locks, no one is writing to a file any more."""

committing = threading.RLock()
"""Held while finished files take their places: whoever ends the process waits for it."""
_begun: set[Path] = set()


@contextlib.contextmanager
def temporary(
    folder: Path, suffix: str = "", *, is_folder: bool = False, mode: int = 0o777
) -> Iterator[Path]:
    """A new file, which no one else may read, or a folder in `folder`; it goes with the block.

    What processes that are gone have left there goes before.

    **Arguments:** `mode` of a folder, within what the process allows.

    **Raises:** `OSError` where there can be none.
    """
    sweep(folder)
    path, lock = _begin(folder, suffix, mode if is_folder else None)
    try:
        yield path
    finally:
        _remove(path)
        _begun.discard(path)
        if lock is not None:
            os.close(lock)


def _begin(folder: Path, suffix: str, mode: int | None) -> tuple[Path, int | None]:
    """A path, and a descriptor that holds its lock; of a folder where there is a mode."""
    while True:
        path = folder / f".riecjax-{os.urandom(16).hex()}{suffix}"
        _begun.add(path)
        if mode is not None:
            path.mkdir(mode)
        else:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        if fcntl is None:
            return path, None
        with contextlib.suppress(OSError):
            lock = os.open(path, os.O_RDONLY)
            with contextlib.suppress(OSError):  # as on some network drives
                fcntl.flock(lock, fcntl.LOCK_EX)
            if path.exists():
                return path, lock
            # Somebody swept it before it was locked.
            os.close(lock)
        _begun.discard(path)


def sweep(folder: Path) -> None:
    """Remove what processes that are gone have left in a folder."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if LEFT_BEHIND.fullmatch(entry.name):
                _remove_if_left(Path(entry.path))


def _remove_if_left(path: Path) -> None:
    with contextlib.suppress(OSError):
        if fcntl is None:
            if time.time() - path.stat().st_mtime > OLD:
                _remove(path)
            return
        lock = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _remove(path)
        finally:
            os.close(lock)


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def end(process: Callable[[], None]) -> None:
    """End the process, once finished files are in their places, without what it has begun."""
    with committing:
        for path in list(_begun):
            _remove(path)
        process()


def write_whole(file: Path, content: bytes) -> None:
    """Write a file, which no one else may read, whole or not at all.

    **Raises:** `OSError` where it cannot be written.
    """
    with temporary(file.parent) as new:
        new.write_bytes(content)
        new.replace(file)


def stamp(file: Path) -> str:
    """What stands in a file that a later run, which does not make it any more, may remove."""
    return f"written by riecjax as {file.name}"


def is_stamped(file: Path) -> bool:
    """Whether a file was written under this name with its [`stamp`][]."""
    return file.is_file() and stamp(file).encode() in file.read_bytes()


class Store(NamedTuple):
    """Files by key in a folder; beyond `most` bytes, those go that were not used for longest."""

    folder: Path
    suffix: str
    most: int

    def get(self, key: str) -> bytes | None:
        """What is kept under a key; `None` for nothing."""
        file = self._file(key)
        with contextlib.suppress(OSError):
            os.utime(file)
            return file.read_bytes()
        return None

    def put(self, key: str, content: bytes) -> None:
        """Keep it, where it can be."""
        with contextlib.suppress(OSError):
            self._make_room(len(content))
            write_whole(self._file(key), content)

    def _file(self, key: str) -> Path:
        return self.folder / (key + self.suffix)

    def _make_room(self, needed: int) -> None:
        found = [(file.stat(), file) for file in self.folder.glob(f"[!.]*{self.suffix}")]
        excess = sum(told.st_size for told, _ in found) + needed - self.most
        for told, file in sorted(found, key=lambda one: one[0].st_mtime):
            if excess <= 0:
                return
            file.unlink(missing_ok=True)
            excess -= told.st_size

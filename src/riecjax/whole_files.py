"""Files that appear whole or not at all.

What is written stands under a temporary name until it is whole. What a process that was killed left
behind goes a day later, with the next one that writes beside it; nothing that stands there under
such a name is opened.
"""

# This module imports little: it is there before all that takes long.

import contextlib
import os
import re
import shutil
import stat
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from riecjax.errors import DataError

LEFT_BEHIND = re.compile(r"\.riecjax-[0-9a-f]{32}(\.\w+)?")
"""Temporary names."""
OLD = 86400.0
"""Seconds after which no one is writing to a file any more."""
MOST_SEARCHED = 2**16
"""Bytes at each end of a file among which a stamp is looked for."""

LARGEST_DOCUMENT = 2**28
"""Bytes of a file of settings or results."""

committing = threading.RLock()
"""Held while finished files take their places: whoever ends the process waits for it."""
_begun: set[Path] = set()


@contextlib.contextmanager
def temporary(
    folder: Path, suffix: str = "", *, is_folder: bool = False, mode: int = 0o700
) -> Iterator[Path]:
    """A new file or folder in `folder`, by default for no one else; it goes with the block.

    What processes that are gone have left there goes before.

    **Arguments:** `mode`, within what the process allows; a file is never to be executed.

    **Raises:** `OSError` where there can be none.
    """
    sweep(folder)
    path = folder / f".riecjax-{os.urandom(16).hex()}{suffix}"
    _begun.add(path)
    try:
        if is_folder:
            path.mkdir(mode)
        else:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode & 0o666))
        yield path
    finally:
        _remove(path)
        _begun.discard(path)


def sweep(folder: Path) -> None:
    """Remove what processes that are gone have left in a folder, files and folders of theirs."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if not LEFT_BEHIND.fullmatch(entry.name):
                continue
            with contextlib.suppress(OSError):
                told = entry.stat(follow_symlinks=False)
                is_plain = stat.S_ISREG(told.st_mode) or stat.S_ISDIR(told.st_mode)
                if is_plain and time.time() - told.st_mtime > OLD:
                    _remove(Path(entry.path))


def require_plain(file: Path) -> None:
    """Raise `OSError` where a file could not take this place: a folder or a device stands there."""
    if file.exists() and not file.is_file():
        raise OSError(0, "it is no plain file")


def no_file(path: str | os.PathLike[str]) -> str:
    """That no file can be read here, in words: nothing is there, or something else is."""
    if not os.path.exists(path):
        return f"there is no file '{path}'."
    return f"'{path}' is a {'folder' if os.path.isdir(path) else 'pipe or device'}, and no file."


def no_folder(path: Path, error: OSError) -> str:
    """Why a folder cannot be written, in words: a file may stand in its way."""
    for place in (path, *path.parents):
        if os.path.lexists(place) and not place.is_dir():
            return f"cannot write to '{path}': '{place}' is no folder."
    return f"cannot write to '{path}': {error.strerror}."


def seen_from(folder: Path | None, path: str) -> str:
    """A path, which starts from here, as one that starts from a folder, on any system.

    It is absolute where the folder is on another drive, to which no path of Windows leads.
    """
    seen = os.path.normpath(path)
    if folder is not None and not os.path.isabs(path):
        try:
            seen = os.path.relpath(path, folder)
        except ValueError:
            seen = os.path.abspath(path)
    return seen.replace(os.sep, "/")


def read_plain(file: Path) -> bytes:
    """What a plain file of settings or results holds.

    **Raises:** `OSError` for anything else, such as a device, and one that is too large to be that.
    """
    told = file.stat()
    if not stat.S_ISREG(told.st_mode):
        raise OSError(0, "it is no plain file")
    if told.st_size > LARGEST_DOCUMENT:
        raise OSError(0, f"it has more than {LARGEST_DOCUMENT} bytes")
    return file.read_bytes()


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


def write_file(file: Path, fill: Callable[[Path], None]) -> None:
    """Let `fill` write a temporary file beside this one, then rename it: whole or not at all.

    Others may read it as far as the process allows that.

    **Raises:** `DataError` where it cannot be written.
    """
    try:
        require_plain(file)
        with temporary(file.parent, file.suffix, mode=0o666) as new:
            fill(new)
            new.replace(file)
    except OSError as error:
        raise DataError(f"cannot write '{file}': {error.strerror}.") from None


def stamp(file: Path) -> str:
    """What stands in a file that a later run, which does not make it any more, may remove."""
    return f"written by riecjax as {file.name}"


def is_stamped(file: Path) -> bool:
    """Whether a plain file was written under this name with its [`stamp`][], at either end."""
    with contextlib.suppress(OSError):
        if not stat.S_ISREG(file.lstat().st_mode):
            return False
        with file.open("rb") as stream:
            ends = stream.read(MOST_SEARCHED)
            stream.seek(max(file.stat().st_size - MOST_SEARCHED, 0))
            return stamp(file).encode() in ends + b"\0" + stream.read(MOST_SEARCHED)
    return False

"""Reading a file in a process of its own, with limits on time and memory.

On some damaged files a library ends the whole process instead of raising an error, hangs, or asks
for all memory. So it runs in a separate process, which is this module as a program:
`python -m <this> MODULE FUNCTION FILE OUT.npz ARGUMENTS`.
"""

import contextlib
import ctypes
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.channels import LARGEST_FILE, Channels, size_of
from riecjax.whole_files import temporary

PATIENCE = 60.0
"""Seconds that reading may take, besides those that the file's size explains."""
SLOWEST_READING = 5e6
"""Bytes a second."""
MEMORY = 4 * LARGEST_FILE
"""Bytes that the reading process may ask for."""
END_WITH_PARENT = 1
"""Linux's number for that wish."""
OUT_OF_MEMORY = 77
"""Exit status of the reading process: not 3, with which abort() ends one on Windows."""


def read_apart(
    read: Callable[..., Channels], file: Path, kind: str, *arguments: object
) -> Channels:
    """What `read(file, *arguments)` returns, a function of a module, run in a process of its own.

    **Arguments:** `kind` of the file, for messages; `arguments` that JSON can say.

    **Raises:** `DataError` where the function does, crashes, or takes too long; `MemoryError`.
    """
    limit = PATIENCE + size_of(file) / SLOWEST_READING
    # What the library leaves behind when it crashes goes with this folder.
    with temporary(Path(tempfile.gettempdir()), is_folder=True, mode=0o700) as folder:
        out = folder / "channels.npz"
        words = (read.__module__, read.__name__, file.absolute(), out, json.dumps(arguments))
        try:
            status = _run(list(map(str, words)), folder, limit)
        except subprocess.TimeoutExpired:
            raise DataError(
                f"not a readable {kind} file: reading it took longer than {limit:.0f} s."
            ) from None
        if status == OUT_OF_MEMORY:
            raise MemoryError
        if status != 0 or not out.is_file():
            raise DataError(
                f"not a readable {kind} file: its reader crashed, as it does on damaged files."
            )
        return _unpacked(out)


def _run(words: list[str], folder: Path, limit: float) -> int:
    """Run the reading process for `limit` seconds at most, and return its exit status."""
    paths = os.pathsep.join(os.path.abspath(path) for path in sys.path)
    places = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
    return subprocess.run(
        # -P: it finds its modules where this process does, and not in the working folder.
        [sys.executable, "-P", "-m", __spec__.name, *words],
        env={**os.environ, **places, "PYTHONPATH": paths},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        timeout=limit,
        check=False,
    ).returncode


def _unpacked(out: Path) -> Channels:
    with np.load(out) as archive:
        described = json.loads(archive["described"].tobytes())
        if "error" in described:
            raise DataError(described["error"])
        names = described.pop("columns")
        return Channels({name: archive[str(i)] for i, name in enumerate(names)}, **described)


def _pack(module: str, function: str, file: str, out: str, arguments: str) -> None:
    """Read a file and write what it holds, or what is wrong with it."""
    columns: dict[str, np.ndarray] = {}
    try:
        read = getattr(importlib.import_module(module), function)
        found = read(Path(file), *json.loads(arguments))
        columns = found.columns
        described = {**vars(found), "columns": list(columns)}
    except DataError as error:
        described = {"error": str(error)}
    arrays: dict[str, Any] = {str(i): values for i, values in enumerate(columns.values())}
    np.savez(out, described=np.frombuffer(json.dumps(described).encode(), np.uint8), **arrays)


def _limit_resources() -> None:
    """Keep damaged sizes from the machine's memory, and crashes from its disk.

    Windows has neither limit, but a dialog after a crash, for which reading would wait.
    """
    if sys.platform == "win32":
        import msvcrt

        msvcrt.SetErrorMode(msvcrt.SEM_FAILCRITICALERRORS | msvcrt.SEM_NOGPFAULTERRORBOX)
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    with contextlib.suppress(AttributeError, OSError, TypeError):  # of Linux alone
        ctypes.CDLL(None).prctl(END_WITH_PARENT, signal.SIGKILL)


if __name__ == "__main__":
    _limit_resources()
    try:
        _pack(*sys.argv[1:])
    except MemoryError:
        sys.exit(OUT_OF_MEMORY)

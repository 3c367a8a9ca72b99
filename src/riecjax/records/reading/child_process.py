"""Reading a file in a process of its own, with limits on time and memory.

On some damaged files a library ends the whole process instead of raising an error, hangs in code
that no signal interrupts, or asks for all memory. So it runs in a separate process, which is this
module as a program: `python -m <this> FOLDER`. It reads one file after the other, for to start it
takes longer than most reading, and is ended where a file took too long or too much.
"""

import atexit
import contextlib
import functools
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.errors import DataError
from riecjax.extensions import require_packages
from riecjax.records.reading.channels import LARGEST_FILE, Channels, foreign_reader, size_of
from riecjax.runtime import free_memory

PATIENCE = 60.0
"""Seconds that reading may take, besides those that the file's size explains."""
SLOWEST_READING = 5e6
"""Bytes a second."""
MEMORY = 4 * LARGEST_FILE
"""Bytes that the reading process may ask for, where so many are free."""
LEAST_MEMORY = 2 * 2**30
"""Bytes that it may ask for in any case: libraries reserve much that they never use."""


def apart(
    kind: str, needs: str = "", is_trusted: bool = True
) -> Callable[[Callable[..., Channels]], Callable[..., Channels]]:
    """Make a function of a module that reads a file one that runs in a process of its own.

    **Arguments:** `kind` of the file, for messages; `needs`: a use of optional packages that
    riecjax knows, which must be installed; `is_trusted`, as for
    [`foreign_reader`][riecjax.records.reading.foreign_reader], within which it runs.

    **Raises:** `DataError` where the function fails, crashes, or takes too long, or packages are
    not installed; `MemoryError`.
    """

    def decorated(read: Callable[..., Channels]) -> Callable[..., Channels]:
        @functools.wraps(read)
        def asked(file: Path, *arguments: object, **named: object) -> Channels:
            if needs:
                require_packages(needs)
            return _answer(asked, file, (arguments, named), kind, is_trusted)

        return asked

    return decorated


def _answer(
    read: Callable[..., Channels], file: Path, arguments: object, kind: str, is_trusted: bool
) -> Channels:
    limit = PATIENCE + size_of(file) / SLOWEST_READING
    function = [read.__module__, read.__name__]
    question = [*function, str(file.absolute()), arguments, kind, is_trusted, limit]
    with _lock:
        if not (_readers and _readers[0].is_usable):
            _end()
            _readers.append(_Reader())
        began, answered = time.monotonic(), False
        try:
            if answered := _readers[0].answers(question, limit):
                # Arrays and words alone, as nothing that a damaged or hostile file makes of that
                # process is run here.
                with np.load(_readers[0].out) as arrays:
                    described = json.loads(arrays["described"].tobytes())
                    if "error" in described:
                        raise DataError(described["error"])
                    if "memory" in described:
                        raise MemoryError(described["memory"])
                    names = enumerate(described.pop("columns"))
                    return Channels({name: arrays[str(i)] for i, name in names}, **described)
        finally:
            if not answered:
                _end()
    if time.monotonic() - began < limit:
        why = "its reader crashed, as it does on damaged files"
    else:
        why = f"reading it took longer than {limit:.0f} s"
    raise DataError(f"not a readable {kind} file: {why}.")


class _Reader:
    """The reading process and the folder for what it hands over, and what crashes leave behind."""

    def __init__(self):
        # Nothing but `end` removes it: a fork forgets the reader of its parent, and must not.
        folder = tempfile.mkdtemp()
        self.out = Path(folder) / "channels.npz"
        self.made_for = _surroundings()
        places = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), folder)
        self.process: Any = subprocess.Popen(
            # -P: it finds its modules where this process does, and not in the working folder.
            [sys.executable, "-P", "-m", __spec__.name, folder],
            env={**os.environ, **places, "PYTHONPATH": self.made_for[1]},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )

    @property
    def is_usable(self) -> bool:
        """Whether it runs, for this process, and what it hands over has its place."""
        is_alive = self.process.poll() is None and self.out.parent.is_dir()
        return is_alive and self.made_for == _surroundings()

    def answers(self, question: list[object], limit: float) -> bool:
        """Whether a file was read, or refused, within `limit` seconds: the answer is in `out`."""
        timer = threading.Timer(limit, self.process.kill)
        timer.start()
        try:
            self.process.stdin.write(json.dumps(question).encode() + b"\n")
            self.process.stdin.flush()
            return bool(self.process.stdout.readline())
        except OSError:  # it has ended
            return False
        finally:
            timer.cancel()

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()
        shutil.rmtree(self.out.parent, ignore_errors=True)


_lock = threading.RLock()
_readers: list[_Reader] = []


def _surroundings() -> tuple[int, str]:
    """What a reading process is for: this process, not a fork of it, and where modules lie."""
    return os.getpid(), os.pathsep.join(os.path.abspath(path) for path in sys.path)


@atexit.register
def _end() -> None:
    while _readers:
        reader = _readers.pop()
        if reader.made_for[0] == os.getpid():
            reader.end()


def _serve(folder: str) -> None:
    """Read the files that are asked for, a line each, until nobody can ask any more.

    Damaged sizes are kept from the machine's memory, and crashes from its disk. Windows has neither
    limit, but a dialog after a crash, for which reading would wait.
    """
    if sys.platform == "win32":
        import msvcrt

        msvcrt.SetErrorMode(msvcrt.SEM_FAILCRITICALERRORS | msvcrt.SEM_NOGPFAULTERRORBOX)
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        memory = int(max(min(MEMORY, free_memory()), LEAST_MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    # What a library prints is no answer.
    answers = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    try:
        for line in sys.stdin.buffer:
            module, function, file, (arguments, named), kind, is_trusted, limit = json.loads(line)
            # Ends a loop that the parent cannot, having been killed itself.
            with contextlib.suppress(AttributeError):
                signal.alarm(int(limit) + 2)
            columns: dict[str, Any] = {}
            try:
                read = getattr(importlib.import_module(module), function).__wrapped__
                with foreign_reader(kind, is_trusted):
                    channels = read(Path(file), *arguments, **named)
                columns = {str(i): values for i, values in enumerate(channels.columns.values())}
                described = {**vars(channels), "columns": list(channels.columns)}
            except DataError as error:
                described = {"error": str(error)}
            except MemoryError as error:
                described = {"memory": str(error)}
            written = np.frombuffer(json.dumps(described).encode(), np.uint8)
            np.savez(Path(folder) / "channels.npz", described=written, **columns)
            os.write(answers, b"\n")
            with contextlib.suppress(AttributeError):
                signal.alarm(0)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    _serve(sys.argv[1])

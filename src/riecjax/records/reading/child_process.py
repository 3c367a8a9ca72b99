"""Reading a file in a process of its own, with limits on time and memory.

On some damaged files a library ends the whole process instead of raising an error, hangs in code
that no signal interrupts, or asks for all memory. So it runs in a separate process, which is this
module as a program: `python -m <this> FOLDER`. It reads one file after the other, for to start it
takes longer than most reading, and is ended where a file took too long or too much.
"""

import atexit
import contextlib
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from riecjax.errors import DataError
from riecjax.memory import free_memory
from riecjax.records.reading.channels import LARGEST_FILE, Channels, size_of
from riecjax.whole_files import temporary

PATIENCE = 60.0
"""Seconds that reading may take, besides those that the file's size explains."""
SLOWEST_READING = 5e6
"""Bytes a second."""
MEMORY = 4 * LARGEST_FILE
"""Bytes that the reading process may ask for, where so many are free."""
LEAST_MEMORY = 2 * 2**30
"""Bytes that it may ask for in any case: libraries reserve much that they never use."""


def read_apart(
    read: Callable[..., Channels], file: Path, kind: str, *arguments: object
) -> Channels:
    """What `read(file, *arguments)` returns, a function of a module, run in a process of its own.

    **Arguments:** `kind` of the file, for messages; `arguments` that can be pickled.

    **Raises:** `DataError` where the function does, crashes, or takes too long; `MemoryError`.
    """
    limit = PATIENCE + size_of(file) / SLOWEST_READING
    with _lock:
        reader, began, answer = _reader(), time.monotonic(), None
        try:
            answer = reader.answer((read, file.absolute(), arguments, limit), limit)
        except (EOFError, OSError, pickle.UnpicklingError):
            _end()
        except BaseException:
            _end()
            raise
    if isinstance(answer, Exception):
        raise answer
    if answer is not None:
        return answer
    if time.monotonic() - began < limit:
        why = "its reader crashed, as it does on damaged files"
    else:
        why = f"reading it took longer than {limit:.0f} s"
    raise DataError(f"not a readable {kind} file: {why}.")


class _Reader:
    """The reading process, and a folder for what libraries write and crashes leave behind."""

    def __init__(self):
        self.ending = contextlib.ExitStack()
        place = temporary(Path(tempfile.gettempdir()), is_folder=True, mode=0o700)
        self.folder = Path(self.ending.enter_context(place))
        self.made_for = _surroundings()
        places = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(self.folder))
        self.process = subprocess.Popen(
            # -P: it finds its modules where this process does, and not in the working folder.
            [sys.executable, "-P", "-m", __spec__.name, str(self.folder)],
            env={**os.environ, **places, "PYTHONPATH": self.made_for[1]},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )

    def answer(self, request: tuple[Any, ...], limit: float) -> Any:
        """What the function returned or raised.

        **Raises:** `EOFError`, `OSError` or `UnpicklingError` where the process ended, or took
        more than `limit` seconds.
        """
        timer = threading.Timer(limit, self.process.kill)
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        timer.start()
        try:
            pickle.dump(request, self.process.stdin)
            self.process.stdin.flush()
            return pickle.load(self.process.stdout)
        finally:
            timer.cancel()

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()
        self.ending.close()


_lock = threading.RLock()
_readers: list[_Reader] = []


def _surroundings() -> tuple[int, str]:
    """What a reading process is for: this process, not a fork of it, and where modules lie."""
    return os.getpid(), os.pathsep.join(os.path.abspath(path) for path in sys.path)


def _reader() -> _Reader:
    if _readers:
        reader = _readers[0]
        is_alive = reader.process.poll() is None and reader.folder.is_dir()
        if reader.made_for != _surroundings() or not is_alive:
            _end()
    if not _readers:
        _readers.append(_Reader())
    return _readers[0]


@atexit.register
def _end() -> None:
    while _readers:
        reader = _readers.pop()
        if reader.made_for[0] == os.getpid():
            reader.end()


def _serve(folder: str) -> None:
    """Read the files that are asked for, until nobody can ask any more."""
    # Keep crashes from waiting for a dialog, as on Windows, which has no limits.
    if sys.platform == "win32":
        import msvcrt

        msvcrt.SetErrorMode(msvcrt.SEM_FAILCRITICALERRORS | msvcrt.SEM_NOGPFAULTERRORBOX)
    # Keep damaged sizes from the machine's memory, and crashes from its disk.
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        memory = int(max(min(MEMORY, free_memory()), LEAST_MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    # What a library prints is no answer.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    try:
        with contextlib.suppress(EOFError):
            while True:
                read, file, arguments, limit = pickle.load(sys.stdin.buffer)
                # End a loop that the parent cannot, having been killed itself; threads count
                # together.
                with contextlib.suppress(ImportError, ValueError, OSError):
                    import resource

                    seconds = int(time.process_time() + limit * (1 + (os.cpu_count() or 1))) + 1
                    most = resource.getrlimit(resource.RLIMIT_CPU)[1]
                    resource.setrlimit(resource.RLIMIT_CPU, (seconds, most))
                try:
                    answer = read(file, *arguments)
                except (DataError, MemoryError) as error:
                    answer = error
                pickle.dump(answer, answers)
                answers.flush()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    _serve(sys.argv[1])

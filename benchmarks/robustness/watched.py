"""A function run case by case in another process, which is watched from outside.

What hangs in code that no signal interrupts, ends the process, prints past Python or takes too much
memory is found this way, and costs one case.
"""

import contextlib
import ctypes
import faulthandler
import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from riecjax.records.reading import child_process
from riecjax.runtime import start_jax

AT_REST = 1.3e9
"""Bytes that a process may hold between two cases, compiled programs mostly, before a new one
takes its place: a command has a process of its own."""
WAITING = 20
"""Times its patience that a process may wait, on a machine that is busy."""


class Ran(NamedTuple):
    """How a case ran.

    **Fields:** `result`, `None` where there is none; `ended`: why not; `printed` to standard error
    by whatever passes Python's; `seconds` of the processor; `memory`, the peak in bytes.
    """

    result: Any
    ended: str = ""
    printed: str = ""
    seconds: float = 0.0
    memory: float = 0.0


class Watched:
    """Calls of a function of a module in a process of its own, which begins with `begin()`."""

    def __init__(self, function: Callable[..., Any], patience: float):
        self._function, self._patience = function, patience
        self._folder = tempfile.TemporaryDirectory()
        self._process: Any = None

    def __call__(self, *arguments: Any) -> Ran:
        process = self._process = self._process or self._started()
        self._pipe.send(arguments)
        try:
            began, before = time.monotonic(), _seconds(process.pid)
            while (
                _seconds(process.pid) - before < self._patience
                and time.monotonic() - began < WAITING * self._patience
            ):
                if self._pipe.poll(0.2):
                    *ran, at_rest = self._pipe.recv()
                    if at_rest > AT_REST:
                        self.end()
                    return Ran(*ran)
        except (EOFError, ConnectionResetError):
            process.join()
            self._process = None
            return Ran(None, f"the process ended with {process.exitcode}")
        os.kill(process.pid, signal.SIGUSR1)
        time.sleep(0.5)
        trace = (Path(self._folder.name) / "trace").read_text().splitlines()
        self.end()
        return Ran(None, f"stuck for {self._patience:.0f} s: {' <- '.join(trace[:6])}")

    def _started(self) -> Any:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        arguments = (theirs, self._function, self._folder.name)
        process = context.Process(target=_serve, args=arguments, daemon=True)
        process.start()
        theirs.close()
        self._pipe.recv()  # starting takes its own time
        return process

    def end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None

    def __enter__(self) -> "Watched":
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        self._folder.cleanup()


def _serve(pipe: Any, function: Callable[..., Any], folder: str) -> None:
    with open(f"{folder}/trace", "w") as trace, open(f"{folder}/printed", "w+b") as printed:
        faulthandler.register(signal.SIGUSR1, file=trace)
        os.dup2(printed.fileno(), 2)
        # As the command line has it, but for how fast what it compiles is: thousands of cases
        # compile, and few run it twice. The next process finds what this one has compiled.
        os.environ["XDG_CACHE_HOME"] = folder
        start_jax(keep_compiled=True)
        peaks()
        pipe.send("ready")
        while True:
            try:
                arguments = pipe.recv()
            except EOFError:
                return
            began = time.process_time()
            result = function(*arguments)
            seconds, memory = time.process_time() - began, peaks()
            printed.seek(0)
            said = printed.read().decode(errors="replace")
            printed.truncate(0)
            pipe.send((result, "", said, seconds, memory, _at_rest()))


def _at_rest() -> float:
    """Bytes that this process holds once what it has freed is given back."""
    import psutil  # which POSIX alone has in parts

    with contextlib.suppress(AttributeError):  # another C library than GNU's
        ctypes.CDLL(None).malloc_trim(0)
    return psutil.Process().memory_info().rss


def _seconds(pid: int) -> float:
    """Seconds of the processor that a process has used so far; infinite once it has gone."""
    import psutil

    try:
        return sum(psutil.Process(pid).cpu_times()[:2])
    except psutil.NoSuchProcess:
        return float("inf")


def peaks() -> float:
    """Most bytes that this process or the one that reads for it has held since this was asked."""
    readers = [reader.process.pid for reader in child_process._readers]
    most = [0.0]
    for pid in ("self", *readers):
        with contextlib.suppress(OSError):
            lines = Path(f"/proc/{pid}/status").read_text().splitlines()
            # In bytes (Linux); the next peak is counted from here.
            Path(f"/proc/{pid}/clear_refs").write_text("5")
            most += [1024.0 * int(line.split()[1]) for line in lines if line.startswith("VmHWM")]
    return max(most)

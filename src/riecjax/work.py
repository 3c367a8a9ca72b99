"""What a computation takes, said before it starts: seconds, and bytes at its peak, from counts.

Code that may run long counts what it is about to do and calls [`expect`][]. That refuses what the
memory cannot hold, and tells whoever is [`listening`][]: the command line does, engines print
nothing. Seconds are of the machine that the constants were measured on; how far forecasts are off
is measured by `python -m benchmarks.forecasts`.
"""

import contextlib
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import NamedTuple

LONG = 10.0
"""Seconds past which a computation is announced."""
LARGE = 2e9
"""Bytes past which it is."""
CONTROL_GROUP = Path("/sys/fs/cgroup")
MEMORY = Path("/proc/meminfo")


class Work(NamedTuple):
    """What a computation takes.

    **Fields:** `seconds`; `bytes`, at its peak, beside what the process holds already.
    """

    seconds: float = 0.0
    bytes: float = 0.0

    @property
    def is_much(self) -> bool:
        """Whether somebody who waits for it wants to know beforehand."""
        return self.seconds > LONG or self.bytes > LARGE

    @property
    def words(self) -> str:
        """As in "about 40 s and 2.1 GB of memory"."""
        memory = f" and {in_gigabytes(self.bytes)} of memory" if self.bytes > LARGE / 10 else ""
        return f"about {in_time(self.seconds)}{memory}"


def in_time(seconds: float) -> str:
    """Seconds in two digits, in the unit that suits."""
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{float(f'{seconds / size:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"


def in_gigabytes(size: float) -> str:
    """Bytes in two digits."""
    return f"{float(f'{size / 1e9:.2g}'):g} GB"


Listener = Callable[[str, Work], None]
_listeners: ContextVar[tuple[Listener, ...]] = ContextVar("listeners", default=())


@contextlib.contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Have `listener` called with the words and the work of each computation that is expected."""
    before = _listeners.set((*_listeners.get(), listener))
    try:
        yield
    finally:
        _listeners.reset(before)


def expect(what: str, work: Work, remedy: str = "") -> None:
    """Say what is about to be done, as in "reading drive.csv", and what that takes.

    **Raises:** `MemoryError` with these numbers and the remedy if so much memory is not free.
    """
    free = free_memory()
    if work.bytes > free:
        raise MemoryError(
            f"{what} takes about {in_gigabytes(work.bytes)} of memory, and "
            f"{in_gigabytes(free)} are free. {remedy}".strip()
        )
    for listener in _listeners.get():
        listener(what, work)


def free_memory() -> float:
    """Bytes that this process may still ask for; infinite where the system does not tell."""
    return min(_free_of_machine(), _free_of_group())


def _free_of_machine() -> float:
    with contextlib.suppress(OSError, ValueError, IndexError):
        lines = MEMORY.read_text(encoding="utf-8").splitlines()
        kilobytes = [line.split()[1] for line in lines if line.startswith("MemAvailable:")]
        return 1024.0 * int(kilobytes[0])
    return float("inf")


def _free_of_group() -> float:
    """What a container's limit leaves, which the machine's free memory does not know of."""
    with contextlib.suppress(OSError, ValueError):
        limit, used = (
            int((CONTROL_GROUP / f"memory.{name}").read_text(encoding="utf-8"))
            for name in ("max", "current")
        )
        # Of what is used, cached files give way.
        statistics = (CONTROL_GROUP / "memory.stat").read_text(encoding="utf-8").splitlines()
        cached = [int(line.split()[1]) for line in statistics if line.startswith("inactive_file ")]
        return float(limit - used + sum(cached))
    return float("inf")

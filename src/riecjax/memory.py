"""Memory that a computation takes, counted before it starts and refused where it is not free."""

import contextlib
from pathlib import Path

REMEDY = "Use a part of the record (--from, --to), every n-th sample (--every), or fewer windows."
CONTROL_GROUP = Path("/sys/fs/cgroup")
MEMORY = Path("/proc/meminfo")


def in_gigabytes(size: float) -> str:
    """Bytes in two digits."""
    return f"{float(f'{size / 1e9:.2g}'):g} GB"


def require_memory(what: str, size: float, remedy: str = "") -> None:
    """Refuse what is about to be done, as in "reading drive.csv", where memory does not hold it.

    **Arguments:** `size`, bytes at its peak, beside what the process holds already.

    **Raises:** `MemoryError` with both numbers and the remedy.
    """
    free = free_memory()
    if size > free:
        raise MemoryError(
            f"{what} takes about {in_gigabytes(size)} of memory, and "
            f"{in_gigabytes(free)} are free. {remedy}".strip()
        )


def free_memory() -> float:
    """Bytes that this process may still ask for; infinite where the system does not tell."""
    free = [float("inf")]
    with contextlib.suppress(OSError, ValueError, IndexError):
        lines = MEMORY.read_text(encoding="utf-8").splitlines()
        kilobytes = [line.split()[1] for line in lines if line.startswith("MemAvailable:")]
        free.append(1024.0 * int(kilobytes[0]))
    # What a container's limit leaves, which the machine's free memory does not know of.
    with contextlib.suppress(OSError, ValueError):
        limit, used = (
            int((CONTROL_GROUP / f"memory.{name}").read_text(encoding="utf-8"))
            for name in ("max", "current")
        )
        # Of what is used, cached files give way.
        statistics = (CONTROL_GROUP / "memory.stat").read_text(encoding="utf-8").splitlines()
        cached = [int(line.split()[1]) for line in statistics if line.startswith("inactive_file ")]
        free.append(float(limit - used + sum(cached)))
    return min(free)

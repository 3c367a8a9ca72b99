"""What a process runs in: the memory that is free, and JAX's global settings.

No import makes these settings: the command line does, or whoever asks for it. Memory that a
computation takes is counted before it starts, and refused where it is not free.
"""

import contextlib
import os
import platform
import zlib
from pathlib import Path

REMEDY = "Use a part of the record (--from, --to), every n-th sample (--every), or fewer windows."
CONTROL_GROUP = Path("/sys/fs/cgroup")
MEMORY = Path("/proc/meminfo")
SMALL_LOOP_BYTES = 10**6
"""Loops that touch less memory than this in a turn are compiled whole; XLA's own limit is 1024."""
CACHE_BYTES = 2**28
"""Size that what JAX has compiled may grow to on disk."""
WORTH_KEEPING = 0.2
"""Seconds of compiling from which on that is kept for other processes."""
COLLECT_AFTER = 100_000
"""New objects after which Python looks for cycles: tracing makes many, and hardly any cycle."""
_SMALL_LOOPS = "xla_cpu_small_while_loop_byte_threshold"
_FLAGS = {
    # XLA's Fourier transforms wait for threads of the pool that they run on, so that two at once
    # may wait for each other for ever on a machine of two cores.
    "xla_cpu_multi_thread_eigen": "--xla_cpu_multi_thread_eigen=false",
    # A step of a simulation is some dozens of additions. One kernel after the other, starting each
    # takes longer than the additions do.
    _SMALL_LOOPS: f"--xla_backend_extra_options={_SMALL_LOOPS}={SMALL_LOOP_BYTES}",
}


def start_jax(*, keep_compiled: bool = False, devices: int = 1) -> None:
    """Turn on 64-bit, and compile loops over samples whole on a CPU; call before the first array.

    Simulations are then two to six times as fast. What is already in `XLA_FLAGS` stays as it is.

    **Arguments:** `keep_compiled`: keep what is compiled, of simulations and refinements, in
    `~/.cache/riecjax` (or below `XDG_CACHE_HOME`) for other processes, unless
    `JAX_COMPILATION_CACHE_DIR` names another place; `devices`, how many the CPU is to count as, on
    all of which repetitions over random keys then run side by side.

    **Raises:** `RuntimeError` if JAX has started, and would no longer see these settings.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    flags = os.environ.get("XLA_FLAGS", "")
    lacking = [flag for name, flag in _FLAGS.items() if name not in flags]
    import jax

    if lacking or devices > 1:
        try:
            # JAX refuses this once it has started.
            most = max(devices, jax.config.values["jax_num_cpu_devices"])
            jax.config.update("jax_num_cpu_devices", most)
        except RuntimeError:
            if lacking:
                raise RuntimeError(
                    "start_jax() is too late: call it before the first JAX array is made."
                ) from None
    os.environ["XLA_FLAGS"] = " ".join([flags, *lacking]).strip()
    jax.config.update("jax_enable_x64", True)
    if not keep_compiled or os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return
    with contextlib.suppress(OSError, RuntimeError):  # the latter where there is no home
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        # Earlier versions kept other files, in folders with other endings.
        folder = Path(base) / "riecjax" / f"{processor()}-jax"
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            jax.config.update("jax_compilation_cache_dir", str(folder))
            jax.config.update("jax_compilation_cache_max_size", CACHE_BYTES)
            jax.config.update("jax_persistent_cache_min_compile_time_secs", WORTH_KEEPING)


def compiles_loops_whole() -> bool:
    """Whether XLA was told to make one kernel of a whole loop, see [`start_jax`][]."""
    return _SMALL_LOOPS in os.environ.get("XLA_FLAGS", "")


def processor() -> str:
    """A name for what compiled code may run on: homes are shared between machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        abilities = platform.processor()  # its kind, which is all that Windows and macOS tell
    else:
        told = {line for line in lines if line.startswith(("flags", "Features"))}
        abilities = "".join(sorted(told))
    return f"{platform.machine()}-{zlib.crc32(abilities.encode()):08x}"


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

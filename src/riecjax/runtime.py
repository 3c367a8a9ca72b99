"""JAX's global settings, which no import makes: the command line does, or whoever asks for it."""

import contextlib
import ctypes
import gc
import os
import platform
import sys
import zlib
from importlib import metadata
from pathlib import Path

from riecjax.whole_files import Store

SMALL_LOOP_BYTES = 10**6
"""Loops that touch less memory than this in a turn are compiled whole; XLA's own limit is 1024."""
CACHE_BYTES = 2**28
"""Size that kept programs may grow to, and JAX's own compilations beside them."""
COLLECT_AFTER = 100_000
"""New objects after which Python looks for cycles: tracing makes many, and hardly any cycle."""
_programs_folder: Path | None = None
_SMALL_LOOPS = "xla_cpu_small_while_loop_byte_threshold"
_FLAGS = {
    # XLA's Fourier transforms wait for threads of the pool that they run on, so that two at once
    # may wait for each other for ever on a machine of two cores.
    "xla_cpu_multi_thread_eigen": "--xla_cpu_multi_thread_eigen=false",
    # A step of a simulation is some dozens of additions. One kernel after the other, starting each
    # takes longer than the additions do.
    _SMALL_LOOPS: f"--xla_backend_extra_options={_SMALL_LOOPS}={SMALL_LOOP_BYTES}",
}
_ONCE = {
    # Of code that runs once, what it takes to make it fast is more than what that saves.
    "xla_backend_optimization_level": "--xla_backend_optimization_level=0",
    # Nor does what compiles in a second or two gain by being cut up for several threads.
    "xla_cpu_parallel_codegen_split_count": "--xla_cpu_parallel_codegen_split_count=1",
}
# XLA ends the process at an option that it does not know: this is gone from that version on.
_GONE = (0, 11)
_BEFORE = {"xla_cpu_use_fusion_emitters": "--xla_cpu_use_fusion_emitters=false"}


def start_jax(*, once: bool = False, keep_compiled: bool = False, devices: int = 1) -> None:
    """Turn on 64-bit, and compile loops over samples whole on a CPU; call before the first array.

    Simulations are then two to six times as fast. What is already in `XLA_FLAGS` stays as it is.

    **Arguments:** `once`: compile three times as fast what then runs slower, for a process that
    calls everything once on little data; `keep_compiled`: keep what is compiled in
    `~/.cache/riecjax` (or below `XDG_CACHE_HOME`) for the next process, which then need not trace
    it again, unless `JAX_COMPILATION_CACHE_DIR` names another place, where JAX keeps what it
    compiles; `devices`, how many the CPU is to count as, on
    all of which repetitions over random keys then run side by side.

    **Raises:** `RuntimeError` if JAX has started, and would no longer see these settings.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    flags = os.environ.get("XLA_FLAGS", "")
    started = False
    if "jax" in sys.modules:
        from jax._src import xla_bridge

        started = xla_bridge.backends_are_initialized()
    wanted = _FLAGS
    # To compile fast is a wish, which a process that has begun otherwise cannot fulfil.
    if once and not started:  # by options that the installed XLA knows
        installed = tuple(int(part) for part in metadata.version("jaxlib").split(".")[:2])
        wanted = _FLAGS | _ONCE | (_BEFORE if installed < _GONE else {})
    lacking = [flag for name, flag in wanted.items() if name not in flags]
    if lacking and started:
        raise RuntimeError("start_jax() is too late: call it before the first JAX array is made.")
    os.environ["XLA_FLAGS"] = " ".join([flags, *lacking]).strip()
    import jax

    jax.config.update("jax_enable_x64", True)
    if devices > 1 and not started:
        jax.config.update("jax_num_cpu_devices", devices)
    if keep_compiled and not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        _keep_compiled()


def collect_seldom() -> None:
    """Look for cycles of objects less often, in a process that is this package's own."""
    gc.set_threshold(COLLECT_AFTER)


def release_memory() -> None:
    """Give back to the system what is free, which allocators keep in pieces between what is not.

    For a process that works through large arrays for weeks: it takes about 0.1 s.
    """
    import pyarrow

    gc.collect()
    pyarrow.default_memory_pool().release_unused()
    # Of glibc; other C libraries have none.
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def compiles_loops_whole() -> bool:
    """Whether XLA was told to make one kernel of a whole loop, see [`start_jax`][]."""
    return _SMALL_LOOPS in os.environ.get("XLA_FLAGS", "")


def _keep_compiled() -> None:
    import jax
    from jax._src import compilation_cache

    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        # Earlier versions, whose files begin with a checksum, kept them under another suffix.
        folder = Path(base) / "riecjax" / f"{processor()}-programs"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # the latter where there is no home
        return
    if not os.access(folder, os.W_OK):
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_compilation_cache_max_size", CACHE_BYTES)
    # Small functions too: there are many of them.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    # JAX's files are neither written whole nor checked: what a process that was killed left half
    # written it would warn of for ever.
    others = compilation_cache.get_file_cache
    kept = Store(folder, ".compiled", CACHE_BYTES)
    compilation_cache.get_file_cache = lambda path: (
        (kept, path) if path == str(folder) else others(path)
    )
    global _programs_folder
    _programs_folder = folder


def programs_folder() -> Path | None:
    """Where this process keeps what it has compiled, without JAX's help; `None` for nowhere."""
    return _programs_folder


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

"""Settings and data for all tests."""

import gc
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from riecjax.runtime import start_jax

# What one worker or one process of the command line has compiled, no other compiles again. The
# first process to come here makes the folder; those that it starts find its name.
COMPILED = None
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    COMPILED = tempfile.mkdtemp(prefix="riecjax-tests-")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = COMPILED
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.2"

# As the command line does.
start_jax()

import jax  # noqa: E402
import pytest  # noqa: E402

# A shape that is stretched by accident is a bug; every stretch in the code is spelled out.
jax.config.update("jax_numpy_rank_promotion", "raise")


def pytest_unconfigure() -> None:
    if COMPILED is not None:
        shutil.rmtree(COMPILED, ignore_errors=True)


MOST_MAPS = 20_000
"""Memory maps of a process past which compiled functions are forgotten; Linux allows 65530."""


@pytest.fixture(autouse=True)
def forget_compiled_functions() -> Iterator[None]:
    """Every function that XLA compiles keeps memory maps; a whole suite of them runs out."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        gc.collect()


def measured_data(folder: str) -> Path:
    """The folder of one measured recording; skips the test, with the reason, where it is absent."""
    root = Path(os.environ.get("RIECJAX_DATA", Path(__file__).parents[2] / "shared" / "data"))
    found = root / folder
    if not found.is_dir():
        pytest.skip(f"measured data '{folder}' is not here; set RIECJAX_DATA to its parent folder")
    return found

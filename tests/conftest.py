"""Settings and data for all tests."""

import os
from pathlib import Path

# As the command line does (see `riecjax.cli.runtime`); it must stand before JAX is imported.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import jax
import pytest

jax.config.update("jax_enable_x64", True)
# A shape that is stretched by accident is a bug; every stretch in the code is spelled out.
jax.config.update("jax_numpy_rank_promotion", "raise")


def measured_data(folder: str) -> Path:
    """The folder of one measured recording; skips the test, with the reason, where it is absent."""
    root = Path(os.environ.get("RIECJAX_DATA", Path(__file__).parents[2] / "shared" / "data"))
    found = root / folder
    if not found.is_dir():
        pytest.skip(f"measured data '{folder}' is not here; set RIECJAX_DATA to its parent folder")
    return found

"""Repetition over keys: chunks change the work, never the numbers."""

import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.studies import over_keys

KEY = jax.random.key(42)
TRACES = []


def draw(key, scale=1.0):
    values = scale * jax.random.normal(key, (3,))
    return {"values": values, "sum": jnp.sum(values), "positive": values[0] > 0}


def counted(key, scale):
    TRACES.append(1)
    return scale * jax.random.normal(key)


def assert_equal_trees(found, expected):
    jax.tree.map(np.testing.assert_array_equal, found, expected)


@pytest.mark.parametrize("chunk", [1, 3, 100])
def test_results_do_not_depend_on_the_chunk(chunk):
    whole = over_keys(draw, KEY, 7, chunk=7)
    assert whole["values"].shape == (7, 3)
    finished: list[int] = []
    found = over_keys(draw, KEY, 7, chunk=chunk, progress=finished.append)
    assert_equal_trees(found, whole)
    assert finished[-1] == 7
    # More repetitions extend a study, each the experiment with its folded key.
    longer = over_keys(draw, KEY, 20, chunk=chunk)
    assert_equal_trees(found, jax.tree.map(lambda leaf: leaf[:7], longer))
    alone = draw(jax.random.fold_in(KEY, 5))
    np.testing.assert_allclose(found["values"][5], alone["values"], rtol=1e-12)


def test_all_chunks_and_further_studies_share_one_compilation():
    TRACES.clear()
    over_keys(counted, KEY, 10, jnp.array(1.0), chunk=4)
    over_keys(counted, jax.random.key(1), 6, jnp.array(2.0), chunk=4)
    assert len(TRACES) == 1


ON_SEVERAL = """
import sys
from riecjax.runtime import start_jax
start_jax(devices=2)
import jax, numpy as np
assert jax.local_device_count() == 2
from tests.studies.test_monte_carlo import KEY, draw
from riecjax.studies import over_keys
for chunk in (1, 4, 5):
    found = over_keys(draw, KEY, 9, 2.0, chunk=chunk)
    np.savez(f"{sys.argv[1]}/{chunk}.npz", **found)
placed = over_keys(draw, KEY, 4, 2.0, chunk=4)["values"]
print(len(placed.sharding.device_set))
"""


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_devices(tmp_path):
    run = subprocess.run(
        [sys.executable, "-c", ON_SEVERAL, str(tmp_path)],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=True,
    )
    expected = over_keys(draw, KEY, 9, 2.0)
    for chunk in (1, 4, 5):
        found = np.load(tmp_path / f"{chunk}.npz")
        assert_equal_trees({name: found[name] for name in expected}, expected)
    assert run.stdout.split() == ["2"]

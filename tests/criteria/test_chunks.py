"""Long records in chunks give what they give whole, and with the precision of 64 and 32 bits."""

import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import MACHINES, Shape

import riecjax as rx
from conftest import in_32_bit
from nightly import nightly
from riecjax.summaries.one_pass import stage_normal_equations

EQUATION = rx.Equation(rx.Term("m", "dx", derivative=1), rx.Term("k", "x"), -rx.Term(1.0, "u"))
STEP = 0.01


def arrays_of(n, offset=0.0):
    signals = MACHINES["linear"].signals(shape=Shape(n, 100))
    error = np.random.default_rng(0).normal(size=n)
    return {"x": signals["x"] + offset, "dx": signals["dx"], "u": signals["u"] + error}


@pytest.mark.parametrize(
    "weight", [rx.Boxcar(), rx.Boxcar(8), rx.Hat(6), rx.Bump(4, lengths=3)], ids=str
)
@pytest.mark.parametrize("traced", [False, *nightly([True])])
@pytest.mark.parametrize("gaps", [0, 5])
def test_chunks_add_up_to_the_whole(weight, gaps, traced, monkeypatch):
    arrays = arrays_of(5000)
    arrays["u"][np.random.default_rng(1).integers(0, 5000, gaps)] = np.nan
    record = rx.Record.from_samples(arrays, time_step=STEP)
    windows = rx.AllWindows(0.1, 0.9).fitted([record])
    criterion = rx.RIEC(windows, weight)
    (whole,) = stage_normal_equations(rx.staged(EQUATION), record, criterion, None)
    monkeypatch.setattr("riecjax.criteria.windows.WHOLE", 700)
    monkeypatch.setattr("riecjax.criteria.windows.CHUNK", 700)
    monkeypatch.setattr("riecjax.summaries.one_pass.CHUNK", 700)
    sums = eqx.filter_jit(stage_normal_equations) if traced else stage_normal_equations
    (pieces,) = sums(rx.staged(EQUATION), record, criterion, None)
    np.testing.assert_allclose(pieces.count, whole.count, rtol=1e-14)
    scale = np.sqrt(np.einsum("bii->bi", whole.moments))
    error = (pieces.moments - whole.moments) / (scale[:, :, None] * scale[:, None, :] + 1e-300)
    assert np.abs(error).max() < 1e-10
    jax.clear_caches()


@pytest.mark.slow
def test_a_million_samples_in_32_bit_agree_with_64_bit():
    arrays = arrays_of(10**6, offset=1.5)
    criterion = rx.RIEC(rx.AllWindows(0.05, 0.5, longest_samples=64))
    exact = rx.identify(EQUATION, rx.Record(arrays, STEP), criterion)
    with in_32_bit():
        record = rx.Record({n: v.astype(np.float32) for n, v in arrays.items()}, np.float32(STEP))
        single = eqx.filter_jit(rx.identify)(EQUATION, record, criterion)
        assert single.theta.dtype == jnp.float32
    # An offset of five deviations; eps is 6e-8.
    np.testing.assert_allclose(np.asarray(single.theta, float), exact.theta, rtol=2e-5)
    # Leaving out a block moves an estimate by less than eps; the change itself is solved for.
    errors = np.asarray(single.standard_errors)
    np.testing.assert_allclose(errors, exact.standard_errors, rtol=5e-3)


def test_a_long_record_equals_its_running_sums_in_exact_arithmetic():
    """2^18 samples of whole numbers: every sum is exact in 64-bit integers."""
    rng = np.random.default_rng(0)
    n = 2**18
    walk = np.cumsum(rng.integers(-3, 4, n))
    other = rng.integers(-50, 50, n)
    record = rx.Record({"x": walk.astype(float), "y": other.astype(float)}, 1.0)
    equation = rx.Equation(rx.Term("a", "x", derivative=1), -rx.Term(1.0, "y", derivative=1))
    criterion = rx.RIEC(rx.AllWindows(5.0, 20.0, longest_samples=32))
    (found,) = stage_normal_equations(rx.staged(equation), record, criterion, None)
    expected = np.zeros((2, 2), np.int64)
    for lag in range(5, 21):
        rows = np.stack([other[lag:] - other[:-lag], walk[lag:] - walk[:-lag]])
        expected += rows @ rows.T
    np.testing.assert_allclose(found.total().moments, expected, rtol=1e-12)


OF_A_LONG_RECORD = """
import resource
import numpy as np
import riecjax as rx

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

rng = np.random.default_rng(0)
record = rx.Record({f"s{i}": rng.normal(size=10**6) for i in range(8)}, 1e-3)
terms = [rx.Term(f"p{i}", f"s{i}") for i in range(7)]
equation, before = rx.Equation(*terms, -rx.Term(1.0, "s7")), peak()
rx.identify(equation, record, rx.RIEC(rx.AllWindows(0.02, 0.2)))
print(peak() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory is in kilobytes on Linux")
def test_a_long_record_takes_little_memory_beside_itself():
    """Eight signals of a million samples are 64 MB; what is made of them is made by chunks."""
    command = [sys.executable, "-c", OF_A_LONG_RECORD]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert float(done.stdout) < 300

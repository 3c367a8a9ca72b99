"""Long records in chunks give what they give whole, and with the precision of 64 and 32 bits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.criteria import chunks
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.test_functions import Boxcar, Bump, Hat
from riecjax.criteria.windows import AllWindows
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import staged
from riecjax.equations.term import Term
from riecjax.estimation.identify import identify
from riecjax.records.record import Record
from riecjax.summaries.stage_sums import stage_normal_equations

EQUATION = Equation(Term("m", "v", derivative=1), Term("k", lambda s: s["x"]), -Term(1.0, "u"))
STEP = 0.01


def arrays_of(n, offset=0.0, seed=0):
    """A random motion whose running integral wanders, in closed form between its derivatives."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(n)
    x, v, a = np.full(n, offset), np.zeros(n), np.zeros(n)
    for w in rng.uniform(0.01, 12, 12):
        phase, size = w * t + rng.uniform(0, 6.28), rng.normal()
        x += size * np.sin(phase)
        v += size * w * np.cos(phase)
        a -= size * w**2 * np.sin(phase)
    return {"x": x, "v": v, "u": 2.0 * a + 30.0 * x + rng.normal(size=n)}


@pytest.mark.parametrize("weight", [Boxcar(), Boxcar(8), Hat(6), Bump(4, lengths=3)], ids=str)
@pytest.mark.parametrize("gaps", [0, 5])
def test_chunks_add_up_to_the_whole(weight, gaps, monkeypatch):
    arrays = arrays_of(5000)
    arrays["u"][np.random.default_rng(1).integers(0, 5000, gaps)] = np.nan
    record = Record.from_samples(arrays, time_step=STEP)
    windows = AllWindows(0.1, 0.9).fitted([record])
    criterion = RIEC(windows, weight)
    (whole,) = stage_normal_equations(staged(EQUATION), record, criterion, None)
    monkeypatch.setattr(chunks, "WHOLE", 700)
    monkeypatch.setattr(chunks, "CHUNK", 700)
    jax.clear_caches()
    assert windows.in_chunks(record)
    (pieces,) = stage_normal_equations(staged(EQUATION), record, criterion, None)
    np.testing.assert_array_equal(pieces.count, whole.count)
    scale = np.sqrt(np.einsum("bii->bi", whole.moments))
    error = (pieces.moments - whole.moments) / (scale[:, :, None] * scale[:, None, :] + 1e-300)
    assert np.abs(error).max() < 1e-10
    jax.clear_caches()


@pytest.mark.slow
def test_a_million_samples_in_32_bit_agree_with_64_bit():
    arrays = arrays_of(10**6, offset=5.0)
    criterion = RIEC(AllWindows(0.05, 0.5, longest_samples=64))
    exact = identify(EQUATION, Record(arrays, STEP), criterion)
    with jax.enable_x64(False):
        record = Record({n: v.astype(np.float32) for n, v in arrays.items()}, np.float32(STEP))
        single = identify(EQUATION, record, criterion)
        assert single.theta.dtype == jnp.float32
    # An offset of five amplitudes; eps is 6e-8.
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
    record = Record({"x": walk.astype(float), "y": other.astype(float)}, 1.0)
    equation = Equation(Term("a", "x", derivative=1), -Term(1.0, "y", derivative=1))
    criterion = RIEC(AllWindows(5.0, 20.0, longest_samples=32))
    (found,) = stage_normal_equations(staged(equation), record, criterion, None)
    expected = np.zeros((2, 2), np.int64)
    for lag in range(5, 21):
        rows = np.stack([other[lag:] - other[:-lag], walk[lag:] - walk[:-lag]])
        expected += rows @ rows.T
    np.testing.assert_allclose(found.total().moments, expected, rtol=1e-12)

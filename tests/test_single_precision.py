import contextlib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from conftest import in_32_bit
from nightly import nightly
from riecjax.criteria.windows import WindowSet

STEP = 0.005


def shaken_under_weight():
    """u = m v' + k x + W exactly, where the weight W is some twenty times what u has beside it."""
    t = STEP * np.arange(8000)
    parts = ((1.0, 8.0, 0.3), (0.5, 13.0, 1.1))
    x = sum(a * np.sin(w * t + p) for a, w, p in parts)
    v = sum(a * w * np.cos(w * t + p) for a, w, p in parts)
    acceleration = sum(-a * w**2 * np.sin(w * t + p) for a, w, p in parts)
    return {"x": x, "v": v, "a": acceleration, "u": 3.0 * acceleration + 20.0 * x + 1e4}


def unity(signals):
    return jnp.ones_like(signals["x"])


def weight_equation():
    return rx.Equation(
        rx.Term(1.0, "u"),
        -rx.Term("m", "v", derivative=1, measured=("a",)),
        -rx.Term("k", "x"),
        -rx.Term("W", unity),
    )


class SameWindows(rx.RandomWindows):
    """Windows drawn by NumPy: one JAX key draws others in 32-bit than in 64-bit."""

    def draw(self, key, record, multiple=1):
        rng = np.random.default_rng(0)
        lag = rng.integers(round(0.05 / STEP), round(0.5 / STEP) + 1, self.count)
        share = rng.integers(0, 2**20, self.count)
        start = (jnp.asarray(share, jnp.int32) % (record.sample_count - lag)).astype(jnp.int32)
        return WindowSet(jnp.asarray(start, jnp.int32), jnp.asarray(start + lag, jnp.int32))


def riec():
    return rx.RIEC(SameWindows(np.array(0.05), np.array(0.5), 8000, between_samples=False))


def identified(equation, record, criterion, key):
    return rx.identify(equation, record, criterion, key=key, intervals=rx.Naive())


traced = eqx.filter_jit(identified)


@pytest.mark.raises_finding("single_precision")
@pytest.mark.parametrize("criterion", [riec, *nightly([rx.DOLS])])
def test_32_bit_is_close_to_64_bit_and_says_that_it_is_32_bit(criterion):
    found, codes = {}, {}
    for bits in (64, 32):
        with in_32_bit() if bits == 32 else contextlib.nullcontext():
            record = rx.Record.from_samples(shaken_under_weight(), time_step=STEP)
            asked = (weight_equation(), record, criterion(), jax.random.key(1))
            fit = traced(*asked)
            # Eagerly everything is in double precision.
            eager = identified(*asked)
        assert fit.theta.dtype == np.dtype(f"float{bits}")
        assert eager.theta.dtype == np.float64
        assert "single_precision" not in [finding.code for finding in eager.findings()]
        found[bits] = np.asarray(fit.theta, float)
        codes[bits] = [finding.code for finding in fit.findings()]
    # 32-bit holds u to 5e-4 beside 1e4, which is 2.5e-5 of the spring's force of 20, times a
    # condition number of 5.
    np.testing.assert_allclose(found[32], found[64], rtol=3e-4)
    assert "single_precision" in codes[32]
    assert "single_precision" not in codes[64]


MANY = 120_000
"""Samples, of which there are up to 7e9 windows."""


def samples_of_many(gap):
    rng = np.random.default_rng(0)
    a, b, error = rng.normal(size=(3, MANY))
    u = 2.0 * a + 3.0 * b + 0.5 * error
    if gap is not None:
        a[gap] = np.nan
    return {"a": a, "b": b, "u": u}


# The first number of windows rounds down in 32-bit, by which no window is left out.
@pytest.mark.parametrize(
    ("weight", "longest", "gap"),
    [
        (rx.Boxcar(), 47_003, None),
        *nightly([(rx.Hat(), 60_000, None), (rx.Boxcar(), 60_000, MANY // 2)]),
    ],
)
def test_more_windows_than_32_bit_integers_hold_are_counted(weight, longest, gap):
    multiple = weight.length_multiple
    lengths = np.arange(multiple, longest + 1, multiple, dtype=np.int64)
    runs = [MANY] if gap is None else [gap, MANY - 1 - gap]
    expected = sum(int(np.sum(np.maximum(run - lengths, 0))) for run in runs)
    equation = rx.Equation(rx.Term("p", "a"), rx.Term("q", "b"), -rx.Term(1.0, "u"))
    criterion = rx.RIEC(rx.AllWindows(1e-3, 1e-3 * longest), weight)
    found = {}
    for bits in (64, 32):
        with in_32_bit() if bits == 32 else contextlib.nullcontext():
            record = rx.Record.from_samples(samples_of_many(gap), time_step=1e-3)
            found[bits] = rx.identify(equation, record, criterion, intervals=rx.Naive())
        assert float(found[bits].stages[0].count) == pytest.approx(expected, rel=1e-6)
        codes = [finding.code for finding in found[bits].findings()]
        assert ("rows_left_out" in codes) == (gap is not None)
    np.testing.assert_allclose(found[32].naive, found[64].naive, rtol=2e-2)

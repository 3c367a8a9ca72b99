import equinox as eqx
import jax
import numpy as np
import pytest

import riecjax as rx


def trapezoid(samples, start, stop):
    """Integral of the polygon through the samples, in sample units, by brute force."""
    inner = np.arange(np.ceil(start), np.floor(stop) + 1)
    at = np.unique(np.concatenate([[start], inner, [stop]]))
    return np.trapezoid(np.interp(at, np.arange(samples.size), samples), at)


EQUATION = rx.Equation(
    rx.Term(1.0, "u"),
    -rx.Term("m", "x", derivative=2, measured=("v", "a")),
    -rx.Term("d", "v"),
    -rx.Terms("k", rx.Polynomial((1, 3)), of="x"),
)


def oscillator_record(count=200):
    rng = np.random.default_rng(3)
    signals = {name: rng.normal(size=count) for name in ("u", "x", "v", "a")}
    return rx.Record.from_samples(signals, time_step=0.01), signals


def test_dols_takes_the_equation_at_every_sample():
    record, s = oscillator_record()
    rows = rx.DOLS().rows(EQUATION, record)
    np.testing.assert_allclose(rows.target, -s["u"], rtol=1e-15)
    expected = -np.stack([s["a"], s["v"], s["x"], s["x"] ** 3], axis=1)
    np.testing.assert_allclose(rows.regressors, expected, rtol=1e-14)
    assert rows.parameters == ("m", "d", "k_1", "k_3")
    assert not rx.DOLS().needs_key


@pytest.mark.parametrize("between_samples", [False, True])
def test_riec_takes_the_integral_of_every_term_over_every_window(between_samples):
    record, s = oscillator_record()
    windows = rx.RandomWindows(0.05, 0.3, 50, between_samples=between_samples)
    key = jax.random.key(5)
    rows = eqx.filter_jit(rx.RIEC(windows, rx.Boxcar(2)).rows)(EQUATION, record, key)
    drawn = windows.draw(key, record)
    at = np.arange(200.0)
    for i, (a, b) in enumerate(zip(np.asarray(drawn.start), np.asarray(drawn.stop))):
        rise = np.diff(np.interp([a, b], at, s["v"]))[0]
        integrals = [0.01 * trapezoid(y, a, b) for y in (s["v"], s["x"], s["x"] ** 3)]
        expected = -np.array([rise, *integrals])
        np.testing.assert_allclose(rows.regressors[i], expected, rtol=0, atol=1e-13)
        np.testing.assert_allclose(rows.target[i], -0.01 * trapezoid(s["u"], a, b), atol=1e-13)
    # Compiled as a whole, a product and a sum may round once instead of twice.
    np.testing.assert_allclose(rows.position, drawn.start, rtol=1e-14)

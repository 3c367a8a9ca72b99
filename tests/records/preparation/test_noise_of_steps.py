"""What a step says of a signal's noise, against what it makes of white noise."""

import numpy as np
import pytest

import riecjax as rx
from riecjax.records.preparation.resampling import on_grid, resampled_taps, spline_taps, upsample

STEP = 0.01
LEVEL = 0.3
SAMPLES = 400_000


def noisy(samples: int = SAMPLES) -> rx.Record:
    """A record of nothing but white noise, of which that is known."""
    white = LEVEL * np.random.default_rng(7).normal(size=samples)
    return rx.Record({"x": white}, STEP).with_noise(rx.Noise.given({"x": LEVEL}))


def expected(noise: rx.Noise, one: str, other: str, lag: int) -> float:
    """Covariance of `one` with `other` so many samples before, by the definition of kernels."""
    total = 0.0
    for source in noise.kernels[one].keys() & noise.kernels[other].keys():
        first, second = (np.asarray(noise.kernels[n][source]) for n in (one, other))
        width = first.size + second.size + 2 * abs(lag) + 2
        a, b = np.zeros(2 * width + 1), np.zeros(2 * width + 1)
        a[width - first.size // 2 :][: first.size] = first
        b[width - second.size // 2 + lag :][: second.size] = second
        total += float(a @ b)
    return total


def found(record: rx.Record, one: str, other: str, lag: int) -> float:
    a, b = np.asarray(record[one]), np.asarray(record[other])
    return float(np.mean(a[lag:] * b[: b.size - lag]))


STEPS = {
    "low_pass": lambda r: rx.low_pass(r, {"x": 11.0}),
    "remove_drift": lambda r: rx.remove_drift(r, "x"),
    "decimate": lambda r: rx.resample(r, 25.0),
    "resample down": lambda r: rx.resample(r, 61.7),
    "upsample": lambda r: upsample(r.part(0, 80_000), 3),
    "low_pass, decimate": lambda r: rx.resample(rx.low_pass(r, {"x": 20.0}), 50.0),
    "low_pass, every third": lambda r: rx.low_pass(r, {"x": 8.0}).every(3),
}


@pytest.mark.parametrize("step", STEPS)
def test_autocovariance_after_a_step(step):
    record = STEPS[step](noisy())
    variance = expected(record.noise, "x", "x", 0)
    assert variance == pytest.approx(float(record.noise.std("x")) ** 2)
    # Products of band-limited noise scatter by sqrt(2 / n) times a few, 0.5 to 1 %.
    for lag in (0, 1, 2, 5, 9):
        theory = expected(record.noise, "x", "x", lag)
        assert found(record, "x", "x", lag) == pytest.approx(theory, abs=0.015 * variance)


def test_a_derivative_shares_its_source():
    record = rx.differentiate(rx.low_pass(noisy(), {"x": 15.0}), "x", "v")
    assert set(record.noise.kernels["v"]) == {"x"}
    scale = float(record.noise.std("x") * record.noise.std("v"))
    for lag in (0, 1, 2, 5):
        for one, other in (("x", "v"), ("v", "x")):
            theory = expected(record.noise, one, other, lag)
            assert found(record, one, other, lag) == pytest.approx(theory, abs=0.01 * scale)
    np.testing.assert_allclose(
        record.noise.std("v") ** 2, np.var(np.asarray(record["v"])), rtol=0.01
    )


def test_what_is_thinned_keeps_all_covariances():
    taps = {"x": [0.3, 1.0, 0.5, 0.2, 0.7], "v": [-1.0, 0.4, 1.0]}
    noise = rx.Noise({name: {"x": np.array(of)} for name, of in taps.items()}, {"x": np.array(9.0)})
    record = rx.Record({name: np.zeros(20) for name in taps}, STEP).with_noise(noise)
    for count in (1, 2, 3, 7):
        thinned = record.every(count).noise
        for one, other in (("x", "x"), ("x", "v"), ("v", "x"), ("v", "v")):
            for lag in range(4):
                np.testing.assert_allclose(
                    expected(thinned, one, other, lag),
                    expected(noise, one, other, count * lag),
                    atol=1e-14,
                )
        assert set(thinned.freedom) == {s for of in thinned.kernels.values() for s in of}


def test_the_noise_of_a_filtered_signal_is_judged_before_the_filter():
    time = np.arange(4000) * STEP
    rng = np.random.default_rng(1)
    record = rx.Record({"x": np.sin(5 * time) + 0.02 * rng.normal(size=time.size)}, STEP)
    filtered = rx.low_pass(record, {"x": 10.0})
    grid = np.linspace(0, np.pi, 20_001)
    ratio = np.tan(grid[:-1] / 2) / np.tan(0.1 * np.pi)
    gain = 0.02 * np.sqrt(np.mean((1 + ratio**8) ** -2.0))
    assert float(filtered.noise.std("x")) == pytest.approx(gain, rel=0.06)


@pytest.mark.parametrize("rate", [100.0, 91.0, 230.0, 500.0])
@pytest.mark.parametrize("shift", [0.0, 0.3])
def test_channels_on_a_common_grid(rate, shift):
    white = LEVEL * np.random.default_rng(3).normal(size=200_000)
    time = STEP * (np.arange(white.size) + shift)
    marker = STEP * np.arange(white.size) * 1.0
    grid, values, _ = on_grid({"x": (time, white), "m": (marker, 0 * marker)}, rate)
    if rate < 99:
        taps = LEVEL * resampled_taps(np.ones(1), 100.0 / rate)
    else:
        taps = LEVEL * spline_taps((grid - time[0]) / STEP)
    noise = rx.Noise({"x": {"x": taps}})
    record = rx.Record(values, 1 / rate)
    variance = expected(noise, "x", "x", 0)
    for lag in (0, 1, 2, 3, 6):
        theory = expected(noise, "x", "x", lag)
        assert found(record, "x", "x", lag) == pytest.approx(theory, abs=0.012 * variance)

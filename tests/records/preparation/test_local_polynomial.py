"""Derivatives by local polynomials, against SciPy, closed forms and white noise."""

import numpy as np
import pytest
import scipy.signal

from nightly import nightly
from riecjax.records.noise import Noise
from riecjax.records.preparation.filtering import derivative_taps, with_local_derivative
from riecjax.records.record import Record

STEP = 0.01
TIME = np.arange(4000) * STEP
MOTION = np.sin(2 * np.pi * 0.7 * TIME) + 0.4 * np.sin(2 * np.pi * 1.9 * TIME + 1)
SLOPE = (
    2
    * np.pi
    * (0.7 * np.cos(2 * np.pi * 0.7 * TIME) + 0.4 * 1.9 * np.cos(2 * np.pi * 1.9 * TIME + 1))
)


def noisy(level, seed=0):
    white = np.random.default_rng(seed).normal(size=TIME.size)
    return Record({"x": MOTION + level * white}, STEP, units={"x": "m"})


@pytest.mark.parametrize("count", [3, 8, 25])
def test_taps_are_those_of_savitzky_and_golay(count):
    reference = scipy.signal.savgol_coeffs(2 * count + 1, 4, deriv=1, delta=0.02, use="conv")
    np.testing.assert_allclose(derivative_taps(count, 0.02), reference, atol=1e-9)


def test_a_polynomial_of_fourth_order_has_its_slope():
    time = TIME - 20
    record = Record({"x": 3 - time + 0.1 * time**2 - 0.02 * time**3 + 1e-3 * time**4}, STEP)
    found, half_width = with_local_derivative(record, "x", "v", 0.1)
    inner = time[10:-10]
    assert half_width == pytest.approx(0.1)
    np.testing.assert_allclose(found.time, TIME[10:-10])
    slope = -1 + 0.2 * inner - 0.06 * inner**2 + 4e-3 * inner**3
    np.testing.assert_allclose(found["v"], slope, atol=1e-7)


@pytest.mark.parametrize("level", [0.001, 0.01, 0.05])
def test_smoothing_errs_by_little_of_the_noise_that_is_left(level):
    record, half_width = with_local_derivative(noisy(level), "x", "v")
    count = round(half_width / STEP)
    clean = np.convolve(MOTION, derivative_taps(count, STEP), "valid")
    bias = np.sqrt(np.mean((clean - SLOPE[count:-count]) ** 2))
    left = float(record.noise.std("v"))
    # Half widths come in steps of 8 % and of whole samples; the error grows with the fourth power.
    assert 0.01 * left < bias < 0.08 * left
    errors = np.asarray(record["v"]) - SLOPE[count:-count]
    assert np.std(errors) == pytest.approx(left, rel=0.15)
    assert record.noise.kernels["v"].keys() == {"x"}
    assert dict(record.units)["v"] == "m/s"


@pytest.mark.parametrize("count", [1000, *nightly([4000])])
def test_noise_that_stands_out_by_chance_is_not_taken_for_motion(count):
    """Of a thousand frequencies one is likely to; the polynomial then was 3 samples wide."""
    recordings = (noisy(0.05, seed).part(0, count) for seed in range(150))
    widths = [with_local_derivative(one, "x", "v")[1] for one in recordings]
    assert min(widths) > 0.7 * np.median(widths)


def test_without_noise_it_is_as_narrow_as_can_be():
    record = Record({"x": MOTION}, STEP).with_noise(Noise({"x": {}}))
    assert with_local_derivative(record, "x", "v")[1] == pytest.approx(3 * STEP)

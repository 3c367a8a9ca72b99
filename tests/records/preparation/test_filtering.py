"""Filters and derivatives, against SciPy, closed forms and white noise."""

import numpy as np
import pytest
import scipy.signal

import riecjax as rx
from nightly import nightly
from riecjax.records.linear_op import LinearOp
from riecjax.records.preparation.filtering import derivative_taps, with_local_derivative
from riecjax.records.signal import SignalNoise

RATE = 1000.0
TIME = np.arange(4000) / RATE


def record(**signals: np.ndarray) -> rx.Record:
    return rx.Record(signals, 1 / RATE)


@pytest.mark.parametrize("frequency", [5.0, 50.0, 80.0, 200.0])
def test_low_pass_has_the_gain_of_a_butterworth_run_both_ways_and_no_phase(frequency):
    cutoff = 50.0
    wave = np.sin(2 * np.pi * frequency * TIME + 0.3)
    filtered = rx.low_pass(record(q=wave), {"q": cutoff})
    ratio = np.tan(np.pi * frequency / RATE) / np.tan(np.pi * cutoff / RATE)
    # Once each way: |H|^2 = 1 / (1 + ratio^8), and phases cancel.
    expected = wave[100:-100] / (1 + ratio**8)
    # The slowest pole has decayed to exp(-0.38 * 2 pi * 5) = 6e-6 where the ends are cut.
    np.testing.assert_allclose(filtered["q"], expected, atol=2e-5)


def with_missing(values: np.ndarray, *gaps: slice, **others: np.ndarray) -> rx.Record:
    values = values.copy()
    for gap in gaps:
        values[gap] = np.nan
    return rx.Record.from_samples({"q": values, **others}, time_step=1 / RATE)


def test_low_pass_loses_five_periods_of_a_signals_own_cut_off_beside_its_gaps():
    broken = with_missing(TIME, slice(2000, 2001))
    both = broken.with_signals({"p": broken.signal("q")})
    filtered = rx.low_pass(both, {"q": 100.0, "p": 20.0})
    np.testing.assert_allclose(filtered.time[0], 0.25)
    assert filtered.segments(["p"]) == [slice(0, 1500), slice(2001, 3500)]
    assert filtered.segments(["q"]) == [slice(0, 1700), slice(1801, 3500)]


def test_offset_is_the_mean_of_what_is_there():
    values = 5.0 + np.sin(np.arange(4000.0))
    broken = with_missing(values, slice(100, 900), slice(3999, 4000), p=values)
    freed = rx.remove_offset(broken, "q")
    there = np.asarray(freed.present(["q"]))
    assert there.sum() == 3199
    np.testing.assert_allclose(freed["q"][there], values[there] - values[there].mean(), atol=1e-12)
    np.testing.assert_array_equal(freed["q"][100:900], np.full(800, freed["q"][99]))
    np.testing.assert_array_equal(freed["p"], values)
    assert freed.sample_count == 4000


@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_drift_is_a_line_in_true_time_through_pauses(start):
    stamps = start + np.concatenate([TIME, 100 + TIME])
    noise = np.random.default_rng(0).normal(size=8000)
    drifting = rx.Record.from_samples({"q": 2 + 3 * (stamps - start) + noise}, time=stamps)
    freed = rx.remove_drift(drifting, "q")
    there = np.asarray(freed.present(["q"]))
    columns = np.column_stack([np.ones(8000), stamps - start])
    residual = noise - columns @ np.linalg.lstsq(columns, noise, rcond=None)[0]
    np.testing.assert_allclose(freed["q"][there], residual, rtol=0, atol=1e-5 if start else 1e-10)


def test_differences_are_exact_for_parabolas_at_the_ends_too():
    values = 3 - 2 * TIME + 5 * TIME**2
    derived = rx.differentiate(rx.Record({"q": rx.Signal(values, unit="m")}, 1 / RATE), "q", "dq")
    np.testing.assert_allclose(derived["dq"], -2 + 10 * TIME, rtol=0, atol=1e-10)
    assert dict(derived.units)["dq"] == "m/s"


def test_one_sample_between_gaps_has_no_slope_and_two_have_one():
    values = np.array([0.0, 1.0, np.nan, 5.0, np.nan, 7.0, 9.0])
    derived = rx.differentiate(rx.Record.from_samples({"q": values}, time_step=1.0), "q", "dq")
    assert derived.segments(["dq"]) == [slice(0, 2), slice(5, 7)]
    assert derived["dq"].tolist() == [1.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0]
    with pytest.raises(rx.DataError, match=r"'q' .*central differences of q.*takes 2 samples"):
        rx.differentiate(rx.Record.from_samples({"q": values[1:5]}, time_step=1.0), "q", "dq")


def test_an_operation_carries_values_gaps_noise_and_unit_of_the_signals_that_it_is_for():
    q = np.array([1.0, 2.0, 4.0, 8.0, np.nan, 3.0, 5.0, 7.0])
    signals = {"q": rx.Signal.of(q, "m", SignalNoise({"q": np.ones(1)})), "p": np.arange(8.0)}
    average = LinearOp.of_taps("{}: mean of three", np.ones(3) / 3, -1, source="q", unit="/3")
    made = rx.Record(signals, 1 / RATE).through({"mean": average})
    expected = [7 / 3, 14 / 3, np.nan, np.nan, np.nan, 5.0]
    np.testing.assert_allclose(made.signal("mean").with_nan, expected)
    np.testing.assert_array_equal(made["p"], np.arange(1.0, 7.0))
    np.testing.assert_allclose(made.noise.kernels["mean"]["q"], np.ones(3) / 3)
    assert made.signal("mean").unit == "m/3"


FINE_STEP = 0.01
FINE_TIME = np.arange(4000) * FINE_STEP
SLOW, FAST = 2 * np.pi * 0.7 * FINE_TIME, 2 * np.pi * 1.9 * FINE_TIME + 1
MOTION = np.sin(SLOW) + 0.4 * np.sin(FAST)
SLOPE = 2 * np.pi * (0.7 * np.cos(SLOW) + 0.4 * 1.9 * np.cos(FAST))


def noisy(level, seed=0):
    white = np.random.default_rng(seed).normal(size=FINE_TIME.size)
    return rx.Record({"x": rx.Signal(MOTION + level * white, unit="m")}, FINE_STEP)


@pytest.mark.parametrize("count", [3, 8, 25])
def test_taps_are_those_of_savitzky_and_golay(count):
    reference = scipy.signal.savgol_coeffs(2 * count + 1, 4, deriv=1, delta=0.02, use="conv")
    np.testing.assert_allclose(derivative_taps(count, 0.02), reference, atol=1e-9)


@pytest.mark.parametrize("level", [0.001, 0.01, 0.05])
def test_smoothing_errs_by_little_of_the_noise_that_is_left(level):
    record, half_width = with_local_derivative(noisy(level), "x", "v")
    count = round(half_width / FINE_STEP)
    clean = np.convolve(MOTION, derivative_taps(count, FINE_STEP), "valid")
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

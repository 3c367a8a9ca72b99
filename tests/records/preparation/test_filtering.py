import numpy as np
import pytest
import scipy.signal

from riecjax.records.preparation.filtering import low_pass, remove_drift, remove_offset, unfilter
from riecjax.records.record import Record

RATE = 1000.0
TIME = np.arange(4000) / RATE


def record(**signals: np.ndarray) -> Record:
    return Record(signals, 1 / RATE)


def butterworth(cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    coefficients = scipy.signal.butter(4, cutoff, fs=RATE)
    assert coefficients is not None
    return np.asarray(coefficients[0]), np.asarray(coefficients[1])


@pytest.mark.parametrize("frequency", [5.0, 50.0, 80.0, 200.0])
def test_low_pass_has_the_gain_of_a_butterworth_run_both_ways_and_no_phase(frequency):
    cutoff = 50.0
    wave = np.sin(2 * np.pi * frequency * TIME + 0.3)
    filtered = low_pass(record(q=wave), {"q": cutoff})
    ratio = np.tan(np.pi * frequency / RATE) / np.tan(np.pi * cutoff / RATE)
    # Once each way: |H|^2 = 1 / (1 + ratio^8), and phases cancel.
    expected = wave[100:-100] / (1 + ratio**8)
    # The slowest pole has decayed to exp(-0.38 * 2 pi * 5) = 6e-6 where the ends are cut.
    np.testing.assert_allclose(filtered["q"], expected, atol=2e-5)


def test_low_pass_agrees_with_filtfilt_and_leaves_other_signals():
    rng = np.random.default_rng(0)
    signals = {"q": rng.normal(size=4000).cumsum(), "force": rng.normal(size=4000)}
    filtered = low_pass(record(**signals), {"q": 100.0})
    reference = scipy.signal.filtfilt(*butterworth(100.0), signals["q"])[50:-50]
    # Transfer function against second-order sections: rounding of the coefficients, 1e-10.
    np.testing.assert_allclose(filtered["q"], reference, rtol=0, atol=1e-9 * np.ptp(reference))
    np.testing.assert_array_equal(filtered["force"], signals["force"][50:-50])


TAU = 0.004


def behind_a_low_pass(frequency: float) -> np.ndarray:
    """The settled answer of tau z' + z = s to a wave of this frequency."""
    lag = 2 * np.pi * frequency * TAU
    wave = np.sin(2 * np.pi * frequency * TIME + 0.3 - np.arctan(lag))
    return wave / np.hypot(1, lag)


@pytest.mark.parametrize("frequency", [5.0, 40.0, 80.0])
def test_a_low_pass_of_first_order_is_undone(frequency):
    z = behind_a_low_pass(frequency)
    z[2000:2005] = np.nan
    found = unfilter(Record.from_samples({"q": z, "p": TIME}, time_step=1 / RATE), {"q": TAU})
    values, time = np.asarray(found["q"]), np.asarray(found.elapsed)
    gone = np.asarray(found.missing["q"])
    # What differences of sixth order miss of a slope, (w h)^6 / 140.
    off = 2 * np.pi * frequency * TAU * (2 * np.pi * frequency / RATE) ** 6 / 140
    wave = np.sin(2 * np.pi * frequency * time + 0.3)
    np.testing.assert_allclose(values[~gone], wave[~gone], rtol=0, atol=1.1 * off + 1e-9)
    assert gone.sum() == 5 + 2 * 3
    np.testing.assert_array_equal(found["p"], TIME[3:-3])


def with_missing(values: np.ndarray, *gaps: slice, **others: np.ndarray) -> Record:
    values = values.copy()
    for gap in gaps:
        values[gap] = np.nan
    return Record.from_samples({"q": values, **others}, time_step=1 / RATE)


def test_low_pass_loses_five_periods_of_a_signals_own_cut_off_beside_its_gaps():
    broken = with_missing(TIME, slice(2000, 2001))
    both = broken.with_signals({"p": broken["q"]}, missing={"p": broken.missing["q"]})
    filtered = low_pass(both, {"q": 100.0, "p": 20.0})
    np.testing.assert_allclose(filtered.time[0], 0.25)
    assert filtered.segments(["p"]) == [slice(0, 1500), slice(2001, 3500)]
    assert filtered.segments(["q"]) == [slice(0, 1700), slice(1801, 3500)]


def test_offset_is_the_mean_of_what_is_there():
    values = 5.0 + np.sin(np.arange(4000.0))
    broken = with_missing(values, slice(100, 900), slice(3999, 4000), p=values)
    freed = remove_offset(broken, "q")
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
    drifting = Record.from_samples({"q": 2 + 3 * (stamps - start) + noise}, time=stamps)
    freed = remove_drift(drifting, "q")
    there = np.asarray(freed.present(["q"]))
    columns = np.column_stack([np.ones(8000), stamps - start])
    residual = noise - columns @ np.linalg.lstsq(columns, noise, rcond=None)[0]
    np.testing.assert_allclose(freed["q"][there], residual, rtol=0, atol=1e-5 if start else 1e-10)


def test_drift_of_a_line_is_all_of_it():
    freed = remove_drift(with_missing(7 - 2 * TIME, slice(5, 50), p=TIME**2), "q", "p")
    np.testing.assert_allclose(freed["q"], 0, atol=1e-12)
    np.testing.assert_allclose(freed["p"], scipy.signal.detrend(TIME**2), atol=1e-12)

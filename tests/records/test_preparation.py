import numpy as np
import pytest
import scipy.signal

from riecjax.errors import DataError
from riecjax.models.model import Model
from riecjax.models.preparation import Preparation, prepare
from riecjax.records.preparation import central_difference, differentiate, every, low_pass
from riecjax.records.record import Record

RATE = 1000.0
TIME = np.arange(4000) / RATE
AXIS = Model("axis", "", derived={"dq": "q", "ddq": "dq"})


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


def test_low_pass_cuts_five_periods_of_the_lowest_cut_off_and_keeps_time():
    filtered = low_pass(record(q=TIME, p=TIME), {"q": 100.0, "p": 20.0})
    assert filtered.sample_count == 4000 - 2 * 250
    np.testing.assert_allclose(filtered.start_time, 0.25)
    np.testing.assert_allclose(filtered.time, TIME[250:-250])


@pytest.mark.parametrize("cutoff", [0.0, -5.0, 500.0, 1e9])
def test_impossible_cut_off(cutoff):
    with pytest.raises(DataError, match="between 0 and half the sampling rate, 500 Hz"):
        low_pass(record(q=TIME), {"q": cutoff})


def test_low_pass_of_a_missing_signal():
    with pytest.raises(DataError, match="no signal 'speed'"):
        low_pass(record(q=TIME), {"speed": 10.0})


@pytest.mark.parametrize("sample_count", [2, 3, 10, 15, 16, 17, 100, 102])
def test_low_pass_of_a_record_that_is_too_short(sample_count):
    with pytest.raises(DataError, match="too short to be filtered at 100 Hz"):
        low_pass(record(q=TIME[:sample_count]), {"q": 100.0})


def test_low_pass_of_a_short_record_that_will_do():
    assert low_pass(record(q=TIME[:150]), {"q": 100.0}).sample_count == 50


def test_differences_are_exact_for_parabolas_at_the_ends_too():
    values = 3 - 2 * TIME + 5 * TIME**2
    derived = differentiate(Record({"q": values}, 1 / RATE, units={"q": "m"}), "q", "dq")
    np.testing.assert_allclose(derived["dq"], -2 + 10 * TIME, rtol=0, atol=1e-10)
    assert dict(derived.units)["dq"] == "m/s"


def test_differences_agree_with_numpy():
    values = np.random.default_rng(1).normal(size=50)
    np.testing.assert_allclose(
        central_difference(values, np.asarray(0.1)),  # pyright: ignore[reportArgumentType]
        np.gradient(values, 0.1, edge_order=2),
        rtol=1e-12,
    )


def test_difference_of_two_samples():
    derived = differentiate(Record({"q": np.array([1.0, 3.0])}, 0.5), "q", "dq")
    assert derived["dq"].tolist() == [4.0, 4.0]


@pytest.mark.parametrize("count", [1, 2, 7, 1999, 3999])
def test_every_nth_sample(count):
    thinned = every(Record({"q": TIME}, 1 / RATE, 2.0), count)
    np.testing.assert_array_equal(thinned["q"], TIME[::count])
    np.testing.assert_allclose(thinned.time, 2.0 + TIME[::count])


@pytest.mark.parametrize("count", [0, -1, 4000])
def test_every_nth_of_too_few(count):
    with pytest.raises(DataError, match="too few would remain"):
        every(record(q=TIME), count)


def test_prepare_filters_then_differentiates_then_thins_out():
    rng = np.random.default_rng(2)
    q = np.sin(9 * TIME) + 1e-3 * rng.normal(size=4000)
    prepared = prepare(record(q=q), AXIS, Preparation({"q": 100.0}, 10))
    smooth = scipy.signal.filtfilt(*butterworth(100.0), q)[50:-50]
    velocity = np.gradient(smooth, 1 / RATE, edge_order=2)
    acceleration = np.gradient(velocity, 1 / RATE, edge_order=2)
    assert float(prepared.time_step) == pytest.approx(0.01, rel=1e-12)
    np.testing.assert_allclose(prepared["q"], smooth[::10], rtol=0, atol=1e-9)
    np.testing.assert_allclose(prepared["dq"], velocity[::10], rtol=0, atol=1e-7)
    # Each difference divides the filter's rounding of 1e-11 by the step of 1e-3.
    np.testing.assert_allclose(prepared["ddq"], acceleration[::10], rtol=0, atol=1e-5)


def test_prepare_keeps_a_recorded_derivative():
    recorded = np.cos(3 * TIME)
    prepared = prepare(record(q=TIME**3, dq=recorded), AXIS, Preparation({}))
    np.testing.assert_array_equal(prepared["dq"], recorded)
    np.testing.assert_allclose(
        prepared["ddq"], np.gradient(recorded, 1 / RATE, edge_order=2), atol=1e-9
    )


def test_steps_in_words():
    steps = Preparation({"q": 100.0}, 10).describe(AXIS)
    assert steps == [
        "q: zero-phase 4th-order Butterworth low-pass at 100 Hz",
        "dq: central differences of q, if not recorded",
        "ddq: central differences of dq, if not recorded",
        "every 10th sample",
    ]
    assert Preparation({}).describe(Model("none", "")) == []

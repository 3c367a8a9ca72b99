import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
import scipy.signal

from riecjax.errors import DataError
from riecjax.records.noise import Noise
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


def test_low_pass_cuts_five_periods_of_the_lowest_cut_off_and_keeps_time():
    filtered = low_pass(record(q=TIME, p=TIME), {"q": 100.0, "p": 20.0})
    assert filtered.sample_count == 4000 - 2 * 250
    np.testing.assert_allclose(filtered.start_time, 0.25)
    np.testing.assert_allclose(filtered.time, TIME[250:-250])


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


def test_noise_grows_as_a_low_pass_is_undone():
    white = np.random.default_rng(0).normal(size=40_000)
    noisy = record(q=white).with_noise(Noise.given({"q": 1.0}))
    found = unfilter(noisy, {"q": TAU})
    assert float(found.noise.std("q")) == pytest.approx(np.std(np.asarray(found["q"])), rel=0.02)
    assert float(found.noise.std("q")) > 3


@pytest.mark.parametrize("seconds", [0.0, -TAU, np.nan, np.inf])
def test_no_low_pass_has_such_a_time_constant(seconds):
    with pytest.raises(DataError, match="must be positive"):
        unfilter(record(q=TIME), {"q": seconds})


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


def with_missing(values: np.ndarray, *gaps: slice, **others: np.ndarray) -> Record:
    values = values.copy()
    for gap in gaps:
        values[gap] = np.nan
    return Record.from_samples({"q": values, **others}, time_step=1 / RATE)


def test_low_pass_treats_stretches_as_records_of_their_own():
    values = np.random.default_rng(3).normal(size=4000).cumsum()
    filtered = low_pass(with_missing(values, slice(1500, 1510), force=TIME), {"q": 100.0})
    alone = low_pass(record(q=values[:1500]), {"q": 100.0})
    after = low_pass(record(q=values[1510:]), {"q": 100.0})
    assert filtered.segments(["q"]) == [slice(0, 1400), slice(1510, 3900)]
    np.testing.assert_array_equal(filtered["q"][:1400], alone["q"])
    np.testing.assert_array_equal(filtered["q"][1510:], after["q"])
    # Missing samples hold the last value, and a signal that was not treated lacks nothing.
    np.testing.assert_array_equal(filtered["q"][1400:1510], np.full(110, alone["q"][-1]))
    assert filtered.segments(["force"]) == [slice(0, 3900)]
    np.testing.assert_array_equal(filtered["force"], TIME[50:-50])


def test_low_pass_loses_five_periods_of_a_signals_own_cut_off_beside_its_gaps():
    broken = with_missing(TIME, slice(2000, 2001))
    both = broken.with_signals({"p": broken["q"]}, missing={"p": broken.missing["q"]})
    filtered = low_pass(both, {"q": 100.0, "p": 20.0})
    np.testing.assert_allclose(filtered.time[0], 0.25)
    assert filtered.segments(["p"]) == [slice(0, 1500), slice(2001, 3500)]
    assert filtered.segments(["q"]) == [slice(0, 1700), slice(1801, 3500)]


def test_low_pass_keeps_a_pause():
    stamps = np.concatenate([TIME[:2000], 60 + TIME[:2000]])
    values = np.sin(2 * np.pi * 5 * stamps)
    paused = Record.from_samples({"q": values}, time=stamps)
    filtered = low_pass(paused, {"q": 100.0})
    there = np.asarray(filtered.present(["q"]))
    assert there.sum() == 4000 - 4 * 50
    np.testing.assert_array_equal(
        np.asarray(filtered.time)[there], np.concatenate([stamps[50:1950], stamps[2050:3950]])
    )
    expected = np.sin(2 * np.pi * 5 * np.asarray(filtered.time)[there])
    np.testing.assert_allclose(filtered["q"][there], expected, atol=2e-5)


def test_low_pass_gives_up_stretches_that_are_too_short_and_no_others():
    broken = with_missing(TIME, slice(1000, 1001), slice(1102, 1103))
    filtered = low_pass(broken, {"q": 100.0})
    assert filtered.segments(["q"]) == [slice(0, 900), slice(1103, 3900)]


def test_low_pass_of_nothing_but_short_stretches():
    broken = with_missing(TIME, *(slice(at, at + 1) for at in range(0, 4000, 100)))
    match = "no stretch of 'q'.*more than 102 samples, and the longest has 99. Raise the cut-off"
    with pytest.raises(DataError, match=match):
        low_pass(broken, {"q": 100.0})


def test_low_pass_of_nothing_changes_nothing():
    assert low_pass(record(q=TIME), {}).sample_count == 4000


@hypothesis.given(st.lists(st.integers(0, 3999), max_size=6), st.sampled_from([20.0, 60.0]))
@hypothesis.settings(deadline=None, max_examples=30)
def test_low_pass_never_feels_another_stretch(gaps, cutoff):
    values = np.sin(2 * np.pi * 3 * TIME)
    broken = with_missing(values, *(slice(at, at + 1) for at in gaps))
    # Each stretch far above the one before: what came across would show.
    number = np.cumsum(np.asarray(broken.missing.get("q", np.zeros(4000, bool))))
    lifted = broken.with_signals({"q": broken["q"] + 1e3 * number}, missing=dict(broken.missing))
    try:
        filtered = low_pass(lifted, {"q": cutoff})
    except DataError:
        longest = max(s.stop - s.start for s in broken.segments(["q"]))
        # Nothing but one long stretch at the record's ends is cut for the ends' sake as well.
        assert longest <= 2 * 2 * 5 * RATE / cutoff
        return
    cut = (4000 - filtered.sample_count) // 2
    # In NumPy, since JAX compiles an indexing anew for every length.
    there = ~np.asarray(filtered.missing.get("q", np.zeros(filtered.sample_count, bool)))
    expected = (values + 1e3 * number)[cut:-cut]
    # Gain at 3 Hz of a low-pass at 20 Hz: 1 / (1 + 0.15^8).
    np.testing.assert_allclose(np.asarray(filtered["q"])[there], expected[there], rtol=0, atol=1e-3)


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


@pytest.mark.parametrize("step", [remove_offset, remove_drift])
def test_offset_and_drift_of_unknown_or_no_signals(step):
    with pytest.raises(DataError, match="no signal 'speed'"):
        step(record(q=TIME), "speed")
    with pytest.raises(DataError, match=r"name the signals.*there are: q"):
        step(record(q=TIME))

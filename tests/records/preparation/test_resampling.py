import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
import scipy.signal

from riecjax.errors import DataError
from riecjax.records.preparation.resampling import decimate, resample, upsample
from riecjax.records.record import Record

UP_REACH, DOWN_REACH = 44, 26
"""Samples of the slower rate that are lost, as the docstrings say."""


def wave(time, share: float, rate: float = 1.0, phase: float = 0.4) -> np.ndarray:
    """A sine at a share of half the rate."""
    return np.sin(np.pi * share * rate * np.asarray(time) + phase)


def waves(count: int, share: float, phase: float = 0.4) -> Record:
    return Record({"a": wave(np.arange(count), share, 1.0, phase)}, 1.0, units={"a": "m"})


@pytest.mark.parametrize("factor", [2, 7, 8])
@pytest.mark.parametrize("share", [0.01, 0.222, 0.5, 0.8, 0.9])
def test_upsampling_errs_by_less_than_1e_6_up_to_0_9_of_half_the_rate(share, factor):
    for phase in (0.0, 0.8, 1.6, 2.4):
        finer = upsample(waves(1000, share, phase), factor)
        truth = wave(finer.time, share, 1.0, phase)
        np.testing.assert_allclose(finer["a"], truth, rtol=0, atol=1e-6)


def test_upsampling_keeps_recorded_samples_and_loses_its_reach_at_the_ends():
    values = np.random.default_rng(0).normal(size=500)
    finer = upsample(Record({"a": values}, 0.1, 3.0, {"a": "V"}), 6)
    assert finer.sample_count == (500 - 1 - 2 * UP_REACH) * 6 + 1
    assert float(finer.time_step) == pytest.approx(0.1 / 6, rel=1e-14)
    assert float(finer.start_time) == pytest.approx(3.0 + 0.1 * UP_REACH, rel=1e-14)
    np.testing.assert_allclose(finer["a"][::6], values[UP_REACH:-UP_REACH], rtol=0, atol=1e-13)
    assert dict(finer.units) == {"a": "V"}
    assert not finer.missing
    assert finer.stamps is None


def test_upsampling_agrees_with_the_fourier_series_of_a_periodic_signal():
    spectrum = np.zeros(101, complex)
    spectrum[1:91] = np.exp(1j * np.random.default_rng(1).uniform(0, 7, 90))
    period = np.fft.irfft(spectrum, 200)
    finer = np.asarray(upsample(Record({"a": np.tile(period, 3)}, 1.0), 5)["a"])
    reference = np.tile(np.asarray(scipy.signal.resample(period, 1000)), 3)
    inside = slice(5 * UP_REACH, 5 * (599 - UP_REACH) + 1)
    np.testing.assert_allclose(finer, reference[inside], rtol=0, atol=1e-6 * np.ptp(period).item())


@pytest.mark.parametrize(("offset", "slope"), [(np.pi, 0.0), (1e6, 0.0), (0.0, 2.0)])
def test_offsets_and_ramps_pass(offset, slope):
    record = Record({"a": offset + slope * np.arange(2000.0)}, 1.0)
    for other in (upsample(record, 3), decimate(record, 3), resample(record, 0.7)):
        expected = offset + slope * np.asarray(other.time)
        np.testing.assert_allclose(other["a"], expected, rtol=1e-12, atol=1e-3 * slope)


@pytest.mark.parametrize("factor", [2, 5, 10])
@pytest.mark.parametrize("share", [0.05, 0.5, 0.8])
def test_decimation_is_flat_within_1e_4_to_0_8_of_half_the_new_rate(share, factor):
    thinner = decimate(waves(4000, share / factor), factor)
    np.testing.assert_allclose(thinner["a"], wave(thinner.time, share / factor), rtol=0, atol=1e-4)


@pytest.mark.parametrize("factor", [2, 5, 10])
@pytest.mark.parametrize("share", [1.0, 1.05, 1.2, 1.9])
def test_decimation_is_80_db_down_from_half_the_new_rate_on(share, factor):
    thinner = decimate(waves(4000, share / factor), factor)
    assert np.max(np.abs(thinner["a"])) < 1e-4


def test_decimation_takes_samples_of_the_old_grid_and_loses_its_reach():
    record = Record({"a": np.ones(5000), "b": np.arange(5000.0)}, 0.01, 1.0)
    thinner = decimate(record, 10)
    assert float(thinner.start_time) == pytest.approx(1.0 + DOWN_REACH * 0.1)
    assert float(thinner.time_step) == pytest.approx(0.1)
    # The last index of a multiple of 10 with 260 samples after it.
    assert thinner.sample_count == (4999 - 260) // 10 - DOWN_REACH + 1
    np.testing.assert_allclose(thinner["b"], 260 + 10 * np.arange(thinner.sample_count), atol=1e-6)


@pytest.mark.parametrize("rate", [2.0, np.e, 7.0])
def test_resampling_to_faster_rates_is_band_limited(rate):
    for share in (0.2, 0.9):
        other = resample(waves(1000, share), rate)
        assert float(other.time_step) == pytest.approx(1 / rate, rel=1e-14)
        np.testing.assert_allclose(other["a"], wave(other.time, share), rtol=0, atol=1e-6)


@pytest.mark.parametrize("rate", [0.99, 0.5, 1 / np.pi])
def test_resampling_to_slower_rates_keeps_what_they_can_hold_and_nothing_else(rate):
    kept = resample(waves(3000, 0.8 * rate), rate)
    np.testing.assert_allclose(kept["a"], wave(kept.time, 0.8 * rate), rtol=0, atol=1e-4)
    if rate < 0.9:
        assert np.max(np.abs(resample(waves(3000, 1.02 * rate), rate)["a"])) < 1.1e-4


def test_whole_factors_are_resampling():
    record = Record({"a": np.random.default_rng(2).normal(size=3000)}, 0.01)
    np.testing.assert_allclose(upsample(record, 4)["a"], resample(record, 400.0)["a"], atol=1e-12)
    np.testing.assert_allclose(decimate(record, 4)["a"], resample(record, 25.0)["a"], atol=1e-12)


def test_the_same_rate_changes_nothing():
    record = Record({"a": np.random.default_rng(2).normal(size=10)}, 0.01)
    for same in (resample(record, 100.0), upsample(record, 1), decimate(record, 1)):
        np.testing.assert_array_equal(same["a"], record["a"])


def test_a_gap_costs_one_signal_its_reach_and_the_others_nothing():
    values = wave(np.arange(1000), 0.3)
    broken = values.copy()
    broken[:500] += 1e6
    broken[500] = np.nan
    finer = upsample(Record.from_samples({"a": broken, "b": values}, time_step=1.0), 4)
    time = np.asarray(finer.time)
    gone = np.asarray(finer.missing["a"])
    np.testing.assert_array_equal(gone, (time > 499 - UP_REACH) & (time < 501 + UP_REACH))
    expected = wave(time, 0.3) + np.where(time < 500, 1e6, 0)
    np.testing.assert_allclose(finer["a"][~gone], expected[~gone], rtol=0, atol=1e-6)
    np.testing.assert_allclose(finer["b"], wave(time, 0.3), rtol=0, atol=1e-6)
    assert "b" not in finer.missing


@pytest.mark.parametrize("rate", [40.0, 13.7, 2.5])
def test_pauses_stay_pauses_of_one_sample_and_grids_begin_anew(rate):
    time = np.concatenate([np.arange(900) / 10, 1000.03 + np.arange(800) / 10])
    values = wave(time, 0.1, 10.0)
    values[:900] += 1e6
    other = resample(Record.from_samples({"a": values}, time=time), rate)
    there = np.asarray(other.present(["a"]))
    assert (~there).sum() == 1
    stamps = np.asarray(other.time)
    steps = np.diff(stamps)
    pause = int(np.argmin(there))
    np.testing.assert_allclose(np.delete(steps, [pause - 1, pause]), 1 / rate, rtol=0, atol=1e-9)
    lost = UP_REACH / 10 if rate > 10 else DOWN_REACH / rate
    assert stamps[pause - 1] == pytest.approx(89.9 - lost, abs=1 / rate)
    assert stamps[pause + 1] == pytest.approx(1000.03 + lost, abs=1 / rate)
    assert stamps[pause] == pytest.approx((stamps[pause - 1] + stamps[pause + 1]) / 2)
    expected = wave(stamps, 0.1, 10.0) + np.where(stamps < 500, 1e6, 0)
    atol = 1e-5 if rate > 10 else 2e-4
    np.testing.assert_allclose(other["a"][there], expected[there], rtol=1e-12, atol=atol)


def test_a_stretch_too_short_between_pauses_is_gone():
    time = np.concatenate([np.arange(200), 300 + np.arange(88), 500.0 + np.arange(200)])
    other = upsample(Record.from_samples({"a": np.sin(time / 9)}, time=time), 2)
    assert [s.stop - s.start for s in other.segments()] == [223, 223]
    assert other.time[223] == pytest.approx((155 + 544) / 2)


@hypothesis.given(
    st.lists(st.integers(0, 1499), max_size=5), st.floats(0.2, 5.0), st.integers(0, 2**31)
)
@hypothesis.settings(deadline=None, max_examples=50)
def test_whatever_is_there_is_right_and_whatever_is_whole_is_there(gaps, rate, seed):
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 7, 5)
    shares = 0.78 * min(rate, 1.0) * rng.uniform(0, 1, 5)

    def truth(time):
        return sum(wave(time, s, 1.0, p) for s, p in zip(shares, phases))

    values = np.asarray(truth(np.arange(1500)))
    values[gaps] = np.nan
    record = Record.from_samples({"a": values, "b": np.ones(1500)}, time_step=1.0)
    reach = UP_REACH if rate >= 1 else int(np.ceil(DOWN_REACH / rate))
    longest = max(s.stop - s.start for s in record.segments(["a"]))
    if longest <= 2 * reach + 1 + 1 / rate:
        return
    other = resample(record, rate)
    # In NumPy, since JAX compiles an operation anew for every length.
    there = ~np.asarray(other.missing.get("a", np.zeros(other.sample_count, bool)))
    time = float(other.start_time) + float(other.time_step) * np.arange(other.sample_count)
    found, expected = np.asarray(other["a"]), np.asarray(truth(time))
    np.testing.assert_allclose(found[there], expected[there], rtol=0, atol=5e-4)
    for stretch in record.segments(["a"]):
        whole = (time >= stretch.start + reach) & (time <= stretch.stop - 1 - reach)
        assert there[whole].all()


@pytest.mark.parametrize("factor", [0, -2, 1.5])
@pytest.mark.parametrize("step", [upsample, decimate])
def test_impossible_factor(step, factor):
    with pytest.raises(DataError, match="whole number of at least 1"):
        step(waves(1000, 0.1), factor)


@pytest.mark.parametrize("rate", [0.0, -3.0, np.inf, np.nan])
def test_impossible_rate(rate):
    with pytest.raises(DataError, match="positive number"):
        resample(waves(1000, 0.1), rate)


def test_more_samples_than_anybody_wants():
    with pytest.raises(
        DataError, match=r"^1e\+09 Hz would make .*to identify from them takes about"
    ):
        resample(waves(1000, 0.1), 1e9)
    with pytest.raises(DataError, match=r"4e\+06 samples.* of 4000 .* takes about 0\.68 GB"):
        upsample(waves(4000, 0.1), 1000)
    assert upsample(waves(4000, 0.1), 50).sample_count > 190_000


def test_records_too_short():
    match = "no stretch of 'a'.*takes 89 samples of the record, and the longest has 88"
    with pytest.raises(DataError, match=match):
        upsample(waves(88, 0.1), 2)
    assert upsample(waves(90, 0.1), 2).sample_count == 3
    with pytest.raises(DataError, match="takes 521 samples"):
        decimate(waves(500, 0.1), 10)


def test_an_integral_over_nine_samples_a_period_needs_the_finer_record():
    # The use: a trapezoid over a quarter period, by samples 9 to the period and 8 times finer.
    record = waves(400, 2 / 9, 0.0)
    finer = upsample(record, 8)

    def relative_error(r: Record, per_sample: int) -> float:
        area = np.trapezoid(np.asarray(r["a"]), np.asarray(r.time))
        omega, (first, last) = 2 * np.pi / 9, np.asarray(r.time)[[0, -1]]
        return area / ((np.cos(omega * first) - np.cos(omega * last)) / omega) - 1

    start = UP_REACH + 1
    raw = relative_error(record.part(start, start + 3), 1)
    fine = relative_error(finer.part(8, 8 + 16 + 1), 8)
    assert raw == pytest.approx(np.pi / 9 / np.tan(np.pi / 9) - 1, rel=1e-6)
    assert raw < -0.04
    assert abs(fine) < 1e-3

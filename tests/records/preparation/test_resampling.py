import numpy as np
import pytest

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


def test_the_same_rate_changes_nothing():
    record = Record({"a": np.random.default_rng(2).normal(size=10)}, 0.01)
    for same in (resample(record, 100.0), upsample(record, 1), decimate(record, 1)):
        np.testing.assert_array_equal(same["a"], record["a"])


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


def test_more_samples_than_anybody_wants():
    with pytest.raises(
        DataError, match=r"^1e\+09 Hz would make .*to identify from them takes about"
    ):
        resample(waves(1000, 0.1), 1e9)
    with pytest.raises(DataError, match=r"4e\+06 samples.* of 4000 .* takes about 0\.68 GB"):
        upsample(waves(4000, 0.1), 1000)
    assert upsample(waves(4000, 0.1), 50).sample_count > 190_000

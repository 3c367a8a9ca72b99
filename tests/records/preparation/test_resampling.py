"""Records at another rate, and channels of different rates on one."""

import numpy as np
import pytest
import scipy.interpolate
import scipy.signal

import riecjax as rx
from riecjax.records.preparation.resampling import (
    ANTI_ALIAS,
    INTERPOLATION,
    TRANSITION,
    on_grid,
    response,
    upsample,
)

UP_REACH = 44
"""Samples of the slower rate that are lost, as the docstrings say."""


def wave(time, share: float, rate: float = 1.0, phase: float = 0.4) -> np.ndarray:
    """A sine at a share of half the rate."""
    return np.sin(np.pi * share * rate * np.asarray(time) + phase)


def waves(count: int, share: float, phase: float = 0.4) -> rx.Record:
    return rx.Record({"a": rx.Signal(wave(np.arange(count), share, 1.0, phase), unit="m")}, 1.0)


@pytest.mark.parametrize(("spacing", "of"), [(1.0, INTERPOLATION), (3.0, ANTI_ALIAS)])
def test_windows_are_of_the_order_and_shape_that_scipy_gives_for_their_attenuation(spacing, of):
    cutoff, attenuation = of
    taps, shape = scipy.signal.kaiserord(attenuation, TRANSITION)
    reach = 0.5 * taps * spacing
    offsets = np.arange(-np.ceil(reach), np.ceil(reach) + 1)
    inside = np.abs(offsets) < reach
    window = np.i0(shape * np.sqrt(np.where(inside, 1 - (offsets / reach) ** 2, 0.0))) * inside
    weights = np.sinc(cutoff / spacing * offsets) * window
    np.testing.assert_allclose(response(offsets, spacing), weights / weights.sum(), atol=1e-14)


@pytest.mark.parametrize("factor", [2, 7, 8])
@pytest.mark.parametrize("share", [0.01, 0.222, 0.5, 0.8, 0.9])
def test_upsampling_errs_by_less_than_1e_6_up_to_0_9_of_half_the_rate(share, factor):
    for phase in (0.0, 0.8, 1.6, 2.4):
        finer = upsample(waves(1000, share, phase), factor)
        truth = wave(finer.time, share, 1.0, phase)
        np.testing.assert_allclose(finer["a"], truth, rtol=0, atol=1e-6)


def test_upsampling_keeps_recorded_samples_and_loses_its_reach_at_the_ends():
    values = np.random.default_rng(0).normal(size=500)
    finer = upsample(rx.Record({"a": rx.Signal(values, unit="V")}, 0.1, 3.0), 6)
    assert finer.sample_count == (500 - 1 - 2 * UP_REACH) * 6 + 1
    assert float(finer.time_step) == pytest.approx(0.1 / 6, rel=1e-14)
    assert float(finer.start_time) == pytest.approx(3.0 + 0.1 * UP_REACH, rel=1e-14)
    np.testing.assert_allclose(finer["a"][::6], values[UP_REACH:-UP_REACH], rtol=0, atol=1e-13)
    assert dict(finer.units) == {"a": "V"}
    assert finer.present(["a"]) is None
    assert finer.stamps is None


@pytest.mark.parametrize("factor", [2, 5, 10])
@pytest.mark.parametrize("share", [1.0, 1.05, 1.2, 1.9])
def test_decimation_is_80_db_down_from_half_the_new_rate_on(share, factor):
    thinner = rx.resample(waves(4000, share / factor), 1 / factor)
    assert np.max(np.abs(thinner["a"])) < 1e-4


@pytest.mark.parametrize("rate", [0.99, 0.5, 1 / np.pi])
def test_resampling_to_slower_rates_keeps_what_they_can_hold_and_nothing_else(rate):
    kept = rx.resample(waves(3000, 0.8 * rate), rate)
    np.testing.assert_allclose(kept["a"], wave(kept.time, 0.8 * rate), rtol=0, atol=1e-4)
    if rate < 0.9:
        assert np.max(np.abs(rx.resample(waves(3000, 1.02 * rate), rate)["a"])) < 1.1e-4


def test_the_same_rate_changes_nothing():
    record = rx.Record({"a": np.random.default_rng(2).normal(size=10)}, 0.01)
    for same in (rx.resample(record, 100.0), upsample(record, 1)):
        np.testing.assert_array_equal(same["a"], record["a"])


def test_a_stretch_too_short_between_pauses_is_gone():
    time = np.concatenate([np.arange(200), 300 + np.arange(88), 500.0 + np.arange(200)])
    other = upsample(rx.Record.from_samples({"a": np.sin(time / 9)}, time=time), 2)
    assert [s.stop - s.start for s in other.segments()] == [223, 223]
    assert other.time[223] == pytest.approx((155 + 544) / 2)


def test_more_samples_than_anybody_wants():
    with pytest.raises(
        rx.DataError, match=r"^1e\+09 Hz would make .*to identify from them takes about"
    ):
        rx.resample(waves(1000, 0.1), 1e9)
    with pytest.raises(rx.DataError, match=r"4e\+06 samples.* of 4000 .* takes about 0\.68 GB"):
        upsample(waves(4000, 0.1), 1000)
    assert upsample(waves(4000, 0.1), 50).sample_count > 190_000


def sampled(rate: float, duration: float, start: float = 0.0) -> np.ndarray:
    return start + np.arange(round(duration * rate) + 1) / rate


def jittered(time: np.ndarray, share: float, seed: int = 0) -> np.ndarray:
    step = time[1] - time[0]
    return time + share * step * np.random.default_rng(seed).uniform(-1, 1, time.size)


def sine(time: np.ndarray, hertz: float, phase: float = 0.4) -> np.ndarray:
    return np.sin(2 * np.pi * hertz * time + phase)


def test_between_even_samples_lies_the_cubic_spline():
    time, values = sampled(50.0, 4.0, 0.37), np.random.default_rng(1).normal(size=201)
    grid, columns, _ = on_grid({"a": (time, values)}, 61.7)
    expected = scipy.interpolate.CubicSpline(time, values)(grid)
    np.testing.assert_allclose(columns["a"], expected, atol=1e-9)


def test_the_grid_is_what_all_channels_share():
    channels = {
        "a": (sampled(100.0, 5.0, 1.0), np.ones(501)),
        "b": (sampled(30.0, 5.0, 2.005), np.ones(151)),
        "c": (sampled(10.0, 7.0, 0.5), np.ones(71)),
    }
    grid, columns, _ = on_grid(channels, 100.0)
    np.testing.assert_allclose(grid, 2.005 + np.arange(400) / 100)
    assert all(np.array_equal(values, np.ones(400)) for values in columns.values())


@pytest.mark.parametrize("share", [0.0, 0.3], ids=["even", "uneven"])
@pytest.mark.parametrize("hertz", [1.0, 10.0, 39.9])
def test_a_faster_channel_keeps_what_lies_below_0_8_of_half_the_rate(share, hertz):
    time = jittered(sampled(1000.0, 10.0), share)
    grid, columns, _ = on_grid({"a": (time, sine(time, hertz))}, 100.0)
    np.testing.assert_allclose(columns["a"], sine(grid, hertz), rtol=0, atol=1.5e-4)


@pytest.mark.parametrize("share", [0.0, 0.3], ids=["even", "uneven"])
@pytest.mark.parametrize("hertz", [50.0, 55.0, 90.0, 133.0])
def test_a_faster_channel_folds_nothing_down(share, hertz):
    time = jittered(sampled(1000.0, 10.0), share)
    _, columns, _ = on_grid({"a": (time, sine(time, hertz))}, 100.0)
    # 80 dB; what uneven times spoil on the way through a spline adds to it.
    assert np.max(np.abs(columns["a"])) < (1.2e-4 if share == 0 else 2e-3)


def test_gaps_by_nan_and_by_time():
    time = np.delete(sampled(100.0, 10.0), slice(301, 341))
    values = sine(time, 2.0)
    values[700:702] = np.nan
    slow = sampled(20.0, 10.0)
    grid, columns, _ = on_grid({"a": (time, values), "b": (slow, sine(slow, 1.0))}, 100.0)
    assert grid.size == 1001
    gone = (grid > 3.005) & (grid < 3.405) | (grid > time[699] + 0.005) & (grid < time[702] - 0.005)
    np.testing.assert_array_equal(np.isnan(columns["a"]), gone)
    np.testing.assert_array_equal(columns["a"][~gone], sine(grid, 2.0)[~gone])
    assert not np.isnan(columns["b"]).any()


def test_a_step_of_three_usual_ones_is_no_gap_and_a_longer_one_is():
    def missing(dropped: int) -> int:
        time = np.delete(sampled(100.0, 2.0), slice(50, 50 + dropped))
        _, columns, _ = on_grid({"a": (time, sine(time, 0.5))}, 100.0)
        return int(np.isnan(columns["a"]).sum())

    assert missing(2) == 0
    assert missing(3) == 3


def test_nothing_comes_across_a_gap_of_a_faster_channel():
    time, values = sampled(1000.0, 20.0), sine(sampled(1000.0, 20.0), 3.0)
    values[10_000:] += 1e6
    values[9_990:10_010] = np.nan
    grid, columns, _ = on_grid({"a": (time, values)}, 100.0)
    # 26 samples of the grid from the last sample before, 9.989 s, and the first after, 10.01 s.
    near = np.isnan(columns["a"])
    edges = grid[near][[0, -1]]
    np.testing.assert_allclose(edges, [9.73, 10.26], atol=1e-9)
    before = ~near & (grid < 10)
    np.testing.assert_allclose(columns["a"][before], sine(grid, 3.0)[before], atol=1e-4)


def test_short_stretches_of_samples_on_the_grid_stay_and_others_go():
    values = np.sin(np.arange(60.0))
    values[[20, 22, 25]] = np.nan
    time = sampled(10.0, 5.9)
    _, same, _ = on_grid({"a": (time, values)}, 10.0)
    np.testing.assert_array_equal(same["a"], values)
    _, finer, _ = on_grid({"a": (time, values)}, 20.0)
    # One and two samples between gaps have no curve through them.
    np.testing.assert_array_equal(np.flatnonzero(~np.isnan(finer["a"][39:51])), [3, 7, 9])


def test_time_must_increase():
    time = sampled(100.0, 1.0)
    time[6] = 0.03
    match = "channel 'b': time must increase.*at sample 6 it goes from 0.05 to"
    with pytest.raises(rx.DataError, match=match):
        on_grid({"a": (time[:5], time[:5]), "b": (time, time)}, 100.0)


@pytest.mark.parametrize(
    ("time", "values", "match"),
    [
        ([0.0, np.nan, 2.0], [1.0, 2.0, 3.0], "no finite time at 1 sample.*first at sample 1"),
        ([0.0, 1.0, 2.0], [1.0, np.inf, 3.0], "no finite value at 1 sample.*first at sample 1"),
        ([0.0, 1.0, 2.0], [1.0, 2.0], "3 times and 2 values"),
        ([0.0], [1.0], "at least two samples"),
        ([0.0, 1.0], [np.nan, np.nan], "no number at all"),
        (
            [0.0, 1e7],
            [1.0, 1.0],
            r"1e\+08 samples.* of 2 that were recorded.* about 17 GB of memory\. Cho",
        ),
        ([0.0, 0.05], [1.0, 1.0], "no time in common at 10 Hz"),
    ],
)
def test_channels_that_cannot_be_used(time, values, match):
    with pytest.raises(rx.DataError, match=match):
        on_grid({"a": (np.array(time), np.array(values))}, 10.0)


def turning(time: np.ndarray) -> np.ndarray:
    return 9 + 8.6 * np.cos(2 * np.pi * time / 130)


def by_event(longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Times of a shaft's marks and its speed, which creeps twice, with a stop of so many s."""
    time = sampled(500.0, 400.0)
    speed = turning(time)
    angle = scipy.interpolate.CubicSpline(time, speed).antiderivative()(time)
    marks = np.interp(np.arange(0, angle[-1], 0.7), angle, time)
    return marks + longest * (marks > 200), turning(marks)


@pytest.mark.parametrize("longest", [0.0, 30.0])
@pytest.mark.parametrize("rate", [3.0, 20.0])
def test_rows_by_event_keep_all_but_what_is_a_pause(tmp_path, rate, longest):
    time, speed = by_event(longest)
    assert np.ptp(np.diff(time)) > 15 * np.median(np.diff(time))
    grid, columns, words = on_grid({"w": (time, speed)}, rate)
    off = columns["w"] - turning(grid - longest * (grid > 200 + longest / 2))
    known = ~np.isnan(off)
    assert np.max(np.abs(off[known])) < 2e-3
    # A low-pass reaches 26 samples of the grid to each side of an end or a gap.
    lost = (2 + 2 * (longest > 0)) * 26 / rate + (longest > 0) * np.max(np.diff(time))
    assert known.sum() / rate > time[-1] - time[0] - lost - 4 / rate
    said = float(words[-1].split()[0])
    assert said == pytest.approx(time[-1] - time[0] - known.sum() / rate, abs=2 / rate)
    assert any("w: 1 step(s) of up to 31.1" in each for each in words) == (longest > 0)
    file = tmp_path / "turns.csv"
    np.savetxt(file, np.stack([time, speed], 1), delimiter=",", header="t,w", comments="")
    steps = rx.read_recording(file, resample=rate).steps
    assert set(words) < set(steps)

"""Steps in their order, cuts, and records split in two."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

import riecjax as rx
from riecjax.records.preparation.steps import prepare
from riecjax.settings import Prepare

RATE = 1000.0
TIME = np.arange(4000) / RATE
AXIS = rx.Model("axis", "", derived={"dq": "q", "ddq": "dq"})


def record(**signals: np.ndarray) -> rx.Record:
    return rx.Record(signals, 1 / RATE)


def test_prepare_filters_then_differentiates_then_thins_out():
    rng = np.random.default_rng(2)
    q = np.sin(9 * TIME) + 1e-3 * rng.normal(size=4000)
    prepared, _ = prepare(record(q=q), AXIS.derived, Prepare(cutoffs={"q": 100.0}, every=10))
    smooth = scipy.signal.filtfilt(*scipy.signal.butter(4, 100.0, fs=RATE), q)[50:-50]  # pyright: ignore
    velocity = np.gradient(smooth, 1 / RATE, edge_order=2)
    acceleration = np.gradient(velocity, 1 / RATE, edge_order=2)
    assert float(prepared.time_step) == pytest.approx(0.01, rel=1e-12)
    np.testing.assert_allclose(prepared["q"], smooth[::10], rtol=0, atol=1e-9)
    np.testing.assert_allclose(prepared["dq"], velocity[::10], rtol=0, atol=1e-7)
    # Each difference divides the filter's rounding of 1e-11 by the step of 1e-3.
    np.testing.assert_allclose(prepared["ddq"], acceleration[::10], rtol=0, atol=1e-5)


def test_every_step_of_a_preparation_is_taken_in_order():
    cut = Prepare(start=1.0, stop=3.0, offsets=("q",), drifts=("p",), upsample=2, every=4)
    asked = replace(cut, derivatives={"v": "q"})
    prepared, words = prepare(record(q=5 + np.sin(9 * TIME), p=TIME), {}, asked)
    assert [word.split()[0] for word in words] == ["cut", "q:", "p:", "band-limited", "v:", "one"]
    assert float(prepared.time_step) == pytest.approx(2 / RATE)
    # 44 samples are lost at either end of the cut record to the interpolation.
    assert float(prepared.time[0]) == pytest.approx(1.044)
    mean = 5 + np.sin(9 * TIME[1000:3001]).mean()
    expected = 5 + np.sin(9 * np.asarray(prepared.time)) - mean
    np.testing.assert_allclose(prepared["q"], expected, atol=1e-6)
    np.testing.assert_allclose(prepared["p"], 0, atol=1e-9)
    np.testing.assert_allclose(prepared["v"][1:-1], 9 * np.cos(9 * prepared.time)[1:-1], atol=1e-3)


EPOCH = 1.7e9


def test_a_cut_counts_from_the_first_sample_whatever_its_stamp():
    stamped = rx.Record.from_samples({"q": TIME}, time=EPOCH + TIME)
    prepared, words = prepare(stamped, {}, Prepare(start=1.0, stop=2.5))
    np.testing.assert_allclose(np.asarray(prepared["q"])[[0, -1]], [1.0, 2.5])
    assert words == ["cut from 1 s to 2.5 s"]
    # The recording's clock goes on, and its own stamps are kept.
    # Their rounding, 2.4e-7 s, is in the time step.
    np.testing.assert_allclose(np.asarray(prepared.elapsed)[[0, -1]], [1.0, 2.5], atol=3e-7)
    assert float(prepared.start_time) == pytest.approx(EPOCH + 1.0, abs=3e-7)
    again, _ = prepare(prepared, {}, Prepare(start=2.0))
    assert float(again["q"][0]) == 2.0


VALUES = np.arange(100.0)


def numbered(values: np.ndarray = VALUES) -> rx.Record:
    return rx.Record.from_samples({"q": values}, time=2.0 + 0.1 * np.arange(values.size))


@pytest.mark.parametrize(("share", "held_out"), [(0.3, 30), (0.5, 50), (0.021, 2), (0.978, 98)])
def test_the_last_share_is_held_out(share, held_out):
    estimation, validation = rx.split(numbered(), share)
    np.testing.assert_array_equal(estimation["q"], VALUES[: 100 - held_out])
    np.testing.assert_array_equal(validation["q"], VALUES[100 - held_out :])
    np.testing.assert_allclose(validation.time[0], 2 + 0.1 * (100 - held_out))


def test_pauses_stay_where_they_are():
    stamps = np.concatenate([np.arange(50) / 10, 60 + np.arange(50) / 10])
    paused = rx.Record.from_samples({"q": VALUES}, time=stamps)
    estimation, validation = rx.split(paused, 0.3)
    assert estimation.segments() == [slice(0, 50), slice(51, 71)]
    assert validation.segments() == [slice(0, 30)]
    np.testing.assert_allclose(validation.time, 62 + np.arange(30) / 10)


@pytest.mark.parametrize("share", [0.0, 1.0, -0.1, 2.0, np.nan, 0.01, 0.99])
def test_impossible_share(share):
    why = "without two samples" if share in (0.01, 0.99) else "between 0 and 1"
    with pytest.raises(rx.DataError, match=why):
        rx.split(numbered(), share)


def test_a_part_without_any_sample_of_a_signal():
    values = VALUES.copy()
    values[:40] = np.nan
    with pytest.raises(rx.DataError, match="the estimation part holds no sample of 'q'"):
        rx.split(numbered(values), 0.7)


def test_the_slope_of_a_signal_that_is_held_is_of_the_rows_at_which_it_is_new(tmp_path):
    time = 0.005 * np.arange(4000)
    held = np.repeat(np.sin(2 * np.pi * time[::2]), 2) + 0.002 * np.repeat(
        np.random.default_rng(1).normal(size=2000), 2
    )
    file = tmp_path / "a.csv"
    np.savetxt(file, np.stack([time, held], 1), delimiter=",", header="t,x", comments="")
    model = rx.Model("m", "m", stages=rx.Equation(rx.Term("k", "x")), derived={"dx": "x"})
    record = rx.read_recording(file, model=model, every=2).record
    expected = 2 * np.pi * np.cos(2 * np.pi * np.asarray(record.time))
    assert np.std(np.asarray(record["dx"]) - expected) < 0.04 * np.std(expected)

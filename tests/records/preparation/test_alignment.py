"""Signals that are shifted in time, against motion whose value at any time is exact."""

import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.models.catalogue import find_model
from riecjax.records.noise import Noise
from riecjax.records.preparation.alignment import align, declared_pairs, set_clocks, shift
from riecjax.records.record import Record, samples_with_nan
from riecjax.records.recording import read_recording

STEP = 0.005
TIME = STEP * np.arange(4000)
OMEGA = 2 * np.pi * np.array([0.31, 0.83, 1.7, 2.9])


def motion(time: np.ndarray, order: int = 0) -> np.ndarray:
    return np.sum(OMEGA**order * np.cos(np.outer(time, OMEGA) + 0.5 * np.pi * order), axis=1)


def recorded(noise: float = 0.0, seed: int = 0, count: int = TIME.size, **late: float) -> Record:
    """Position q, velocity dq and acceleration ddq, each so many samples late."""
    rng, signals = np.random.default_rng(seed), {}
    for order, name in enumerate(("q", "dq", "ddq")):
        values = motion(TIME[:count] - STEP * late.get(name, 0.0), order)
        signals[name] = values + noise * values.std() * rng.normal(size=count)
    return Record.from_samples(signals, time_step=STEP)


PAIRS = [("q", "dq"), ("dq", "ddq")]


@pytest.mark.parametrize("count", [4000, 300])
@pytest.mark.parametrize("late", [3.0, -2.0, 0.37, -5.81])
def test_a_shifted_signal_is_what_it_was_so_much_later(late, count):
    record = recorded(count=count, q=late)
    shifted = shift(record, {"q": late * STEP})
    time = STEP * np.round(np.asarray(shifted.elapsed) / STEP)
    np.testing.assert_allclose(shifted["q"], motion(time), atol=1e-6)
    np.testing.assert_allclose(shifted["dq"], motion(time, 1), atol=1e-9)
    assert record.sample_count - shifted.sample_count < (15 if count == 300 else 100)


def test_gaps_grow_by_what_cannot_be_computed():
    q = motion(TIME - 0.5 * STEP)
    q[2000:2010] = np.nan
    shifted = shift(Record.from_samples({"q": q}, time_step=STEP), {"q": 0.5 * STEP})
    values, time = samples_with_nan(shifted, "q"), np.asarray(shifted.elapsed)
    there = ~np.isnan(values)
    np.testing.assert_allclose(values[there], motion(time[there]), atol=1e-6)
    assert 10 < np.sum(~there) < 110


def test_noise_goes_on_with_its_size():
    noise = np.random.default_rng(0).normal(size=4000)
    record = Record.from_samples({"q": noise}, time_step=STEP)
    record = record.with_noise(Noise.given({"q": 1.0}))
    for late in (0.5, 0.2, 3.0):
        shifted = shift(record, {"q": late * STEP})
        std = float(shifted.noise.std("q"))
        assert std == pytest.approx(np.std(np.asarray(shifted["q"])), rel=0.04)


@pytest.mark.parametrize("seconds", [np.nan, np.inf, 11.0])
def test_impossible_shifts(seconds):
    with pytest.raises(DataError, match="half the record"):
        shift(recorded(), {"q": seconds})


@pytest.mark.parametrize("ppm", [500.0, -2000.0])
def test_a_signal_of_another_clock_is_brought_to_the_records(ppm):
    slow = motion(TIME * (1 - 1e-6 * ppm))
    slow[1500:1510] = np.nan
    record = Record.from_samples({"q": slow, "dq": motion(TIME, 1)}, time_step=STEP)
    # What was cut off before counts: clocks part from the recording's first sample on.
    for start in (0, 700):
        set_ = set_clocks(record.part(start, TIME.size), {"q": ppm})
        values, time = samples_with_nan(set_, "q"), np.asarray(set_.elapsed)
        there = ~np.isnan(values)
        # Of the advance itself, by millionths of the time, 1e-3 of a per mille is left.
        exact = motion(time[there] * (1 - (1e-6 * ppm) ** 2))
        np.testing.assert_allclose(values[there], exact, atol=1e-5)
        np.testing.assert_allclose(set_["dq"], motion(time, 1), atol=1e-9)
        assert 50 < np.sum(~there) < 110
        assert record.sample_count - start - set_.sample_count < 110


def test_noise_of_another_clock_goes_on_with_its_size():
    noise = np.random.default_rng(0).normal(size=4000)
    record = Record.from_samples({"q": noise}, time_step=STEP)
    found = set_clocks(record.with_noise(Noise.given({"q": 1.0})), {"q": 3000.0})
    assert float(found.noise.std("q")) == pytest.approx(np.std(np.asarray(found["q"])), rel=0.04)


@pytest.mark.parametrize(
    ("ppm", "count", "said"), [(np.nan, 4000, "no clock"), (1e5, 4000, "10"), (50.0, 80, "long")]
)
def test_impossible_clocks(ppm, count, said):
    with pytest.raises(DataError, match=said):
        set_clocks(recorded(count=count), {"q": ppm})


@pytest.mark.no_finding("late_signal")
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_what_is_in_time_stays(noise):
    record = recorded(noise)
    assert align(record, PAIRS).record is record


@pytest.mark.raises_finding("late_signal")
@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize(
    "late", [{"dq": 1.0}, {"q": 0.6}, {"dq": 0.6, "ddq": 1.3}, {"q": 2.0, "dq": 1.0}]
)
def test_the_later_ones_are_brought_forward_to_the_earliest(noise, late):
    found = align(recorded(noise, **late), PAIRS)
    assert {finding.signals[0] for finding in found.findings} == set(late)
    assert all(finding.doubt == 0 for finding in found.findings)
    for words in found.words:
        name, _, seconds = words.partition(": advanced by ")
        assert float(seconds.split()[0]) == pytest.approx(STEP * late[name], abs=0.1 * STEP)
    assert align(found.record, PAIRS).record is found.record


def test_one_that_is_named_is_shifted_either_way():
    late = recorded(0.01, dq=0.8)
    assert align(late, PAIRS, "none").record is late
    (words,) = align(late, PAIRS, ("q",)).words
    assert float(words.split()[-2]) == pytest.approx(-0.8 * STEP, abs=0.1 * STEP)
    with pytest.raises(DataError, match="cannot be aligned"):
        align(late, PAIRS, ("force",))
    with pytest.raises(DataError, match="'auto'"):
        align(late, PAIRS, "always")


def test_a_wrong_sign_is_no_delay():
    late = recorded()
    turned = late.with_signals({"dq": -late["dq"]})
    assert align(turned, [("q", "dq")]).record is turned


def test_a_file_is_aligned_as_its_model_pairs_its_signals(tmp_path):
    model = find_model("emps")
    assert ("q", "dq") in declared_pairs(model)
    late = recorded(0.005, dq=1.0)
    columns = {"t": TIME, "q": late["q"], "dq": late["dq"], "force": np.ones(TIME.size)}
    table = np.column_stack(list(columns.values()))
    file = tmp_path / "drive.csv"
    np.savetxt(file, table, delimiter=",", header=",".join(columns), comments="")
    read = read_recording(file, model=model)
    assert [finding.code for finding in read.findings] == ["late_signal"]
    assert any(step.startswith("dq: advanced by 0.00") for step in read.steps)
    assert read_recording(file, model=model, align="none").findings == ()
    by_hand = read_recording(file, model=model, shifts={"dq": STEP})
    assert [f.code for f in by_hand.findings] == []
    assert "advanced: dq by 0.005 s" in by_hand.steps

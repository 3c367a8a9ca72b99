"""Signals that are shifted in time, against motion whose value at any time is exact."""

import numpy as np
import pytest

import riecjax as rx
from riecjax.doubts import align
from riecjax.errors import DataError
from riecjax.records.preparation.resampling import set_clocks
from riecjax.records.record import Record

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


@pytest.mark.parametrize("ppm", [500.0, -2000.0])
def test_a_signal_of_another_clock_is_brought_to_the_records(ppm):
    slow = motion(TIME * (1 - 1e-6 * ppm))
    slow[1500:1510] = np.nan
    record = Record.from_samples({"q": slow, "dq": motion(TIME, 1)}, time_step=STEP)
    # What was cut off before counts: clocks part from the recording's first sample on.
    for start in (0, 700):
        set_ = set_clocks(record.part(start, TIME.size), {"q": ppm})
        values, time = set_.signal("q").with_nan, np.asarray(set_.elapsed)
        there = ~np.isnan(values)
        # Of the advance itself, by millionths of the time, 1e-3 of a per mille is left.
        exact = motion(time[there] * (1 - (1e-6 * ppm) ** 2))
        np.testing.assert_allclose(values[there], exact, atol=1e-5)
        np.testing.assert_allclose(set_["dq"], motion(time, 1), atol=1e-9)
        most = 1e-6 * abs(ppm) * TIME.size + 1
        assert 10 <= np.sum(~there) <= 14
        assert record.sample_count - start - set_.sample_count <= most


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


def test_an_equation_says_which_signals_belong_together_when_a_file_is_read(tmp_path):
    record, file = recorded(0.01, dq=2.0), tmp_path / "axis.csv"
    table = np.stack([TIME, record["q"], record["dq"]], axis=1)
    np.savetxt(file, table, delimiter=",", header="t,q,dq", comments="")
    axis = rx.Equation(rx.Term("k", "q", measured=("dq",)), -rx.Term(1.0, "dq"))
    for model in (axis, rx.staged(axis)):
        _, words, *_ = rx.read_recording(file, model=model).steps
        assert words.startswith("dq: advanced by 0.0")

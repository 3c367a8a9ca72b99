import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.records.preparation.filtering import central_difference, differentiate
from riecjax.records.record import Record

RATE = 1000.0
TIME = np.arange(4000) / RATE


def test_differences_are_exact_for_parabolas_at_the_ends_too():
    values = 3 - 2 * TIME + 5 * TIME**2
    derived = differentiate(Record({"q": values}, 1 / RATE, units={"q": "m"}), "q", "dq")
    np.testing.assert_allclose(derived["dq"], -2 + 10 * TIME, rtol=0, atol=1e-10)
    assert dict(derived.units)["dq"] == "m/s"


def test_differences_agree_with_numpy():
    values = np.random.default_rng(1).normal(size=50)
    np.testing.assert_allclose(
        central_difference(values, 0.1),
        np.gradient(values, 0.1, edge_order=2),
        rtol=1e-12,
    )


def test_difference_of_two_samples():
    derived = differentiate(Record({"q": np.array([1.0, 3.0])}, 0.5), "q", "dq")
    assert derived["dq"].tolist() == [4.0, 4.0]


def test_differences_never_reach_across_a_gap_or_a_pause():
    stamps = np.concatenate([TIME[:500], 9 + TIME[:500]])
    values = 3 * stamps**2
    values[:300] += 1e6
    values[300:310] = np.nan
    broken = Record.from_samples({"q": values}, time=stamps)
    derived = differentiate(broken, "q", "dq")
    assert derived.segments(["dq"]) == broken.segments(["q"]) == derived.segments(["q"])
    there = np.asarray(derived.present(["dq"]))
    expected = 6 * np.asarray(derived.time)[there]
    np.testing.assert_allclose(derived["dq"][there], expected, rtol=0, atol=1e-6)


def test_one_sample_between_gaps_has_no_slope_and_two_have_one():
    values = np.array([0.0, 1.0, np.nan, 5.0, np.nan, 7.0, 9.0])
    derived = differentiate(Record.from_samples({"q": values}, time_step=1.0), "q", "dq")
    assert derived.segments(["dq"]) == [slice(0, 2), slice(5, 7)]
    assert derived["dq"].tolist() == [1.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0]


def test_no_two_samples_in_succession():
    values = np.array([0.0, np.nan, 1.0, np.nan])
    with pytest.raises(DataError, match="'q' has no derivative"):
        differentiate(Record.from_samples({"q": values}, time_step=1.0), "q", "dq")


def test_derivative_of_a_missing_signal():
    with pytest.raises(DataError, match="no signal 'speed'"):
        differentiate(Record({"q": TIME}, 1 / RATE), "speed", "dq")

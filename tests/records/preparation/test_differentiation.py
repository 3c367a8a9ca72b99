import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.records.preparation.filtering import differentiate
from riecjax.records.record import Record

RATE = 1000.0
TIME = np.arange(4000) / RATE


def test_differences_are_exact_for_parabolas_at_the_ends_too():
    values = 3 - 2 * TIME + 5 * TIME**2
    derived = differentiate(Record({"q": values}, 1 / RATE, units={"q": "m"}), "q", "dq")
    np.testing.assert_allclose(derived["dq"], -2 + 10 * TIME, rtol=0, atol=1e-10)
    assert dict(derived.units)["dq"] == "m/s"


def test_difference_of_two_samples():
    derived = differentiate(Record({"q": np.array([1.0, 3.0])}, 0.5), "q", "dq")
    assert derived["dq"].tolist() == [4.0, 4.0]


def test_one_sample_between_gaps_has_no_slope_and_two_have_one():
    values = np.array([0.0, 1.0, np.nan, 5.0, np.nan, 7.0, 9.0])
    derived = differentiate(Record.from_samples({"q": values}, time_step=1.0), "q", "dq")
    assert derived.segments(["dq"]) == [slice(0, 2), slice(5, 7)]
    assert derived["dq"].tolist() == [1.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0]


def test_no_two_samples_in_succession():
    values = np.array([0.0, np.nan, 1.0, np.nan])
    with pytest.raises(DataError, match="'q' has no derivative"):
        differentiate(Record.from_samples({"q": values}, time_step=1.0), "q", "dq")

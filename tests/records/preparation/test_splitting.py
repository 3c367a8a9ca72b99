import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.records.preparation.steps import split, split_at
from riecjax.records.record import Record

VALUES = np.arange(100.0)


def record(values: np.ndarray = VALUES) -> Record:
    return Record.from_samples({"q": values}, time=2.0 + 0.1 * np.arange(values.size))


@pytest.mark.parametrize(("share", "held_out"), [(0.3, 30), (0.5, 50), (0.021, 2), (0.978, 98)])
def test_the_last_share_is_held_out(share, held_out):
    estimation, validation = split(record(), share)
    np.testing.assert_array_equal(estimation["q"], VALUES[: 100 - held_out])
    np.testing.assert_array_equal(validation["q"], VALUES[100 - held_out :])
    np.testing.assert_allclose(validation.time[0], 2 + 0.1 * (100 - held_out))


@pytest.mark.parametrize(("seconds", "first"), [(7.0, 50), (7.01, 51), (2.2, 2), (11.8, 98)])
def test_split_at_a_time_on_the_records_clock(seconds, first):
    estimation, validation = split_at(record(), seconds)
    assert estimation.sample_count == first
    assert validation["q"][0] == first


def test_pauses_stay_where_they_are():
    stamps = np.concatenate([np.arange(50) / 10, 60 + np.arange(50) / 10])
    paused = Record.from_samples({"q": VALUES}, time=stamps)
    estimation, validation = split_at(paused, 62.0)
    assert estimation.segments() == [slice(0, 50), slice(51, 71)]
    assert validation.segments() == [slice(0, 30)]
    np.testing.assert_allclose(validation.time, 62 + np.arange(30) / 10)


@pytest.mark.parametrize("share", [0.0, 1.0, -0.1, 2.0, np.nan])
def test_impossible_share(share):
    with pytest.raises(DataError, match="between 0 and 1"):
        split(record(), share)


@pytest.mark.parametrize("seconds", [0.0, 2.05, 11.85, 50.0])
def test_a_time_outside(seconds):
    with pytest.raises(DataError, match="without two samples"):
        split_at(record(), seconds)


def test_a_part_without_any_sample_of_a_signal():
    values = VALUES.copy()
    values[:40] = np.nan
    with pytest.raises(DataError, match="the estimation part holds no sample of 'q'"):
        split(record(values), 0.7)

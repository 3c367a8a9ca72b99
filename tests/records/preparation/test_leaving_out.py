"""What a sensor could not show is marked as missing: stuck, and at the end of its range."""

import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.records.faults.signals import check_signals
from riecjax.records.preparation.repair import leave_out
from riecjax.records.record import Record, samples_with_nan

COUNT, STEP = 4000, 0.005
TIME = STEP * np.arange(COUNT)
TONES = np.array([0.4, 0.9, 1.3, 2.2, 2.9])


def motion(seed: int, noise: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, TONES.size)
    values = np.sin(2 * np.pi * np.outer(TIME, TONES) + phases).sum(1)
    return values + noise * np.std(values) * rng.normal(size=COUNT)


def recorded(x: np.ndarray) -> Record:
    return Record.from_samples({"x": x, "y": motion(1, 0.01)}, time_step=STEP)


def gone(record: Record) -> np.ndarray:
    return np.flatnonzero(np.isnan(samples_with_nan(leave_out(record, "x"), "x")))


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_stretch_of_one_value(noise):
    x = motion(0, noise)
    x[1000:1400] = x[1000]
    record = recorded(x)
    np.testing.assert_array_equal(gone(record), np.arange(1000, 1400))
    assert {f.code for f in check_signals(record, ["x"])} == {"stuck_sensor"}
    after = check_signals(leave_out(record, "x"), ["x"])
    assert [f.code for f in after] == ["missing_samples"]


@pytest.mark.parametrize("share", [0.6, 0.8])
def test_the_ends_of_a_converters_range(share):
    x = motion(0, 0.01)
    limit = share * np.max(np.abs(x))
    record = recorded(np.clip(x, -limit, limit))
    np.testing.assert_array_equal(gone(record), np.flatnonzero(np.abs(x) >= limit))
    assert "clipped" not in {f.code for f in check_signals(leave_out(record, "x"), ["x"])}


def test_an_amplifiers_limit_under_the_converters_noise():
    exact, noise = motion(0), 0.02 * np.std(motion(0))
    limit = 0.7 * np.max(np.abs(exact))
    white = noise * np.random.default_rng(5).normal(size=COUNT)
    record = recorded(np.clip(exact, -limit, limit) + white)
    left_out = np.zeros(COUNT, bool)
    left_out[gone(record)] = True
    at_limit = np.abs(exact) >= limit
    # All but what noise takes three deviations below the limit, and little else.
    assert np.mean(left_out[at_limit]) > 0.99
    assert np.mean(left_out[np.abs(exact) < limit - 6 * noise]) == 0.0


def test_what_is_sound_stays():
    record = recorded(motion(0, 0.01))
    assert gone(record).size == 0
    assert not leave_out(record, "x").missing


def test_what_was_missing_stays_so():
    x = motion(0, 0.01)
    x[1000:1400] = x[1000]
    x[2000:2010] = np.nan
    expected = np.concatenate([np.arange(1000, 1400), np.arange(2000, 2010)])
    np.testing.assert_array_equal(gone(recorded(x)), expected)


def test_no_signal_or_an_unknown_one():
    with pytest.raises(DataError, match="name the signals"):
        leave_out(recorded(motion(0)))
    with pytest.raises(DataError, match="no signal 'z'"):
        leave_out(recorded(motion(0)), "z")

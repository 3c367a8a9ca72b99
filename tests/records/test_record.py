import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.records.record import Record, stack_records


def ramp(count=5):
    return np.arange(float(count))


def test_samples_time_and_units_are_kept():
    time = 2.0 + 0.25 * ramp()
    record = Record.from_samples({"x": ramp() ** 2}, time=time, units={"x": "m", "other": "N"})
    np.testing.assert_array_equal(record["x"], ramp() ** 2)
    np.testing.assert_allclose(record.time, time, rtol=1e-15)
    assert float(record.time_step) == 0.25
    assert float(record.start_time) == 2.0
    assert float(record.duration) == 1.0
    assert record.sample_count == 5
    assert record.units == (("x", "m"),)


def test_integer_samples_become_floats():
    record = Record.from_samples({"x": [1, 2, 3]}, time_step=1)
    assert record["x"].dtype == jnp.float64


def test_time_stamps_rounded_to_a_tenth_of_a_percent_of_the_step_are_even():
    exact = ramp(1000) / 300.0
    record = Record.from_samples({"x": ramp(1000)}, time=np.round(exact, 6))
    assert float(record.time_step) == pytest.approx(1 / 300, rel=1e-6)


def signals_with(value, at):
    samples = ramp()
    samples[at] = value
    return {"x": samples}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (dict(signals=signals_with(np.nan, 3), time_step=1.0), ["'x'", "at sample 3", "repair"]),
        (dict(signals=signals_with(np.inf, 0), time_step=1.0), ["'x'", "at sample 0"]),
        (
            dict(signals={"x": ramp()}, time=[0, 1, np.nan, 3, 4]),
            ["'t'", "at sample 2"],
        ),
        (
            dict(signals={"x": ramp()}, time=[0, 1, 1, 2, 3]),
            ["must increase", "at sample 2", "from 1 to 1", "Sort"],
        ),
        (dict(signals={"x": ramp()}, time=[0, 1, 3, 2, 4]), ["must increase", "at sample 3"]),
        (
            dict(signals={"x": ramp()}, time=[0, 1, 2, 3, 4.1]),
            ["evenly spaced", "from 1 to 1.1", "Resample"],
        ),
        (dict(signals={"x": ramp(4)}, time=ramp(5)), ["same length", "x 4"]),
        (dict(signals={"x": ramp(4), "y": ramp(5)}, time_step=1.0), ["x 4", "y 5"]),
        (dict(signals={"x": [1.0]}, time=[0.0]), ["at least two samples"]),
        (dict(signals={"x": [1.0]}, time_step=1.0), ["at least two samples"]),
        (dict(signals={}, time=ramp()), ["at least one signal"]),
        (dict(signals={"x": ramp()}), ["either the time of each sample or the time step"]),
        (dict(signals={"x": ramp()}, time=ramp(), time_step=1.0), ["not both"]),
        (dict(signals={"x": ramp()}, time_step=0.0), ["positive", "got 0"]),
        (dict(signals={"x": ramp()}, time_step=-1.0), ["positive", "got -1"]),
        (dict(signals={"x": ramp()}, time_step=np.nan), ["positive", "got nan"]),
        (dict(signals={"x": ramp()[:, None]}, time_step=1.0), ["one column", "(5, 1)"]),
        (dict(signals={"x": ["a", "b"]}, time_step=1.0), ["'x'", "not a list of numbers"]),
    ],
)
def test_bad_data_is_refused_in_one_line_that_says_where(arguments, words):
    with pytest.raises(DataError) as caught:
        Record.from_samples(**arguments)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_missing_signal_is_answered_with_those_that_exist_and_a_remedy():
    record = Record.from_samples({"x": ramp(), "y": ramp()}, time_step=1.0)
    with pytest.raises(DataError, match=r"no signal 'z'; it has: x, y\. .*--map z=COLUMN"):
        record["z"]


def test_part_shifts_the_start_time():
    record = Record.from_samples({"x": ramp(10)}, time=5 + 0.5 * ramp(10)).part(4, 7)
    np.testing.assert_array_equal(record["x"], [4, 5, 6])
    np.testing.assert_allclose(record.time, [7, 7.5, 8])


@pytest.mark.parametrize(("start", "stop"), [(-1, 3), (3, 3), (0, 11)])
def test_a_part_beyond_the_record_is_refused(start, stop):
    record = Record.from_samples({"x": ramp(10)}, time_step=1.0)
    with pytest.raises(DataError, match="record of 10 samples"):
        record.part(start, stop)


def test_added_signals_keep_the_rest_and_selected_ones_drop_it():
    record = Record.from_samples({"x": ramp()}, time=3 + ramp(), units={"x": "m"})
    both = record.with_signals({"y": jnp.ones(5)}, {"y": "N"})
    assert set(both.signals) == {"x", "y"}
    assert dict(both.units) == {"x": "m", "y": "N"}
    alone = both.select("y")
    assert set(alone.signals) == {"y"}
    assert dict(alone.units) == {"y": "N"}
    assert float(alone.start_time) == 3.0


def test_a_record_passes_through_jit_and_vmap():
    records = [Record.from_samples({"x": k * ramp()}, time_step=0.1 * k) for k in (1.0, 2.0)]
    durations = jax.jit(jax.vmap(lambda r: r.duration * r["x"][-1]))(stack_records(records))
    np.testing.assert_allclose(durations, [0.4 * 4, 0.8 * 8])

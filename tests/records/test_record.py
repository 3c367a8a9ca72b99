from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.records.linear_op import LinearOp
from riecjax.records.record import Record, stack_records
from riecjax.records.signal import Noise, Signal


def ramp(count=5):
    return np.arange(float(count))


def test_samples_time_and_units_are_kept():
    time = 2.0 + 0.25 * ramp()
    record = Record.from_samples({"x": ramp() ** 2}, time=time, units={"x": "m"})
    np.testing.assert_array_equal(record["x"], ramp() ** 2)
    np.testing.assert_allclose(record.time, time, rtol=1e-15)
    assert float(record.time_step) == 0.25
    assert float(record.start_time) == 2.0
    assert float(record.duration) == 1.0
    assert record.sample_count == 5
    assert record.units == (("x", "m"),)


def signals_with(value, at):
    samples = ramp()
    samples[at] = value
    return {"x": samples}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (dict(signals={"x": np.full(5, np.nan)}, time_step=1.0), ["'x'", "no number at all"]),
        (dict(signals=signals_with(np.inf, 0), time_step=1.0), ["'x'", "at sample 0"]),
        (
            dict(signals={"x": ramp()}, time=[0, 1, np.nan, 3, 4]),
            ["time is missing at 1", "at sample 2"],
        ),
        (
            dict(signals={"x": ramp()}, time=[0, 1, 1, 2, 3]),
            ["must increase", "at sample 2", "from 1 to 1", "Sort"],
        ),
        (
            dict(signals={"x": ramp()}, time=[0, 1, 2, 3, 4.15]),
            ["evenly spaced", "from 1 to 1.15", "Resample"],
        ),
        (dict(signals={"x": ramp(4)}, time=ramp(5)), ["same length", "x 4"]),
        (dict(signals={"x": ramp(4), "y": ramp(5)}, time_step=1.0), ["x 4", "y 5"]),
        (dict(signals={"x": [1.0]}, time_step=1.0), ["at least two samples"]),
        (dict(signals={"x": ramp()}, time_step=1.0, units={"y": "m"}), ["unit", "'y'", "are: x"]),
        (dict(signals={}, time=ramp()), ["at least one signal"]),
        (dict(signals={"x": ramp()}), ["either the time of each sample or the time step"]),
        (dict(signals={"x": ramp()}, time=ramp(), time_step=1.0), ["not both"]),
        (dict(signals={"x": ramp()}, time_step=np.nan), ["positive", "got nan"]),
        (dict(signals={"x": ramp()[:, None]}, time_step=1.0), ["one column", "(5, 1)"]),
        (dict(signals={"x": ["a", "b"]}, time_step=1.0), ["'x'", "not a list of numbers"]),
        (dict(signals={"x": [[1, 2], [3]]}, time_step=1.0), ["'x'", "not a list of numbers"]),
        (
            dict(signals={"x": np.arange(2).astype("datetime64[s]")}, time_step=1.0),
            ["'x'", "of datetime64[s]", "convert it"],
        ),
        (dict(signals={1: ramp()}, time_step=1.0), ["signal's name is an int"]),
        (dict(signals={"": ramp()}, time_step=1.0), ["signal's name is empty"]),
        (dict(signals={"x": 1j * ramp()}, time_step=1.0), ["'x'", "complex", "real or imaginary"]),
    ],
)
def test_bad_data_is_refused_in_one_line_that_says_where(arguments, words):
    with pytest.raises(DataError) as caught:
        Record.from_samples(**arguments)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("values", [1j * ramp(), jnp.asarray(1j * ramp()), ["a", "b"]])
@pytest.mark.parametrize("kind", [lambda values: values, Signal])
def test_a_record_of_arrays_refuses_what_are_no_real_numbers(values, kind):
    with pytest.raises(DataError, match=r"signal 'x' (holds complex numbers|is not a list)"):
        Record({"x": kind(values)}, 1.0)


@pytest.mark.parametrize("count", [100, 4096])
@pytest.mark.parametrize(
    "make", [lambda x: Record({"x": x}, 1.0), lambda x: Record.from_samples({"x": x}, time_step=1)]
)
def test_a_record_does_not_change_with_the_array_it_was_made_of(make, count):
    # On an address that JAX would take over as it is.
    room = np.zeros(8 * count + 64, np.uint8)
    values = room[-room.ctypes.data % 64 :][: 8 * count].view(float)
    values[:] = np.arange(count)
    record = make(values)
    values *= 7
    np.testing.assert_array_equal(record["x"], np.arange(count))


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
    both = record.with_signals({"y": Signal(jnp.ones(5), unit="N")})
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


def test_missing_samples_are_marked_and_hold_the_last_value():
    record = Record.from_samples({"x": [np.nan, 1, np.nan, np.nan, 4], "y": ramp()}, time_step=1.0)
    np.testing.assert_array_equal(record["x"], [1, 1, 1, 1, 4])
    np.testing.assert_array_equal(record.signal("x").with_nan, [np.nan, 1, np.nan, np.nan, 4])
    assert record.present(["y"]) is None
    np.testing.assert_array_equal(record.present(["x", "y"]), [0, 1, 0, 0, 1])
    assert record.segments(["x"]) == [slice(1, 2), slice(4, 5)]
    assert record.segments(["y"]) == [slice(0, 5)]


X, Y = np.array([[np.nan, 1, 2, 3, 4], [0, np.nan, 2, np.nan, 4]])


@pytest.mark.parametrize("samples", [[0.0, np.nan, 2.0], np.ma.masked_equal([0.0, 9.0, 2.0], 9)])
def test_bare_samples_are_missing_where_they_are_nan_or_masked(samples):
    empty = Record({"y": np.ones(3)}, 1.0)
    checked = Record.from_samples({"x": samples}, time_step=1.0)
    for record in (checked, Record({"x": samples}, 1.0), empty.with_signals({"x": samples})):
        assert np.asarray(record.present(["x"])).tolist() == [True, False, True]
        assert record["x"].tolist() == [0.0, 0.0, 2.0]


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda r: Record({"x": X}, 1.0, stamps=X[:3]), r"same length; .* stamps \(3,\)"),
        (lambda r: Record({"x": Signal(X, X[:3] > 0)}, 1.0), r"x.present \(3,\)"),
        (lambda r: r.with_noise(Noise.given({"q": 0.1})), "no signal 'q'"),
        (lambda r: r.with_noise({"x": 0.1}), "the noise is a dict"),
        (lambda r: r.through(LinearOp.of_values("{}", X)), "have no names"),
        (lambda r: r.through(GRID, "x"), "the same for all signals: x, y"),
        (lambda r: r.through({"x": GRID, "y": replace(GRID, spacing=0.2)}), "make the same"),
    ],
)
def test_what_a_record_cannot_be_made_of_is_said_and_nothing_is_dropped(make, says):
    with pytest.raises(DataError, match=says):
        make(Record({"x": X, "y": X}, 1.0))


GRID = LinearOp("{}: finer", lambda samples, places: samples[places.astype(int)], spacing=0.5)


@pytest.mark.parametrize(
    ("taps", "first"), [([-1.0, 1.0], -1), ([1.0], -2), ([0.5, 0.0, 2.0], 1), ([1.0, 2.0, 3.0], -1)]
)
def test_noise_goes_through_the_sums_that_samples_go_through(taps, first):
    samples = np.random.default_rng(0).normal(size=20_000)
    record = Record({"x": samples}, 1.0).with_noise(Noise.given({"x": 1.0}))
    made = record.through({"y": LinearOp.of_taps("{}", np.array(taps), first, source="x")})
    total = made.signal("x") - made.signal("y")
    assert total.noise is not None
    np.testing.assert_allclose(total.noise.std, np.std(total.values), rtol=0.03)


def test_small_integers_do_not_wrap_and_a_factor_for_each_sample_leaves_no_known_noise():
    small = Signal.of(np.array([200, 100], np.uint8), noise=Noise.given({"x": 0.1})["x"])
    assert (small + small).values.tolist() == [400.0, 200.0]
    assert (np.ones(2) * small).noise is None


@pytest.mark.parametrize("traced", [False, True])
def test_a_sum_of_signals_is_there_where_all_are_and_holds_its_last_value(traced):
    def total(x, y):
        made = 3.0 - (2 * Signal.of(x) - np.float64(0.5) * Signal.of(y)) + np.float64(0.25)
        return made.values, made.present

    some = np.array([[X, Y], [Y, Y], [Y, X], [X, X]])
    values, present = zip(*(total(x, y) for x, y in some))
    if traced:  # and batched
        values, present = jax.jit(jax.vmap(total))(some[:, 0], some[:, 1])
    for k, (x, y) in enumerate(some):
        expected = 3 - (2 * x - 0.5 * y) + 0.25
        known = ~np.isnan(expected)
        np.testing.assert_array_equal(present[k], known)
        last = [max(np.flatnonzero(known[: n + 1]), default=np.argmax(known)) for n in range(5)]
        np.testing.assert_allclose(values[k], expected[last], rtol=1e-7)


def test_the_noise_of_a_sum_is_that_of_its_sources_and_unknown_if_one_is():
    noise = Noise.given({"x": 0.3, "y": 0.4}, {("x", "y"): 0.5})
    record = Record({"x": X, "y": Y, "z": X}, 1.0).with_noise(noise)
    x, y = record.signal("x"), record.signal("y")
    assert (x + record.signal("z")).noise is None
    # Var(2 x - y) of correlated x and y; a difference of samples doubles white noise's variance.
    variance = (2 * 0.3) ** 2 + 0.4**2 - 2 * 0.5 * (2 * 0.3) * 0.4
    made = (2 * x - y).noise
    assert made is not None
    assert float(noise.std("y")) == pytest.approx(0.4)
    assert float(made.std) == pytest.approx(np.sqrt(variance))
    assert float(made.convolved(np.array([1.0, -1.0, 0.0])).std) == pytest.approx(
        np.sqrt(2 * variance)
    )


def paused(pause=5000.0):
    time = np.concatenate([0.1 * ramp(20), pause + 0.1 * ramp(10)])
    return Record.from_samples({"x": np.sin(time)}, time=time), time


@pytest.mark.parametrize("pause", [2.1, 2.137, 5000.03])
def test_a_pause_of_any_length_takes_one_sample_and_time_stays_true(pause):
    record, time = paused(pause)
    assert record.sample_count == 31
    assert record.segments() == [slice(0, 20), slice(21, 31)]
    assert float(record.time_step) == pytest.approx(0.1, rel=1e-9)
    np.testing.assert_allclose(np.delete(record.time, 20), time, rtol=1e-15)
    assert time[19] < record.time[20] < time[20]
    np.testing.assert_array_equal(np.delete(record["x"], 20), np.sin(time))


@pytest.mark.parametrize("count", [2, 3, 7])
def test_thinning_never_joins_what_a_pause_parts(count):
    thin = paused()[0].every(count)
    kept = np.arange(0, 31, count)
    first, second = thin.segments()
    assert np.all(kept[first] < 20)
    assert np.all(kept[second] > 20)


@pytest.mark.parametrize(
    "stamps",
    [
        np.round(ramp(3000) / 600, 3),
        np.floor(ramp(3000) / 600 * 1000) / 1000,
        (ramp(3000) / 600).astype(np.float32).astype(float),
        1.7e9 + ramp(3000) / 600,
    ],
    ids=["rounded to ms", "cut to ms", "32-bit", "seconds since 1970"],
)
def test_stamps_within_their_own_rounding_of_an_even_grid_are_even(stamps):
    record = Record.from_samples({"x": ramp(3000)}, time=stamps)
    assert float(record.time_step) == pytest.approx(1 / 600, rel=1e-3)
    assert record.sample_count == 3000

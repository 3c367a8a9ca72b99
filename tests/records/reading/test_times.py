"""Which column is time, what its numbers count, and what is said where they are none."""

import numpy as np
import pytest

from riecjax.doubts.reading import read_recording
from riecjax.errors import DataError
from riecjax.models.catalogue import find_model
from riecjax.records.reading.times import find_time
from riecjax.records.time_base import time_base

N, STEP = 400, 0.005
T = STEP * np.arange(N)
X = np.sin(9 * T)


def read(folder, columns, **settings):
    path = folder / "a.csv"
    lines = [",".join(columns)]
    lines += [",".join(map(str, row)) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(lines) + "\n")
    return read_recording(path, **settings)


CALLED = (
    *("Time (s)", "Zeit [s]", "t/s", "Time / s", "Elapsed Time", "time_s", "Tempo_s", "TIMESTAMP"),
    *("Time in s", "Time, s", "X_Value", "Date/Time", "Unnamed: 0"),
)


@pytest.mark.parametrize("name", CALLED)
def test_a_column_called_time_or_the_first_that_rises_evenly_is_time(tmp_path, name):
    recording = read(tmp_path, {f'"{name}"': T, "x": X})
    assert set(recording.record.arrays) == {"x"}
    np.testing.assert_allclose(recording.record.time_step, STEP, rtol=1e-12)


def test_uptime_in_seconds_is_no_day(tmp_path):
    recording = read(tmp_path, {"time": 45352.5 + T, "x": X})
    np.testing.assert_allclose(recording.record.time_step, STEP, rtol=1e-6)


OTHERS = {
    "a constant timestamp": ({"timestamp": np.full(N, 7.0), "t": T, "x": X}, "t"),
    "a temperature with its unit": ({"t [degC]": 20 + T, "Zeit": T, "x": X}, "Zeit"),
    "a row number": ({"n": np.arange(N), "time": T, "x": X}, "time"),
}


@pytest.mark.parametrize("case", OTHERS)
def test_of_several_columns_the_samples_decide(tmp_path, case):
    columns, time = OTHERS[case]
    recording = read(tmp_path, columns)
    np.testing.assert_allclose(recording.record.time_step, STEP, rtol=1e-6)
    assert time not in recording.record.arrays
    np.testing.assert_allclose(recording.record["x"], X)


def test_a_row_number_alone_is_no_time():
    assert find_time({"n": np.arange(9.0), "x": np.ones(9)}, {}, None, nameless=True) is None
    assert find_time({"x": X, "n": T}, {}, None, nameless=True) is None


def test_errors_name_the_column(tmp_path):
    with pytest.raises(DataError, match=r"column 'Clock': time must increase.*at sample 1 "):
        read(tmp_path, {"Clock": np.r_[1.0, 0.0, T[2:]], "x": X})
    with pytest.raises(DataError, match=r"column 'Clock': samples must be evenly spaced"):
        read(tmp_path, {"Clock": T**1.1, "x": X})


def test_rows_of_which_the_newest_stands_first_are_turned_round(tmp_path):
    recording = read(tmp_path, {"Clock": 1.7e9 + T[::-1], "x": X[::-1]})
    np.testing.assert_array_equal(recording.record["x"], X)
    assert float(recording.record.start_time) == 1.7e9 + T[0]
    assert "rows turned round: the newest stood first" in recording.steps


def test_stamps_stored_in_32_bit_are_said_to_be(tmp_path):
    since = (1.7e9 + T).astype(np.float32).astype(float)
    with pytest.raises(DataError, match=r"'timestamp': .*stored in 32-bit, which has steps of 128"):
        read(tmp_path, {"timestamp": since, "x": X})
    with pytest.raises(DataError, match=r"too coarse.* repeat .*--time-step, about 0\.00"):
        read(tmp_path, {"timestamp": np.floor(1.7e9 + T), "x": X})
    recording = read(tmp_path, {"timestamp": since, "x": X}, time_step=STEP)
    assert set(recording.record.arrays) == {"x"}


@pytest.mark.raises_finding("time_unit_doubtful")
def test_milliseconds_are_suggested(tmp_path):
    whole = (1e3 * T).round().astype(int)
    finding = read(tmp_path, {"time": whole, "x": X}).findings[0]
    assert finding.code == "time_unit_doubtful"
    assert "--scale time=0.001" in finding.message
    assert not read(tmp_path, {"time [s]": whole, "x": X}).findings
    scaled = read(tmp_path, {"time": whole, "x": X}, scale={"time": 0.001})
    assert not scaled.findings
    assert float(scaled.record.time_step) == pytest.approx(STEP, rel=1e-12)


@pytest.mark.parametrize(
    ("factor", "start", "scale"), [(1e3, 0.37, "0.001"), (1e3, 0.0, "0.001"), (1e6, 5.5, "1e-06")]
)
def test_time_that_leaves_the_models_windows_less_than_a_sample_is_doubted(
    tmp_path, factor, start, scale
):
    """Stamps are not whole, by their start or their rounding, or are microseconds."""
    model = find_model("drag-oscillator")
    stamps = start + T * factor
    signals = {"x": X, "dx": X, "u": X}
    (finding,) = read(tmp_path, {"zeit": stamps, **signals}, model=model).findings
    assert finding.code == "time_unit_doubtful"
    assert f"--scale zeit={scale}" in finding.message
    assert finding.doubt == 1.0
    assert not read(tmp_path, {"zeit [s]": stamps, **signals}, model=model).findings
    assert not read(tmp_path, {"zeit": T + start, **signals}, model=model).findings


def test_stamps_that_jitter_by_more_than_their_digits_are_uneven():
    rng = np.random.default_rng(0)
    jitter = np.cumsum(rng.uniform(0.5, 1.5, 3000)) * STEP
    with pytest.raises(DataError, match="evenly spaced"):
        time_base(np.array([float(f"{t:.5g}") for t in jitter]))


SPELLED = {
    "time_ms": 1e3, "timestamp_us": 1e6, "t/ms": 1e3, "Time in min": 1 / 60,
    "timeMs": 1e3, "time.us": 1e6, "Time ms": 1e3, "Time - ms": 1e3, "Time(mSec)": 1e3,
    "TIME [MS]": 1e3, "millis": 1e3, "time [Seconds]": 1, "t [d]": 1 / 86400,
    "time (days)": 1 / 86400, "Time_Minutes": 1 / 60,
}  # fmt: skip


@pytest.mark.parametrize("name", SPELLED)
def test_more_spellings_of_units_of_time(tmp_path, name):
    stamps = [f"{t:.15g}" for t in T * SPELLED[name]]
    recording = read(tmp_path, {name: stamps, "x": X})
    np.testing.assert_allclose(recording.record.time_step, STEP, rtol=2e-5)
    assert not recording.findings
    scaled = read(tmp_path, {name: stamps, "x": X}, scale={name: 1 / SPELLED[name]})
    np.testing.assert_allclose(scaled.record.time_step, STEP, rtol=2e-5)
    mapped = read(tmp_path, {"n": range(N), name: stamps, "x": X}, rename={"t": name})
    np.testing.assert_allclose(mapped.record.time_step, STEP, rtol=2e-5)


def test_a_unit_that_is_none_of_time_is_named(tmp_path):
    with pytest.raises(DataError, match=r"'t \[samples\]' is in 'samples', which is no unit of"):
        read(tmp_path, {"t [samples]": range(N), "x": X})


@pytest.mark.parametrize("name", ["angle", "Frequency"])
def test_a_first_column_of_another_name_is_doubted(tmp_path, name):
    (finding,) = read(tmp_path, {name: 0.1 * np.arange(N), "x": X}).findings
    assert finding.code == "time_unit_doubtful"
    assert f"nothing says that '{name}' is time" in finding.message
    assert "--map t=COLUMN" in finding.message


@pytest.mark.parametrize("rate", [667, 700, 800, 950, 1024])
@pytest.mark.parametrize("since", [0.0, 1.7e9])
def test_milliseconds_that_are_hardly_shorter_than_a_step(rate, since):
    base = time_base(since + np.round(np.arange(3000) / rate, 3))
    assert base.pauses.size == 0
    np.testing.assert_allclose(base.step, 1 / rate, rtol=1e-5)


def test_a_lost_row_is_a_pause_or_refused_but_no_grid():
    stamps = np.round(np.arange(3000) / 700, 3)
    base = time_base(np.delete(stamps, [800, 1600]))
    np.testing.assert_array_equal(base.pauses, [800, 1599])
    np.testing.assert_allclose(base.step, 1 / 700, rtol=1e-5)
    with pytest.raises(DataError, match=r"tell lost rows from rounding.*--time-step, about 0.001"):
        time_base(np.delete(np.round(np.arange(3000) / 900, 3), 1000))
    lossy = np.delete(np.arange(3000) / 1000, [500, 700, 1100, 1101, 2000])
    assert time_base(lossy).step == pytest.approx(1e-3)


BACK = {
    "newest first": (T[::-1], "Sort the record"),
    "summer time ends": (np.r_[T[:200], T[200:] - 3600], "where summer time ends.*--time-step"),
    "a second run": (np.r_[T[:200], T[:200]], "split the file there"),
    "two rows swapped": (np.r_[T[:100], T[[101, 100]], T[102:]], "Sort the record"),
    "one bad stamp": (np.where(np.arange(N) == 50, 0, T), "Sort the record"),
    "every row twice": (np.repeat(T, 2), "50% of rows repeat.* one row for each time"),
    "up to zero": (-(T[::-1] ** 1.1), "evenly spaced"),
}


@pytest.mark.parametrize("case", BACK)
def test_what_to_do_about_time_that_runs_back(case):
    stamps, words = BACK[case]
    with pytest.raises(DataError, match=words):
        time_base(stamps)


@pytest.mark.parametrize("kind", ["jitter", "sleep", "pause", "drift", "large", "one"])
def test_stamps_that_jitter_are_even_and_it_is_said(tmp_path, kind):
    rng = np.random.default_rng(3)
    time, late = 0.02 * np.arange(N), 0.02 * 0.006 * rng.normal(size=N)
    stamps = {
        "jitter": time + late,
        "sleep": time + np.cumsum(late),  # each step is off by itself
        "pause": time + late + 7.003 * (np.arange(N) > 90),
        "drift": time * (1 + 0.02 * time / 8),  # by 4 % of a step from the first to the last
        "large": time + 9 * late,
        "one": time + 0.00437 * (np.arange(N) > 90),
    }[kind]
    file = {"time": [f"{t:.7f}" for t in stamps], "x": np.sin(stamps)}
    if kind in ("drift", "large", "one"):
        with pytest.raises(DataError, match=r"evenly spaced.*--resample"):
            read(tmp_path, file)
        return
    recording = read(tmp_path, file)
    np.testing.assert_allclose(recording.record.time_step, 0.02, rtol=3e-4)
    assert recording.record.sample_count == N + (kind == "pause")
    (said,) = [words for words in recording.steps if "jitter" in words]
    share = float(said.split("%")[0].split()[-1])
    np.testing.assert_allclose(share, 0.6 if kind != "sleep" else 0.42, rtol=0.1)


def test_what_is_said_of_stamps_that_may_be_read_in_two_ways(tmp_path):
    every = 0.01 * np.arange(400)
    kept = np.arange(400) % 10 != 5
    recording = read(tmp_path, {"t": every[kept], "x": np.sin(3 * every[kept])})
    assert any("--resample 100" in step for step in recording.steps)
    recording = read(tmp_path, {"t": every[kept], "x": every[kept]}, time_step=0.01)
    assert "column 't' is not used: the time step is given, though 40 of its steps are longer" in (
        recording.steps
    )
    with pytest.raises(DataError, match=r"--time-step, about 0\.01 here"):
        read(tmp_path, {"t": np.floor(np.arange(30, 430) / 100), "x": every})


def test_a_slower_channel_has_blanks_and_no_gaps(tmp_path):
    time = 0.01 * np.arange(2000)
    fast, slow = np.sin(7 * time), np.where(np.arange(2000) % 4 == 0, np.cos(3 * time), np.nan)
    record = read(tmp_path, {"t": time, "x": fast, "u": slow}, resample=100.0).record
    assert record.duration > 19.8
    np.testing.assert_allclose(record["u"], np.cos(3 * np.asarray(record.time)), atol=1e-4)

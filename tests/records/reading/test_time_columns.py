"""Which column is time, what its numbers count, and what is said where they are none."""

import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.models.catalogue import find_model
from riecjax.records.reading.time_columns import find_time
from riecjax.records.recording import read_recording
from riecjax.records.time_base import time_base

N, STEP = 400, 0.005
T = STEP * np.arange(N)
X = np.sin(9 * T)


def read(folder, columns, **settings):
    path = folder / "a.csv"
    lines = [",".join(columns)]
    lines += [",".join(str(values[i]) for values in columns.values()) for i in range(N)]
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


COUNTED = {
    "time_ms": 1e3,
    "timestamp_us": 1e6,
    "time [ms]": 1e3,
    "t/ms": 1e3,
    "Time in min": 1 / 60,
}


@pytest.mark.parametrize("name", COUNTED)
def test_units_of_time_in_its_name(tmp_path, name):
    recording = read(tmp_path, {name: T * COUNTED[name], "x": X})
    np.testing.assert_allclose(recording.record.time_step, STEP, rtol=1e-9)
    assert not recording.findings


EPOCHS = {
    "s": (1_700_000_000 + T, 1e-6),
    "ms": (1_700_000_000_000 + (1e3 * T).round().astype(int), 1e-6),
    "ns": ((1_700_000_000 * 10**9 + (1e9 * T).round().astype(np.int64)), 1e-6),
    "days of a spreadsheet": ([f"{45352.5 + t / 86400:.10f}" for t in T], 2e-5),
    "days of MATLAB": ([f"{739312.5 + t / 86400:.10f}" for t in T], 2e-5),
}


@pytest.mark.parametrize("case", EPOCHS)
def test_counts_since_an_epoch_are_known_by_their_size(tmp_path, case):
    stamps, rtol = EPOCHS[case]
    recording = read(tmp_path, {"timestamp": stamps, "x": X})
    np.testing.assert_allclose(recording.record.time_step, STEP, rtol=rtol)
    assert not recording.findings


def test_uptime_in_seconds_is_no_day(tmp_path):
    recording = read(tmp_path, {"time": 45352.5 + T, "x": X})
    np.testing.assert_allclose(recording.record.time_step, STEP, rtol=1e-6)


OTHERS = {
    "a temperature called T": ({"T": 20 + 0.1 * np.sin(T), "timestamp": T, "x": X}, "timestamp"),
    "a constant timestamp": ({"timestamp": np.full(N, 7.0), "t": T, "x": X}, "t"),
    "two that rise": ({"timestamp": 1.7e9 + T, "t": T, "x": X}, "t"),
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


def test_which_of_several_is_said(tmp_path):
    recording = read(tmp_path, {"timestamp": np.full(N, 7.0), "t": T, "x": X})
    assert "time is column 't', not timestamp" in recording.steps


def test_a_row_number_alone_is_no_time():
    assert find_time({"n": np.arange(9.0), "x": np.ones(9)}, {}, None, nameless=True) is None
    assert find_time({"x": X, "n": T}, {}, None, nameless=True) is None


def test_errors_name_the_column(tmp_path):
    with pytest.raises(DataError, match=r"column 'Clock': time must increase.*at sample 1 "):
        read(tmp_path, {"Clock": np.zeros(N) - np.arange(N), "x": X})
    with pytest.raises(DataError, match=r"column 'Clock': samples must be evenly spaced"):
        read(tmp_path, {"Clock": T**1.1, "x": X})


def test_stamps_stored_in_32_bit_are_said_to_be(tmp_path):
    since = (1.7e9 + T).astype(np.float32).astype(float)
    with pytest.raises(DataError, match=r"'timestamp': .*stored in 32-bit, which has steps of 128"):
        read(tmp_path, {"timestamp": since, "x": X})
    with pytest.raises(DataError, match=r"advance by 1 s at a time.*--time-step, about 0\.00"):
        read(tmp_path, {"timestamp": np.floor(1.7e9 + T), "x": X})
    recording = read(tmp_path, {"timestamp": since, "x": X}, time_step=STEP)
    assert set(recording.record.arrays) == {"x"}


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


@pytest.mark.parametrize("digits", [4, 5, 6])
@pytest.mark.parametrize("step", [0.005, 0.001, 1 / 60])
def test_stamps_of_few_significant_digits(step, digits):
    stamps = np.array([float(f"{t:.{digits}g}") for t in step * np.arange(20000)])
    base = time_base(stamps)
    assert base.pauses.size == 0
    np.testing.assert_allclose(base.step, step, rtol=2e-5)


def test_stamps_that_jitter_by_more_than_their_digits_are_uneven():
    rng = np.random.default_rng(0)
    jitter = np.cumsum(rng.uniform(0.5, 1.5, 3000)) * STEP
    with pytest.raises(DataError, match="evenly spaced"):
        time_base(np.array([float(f"{t:.5g}") for t in jitter]))


def test_a_channel_that_no_equation_reads_does_not_decide_the_common_time(tmp_path):
    path = tmp_path / "a.csv"
    signals = {"t": T, "x": X, "dx": X, "u": X, "temperature": np.where(T < 0.5, np.nan, X)}
    text = [",".join(signals)]
    text += [",".join("" if np.isnan(v[i]) else repr(float(v[i])) for v in signals.values())
             for i in range(N)]  # fmt: skip
    path.write_text("\n".join(text) + "\n")
    model = find_model("drag-oscillator")
    read = read_recording(path, model=model, resample=200.0).record
    assert read.sample_count == N
    assert "temperature" in read.missing
    plain = read_recording(path, resample=200.0).record
    assert plain.sample_count == N - 100

import csv
import os
import zipfile
from pathlib import Path

import h5py
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pytest
import scipy.io
from pyarrow import parquet

from riecjax.errors import DataError
from riecjax.records.reading import channels as limits
from riecjax.records.recording import read_record, read_recording

ENDINGS = (".csv", ".npz", ".mat")
TIME = np.arange(5) * 0.1
COLUMNS = {"t": TIME, "pos": TIME**2, "volt": np.cos(TIME)}


def write_columns(folder: Path, ending: str, columns: dict[str, np.ndarray]) -> Path:
    path = folder / f"recording{ending}"
    if ending == ".npz":
        np.savez(path, **columns)  # pyright: ignore[reportArgumentType]
    elif ending == ".mat":
        scipy.io.savemat(path, columns)
    else:
        with path.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(columns)
            writer.writerows(np.column_stack(list(columns.values())).tolist())
    return path


@pytest.mark.portable
@pytest.mark.parametrize("ending", ENDINGS)
def test_rename_and_scale(tmp_path, ending):
    path = write_columns(tmp_path, ending, COLUMNS)
    record = read_record(path, rename={"q": "pos", "force": "volt"}, scale={"volt": 35.0})
    assert set(record.arrays) == {"q", "force"}
    np.testing.assert_array_equal(record["q"], TIME**2)
    np.testing.assert_array_equal(record["force"], 35.0 * np.cos(TIME))


def test_one_column_may_serve_as_two_signals(tmp_path):
    path = write_columns(tmp_path, ".csv", COLUMNS)
    record = read_record(path, rename={"q": "pos", "p": "pos"})
    assert set(record.arrays) == {"q", "p", "volt"}
    np.testing.assert_array_equal(record["q"], record["p"])


def test_scaling_the_time_column_changes_its_unit(tmp_path):
    path = write_columns(tmp_path, ".csv", {"ms": 1e3 * TIME, "x": TIME})
    record = read_record(path, rename={"t": "ms"}, scale={"ms": 1e-3})
    np.testing.assert_allclose(record.time_step, 0.1, rtol=1e-12)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("name", ["t", "time", "Time", "T", "time_s", "t_s"])
def test_time_column_names(tmp_path, ending, name):
    path = write_columns(tmp_path, ending, {"x": TIME**2, name: TIME})
    record = read_record(path)
    assert set(record.arrays) == {"x"}
    np.testing.assert_allclose(record.time_step, 0.1, rtol=1e-14)


def test_a_column_renamed_to_t_is_preferred_to_other_time_columns(tmp_path):
    path = write_columns(tmp_path, ".csv", {"time": TIME, "clock": 2 * TIME, "x": TIME})
    record = read_record(path, rename={"t": "clock"})
    np.testing.assert_allclose(record.time_step, 0.2, rtol=1e-14)


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["plain", "BOM"])
def test_csv_dialects(tmp_path, delimiter, newline, mark):
    rows = [["t", ' "speed" ' if delimiter != "," else "speed"], ["0", "1.5"], ["0.5", "-2e-3"]]
    text = newline.join(delimiter.join(row) for row in rows).replace('"', "")
    path = tmp_path / "a.csv"
    path.write_bytes((mark + text + newline).encode())
    record = read_record(path)
    assert record["speed"].tolist() == [1.5, -2e-3]
    assert float(record.time_step) == 0.5


def test_upper_case_ending(tmp_path):
    write_columns(tmp_path, ".csv", COLUMNS).rename(tmp_path / "A.CSV")
    assert set(read_record(tmp_path / "A.CSV").arrays) == {"pos", "volt"}


@pytest.mark.parametrize("ending", [".npz", ".mat"])
def test_arrays_that_are_not_samples_are_left_out(tmp_path, ending):
    extra = {
        "gtau": np.array([[35.1507]]),
        "gains": np.array([1.0, 2.0]),
        "picture": np.zeros((5, 5)),
        "comment": np.array("measured on Tuesday"),
    }
    path = write_columns(tmp_path, ending, {**COLUMNS, **extra})
    assert set(read_record(path).arrays) == {"pos", "volt"}


@pytest.mark.parametrize("ending", [".npz", ".mat"])
def test_asking_for_an_array_of_another_length_says_so(tmp_path, ending):
    path = write_columns(tmp_path, ending, {**COLUMNS, "gains": np.array([1.0, 2.0])})
    with pytest.raises(DataError, match=r"'gains' has another length than the time, 5 samples"):
        read_record(path, rename={"k": "gains"})


@pytest.mark.parametrize("shape", [(5,), (5, 1), (1, 5)])
@pytest.mark.parametrize("dtype", [np.float32, np.int16, np.bool_])
def test_vectors_of_any_layout_and_number_type(tmp_path, shape, dtype):
    values = np.array([0, 1, 1, 0, 1], dtype)
    np.savez(tmp_path / "a.npz", t=TIME, x=values.reshape(shape))
    assert read_record(tmp_path / "a.npz")["x"].tolist() == [0, 1, 1, 0, 1]


def test_a_file_that_may_not_be_read(tmp_path, monkeypatch):
    path = write_columns(tmp_path, ".csv", COLUMNS)

    def refuse(*_args: object, **_kwargs: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(DataError, match="Permission denied"):
        read_record(path)


class Payload:
    def __init__(self, target: Path):
        self.target = target

    def __reduce__(self):
        return (os.mkdir, (str(self.target),))


def test_objects_in_npz_are_refused_and_not_executed(tmp_path):
    trap = tmp_path / "executed"
    pickled = np.array([Payload(trap)] * 5, dtype=object)
    np.savez(tmp_path / "a.npz", t=TIME, x=pickled)
    with pytest.raises(DataError, match=r"'x' was left out: it holds Python objects"):
        read_record(tmp_path / "a.npz")
    assert not trap.exists()
    # What lies beside objects is read all the same.
    np.savez(tmp_path / "a.npz", t=TIME, x=TIME, about=pickled)
    assert set(read_record(tmp_path / "a.npz").arrays) == {"x"}
    assert not trap.exists()


def test_damage_inside_a_compressed_npz(tmp_path):
    path = tmp_path / "a.npz"
    rng = np.random.default_rng(1)
    np.savez_compressed(path, t=np.arange(400) * 0.1, x=rng.normal(size=400))
    whole = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        # Past the local header: the first bytes of the deflate stream.
        start = archive.getinfo("t.npy").header_offset + 60
    for shift in range(0, 60, 5):
        damaged = bytearray(whole)
        damaged[start + shift : start + shift + 20] = rng.bytes(20)
        path.write_bytes(damaged)
        with pytest.raises(DataError, match="not a readable NPZ file"):
            read_record(path)


def test_archive_that_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    path = write_columns(tmp_path, ".npz", COLUMNS)
    monkeypatch.setattr(limits, "LARGEST_FILE", 5000)
    np.savez_compressed(path, t=np.arange(2000.0), x=np.zeros(2000))
    assert path.stat().st_size > 0
    with pytest.raises(DataError, match=r"unpacks to|larger than"):
        read_record(path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("ending", [".npz", ".mat"])
def test_truncated_archives(tmp_path, ending, share):
    path = write_columns(tmp_path, ending, COLUMNS)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(DataError, match="recording"):
        read_record(path)


def test_matlab_7_3_says_how_to_save_it_again(tmp_path):
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    (tmp_path / "a.mat").write_bytes(header + bytes(400))
    with pytest.raises(DataError, match=r"v7\.3"):
        read_record(tmp_path / "a.mat")


def test_records_are_jax_arrays_in_double_precision(tmp_path):
    record = read_record(write_columns(tmp_path, ".csv", COLUMNS), units={"pos": "m"})
    assert record["pos"].dtype == jnp.float64
    assert dict(record.units) == {"pos": "m"}


def test_stamps_beyond_32_bit_give_no_warning(tmp_path):
    # Such numbers come from damaged files; warnings are errors here.
    path = write_columns(tmp_path, ".npz", {"t": np.array([1.0, 2.0, 1e300]), "x": np.ones(3)})
    assert np.isfinite(read_record(path).time).all()


@pytest.mark.parametrize("ending", [".csv", ".npz", ".parquet", ".h5"])
def test_names_that_would_steer_a_terminal(tmp_path, ending):
    hostile = "F\x1b]0;owned\x07\u202e\x9b2J"
    shown = "F\\x1b]0;owned\\x07\\u202e\\x9b2J"
    path = tmp_path / f"a\x1b[2J{ending}"
    columns = {"t": np.arange(5) * 0.1, hostile: np.arange(5.0)}
    if ending == ".csv":
        path.write_text("\n".join([",".join(columns), *(f"{i / 10},{i}" for i in range(5))]))
    elif ending == ".npz":
        np.savez(path, **columns)
    elif ending == ".parquet":
        parquet.write_table(pa.table(columns), path)
    else:
        with h5py.File(path, "w") as file:
            for name, values in columns.items():
                file[name] = values
            file["text" + hostile] = ["a", "b"]
    recording = read_recording(path)
    assert list(recording.record.arrays) == [shown]
    said = [recording.name, *recording.steps, *(f.message for f in recording.findings)]
    assert all(map(str.isprintable, [*said, *recording.left_out, *recording.left_out.values()]))
    with pytest.raises(DataError) as refused:
        read_recording(path, rename={"F": "G\x1b"}, part="x\x1b")
    assert str(refused.value).isprintable()


def test_names_that_are_one_when_escaped(tmp_path):
    np.savez(tmp_path / "a.npz", **{"t": np.arange(5), "x\x1b": np.ones(5), "x\\x1b": np.ones(5)})
    with pytest.raises(DataError, match=r"two columns are called 'x\\x1b'"):
        read_record(tmp_path / "a.npz")

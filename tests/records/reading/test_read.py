import csv
import os
import tempfile
import zipfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from riecjax.errors import DataError
from riecjax.records import writing
from riecjax.records.reading import limits
from riecjax.records.reading.read import read_record
from riecjax.records.writing import write_record, write_whole
from riecjax.records.record import Record

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


def bits(values: object) -> list[int]:
    return np.asarray(values, float).view(np.int64).tolist()


def no_temporaries(folder: Path, *expected: str) -> None:
    assert sorted(path.name for path in folder.iterdir()) == sorted(expected)


finite = st.floats(allow_nan=False, allow_infinity=False, width=64)


@pytest.mark.parametrize("ending", ENDINGS)
@given(st.lists(st.tuples(finite, finite), min_size=2, max_size=12), st.floats(1e-6, 1e3))
@settings(max_examples=25, deadline=None)
def test_round_trip_is_exact_to_the_bit(ending, samples, step):
    first, second = np.array(samples).T
    record = Record({"b": first, "a_2": second}, step)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"record{ending}"
        write_record(path, record)
        back = read_record(path)
    assert set(back.arrays) == {"a_2", "b"}
    assert bits(back["b"]) == bits(first)
    assert bits(back["a_2"]) == bits(second)
    # The step is not in the file but formed from the times: two roundings.
    np.testing.assert_allclose(back.time_step, step, rtol=1e-14)


@pytest.mark.parametrize("ending", ENDINGS)
def test_start_time_is_kept(tmp_path, ending):
    write_record(tmp_path / f"a{ending}", Record({"x": np.zeros(4)}, 0.25, 3.5))
    assert read_record(tmp_path / f"a{ending}").time.tolist() == [3.5, 3.75, 4.0, 4.25]


@pytest.mark.parametrize("ending", ENDINGS)
def test_written_files_are_read_by_their_own_tools(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    values = np.array([1 / 3, -2e-308, 1e300])
    write_record(path, Record({"x": values}, 0.5))
    if ending == ".csv":
        table = np.genfromtxt(path, delimiter=",", names=True)
    elif ending == ".npz":
        table = np.load(path)
    else:
        table = {k: v.ravel() for k, v in scipy.io.loadmat(path).items() if k in ("t", "x")}
    assert table["t"].tolist() == [0.0, 0.5, 1.0]
    assert bits(table["x"]) == bits(values)


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


def refusal(path: Path, record: Record) -> str | None:
    try:
        write_record(path, record)
    except DataError as error:
        return str(error)
    return None


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("name", ["speed, left", "file", "allow_pickle", "_hidden", "größe"])
def test_signal_names_survive_or_are_refused(tmp_path, ending, name):
    # Whatever a name may hold, a signal is never lost or mixed up without a word.
    path = tmp_path / f"a{ending}"
    message = refusal(path, Record({name: TIME, "y": 2 * TIME}, 0.1))
    if message is None:
        assert set(read_record(path).arrays) == {name, "y"}
    else:
        assert name in message
        no_temporaries(tmp_path)


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_signal_called_t_does_not_replace_the_time(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    with pytest.raises(DataError, match="'t'"):
        write_record(path, Record({"t": np.array([5.0, 4.0, 7.0]), "x": np.zeros(3)}, 0.1))
    no_temporaries(tmp_path)


def test_failing_writer_leaves_nothing(tmp_path):
    def fail(temporary: Path) -> None:
        temporary.write_text("half of it")
        raise RuntimeError("out of ideas")

    with pytest.raises(RuntimeError, match="out of ideas"):
        write_whole(tmp_path / "a.csv", fail)
    no_temporaries(tmp_path)


def test_full_disk_is_reported_and_leaves_the_old_file(tmp_path, monkeypatch):
    target = tmp_path / "a.csv"
    target.write_text("old")

    def fail(temporary: Path, *_columns: object) -> None:
        temporary.write_text("half of it")
        raise OSError(28, "No space left on device")

    monkeypatch.setitem(writing.WRITERS, ".csv", fail)
    with pytest.raises(DataError, match="No space left on device"):
        write_record(target, Record({"x": TIME}, 0.1))
    assert target.read_text() == "old"
    no_temporaries(tmp_path, "a.csv")


@pytest.mark.parametrize("ending", ENDINGS)
def test_an_existing_file_is_replaced_whole(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    path.write_bytes(b"x" * 100_000)
    write_record(path, Record({"x": TIME}, 0.1))
    assert set(read_record(path).arrays) == {"x"}
    no_temporaries(tmp_path, path.name)


def test_written_file_has_the_usual_permissions(tmp_path):
    ordinary = tmp_path / "ordinary"
    ordinary.touch()
    write_record(tmp_path / "a.csv", Record({"x": TIME}, 0.1))
    assert (tmp_path / "a.csv").stat().st_mode == ordinary.stat().st_mode


@pytest.mark.parametrize(
    ("name", "message"),
    [("a.xlsx", "ending must be one of .csv, .npz, .mat"), ("no/a.csv", "there is no folder")],
)
def test_unwritable_targets(tmp_path, name, message):
    with pytest.raises(DataError, match=message):
        write_record(tmp_path / name, Record({"x": TIME}, 0.1))
    no_temporaries(tmp_path)


def test_a_folder_is_no_target(tmp_path):
    (tmp_path / "a.csv").mkdir()
    with pytest.raises(DataError, match="it is a folder"):
        write_record(tmp_path / "a.csv", Record({"x": TIME}, 0.1))


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
    with pytest.raises(DataError, match=r"a\.npz: not a readable NPZ file"):
        read_record(tmp_path / "a.npz")
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

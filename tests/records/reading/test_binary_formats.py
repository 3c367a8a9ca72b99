"""MAT, NPZ, Parquet and MDF files, made by the libraries that others make them with."""

import subprocess
import sys
import warnings
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import scipy.io
import scipy.sparse
from pyarrow import parquet

from riecjax.errors import DataError
from riecjax.records.reading import channels as limits
from riecjax.records.reading.parquet import _read
from riecjax.records.reading.read import read_channels
from riecjax.records.reading.selection import Selection, record_from_channels
from riecjax.records.recording import read_record, read_recording

N = 40
TIME = np.arange(N) * 0.05
X = np.sin(TIME)


def write_v73(path: Path, content: dict[str, object]) -> Path:
    """What MATLAB's save(..., '-v7.3') writes: HDF5 behind a header, matrices transposed."""

    def fill(group: h5py.Group, values: dict[str, object]) -> None:
        for name, value in values.items():
            if isinstance(value, dict):
                fill(group.create_group(name), value)
            elif isinstance(value, list):
                refs = group.file.require_group("#refs#")
                made = [
                    refs.create_dataset(f"{name}{i}", data=np.atleast_2d(np.asarray(v)).T)
                    for i, v in enumerate(value)
                ]
                cell = group.create_dataset(name, (len(made), 1), dtype=h5py.ref_dtype)
                cell.attrs["MATLAB_class"] = np.bytes_("cell")
                for i, target in enumerate(made):
                    cell[i, 0] = target.ref
            elif isinstance(value, str):
                codes = np.array([[ord(c)] for c in value], np.uint16)
                group.create_dataset(name, data=codes).attrs["MATLAB_class"] = np.bytes_("char")
            else:
                group.create_dataset(name, data=np.atleast_2d(np.asarray(value)).T)

    with h5py.File(path, "w", userblock_size=512) as file:
        fill(file, content)
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


def write_v5(path: Path, content: dict[str, object]) -> Path:
    def convert(value: object) -> object:
        if isinstance(value, list):
            cell = np.empty((len(value), 1), dtype=object)
            for i, each in enumerate(value):
                cell[i, 0] = each
            return cell
        return {k: convert(v) for k, v in value.items()} if isinstance(value, dict) else value

    scipy.io.savemat(path, {name: convert(value) for name, value in content.items()})
    return path


COLUMN = X[:, None]
MATLAB: dict[str, object] = {
    "t": TIME[:, None],
    "x": COLUMN,
    "row": TIME[None, :] ** 2,
    "x_F": np.stack([X, 2 * X, 3 * X], axis=1),
    "wide": np.stack([X, -X]),
    "name": "measured on a Tuesday, with a long remark about the weather",
    "Ts": 0.5,
    "square": np.zeros((N, N)),
    "pieces": [np.stack([X, 4 * X]), COLUMN[:-2] + 1],
    "logged": {"time": 2 * TIME[:, None], "signals": {"values": 7 * COLUMN, "label": "a"}},
}
WRITERS = {"v5": write_v5, "v7.3": write_v73}


@pytest.mark.portable
@pytest.mark.parametrize("version", WRITERS)
def test_matlab_files_by_name(tmp_path, version):
    channels = read_channels(WRITERS[version](tmp_path / "a.mat", MATLAB))
    expected = {
        "t": TIME,
        "x": X,
        "row": TIME**2,
        "x_F[0]": X,
        "x_F[1]": 2 * X,
        "x_F[2]": 3 * X,
        "wide[0]": X,
        "wide[1]": -X,
        "pieces{1}[0]": X,
        "pieces{1}[1]": 4 * X,
        "pieces{2}": X[:-2] + 1,
        "logged.time": 2 * TIME,
        "logged.signals.values": 7 * X,
    }
    assert set(channels.columns) == set(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(channels.columns[name], values)
    assert channels.time_of == {
        "logged.signals.values": "logged.time",
        "logged.time": "logged.time",
    }
    assert "square" in channels.left_out


@pytest.mark.parametrize("version", WRITERS)
def test_a_structure_with_time_brings_its_own(tmp_path, version):
    logged = {"time": TIME[:, None], "signals": {"values": COLUMN}}
    path = WRITERS[version](tmp_path / "a.mat", {"Theta": logged, "Speed": logged, "dt": 9.0})
    record = read_record(path, rename={"theta": "Theta.signals.values"})
    np.testing.assert_array_equal(record["theta"], X)
    np.testing.assert_allclose(record.time_step, 0.05, rtol=1e-12)


@pytest.mark.parametrize("version", WRITERS)
def test_structures_with_different_times_are_never_mixed(tmp_path, version):
    path = WRITERS[version](
        tmp_path / "a.mat",
        {
            "fast": {"t": TIME[:, None], "v": COLUMN},
            "slow": {"t": 2 * TIME[:, None], "v": COLUMN},
        },
    )
    with pytest.raises(DataError, match=r"'fast.v' and 'slow.v' have different times.*--resample"):
        read_record(path)
    with pytest.raises(DataError, match="different times"):
        read_record(path, rename={"a": "fast.v", "b": "slow.v"})
    record = read_record(path, rename={"t": "slow.t", "b": "slow.v"})
    np.testing.assert_allclose(record.time_step, 0.1, rtol=1e-12)
    both = read_record(path, rename={"a": "fast.v", "b": "slow.v"}, resample=20.0)
    np.testing.assert_allclose(both["a"], np.sin(both.time), atol=1e-3)
    np.testing.assert_allclose(both["b"], np.sin(both.time / 2), atol=1e-3)


@pytest.mark.parametrize("version", WRITERS)
def test_a_scalar_step_is_not_taken_for_time(tmp_path, version):
    path = WRITERS[version](tmp_path / "a.mat", {"x": COLUMN, "y": 2 * COLUMN, "dt": 0.05, "Ts": 1})
    with pytest.raises(DataError, match="there is no time column"):
        read_record(path)
    record = read_record(path, time_step=0.25)
    assert set(record.arrays) == {"x", "y"}
    assert float(record.time_step) == 0.25


def test_with_a_time_step_the_most_common_length_is_that_of_the_signals(tmp_path):
    np.savez(tmp_path / "a.npz", x=X, y=X, k=np.arange(900.0), z=np.ones(4))
    record = read_record(tmp_path / "a.npz", time_step=0.1)
    assert set(record.arrays) == {"x", "y"}
    assert set(read_record(tmp_path / "a.npz", time_step=1, rename={"q": "k"}).arrays) == {"q"}
    with pytest.raises(DataError, match="'z' has another length than the others, 40 samples"):
        read_record(tmp_path / "a.npz", time_step=1, rename={"a": "x", "b": "y", "c": "z"})
    np.savez(tmp_path / "b.npz", x=X, t=np.zeros(TIME.size))
    recording = read_recording(tmp_path / "b.npz", time_step=0.1)
    assert set(recording.record.arrays) == {"x"}
    assert "column 't' is not used: the time step is given" in recording.steps


@pytest.mark.parametrize("version", ["4", "5"])
@pytest.mark.parametrize("compressed", [False, True])
def test_older_and_compressed_matlab_files(tmp_path, version, compressed):
    content = {"t": TIME, "x": X, "n": np.arange(N)}
    scipy.io.savemat(tmp_path / "a.mat", content, format=version, do_compression=compressed)
    found = read_channels(tmp_path / "a.mat").columns
    for name, values in content.items():
        np.testing.assert_array_equal(found[name], values)


def test_a_compressed_matlab_file_that_unpacks_to_too_much(tmp_path, monkeypatch):
    scipy.io.savemat(tmp_path / "a.mat", {"t": np.zeros(10**6)}, do_compression=True)
    assert (tmp_path / "a.mat").stat().st_size < 20_000
    monkeypatch.setattr(limits, "LARGEST_FILE", 10**6)
    with pytest.raises(DataError, match=r"a\.mat: unpacks to"):
        read_channels(tmp_path / "a.mat")


def test_a_matlab_cell_that_claims_more_than_there_is(tmp_path):
    cell = np.empty((3, 1), dtype=object)
    cell[:] = [[np.arange(5.0)]] * 3
    scipy.io.savemat(tmp_path / "a.mat", {"c": {"inner": cell}})
    content = (tmp_path / "a.mat").read_bytes()
    sides = np.array([3, 1], np.int32).tobytes()
    assert content.count(sides) == 1
    claimed = np.array([2**30, 1], np.int32).tobytes()
    (tmp_path / "a.mat").write_bytes(content.replace(sides, claimed))
    with pytest.raises(DataError, match="array of 1073741824 elements lies in"):
        read_channels(tmp_path / "a.mat")


def test_sparse_matrices_are_left_out_whatever_their_size(tmp_path):
    sparse = scipy.sparse.csc_array((np.ones(2), ([0, 900], [5, 7])), shape=(1000, 1000))
    scipy.io.savemat(tmp_path / "a.mat", {"t": TIME, "x": X, "s": sparse})
    assert set(read_channels(tmp_path / "a.mat").columns) == {"t", "x"}


def test_a_matlab_element_of_an_unknown_type(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"x": TIME})
    content = (tmp_path / "a.mat").read_bytes()
    tag = np.array([9, TIME.nbytes], np.int32).tobytes()
    assert content.count(tag) == 1
    unknown = np.array([0x409, TIME.nbytes], np.int32).tobytes()
    (tmp_path / "a.mat").write_bytes(content.replace(tag, unknown))
    with pytest.raises(DataError, match="unknown type 1033"):
        read_channels(tmp_path / "a.mat")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        # Tags and sizes of the text 'ab': its sides are two 4-byte integers, 1 and 2.
        ([5, 8, 1, 2], [5, 0, 1, 2], "not a readable MAT file"),
        ([6, 8, 6, 0], [6, 8, 0x806, 0], "an array has 1 parts, not 2"),
        ([5, 8, 1, 2], [5, 8, 1, 2000], "an array of 2000 elements lies in 48 bytes"),
        ([5, 8, 1, 40], [5, 8, 1, 39], "array of size 40"),
        ([5, 8, 1, 40], [5, 8, -1, 40], "negative size"),
        ([5, 8, 1, 40], [5, 9000, 1, 40], "larger than its file"),
    ],
)
def test_matlab_arrays_that_do_not_fit(tmp_path, old, new, words):
    scipy.io.savemat(tmp_path / "a.mat", {"x": TIME[None, :], "name": "ab"})
    content = (tmp_path / "a.mat").read_bytes()
    before, after = (np.array(each, np.int32).tobytes() for each in (old, new))
    assert content.count(before) == 1
    (tmp_path / "a.mat").write_bytes(content.replace(before, after))
    with pytest.raises(DataError, match=words):
        read_channels(tmp_path / "a.mat")


def test_v73_links_to_other_files_are_not_followed(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["x"] = X
    path = write_v73(tmp_path / "a.mat", {"t": TIME, "y": X})
    with h5py.File(path, "r+") as file:
        file["secret"] = h5py.ExternalLink("other.h5", "x")
        layout = h5py.VirtualLayout((N,), float)
        layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "x", (N,))
        file.create_virtual_dataset("virtual", layout)
        file["loop"] = h5py.SoftLink("/")
    assert set(read_channels(path).columns) == {"t", "y"}


def test_v73_and_npz_that_declare_too_much_are_refused_before_reading(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file.create_dataset("x", (2**34,), float, chunks=(2**20,), compression="gzip")
        assert file["x"].id.get_storage_size() == 0
    with pytest.raises(DataError, match=r"a\.mat: unpacks to 137438953472 bytes"):
        read_channels(tmp_path / "a.mat")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive, archive.open("x.npy", "w") as member:
        np.lib.format.write_array_header_1_0(
            member, {"descr": "<f8", "fortran_order": False, "shape": (2**40,)}
        )
    with pytest.raises(DataError, match=r"a\.npz: not a readable NPZ file: an array is larger"):
        read_channels(tmp_path / "a.npz")


def test_a_zip_bomb_is_refused_by_what_it_declares(tmp_path):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, x=np.zeros(1000))
    content = bytearray(path.read_bytes())
    # The size in the central directory, which is what a reader goes by.
    place = content.index(b"PK\x01\x02") + 24
    content[place : place + 4] = (2**31).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"a\.npz: declares 2147483648 bytes"):
        read_channels(path)


@pytest.mark.parametrize("make", ["npz", "mat"])
def test_too_many_arrays_are_refused(tmp_path, monkeypatch, make):
    monkeypatch.setattr(limits, "MOST_COLUMNS", 20)
    arrays = {f"x{i}": X for i in range(25)}
    path = tmp_path / f"a.{make}"
    if make == "npz":
        np.savez(path, allow_pickle=False, **arrays)
    else:
        scipy.io.savemat(path, arrays)
    with pytest.raises(DataError, match="columns"):
        read_channels(path)


def test_npz_matrices_by_column(tmp_path):
    matrix = np.asfortranarray(np.stack([X, 2 * X, 3 * X], axis=1))
    np.savez(tmp_path / "a.npz", t=TIME, m=matrix, big=matrix.astype(">f4"), c=X + 1j)
    channels = read_channels(tmp_path / "a.npz")
    assert set(channels.columns) == {"t", *(f"{n}[{i}]" for n in ("m", "big") for i in range(3))}
    np.testing.assert_array_equal(channels.columns["m[2]"], 3 * X)
    np.testing.assert_array_equal(channels.columns["big[1]"], (2 * X).astype(np.float32))
    assert "c" in channels.left_out


STAMPED = {
    "timestamp in ns, with a zone": pa.array(
        (TIME * 1e9).astype("int64") + 1_700_000_000_000_000_000, pa.timestamp("ns", tz="UTC")
    ),
    "timestamp in ms": pa.array((TIME * 1e3).round().astype("int64"), pa.timestamp("ms")),
    "duration": pa.array((TIME * 1e6).round().astype("int64"), pa.duration("us")),
    "time of day": pa.array((TIME * 1e3).round().astype("int32"), pa.time32("ms")),
    "decimal": pa.array([f"{x:.2f}" for x in TIME]).cast(pa.decimal128(10, 2)),
    "32-bit": pa.array(TIME.astype(np.float32)),
}


@pytest.mark.parametrize("case", STAMPED)
def test_parquet_times(tmp_path, case):
    parquet.write_table(pa.table({"x": X, "time": STAMPED[case]}), tmp_path / "a.parquet")
    channels = read_channels(tmp_path / "a.parquet")
    np.testing.assert_allclose(channels.columns["time"], TIME, atol=2e-7)
    np.testing.assert_allclose(read_record(tmp_path / "a.parquet").time_step, 0.05, rtol=1e-6)


def test_parquet_nulls_and_other_columns(tmp_path):
    table = pa.table(
        {
            "t": TIME,
            "count": pa.array([None, 2**60, *range(N - 2)], pa.int64()),
            "flag": pa.array([True, False] * (N // 2)),
            "code": pa.array(X).dictionary_encode(),
            "text": ["a"] * N,
            "list": [[1.0]] * N,
        }
    )
    parquet.write_table(table, tmp_path / "a.parquet")
    channels = read_channels(tmp_path / "a.parquet")
    assert list(channels.columns) == ["t", "count", "flag", "code"]
    assert set(channels.left_out) == {"text", "list"}
    np.testing.assert_array_equal(
        channels.columns["count"], [np.nan, 2.0**60, *map(float, range(N - 2))]
    )
    np.testing.assert_array_equal(channels.columns["code"], X)
    assert channels.columns["flag"].tolist() == [1.0, 0.0] * (N // 2)


@pytest.mark.portable
def test_the_index_of_a_frame_in_parquet_is_time(tmp_path):
    index = pd.date_range("2024-05-01", periods=N, freq="50ms")
    pd.DataFrame({"x": X}, index=index).to_parquet(tmp_path / "a.parquet")
    record = read_record(tmp_path / "a.parquet")
    assert set(record.arrays) == {"x"}
    np.testing.assert_allclose(record.time_step, 0.05, rtol=1e-12)


def test_parquet_that_unpacks_to_too_much(tmp_path, monkeypatch):
    parquet.write_table(pa.table({"x": np.zeros(10**6)}), tmp_path / "a.parquet")
    assert (tmp_path / "a.parquet").stat().st_size < 10_000
    monkeypatch.setattr(limits, "LARGEST_FILE", 5 * 10**6)
    with pytest.raises(DataError, match=r"^unpacks to 8000000 bytes"):
        _read(tmp_path / "a.parquet")


def test_what_parquet_takes_is_counted_before_it_is_read(tmp_path, monkeypatch):
    parquet.write_table(pa.table({"x": np.zeros(10**6)}), tmp_path / "a.parquet")
    monkeypatch.setattr("riecjax.memory.free_memory", lambda: 4e7)
    with pytest.raises(
        MemoryError, match=r"takes about 0\.064 GB of memory, and 0\.04 GB are free"
    ):
        _read(tmp_path / "a.parquet")


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 4])
def test_parquet_takes_no_more_than_is_counted(tmp_path, count):
    # Time stamps take most: counts, their differences from the first and their numbers.
    stamps = pa.array(np.arange(4 * 10**6) * 10**6, pa.timestamp("ns"))
    parquet.write_table(pa.table({f"t{i}": stamps for i in range(count)}), tmp_path / "a.parquet")
    code = """if True:
        import sys
        from pathlib import Path
        import pyarrow.compute, pyarrow.parquet
        from riecjax.records.reading import parquet
        def peak():
            lines = Path("/proc/self/status").read_text().splitlines()
            return 1024 * next(int(line.split()[1]) for line in lines if "VmHWM" in line)
        before, counted = peak(), []
        parquet.require_memory = lambda what, size, remedy: counted.append(size)
        parquet._read(Path(sys.argv[1]))
        print(peak() - before, counted[0])"""
    command = [sys.executable, "-c", code, str(tmp_path / "a.parquet")]
    taken, counted = subprocess.run(command, capture_output=True, text=True).stdout.split()
    assert 0.3 * float(counted) < float(taken) < float(counted)


def test_mdf_groups_with_their_own_times(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    slow = TIME[::4]
    with asammdf.MDF(version="4.10") as file:
        signal = asammdf.Signal
        file.append([signal(X, TIME, name="x", unit="m"), signal(2 * X, TIME, name="v")])
        file.append([signal(np.cos(slow), slow, name="force", unit="N")])
        file.append([signal(np.array([b"a", b"b"]), slow[:2], name="text", encoding="utf-8")])
        path = file.save(tmp_path / "a.mf4")
    channels = read_channels(path)
    np.testing.assert_array_equal(channels.columns["v"], 2 * X)
    np.testing.assert_array_equal(channels.columns["force"], np.cos(slow))
    assert channels.units == {"x": "m", "force": "N"}
    assert channels.time_of["x"] == channels.time_of["v"] != channels.time_of["force"]
    assert "text" in channels.left_out
    with pytest.raises(DataError, match=r"a\.mf4: .*different times.*--resample HZ"):
        read_record(path)
    selection = Selection(rename={"x": "x", "F": "force"}, resample=20.0)
    record = record_from_channels(channels, selection).record
    np.testing.assert_allclose(record["F"], np.cos(record.time), atol=1e-3)
    np.testing.assert_allclose(record["x"], np.sin(record.time), atol=1e-3)
    assert dict(record.units)["F"] == "N"


def test_mdf_without_its_library_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10    ")
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(DataError, match=r'a\.mf4: .*pip install "riecjax\[mdf\]"'):
        read_channels(tmp_path / "a.mf4")


def test_damaged_mdf(tmp_path):
    pytest.importorskip("asammdf")
    for content in (b"", b"MDF     4.10    " + bytes(300), b"no such thing"):
        (tmp_path / "a.mf4").write_bytes(content)
        with pytest.raises(DataError, match=r"^a\.mf4: "):
            read_channels(tmp_path / "a.mf4")


def test_two_arrays_of_one_name_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for values in (TIME, X):
            with archive.open("x.npy", "w") as member:
                np.save(member, values)
    with pytest.raises(DataError, match=r"^a\.npz: two columns are called 'x'\.$"):
        read_channels(tmp_path / "a.npz")
    for compressed in (False, True):
        files = []
        for name in ("one.mat", "two.mat"):
            scipy.io.savemat(tmp_path / name, {"x": TIME}, do_compression=compressed)
            files.append((tmp_path / name).read_bytes())
        # After the header of 128 bytes come the variables, one behind the other.
        (tmp_path / "a.mat").write_bytes(files[0] + files[1][128:])
        with pytest.raises(DataError, match=r"^a\.mat: two columns are called 'x'\.$"):
            read_channels(tmp_path / "a.mat")


def test_text_in_mat_files_is_left_out_with_the_reason(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"t": ["on"] * N, "x": X, "log": {"who": "me"}})
    channels = read_channels(tmp_path / "a.mat")
    assert set(channels.columns) == {"x"}
    assert channels.left_out == dict.fromkeys(("t", "log.who"), "it holds no real numbers")
    with pytest.raises(
        DataError, match=r"no time column.*; column 't' was left out: it holds no real"
    ):
        read_record(tmp_path / "a.mat")


def test_cells_of_a_matlab_table_are_counted_along_columns(tmp_path):
    """c{2} of a 2 x 2 cell is c{2,1}, whose samples here start at 10."""
    cell = np.empty((2, 2), dtype=object)
    for i in range(2):
        for j in range(2):
            cell[i, j] = 10.0 * i + j + np.arange(4) / 8
    scipy.io.savemat(tmp_path / "v5.mat", {"c": cell})
    with h5py.File(tmp_path / "v73.mat", "w") as file:
        # HDF5 holds what MATLAB writes transposed.
        table = file.create_dataset("c", (2, 2), dtype=h5py.ref_dtype)
        table.attrs["MATLAB_class"] = np.bytes_("cell")
        for i in range(2):
            for j in range(2):
                target = file.create_dataset(f"#refs#/{i}{j}", data=cell[i, j][:, None])
                table[j, i] = target.ref
    for name in ("v5.mat", "v73.mat"):
        columns = read_channels(tmp_path / name).columns
        first = {key: values[0] for key, values in columns.items() if key.startswith("c{")}
        assert first == {"c{1}": 0.0, "c{2}": 10.0, "c{3}": 1.0, "c{4}": 11.0}

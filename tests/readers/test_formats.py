"""What each format has of its own: structures, groups, sheets, stamps, units, its own times."""

import datetime
import inspect
import json
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pyarrow as pa
import pytest
import scipy.io
import scipy.sparse
from nptdms import ChannelObject, TdmsWriter
from openpyxl.utils.datetime import CALENDAR_MAC_1904
from pyarrow import parquet
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import riecjax as rx
from damage import outcome
from riecjax.errors import DataError
from riecjax.readers.hdf5 import read_hdf5
from riecjax.readers.matlab import read_v5
from riecjax.records.reading.channels import read_channels

N = 60
TIME = 0.05 * np.arange(N)
X = np.sin(TIME) / 3
COLUMN = X[:, None]
START = datetime.datetime(2024, 3, 1, 12)


def write_v73(path: Path, content: dict[str, object]) -> Path:
    """What MATLAB's save(..., '-v7.3') writes: HDF5 behind a header, matrices transposed."""

    def fill(group: h5py.Group, values: dict[str, object]) -> None:
        for name, value in values.items():
            if isinstance(value, dict):
                fill(group.create_group(name), value)
            elif isinstance(value, list):
                refs = group.file.require_group("#refs#")
                cell = group.create_dataset(name, (len(value), 1), dtype=h5py.ref_dtype)
                cell.attrs["MATLAB_class"] = np.bytes_("cell")
                for i, each in enumerate(value):
                    data = np.atleast_2d(np.asarray(each)).T
                    cell[i, 0] = refs.create_dataset(f"{name}{i}", data=data).ref
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


WRITERS = {"v5": write_v5, "v7.3": write_v73}
MATLAB: dict[str, object] = {
    "t": TIME[:, None],
    "row": TIME[None, :] ** 2,
    "wide": np.stack([X, -X]),
    "name": "measured on a Tuesday, with a long remark about the weather",
    "Ts": 0.5,
    "square": np.zeros((N, N)),
    "pieces": [np.stack([X, 4 * X]), COLUMN[:-2] + 1],
    "logged": {"time": 2 * TIME[:, None], "signals": {"values": 7 * COLUMN, "label": "a"}},
}


@pytest.mark.parametrize("version", WRITERS)
def test_matlab_files_by_name(tmp_path, version):
    channels = read_channels(WRITERS[version](tmp_path / "a.mat", MATLAB))
    expected = {
        "t": TIME,
        "row": TIME**2,
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
    times = ("logged.signals.values", "logged.time")
    assert channels.time_of == dict.fromkeys(times, "logged.time")
    assert "square" in channels.left_out


@pytest.mark.parametrize("version", WRITERS)
def test_structures_with_different_times_are_never_mixed(tmp_path, version):
    kinds = {name: {"t": k * TIME[:, None], "v": COLUMN} for name, k in (("fast", 1), ("slow", 2))}
    path = WRITERS[version](tmp_path / "a.mat", {**kinds, "dt": 0.1})
    asked = {"a": "fast.v", "b": "slow.v"}
    for rename in ({}, asked):
        with pytest.raises(DataError, match=r"different times.*--resample"):
            rx.read_record(path, rename=rename)
    record = rx.read_record(path, rename={"t": "slow.t", "b": "slow.v"})
    np.testing.assert_allclose(record.time_step, 0.1, rtol=1e-12)
    both = rx.read_record(path, rename=asked, resample=20.0)
    np.testing.assert_allclose(both["a"], np.sin(both.time) / 3, atol=1e-3)
    np.testing.assert_allclose(both["b"], np.sin(both.time / 2) / 3, atol=1e-3)


def test_older_matlab_files(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"t": TIME, "x": X}, format="4")
    np.testing.assert_array_equal(read_channels(tmp_path / "a.mat").columns["x"], X)


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


def test_objects_of_matlab_are_named(tmp_path, monkeypatch):
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        table = file.create_dataset("TT", data=np.array([[1, 2, 3]], np.uint32))
        table.attrs["MATLAB_class"] = np.bytes_("timetable")
        table.attrs["MATLAB_object_decode"] = np.int32(3)
    with pytest.raises(DataError, match=r"'TT' was left out: it is a timetable of MATLAB.*save"):
        rx.read_record(tmp_path / "a.mat")
    kind = [(name, object) for name in ("s0", "s1", "s2", "arr")]
    opaque = np.array([(b"TT", b"MCOS", b"timetable", np.zeros(3))], kind)
    found = {"None": scipy.io.matlab.MatlabOpaque(opaque)}
    scipy.io.savemat(tmp_path / "b.mat", {"x": X})
    monkeypatch.setattr(scipy.io, "loadmat", lambda source: found)
    assert "timetable" in inspect.unwrap(read_v5)(tmp_path / "b.mat").left_out["TT"]


BESIDE = {
    "a variable": ({"t": TIME, "x": 1e3 * X, "x_unit": "mm"}, {}),
    "a field": ({"t": TIME, "x": {"values": 1e3 * X, "unit": "mm"}}, {"x": "x.values"}),
    "a field beside the time": ({"r": {"time": TIME, "y": 1e3 * X, "units": "mm"}}, {"x": "r.y"}),
    "of one of two": ({"r": {"time": TIME, "y": X, "z": X, "units": "mm"}}, {"x": "r.y"}),
}


@pytest.mark.parametrize("case", BESIDE)
def test_units_beside_their_columns(tmp_path, case):
    content, rename = BESIDE[case]
    (tmp_path / "a.json").write_text(json.dumps(content, default=lambda array: array.tolist()))
    inner = {name: column.removeprefix("r.") for name, column in rename.items()}
    files = [(write(tmp_path / f"{v}.mat", content), rename) for v, write in WRITERS.items()]
    for path, names in (*files, (tmp_path / "a.json", inner)):
        np.testing.assert_allclose(rx.read_record(path, rename=names)["x"], X, rtol=1e-12)


def test_tables_of_hdf5(tmp_path):
    kind = [("t", "f8"), ("x", "f4"), ("acc", "f8", (2,)), ("name", "S4")]
    table = np.zeros(N, kind)
    table["t"], table["x"], table["acc"][:, 1] = TIME, X, 2 * X
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["log"] = table
        file["log"].attrs["units"] = ["s", "m", "m/s^2", ""]
    fields = read_channels(tmp_path / "b.h5")
    assert fields.units == {"t": "s", "x": "m", "acc[0]": "m/s^2", "acc[1]": "m/s^2"}
    np.testing.assert_array_equal(fields.columns["acc[1]"], 2 * X)
    assert "name" in fields.left_out


@pytest.mark.parametrize("ending", [".mat", ".h5"])
def test_links_of_hdf5(tmp_path, ending):
    """In a circle, to other files, to what was never written; all to all: 40 to the 16th ways."""
    path = tmp_path / f"a{ending}"
    with h5py.File(path, "w") as file:
        file["time"], file["x"] = TIME, X
        file["back"], file["soft"] = file["/"], h5py.SoftLink("/x")
        file["elsewhere"] = h5py.ExternalLink("b.h5", "/x")
        layout = h5py.VirtualLayout((N,), float)
        layout[:] = h5py.VirtualSource(tmp_path / "b.h5", "x", (N,))
        file.create_virtual_dataset("virtual", layout)
        groups = [file.create_group(f"g{i}") for i in range(40)]
        cells = [file.create_dataset(f"c{i}", (10,), h5py.ref_dtype) for i in range(10)]
        for group in groups:
            for i, each in enumerate(groups):
                group[f"l{i}"] = each
        for cell in cells:
            cell.attrs["MATLAB_class"] = np.bytes_("cell")
            cell[:] = [each.ref for each in cells]
    assert set(read_channels(path).columns) == {"time", "x"}


def test_too_many_groups_and_pictures_of_hdf5(tmp_path, monkeypatch):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"], file["x"] = TIME, X
        # Declared and never written: a terabyte that takes no room.
        file.create_dataset("video", (10**6, 1000, 1000), dtype="u1", chunks=(1, 1000, 1000))
    channels = read_channels(tmp_path / "a.h5")
    assert "not that of channels" in channels.left_out["video"]
    monkeypatch.setattr("riecjax.records.reading.channels.MOST_COLUMNS", 2)
    with pytest.raises(DataError, match="has 3 columns; at most 2 are read"):
        inspect.unwrap(read_hdf5)(tmp_path / "a.h5")


def counts_in_hdf5(path, dtype, **attributes):
    with h5py.File(path, "w") as file:
        file["t"] = TIME
        counts = np.round(1e4 * X).astype(dtype)
        counts[7] = -32768
        file.create_dataset("x", data=counts).attrs.update(attributes)
    return path


def test_counts_of_hdf5_and_their_factors(tmp_path):
    stated = {"scale_factor": 1e-4, "add_offset": 0.5, "_FillValue": np.int16(-32768), "units": "m"}
    path = counts_in_hdf5(tmp_path / "a.h5", np.int16, **stated)
    got = read_channels(path).columns["x"]
    expected = np.round(1e4 * X) * 1e-4 + 0.5
    expected[7] = np.nan
    np.testing.assert_allclose(got, expected, rtol=1e-12)
    # Of another attribute nothing tells whether it was applied.
    path = counts_in_hdf5(tmp_path / "b.h5", np.int16, scale=1e-4, units="m")
    kept = {"rename": {"x": "x"}, "outliers": "keep"}
    with pytest.raises(DataError, match=r"attribute 'scale'.*--scale x=FACTOR.*--unit x=m"):
        rx.read_record(path, **kept)
    counts = read_channels(path).columns["x"]
    np.testing.assert_array_equal(rx.read_record(path, **kept, units={"x": "m"})["x"], counts)
    np.testing.assert_array_equal(rx.read_record(path, **kept, scale={"x": 2})["x"], 2 * counts)


def test_stamps_and_numbers_as_text(tmp_path):
    stamps = [f"2024-03-01T12:00:{t:06.3f}Z" for t in TIME]
    texts = [f"{x:.17g}" for x in X]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"], file["x"] = np.array(stamps, "S"), np.array(texts, object)
    table = pa.table({"time": stamps, "x": texts, "tag": ["on"] * N})
    parquet.write_table(table, tmp_path / "a.parquet")
    rows = [json.dumps({"time": t, "x": x}) for t, x in zip(stamps, texts)]
    (tmp_path / "a.jsonl").write_text("\n".join(rows))
    since = np.datetime64("2024-03-01") + (1e3 * TIME).round().astype("timedelta64[ms]")
    fields = np.zeros(N, [("time", since.dtype), ("x", "f8")])
    fields["time"], fields["x"] = since, X
    np.savez(tmp_path / "a.npz", table=fields)
    for ending in (".h5", ".parquet", ".jsonl", ".npz"):
        record = rx.read_record(tmp_path / f"a{ending}")
        np.testing.assert_array_equal(record["x"], X)
        np.testing.assert_allclose(float(record.time_step), 0.05, rtol=1e-6)
    assert "tag" in read_channels(tmp_path / "a.parquet").left_out


def test_an_object_in_each_line(tmp_path):
    rows = [{"t": t, "imu": {"acc": [x, 2 * x]}, "tag": "a"} for t, x in zip(TIME, X)]
    rows[3]["imu"]["acc"][1] = None
    del rows[4]["imu"]
    text = "\n".join(map(json.dumps, rows))
    (tmp_path / "a.ndjson").write_text(text)
    channels = read_channels(tmp_path / "a.ndjson")
    assert set(channels.columns) == {"t", "imu.acc[0]", "imu.acc[1]"}
    expected = np.where(np.arange(N) == 4, np.nan, X)
    np.testing.assert_array_equal(channels.columns["imu.acc[0]"], expected)
    assert np.flatnonzero(np.isnan(channels.columns["imu.acc[1]"])).tolist() == [3, 4]
    assert channels.left_out == {"tag": "it holds text, 'a'"}
    # Cut off within the last line, and within another one.
    (tmp_path / "a.jsonl").write_text(text[:-4])
    assert "the last line is cut off and left out" in read_channels(tmp_path / "a.jsonl").notes
    for lines, number in ((text[:-4] + "\n", N), ('{"t": 1}\n\n{"t": 2,}\n', 3), ("{}\n[1]\n", 2)):
        (tmp_path / "a.jsonl").write_text(lines)
        with pytest.raises(DataError, match=rf"^a\.jsonl: line {number} is no"):
            read_channels(tmp_path / "a.jsonl")


ROWS = [[float(t), float(x)] for t, x in zip(TIME, X)]
OBJECTS = [{"t": t, "x": x} for t, x in ROWS]
DOCUMENTS = {
    "array of objects": OBJECTS,
    "object of arrays": {"t": TIME.tolist(), "x": X.tolist(), "rate": 10, "by": ["me"]},
    "both in others": {"meta": {"rig": 3}, "data": {"t": TIME.tolist(), "x": X.tolist()}},
    "pandas columns": {n: {str(i): r[k] for i, r in enumerate(ROWS)} for k, n in enumerate("tx")},
}


@pytest.mark.parametrize("case", DOCUMENTS)
def test_forms_of_json(tmp_path, case):
    (tmp_path / "a.json").write_text(json.dumps(DOCUMENTS[case]))
    channels = read_channels(tmp_path / "a.json")
    np.testing.assert_array_equal(channels.columns["t"], TIME)
    np.testing.assert_array_equal(channels.columns["x"], X)


def test_arrays_of_arrays_and_of_recordings_in_json(tmp_path):
    table = np.stack([TIME, X])
    for matrix in (table, table.T):
        (tmp_path / "a.json").write_text(json.dumps({"m": matrix.tolist()}))
        np.testing.assert_array_equal(read_channels(tmp_path / "a.json").columns["m[1]"], X)
    runs = [{"t": TIME[:n].tolist(), "x": X[:n].tolist()} for n in (N, 30)]
    (tmp_path / "a.json").write_text(json.dumps({"runs": runs}))
    read = rx.read_recordings(tmp_path / "a.json")
    assert [one.part for one in read] == ["runs(1)", "runs(2)"]
    np.testing.assert_array_equal(read[1].record["x"], X[:30])


@pytest.mark.parametrize("text", ["3", '"a"', "{", "[" * 10**5, '{"x": [1e999, 2]}', "null"])
def test_odd_documents(tmp_path, text):
    for ending in (".json", ".jsonl"):
        assert outcome(tmp_path / f"a{ending}", text.encode()) is not None


STAMPED = {
    "timestamp in ns, with a zone": pa.array(
        (TIME * 1e9).astype("int64") + 1_700_000_000_000_000_000, pa.timestamp("ns", tz="UTC")
    ),
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


def test_nulls_and_kinds_of_parquet(tmp_path):
    counts = pa.array([None, 2**60, *range(N - 2)], pa.int64())
    flags, codes = [True, False] * (N // 2), pa.array(X).dictionary_encode()
    table = {"t": TIME, "count": counts, "flag": flags, "code": codes, "list": [[1.0]] * N}
    parquet.write_table(pa.table(table), tmp_path / "a.parquet")
    channels = read_channels(tmp_path / "a.parquet")
    assert list(channels.columns) == ["t", "count", "flag", "code"]
    expected = [np.nan, 2.0**60, *map(float, range(N - 2))]
    np.testing.assert_array_equal(channels.columns["count"], expected)
    np.testing.assert_array_equal(channels.columns["code"], X)


def test_what_parquet_takes_is_counted_before_it_is_read(tmp_path, monkeypatch):
    parquet.write_table(pa.table({"x": np.zeros(10**6)}), tmp_path / "a.parquet")
    word = pa.DictionaryArray.from_arrays(np.zeros(10**5, int), pa.array(["1" * 10**5]))
    for stored in (True, False):
        parquet.write_table(pa.table({"x": word}), tmp_path / "b.parquet", store_schema=stored)
        with pytest.raises(DataError, match=r"^b\.parquet: unpacks to 10000000000 bytes"):
            read_channels(tmp_path / "b.parquet")
    monkeypatch.setattr("riecjax.runtime.free_memory", lambda: 2e7)
    with pytest.raises(MemoryError, match=r"takes about 0\.024 GB of memory, and 0\.02 GB"):
        read_channels(tmp_path / "a.parquet")


def workbook(path, **sheets):
    book = openpyxl.Workbook()
    book.remove(book.worksheets[0])
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        sheet.sheet_state = "hidden" if name == "Hidden" else "visible"
        for row in rows:
            sheet.append(list(row))
    book.epoch = CALENDAR_MAC_1904
    book.save(path)
    return path


def rows_of_sheet(x=X, head=("t [s]", "x [mm]")):
    return [head, *zip(TIME.tolist(), x.tolist(), strict=True)]


def test_sheets(tmp_path):
    alike = workbook(tmp_path / "a.xlsx", One=rows_of_sheet(), Two=rows_of_sheet(2 * X))
    read = rx.read_recordings(alike)
    assert [one.part for one in read] == ["One", "Two"]
    np.testing.assert_allclose(read[1].record["x"], 2e-3 * X, rtol=1e-14)
    other = rows_of_sheet(head=("t [s]", "F [N]"))
    unlike = workbook(tmp_path / "b.xlsx", One=rows_of_sheet(), Two=other, Hidden=other)
    assert "hidden sheet 'Hidden' left out" in read_channels(unlike).notes
    with pytest.raises(DataError, match=r"of several kinds: One with .*; Two with .*--part"):
        rx.read_recordings(unlike)
    np.testing.assert_allclose(rx.read_record(unlike, part="Two")["F"], X, rtol=1e-14)
    words = workbook(tmp_path / "c.xlsx", Notes=[["only words", "and more"]])
    with pytest.raises(DataError, match=r"^c\.xlsx: no sheet holds a table of numbers: sheet 'N"):
        read_channels(words)


def write_tdms(path, *channels):
    with TdmsWriter(str(path)) as out:
        out.write_segment([ChannelObject(g, n, v, properties=p) for g, n, v, p in channels])
    return path


def even(step, unit="m", start=0.0):
    return {"wf_increment": step, "wf_start_offset": start, "unit_string": unit}


def test_times_of_tdms_by_increments_and_stamps(tmp_path):
    two = [("rig", "x", X, even(0.05, "mm", 3.0)), ("rig", "F", X[:30], even(0.1, "N", 3.0))]
    channels = read_channels(write_tdms(tmp_path / "a.tdms", *two))
    assert channels.units["x"] == "mm"
    np.testing.assert_allclose(channels.columns[channels.time_of["x"]], 3.0 + TIME)
    np.testing.assert_allclose(channels.columns[channels.time_of["F"]], 3.0 + 2 * TIME[:30])
    stamps = np.datetime64(START, "us") + (TIME * 1e6).round().astype("timedelta64[us]")
    stamped = [("rig", "Time", stamps, {}), ("rig", "x", X, {})]
    record = rx.read_record(write_tdms(tmp_path / "b.tdms", *stamped))
    assert float(record.time_step) == pytest.approx(0.05, rel=1e-6)


def test_groups_of_tdms_with_the_same_channels(tmp_path):
    groups = [(f"test {i}", i, X[: N - 10 * i]) for i in (1, 2)]
    made = [(g, n, k * v, even(0.05)) for g, k, v in groups for n in ("x", "y")]
    read = rx.read_recordings(write_tdms(tmp_path / "a.tdms", *made))
    assert [one.part for one in read] == ["test 1", "test 2"]
    np.testing.assert_array_equal(read[1].record["x"], 2 * X[:40])


def test_mdf_groups_with_their_own_times(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    signal, slow = asammdf.Signal, TIME[::4]
    with asammdf.MDF(version="4.10") as file:
        file.append([signal(X, TIME, name="x", unit="m"), signal(2 * X, TIME, name="v")])
        file.append([signal(np.cos(slow), slow, name="force", unit="N")])
        file.append([signal(np.array([b"a", b"b"]), slow[:2], name="text", encoding="utf-8")])
        path = file.save(tmp_path / "a.mf4")
    channels = read_channels(path)
    assert channels.units == {"x": "m", "force": "N"}
    assert channels.time_of["x"] == channels.time_of["v"] != channels.time_of["force"]
    assert "text" in channels.left_out
    record = rx.read_record(path, rename={"x": "x", "F": "force"}, resample=20.0)
    np.testing.assert_allclose(record["F"], np.cos(record.time), atol=1e-3)


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_time_of_a_bag_is_that_of_the_headers(tmp_path, storage):
    """Accelerations with headers, logged late by up to 3 ms."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    vector = types["geometry_msgs/msg/Vector3Stamped"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=storage) as out:
        topic = out.add_connection("/imu", vector.__msgtype__, typestore=store)
        for i, x in enumerate(X):
            stamp = 10**18 + 50_000_000 * i
            at = types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
            header = types["std_msgs/msg/Header"](at, "rig")
            message = vector(header, types["geometry_msgs/msg/Vector3"](x, 2 * x, 0.0))
            packed = store.serialize_cdr(message, vector.__msgtype__)
            out.write(topic, stamp + 1_000_000 * (i % 4), packed)
    channels = read_channels(tmp_path / "bag")
    np.testing.assert_array_equal(channels.columns["vector.y"], 2 * X)
    np.testing.assert_allclose(channels.columns["time"], TIME, atol=1e-12)
    assert "topic '/imu': time by its headers" in channels.notes

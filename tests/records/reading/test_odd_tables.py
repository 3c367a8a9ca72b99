"""What is kept beside numbers in binary files and JSON: units, factors, texts, objects."""

import datetime
import json

import h5py
import numpy as np
import openpyxl
import pyarrow as pa
import pytest
import scipy.io
import scipy.sparse
from openpyxl.utils.datetime import CALENDAR_MAC_1904
from pyarrow import parquet

import riecjax as rx
from riecjax.errors import DataError
from riecjax.records.reading.matlab import _read_v5
from riecjax.records.reading.read import read_channels

TIME = 0.1 * np.arange(60)
X = np.sin(TIME) / 7
STAMPS = [f"2024-03-01T12:00:{t:06.3f}Z" for t in TIME]


def signal(path, **settings):
    record = rx.read_record(path, **settings)
    np.testing.assert_allclose(float(record.time_step), 0.1, rtol=1e-6)
    return record["x"]


BESIDE = {
    "a variable": ({"t": TIME, "x": 1e3 * X, "x_unit": "mm"}, {}),
    "a field": ({"t": TIME, "x": {"values": 1e3 * X, "unit": "mm"}}, {"x": "x.values"}),
    "a field beside the time": ({"r": {"time": TIME, "y": 1e3 * X, "units": "mm"}}, {"x": "r.y"}),
    "of one of two": (
        {"r": {"time": TIME, "y": X, "z": X, "units": "mm"}},
        {"x": "r.y"},
    ),
}


@pytest.mark.parametrize("case", BESIDE)
def test_units_beside_their_columns(tmp_path, case):
    content, rename = BESIDE[case]
    scipy.io.savemat(tmp_path / "a.mat", content)
    np.testing.assert_allclose(signal(tmp_path / "a.mat", rename=rename), X, rtol=1e-12)
    plain = json.dumps(content, default=lambda array: array.tolist())
    (tmp_path / "a.json").write_text(plain)
    inner = {name: column.removeprefix("r.") for name, column in rename.items()}
    np.testing.assert_allclose(signal(tmp_path / "a.json", rename=inner), X, rtol=1e-12)


def test_a_unit_as_text_in_v73(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file["t"], file["x"] = TIME[None], 1e3 * X[None]
        text = file.create_dataset("x_unit", data=np.array([[ord(c)] for c in "mm"], np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
    np.testing.assert_allclose(signal(tmp_path / "a.mat"), X, rtol=1e-12)


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
    assert _read_v5(tmp_path / "b.mat") == ({}, {"TT": "timetable"})


def test_sparse_and_complex_vectors_of_real_numbers(tmp_path):
    columns = {"t": TIME, "x": scipy.sparse.csc_matrix(X[:, None]), "y": X + 0j, "z": X * 1j}
    scipy.io.savemat(tmp_path / "a.mat", columns)
    channels = read_channels(tmp_path / "a.mat")
    np.testing.assert_array_equal(channels.columns["x"], X)
    np.testing.assert_array_equal(channels.columns["y"], X)
    assert channels.left_out == {"z": "it holds no real numbers"}


def hdf5(path, dtype, **attributes):
    with h5py.File(path, "w") as file:
        file["t"] = TIME
        counts = np.round(1e4 * X).astype(dtype)
        counts[7] = -32768
        file.create_dataset("x", data=counts).attrs.update(attributes)
    return path


def test_packed_counts_of_netcdf(tmp_path):
    stated = {"scale_factor": 1e-4, "add_offset": 0.5, "_FillValue": np.int16(-32768), "units": "m"}
    got = signal(hdf5(tmp_path / "a.h5", np.int16, **stated), rename={"x": "x"})
    expected = np.round(1e4 * X) * 1e-4 + 0.5
    expected[7] = got[7]
    np.testing.assert_allclose(got, expected, rtol=1e-12)
    assert np.isnan(read_channels(tmp_path / "a.h5").columns["x"][7])


def test_counts_with_another_factor_are_asked_about(tmp_path):
    path = hdf5(tmp_path / "a.h5", np.int16, scale=1e-4, units="m")
    with pytest.raises(DataError, match=r"attribute 'scale'.*--scale x=FACTOR.*--unit x=m"):
        signal(path, rename={"x": "x"})
    counts = read_channels(path).columns["x"]
    kept = {"rename": {"x": "x"}, "outliers": "keep"}
    np.testing.assert_array_equal(signal(path, **kept, units={"x": "m"}), counts)
    np.testing.assert_array_equal(signal(path, **kept, scale={"x": 2}), 2 * counts)
    plain = hdf5(tmp_path / "b.h5", np.float64, scale=1e-4, units="m")
    np.testing.assert_array_equal(signal(plain, **kept), counts)


def test_stamps_and_numbers_as_text(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"], file["x"] = np.array(STAMPS, "S"), np.array([f"{x:.17g}" for x in X], object)
    table = pa.table({"time": STAMPS, "x": [f"{x:.17g}" for x in X], "tag": ["on"] * 60})
    parquet.write_table(table, tmp_path / "a.parquet")
    since = np.datetime64("2024-03-01") + (1e3 * TIME).round().astype("timedelta64[ms]")
    np.savez(tmp_path / "a.npz", time=since, x=X)
    for ending in (".h5", ".parquet", ".npz"):
        np.testing.assert_array_equal(signal(tmp_path / f"a{ending}"), X)
    assert "tag" in read_channels(tmp_path / "a.parquet").left_out


def test_fields_of_an_array_of_numpy(tmp_path):
    table = np.zeros(60, [("t", "f8"), ("x", "f4")])
    table["t"], table["x"] = TIME, X
    np.savez(tmp_path / "a.npz", table=table)
    np.testing.assert_array_equal(signal(tmp_path / "a.npz"), X.astype("f4"))


ROWS = [[float(t), float(x)] for t, x in zip(TIME, X, strict=True)]
FORMS = {
    "names above rows": json.dumps([["t", "x"], *ROWS]),
    "pandas split": json.dumps({"columns": ["t", "x"], "index": list(range(60)), "data": ROWS}),
    "pandas columns": json.dumps(
        {name: {str(i): row[k] for i, row in enumerate(ROWS)} for k, name in enumerate("tx")}
    ),
    "lines": "\n".join(json.dumps({"t": t, "x": x}) for t, x in ROWS),
}


@pytest.mark.parametrize("form", FORMS)
def test_forms_of_json(tmp_path, form):
    (tmp_path / "a.json").write_text(FORMS[form])
    np.testing.assert_array_equal(signal(tmp_path / "a.json"), X)


def test_a_last_object_that_is_cut_off(tmp_path):
    (tmp_path / "a.jsonl").write_text(FORMS["lines"][:-4])
    channels = read_channels(tmp_path / "a.jsonl")
    assert channels.columns["x"].size == 59
    assert channels.notes == ["the last line is cut off and left out"]
    (tmp_path / "a.jsonl").write_text(FORMS["lines"][:-4] + "\n")
    with pytest.raises(DataError, match="line 60 is not JSON"):
        read_channels(tmp_path / "a.jsonl")


def test_hidden_sheets_and_the_epoch_of_macs(tmp_path):
    book = openpyxl.Workbook()
    book.epoch = CALENDAR_MAC_1904
    start = datetime.datetime(2024, 3, 1)
    sheets = [book.worksheets[0], book.create_sheet("raw")]
    for sheet in sheets:
        sheet.append(["time", "x"])
        for t, x in zip(TIME, X, strict=True):
            sheet.append([start + datetime.timedelta(seconds=float(t)), float(x)])
    sheets[1].sheet_state = "hidden"
    book.save(tmp_path / "a.xlsx")
    np.testing.assert_allclose(signal(tmp_path / "a.xlsx"), X, rtol=1e-15)
    assert "hidden sheet 'raw' left out" in read_channels(tmp_path / "a.xlsx").notes

"""HDF5 files of any program: groups, tables, units, links that lead in a circle."""

import h5py
import numpy as np
import pytest

from damage import damaged, outcome
from riecjax.errors import DataError
from riecjax.records.reading import channels as limits
from riecjax.records.reading import child_process, hdf5
from riecjax.records.reading.hdf5 import _read
from riecjax.records.reading.read import read_channels
from riecjax.records.recording import read_record

TIME = np.arange(60) * 0.125
X, F = np.sin(TIME), np.cos(3 * TIME).astype(np.float32)


def one_group(path):
    with h5py.File(path, "w") as file:
        run = file.create_group("rig/run")
        run["time"], run["position"], run["force"] = TIME, X, F
        run["position"].attrs["units"] = "mm"
        run["force"].attrs["unit"] = np.bytes_("N")
        run["label"] = "a remark"
        file["rig/rate"] = 8.0
    return path


@pytest.mark.portable
def test_names_begin_below_the_group_of_all(tmp_path):
    channels = read_channels(one_group(tmp_path / "a.h5"))
    assert set(channels.columns) == {"time", "position", "force"}
    np.testing.assert_array_equal(channels.columns["position"], X)
    np.testing.assert_array_equal(channels.columns["force"], F.astype(float))
    assert channels.units == {"position": "mm", "force": "N"}
    record = read_record(tmp_path / "a.h5", rename={"x": "position"})
    np.testing.assert_array_equal(record["x"], 1e-3 * X)


def test_groups_of_other_rates_keep_their_own_time(tmp_path):
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        file["fast/time"], file["fast/x"] = TIME, X
        file["slow/time"], file["slow/F"] = TIME[::2], F[::2]
    channels = read_channels(tmp_path / "a.hdf5")
    assert channels.time_of["fast/x"] == "fast/time"
    assert channels.time_of["slow/F"] == "slow/time"
    record = read_record(tmp_path / "a.hdf5", rename={"F": "F"}, resample=4.0)
    np.testing.assert_allclose(float(record.time_step), 0.25)


def test_fields_of_a_table_are_columns(tmp_path):
    kind = [("t", "f8"), ("x", "f4"), ("count", "i4"), ("acc", "f8", (2,)), ("name", "S4")]
    table = np.zeros(60, kind)
    table["t"], table["x"], table["count"], table["acc"][:, 1] = TIME, X, np.arange(60), 2 * X
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["log"] = table
        file["log"].attrs["units"] = ["s", "m", "1", "m/s^2", ""]
    channels = read_channels(tmp_path / "a.h5")
    assert set(channels.columns) == {"t", "x", "count", "acc[0]", "acc[1]"}
    np.testing.assert_array_equal(channels.columns["x"], table["x"].astype(float))
    np.testing.assert_array_equal(channels.columns["acc[1]"], 2 * X)
    assert channels.units == {
        "t": "s",
        "x": "m",
        "count": "1",
        "acc[0]": "m/s^2",
        "acc[1]": "m/s^2",
    }
    assert "name" in channels.left_out


def test_links_in_a_circle_end(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        run = file.create_group("run")
        run["time"], run["x"] = TIME, X
        run["back"] = file["/"]
        run["self"] = run
        run["soft"] = h5py.SoftLink("/run/x")
        run["elsewhere"] = h5py.ExternalLink("b.h5", "/x")
    assert set(read_channels(tmp_path / "a.h5").columns) == {"time", "x"}


def test_pictures_are_not_read(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"], file["x"] = TIME, X
        # Declared and never written: a terabyte that takes no room.
        file.create_dataset("video", (10**6, 1000, 1000), dtype="u1", chunks=(1, 1000, 1000))
    channels = read_channels(tmp_path / "a.h5")
    assert set(channels.columns) == {"time", "x"}
    assert "not that of channels" in channels.left_out["video"]


def test_declared_sizes_are_checked(tmp_path, monkeypatch):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", (2**40,), dtype="f8", chunks=(2**20,))
    with pytest.raises(DataError, match=r"^a\.h5: unpacks to 8796093022208 bytes"):
        read_channels(tmp_path / "a.h5")
    monkeypatch.setattr(limits, "LARGEST_FILE", 2**50)
    with pytest.raises(DataError, match="it is damaged"):
        _read(tmp_path / "a.h5")


def test_damaged_files(tmp_path):
    content = one_group(tmp_path / "whole.h5").read_bytes()
    rng = np.random.default_rng(20240501)
    refused = [outcome(tmp_path / "a.h5", damaged(content, rng)) for _ in range(300)]
    assert sum(message is not None for message in refused) > 50
    assert outcome(tmp_path / "a.h5", content[: len(content) // 2]) is not None


def cells_of_each_other(path, count=10):
    """Cells each of which refers to all of them: 10 to the 16th ways within 16 levels."""
    with h5py.File(path, "w") as file:
        file["t"], file["x"] = TIME, X
        cells = [file.create_dataset(f"c{i}", (count,), h5py.ref_dtype) for i in range(count)]
        for cell in cells:
            cell.attrs["MATLAB_class"] = np.bytes_("cell")
            cell[:] = [each.ref for each in cells]


def groups_in_each_other(path, count=40):
    with h5py.File(path, "w") as file:
        file["t"], file["x"] = TIME, X
        groups = [file.create_group(f"g{i}") for i in range(count)]
        for group in groups:
            for i, each in enumerate(groups):
                group[f"l{i}"] = each


@pytest.mark.parametrize("make", [cells_of_each_other, groups_in_each_other])
@pytest.mark.parametrize("ending", [".mat", ".h5"])
def test_what_refers_to_each_other_is_read_once(tmp_path, monkeypatch, make, ending):
    monkeypatch.setattr(child_process, "PATIENCE", 20.0)  # for whoever breaks it
    make(tmp_path / f"a{ending}")
    assert set(read_channels(tmp_path / f"a{ending}").columns) == {"t", "x"}


def test_too_many_groups_are_refused(tmp_path, monkeypatch):
    groups_in_each_other(tmp_path / "a.h5")
    monkeypatch.setattr(hdf5, "MOST_ITEMS", 1000)
    with pytest.raises(DataError, match="at most 1000 are read"):
        _read(tmp_path / "a.h5")

"""TDMS of LabVIEW, made with npTDMS: groups, increments, stamps."""

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter

import riecjax as rx
from damage import damaged, outcome
from riecjax.errors import DataError
from riecjax.records.reading.read import read_channels

TIME = np.arange(60) * 0.02
X = np.sin(TIME)


def saved(path, *channels):
    with TdmsWriter(str(path)) as out:
        out.write_segment([ChannelObject(g, n, v, properties=p) for g, n, v, p in channels])
    return path


def even(step, unit="m", start=0.0):
    return {"wf_increment": step, "wf_start_offset": start, "unit_string": unit}


@pytest.mark.portable
def test_times_by_increments(tmp_path):
    path = saved(
        tmp_path / "a.tdms",
        ("rig", "x", X, even(0.02, "mm", 3.0)),
        ("rig", "F", X[:30], even(0.04, "N", 3.0)),
    )
    channels = read_channels(path)
    assert channels.units["x"] == "mm"
    np.testing.assert_allclose(channels.columns[channels.time_of["x"]], 3.0 + TIME)
    np.testing.assert_allclose(channels.columns[channels.time_of["F"]], 3.0 + 2 * TIME[:30])
    record = rx.read_record(path, rename={"x": "x"})
    np.testing.assert_allclose(record["x"], 1e-3 * X, rtol=1e-15)
    assert float(record.time_step) == pytest.approx(0.02)


def test_a_channel_of_stamps(tmp_path):
    start = np.datetime64("2024-03-01T12:00:00", "us")
    stamps = start + (TIME * 1e6).round().astype("timedelta64[us]")
    path = saved(tmp_path / "a.tdms", ("rig", "Time", stamps, {}), ("rig", "x", X, {}))
    record = rx.read_record(path)
    assert float(record.time_step) == pytest.approx(0.02, rel=1e-6)
    np.testing.assert_array_equal(record["x"], X)


def test_groups_with_the_same_channels(tmp_path):
    groups = [(f"test {i}", i, X[: 60 - 10 * i]) for i in (1, 2)]
    path = saved(
        tmp_path / "a.tdms",
        *((g, n, k * v, even(0.02)) for g, k, v in groups for n in ("x", "y")),
    )
    read = rx.read_recordings(path)
    assert [one.part for one in read] == ["test 1", "test 2"]
    np.testing.assert_array_equal(read[1].record["x"], 2 * X[:40])


def test_damaged_files(tmp_path, capfd):
    whole = saved(tmp_path / "whole.tdms", ("rig", "x", X, even(0.02)), ("rig", "y", X, even(0.02)))
    content, rng = whole.read_bytes(), np.random.default_rng(20240501)
    refused = [outcome(tmp_path / "a.tdms", damaged(content, rng)) for _ in range(300)]
    assert sum(message is not None for message in refused) > 50
    assert capfd.readouterr() == ("", "")


def test_without_the_library_the_extra_is_named(tmp_path, monkeypatch):
    path = saved(tmp_path / "a.tdms", ("rig", "x", X, even(0.02)))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(DataError, match=r'pip install "riecjax\[tdms\]"'):
        read_channels(path)

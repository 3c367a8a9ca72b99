"""JSON: lines of objects, and documents of arrays."""

import json

import numpy as np
import pytest

from damage import damaged, outcome
from riecjax.errors import DataError
from riecjax.records.reading.read import read_channels
from riecjax.records.recording import read_record, read_recordings

TIME = np.arange(50) * 0.1
X = np.sin(TIME) / 7


def saved(path, document):
    path.write_text(json.dumps(document))
    return path


def lines(path, rows):
    path.write_text("\n".join(map(json.dumps, rows)) + "\n")
    return path


@pytest.mark.portable
@pytest.mark.parametrize("ending", [".jsonl", ".ndjson"])
def test_an_object_in_each_line(tmp_path, ending):
    rows = [{"t": t, "imu": {"acc": [x, 2 * x]}, "tag": "a"} for t, x in zip(TIME, X)]
    rows[3]["imu"]["acc"][1] = None
    del rows[4]["imu"]
    channels = read_channels(lines(tmp_path / f"a{ending}", rows))
    assert set(channels.columns) == {"t", "imu.acc[0]", "imu.acc[1]"}
    expected = np.where(np.arange(50) == 4, np.nan, X)
    np.testing.assert_array_equal(channels.columns["imu.acc[0]"], expected)
    assert np.flatnonzero(np.isnan(channels.columns["imu.acc[1]"])).tolist() == [3, 4]
    assert channels.left_out == {"tag": "it holds text, 'a'"}


def test_stamps_and_numbers_as_text(tmp_path):
    rows = [
        {"time": f"2024-03-01T23:59:{50 + k / 10:09.6f}Z"[:26], "x": f"{k}.25"} for k in range(99)
    ]
    record = read_record(lines(tmp_path / "a.jsonl", rows))
    np.testing.assert_allclose(float(record.time_step), 0.1, rtol=1e-6)
    np.testing.assert_array_equal(record["x"], np.arange(99) + 0.25)


DOCUMENTS = {
    "array of objects": [{"t": t, "x": x} for t, x in zip(TIME, X)],
    "object of arrays": {"t": TIME.tolist(), "x": X.tolist(), "rate": 10, "by": ["me"]},
    "both in others": {"meta": {"rig": 3}, "data": {"t": TIME.tolist(), "x": X.tolist()}},
    "table in others": {"meta": {"rig": 3}, "rows": [{"t": t, "x": x} for t, x in zip(TIME, X)]},
}


@pytest.mark.parametrize("case", DOCUMENTS)
def test_documents(tmp_path, case):
    channels = read_channels(saved(tmp_path / "a.json", DOCUMENTS[case]))
    np.testing.assert_array_equal(channels.columns["t"], TIME)
    np.testing.assert_array_equal(channels.columns["x"], X)


def test_rows_of_arrays(tmp_path):
    table = np.stack([TIME, X])
    for matrix in (table, table.T):
        channels = read_channels(saved(tmp_path / "a.json", {"m": matrix.tolist()}))
        np.testing.assert_array_equal(channels.columns["m[0]"], TIME)
        np.testing.assert_array_equal(channels.columns["m[1]"], X)


def test_an_array_of_recordings(tmp_path):
    runs = [{"t": TIME.tolist(), "x": X.tolist()}, {"t": TIME[:30].tolist(), "x": X[:30].tolist()}]
    read = read_recordings(saved(tmp_path / "a.json", {"runs": runs}))
    assert [one.part for one in read] == ["runs(1)", "runs(2)"]
    np.testing.assert_array_equal(read[1].record["x"], X[:30])


def test_what_is_no_object_is_named_by_its_line(tmp_path):
    path = tmp_path / "a.jsonl"
    for text, line in (('{"t": 1}\n\n{"t": 2,}\n', 3), ('{"t": 1}\n[1, 2]\n', 2)):
        path.write_text(text)
        with pytest.raises(DataError, match=rf"^a\.jsonl: line {line} is no"):
            read_channels(path)


@pytest.mark.parametrize("text", ["", "3", '"a"', "{", "[" * 10**5, '{"x": [1e999, 2]}', "null"])
def test_odd_documents(tmp_path, text):
    for ending in (".json", ".jsonl"):
        assert outcome(tmp_path / f"a{ending}", text.encode()) is not None


@pytest.mark.parametrize("ending", [".json", ".jsonl"])
def test_damaged_files(tmp_path, ending):
    rows = DOCUMENTS["array of objects"]
    path = tmp_path / f"a{ending}"
    content = (saved if ending == ".json" else lines)(path, rows).read_bytes()
    rng = np.random.default_rng(20240501)
    refused = [outcome(path, damaged(content, rng)) for _ in range(300)]
    assert sum(message is not None for message in refused) > 100

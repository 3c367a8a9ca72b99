import csv
import os
import re
import tempfile
from pathlib import Path

import numpy as np
import pandas
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from riecjax.doubts.reading import read_record
from riecjax.errors import DataError
from riecjax.records import writing
from riecjax.records.record import Record
from riecjax.records.signal import Signal
from riecjax.records.writing import check_writable, write_record

ENDINGS = (".csv", ".npz", ".mat", ".parquet")
TIME = np.arange(5) * 0.1


def bits(values: object) -> list[int]:
    return np.asarray(values, float).view(np.int64).tolist()


def no_temporaries(folder: Path, *expected: str) -> None:
    assert sorted(path.name for path in folder.iterdir()) == sorted(expected)


finite = st.floats(allow_nan=False, allow_infinity=False, width=64)


sample = st.one_of(finite, st.just(np.nan))


@pytest.mark.parametrize("ending", ENDINGS)
@given(st.data())
@settings(max_examples=40, deadline=None)
def test_missing_samples_and_pauses_come_back(ending, data):
    size = data.draw(st.integers(3, 14))
    signals = {}
    for name in ("b", "a_2"):
        values = np.array(data.draw(st.lists(sample, min_size=size, max_size=size)))
        values[data.draw(st.integers(0, size - 1))] = 0.25
        signals[name] = values
    # Of two parts in three the step is the usual one, so that it is the median.
    extra = np.zeros(size - 1)
    for place in data.draw(st.sets(st.integers(0, size - 2), max_size=(size - 1) // 3)):
        extra[place] = data.draw(st.sampled_from([0.75, 1.0, 2.0, 7.25, 1000.0]))
    time = 4.0 + np.concatenate([[0.0], np.cumsum(0.25 * (1 + extra))])
    record = Record.from_samples(signals, time=time)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"record{ending}"
        write_record(path, record)
        back = read_record(path)
    assert set(back.arrays) == set(record.arrays)
    (rows, breaks), (rows_back, breaks_back) = samples(record), samples(back)
    assert rows_back == rows
    assert breaks_back == breaks
    if record.stamps is None:
        assert back.sample_count == record.sample_count


def samples(record: Record) -> tuple[list[list[int]], list[bool]]:
    """The samples that are there, to the bit, and between which there are empty ones.

    How many samples an empty stretch beside a pause takes tells nothing.
    """
    names = sorted(record.arrays)
    columns = [record.signal(name).with_nan for name in names]
    filled = np.flatnonzero(~np.all(np.isnan(columns), axis=0))
    rows = np.stack([np.asarray(record.time), *columns], axis=1)[filled]
    return [bits(row) for row in rows], (np.diff(filled) > 1).tolist()


def test_missing_samples_are_written_as_others_read_them(tmp_path):
    record = Record.from_samples({"x": [1.0, np.nan, 3.0], "y": [1, 2, 3]}, time_step=0.5)
    write_record(tmp_path / "a.csv", record)
    assert (tmp_path / "a.csv").read_text() == "t,x,y\n0,1,1\n0.5,,2\n1,3,3\n"
    write_record(tmp_path / "a.parquet", record)
    frame = pandas.read_parquet(tmp_path / "a.parquet")
    np.testing.assert_array_equal(frame["x"], [1, np.nan, 3])


def test_parquet_keeps_units(tmp_path):
    record = Record({"x": Signal(TIME, unit="m/s"), "y": TIME}, 0.1)
    write_record(tmp_path / "a.parquet", record)
    assert dict(read_record(tmp_path / "a.parquet").units) == {"x": "m/s"}


def refusal(path: Path, record: Record) -> str | None:
    try:
        write_record(path, record)
    except DataError as error:
        return str(error)
    return None


NAMES = (
    "speed, left", "file", "allow_pickle", "_hidden", "größe", "a;b", 'say "no"', " x",
    "line\nend", "m", "7", "F (left)", "#1", "-", "=1+1", "@A1", "a;\t=HYPERLINK(0)",
    "/etc/x", "a/../../x", "C:x", "a/..b",
)  # fmt: skip
"""Of signals, as no format and all of them can hold."""


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("name", NAMES)
def test_signal_names_survive_or_are_refused(tmp_path, ending, name):
    # Whatever a name may hold, a signal is never lost or mixed up without a word.
    path = tmp_path / f"a{ending}"
    message = refusal(path, Record({name: TIME, "y": 2 * TIME}, 0.1))
    if message is None:
        assert set(read_record(path).arrays) == {name, "y"}
    else:
        assert name.replace("\n", r"\n").replace("\t", r"\t") in message
        assert message.isprintable()
        no_temporaries(tmp_path)


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_signal_called_t_does_not_replace_the_time(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    with pytest.raises(DataError, match="'t'"):
        write_record(path, Record({"t": np.array([5.0, 4.0, 7.0]), "x": np.zeros(3)}, 0.1))
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


@pytest.mark.parametrize("name", ["=1+1", "+1", "-1", "@SUM(1)", "a;=1+1", "a, =1+1"])
def test_no_name_is_a_formula_to_a_spreadsheet(tmp_path, name):
    write_record(tmp_path / "a.csv", Record({name: TIME, "x=y-z": TIME}, 0.1))
    (header,) = csv.reader((tmp_path / "a.csv").read_text().splitlines()[:1])
    assert header[2] == "x=y-z"
    for cell in re.split("[;,]", header[1]):
        assert cell.strip()[0] not in "=+-@"


def unwritable(folder: Path) -> dict[Path, str]:
    (folder / "folder.csv").mkdir()
    (folder / "device.csv").symlink_to("/dev/null")
    os.mkfifo(folder / "pipe.csv")
    return {
        folder / "a.xlsx": "ending must be one of .csv, .npz, .mat",
        folder / "no" / "a.csv": "there is no folder",
        folder / ("a" * 300 + ".csv"): "File name too long",
        folder / ("a" * 300) / "a.csv": "File name too long|there is no folder",
        folder / "folder.csv": "it is no plain file",
        folder / "device.csv": "it is no plain file",
        folder / "pipe.csv": "it is no plain file",
    }


def test_what_cannot_be_written_is_refused_before_any_work_and_stays(tmp_path):
    for path, words in unwritable(tmp_path).items():
        for write in (check_writable, lambda file: write_record(file, Record({"x": TIME}, 0.1))):
            with pytest.raises(DataError, match=words):
                write(path)
    no_temporaries(tmp_path, "device.csv", "folder.csv", "pipe.csv")


@pytest.mark.portable
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_written_file_replaces_the_old_one_whole_and_others_read_it(tmp_path, ending):
    path, values = tmp_path / f"a{ending}", np.array([1 / 3, -2e-308, 1e300])
    path.write_bytes(b"x" * 100_000)
    mode = path.stat().st_mode
    write_record(path, Record({"x": values}, 0.25, 3.5))
    assert path.stat().st_mode == mode
    no_temporaries(tmp_path, path.name)
    if ending == ".csv":
        table = np.genfromtxt(path, delimiter=",", names=True)
    elif ending == ".npz":
        table = np.load(path)
    elif ending == ".parquet":
        table = {k: v.to_numpy() for k, v in pandas.read_parquet(path).items()}
    else:
        table = {k: v.ravel() for k, v in scipy.io.loadmat(path).items() if k in ("t", "x")}
    assert table["t"].tolist() == [3.5, 3.75, 4.0]
    assert bits(table["x"]) == bits(values)


@pytest.mark.parametrize("name", ["../x", "/etc/x", "a/../../x", "a\\..\\x", "C:\\x", "x\0.exe"])
def test_no_member_of_an_archive_leaves_its_folder(tmp_path, name):
    message = refusal(tmp_path / "a.npz", Record({name: TIME}, 0.1))
    assert message is not None
    assert "rename it" in message
    assert message.isprintable()
    no_temporaries(tmp_path)

"""Files of a fleet: found by patterns, here or in a store; rows of Parquet taken apart."""

from pathlib import Path

import fsspec
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from riecjax.errors import DataError
from riecjax.fleets.sources import (
    Piece,
    Source,
    at_hand,
    find_sources,
    recordings_of,
    stretches,
)


def write(file: Path, rows: int = 3, **columns: object) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    table = {"x": np.arange(rows, dtype=float), **columns}
    parquet.write_table(pa.table(table), file, row_group_size=2)


@pytest.fixture
def folder(tmp_path) -> Path:
    for name in ("vehicle=1/a.parquet", "vehicle=2/b.parquet", "vehicle=2/load=full/c.parquet"):
        write(tmp_path / name)
    (tmp_path / "notes.md").write_text("no data")
    (tmp_path / "drive.csv").write_text("t,x\n0,1\n")
    for part in range(3):
        write(tmp_path / f"week.parquet/part.{part}.parquet", rows=4)
    (tmp_path / "week.parquet/_common.parquet").write_text("")
    return tmp_path


def named(sources: list[Source]) -> list[str]:
    return [source.name for source in sources]


def test_a_folder_holds_all_that_can_be_read_below_it(folder):
    found = find_sources([folder])
    assert named(found) == [
        "drive.csv",
        "vehicle=1/a.parquet",
        "vehicle=2/b.parquet",
        "vehicle=2/load=full/c.parquet",
        "week.parquet",
    ]
    assert found[3].keys == (("vehicle", "2"), ("load", "full"))
    # The files of a data set are one recording, in the order of their names.
    assert [Path(url).name for url in found[4].urls] == [f"part.{i}.parquet" for i in range(3)]


def test_patterns_join_and_name_files_below_what_they_have_in_common(folder):
    found = find_sources([f"{folder}/vehicle=2/*.parquet", f"{folder}/vehicle=2/load=full"])
    assert named(found) == ["b.parquet", "load=full/c.parquet"]
    assert named(find_sources([f"{folder}/**/*.csv"])) == ["drive.csv"]
    assert named(find_sources([folder / "drive.csv", folder / "drive.csv"])) == ["drive.csv"]


def test_what_nothing_matches_is_refused(folder):
    for pattern in (f"{folder}/*.mat", folder / "absent", "no-such://bucket/x"):
        with pytest.raises(DataError, match=r"nothing that can be read|cannot be looked at"):
            find_sources([pattern])


def test_a_store_is_looked_at_and_a_file_of_it_brought_here():
    store = fsspec.filesystem("memory")
    store.pipe({"/bench/vehicle=7/a.csv": b"t,x\n0,1\n", "/bench/vehicle=8/b.csv": b"t,x\n0,2\n"})
    try:
        found = find_sources(["memory://bench"])
        assert named(found) == ["vehicle=7/a.csv", "vehicle=8/b.csv"]
        assert found[0].keys == (("vehicle", "7"),)
        with at_hand(Piece(found[1]), (0, 0)) as file:
            assert file.name == "b.csv"
            assert file.read_bytes() == b"t,x\n0,2\n"
        assert not file.exists()
    finally:
        store.rm("/bench", recursive=True)


def test_rows_of_a_data_set_are_taken_across_its_files(folder):
    (week,) = find_sources([folder / "week.parquet"])
    (whole,) = recordings_of(week, [])
    for low, high in ((0, 12), (3, 5), (7, 9), (4, 8), (11, 12)):
        with at_hand(whole, (low, high)) as file:
            found = parquet.read_table(file)["x"].to_numpy()
        np.testing.assert_array_equal(found, (np.arange(12) % 4)[low:high])


def test_rows_that_agree_in_a_column_are_recordings(tmp_path):
    write(tmp_path / "a.parquet/0.parquet", 5, drive=["p", "p", "q", "q", "p"])
    write(tmp_path / "a.parquet/1.parquet", 3, drive=["p", "p", "r"])
    (source,) = find_sources([tmp_path / "a.parquet"])
    found = recordings_of(source, ["drive"])
    assert [(p.keys[0][1], p.first, p.stop) for p in found] == [
        ("p", 0, 2),
        ("q", 2, 4),
        ("p", 4, 7),  # on through the next file
        ("r", 7, 8),
    ]
    (whole,) = recordings_of(source, [])
    assert (whole.first, whole.stop) == (0, 8)
    with pytest.raises(DataError, match="no column 'truck'"):
        recordings_of(source, ["truck"])


def test_stretches_hold_every_start_once_and_the_last_is_no_stump():
    source = Source("a", ("a",), (), "", 0)
    for rows in (10, 149, 150, 151, 460, 1000):
        every = list(stretches(Piece(source, 0, rows, 0, rows, files=(("a", 0, rows),)), 100, 7))
        assert [p.first for p in every] == [0, *(p.stop for p in every[:-1])]
        assert every[-1].stop == rows
        assert all(p.stop - p.first == 100 for p in every[:-1])
        assert rows < 50 or every[-1].stop - every[-1].first >= 50
        assert len({p.identity for p in every}) == len(every)


def test_a_stretch_takes_along_only_the_files_that_it_reads(tmp_path):
    rng = np.random.default_rng(0)
    counts = rng.integers(1, 2000, 40)
    for number, count in enumerate(counts):
        write(tmp_path / f"weeks.parquet/{number:02}.parquet", int(count))
    (source,) = find_sources([tmp_path / "weeks.parquet"])
    (whole,) = recordings_of(source, [])
    rows = int(counts.sum())
    every = list(stretches(whole, 3000, 50))
    assert max(len(piece.files) for piece in every) < 20
    values = np.concatenate([np.arange(count) for count in counts])
    for piece in every:
        low, high = piece.reach(50)
        assert (low, high) == (max(piece.first - 1024, 0), min(piece.stop + 1074, rows))
        with at_hand(piece, (low, high)) as file:
            found = parquet.read_table(file)["x"].to_numpy()
        np.testing.assert_array_equal(found, values[low:high])


def test_a_data_set_without_rows_is_said(tmp_path):
    write(tmp_path / "week.parquet/0.parquet", rows=0)
    (week,) = find_sources([tmp_path / "week.parquet"])
    with pytest.raises(DataError, match="holds no rows"):
        recordings_of(week, [])

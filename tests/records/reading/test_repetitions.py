"""Names, headings and columns that stand twice, and what is below a table or cut off."""

import numpy as np
import pytest

import riecjax as rx
from riecjax.errors import DataError
from riecjax.records.reading.read import read_channels

ROWS = [f"{0.1 * i:.1f},{i},{2 * i}" for i in range(60)]


def read(tmp_path, *rows: str, end: str = "\n"):
    (tmp_path / "a.csv").write_text("\n".join(rows) + end)
    return read_channels(tmp_path / "a.csv")


def test_lines_below_the_table_are_skipped_and_counted(tmp_path):
    found = read(tmp_path, "t,a,b", *ROWS, "", "Mean,1,2", "Max,3,4", "made by hand")
    assert found.columns["a"].size == 60
    assert "3 lines below the table skipped" in found.notes


def test_text_among_the_rows_or_in_a_later_column_is_no_end(tmp_path):
    with pytest.raises(DataError, match="line 32: 'Mean' is not a number; correct it, or leave"):
        read(tmp_path, "t,a,b", *ROWS[:30], "Mean,1,2", *ROWS[30:])
    with pytest.raises(DataError, match="line 62: 'abc' is not a number"):
        read(tmp_path, "t,a,b", *ROWS, "6.0,1,abc")
    with pytest.raises(DataError, match="is not a number"):
        read(tmp_path, "t,a,b", *ROWS * 30, *["x,1,2"] * 100)


def test_only_a_last_line_that_is_not_ended_is_cut_off(tmp_path):
    found = read(tmp_path, "t,a,b", *ROWS, "6.0,6", end="")
    assert found.columns["a"].size == 60
    assert "the last line is cut off and left out" in found.notes
    with pytest.raises(DataError, match="line 62 has 2 values for 3 columns"):
        read(tmp_path, "t,a,b", *ROWS, "6.0,6")


def test_columns_of_one_name_are_numbered_where_they_differ(tmp_path):
    found = read(tmp_path, "t,x [mm],x [mm]", *ROWS)
    assert list(found.columns) == ["t", "x #1 [mm]", "x #2 [mm]"]
    record = rx.read_record(tmp_path / "a.csv", rename={"x": "x #2"})
    np.testing.assert_allclose(record["x"], 2e-3 * np.arange(60), rtol=1e-12)
    with pytest.raises(DataError, match=r"there is no column 'y'; there are: .*x #1"):
        rx.read_record(tmp_path / "a.csv", rename={"x": "y"})


def test_copies_are_read_once(tmp_path):
    found = read(tmp_path, "t,x,t", *(f"{row.rpartition(',')[0]},{row[:3]}" for row in ROWS))
    assert list(found.columns) == ["t", "x"]
    assert "1 copies of columns left out" in found.notes


def test_a_repeated_heading_keeps_the_numbers_of_lines(tmp_path):
    with pytest.raises(DataError, match="line 63: 'abc'"):
        read(tmp_path, "t,a,b", *ROWS[:30], "t,a,b", *ROWS[30:], "6.0,1,abc")


KINDS = {
    b"PK\x03\x04...": "zip archive",
    b"\x1f\x8b\x08": "gzip",
    b"\xd0\xcf\x11\xe0": "before 2007",
    b"\x89HDF\r\n": "HDF5",
}


@pytest.mark.parametrize("content", KINDS)
def test_another_format_under_the_name_of_text_is_named(tmp_path, content):
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(DataError, match=f"it is .*{KINDS[content]}.*, whatever its name says"):
        read_channels(tmp_path / "a.csv")


def test_a_file_without_a_line_of_numbers_is_shown(tmp_path):
    with pytest.raises(DataError, match=r"line 31 is '2\.9\^29\^58'\. Name delimiter"):
        read(tmp_path, "t^a^b", *(row.replace(",", "^") for row in ROWS))
    found = read_channels(tmp_path / "a.csv", delimiter="^")
    assert found.columns["b"][-1] == 118
    with pytest.raises(DataError, match="If commas are decimal signs too"):
        read(tmp_path, "t,a,b", *(f"0,{i},1,5,2,5" for i in range(60)))


def test_a_row_of_missing_samples_is_no_rule(tmp_path):
    found = read(tmp_path, "a b", *(["1 2"] * 9), "--- ---", *(["1 2"] * 9))
    assert np.flatnonzero(np.isnan(found.columns["a"])).tolist() == [9]
    ruled = read(tmp_path, "t    a", "---- ----", *(f"{i} 2" for i in range(9)), "", "(9 rows out)")
    assert ruled.columns["a"].size == 9


def test_a_row_of_units_with_an_unknown_one(tmp_path):
    found = read(tmp_path, "t,a,b", "s,mm,furlong", *ROWS)
    assert list(found.columns) == ["t", "a", "b"]
    assert found.units == {"t": "s", "a": "mm", "b": "furlong"}


def test_a_tab_as_it_is_typed(tmp_path):
    read(tmp_path, "t\ta", *(row.rpartition(",")[0].replace(",", "\t") for row in ROWS))
    assert read_channels(tmp_path / "a.csv", delimiter="\\t").columns["a"][-1] == 59


def test_an_open_quote_above_the_table_joins_no_lines(tmp_path):
    found = read(tmp_path, 'rod,"3/4 inch', "t,a,b", *ROWS)
    assert list(found.columns) == ["t", "a", "b"]
    assert found.columns["t"].size == 60

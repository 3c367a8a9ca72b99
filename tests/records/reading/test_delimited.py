"""Text files as loggers and spreadsheets write them, each by hand."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from riecjax.doubts.reading import read_record
from riecjax.errors import DataError
from riecjax.records.reading.channels import read_channels

LONG = 900
"""Rows of a file much longer than what its dialect is decided on."""


def columns(folder: Path, text: str | bytes, name: str = "a.csv", **dialect: Any):
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_channels(path, **dialect)


def values(folder: Path, text: str | bytes, **dialect: str) -> dict[str, list[float]]:
    return {k: v.tolist() for k, v in columns(folder, text, **dialect).columns.items()}


def message(folder: Path, text: str | bytes, **dialect: str) -> str:
    with pytest.raises(DataError) as raised:
        columns(folder, text, **dialect)
    assert str(raised.value).startswith("a.csv: ")
    assert "\n" not in str(raised.value)
    return str(raised.value)


TX = {"t": [0.0, 0.5, 1.0], "x": [1.5, -2e-3, 3.25]}
READABLE = {
    "comma": "t,x\n0,1.5\n0.5,-2e-3\n1,3.25\n",
    "semicolon": "t;x\n0;1.5\n0.5;-2e-3\n1;3.25\n",
    "bar": "t|x\n0|1.5\n0.5|-2e-3\n1|3.25\n",
    "blanks": "   t     x\n   0   1.5\n 0.5 -2e-3\n   1  3.25\n",
    "comma and blank": "t, x\n0, 1.5\n0.5, -2e-3\n1, 3.25\n",
    "decimal comma": "t;x\n0;1,5\n0,5;-2e-3\n1;3,25\n",
    "decimal comma and tab": "t\tx\n0\t1,5\n0,5\t-2E-03\n1,0\t3,25\n",
    "decimal comma in quotes": 't,x\n"0","1,5"\n"0,5","-2e-3"\n"1","3,25"\n',
    "no line end": "t,x\n0,1.5\n0.5,-2e-3\n1,3.25",
    "old line ends": "t,x\r0,1.5\r0.5,-2e-3\r1,3.25\r",
    "blank lines": "\n\nt,x\n\n0,1.5\n0.5,-2e-3\n   \n1,3.25\n\n\n",
    "end delimiter in rows": "t,x\n0,1.5,\n0.5,-2e-3,\n1,3.25,\n",
    "end delimiter throughout": "t;x;\n0;1,5;\n0,5;-2e-3;\n1;3,25;\n",
    "end delimiter in the header": "t,x,\n0,1.5\n0.5,-2e-3\n1,3.25\n",
    "empty rows of a spreadsheet": "t,x,,\n0,1.5,,\n0.5,-2e-3,,\n1,3.25,,\n,,,\n,,,\n",
    "comments": "# by a logger\n%two\nt,x\n0,1.5\n# paused, twice\n0.5,-2e-3\n//x\n1,3.25\n",
    "header in a comment": "# made by savetxt\n# t x\n0 1.5\n0.5 -2e-3\n1 3.25\n",
    "preamble as wide as the table": "Title,Run 7\nGain,2\nt,x\n0,1.5\n0.5,-2e-3\n1,3.25\n",
    "Fortran": "t,x\n0.,.15D+01\n.5,-2d-3\n1.,3.25D0\n",
    "semicolon comments": ";by a logger\nt,x\n0,1.5\n;paused\n0.5,-2e-3\n1,3.25\n",
}


@pytest.mark.parametrize("case", READABLE)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_one_table_in_every_dialect_and_encoding(tmp_path, case, encoding):
    assert values(tmp_path, READABLE[case].encode(encoding)) == TX


NAMELESS = {
    "comments above": "# logger 7\n0,1.5\n0.5,-2e-3\n1,3.25\n",
    "tabs at the end": "0\t1.5\t\n0.5\t-2e-3\t\n1\t3.25\t\n",
}


@pytest.mark.parametrize("case", NAMELESS)
def test_columns_without_names_have_numbers_or_those_given(tmp_path, case):
    numbered = values(tmp_path, NAMELESS[case])
    assert (numbered["column 1"], numbered["column 2"]) == (TX["t"], TX["x"])
    found = columns(tmp_path, NAMELESS[case], columns=("t", "x")).columns
    assert {k: v.tolist() for k, v in found.items()} == TX
    with pytest.raises(DataError, match=r"4 names are given for \d columns"):
        columns(tmp_path, NAMELESS[case], columns=("t", "x", "u", "v"))
    named = columns(tmp_path, READABLE["semicolon"], columns=("clock", "F")).columns
    assert {k: v.tolist() for k, v in named.items()} == {"clock": TX["t"], "F": TX["x"]}


LONG_ROWS = [f"{i / 8},{i},{2 * i}" for i in range(60)]
ODD = {
    "rows in brackets": (["[" + row + "]" for row in LONG_ROWS], "Take off brackets and labels"),
    "a MATLAB matrix": (["x = [", *LONG_ROWS, "];"], "1 column names but 3 .*--columns"),
    "another heading": (["t,a,b", *LONG_ROWS, "t,a,c", *LONG_ROWS], "line 62: 't' is not a number"),
    "means below": (["t,a,b", *LONG_ROWS, "Mean,1,2"], "line 62: 'Mean' is not a number; take off"),
    "a word among": (
        ["t,a,b", *LONG_ROWS, "6.0,1,abc"],
        "line 62: 'abc' is not a number; take off",
    ),
    "a short row": (["t,a,b", *LONG_ROWS, "6.0,6"], "line 62 has 2 values for 3 columns"),
    "another delimiter": (
        [r.replace(",", "^") for r in LONG_ROWS],
        r"is '3.75\^30\^60'\. Take off",
    ),
    "commas twice": (
        ["t,a", *(f"0,{i},1,5" for i in range(60))],
        "If commas are decimal signs too",
    ),
}


@pytest.mark.parametrize("case", ODD)
def test_odd_text_is_refused_in_one_line_that_says_what_to_do(tmp_path, case):
    rows, words = ODD[case]
    assert re.search(words, message(tmp_path, "\n".join(rows) + "\n"))


def test_names_again_and_columns_again(tmp_path):
    """A logger that opens its file again, and tables side by side."""
    rows = ["t,a,t,a", "s,mm,s,mm", *(f"{i},{i * i},{i},{-i}" for i in range(9))]
    found = columns(tmp_path, "\n".join([*rows, *rows[:2], "9,81,9,-9"]) + "\n")
    assert found.units == {"t": "s", "a": "mm", "a #2": "mm"}
    assert found.columns["a #2"].tolist() == [-float(i) for i in range(10)]
    assert "1 further row of names left out" in found.notes
    assert "a copy of column 't' left out" in found.notes


def test_only_a_last_line_that_is_not_ended_is_cut_off(tmp_path):
    found = columns(tmp_path, "\n".join(["t,a,b", *LONG_ROWS, "6.0,6"]))
    assert found.columns["a"].size == 60
    assert "the last line is cut off and left out" in found.notes


WHOLE, COMMAS = [f"{i};{i}" for i in range(3 * LONG)], [f"{i};{i},5" for i in range(LONG)]
TAILS = {
    "a column of decimals, then zeros": ([f"{i / 8:.3f}" for i in range(5 * LONG)], ["0"] * LONG),
    "zeros, then decimals": (["0"] * 390, ["0.125", "1.375"]),
    "two columns, then whole numbers": ([f"{i / 8} {i / 4}" for i in range(120)], ["7 8"] * 280),
    "whole numbers, then commas": (WHOLE, COMMAS),
    "whole numbers, then mostly commas": (WHOLE, 9 * COMMAS),
    "decimals, then exponents": (["0.5;1.5"] * LONG, ["1e-3;+2.", "5;.5D+01", "inf;1E2"]),
}


@pytest.mark.parametrize("case", TAILS)
def test_rows_far_below_the_first_ones_are_all_read(tmp_path, case):
    first, last = TAILS[case]
    found = values(tmp_path, "\n".join([*first, *last, ""]))
    rows = [re.split("[; ]", row.replace(",", ".").replace("D", "e")) for row in first + last]
    assert [*zip(*found.values())] == [tuple(map(float, row)) for row in rows]


NEVER = {
    "point, then comma": (["0;1.5"] * LONG, COMMAS, r"line 901: '0,5' is not .*--decimal"),
    "comma, then point": (["0;1,5"] * LONG, ["0;1.5"] * 2000, r"line 901: '1.5' .*--decimal"),
    "thousands or decimals": (WHOLE, ["1;1,234"], r"line 2701: '1,234' .*pass decimal"),
    "either in a unit": (["t;x", "s;"], ["1;1,234 mm"] * 9, r"line 3: '1,234' .*pass decimal"),
    "one column or two": (["7"] * LONG, ["7,5"], r"line 901: '7,5' .*two columns; pass decimal"),
    "wider": (["1 2"] * LONG, ["1 2 3"], r"line 901 has 3 values for 2 .*--delimiter"),
    "narrower": (["1,2"] * LONG, ["1", ""], r"line 901 has 1 values for 2 .*--delimiter"),
    "another delimiter": (["1;2"] * LONG, ["1\t2"] * 500, r"line 901 has 1 values.*--delimiter"),
    "fewer columns first": (["1,2"] * 100, ["1,2,3"] * 290, "line 1 has 2 values for 3 columns"),
    "a row number above": (["801"], ["0,1.5"] * 50, "line 1 has 1 values for 2 columns"),
    "two tables": (["a,b", *["1,2"] * 100], ["a,b,c", *["1,2,3"] * 290], "line 2 and 99 more hold"),
    "a word in the first row": (["0,err,3"], ["1,2,3"] * 50, "line 1: 'err' is not a number"),
    "an open quote": (['0,1,"a'] + ["1,2,b"] * 9, ['2,3,"c', "3,4,d"], "line 11: a text in quotes"),
}


@pytest.mark.parametrize("case", NEVER)
def test_rows_that_do_not_fit_are_refused_by_their_line(tmp_path, case):
    first, last, words = NEVER[case]
    assert re.search(words, message(tmp_path, "\n".join([*first, *last, ""])))


def test_what_a_formula_gives_is_no_comment_and_a_lone_number_above_the_names_is_said(tmp_path):
    found = columns(tmp_path, "801,0.5\nt,x,y\n" + "0,1,2\n#N/A,2,3\n2,#DIV/0!,4\n" * 9)
    assert np.isnan(found.columns["t"]).sum() == np.isnan(found.columns["x"]).sum() == 9
    assert found.notes == ["1 line above the column names skipped"]


KINDS = {b"PK\x03\x04...": "zip archive", b"\x1f\x8b\x08": "gzip", b"\x89HDF\r\n": "HDF5"}


@pytest.mark.parametrize("content", KINDS)
def test_another_format_under_the_name_of_text_is_named(tmp_path, content):
    assert re.search(f"it is .*{KINDS[content]}.*, whatever its name", message(tmp_path, content))


def test_missing_samples_open_quotes_and_unknown_units(tmp_path):
    found = columns(tmp_path, "a b\n" + "1 2\n" * 9 + "--- ---\n" + "1 2\n" * 9)
    assert np.flatnonzero(np.isnan(found.columns["a"])).tolist() == [9]
    found = columns(tmp_path, "\n".join(['rod,"3/4 inch', "t,a,b", *LONG_ROWS]))
    assert list(found.columns) == ["t", "a", "b"]
    found = columns(tmp_path, "\n".join(["t,a,b", "s,mm,furlong", *LONG_ROWS]))
    assert found.units == {"t": "s", "a": "mm", "b": "furlong"}
    tabbed = "\n".join(row.replace(",", "\t") for row in ["t,a,b", *LONG_ROWS])
    assert columns(tmp_path, tabbed, delimiter="\\t").columns["a"][-1] == 59


@pytest.mark.parametrize("case", [name for name in READABLE if "empty rows" not in name])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_dialects_of_long_files(tmp_path, case, ending):
    # The dialect is decided on the first lines only, and the rest must be read alike.
    cut = READABLE[case].rstrip("\n\r")
    last = cut.replace("\r", "\n").split("\n")[-1]
    text = cut + "\n" + "\n".join([last] * LONG) + "\n"
    if "old line" in case:
        text = text.replace("\r", "\n")
    found = values(tmp_path, text.replace("\n", ending))
    assert found == {"t": TX["t"] + [1.0] * LONG, "x": TX["x"] + [3.25] * LONG}


MISSING = ["", "NaN", "nan", "NA", "N/A", "#N/A", "null", "NULL", "-", "None", " ", "1.#QNAN"]


@pytest.mark.parametrize("text", MISSING)
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_missing_values_are_nan(tmp_path, text, delimiter):
    rows = [["t", "x", "y"], ["0", "1", "2"], ["1", text, "3"], ["2", "5", text], ["3", "7", "8"]]
    found = values(tmp_path, "\n".join(delimiter.join(row) for row in rows))
    np.testing.assert_array_equal(found["x"], [1, np.nan, 5, 7])
    np.testing.assert_array_equal(found["y"], [2, 3, np.nan, 8])


def test_a_blank_line_in_a_single_column_is_a_missing_sample(tmp_path):
    # Leaving it out would move all later samples by a time step.
    np.testing.assert_array_equal(values(tmp_path, "x\n1\n\n3\n\n")["x"], [1, np.nan, 3])


def test_a_name_without_its_unit_must_be_the_only_one(tmp_path):
    (tmp_path / "a.csv").write_text("t,F (N),F (kN)\n0,1,2\n1,2,3\n")
    assert "F (kN)" in read_record(tmp_path / "a.csv", rename={"f": "F (N)"}).arrays
    with pytest.raises(DataError, match=r"'F' may be any of: F \(N\), F \(kN\)"):
        read_record(tmp_path / "a.csv", rename={"f": "F"})


def test_an_unknown_unit_of_time_is_asked_for(tmp_path):
    (tmp_path / "a.csv").write_text("clock [ticks],x\n0,5\n2,6\n4,7\n")
    with pytest.raises(DataError, match="'ticks', which is not known; scale it"):
        read_record(tmp_path / "a.csv", rename={"t": "clock"})
    record = read_record(tmp_path / "a.csv", rename={"t": "clock"}, scale={"clock": 0.25})
    assert float(record.time_step) == 0.5


STAMPS = {
    "zone": ["2024-03-31T01:59:59.5+01:00", "2024-03-31T03:00:00.25+02:00", "2024-03-31T01:00:01Z"],
    "elapsed": ["100:00:00.0", "100:00:00.75", "100:00:01.50"],
    "ISO, zone after a blank": ["2024-05-01 10:00:00 +0200", "2024-05-01 08:00:00.75 UTC",
                                "2024-05-01 10:00:01.5 +02"],
    "day first, both below 13": ["1/2/2024 23:59:59.5", "2/2/2024 0:00:00.25", "2/2/2024 0:00:01"],
    "month first, both below 13": ["2/1/2024 23:59:59.5", "2/2/2024 0:00:00.25",
                                   "2/2/2024 0:00:01"],
    "year of two digits": ["31.03.24 23:59:59.5", "01.04.24 00:00:00.25", "01.04.24 00:00:01"],
    "minutes and seconds": ["59:59.5", "00:00.25", "00:01.0"],
    "weekday": [f'"Fri, 01 Mar 2024 12:00:{s} +0000"' for s in ("00.0", "00.75", "01.5")],
    "days elapsed": ["0 days 23:59:59.5", "1 days 00:00:00.25", "1 days 00:00:01"],
}  # fmt: skip


@pytest.mark.parametrize("case", STAMPS)
def test_time_stamps_become_seconds_from_the_first(tmp_path, case):
    text = "time,x\n" + "".join(f"{stamp},{i}\n" for i, stamp in enumerate(STAMPS[case]))
    assert values(tmp_path, text)["time"] == [0.0, 0.75, 1.5]


def test_nanoseconds_of_time_stamps_survive(tmp_path):
    stamps = [f"2024-05-01T10:00:{i // 1000:02d}.{i % 1000:03d}000000" for i in range(3000)]
    text = "time,x\n" + "".join(f"{stamp},1\n" for stamp in stamps)
    np.testing.assert_allclose(
        values(tmp_path, text)["time"], np.arange(3000) * 1e-3, rtol=0, atol=1e-11
    )


def test_dates_beside_elapsed_days_are_refused(tmp_path):
    text = "time,x\n2024-05-01 10:00:00,1\n3 days 10:00:00,2\n"
    assert "both dates and days" in message(tmp_path, text)


@pytest.mark.parametrize("bad", ["abc", "1.2.3", "0x10", "1_000", "--5", "1e"])
def test_one_bad_number_among_many_is_an_error_that_names_its_line(tmp_path, bad):
    rows = [[str(i), str(2 * i)] for i in range(700)]
    rows[600][1] = bad
    text = "# comment\nt;x\n" + "\n".join(";".join(row) for row in rows)
    assert f"line 603: '{bad}' is not a number" in message(tmp_path, text)


def test_the_line_of_a_bad_number_counts_comments_and_blank_lines(tmp_path):
    rows = "".join(f"{i},{i}\n" for i in range(20))
    text = f"made today\n\nt,x\ns,m\n# one\n\n{rows}#two\n20,abc\n"
    assert "line 28: 'abc'" in message(tmp_path, text)


ERRORS = {
    "empty": ("", "first row must name the columns"),
    "header only": ("t,x\n", "no samples below the column names"),
    "prose": ("Once upon a time\nthere was a file\n", "no line holds numbers"),
    "too few names": ("t,x\n0,1,5\n1,2,5\n", "2 column names but 3 columns"),
    "too many names": ("t,x,y\n0,1\n1,2\n", "3 column names but 2 columns"),
    "ragged": ("t,x\n0,1\n1\n2,3\n", "line 3 has 1 values for 2 columns"),
    "two times": ("t,a,t\n0,1,1\n1,1,1\n", "two columns are called 't' and differ; name"),
    "binary": (bytes(range(256)) * 20, "not a text file"),
    "null byte": (b"t,x\n0,\x00\n1,2\n", "not a text file"),
    "comma twice": ("t,x\n0,0,1,5\n0,5,2,5\n", "2 column names but 4 columns"),
    "long line": (b"t,x\n" + b"1" * 2**23, "no line holds numbers"),
    "no mark": ("t,x\n0,1\n1,2\n".encode("utf-16-le"), "save text as UTF-8"),
    "million columns": ("a," * 10**6 + "b\n" + "1," * 10**6 + "1\n", "at most 10000 are read"),
}


@pytest.mark.parametrize("case", ERRORS)
def test_unreadable_files(tmp_path, case):
    text, words = ERRORS[case]
    assert words in message(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "delimiter", "decimal", "expected"),
    [
        ("t;x\n0;1,234\n1;2,345\n", None, ",", [1.234, 2.345]),
        ("t;x\n0;1,234\n1;2,345\n", None, ".", [1234.0, 2345.0]),
        ("t;x\n0;1,234,567\n1;2,345\n", None, ".", [1234567.0, 2345.0]),
        ("t;x\n0;1.234,5\n1;2.345\n", None, ",", [1234.5, 2345.0]),
        ('t,x\n0,"1,234"\n1,"2,345"\n', None, ".", [1234.0, 2345.0]),
    ],
)
def test_thousands_or_decimals_are_never_guessed(tmp_path, text, delimiter, decimal, expected):
    assert re.search("pass decimal=',' or decimal='.'|--decimal", message(tmp_path, text))
    assert values(tmp_path, text, decimal=decimal)["x"] == expected


@pytest.mark.parametrize("proof", ["0,123", "12,3456", "1234,567", "1,5"])
def test_one_clear_decimal_comma_settles_the_others(tmp_path, proof):
    channels = columns(tmp_path, f"t;x\n0;1,234\n1;{proof}\n")
    assert channels.columns["x"].tolist() == [1.234, float(proof.replace(",", "."))]
    assert "decimal comma" in channels.notes


def test_one_column_with_commas_may_be_two(tmp_path):
    text = "x\n1,5\n2,25\n3,125\n"
    assert "'1,5' has a decimal comma, or two columns" in message(tmp_path, text)
    assert values(tmp_path, text, decimal=",")["x"] == [1.5, 2.25, 3.125]
    assert "1 column names but 2" in message(tmp_path, text, delimiter=",")


def test_the_dialect_can_be_given(tmp_path):
    text = "t:x\n0:1.5\n0.5:-2e-3\n1:3.25\n"
    assert values(tmp_path, text, delimiter=":") == TX
    for wrong in ({"delimiter": "ab"}, {"decimal": "x"}, {"delimiter": "\n"}):
        assert "must be" in message(tmp_path, text, **wrong)
    np.savez(tmp_path / "a.npz", t=np.arange(3.0))
    with pytest.raises(DataError, match="for text files"):
        read_channels(tmp_path / "a.npz", decimal=",")


def test_notes_say_what_was_decided(tmp_path):
    text = "Logger 7\n\nKraft;Zeit größer\n1,5;2\n# Pause\n2,5;3\n"
    notes = "; ".join(columns(tmp_path, text.encode("latin-1")).notes)
    for words in ("Latin-1", "semicolon", "decimal comma", "1 line above", "1 comment line sk"):
        assert words in notes
    assert columns(tmp_path, "t,x\n0,1\n1,2\n").notes == []


def test_numbers_are_read_to_the_last_bit(tmp_path):
    numbers = np.random.default_rng(3).normal(size=2000) * 10.0 ** np.arange(-300, 300, 0.3)
    text = "t,x\n" + "".join(f"{i},{x!r}\n" for i, x in enumerate(numbers.tolist()))
    assert values(tmp_path, text)["x"] == numbers.tolist()


def test_signs_between_thousands(tmp_path):
    # Not in threes: feet and inches, or a slip.
    assert "x" not in values(tmp_path, "t;x\n0;1'23\n0.5;4'5\n1;6'7\n")
    # With a fraction, commas between thousands cannot be decimal; without one they may be.
    quoted = 't,x\n0,"1,234.500"\n0.5,"-12,345,678.25"\n1,3.25\n'
    assert values(tmp_path, quoted)["x"] == [1234.5, -12345678.25, 3.25]
    assert values(tmp_path, "t;x\n0;1.234,5\n0,5;2,5\n1;3,25\n")["x"] == [1234.5, 2.5, 3.25]


def test_words_above_the_numbers(tmp_path):
    rows = "0;1.5\n0.5;-2e-3\n1;3.25\n"
    assert values(tmp_path, "t;x;Comment\n" + rows) == TX
    assert values(tmp_path, "t;x\nDATA\n" + rows) == TX
    assert values(tmp_path, "t;1\nsecond;Volt\n" + rows)["1"] == TX["x"]
    # A name too many is no remark.
    assert "3 column names but 2" in message(tmp_path, "t;x;y\n" + rows)

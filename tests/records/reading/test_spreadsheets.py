"""Workbooks of Excel, made with openpyxl: sheets, titles, cells of dates, decimal commas."""

import datetime

import numpy as np
import openpyxl
import pytest

import riecjax as rx
from damage import damaged, outcome
from riecjax.errors import DataError
from riecjax.records.reading.read import read_channels

TIME = np.arange(40) * 0.05
X = np.sin(TIME) / 3
DIGITS = 1e-15
"""Excel's and openpyxl's 16 digits."""


def workbook(path, **sheets):
    book = openpyxl.Workbook()
    book.remove(book.worksheets[0])
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(list(row))
    book.save(path)
    return path


def table(x=X, head=("t [s]", "x [mm]")):
    return [head, *zip(TIME.tolist(), x.tolist(), strict=True)]


@pytest.mark.portable
def test_a_sheet_below_a_title(tmp_path):
    path = workbook(tmp_path / "a.xlsx", Notes=[["Rig 3"]], Data=[["a title"], [], *table()])
    channels = read_channels(path)
    np.testing.assert_allclose(channels.columns["x [mm]"], X, rtol=DIGITS)
    assert "sheet 'Data'" in channels.notes
    np.testing.assert_allclose(rx.read_record(path)["x"], X * 1e-3, rtol=DIGITS)


def test_sheets_with_the_same_columns_are_recordings(tmp_path):
    path = workbook(tmp_path / "a.xlsx", One=table(), Two=table(2 * X))
    read = rx.read_recordings(path)
    assert [one.part for one in read] == ["One", "Two"]
    np.testing.assert_allclose(read[1].record["x"], 2 * X * 1e-3, rtol=DIGITS)


def test_sheets_of_different_kinds_are_asked_about(tmp_path):
    path = workbook(tmp_path / "a.xlsx", One=table(), Two=table(head=("t [s]", "F [N]")))
    with pytest.raises(DataError, match=r"of several kinds: One with .*; Two with .*--part"):
        rx.read_recordings(path)
    np.testing.assert_allclose(rx.read_record(path, part="Two")["F"], X, rtol=DIGITS)


def test_dates_and_numbers_as_text(tmp_path):
    start = datetime.datetime(2024, 3, 1, 12)
    rows = [
        (start + datetime.timedelta(milliseconds=50 * i), f"{x:.6f}".replace(".", ","))
        for i, x in enumerate(X)
    ]
    record = rx.read_record(workbook(tmp_path / "a.xlsx", S=[("Time", "x"), *rows]))
    np.testing.assert_allclose(float(record.time_step), 0.05, rtol=1e-6)
    np.testing.assert_allclose(record["x"], X, atol=5e-7)


def test_no_table(tmp_path):
    path = workbook(tmp_path / "a.xlsx", Notes=[["only words", "and more"]])
    with pytest.raises(DataError, match=r"^a\.xlsx: no sheet holds a table of numbers: sheet 'N"):
        read_channels(path)


def test_without_the_library_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(DataError, match=r'pip install "riecjax\[excel\]"'):
        read_channels(workbook(tmp_path / "a.xlsx", S=table()))


@pytest.mark.slow
def test_damaged_files(tmp_path):
    content = workbook(tmp_path / "whole.xlsx", S=table()).read_bytes()
    rng = np.random.default_rng(20240501)
    refused = [outcome(tmp_path / "a.xlsx", damaged(content, rng)) for _ in range(12)]
    assert sum(message is not None for message in refused) > 5

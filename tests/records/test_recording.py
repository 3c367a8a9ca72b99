"""What a recording keeps of its file beside the record."""

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import riecjax as rx
from riecjax.equations.quantity import Quantity
from riecjax.records.recording import as_recordings

MODEL = rx.Model(
    "cart",
    "",
    signals=(Quantity("q", "m", ""), Quantity("v", "m/s", "")),
    derived={"v": "q"},
)


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def write(text: str) -> None:
    Path("a.csv").write_text(text)


def rows(header: str, *columns: str, samples: int = 40) -> str:
    lines = [
        ",".join(column.format(i=i, t=0.1 * i) for column in ("{t:.1f}", *columns))
        for i in range(samples)
    ]
    return "\n".join([header, *lines]) + "\n"


def test_units_of_the_model_and_derivatives_that_the_file_lacks():
    write(rows("t,q [mm]", "{i}"))
    recording = rx.read_recording("a.csv", model=MODEL)
    assert dict(recording.record.units) == {"q": "m", "v": "m/s"}
    np.testing.assert_allclose(recording.record["v"][1:-1], 0.01)
    assert recording.findings == ()
    assert recording.converted == {"q": "mm"}
    assert recording.steps[1:] == ("q: mm to m", "v: central differences of q")
    scaled = rx.read_recording("a.csv", model=MODEL, scale={"q": 1e-3})
    assert scaled.findings == ()
    assert scaled.converted == {}
    assert np.array_equal(scaled.record["q"], recording.record["q"])


@pytest.mark.raises_finding("unit_mismatch")
def test_a_unit_of_another_kind_is_pointed_out():
    write(rows("t,q [N]", "{i}"))
    recording = rx.read_recording("a.csv", model=MODEL)
    (finding,) = recording.findings
    assert (finding.code, finding.signals) == ("unit_mismatch", ("q",))
    corrected = rx.read_recording("a.csv", model=MODEL, units={"q": "cm"})
    assert corrected.findings == ()
    np.testing.assert_allclose(corrected.record["q"], 0.01 * np.arange(40.0), rtol=1e-15)


def test_a_unit_goes_to_one_column_and_not_beside_a_scale():
    write(rows("t,x", "{i}"))
    with pytest.raises(rx.DataError, match=r"^a\.csv: 'x' is given both a scale and a unit"):
        rx.read_recording("a.csv", units={"x": "mm"}, scale={"x": 2.0})
    with pytest.raises(rx.DataError, match="'q' and 'x' is given both a scale and a unit"):
        rx.read_recording("a.csv", rename={"q": "x"}, units={"x": "mm"}, scale={"q": 2.0})
    with pytest.raises(rx.DataError, match="'x' and 'q' are one column, given two units"):
        rx.read_recording("a.csv", rename={"q": "x"}, units={"x": "mm", "q": "m"})
    with pytest.raises(rx.DataError, match="no column 'y'"):
        rx.read_recording("a.csv", units={"y": "mm"})


@pytest.mark.raises_finding("nothing_cut")
def test_preparation_is_taken_in_its_order_and_said():
    write(rows("t,x", "{i}"))
    recording = rx.read_recording("a.csv", start=1.0, stop=99.0, offsets=["x"], every=2)
    assert recording.steps == (
        "40 rows of 2 columns of numbers read",
        "cut from 1 s to the end",
        "x: mean removed",
        "one sample of 2",
        "15 of 40 samples left, from 1 s on",
    )
    assert [finding.code for finding in recording.findings] == ["nothing_cut"]
    np.testing.assert_allclose(recording.record["x"], np.arange(10, 40, 2) - 24.5)
    record = rx.read_record("a.csv", start=1.0, stop=99.0, offsets=["x"], every=2)
    np.testing.assert_array_equal(record["x"], recording.record["x"])


def test_a_column_that_is_no_signal_is_kept_with_the_reason():
    write(rows("t,q,v,note", "{i}", "", "on"))
    recording = rx.read_recording("a.csv", model=MODEL)
    assert set(recording.left_out) == {"v", "note"}
    assert "no number" in recording.left_out["v"]
    (finding,) = recording.findings
    assert (finding.code, finding.signals) == ("column_left_out", ("v",))
    said = "column 'v' was left out: it holds no number"
    with pytest.raises(rx.DataError, match=rf"^a\.csv: {said}.*no signal 'v'; it has: q\.$"):
        rx.read_record("a.csv", offsets=["v"])
    with pytest.raises(
        rx.DataError,
        match=r"^a\.csv: there is no signal 'q': its column was renamed to 'p' .--map p=q",
    ):
        rx.read_record("a.csv", rename={"p": "q"}, offsets=["q"])


def test_it_shows_itself_and_splits():
    write(rows("t,q [N]", "{i}"))
    recording = rx.read_recording("a.csv", model=MODEL, drifts=("q",))
    for words in ("a.csv: 40 samples at 10 Hz", "q [m]", "prepared: q: straight", "[unit_mism"):
        assert words in str(recording) == repr(recording)
    first, last = recording.split(0.25)
    assert (first.name, last.name) == ("a.csv", "a.csv, last part")
    assert (first.record.sample_count, last.record.sample_count) == (30, 10)
    assert last.steps == recording.steps
    assert as_recordings([first, recording.record])[0] is first
    assert as_recordings([first, recording.record])[1].name == "record 2"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"rename": ["x"]}, "rename="),
        ({"offsets": "x"}, "offsets="),
        ({"model": "quarter-car"}, "rx.find_model"),
        ({"path": 3}, "rx.read_recording"),
    ],
)
def test_slips_are_named_with_what_to_write(settings, words):
    write(rows("t,x", "{i}"))
    with pytest.raises(rx.RiecjaxError) as error:
        cast(Any, rx.read_recording)(**{"path": "a.csv", **settings})
    assert words in str(error.value)

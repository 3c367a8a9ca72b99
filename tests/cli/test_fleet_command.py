"""`riecjax fleet`, as a user runs it."""

import json
import shutil
from pathlib import Path

import pytest
from command_line import call
from pyarrow import parquet
from tests.machines import drag_fleet as drives

from riecjax.records.writing import write_record


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("drives")
    for vehicle in range(5):
        own = place / f"vehicle={vehicle}"
        own.mkdir()
        worn = {"r": 0.4, "r2": 0.25} if vehicle == 3 else {}
        for i, record in enumerate(drives(2, 1500, 20 + vehicle, **worn)):
            write_record(own / f"{i}.parquet", record)
    (place / "vehicle=0/broken.csv").write_text("t,x\n")
    return place


MODEL = ("--model", "drag-oscillator", "--workers", "0")


def test_a_fleet_is_answered_in_a_sentence_with_tables_and_a_report(capsys, folder, tmp_path):
    out = tmp_path / "out"
    status, printed, said = call(capsys, "fleet", folder, *MODEL, "--by", "vehicle", "--out", out)
    assert status == 0, said
    sentence = printed.splitlines()[0]
    assert sentence.startswith("5 groups of 10 recordings: ")
    assert "r differs in vehicle=3 (-" in sentence
    assert sentence.endswith("1 recording was left out.")
    assert "broken.csv: " in printed
    assert f"wrote {out}/results.json, report.html, estimates.parquet, summaries.par" in printed
    assert "In 1 % of courses" not in printed
    document = json.loads((out / "results.json").read_text())
    assert document["sentence"] == sentence
    assert document["parameters"]["r"]["differing"][0]["group"] == "vehicle=3"
    assert document["recordings"]["left_out"] == 1
    assert parquet.read_table(out / "estimates.parquet").num_rows == 5 * 4 + 1
    assert parquet.read_table(out / "summaries.parquet").num_rows == 11
    assert "vehicle=3" in (out / "report.html").read_text()
    assert "riecjax: summing: 11 of 11" in said


@pytest.mark.slow
def test_spans_settings_and_json(capsys, folder, tmp_path):
    given = ("fleet", f"{folder}/vehicle=1/*", *MODEL, "--span", "2", "--set", "k=20")
    status, printed, said = call(
        capsys, *given, "--alpha", "0.1", "--json", "--out", tmp_path / "o"
    )
    assert status == 0, said
    document = json.loads(printed)
    assert document["criterion"]["alpha"] == 0.1
    assert [one["group"] for one in document["estimates"]] == 3 * ["0.parquet"] + 3 * ["1.parquet"]
    rows = parquet.read_table(tmp_path / "o/estimates.parquet").to_pylist()
    assert {row["parameter"] for row in rows} == {"m", "r", "r2"}
    assert len({row["start"] for row in rows}) > 2


def test_sums_are_estimated_anew(capsys, folder, tmp_path):
    given = ("fleet", folder / "vehicle=1", *MODEL, "--out", tmp_path / "first")
    assert call(capsys, *given)[0] == 0
    drives_of = folder / "vehicle=1"
    hidden = shutil.move(drives_of, tmp_path / "elsewhere")
    try:
        table = tmp_path / "first/summaries.parquet"
        status, printed, said = call(capsys, "fleet", table, *MODEL, "--out", tmp_path / "second")
    finally:
        shutil.move(hidden, drives_of)
    assert status == 0, said
    first, second = (tmp_path / name / "estimates.parquet" for name in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()
    assert printed.startswith("2 groups: ")
    assert "Parameters of each group" in printed


@pytest.mark.parametrize(
    ("given", "status", "why"),
    [
        (("absent/*.csv",), 1, "nothing that can be read matches 'absent/*.csv'"),
        (("{folder}", "--strict"), 1, "broken.csv: "),
        (("{folder}", "--by", "truck"), 1, "truck"),
        (("{folder}", "--windows", "100"), 1, "a fleet sums all windows"),
        (("{folder}", "--scheduler", "tcp://127.0.0.1:1"), 2, "give one"),
        (("{folder}", "--span", "-1"), 2, "--span"),
    ],
)
def test_mistakes_are_one_line(capsys, folder, tmp_path, given, status, why):
    given = [one.format(folder=folder) for one in given]
    found = call(capsys, "fleet", *given, *MODEL, "--out", tmp_path / "o")
    assert found[0] == status
    told = [line for line in found[2].splitlines() if not line.startswith("riecjax: summing")]
    assert len(told) == 1
    assert why in told[0]
    assert not (tmp_path / "o/results.json").exists()

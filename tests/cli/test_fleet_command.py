"""`riecjax fleet`: tables for machines, sums that are estimated anew, and a strict end."""

from pathlib import Path

import pytest
from command_line import call
from tests.approved.inputs import INPUTS

MODEL = ("--model", "drag-oscillator", "--workers", "0")


@pytest.fixture(scope="module")
def drives(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("fleet")
    INPUTS["drives"](place)
    return place / "drives"


@pytest.mark.parametrize(
    ("given", "status", "why"),
    [
        (("absent/*.csv",), 1, "nothing that can be read matches 'absent/*.csv'"),
        (("{drives}", "--strict"), 1, "broken.csv: "),
        (("{drives}", "--by", "truck"), 1, "truck"),
        (("{drives}", "--windows", "100"), 1, "a fleet sums all windows"),
        (("{drives}", "--scheduler", "tcp://127.0.0.1:1"), 2, "give one"),
        (("{drives}", "--span", "-1"), 2, "--span"),
    ],
)
def test_mistakes_are_one_line(capsys, drives, tmp_path, given, status, why):
    words = [word.format(drives=drives) for word in given]
    result = call(capsys, "fleet", *words, *MODEL, "--out", tmp_path / "o")
    assert result.status == status
    told = [line for line in result.err.splitlines() if not line.startswith("riecjax: summing")]
    assert len(told) == 1
    assert why in told[0]
    assert not (tmp_path / "o/results.json").exists()

"""What the command line prints, five lines of Python find."""

import json
import shlex
from pathlib import Path

import jax
import msgspec
import pytest
from command_line import call, write_csv
from test_own_recordings import MODEL, motion

import riecjax as rx
from nightly import nightly
from riecjax.reporting import answer_of


@pytest.mark.parametrize(
    ("windows", "sweep"), [("all", False), *nightly([("all", True), (500, True)])]
)
def test_every_number_of_the_command_line(capsys, windows, sweep):
    Path("machine.py").write_text(MODEL)
    write_csv(Path("run.csv"), motion(offset=4.0, count=3000))
    options = ("--alpha", "0.1", "--beta", "0.5", "--windows", windows, "--test-function", "hat")
    options += ("--hold-out", "0.3", "--remove-drift", "q", "--json")
    options += () if sweep else ("--no-sweep",)
    printed = call(capsys, "identify", "run.csv", "--model", "machine.py:axis", *options).document

    model = rx.find_model("machine.py:axis")
    recording = rx.read_recording("run.csv", model=model, drifts=["q"])
    drawn = rx.AllWindows(0.1, 0.5) if windows == "all" else rx.RandomWindows(0.1, 0.5, 500)
    criterion = rx.RIEC(drawn, rx.Hat())
    found = rx.assess(model, recording, criterion, key=jax.random.key(0), hold_out=0.3, sweep=sweep)

    # What only a command line has: the command, and those that go on from it.
    asked = ["riecjax", "identify", "run.csv", "--model", "machine.py:axis", *map(str, options)]
    assert printed["provenance"]["command"] == shlex.join(asked)
    assert printed.pop("job")["alpha"] == 0.1
    assert len(printed.pop("checksum")) == 64
    assert [one["file"] for one in printed["provenance"].pop("files")] == ["machine.py", "run.csv"]
    document = msgspec.to_builtins(answer_of(found, asked[1:]))
    assert json.loads(json.dumps(document)) == printed
    codes = [warning["code"] for warning in printed["warnings"]]
    assert [finding.code for finding in found.findings()] == codes
    if windows == "all":
        rx.reporting.write_report(found, "report")
        written = json.loads(Path("report/results.json").read_text())
        assert written["provenance"].pop("command") is None
        assert written["parameters"] == printed["parameters"]
        assert written["residual_tests"] == printed["residual_tests"]
        assert Path("report/report.html").stat().st_size > 0
        assert Path("report/fit.png").exists()
    for name, entry in printed["parameters"].items():
        assert f"{name} " in str(found)
        assert float(found.estimate[name]) == entry["value"]

"""`riecjax discover`, as a user runs it."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import call, rejected, write_csv
from tests.machines import PROBLEMS

DUFFING = PROBLEMS["duffing"]
MODEL = """
import riecjax as rx

RIG = rx.Model(
    "rig",
    "a mass that is pushed",
    procedure=lambda: rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("dx",), unit="kg"),
        -rx.Term(1.0, "u"),
        name="rig",
        unit="N",
    ),
    derived={"dx": "x"},
)
LAWS = [rx.Term("spring", "x"), rx.Term("cubic", rx.odd("x", 3)), rx.Term("dry", rx.odd("dx", 0))]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    record = DUFFING.record(0.01, 0)
    write_csv(
        folder / "rig.csv",
        {
            "t": np.arange(record.sample_count) * 0.01,
            **{name: np.asarray(values) for name, values in record.arrays.items()},
        },
    )
    (folder / "rig.py").write_text(MODEL)
    return folder


def test_missing_terms_are_told_and_the_model_file_runs(capsys, place, tmp_path):
    out, model = tmp_path / "out", f"{place}/rig.py:RIG"
    given = ("discover", place / "rig.csv", "--model", model, "--out", out)
    status, printed, said = call(capsys, *given)
    assert status == 0, said
    sentence = printed.splitlines()[0]
    for name in DUFFING.missing:
        assert name in sentence
    assert "are missing: with them 0.045 % of the target's energy is unexplained" in sentence
    assert "+ cubic_stiffness" in printed
    assert (
        "m x'' + cubic_stiffness x^3 + stiffness x + viscous x' + coulomb sign(dx) = u\n" in printed
    )
    document = json.loads((out / "results.json").read_text())
    assert document["sentence"] == sentence
    assert {*document["chosen"]} == DUFFING.missing
    assert document["path"][0]["added"] == ""
    assert document["path"][-1]["unexplained"] < 1e-3
    assert {step["added"] for step in document["path"][1:]} == DUFFING.missing
    assert document["parameters"]["coulomb"]["unit"] == "N"
    low, high = document["parameters"]["coulomb"]["interval95"]
    assert low < 1.5 < high
    assert document["model_file"] == str(out / "model.py")
    assert "coulomb" in (out / "report.html").read_text()

    found = call(
        capsys, "identify", place / "rig.csv", "--model", out / "model.py", "--refine", "none",
        "--json",
    )  # fmt: skip
    assert found.status == 0, found.err
    values = {k: v["value"] for k, v in found.document["parameters"].items()}
    assert values == pytest.approx({k: v["value"] for k, v in document["parameters"].items()})
    made = ("--input", place / "rig.csv", "--out", tmp_path / "again.csv")
    status, _, said = call(capsys, "simulate", out / "model.py", *made)
    assert status == 0, said
    again = np.genfromtxt(tmp_path / "again.csv", delimiter=",", names=True)
    clean = DUFFING.signals()["x"]
    assert np.std(again["x"][:1000] - clean[:1000]) < 0.05 * clean.std()


@pytest.mark.slow
def test_candidates_of_a_file_and_held_out_samples(capsys, place):
    model = f"{place}/rig.py:RIG"
    given = ("--candidates", f"{place}/rig.py:LAWS", "--hold-out", "0.3", "--json")
    found = call(capsys, "discover", place / "rig.csv", "--model", model, *given)
    assert found.status == 0, found.err
    assert {"spring", "cubic"} <= {*found.document["chosen"]}
    assert found.document["held_out"] == 0.3
    assert found.document["model_file"] is None


def test_what_makes_no_sense_is_told_in_a_line(capsys, place, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "few.py").write_text("LAWS = ['x']\n")
    base = ("discover", place / "rig.csv", "--model", f"{place}/rig.py:RIG", "--out", "out")
    assert "a candidate is the text 'x'" in rejected(
        capsys, 1, *base, "--candidates", "few.py:LAWS"
    )
    assert "no object 'NONE'" in rejected(capsys, 1, *base, "--candidates", "few.py:NONE")
    assert "is longer than the record" in rejected(
        capsys, 1, *base, "--to", "0.4", "--beta", "0.5", "--alpha", "0.1"
    )

"""`riecjax discover`: what it finds is true, and the model file that it writes runs."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import call, write_csv
from tests.approved.inputs import TEXTS
from tests.machines import PROBLEMS

import riecjax as rx
from nightly import by_day
from riecjax.discovery.candidate import Shaped, default_candidates, members
from riecjax.discovery.discover import Chosen, Discovery, extended, model_source
from riecjax.models.catalogue import find_model

DUFFING = PROBLEMS["duffing"]


@pytest.mark.slow
def test_missing_terms_are_told_and_the_model_file_runs(capsys):
    record = DUFFING.record(0.01, 0)
    signals = {name: np.asarray(values) for name, values in record.arrays.items()}
    write_csv(Path("rig.csv"), {"t": np.arange(record.sample_count) * 0.01, **signals})
    Path("rig.py").write_text(TEXTS["rig.py"])
    quick = ("--intervals", "sandwich")
    status, printed, said = call(
        capsys, "discover", "rig.csv", "--model", "rig.py:RIG", "--out", "out", *quick
    )
    assert status == 0, said
    document = json.loads(Path("out/results.json").read_text())
    assert printed.splitlines()[0] == document["sentence"]
    assert {*document["chosen"]} == DUFFING.missing
    assert document["path"][-1]["unexplained"] < 1e-3
    # Of one draw of noise: within four standard errors, as 95 % intervals miss one draw of twenty.
    low, high = document["parameters"]["coulomb"]["interval95"]
    assert abs((low + high) / 2 - 1.5) < high - low
    assert "coulomb" in Path("out/report.html").read_text()

    asked = ("--model", "out/model.py", "--refine", "none", "--json", *quick)
    found = call(capsys, "identify", "rig.csv", *asked)
    assert found.status == 0, found.err
    values = {k: v["value"] for k, v in found.document["parameters"].items()}
    assert values == pytest.approx({k: v["value"] for k, v in document["parameters"].items()})
    Path("job.toml").write_text("records = ['rig.csv']\nmodel = 'rig.py:RIG'\nleast = 0.02\n")
    again = call(capsys, "check", "--job", "job.toml")
    assert again.err == "warning: --job job.toml: check does not use least.\n"
    assert again.status == call(capsys, "check", "--job", "out").status == 0
    made = ("--input", "rig.csv", "--out", "again.csv")
    status, _, said = call(capsys, "simulate", "out/model.py", *made)
    assert status == 0, said
    again = np.genfromtxt("again.csv", delimiter=",", names=True)
    clean = DUFFING.signals()["x"]
    assert np.std(again["x"][:1000] - clean[:1000]) < 0.05 * clean.std()


RIG = """import riecjax as rx

RIG = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("dx",), unit="kg"),
    -rx.Term(1.0, "u"),
    name="rig",
    unit="N",
)
"""


def simulates(capsys, file: str) -> bool:
    made = ("--input", "white-noise", "--duration", "2", "--out", "noise.csv")
    status, _, said = call(capsys, "simulate", f"{file}:MODEL", *made)
    assert status == 0, said
    return bool(np.isfinite(np.genfromtxt("noise.csv", delimiter=",", skip_header=1)).all())


@pytest.mark.parametrize("only", by_day(["", "bouc_wen"], "bouc_wen"))
def test_the_file_with_any_kind_of_candidate_is_simulated(only, capsys):
    Path("rig.py").write_text(RIG)
    record = PROBLEMS["drag"].record(0.01, 0)
    valve = 0.5 + np.sin(0.01 * np.arange(record.sample_count))
    model, record = find_model("rig.py:RIG"), record.with_signals({"valve": valve})
    for one in default_candidates(model, [record]):
        if only in one.name:
            one = members([one])[1].settled if isinstance(one, Shaped) else one
            larger = extended(model, [one])
            estimate = rx.identify(larger, record, intervals=rx.Naive())
            chosen = (Chosen(one, one.width, "", 0.0, 1.0),)
            found = Discovery(larger, model, chosen, (), {}, estimate, {}, 0.0, 1)
            Path(f"{one.name}.py").write_text(model_source(found, "rig.py:RIG", Path()))
            assert simulates(capsys, f"{one.name}.py")
    assert only or len([*Path().glob("*.py")]) == 22


def test_the_file_has_values_that_were_stated(capsys):
    Path("rig.py").write_text(RIG)
    signals = PROBLEMS["drag"].signals(0.01, 0)
    write_csv(Path("rig.csv"), {"t": np.arange(len(signals["x"])) / 200, **signals})
    asked = ("--model", "rig.py:RIG", "--set", "m=1.5", "--intervals", "sandwich")
    status, _, said = call(capsys, "discover", "rig.csv", *asked, "--out", "out")
    assert status == 0, said
    assert '"m": 1.5' in Path("out/model.py").read_text()
    assert simulates(capsys, "out/model.py")

"""An element from outside the package, in 40 lines, goes wherever the package's own go."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.signal
from inerter import Inerter

import riecjax as rx
from riecjax.cli.main import run
from riecjax.models.catalogue import with_asked

TRUTH = {"m1": 30.0, "m2": 200.0, "c": 900.0, "k": 15000.0, "kt": 60000.0, "b": 25.0}
STEP = 0.005
MODEL_FILE = """
import riecjax as rx

TWO_BODIES = rx.Model(
    "two bodies",
    stages=rx.simultaneous(
        rx.Equation(
            rx.Term("m1", "v1", derivative=1, unit="kg"),
            rx.Term("c", rx.difference("v1", "v2"), unit="N s/m"),
            rx.Term("k", rx.difference("x1", "x2"), unit="N/m"),
            rx.Term("kt", "x1", unit="N/m"),
            -rx.Term(1.0, "F"),
            name="wheel",
            unit="N",
        ),
        rx.Equation(
            rx.Term("m2", "v2", derivative=1, unit="kg"),
            -rx.Term("c", rx.difference("v1", "v2"), unit="N s/m"),
            -rx.Term("k", rx.difference("x1", "x2"), unit="N/m"),
            name="body",
            unit="N",
        ),
    ),
    rates={"x1": "v1", "x2": "v2"},
    inputs=(rx.equations.Quantity("F", "N", "force on the wheel"),),
)
"""


def exact(force):
    """Positions and velocities of both bodies, by the exact solution of the linear system."""
    t = TRUTH
    masses = np.array([[t["m1"] + t["b"], -t["b"]], [-t["b"], t["m2"] + t["b"]]])
    springs = np.array([[t["k"] + t["kt"], -t["k"]], [-t["k"], t["k"]]])
    dampers = t["c"] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    rate = np.block(
        [
            [np.zeros((2, 2)), np.eye(2)],
            [-np.linalg.solve(masses, springs), -np.linalg.solve(masses, dampers)],
        ]
    )
    pushed = np.concatenate([np.zeros(2), np.linalg.solve(masses, [1.0, 0.0])])[:, None]
    system = scipy.signal.StateSpace(rate, pushed, np.eye(4), np.zeros((4, 1)))
    _, states, _ = scipy.signal.lsim(system, force, np.arange(force.size) * STEP)
    return dict(zip(("x1", "x2", "v1", "v2"), states.T))


@pytest.fixture(scope="module")
def signals():
    rng = np.random.default_rng(3)
    passed = scipy.signal.butter(2, [0.5, 12.0], "bandpass", fs=1 / STEP, output="sos")
    force = 4000 * np.asarray(scipy.signal.sosfilt(passed, rng.standard_normal(6000)))
    clean = exact(force)
    noisy = {n: x + 0.002 * np.std(x) * rng.standard_normal(x.size) for n, x in clean.items()}
    return {**noisy, "F": force}


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "bodies.py"
    path.write_text(MODEL_FILE)
    return rx.find_model(f"{path}:TWO_BODIES")


@pytest.fixture(scope="module")
def record(signals):
    return rx.Record.from_samples(signals, time_step=STEP)


def near(found, share):
    for name, value in TRUTH.items():
        assert float(found[name]) == pytest.approx(value, rel=share), name


def test_it_is_identified_simulated_and_refined(model, record):
    larger = model.with_elements(Inerter("v1-v2"))
    assert larger.parameter_names[-1] == "b" or "b" in larger.parameter_names
    found = rx.identify(larger, record)
    near(found, 0.03)
    # Without it the bodies' masses stand for it.
    assert abs(float(rx.identify(model, record)["m1"]) / TRUTH["m1"] - 1) > 0.3
    system = larger.build_system(TRUTH)
    made = rx.simulate(system, record).checked().record
    clean = exact(np.asarray(record["F"]))
    assert np.max(np.abs(made["v2"] - clean["v2"])) < 2e-3 * np.max(np.abs(clean["v2"]))
    start = {name: 1.15 * value for name, value in TRUTH.items()}
    near(rx.refine(larger, record, start, rx.OutputError()), 0.03)


def test_it_is_assessed(model, record):
    larger = model.with_elements(Inerter("v1-v2"))
    assessment = rx.assess(larger, record)
    assert assessment.verdict.parameters["b"].level == "good"
    assert "with an inerter between v1 and v2" in str(larger)


def test_the_command_line_and_the_page_show_it(signals, tmp_path, capsys):
    (tmp_path / "bodies.py").write_text(MODEL_FILE)
    (tmp_path / "inerter.py").write_text((Path(__file__).parent / "inerter.py").read_text())
    table = np.column_stack([np.arange(6000) * STEP, *signals.values()])
    header = ",".join(["t", *signals])
    np.savetxt(tmp_path / "drive.csv", table, delimiter=",", header=header, comments="")
    arguments = [
        "identify",
        str(tmp_path / "drive.csv"),
        "--model",
        f"{tmp_path}/bodies.py:TWO_BODIES",
    ]
    added = ["--add", f"{tmp_path}/inerter.py:Inerter:v1-v2", "--out", str(tmp_path / "out")]
    assert run([*arguments, *added]) == 0
    assert "b " in capsys.readouterr().out
    document = json.loads((tmp_path / "out" / "results.json").read_text())
    assert document["parameters"]["b"]["value"] == pytest.approx(TRUTH["b"], rel=0.05)
    assert document["equations"][-1] == "with an inerter between v1 and v2"
    assert "an inerter between v1 and v2" in (tmp_path / "out" / "report.html").read_text()
    wrong = ["--add", f"{tmp_path}/inerter.py:Inerter:v1-v9"]
    assert run([*arguments, *wrong]) == 1
    assert "no equation accelerates v9" in capsys.readouterr().err
    assert run([*arguments, "--add", f"{tmp_path}/inerter.py:Absent:v1-v2"]) == 1
    assert "has no object 'Absent'" in capsys.readouterr().err


def test_a_class_that_is_no_element_is_refused(model, tmp_path):
    (tmp_path / "other.py").write_text("Inerter = 3\n")
    asked = rx.settings.Elements(added=[(f"{tmp_path}/other.py:Inerter", "v1-v2", None)])
    with pytest.raises(rx.ModelError, match="is no class derived from"):
        with_asked(model, asked)


class HalfDone(Inerter):
    """Searched, and silent about its search."""

    coordinates = 1


class Breaking(Inerter):
    """Fails in the middle of its own code."""

    def in_equation(self, equation, units):
        raise KeyError("of mine")


class Elsewhere(Inerter):
    """Changes no equation."""

    def in_equation(self, equation, units):
        return equation


@pytest.mark.parametrize(
    ("element", "words"),
    [
        (HalfDone("v1-v2"), "HalfDone is searched, and has to say linear, hidden, shape, shape_at"),
        (Breaking("v1-v2"), "the element Breaking failed at line"),
        (Elsewhere("v1-v2"), "it changes none"),
        (Inerter("v1"), "the element Inerter failed at line"),
    ],
)
def test_what_an_element_leaves_open_is_said(model, element, words):
    with pytest.raises(rx.ModelError, match=words):
        model.with_elements(element)


def test_a_job_finds_the_file_of_an_element(signals, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bodies.py").write_text(MODEL_FILE)
    (tmp_path / "inerter.py").write_text((Path(__file__).parent / "inerter.py").read_text())
    table = np.column_stack([np.arange(6000) * STEP, *signals.values()])
    header = ",".join(["t", *signals])
    np.savetxt(tmp_path / "drive.csv", table, delimiter=",", header=header, comments="")
    first = ["identify", "drive.csv", "--model", "bodies.py:TWO_BODIES", "--refine", "none"]
    assert run([*first, "--add", "inerter.py:Inerter:v1-v2", "--out", "out"]) == 0
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert run(["identify", "--job", "../out/results.json", "--out", "again"]) == 0
    found = [
        json.loads((tmp_path / place / "results.json").read_text())["parameters"]
        for place in ("out", "elsewhere/again")
    ]
    assert found[0] == found[1]

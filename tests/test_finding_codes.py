"""Every code of a finding is registered and explained; one test raises it, and one must not."""

import ast
import re
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import MACHINES, Shape

import riecjax
import riecjax as rx
from conftest import held_to
from riecjax.assessment.refining import Refinement, Track, ValidationRun, validated
from riecjax.equations.model import as_model
from riecjax.estimation.excitation import Excitation
from riecjax.estimation.parameters import Parameter
from riecjax.findings import CODES, Finding, class_of
from riecjax.paper.report import road_findings
from riecjax.paper.reproduction import PaperStudy

ROOT = Path(__file__).parents[1]
PACKAGE = Path(riecjax.__file__).parent


def made_in(source: str) -> set[str]:
    """Codes of the findings that a source makes."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and node.args:
            name = getattr(node.func, "id", "") or getattr(node.func, "attr", "")
            if name in ("Finding", "finding", "each_finding", "fault", "Told", "Absence"):
                values = [n.value for n in ast.walk(node.args[0]) if isinstance(n, ast.Constant)]
                found |= {value for value in values if isinstance(value, str)}
    return found


def marked(mark: str) -> set[str]:
    """Codes that tests name in this mark, which holds them to it."""
    found = set()
    for path in (ROOT / "tests").rglob("test_*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == mark:
                found |= {n.value for n in node.args if isinstance(n, ast.Constant)}
    return found


def test_what_the_sources_make_is_what_the_registry_holds():
    made = set().union(*(made_in(path.read_text("utf-8")) for path in PACKAGE.rglob("*.py")))
    # Of several codes, before their finding is made.
    chosen = {"low_passed", "nearly_collinear", "noise_dominates", "velocity_offset"}
    assert made | chosen == set(CODES)


def test_every_code_is_explained_and_no_other():
    page = (ROOT / "docs" / "warnings.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    assert set(re.findall(r"`(\w+)`", " ".join(rows))) == set(CODES)


def test_every_code_has_a_test_that_raises_it():
    """And one that must not: the last of this file."""
    assert marked("raises_finding") == set(CODES)


def test_a_test_is_held_to_its_marks():
    with held_to({"clipped"}, {"hum"}):
        Finding("clipped", "made")
    with pytest.raises(AssertionError, match=r"no finding .*clipped"), held_to({"clipped"}, set()):
        Finding("hum", "made")
    with pytest.raises(AssertionError, match=r"a finding .*hum"), held_to(set(), {"hum"}):
        Finding("hum", "made")


def test_an_unknown_code_is_said_in_its_own_words():
    assert class_of("wet_road").said() == "wet road"
    assert CODES["clipped"].said(("u",)) == "u is clipped"


# Of codes that need a rare situation, or an expensive one, what makes their findings is asked.


@pytest.mark.raises_finding("noise_dominates")
def test_noise_that_makes_up_much_of_what_tells_parameters_apart():
    size, own, noise = np.array([[1.0, 1.0], [0.5, 0.5], [0.1, 0.1]])
    direction = np.array([0.7, -0.7])
    rows = Parameter("m", "m"), Parameter("k", "k")
    excited = Excitation(size, own, noise, direction, 0.3, direction, 0.5, rows, "axis", True, "x")
    (finding,) = excited.findings()
    assert "50 % of what tells these apart is noise of x" in finding.message
    assert (finding.signals, finding.parameters) == (("x",), ("m", "k"))


@pytest.mark.raises_finding("few_effective_windows")
def test_windows_that_overlap_nearly_all_are_few():
    t = 0.01 * np.arange(400)
    rng = np.random.default_rng(0)
    signals = {"v": np.sin(2 * t), "F": 2 * np.cos(2 * t) + 3 * np.sin(2 * t)}
    signals["F"] += 0.1 * np.cumsum(rng.standard_normal(400))
    body = rx.Equation(rx.Term("m", "v", derivative=1), rx.Term("c", "v"), -rx.Term(1.0, "F"))
    estimate = rx.identify(body, rx.Record(signals, 0.01), rx.RIEC(rx.AllWindows(1.5, 1.6)))
    assert "few_effective_windows" in [finding.code for finding in estimate.findings()]


@pytest.mark.raises_finding("refined_predicts_worse")
def test_a_refinement_that_predicts_worse_than_the_estimate():
    before, after = (SimpleNamespace(worst_fit=fit) for fit in (90.0, 70.0))
    run = ValidationRun(SimpleNamespace(name="b.csv"), after, before)  # type: ignore[arg-type]
    refined = SimpleNamespace(findings=list)
    (finding,) = Refinement(refined, refined, simulations=[run]).findings()  # type: ignore[arg-type]
    assert finding.message.startswith("b.csv: the refined model predicts worse")


@pytest.mark.raises_finding("not_validated")
def test_a_recording_on_which_no_simulation_is_possible():
    axis = as_model(rx.Equation(rx.Term("c", "v"), -rx.Term(1.0, "F")))
    t = 0.01 * np.arange(100)
    recording = rx.Recording(rx.Record({"v": np.sin(t), "F": np.sin(t)}, 0.01), "b.csv")
    found = validated(axis, {"c": jnp.asarray(1.0)}, [Track(recording)])
    assert found.runs == []
    (finding,) = found.failures
    assert finding.message.startswith("b.csv: ")


@pytest.mark.raises_finding("simulation_lost", "few_roads")
def test_roads_that_lost_a_simulation_and_are_few():
    roads = SimpleNamespace(successful=np.array([True, False]), contact=np.ones(2))
    lost, few = road_findings(PaperStudy(roads))  # type: ignore[arg-type]
    assert "1 roads lost" in lost.message
    assert "only 2 roads" in few.message


@pytest.mark.no_finding("simulation_lost", "few_roads")
def test_enough_roads_without_a_loss():
    roads = SimpleNamespace(successful=np.ones(8, bool), contact=np.ones(8))
    assert not list(road_findings(PaperStudy(roads)))  # type: ignore[arg-type]


def assessed(**settings) -> rx.Assessment:
    """A right model of two sound recordings, of which the second is predicted."""
    machine = MACHINES["linear"]
    runs = [machine.record(0.005, seed, drive=seed, shape=Shape(3000, 100)) for seed in (1, 2)]
    recordings = [rx.Recording(run, f"{i}.csv") for i, run in enumerate(runs)]
    return rx.assess(machine.model, recordings[:1], validate_on=recordings[1:], **settings)


@pytest.mark.raises_finding("does_not_predict")
def test_a_wrong_stiffness_does_not_predict_another_recording():
    found = assessed(known={"k": 20.0}, refine=None, sweep=False, intervals=rx.Naive())
    (said,) = [finding for finding in found.findings() if finding.code == "does_not_predict"]
    assert said.message.startswith("1.csv: ")


# This one makes no finding of any code, so that no code lacks a test that must not raise it.
@pytest.mark.no_finding(*CODES)
def test_a_right_model_of_sound_recordings_makes_none():
    assessment = assessed()
    assert assessment.findings() == []
    assert {one.level for one in assessment.verdict.parameters.values()} == {"good"}

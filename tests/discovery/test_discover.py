"""Missing terms of motions with noise, from the samples to a model."""

import numpy as np
import pytest
from tests.machines import PROBLEMS, WIDTH

import riecjax as rx
from nightly import by_day, nightly
from riecjax.discovery import Candidate
from riecjax.discovery.discover import discover, model_source
from riecjax.models.catalogue import find_model
from riecjax.reporting.discovery import choice_lines

QUICK = {"intervals": rx.Naive(), "resamples": 0}
TRUTH = {"m": 1.5, "stiffness": 20.0, "quadratic_drag": 0.5, "viscous": 0.8}
DRAG = PROBLEMS["drag"]


@pytest.fixture(scope="module")
def record() -> rx.Record:
    return DRAG.record(0.01, 0)


@pytest.fixture(scope="module")
def found(record):
    return discover(DRAG.start, record)


def test_exactly_the_missing_terms_are_found(found):
    assert {*found.names} == DRAG.missing
    (path,) = found.paths.values()
    assert [step.added for step in path] == ["", "stiffness", "quadratic_drag", "viscous"]
    assert path[0].unexplained > 0.9
    assert path[-1].unexplained < 5e-4
    # The rest is the sensors' noise.
    assert abs(path[-1].of_motion) < 0.1 * path[-1].unexplained
    assert all(gain.gain < 0.02 for gain in found.rejected)


def test_their_values_are_right_and_errors_include_the_choice(found):
    for name, value in TRUTH.items():
        assert abs(float(found.estimate[name]) - value) < 4 * found.errors[name]
        assert found.errors[name] >= float(found.estimate.standard_error(name))
        assert found.errors[name] < 0.02 * value
    assert all(one.share == 1.0 for one in found.chosen)


def test_the_model_is_identified_and_simulated_like_any(found, record):
    again = rx.identify(found.model, record)
    assert dict(again.values) == pytest.approx(dict(found.estimate.values))
    system = found.model.build_system({k: float(v) for k, v in again.values.items()})
    run = rx.simulate(system, record.select("u"), method=rx.FixedStep(4))
    clean = DRAG.signals()
    assert np.std(np.asarray(run.record["x"]) - clean["x"]) < 0.01 * clean["x"].std()


@pytest.mark.parametrize("noise", [0.1, *nightly([0.0])])
@pytest.mark.parametrize("name", by_day(PROBLEMS, "drag"))
def test_a_right_model_is_given_nothing(name, noise):
    problem = PROBLEMS[name]
    assert discover(problem.model, problem.record(noise, 7, drive=1), **QUICK).names == ()


@pytest.mark.parametrize("name", by_day(PROBLEMS, "hysteresis"))
def test_missing_terms_are_found_at_five_percent_of_noise(name):
    problem = PROBLEMS[name]
    assert {
        *discover(problem.start, problem.record(0.05, 2, drive=2), **QUICK).names
    } == problem.missing


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_the_width_of_a_dead_zone_is_found(seed):
    problem = PROBLEMS["dead_zone"]
    found = discover(problem.start, problem.record(0.01, seed), **QUICK)
    widths = {one.candidate.name: one.width for one in found.chosen}
    assert widths["dead_zone"] == pytest.approx(WIDTH, rel=0.02)
    assert widths["viscous"] is None
    (error,) = (one.width_error for one in found.chosen if one.width is not None)
    assert abs(widths["dead_zone"] - WIDTH) < 4 * error  # pyright: ignore[reportOptionalOperand]
    assert error < 0.01 * WIDTH
    assert float(found.estimate["dead_zone_stiffness"]) == pytest.approx(60, rel=0.02)


@pytest.mark.slow
def test_without_a_recorded_velocity_it_is_formed(record):
    found = discover(DRAG.start, record.select("x", "u"), **QUICK)
    assert {*found.names} == DRAG.missing


def test_what_is_held_out_has_no_part_in_the_choice(record):
    found = discover(DRAG.start, record, hold_out=0.3, intervals=rx.Naive())
    assert {*found.names} == DRAG.missing
    last = rx.identify(found.model, rx.split(record, 0.3)[1], intervals=rx.Naive())
    assert dict(found.estimate.values) == pytest.approx(dict(last.values), rel=1e-3)
    assert "chosen without the last 30 %" in choice_lines(found)[-1]


@pytest.mark.slow
def test_a_known_value_of_the_model_sets_its_scale(record):
    start = rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("dx",), unit="kg"),
        -rx.Term("one", "u", known=1.0),
        name="drag",
        unit="N",
    )
    found = discover(start, record, **QUICK)
    assert {*found.names} == DRAG.missing
    assert float(found.estimate["m"]) == pytest.approx(TRUTH["m"], rel=0.02)
    assert "one" not in found.estimate.parameters


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"candidates": ["k"]}, "a candidate is the text 'k'"),
        ({"candidates": [rx.Term("k", "x"), rx.Term("k", "x")]}, "two candidates are called k"),
        ({"candidates": [rx.Term("m", "x")]}, "there is a coefficient 'm' already"),
        (
            {"candidates": [Candidate("k", (rx.Term("k", "x"),), equation="nope")]},
            "no equation is called 'nope'; there are: mass",
        ),
        ({"candidates": [rx.Term("k", "zz")]}, "no signal 'zz'"),
        ({"known": {"zz": 1.0}}, "unknown parameter 'zz'"),
        ({"hold_out": "half"}, "hold_out"),
        ({"count": 300}, "5 blocks of time, of which terms are to be chosen"),
    ],
)
def test_what_makes_no_sense_is_refused(record, changed, said):
    part = record.part(0, changed.get("count", record.sample_count))
    settings = {name: value for name, value in changed.items() if name != "count"}
    with pytest.raises(rx.RiecjaxError, match=said):
        discover(DRAG.start, part, **settings, **QUICK)


def test_hidden_elements_are_refused(record):
    model = find_model("drag-oscillator").with_elements(rx.HiddenMode(on="x"))
    with pytest.raises(rx.ModelError, match="without hidden elements"):
        discover(model, record, **QUICK)


@pytest.mark.slow
def test_the_file_of_a_hysteretic_model_is_identified_and_simulated(tmp_path):
    problem = PROBLEMS["hysteresis"]
    (tmp_path / "own").mkdir()
    (tmp_path / "own/mass.py").write_text(
        "import riecjax as rx\n"
        "MASS = rx.Equation(rx.Term('m', 'x', derivative=2, measured=('dx',), unit='kg'),\n"
        "    rx.Term('k', 'x', unit='N/m'), -rx.Term(1.0, 'u'), name='mass', unit='N')\n"
    )
    reference, record = f"{tmp_path}/own/mass.py:MASS", problem.record(0.01, 0)
    found = discover(find_model(reference), record, **QUICK)
    assert {*found.names} == problem.missing
    file = tmp_path / "model.py"
    file.write_text(model_source(found, reference, tmp_path))
    read = find_model(str(file))
    again = rx.identify(read, record)
    assert dict(again.values) == pytest.approx(dict(found.estimate.values))
    run = rx.simulate(read.build_system({}), record.select("u"), method=rx.FixedStep(4))
    clean = problem.signals()["x"]
    assert np.std(np.asarray(run.record["x"]) - clean) < 0.05 * clean.std()
    assert {q.name: q.unit for q in read.parameters}["viscous"] == "N s/m"
    assert str(tmp_path) not in file.read_text()

"""Refinement that follows by itself: taken where it leaves white noise, declined elsewhere."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal
from tests.machines import (
    BODY,
    DRAG_BOUND,
    DRAG_TRUTH,
    MODE_TRUTH,
    STANDARD,
    UPRIGHT,
    body_with_mode,
    drag_record,
    drag_signals,
    noisy,
    upright_signals,
)

import riecjax as rx
from riecjax.assessment import output_error_search as refining
from riecjax.assessment.assess import check_answering
from riecjax.records.recording import as_recordings
from riecjax.reporting.checking import check_document
from riecjax.settings import Check

DRAG = rx.find_model("drag-oscillator")
QUICK = {"sweep": False, "intervals": rx.Sandwich()}


def refinement_of(*arguments, **settings):
    found = rx.assess(*arguments, **{**QUICK, **settings})
    assert found.refinement is not None
    return found, found.refinement


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.001, 0.05])
def test_of_a_right_model_the_refined_values_are_the_answer(noise):
    record = drag_record(3, noise)
    found, refinement = refinement_of(DRAG, record)
    assert refinement.chosen
    alone = rx.refine(DRAG, record, found.estimate, rx.OutputError())
    # At 0.1 % the course of the force between its samples shows: straight lines move m by 7 errors.
    for name, true in DRAG_TRUTH.items():
        bound = DRAG_BOUND[name] * noise / 0.05
        assert float(found.answer[name]) == pytest.approx(true, rel=3.5 * bound)
        if noise == 0.05:
            assert float(found.answer[name]) == pytest.approx(float(alone[name]), rel=1e-3)
    assert refinement.whiteness is not None
    for power in (each.chi_squared for each in refinement.whiteness.channels.values()):
        assert power == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
def test_straight_lines_between_samples_are_taken_on_evidence():
    """By position alone at 0.1 % the sum of squares tells smooth from straight by 4 on average.

    In this recording straight lines leave less by 3.6, and put the stiffness off by 3 bounds.
    """
    held = drag_signals(33, 0.001)
    record = rx.Record.from_samples({n: held[n] for n in ("x", "u")}, time_step=0.01)
    found, refinement = refinement_of(DRAG, record)
    assert refinement.chosen
    lines = rx.refine(DRAG, record, found.estimate, rx.OutputError(intersample="lines"))
    assert refinement.refined is not None
    assert float(lines.search.rms[0]) < float(refinement.refined.search.rms[0])
    assert float(found.answer["k"]) == pytest.approx(20.0, rel=3.5 * 0.00153 / 50)
    # Of inputs that are straight lines it is 60 times as much at a tenth of the noise.
    driven = rx.Record.from_samples({"u": held["u"]}, time_step=0.01)
    made = rx.simulate(DRAG.build_system(DRAG_TRUTH), driven).record
    rng = np.random.default_rng(0)
    noisy = {n: np.asarray(made[n]) for n in ("x", "dx")}
    noisy = {n: v + 1e-4 * v.std() * rng.standard_normal(v.size) for n, v in noisy.items()}
    found, refinement = refinement_of(DRAG, driven.with_signals(noisy))
    assert refinement.chosen
    for name, true in DRAG_TRUTH.items():
        bound = DRAG_BOUND[name] / 500
        assert float(found.answer[name]) == pytest.approx(true, rel=3.5 * bound)


@pytest.mark.slow
def test_an_unstable_motion_is_refined_and_validated_over_windows():
    disturbed = noisy(upright_signals(), {"theta": 0.01, "dtheta": 0.01}, 902)
    upright = rx.Record.from_samples(disturbed, time_step=0.01)
    found, refinement = refinement_of(UPRIGHT, upright, hold_out=0.3)
    assert refinement.chosen
    assert refinement.refined is not None
    assert dict(refinement.refined.search.by)["windows"] == "tiles"
    for name, true in {"p1": 20.0, "p2": 0.3}.items():
        low, high = found.answer.interval(name)
        assert low - (high - low) < true < high + (high - low)
    (run,) = found.test("validation").runs
    assert run.held.predicts
    assert run.held.horizon == pytest.approx(0.57, abs=0.05)


def sensor(noise=0.02):
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.standard_normal(800)) / 50
    return {"x": x, "F": 300 * x + noise * np.std(300 * x) * rng.standard_normal(800)}


def test_what_cannot_be_simulated_is_declined_in_one_line():
    model = rx.Equation(rx.Term("K", "x", unit="N/m"), -rx.Term(1.0, "F"), name="spring")
    found, refinement = refinement_of(model, rx.Record.from_samples(sensor(), time_step=0.01))
    assert refinement.refined is None
    assert "no derivative" in refinement.declined
    assert "\n" not in refinement.declined
    assert found.answer is found.estimate
    assert f"not refined: {refinement.declined}" in str(found)


@pytest.mark.slow
def test_a_bound_in_the_way_is_declined():
    _, refinement = refinement_of(DRAG, drag_record(0), bounds={"k": (10.0, 19.98)})
    assert not refinement.chosen
    assert "k" in refinement.declined


def test_what_would_take_long_is_told_and_not_begun(monkeypatch):
    monkeypatch.setattr(refining, "MOST_WORK", 1)
    monkeypatch.setattr(refining, "refined", lambda *_, **__: pytest.fail("begun"))
    _, refinement = refinement_of(DRAG, drag_record(0))
    assert "steps x states x tangents, more than 1;" in refinement.declined
    assert "--refine output-error" in refinement.declined


@pytest.mark.slow
def test_check_names_the_refinement_that_answers_where_windows_cannot():
    """Short windows of a velocity by central differences hold little but noise."""
    signals = drag_signals(1, 0.05)
    del signals["dx"]
    record = rx.Record.from_samples(signals, time_step=0.01)
    record = rx.differentiate(record, "x", "dx")
    short = rx.RIEC(rx.AllWindows(0.03, 0.1))
    found = check_answering(DRAG, record, Check(short))
    assert any(finding.about.refuses for finding in found.findings)
    assert found.refusal is None
    assert found.by_refinement is not None
    bounds = {"m": 0.00181, "r": 0.0293, "r2": 0.0144, "k": 0.00153}
    for name, share in found.by_refinement.items():
        assert share == pytest.approx(bounds[name], rel=0.35)
    said = check_document(found, "drag", as_recordings(record))
    assert said["answerable"]
    assert "error" not in said
    answer = rx.assess(DRAG, record, short, **QUICK).answer
    assert float(answer["m"]) == pytest.approx(1.5, rel=5 * bounds["m"])
    with pytest.raises(rx.IdentifiabilityError):
        rx.assess(DRAG, record, short, **QUICK, refine=None)


@pytest.mark.slow
def test_sensors_of_unequal_noise_are_weighed_by_it():
    signals = drag_signals()
    rng = np.random.default_rng(5)
    for name, noise in (("x", 0.002), ("dx", 0.2)):
        size = noise * signals[name].std()
        signals[name] = signals[name] + size * rng.standard_normal(signals[name].size)
    record = rx.Record.from_samples(signals, time_step=0.01)
    found, refinement = refinement_of(DRAG, record)
    assert refinement.chosen
    alone = rx.refine(DRAG, record, found.estimate, rx.OutputError())
    for name in DRAG_TRUTH:
        assert found.answer.standard_error(name) < 0.2 * alone.standard_error(name)


def test_an_output_that_an_input_reaches_at_once_is_not_compared():
    """F = K x of a recorded x: what is left is white however noisy x is, and K too small."""
    model = rx.find_model("quarter-car")
    names = ("F_t", "x1", "x2", "x3", "x4")
    record = rx.Record({n: jnp.sin(jnp.arange(40.0) + i) for i, n in enumerate(names)}, 0.01)
    values = dict.fromkeys(model.parameter_names, 1.0)
    system = model.identified_system({n: jnp.asarray(v) for n, v in values.items()}, record)
    assert refining._channels(system, [record]) == ("x3", "x4")
    driven = record.with_signals({"v_r": jnp.cos(jnp.arange(40.0))})
    system = model.identified_system({n: jnp.asarray(v) for n, v in values.items()}, driven)
    assert refining._channels(system, [driven]) == ("x1", "x2", "x3", "x4", "F_t")


@pytest.mark.slow
def test_a_position_that_is_read_as_an_input_is_no_straight_line():
    """SciPy's lsim joins the force by lines, which the refinement tries; a line for x as well
    would fit to the last digit with a mass of m - k h^2 / 12."""
    mass, damping, stiffness, step = 2.0, 10.0, 1500.0, 0.005
    rng = np.random.default_rng(0)
    spectrum = np.fft.rfft(rng.standard_normal(4000))
    force = 100 * np.fft.irfft(np.where(np.fft.rfftfreq(4000, step) <= 40, spectrum, 0), 4000)
    dynamics = [[0, 1], [-stiffness / mass, -damping / mass]]
    body = (dynamics, [[0], [1 / mass]], np.eye(2), np.zeros((2, 1)))
    motion = signal.lsim(body, force, step * np.arange(4000))
    record = rx.Record({"F": force, "x": motion[1][:, 0], "v": motion[1][:, 1]}, step)
    equation = rx.Equation(
        rx.Term("m", "v", derivative=1), rx.Term("c", "v"), rx.Term("k", "x"), -rx.Term(1.0, "F")
    )
    found, refinement = refinement_of(equation, record)
    assert refinement.refined is not None
    for name, true in (("m", mass), ("c", damping), ("k", stiffness)):
        assert float(refinement.refined[name]) == pytest.approx(true, rel=1e-5)
        lower, upper = found.verdict.parameters[name].doubt
        assert lower <= true <= upper


def test_impulses_that_were_made_small_say_nothing_for_the_model():
    """They leave no noise to be told from its errors; what they leave is a mode's ringing."""
    record = rx.Record(body_with_mode(), STANDARD.step)
    found, refinement = refinement_of(BODY, record, refine="integral")
    assert refinement.chosen
    # Slow motion carries both masses.
    carried = MODE_TRUTH["m"] + MODE_TRUTH["M_mode"]
    for name, truth in {"m": carried, "c": MODE_TRUTH["c"], "k": MODE_TRUTH["k"]}.items():
        judged = found.verdict.parameters[name]
        assert judged.level != "good" or judged.doubt[0] < truth < judged.doubt[1]
    (cause,) = found.verdict.causes
    assert "the model leaves out a mode" in cause.phrase

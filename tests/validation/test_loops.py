"""Hysteresis that a model lacks is named from what it leaves, and dry friction is none."""

import numpy as np
import pytest
from tests.machines import PROBLEMS, STROKE

import riecjax as rx
from nightly import by_day, nightly
from riecjax.validation.residuals import ResidualTests, residual_tests

HYSTERETIC = PROBLEMS["hysteresis"]


def left(model: object, record: rx.Record) -> ResidualTests:
    return residual_tests(model, record, rx.identify(model, record))  # pyright: ignore


@pytest.mark.raises_finding("hysteresis")
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_missing_state_is_named_with_its_width(noise):
    tests = left(HYSTERETIC.start, HYSTERETIC.record(noise, 3, drive=1))
    found = tests["mass"].loop
    assert found is not None
    assert STROKE / 3 < found.width < 3 * STROKE
    (finding,) = [one for one in tests.findings() if one.code == "hysteresis"]
    assert finding.message.startswith("mass: what the model leaves runs in loops over dx: ")
    assert "riecjax discover --alpha 0.02 --beta 0.1" in finding.message
    assert finding.parameters == ("m", "k")


@pytest.mark.parametrize("name", by_day(("duffing", "drag", "axis", "dead_zone"), "axis"))
@pytest.mark.parametrize("noise", [*nightly([0.0]), 0.05])
def test_friction_and_springs_that_are_missing_are_no_loops(name, noise):
    problem = PROBLEMS[name]
    tests = left(problem.start, problem.record(noise, 5, drive=2))
    assert tests["mass"].loop is None


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_right_model_has_no_loop(noise):
    record = HYSTERETIC.record(noise, 5, drive=2)
    assert left(HYSTERETIC.model, record).equations[0].loop is None


@pytest.mark.raises_finding("residual_follows_signal")
def test_a_voltage_that_changes_dry_friction_is_named_with_what_it_changes():
    times = np.arange(6000) / 200
    x = np.sin(7 * times) + 0.4 * np.sin(11 * times + 1)
    v = 7 * np.cos(7 * times) + 4.4 * np.cos(11 * times + 1)
    volt = 1 + np.sin(0.9 * times)
    force = 3 * v + 5 * x + 4 * volt * np.sign(v)
    record = rx.Record.from_samples({"x": x, "v": v, "F": force, "volt": volt}, time_step=1 / 200)
    damper = rx.Equation(
        rx.Term("c", "x", derivative=1, measured=("v",)),
        rx.Term("k", "x"),
        -rx.Term(1.0, "F"),
        name="damper",
    )
    (finding,) = [f for f in left(damper, record).findings() if f.code[:8] == "residual"]
    assert finding.signals == ("volt",)
    assert "follows volt times the direction of v" in finding.message
    assert "volt changes a friction force" in finding.message

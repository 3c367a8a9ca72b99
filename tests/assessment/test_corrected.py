"""How far a fault of a pair moves each parameter, against how far the answer is off."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import Shape, simulated

import riecjax as rx

QUICK = {"refine": None, "sweep": False, "intervals": rx.Sandwich()}
M, R, K = 2.0, 3.0, 80.0
STEP = 0.005
MODEL = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("v",)),
    rx.Term("r", "x", derivative=1, measured=("v",)),
    rx.Term("k", "x"),
    -rx.Term(1.0, "F"),
)


def recorded(**late: float) -> rx.Record:
    """An oscillator under the force that its motion takes; signals so many samples late."""
    rng = np.random.default_rng(5)
    omega, phases = rng.uniform(1, 20, 20), rng.uniform(0, 2 * np.pi, 20)

    def motion(order: int, samples: float) -> np.ndarray:
        waves = np.outer(STEP * (np.arange(4000) - samples), omega) + phases
        return np.sum(omega ** (order - 1.0) * np.cos(waves + 0.5 * np.pi * order), axis=1)

    x, v = motion(0, late.get("x", 0.0)), motion(1, late.get("v", 0.0))
    force = M * motion(2, 0.0) + R * motion(1, 0.0) + K * motion(0, 0.0)
    signals = {"x": x, "v": v, "F": force}
    noisy = {k: s + 0.005 * s.std() * rng.normal(size=s.size) for k, s in signals.items()}
    return rx.Record.from_samples(noisy, time_step=STEP)


@pytest.mark.raises_finding("late_signal")
def test_a_late_velocity_says_by_how_much_it_moves_each_parameter():
    found = rx.assess(MODEL, recorded(v=1.0), **QUICK)
    (late,) = [f for f in found.findings() if f.code == "late_signal" and f.signals == ("v",)]
    truth = {"m": M, "r": R, "k": K}
    assert set(late.doubts) == set(truth)
    off = {name: abs(truth[name] / float(found.answer[name]) - 1) for name in truth}
    assert off["r"] > 0.03
    for name in truth:
        assert late.doubts[name] == pytest.approx(off[name], abs=0.02)
    assert "Without it" in late.message


@pytest.mark.parametrize(
    "code",
    [
        pytest.param("clipped", marks=pytest.mark.raises_finding("clipped")),
        pytest.param(
            "stuck_sensor", marks=[pytest.mark.raises_finding("stuck_sensor"), pytest.mark.slow]
        ),
    ],
)
def test_what_a_sensor_could_not_show_says_how_far_it_moves_each_parameter(code):
    record = recorded()
    v = np.array(record["v"])
    if code == "clipped":
        v = np.clip(v, -0.5 * v.max(), 0.5 * v.max())
    else:
        v[1500:2000] = v[1500]
    found = rx.assess(MODEL, record.with_signals({"v": jnp.asarray(v)}), **QUICK)
    said = next(f for f in found.findings() if f.code == code)
    for name, truth in {"m": M, "r": R, "k": K}.items():
        off = abs(truth / float(found.answer[name]) - 1)
        assert said.doubts[name] == pytest.approx(off, abs=0.02 + 0.1 * off)
    assert said.doubts["m"] > 0.1
    steps = [cause.step for cause in found.verdict.causes if cause.step is not None]
    assert ("--leave-out", "v") in [step.options for step in steps]


@pytest.mark.raises_finding("not_its_derivative")
def test_which_of_two_sensors_is_off_in_size_is_asked_and_none_taken_for_right():
    record = recorded()
    found = rx.assess(MODEL, record.with_signals({"x": 1.15 * record.signal("x")}), **QUICK)
    steps = [cause.step for cause in found.verdict.causes if cause.step is not None]
    assert "Scale v or x, whichever sensor is off" in [step.words for step in steps]
    assert all("bump" not in step.options for step in steps)


@pytest.mark.raises_finding("not_its_derivative")
def test_signals_of_a_sum_that_do_not_fit_have_a_verdict():
    record = simulated("quarter-car-source", 0, Shape(4000, 200))
    other = record.with_signals({"x2": rx.Signal(np.asarray(record["x2"])[::-1])})
    found = rx.assess(rx.find_model("quarter-car"), other, **QUICK)
    codes = {finding.code: finding.signals for finding in found.findings()}
    assert {*codes["not_its_derivative"]} == {"x2", "x3", "x4"}
    assert not any(judged.level == "good" for judged in found.verdict.parameters.values())

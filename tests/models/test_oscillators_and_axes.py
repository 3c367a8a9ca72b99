"""Small systems against formulas, conservation laws and closed-form motion."""

import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.models.catalogue import built_in_model
from riecjax.records.record import Record
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate

PARAMETERS = {
    "duffing": {"m": 2.0, "d": 0.7, "k1": 30.0, "k2": -40.0, "k3": 900.0},
    "drag-oscillator": {"m": 1.5, "r": 0.8, "r2": 0.5, "k": 20.0},
    "pendulum": {"p1": 60.0, "p2": 0.1},
    "emps": {"M": 95.0, "Fv": 200.0, "Fc": 20.0, "offset": -3.0},
    "emps-asymmetric": {
        "M": 95.0,
        "Fv_pos": 160.0,
        "Fc_pos": 20.0,
        "Fv_neg": 240.0,
        "Fc_neg": 21.0,
    },
}


def acceleration(model: str, x: float, v: float, u: float) -> float:
    """Each equation of motion as its summary prints it, solved for the acceleration."""
    p = PARAMETERS[model]
    if model == "duffing":
        return (u - p["d"] * v - p["k1"] * x - p["k2"] * x**2 - p["k3"] * x**3) / p["m"]
    if model == "drag-oscillator":
        return (u - p["r"] * v - p["r2"] * v * abs(v) - p["k"] * x) / p["m"]
    if model == "pendulum":
        return p["p1"] * np.sin(x) - p["p2"] * v + u
    if model == "emps":
        return (u - p["Fv"] * v - p["Fc"] * np.sign(v) - p["offset"]) / p["M"]
    ahead = p["Fv_pos"] * v + p["Fc_pos"]
    back = p["Fv_neg"] * v - p["Fc_neg"]
    friction = ahead if v > 0 else back if v < 0 else 0.0
    return (u - friction) / p["M"]


@pytest.mark.parametrize("model", PARAMETERS)
@pytest.mark.parametrize("state", [(0.3, 0.8), (-0.2, -1.5), (0.1, 0.0), (0.0, -0.01)])
def test_derivative_is_the_printed_equation(model, state):
    system = built_in_model(model).build_system(PARAMETERS[model])
    x, v = state
    found = system.derivative(jnp.array([x, v]), jnp.array([13.0]))
    expected = [v, acceleration(model, x, v, 13.0)]
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


def free_motion(model: str, parameters: dict[str, float], start: dict[str, float], seconds: float):
    system = built_in_model(model).build_system(parameters)
    count = round(seconds / 0.01) + 1
    silence = Record({system.input_names[0]: np.zeros(count)}, 0.01)
    return simulate(system, silence, initial_state=start, method=FixedStep(16)).checked().record


def test_duffing_without_damping_keeps_its_energy():
    p = {**PARAMETERS["duffing"], "d": 0.0, "k2": 50.0}
    record = free_motion("duffing", p, {"y": 0.25, "dy": -0.5}, 10.0)
    y, dy = record["y"], record["dy"]
    energy = p["m"] * dy**2 / 2 + p["k1"] * y**2 / 2 + p["k2"] * y**3 / 3 + p["k3"] * y**4 / 4
    np.testing.assert_allclose(energy, energy[0], rtol=1e-8)
    assert float(jnp.std(y)) > 0.05


def test_pendulum_without_damping_keeps_its_energy_and_falls_from_upright():
    record = free_motion("pendulum", {"p1": 64.0, "p2": 0.0}, {"theta": 0.05}, 5.0)
    energy = record["dtheta"] ** 2 / 2 + 64.0 * jnp.cos(record["theta"])
    np.testing.assert_allclose(energy, energy[0], rtol=1e-8)
    assert float(jnp.max(record["theta"])) > 3.2


def test_small_swings_about_hanging_have_their_closed_form():
    p1, p2, tilt = 64.0, 0.4, 1e-4
    record = free_motion("pendulum", {"p1": p1, "p2": p2}, {"theta": np.pi + tilt}, 4.0)
    time = np.asarray(record.time)
    rate = np.sqrt(p1 - p2**2 / 4)
    exact = np.exp(-p2 * time / 2) * (np.cos(rate * time) + p2 / (2 * rate) * np.sin(rate * time))
    # Of second order in the tilt: its square over 16 in frequency, over 5 periods.
    np.testing.assert_allclose((np.asarray(record["theta"]) - np.pi) / tilt, exact, atol=1e-6)


def test_quadratic_drag_alone_slows_hyperbolically():
    p = {"m": 2.0, "r": 0.0, "r2": 3.0, "k": 0.0}
    record = free_motion("drag-oscillator", p, {"dx": -4.0}, 2.0)
    exact = -4.0 / (1 + 4.0 * 1.5 * np.asarray(record.time))
    np.testing.assert_allclose(record["dx"], exact, rtol=1e-7)


def test_axis_slides_to_a_stop_as_coulomb_and_viscous_friction_say():
    p = PARAMETERS["emps-asymmetric"]
    for speed, viscous, coulomb in ((0.2, p["Fv_pos"], p["Fc_pos"]), (-0.2, 240.0, 21.0)):
        record = free_motion("emps-asymmetric", p, {"dq": speed}, 0.3)
        time, slip = np.asarray(record.time), coulomb / viscous
        exact = np.sign(speed) * ((abs(speed) + slip) * np.exp(-viscous * time / p["M"]) - slip)
        assert np.all(exact * speed > 0)
        np.testing.assert_allclose(record["dq"], exact, rtol=1e-8)


def test_symmetric_axis_is_the_asymmetric_one_with_equal_sides():
    shared = {"M": 95.0, "Fv_pos": 200.0, "Fc_pos": 20.0, "Fv_neg": 200.0, "Fc_neg": 20.0}
    asymmetric = built_in_model("emps-asymmetric").build_system(shared)
    symmetric = built_in_model("emps").build_system({**PARAMETERS["emps"], "offset": 0.0})
    for v in (-0.3, 0.0, 0.3):
        state, force = jnp.array([0.1, v]), jnp.array([50.0])
        np.testing.assert_allclose(
            symmetric.derivative(state, force), asymmetric.derivative(state, force)
        )

"""Unknown offsets and gains of sensors, beside the truth of a motion in closed form."""

import numpy as np
import pytest

import riecjax as rx
from riecjax.elements import SensorGain, SensorZero
from riecjax.errors import ModelError

M, C, K = 2.0, 3.0, 80.0
TIME = np.arange(4000) * 0.005
CRITERION = rx.RIEC(rx.AllWindows(0.3, 0.6), rx.Hat())


def motion():
    """A mass on spring and damper: position and force."""
    rng = np.random.default_rng(20240501)
    x, v, a = np.zeros((3, TIME.size))
    for w in (2.0, 5.0, 9.0, 14.0):
        phase = w * TIME + rng.uniform(0, 6)
        x, v, a = x + np.sin(phase) / w, v + np.cos(phase), a - w * np.sin(phase)
    return x, M * a + C * v + K * x


def equation(*more):
    return rx.Equation(
        rx.Term("m", "x", derivative=2, unit="kg"),
        rx.Term("c", "x", derivative=1, unit="N s/m"),
        rx.Term("k", "x", unit="N/m"),
        -rx.Term(1.0, "F"),
        *more,
        unit="N",
    )


def estimate(model, x, force, **settings):
    record = rx.Record.from_samples({"x": x, "F": force}, time=TIME)
    found = rx.identify(model, record, CRITERION, intervals=rx.Sandwich(), noise="none", **settings)
    return {name: float(value) for name, value in found.items()}


@pytest.mark.slow
def test_the_zero_of_a_load_cell():
    x, force = motion()
    load = rx.equations.Quantity("F", "N", "force")
    model = rx.Model(stages=equation(), signals=(load,)).with_elements(SensorZero("F"))
    assert model.units["offset_F"] == "N"
    # The recording's force is 7 N too high.
    found = estimate(model, x, force + 7.0)
    assert found == pytest.approx({"m": M, "c": C, "k": K, "offset_F": 7.0}, rel=2e-3)
    # The equations are simulated as the sensors show.
    record = rx.Record.from_samples({"x": x, "F": force + 7.0}, time=TIME)
    held = rx.validation.validate_held_out(rx.equation_system(model, found), record)
    assert float(held.signals["x"].fit) > 98
    # Without it the spring would take part of it.
    assert estimate(rx.staged(equation()), x + 0.5, force)["k"] != pytest.approx(K, rel=0.02)


def test_the_zero_of_a_position_comes_times_its_stiffness():
    x, force = motion()
    model = rx.staged(equation()).with_elements(SensorZero("x"))
    assert model.units["k_offset_x"] == "N"
    found = estimate(model, x + 0.5, force)
    assert found == pytest.approx({"m": M, "c": C, "k": K, "k_offset_x": 0.5 * K}, rel=2e-3)


def test_the_gain_of_a_load_cell_where_the_mass_is_known():
    x, force = motion()
    model = rx.staged(equation()).with_elements(SensorGain("F"))
    found = estimate(model, x, force / 1.25, known={"m": M})
    assert found == pytest.approx({"m": M, "c": C, "k": K, "gain_F": 1.25}, rel=2e-3)


PLAIN = rx.staged(equation())
CONSTANT = rx.staged(equation(rx.Term("friction", rx.constant, unit="N")))
CUBIC = rx.staged(equation(rx.Term("k3", lambda s: s["x"] ** 3)))
DERIVED = rx.staged(rx.Equation(rx.Term("c", "v", derivative=1), -rx.Term(1.0, "F")))


@pytest.mark.parametrize(
    ("model", "error", "words"),
    [
        (CONSTANT, SensorZero("F"), "told apart from 'friction'"),
        (PLAIN, SensorGain("x"), "told apart from 'm'"),
        (CUBIC, SensorZero("x"), "k3 is a function of 'x'"),
        (PLAIN, SensorZero("G"), "no equation has a term of 'G'"),
        (DERIVED, SensorZero("v"), "no equation has a term of 'v'"),
        (PLAIN, SensorGain("G"), "no equation reads 'G'"),
    ],
)
def test_what_cannot_be_told_apart(model, error, words):
    with pytest.raises(ModelError, match=words):
        model.with_elements(error)

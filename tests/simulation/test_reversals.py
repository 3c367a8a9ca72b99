"""Dry friction: steps that are cut where a velocity reverses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import slide

import riecjax as rx
from nightly import nightly

STEP = 2e-3
VALUES = {"m": 2.0, "k": 800.0, "c": 4.0, "f": 6.0}


def spring(*friction):
    return rx.Equation(
        rx.Term("m", "x", derivative=2),
        rx.Term("k", "x"),
        rx.Term("c", "x", derivative=1),
        *friction,
        -rx.Term(1.0, "u"),
    )


def by_sign(s):
    return jnp.sign(s["dx"])


def by_cases(s):
    return jnp.where(s["dx"] > 0, 1.0, -1.0)


FLOOR = rx.Equation(rx.Term("m", "x", derivative=2), rx.Term("f", by_sign), -rx.Term(1.0, "u"))


def force(t):
    return 25 * (np.cos(9 * t + 1) + np.cos(23.7 * t) + np.sin(31 * t))


def simulated(equation, u, values=VALUES, steps=1, **start):
    system = rx.equation_system(equation, values)
    run = rx.simulate(
        system,
        rx.Record({"u": u}, STEP),
        method=rx.FixedStep(steps),
        initial_state=start,
        intersample="smooth",
    )
    return run.record


def test_a_mass_slides_to_a_stop_and_stays_until_it_is_pushed():
    """v0 = 3 m/s and f/m = 3 m/s^2: at rest after 1 s and 1.5 m; pulled back by 8 N/s from 2 s."""
    t = STEP * np.arange(2001)
    pull = -8 * np.maximum(t - 2, 0)
    record = simulated(FLOOR, pull, dx=3.0)
    moving = np.maximum(t - 2.75, 0)  # 6 N are reached 0.75 s later
    x = np.where(t < 1, 3 * t - 1.5 * t**2, 1.5) - 4 * moving**3 / 6
    v = np.maximum(3 - 3 * t, 0) - 2 * moving**2
    # It is let go at the beginning of a step, late by one of them at most.
    np.testing.assert_allclose(record["x"], x, atol=1e-5)
    np.testing.assert_allclose(record["dx"], v, atol=1e-4)
    stuck = (t > 1.01) & (t < 2.7)
    assert (np.asarray(record["dx"])[stuck] == 0).all()
    # An accelerometer sees nothing of the force that friction holds.
    assert (np.asarray(record["ddx"])[stuck] == 0).all()
    sliding = t < 0.99
    np.testing.assert_allclose(np.asarray(record["ddx"])[sliding], -3.0, atol=1e-9)


def reference_of(t, values=VALUES):
    """SciPy's solution, stopped and started anew at each reversal."""
    m, k, c, f = values.values()

    def acceleration(now, x, v, direction):
        return (force(now) - c * v - f * direction - k * x) / m

    return slide(acceleration, t, 0.02, 1e-10)["x"]


@pytest.mark.parametrize("friction", [rx.Term("f", by_sign), *nightly([rx.Term("f", by_cases)])])
def test_states_and_their_derivatives_are_those_of_pieces_between_reversals(friction):
    t = STEP * np.arange(1001)
    reference = reference_of(t)
    assert np.sum(np.diff(np.sign(np.diff(reference))) != 0) > 8
    equation, u = spring(friction), jnp.asarray(force(t))

    def x(f):
        return simulated(equation, u, {**VALUES, "f": f}, x=0.02)["x"]

    size = float(np.std(reference))
    # Steps that are not cut leave 4e-3, and derivatives that are off by 0.3.
    np.testing.assert_allclose(x(6.0), reference, atol=2e-5 * size)
    by_f = (reference_of(t, {**VALUES, "f": 6.01}) - reference) / 0.01
    _, found = jax.jvp(x, (6.0,), (1.0,))
    np.testing.assert_allclose(found, by_f, atol=2e-3 * float(np.abs(by_f).max()))


@pytest.mark.parametrize(
    ("term", "found"),
    [
        (rx.Terms("f", rx.friction(), "dx"), ("dx",)),
        (rx.Term("f", by_sign), ("dx",)),
        (rx.Term("f", by_cases), ("dx",)),
        (rx.Term("f", lambda s: jnp.tanh(s["dx"] / 1e-3)), ()),
        (rx.Term("f", lambda s: s["dx"] * jnp.abs(s["dx"])), ()),
        (rx.Terms("f", rx.roof([-1.0, 0.0, 1.0]), "x"), ()),
        (rx.Term("f", lambda s: jnp.sign(s["u"])), ()),
    ],
)
def test_only_states_at_whose_zero_a_term_jumps_cut_steps(term, found):
    equation = spring(term)
    system = rx.equation_system(equation, dict.fromkeys(equation.parameters, 1.0))
    assert system.reversing == found

"""Inputs that are smooth between samples: against SciPy with the exact input, and brute force."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from scipy.integrate import solve_ivp

from nightly import by_day
from riecjax.records.record import Record
from riecjax.simulation import intersample
from riecjax.simulation.method import AbstractMethod, SimulationStatus
from riecjax.simulation.simulate import simulate
from riecjax.simulation.system import AbstractSystem

SECONDS = 4.0
STEADY = (0.8, 1.1)
RNG = np.random.default_rng(7)
bends_of = jax.jit(intersample.bends_of)


class Swing(AbstractSystem):
    """Smooth, and non-linear in the state and in both inputs."""

    damping: Array

    states: ClassVar = (("angle", "rad"), ("rate", "rad/s"))
    inputs: ClassVar = (("torque", ""), ("gust", ""))

    def derivative(self, state, inputs):
        angle, rate = state
        push = inputs[0] * jnp.cos(angle) + 0.3 * inputs[1] ** 2
        return jnp.stack([rate, -4 * jnp.sin(angle) - self.damping * rate + push])


class Area(AbstractSystem):
    """x' = u."""

    states: ClassVar = (("x", ""),)
    inputs: ClassVar = (("u", ""),)

    def derivative(self, state, inputs):
        return inputs


SWING = Swing(jnp.asarray(0.3))


def torque(t):
    return np.sin(2 * np.pi * 0.9 * t + 0.3) + 0.5 * np.sin(2 * np.pi * 2.0 * t)


def gust(t):
    return np.cos(2 * np.pi * 1.3 * t)


def recorded(count: int) -> Record:
    t = np.linspace(0, SECONDS, count + 1)
    signals = {"torque": torque(t), "gust": gust(t)}
    return Record.from_samples(signals, time_step=SECONDS / count)


@pytest.fixture(scope="module")
def exact() -> np.ndarray:
    """At quarters of a second, driven by the formulas themselves."""

    def slope(t, s):
        push = torque(t) * np.cos(s[0]) + 0.3 * gust(t) ** 2
        return [s[1], -4 * np.sin(s[0]) - 0.3 * s[1] + push]

    t = np.linspace(0, SECONDS, 17)
    return solve_ivp(slope, (0, SECONDS), STEADY, "DOP853", t, rtol=1e-12, atol=1e-13).y.T


def states(count: int, intersample, method: AbstractMethod | None = None) -> np.ndarray:
    first = dict(zip(SWING.state_names, STEADY))
    run = simulate(
        SWING, recorded(count), initial_state=first, intersample=intersample, method=method
    )
    found = run.checked().record
    return np.stack([found["angle"], found["rate"]], axis=-1)[:: count // 16]


@pytest.mark.parametrize(("intersample", "order"), [("lines", 2), ("smooth", 5)])
def test_a_sampled_input_errs_in_its_order(exact, intersample, order):
    """8 steps a sample leave nothing beside that."""
    errors = [np.abs(states(count, intersample) - exact).max() for count in (160, 320, 640)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    np.testing.assert_allclose(orders, order, atol=0.5)
    # 20 samples to the fastest period at first.
    assert errors[0] < {"lines": 2e-3, "smooth": 1e-5}[intersample]


@pytest.mark.parametrize(("per_period", "error"), [(5, 1.1e-3), (10, 2e-6), (20, 1e-8)])
def test_a_tone_has_its_mean_in_every_interval(per_period, error):
    """Lines lack pi^2 / (3 n^2) of it, 13 % at 5 samples per period."""
    rate = 2 * np.pi / per_period
    t = np.arange(100)
    u = np.cos(rate * t + 0.4)
    exact = np.diff(np.sin(rate * t + 0.4)) / rate
    gap = np.isin(t, [50, 51])
    for broken in (u, np.where(gap, 1e3, u)):
        there = jnp.asarray(~gap) if broken is not u else None
        d = np.asarray(bends_of(jnp.asarray(broken[:, None]), there))[:, 0]
        mean = 0.5 * (u[1:] + u[:-1]) - (d[1:] + d[:-1]) / 24
        off = np.abs(mean - exact)
        assert max(off[6:43].max(), off[58:93].max()) < error
        assert np.all(np.isfinite(d))
        if there is None:
            assert off[43:58].max() < error


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
def test_a_short_record_is_simulated(count):
    u = np.arange(count) ** 2.0
    x = simulate(Area(), Record.from_samples({"u": u}, time_step=1.0), intersample="smooth").record
    trapezoids = np.concatenate([[0], np.cumsum(0.5 * (u[1:] + u[:-1]))])
    # A parabola is one from five samples on; the trapezoid is 1/6 more of it in each interval.
    rest = np.arange(count) / 6 if count >= 5 else 0.0
    np.testing.assert_allclose(x["x"], trapezoids - rest, atol=1e-12)


COMMANDS = {
    "a step": np.repeat([0.0, 1.0], 20),
    "a random binary command": np.repeat(RNG.choice([-1.0, 1.0], 30), 4),
    "a triangle": np.concatenate([np.arange(10.0), 10 - np.arange(10.0), np.arange(9.0)]),
    "ramps": np.interp(np.arange(60), [0, 7, 19, 20, 41, 60], [0, 3, 1, 8, 8, -2]),
    "a pulse of one sample": np.eye(30)[12],
}


@pytest.mark.parametrize("name", by_day(COMMANDS, "a step", "a triangle", "a pulse of one sample"))
def test_commands_stay_straight_lines(name):
    u = COMMANDS[name]
    held = Record.from_samples({"u": u}, time_step=1.0)
    smooth, lines = (
        simulate(Area(), held, intersample=of).record["x"] for of in ("smooth", "lines")
    )
    np.testing.assert_allclose(smooth, lines, atol=1e-13)


class Standing(AbstractMethod):
    """A method of one's own, which knows nothing of bends."""

    def trajectory(self, system, inputs, time_step, initial_state):  # pyright: ignore[reportIncompatibleMethodOverride]
        still = jnp.broadcast_to(initial_state, (len(inputs), len(initial_state)))
        return still, SimulationStatus.successful, jnp.asarray(len(inputs))


def test_a_method_of_ones_own_without_bends_takes_lines():
    run = simulate(SWING, recorded(80), method=Standing())
    assert bool(run.successful)

"""Inputs that are smooth between samples: against SciPy with the exact input, and brute force."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from scipy.integrate import solve_ivp

from nightly import by_day, nightly
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


def mean_curvature(second: list[float]) -> float:
    """In the middle of 1, 3, 5 or 7 second differences, by powers of them formed one by one."""
    found, differences = 0.0, np.array(second)
    for coefficient in (1, -11 / 60, 191 / 5040, -2497 / 302400)[: len(second) // 2 + 1]:
        found += coefficient * differences[len(differences) // 2]
        differences = np.diff(differences, 2)
    return found


def bends_of_column(levels: np.ndarray, present: np.ndarray) -> np.ndarray:
    n = len(levels)
    second = {
        i: levels[i + 1] - 2 * levels[i] + levels[i - 1]
        for i in range(1, n - 1)
        if present[i - 1 : i + 2].all()
    }
    found, smooth = np.zeros(n), np.zeros(n, bool)
    for i in second:
        size = [second[j] ** 2 for j in range(i - 5, i + 6) if j in second]
        rough = [
            (second.get(j + 1, 0.0) - second.get(j, 0.0)) ** 2
            for j in range(i - 5, i + 5)
            if j in second or j + 1 in second
        ]
        smooth[i] = len(size) > 5 and np.mean(rough) <= 1.8 * np.mean(size)
        told = [second[j] for j in range(i - 2, i + 3) if j in second]
        reach = max(r for r in range(4) if all(j in second for j in range(i - r, i + r + 1)))
        if smooth[i]:
            found[i] = mean_curvature([second[j] for j in range(i - reach, i + reach + 1)])
        elif len(told) >= 3:
            found[i] = np.median(told)
    for i in range(n):
        if present[i] and i not in second:
            for step in (-1, 1):
                if i + step in second:
                    line = i + 2 * step in second and smooth[i + step] and smooth[i + 2 * step]
                    found[i] = found[i + step] + line * (found[i + step] - found[i + 2 * step])
                    break
    return found


@pytest.mark.parametrize("roughness", [0.3, *nightly([0.0, 1.0])])
def test_bends_are_what_they_are_one_by_one(roughness):
    """Of means or medians, around gaps and ends."""
    noise, present = RNG.normal(size=(300, 3)), RNG.random(300) > 0.05
    t = np.arange(300)[:, None] + np.array([0.0, 2.0, 5.0])
    levels = (1 - roughness) * np.sin(0.9 * t) + roughness * noise
    for there in (present, np.ones(300, bool)):
        expected = [bends_of_column(column, there) for column in levels.T]
        found = bends_of(jnp.asarray(levels), jnp.asarray(there))
        np.testing.assert_allclose(found, np.stack(expected, axis=-1), atol=1e-12)
    np.testing.assert_array_equal(
        bends_of(jnp.asarray(levels)), bends_of(jnp.asarray(levels), jnp.ones(300, bool))
    )


@pytest.mark.parametrize(("per_period", "error"), [(5, 1.1e-3), (10, 2e-6), (20, 1e-8)])
def test_a_tone_has_its_mean_in_every_interval(per_period, error):
    """Lines lack pi^2 / (3 n^2) of it, 13 % at 5 samples per period."""
    rate = 2 * np.pi / per_period
    t = np.arange(100)
    u = np.cos(rate * t + 0.4)
    d = np.asarray(bends_of(jnp.asarray(u[:, None])))[:, 0]
    mean = 0.5 * (u[1:] + u[:-1]) - (d[1:] + d[:-1]) / 24
    exact = np.diff(np.sin(rate * t + 0.4)) / rate
    assert np.abs(mean - exact)[6:-6].max() < error


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
    "a first sample": np.repeat([3.0, 1.0], [1, 30]),
    "steps held for 3": np.repeat(RNG.normal(size=15), 3),
    "a random binary command": np.repeat(RNG.choice([-1.0, 1.0], 30), 4),
    "a triangle": np.concatenate([np.arange(10.0), 10 - np.arange(10.0), np.arange(9.0)]),
    "ramps": np.interp(np.arange(60), [0, 7, 19, 20, 41, 60], [0, 3, 1, 8, 8, -2]),
    "a pulse of one sample": np.eye(30)[12],
    "a pulse of two": np.eye(30)[12] + np.eye(30)[13],
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

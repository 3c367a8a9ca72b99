"""Steppers against exact solutions, SciPy and each other; lost solutions."""

import itertools
from typing import ClassVar

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from jaxtyping import Array, Float
from scipy.integrate import solve_ivp

from nightly import nightly
from riecjax.simulation.method import (
    AbstractMethod,
    Adaptive,
    FixedStep,
    SimulationStatus,
)
from riecjax.simulation.system import AbstractSystem


class Linear(AbstractSystem):
    """x' = A x + B u, two states and two inputs."""

    A: Float[Array, "2 2"]
    B: Float[Array, "2 2"]

    states: ClassVar = (("a", ""), ("b", ""))
    inputs: ClassVar = (("u", ""), ("w", ""))

    def derivative(self, state, inputs):
        return self.A @ state + self.B @ inputs


class Swing(AbstractSystem):
    """Smooth and non-linear in the state and in the input."""

    damping: Float[Array, ""]

    states: ClassVar = (("angle", "rad"), ("rate", "rad/s"))
    inputs: ClassVar = (("torque", ""),)

    def derivative(self, state, inputs):
        angle, rate = state[0], state[1]
        torque = inputs[0] * jnp.cos(angle) + 0.3 * inputs[0] ** 2
        return jnp.stack([rate, -4 * jnp.sin(angle) - self.damping * rate + torque])


class Power(AbstractSystem):
    """x' = gain x^exponent + u."""

    gain: Float[Array, ""]
    exponent: int

    states: ClassVar = (("x", ""),)
    inputs: ClassVar = (("u", ""),)

    def derivative(self, state, inputs):
        return self.gain * state**self.exponent + inputs


OSCILLATOR = Linear(jnp.array([[0.0, 1.0], [-9.0, -0.8]]), jnp.array([[0.0, 0.2], [1.0, -0.5]]))
SWING = Swing(jnp.array(0.3))


def sampled(count: int, width: int) -> np.ndarray:
    return np.random.default_rng(5).normal(size=(count, width))


def exact_first_order_hold(system: Linear, inputs, time_step, first) -> np.ndarray:
    """Matrix exponential of (state, input, slope of the input), which is linear and autonomous."""
    matrix = np.zeros((6, 6))
    matrix[:2, :2], matrix[:2, 2:4], matrix[2:4, 4:] = system.A, system.B, np.eye(2)
    transition = scipy.linalg.expm(matrix * time_step)
    states = [np.asarray(first)]
    for low, high in itertools.pairwise(inputs):
        extended = np.concatenate([states[-1], low, (high - low) / time_step])
        states.append((transition @ extended)[:2])
    return np.array(states)


def scipy_swing(inputs, time_step, first, damping=0.3) -> np.ndarray:
    """DOP853 started anew at each sample, where the input has a kink."""
    states = [np.asarray(first, float)]
    for low, high in zip(inputs[:, 0], inputs[1:, 0]):

        def rate(t, x, low=low, high=high):
            u = low + (high - low) * t / time_step
            return [x[1], -4 * np.sin(x[0]) - damping * x[1] + u * np.cos(x[0]) + 0.3 * u**2]

        solution = solve_ivp(
            rate, (0, time_step), states[-1], method="DOP853", rtol=1e-12, atol=1e-14
        )
        states.append(solution.y[:, -1])
    return np.array(states)


def run(method: AbstractMethod, system, inputs, time_step, first):
    return method.trajectory(system, jnp.asarray(inputs), jnp.asarray(time_step), first)


def observed_orders(errors: list[float]) -> np.ndarray:
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


def test_fixed_steps_converge_at_fourth_order_to_the_matrix_exponential():
    inputs, first = sampled(30, 2), jnp.array([0.5, -1.0])
    exact = exact_first_order_hold(OSCILLATOR, inputs, 0.2, first)
    errors = [
        np.abs(run(FixedStep(k), OSCILLATOR, inputs, 0.2, first)[0] - exact).max()
        for k in (4, 8, 16)
    ]
    np.testing.assert_allclose(observed_orders(errors), 4, atol=0.3)


@pytest.fixture(scope="module")
def swing_by_scipy() -> np.ndarray:
    return scipy_swing(2 * sampled(40, 1), 0.1, [1.0, 0.0])


@pytest.fixture(scope="module")
def swing_by_adaptive():
    method = Adaptive(1e-10, 1e-12)
    return run(method, SWING, 2 * sampled(40, 1), 0.1, jnp.array([1.0, 0.0]))


def test_adaptive_fixed_and_scipy_solutions_agree(swing_by_scipy, swing_by_adaptive):
    adaptive, status, reached = swing_by_adaptive
    fixed = run(FixedStep(64), SWING, 2 * sampled(40, 1), 0.1, jnp.array([1.0, 0.0]))[0]
    # Local errors of 1e-10 add up over some hundreds of steps.
    np.testing.assert_allclose(adaptive, swing_by_scipy, atol=1e-7)
    np.testing.assert_allclose(fixed, swing_by_scipy, atol=1e-9)
    assert bool(status == SimulationStatus.successful)
    assert int(reached) == 40


@pytest.mark.slow
def test_an_implicit_solver_takes_a_stiff_system_with_few_steps():
    stiff = Linear(jnp.array([[-1e6, 1.0], [0.0, -1.0]]), jnp.array([[1e6, 0.0], [0.0, 1.0]]))
    inputs, first = sampled(20, 2), jnp.array([0.0, 0.0])
    exact = exact_first_order_hold(stiff, inputs, 0.1, first)
    method = Adaptive(1e-6, 1e-8, solver=diffrax.Kvaerno5(), max_steps=5000)
    states, status, _ = run(method, stiff, inputs, 0.1, first)
    assert bool(status == SimulationStatus.successful)
    # The fast state follows the input's kinks: only steps that end on them keep the tolerance.
    np.testing.assert_allclose(states, exact, atol=1e-4)
    # That the case is stiff is checked: fifty explicit steps a sample cannot follow it.
    assert bool(run(FixedStep(50), stiff, inputs, 0.1, first)[1] == SimulationStatus.diverged)


def test_used_up_steps_are_a_status_and_leave_finite_states(swing_by_adaptive):
    method = Adaptive(1e-10, 1e-12, max_steps=60)
    states, status, reached = run(method, SWING, 2 * sampled(40, 1), 0.1, jnp.array([1.0, 0.0]))
    assert bool(status == SimulationStatus.max_steps_reached)
    count = int(reached)
    assert 1 < count < 40
    np.testing.assert_allclose(states[:count], swing_by_adaptive[0][:count], atol=1e-12)
    np.testing.assert_array_equal(states[count:], np.tile(states[count - 1], (40 - count, 1)))


# x' = x^3 from this start is x0 / sqrt(1 - 2 x0^2 t), infinite at 0.55 s.
START = jnp.array([1 / np.sqrt(1.1)])


GAINS = jnp.array([-1.0, 1.0, 0.05])


def final_state(gain, method=None):
    zero = jnp.zeros((20, 1))
    method = FixedStep(8) if method is None else method
    return method.trajectory(Power(gain, 3), zero, jnp.array(0.1), START)


@pytest.mark.parametrize(
    "method",
    [FixedStep(8), *nightly([Adaptive(1e-8, 1e-10, max_steps=2000)])],
    ids=["fixed", "adaptive"],
)
def test_a_lost_lane_of_a_batch_leaves_the_others_alone(method):
    states, status, reached = jax.vmap(lambda gain: final_state(gain, method))(GAINS)
    np.testing.assert_array_equal(status == SimulationStatus.successful, [True, False, True])
    np.testing.assert_array_equal(reached, [20, 6, 20])
    assert bool(jnp.all(jnp.isfinite(states)))
    time = 0.1 * np.arange(20)
    for lane in (0, 2):
        gain = float(GAINS[lane])
        exact = START / np.sqrt(1 - 2 * gain * float(START[0]) ** 2 * time)
        np.testing.assert_allclose(states[lane, :, 0], exact, rtol=1e-5)


def test_tangents_through_a_lost_lane_are_finite_and_those_of_the_others_exact():
    _, tangents = jax.jvp(
        lambda gains: jax.vmap(final_state)(gains)[0][:, -1, 0], (GAINS,), (jnp.ones(3),)
    )
    assert bool(jnp.all(jnp.isfinite(tangents)))
    square, time = float(START[0]) ** 2, 1.9
    for lane in (0, 2):
        shrink = 1 - 2 * float(GAINS[lane]) * square * time
        exact = float(START[0]) * square * time * shrink**-1.5
        np.testing.assert_allclose(tangents[lane], exact, rtol=1e-4)


def test_a_state_carried_apart_and_one_carried_as_a_vector_are_the_same(monkeypatch):
    inputs, first = sampled(40, 3), jnp.array([1.0, 0.2])
    found = {}
    for flags in ("", "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1"):
        monkeypatch.setenv("XLA_FLAGS", flags)
        states, status, reached = run(FixedStep(3), SWING, inputs, 0.1, first)
        tangents = jax.jacfwd(lambda x: run(FixedStep(3), SWING, inputs, 0.1, x)[0][-1])(first)
        gradients = jax.jacrev(lambda x: run(FixedStep(3), SWING, inputs, 0.1, x)[0][-1])(first)
        np.testing.assert_allclose(tangents, gradients, rtol=1e-10)
        found[flags] = (states, tangents, reached)
        assert status == SimulationStatus.successful
    for one, other in zip(*found.values()):
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-15)

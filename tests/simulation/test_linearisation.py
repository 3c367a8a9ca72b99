"""Jacobians against those by hand; modes, and how differences grow, against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from riecjax.models.catalogue import built_in_model
from riecjax.simulation.linearisation import FOLDS, growth_horizon, linearise, modes


def oscillator(m=2.0, r=0.6, r2=0.5, k=50.0) -> rx.simulation.AbstractSystem:
    return built_in_model("drag-oscillator").build_system({"m": m, "r": r, "r2": r2, "k": k})


def test_jacobians_at_rest_and_at_a_point_equal_those_by_hand():
    at_rest, gain = linearise(oscillator())
    np.testing.assert_allclose(at_rest, [[0.0, 1.0], [-25.0, -0.3]], rtol=1e-13)
    np.testing.assert_allclose(gain, [[0.0], [0.5]], rtol=1e-13)
    # d/dv (r2 v |v|) = 2 r2 |v|, here 3 at v = -3.
    moving, _ = linearise(oscillator(), jnp.array([0.1, -3.0]), jnp.array([7.0]))
    np.testing.assert_allclose(moving, [[0.0, 1.0], [-25.0, -(0.6 + 3.0) / 2]], rtol=1e-13)


@pytest.mark.parametrize(("omega", "zeta"), [(5.0, 0.0), (8.0, 0.05), (3.0, 0.7)])
def test_an_oscillators_mode_has_its_closed_form(omega, zeta):
    m = 2.0
    system = oscillator(m, 2 * zeta * omega * m, 0.0, omega**2 * m)
    (mode,) = modes(linearise(system)[0])
    assert mode.frequency is not None
    assert mode.damping_ratio is not None
    np.testing.assert_allclose(mode.frequency, omega / (2 * np.pi), rtol=1e-12)
    np.testing.assert_allclose(mode.damping_ratio, zeta, atol=1e-12)
    exact = complex(-zeta * omega, omega * np.sqrt(1 - zeta**2))
    np.testing.assert_allclose(mode.eigenvalue, exact, rtol=1e-12, atol=1e-12)
    # Velocity is the eigenvalue times displacement.
    np.testing.assert_allclose(mode.shape[1], exact * mode.shape[0], rtol=1e-10)
    np.testing.assert_allclose(np.linalg.norm(mode.shape), 1.0, rtol=1e-12)


def test_every_mode_is_an_eigenpair_and_they_are_sorted_by_decay():
    matrix = np.asarray(linearise(built_in_model("quarter-car-source").build_system({}))[0])
    found = modes(jnp.asarray(matrix))
    assert sum(1 if mode.frequency is None else 2 for mode in found) == 7
    decay = [mode.eigenvalue.real for mode in found]
    assert decay == sorted(decay)
    for mode in found:
        np.testing.assert_allclose(
            matrix @ mode.shape, mode.eigenvalue * mode.shape, atol=1e-9 * np.abs(matrix).max()
        )
        assert mode.eigenvalue.imag >= 0


STEP = 0.01
T = np.arange(0, 10, STEP)


class Linear(rx.simulation.AbstractSystem):
    """x' = v, v' = a x - d v + u."""

    a: float
    d: float = 0.0
    states = (("x", "m"), ("v", "m/s"))
    inputs = (("u", "N"),)

    def derivative(self, state, inputs):
        return jnp.stack([state[1], self.a * state[0] - self.d * state[1] + inputs[0]])


def record(rate=3.0):
    x = np.sin(rate * T)
    return rx.Record.from_samples({"x": x, "v": rate * np.cos(rate * T), "u": x}, time_step=STEP)


def test_an_upright_pendulum_grows_by_its_rate():
    """Of x'' = 9 x, in units of x and v / 3, differences grow as e^(3 t) at the most."""
    assert growth_horizon(Linear(9.0), record()) == pytest.approx(FOLDS / 3, rel=0.02)


@pytest.mark.parametrize("system", [Linear(-9.0), Linear(0.0), Linear(-4.0, 1.0), Linear(0.2)])
def test_what_swings_drifts_or_hardly_grows_is_simulated_whole(system):
    assert growth_horizon(system, record()) is None

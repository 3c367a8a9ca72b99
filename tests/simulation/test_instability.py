"""How differences grow along a recorded motion, against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from riecjax.simulation.linearisation import FOLDS, growth

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
    found = growth(Linear(9.0), record())
    assert found is not None
    assert found.factor == pytest.approx(np.exp(30.0), rel=0.1)
    assert found.horizon == pytest.approx(FOLDS / 3, rel=0.02)


@pytest.mark.parametrize("system", [Linear(-9.0), Linear(0.0), Linear(-4.0, 1.0), Linear(0.2)])
def test_what_swings_drifts_or_hardly_grows_is_simulated_whole(system):
    assert growth(system, record()) is None

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


def test_a_horizon_lets_a_right_model_predict_what_no_simulation_follows_for_long():
    rng = np.random.default_rng(1)
    u = np.sin(2 * T) + 0.3 * np.sin(5 * T)
    # A bounded motion of x'' = 9 x + u: to every tone its steady answer.
    x = -np.sin(2 * T) / 13 - 0.3 * np.sin(5 * T) / 34
    v = -2 * np.cos(2 * T) / 13 - 1.5 * np.cos(5 * T) / 34
    noisy = {"x": x + 0.01 * x.std() * rng.standard_normal(T.size), "v": v, "u": u}
    measured = rx.Record.from_samples(noisy, time_step=STEP)
    found = growth(Linear(9.0), measured)
    assert found is not None
    whole = rx.validation.validate_held_out(Linear(9.0), measured)
    anew = rx.validation.validate_held_out(Linear(9.0), measured, horizon=found.horizon)
    assert not whole.predicts
    assert anew.predicts
    assert "anew from the recording every 0.8" in anew.verdict
    lengths = {stop - start for start, stop in anew.stretches}
    assert min(lengths) >= round(found.horizon / STEP)
    assert max(lengths) < 1.2 * found.horizon / STEP

"""Recovery from random starts: of a problem whose basin is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import riecjax as rx
from riecjax.refinement.output_error import Tiles
from riecjax.simulation.system import AbstractSystem
from riecjax.studies import recovery_map


class Oscillator(AbstractSystem):
    """x'' + 0.2 x' + w^2 x = 0: over many periods, only a near frequency finds the true one."""

    w: Array

    states = (("x", "m"), ("dx", "m/s"))

    def derivative(self, state: Array, inputs: Array) -> Array:
        return jnp.stack([state[1], -(self.w**2) * state[0] - 0.02 * state[1]])


@pytest.fixture(scope="module")
def swing():
    t = np.arange(0, 20, 0.02)
    w = np.sqrt(4.0 - 1e-4)
    x = np.exp(-0.01 * t) * np.cos(w * t)
    dx = np.gradient(x, 0.02)
    rng = np.random.default_rng(0)
    samples = {"x": x + 0.01 * rng.normal(size=t.size), "dx": dx + 0.02 * rng.normal(size=t.size)}
    return rx.Record.from_samples(samples, time_step=0.02)


@pytest.mark.slow
def test_short_windows_first_recover_from_where_the_whole_record_does_not(swing):
    model = Oscillator(jnp.asarray(1.9))
    whole = rx.OutputError(method=rx.FixedStep(2))
    optimum = rx.refine(model, swing, {"w": 1.95}, whole)
    assert float(optimum["w"]) == pytest.approx(2.0, rel=1e-3)
    short = rx.OutputError(Tiles(samples=10), initial_states="measured", method=rx.FixedStep(2))
    key = jax.random.key(1)
    at_once, in_turn = (
        recovery_map(model, swing, optimum, by, key=key, starts=24, farthest=4.0)
        for by in ([whole], [short, whole])
    )
    assert np.all(np.isfinite(at_once.theta))
    assert np.all(np.asarray(in_turn.recovered))
    assert 0.1 < float(np.mean(at_once.recovered)) < 0.7
    factor = np.asarray(at_once.start)[:, 0] / float(optimum["w"])
    np.testing.assert_allclose(np.maximum(factor, 1 / factor), at_once.distance)
    near = np.asarray(at_once.distance) < 1.02
    assert np.all(np.asarray(at_once.recovered)[near])
    rows = at_once.shares((1.0, 2.0, 4.001))
    assert sum(count for _, _, count, _ in rows) == 24
    assert rows[0][3] >= rows[1][3]

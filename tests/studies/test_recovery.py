"""Recovery from random starts: of a problem whose basin is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import riecjax as rx
from riecjax.refinement.output_error import Tiles
from riecjax.simulation.system import AbstractSystem
from riecjax.studies import over_keys


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


def refined(key, model, record, optimum, objectives):
    """The factor by which a random start is off, up to 4, and where refinements in turn end."""
    size, sign = jax.random.split(key)
    factor = 4.0 ** jax.random.uniform(size)
    w = optimum * jnp.where(jax.random.bernoulli(sign), factor, 1 / factor)
    for by in objectives:
        w = rx.refine(model, record, {"w": w}, by, max_steps=100)["w"]
    return factor, w


@pytest.mark.slow
def test_short_windows_first_recover_from_where_the_whole_record_does_not(swing):
    model = Oscillator(jnp.asarray(1.9))
    whole = rx.OutputError(method=rx.FixedStep(2))
    optimum = rx.refine(model, swing, {"w": 1.95}, whole)
    assert float(optimum["w"]) == pytest.approx(2.0, rel=1e-3)
    short = rx.OutputError(Tiles(samples=10), initial_states="measured", method=rx.FixedStep(2))
    (factor, at_once), (_, in_turn) = (
        over_keys(refined, jax.random.key(1), 24, model, swing, optimum["w"], by, chunk=24)
        for by in ((whole,), (short, whole))
    )
    assert np.all(np.isfinite(at_once))
    assert np.all(recovered(in_turn, optimum))
    found, factor = recovered(at_once, optimum), np.asarray(factor)
    assert 0.1 < np.mean(found) < 0.7
    assert np.all(found[factor < 1.02])
    assert np.mean(found[factor < 2]) >= np.mean(found[factor >= 2])


def recovered(w, optimum: rx.Estimate) -> np.ndarray:
    """Whether values are within a tenth of a standard error of the optimum."""
    return np.abs(np.asarray(w) - float(optimum["w"])) < 0.1 * float(optimum.standard_error("w"))

"""Standard errors of refined parameters: against scatter over noise, and the Cramer-Rao bound."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from tests.machines import DRAG
from tests.machines import DRAG_BOUND as BOUND
from tests.machines import DRAG_START as START
from tests.machines import DRAG_TRUTH as TRUTH
from tests.machines import drag_oscillator as oscillator
from tests.machines import drag_record as record
from tests.machines import drag_signals as signals

from riecjax.records.record import Record, stack_records
from riecjax.refinement.coordinates import Prior
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.refine import refine
from riecjax.refinement.shots import Tiles
from riecjax.simulation.method import FixedStep
from riecjax.simulation.system import AbstractSystem
from riecjax.uncertainty.intervals import BlockBootstrap, Naive, Sandwich

RATE = DRAG.shape.rate
WHOLE = OutputError(method=FixedStep(1))
SEEDS = 100


@eqx.filter_jit
def refine_all(records, by, intervals):
    def one(arrays):
        found = refine(oscillator(), Record(arrays, 1 / RATE), START, by, intervals=intervals)
        return found.theta, found.standard_errors, found.converged

    return jax.vmap(one)(records.arrays)


@pytest.mark.slow
def test_errors_reach_the_cramer_rao_bound_and_are_told():
    records = stack_records([record(seed) for seed in range(SEEDS)])
    theta, errors, converged = refine_all(records, WHOLE, Sandwich())
    truth, bound = (np.array(list(values.values())) for values in (TRUTH, BOUND))
    assert np.all(converged)
    rms = np.sqrt(np.mean((np.asarray(theta) / truth - 1) ** 2, axis=0))
    # A root mean square of a hundred draws is known to 7 %.
    assert np.all(rms < 1.1 * bound)
    assert np.all(rms > 0.8 * bound)
    np.testing.assert_allclose(np.mean(np.asarray(errors) / truth, axis=0), bound, rtol=0.1)


def coloured(seed, count=1001, pole=0.9):
    """Noise of 5 % that is correlated in time."""
    rng = np.random.default_rng(seed)
    held = {name: samples[:count] for name, samples in signals().items()}
    for name in ("x", "dx"):
        clean = DRAG.signals()[name]
        white = rng.standard_normal(count + 200)
        noise = np.zeros(count + 200)
        for i in range(1, noise.size):
            noise[i] = pole * noise[i - 1] + white[i]
        noise = noise[200:] * np.sqrt(1 - pole**2)
        held[name] = held[name] + 0.05 * clean.std() * noise
    return Record.from_samples(held, time_step=1 / RATE)


@pytest.mark.slow
@pytest.mark.parametrize("by", [WHOLE, OutputError(Tiles(samples=334), method=FixedStep(1))])
def test_noise_that_hangs_together_widens_the_errors_as_it_should(by):
    records = stack_records([coloured(seed) for seed in range(SEEDS)])
    theta, errors, _ = refine_all(records, by, Sandwich())
    scatter = np.std(np.asarray(theta), axis=0)
    np.testing.assert_allclose(np.mean(np.asarray(errors), axis=0), scatter, rtol=0.3)
    _, naive, _ = refine_all(records, by, Naive())
    assert np.all(np.mean(np.asarray(naive), axis=0) < 0.6 * scatter)


@pytest.mark.slow
def test_the_bootstrap_agrees_with_the_sandwich_where_noise_is_white():
    noisy = record(seed=3)
    one = refine(oscillator(), noisy, START, WHOLE)
    other = refine(oscillator(), noisy, START, WHOLE, intervals=BlockBootstrap(400))
    np.testing.assert_allclose(other.theta, one.theta)
    np.testing.assert_allclose(other.standard_errors, one.standard_errors, rtol=0.35)
    low, high = other.interval("k")
    assert low < float(other["k"]) < high


@pytest.mark.slow
def test_single_precision_ends_near_the_optimum():
    noisy = record(seed=0)
    double = refine(oscillator(), noisy, START, WHOLE)
    with jax.enable_x64(False):
        held = {name: samples.astype(np.float32) for name, samples in signals(0).items()}
        single = refine(oscillator(), Record.from_samples(held, time_step=1 / RATE), START, WHOLE)
        assert single.theta.dtype == jnp.float32
        off = np.abs(np.asarray(single.theta) - np.asarray(double.theta))
    assert np.all(off < 0.05 * np.asarray(double.standard_errors))


class Decay(AbstractSystem):
    """x' = -a b x: only the product is determined."""

    a: Array
    b: Array

    states = (("x", "m"),)

    def derivative(self, state, inputs):
        return -(self.a * self.b) * state


@pytest.fixture(scope="module")
def decaying():
    t = np.arange(400) / 100
    noise = 0.01 * np.random.default_rng(0).normal(size=400)
    held = Record.from_samples({"x": np.exp(-0.7 * t) + noise}, time_step=0.01)
    return Decay(jnp.asarray(1.0), jnp.asarray(1.0)), held


@pytest.mark.raises_finding("undetermined")
def test_parameters_that_make_up_for_each_other_are_called_undetermined(decaying):
    model, held = decaying
    both = refine(model, held, {"a": 0.5, "b": 1.1})
    assert float(both["a"] * both["b"]) == pytest.approx(0.7, rel=0.05)
    (found,) = both.findings()
    assert found.code == "undetermined"
    assert "when a, b change together" in found.message
    assert np.all(np.isnan(both.standard_errors))


@pytest.mark.slow
def test_what_is_known_of_one_determines_the_other(decaying):
    model, held = decaying
    one = refine(model, held, {"a": 0.5}, known={"b": 1.1})
    assert one.findings() == []
    pulled = refine(model, held, {"a": 0.5, "b": 1.1}, priors={"b": Prior(1.1, 0.05)})
    assert pulled.findings() == []
    assert float(pulled.standard_error("b")) == pytest.approx(0.05, rel=0.2)

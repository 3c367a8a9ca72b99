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

from riecjax.records.record import Record, stack_records
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.refine import refine
from riecjax.simulation.method import FixedStep
from riecjax.simulation.system import AbstractSystem
from riecjax.uncertainty.intervals import Sandwich

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

"""Derivatives of refined parameters, and of what is refined, against finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import DRAG_START as START
from tests.machines import drag_oscillator as oscillator
from tests.machines import drag_record as record

from nightly import nightly
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import AllWindows
from riecjax.models.catalogue import built_in_model
from riecjax.models.oscillators import drag_oscillator_equation
from riecjax.records.record import Record
from riecjax.refinement.integral_error import IntegralError
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.refine import refine
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate

SHORT = 401
BY = OutputError(method=FixedStep(1))


def moved(amount):
    """The record with a bump added to the measured position."""
    noisy = record(seed=0, count=SHORT)
    bump = jnp.exp(-(((jnp.arange(SHORT) - 150) / 20) ** 2))
    return noisy.with_signals({"x": noisy["x"] + amount * bump})


def by_simulation(amount):
    return refine(oscillator(), moved(amount), START, BY).theta


def by_integrals(amount):
    criterion = RIEC(AllWindows(0.05, 0.5))
    return refine(drag_oscillator_equation(), moved(amount), START, IntegralError(criterion)).theta


def by_known(amount):
    start = {name: START[name] for name in ("m", "r", "r2")}
    return refine(oscillator(), moved(0.0), start, BY, known={"k": 20.0 + amount}).theta


@pytest.mark.parametrize("fit", [by_integrals, *nightly([by_simulation, by_known])])
def test_the_optimum_follows_what_it_is_made_of(fit):
    """The residual is not small, so the second derivatives of the simulation count."""
    zero = jnp.zeros(())
    forward = eqx.filter_jit(jax.jacfwd(fit))(zero)
    step = 1e-4
    compiled = eqx.filter_jit(fit)
    differences = (compiled(zero + step) - compiled(zero - step)) / (2 * step)
    np.testing.assert_allclose(forward, differences, rtol=1e-4)


def slopes_and_differences(function, at, step):
    slope = jax.jacfwd(function)(at)
    return slope, (function(at + step) - function(at - step)) / (2 * step)


def test_gradients_through_friction_are_those_of_differences():
    """An axis that is driven to and fro, and sticks at every turn."""
    t = np.arange(1500) / 1000
    drive = Record.from_samples({"force": 40 * np.sin(4 * t) ** 3}, time_step=1e-3)
    axis = built_in_model("emps").build_system({"M": 95.0, "Fv": 200.0, "offset": 0.0})

    @jax.jit
    def velocity(coulomb):
        own = eqx.tree_at(lambda a: a.values["Fc"], axis, coulomb)
        return simulate(own, drive, method=FixedStep(8)).record["dq"][::100]

    still = np.asarray(velocity(jnp.asarray(20.0))) == 0
    assert 3 < np.sum(still) < 12
    slope, differences = slopes_and_differences(velocity, jnp.asarray(20.0), 1e-4)
    assert np.all(np.isfinite(slope))
    assert np.max(np.abs(slope)) > 1e-3
    np.testing.assert_allclose(slope, differences, rtol=1e-3, atol=1e-4)

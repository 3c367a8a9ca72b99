"""Refinement on the paper's quarter car."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from nightly import nightly
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import AllWindows
from riecjax.models.quarter_car.identification import (
    FORCES,
    INNER,
    body_balance,
    quarter_car_of_break_points,
    wheel_balance,
)
from riecjax.records.record import Record
from riecjax.refinement.integral_error import IntegralError
from riecjax.refinement.optimum import LevenbergMarquardt
from riecjax.refinement.refine import refine
from riecjax.simulation.inputs import band_limited_noise
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate

STEP = 1 / 200
KEYS = jax.random.split(jax.random.key(6), 3)
WINDOWS = AllWindows(0.05, 0.5)
# Samples that cross a break point are kinks, at which no gradient vanishes to rounding.
SOLVER = LevenbergMarquardt(1e-3)
INNER_PLACES = {"v_2": -0.3, "v_3": 0.3}


def white_noise(samples: int) -> Record:
    noise = band_limited_noise(KEYS[0], samples, STEP, bandwidth=30.0, rms=0.55)
    return Record({"v_r": noise}, STEP)


@pytest.mark.parametrize(
    ("balance", "mass"), [(body_balance(), "M_s"), *nightly([(wheel_balance(), "M_us")])]
)
def test_integral_refinement_finds_the_break_points_of_a_map_that_has_them(balance, mass):
    truth = {
        "K_t": 178e3,
        "M_us": 23.2,
        "M_s": 302.7,
        "K_s": 20.7e3,
        **dict(zip(FORCES, (-1200.0, -800.0, 700.0, 1130.0))),
        "v_2": -0.2,
        "v_3": 0.15,
    }
    system = quarter_car_of_break_points(truth)
    record = simulate(system, white_noise(4000), method=FixedStep(4)).checked().record
    start = {"K_s": 15e3, **{name: 0.8 * truth[name] for name in FORCES}, **INNER_PLACES}
    known = {mass: truth[mass]}
    by = IntegralError(RIEC(WINDOWS))
    refined = refine(balance, record, start, by, known=known, solver=SOLVER)
    assert bool(refined.converged)
    for name in ("K_s", *INNER):
        np.testing.assert_allclose(refined[name], truth[name], rtol=0.02)


def test_an_outer_break_point_may_slide_along_its_segment():
    parameters = {
        "K_t": 178e3,
        "M_us": 23.2,
        "M_s": 302.7,
        "K_s": 20.7e3,
        **dict(zip(FORCES, (-1200.0, -800.0, 700.0, 1100.0))),
    }
    here = quarter_car_of_break_points(parameters)
    slid = quarter_car_of_break_points({**parameters, "v_1": -0.55, "F_1": -1000.0})
    speeds = jnp.linspace(-2.0, 2.0, 41)
    np.testing.assert_allclose(
        slid.roof.interpolate(slid.F, speeds), here.roof.interpolate(here.F, speeds), rtol=1e-12
    )

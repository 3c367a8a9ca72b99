"""Refinement on the paper's quarter car; the whole study is in benchmarks/paper."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from nightly import nightly
from riecjax.criteria.criterion import DOLS, RIEC
from riecjax.criteria.windows import AllWindows
from riecjax.models.catalogue import built_in_model
from riecjax.models.quarter_car.identification import (
    FORCES,
    INNER,
    body_balance,
    damper_system,
    quarter_car_of_break_points,
    wheel_balance,
)
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.paper.reproduction import (
    PARAMETERS,
    TRUE_MASSES,
    VALIDATED_STATES,
    identify_variants,
)
from riecjax.records.record import Record
from riecjax.refinement.arrowhead import LevenbergMarquardt
from riecjax.refinement.integral_error import IntegralError
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.refine import refine
from riecjax.simulation.inputs import band_limited_noise, robson_road
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate
from riecjax.validation.goodness_of_fit import validate

STEP = 1 / 200
METHOD = FixedStep(3)
# The source model is driven by roads that are straight lines between samples.
BY = partial(OutputError, intersample="lines")
KEYS = jax.random.split(jax.random.key(6), 3)
WINDOWS = AllWindows(0.05, 0.5)
# Samples that cross a break point are kinks, at which no gradient vanishes to rounding.
SOLVER = LevenbergMarquardt(1e-3)
STATES = {
    "four states": {name: 0.0 for name in VALIDATED_STATES},
    "seven states": {f"x{i}": 0.0 for i in range(1, 8)},
}
INNER_PLACES = {"v_2": -0.3, "v_3": 0.3}


def white_noise(samples: int) -> Record:
    noise = band_limited_noise(KEYS[0], samples, STEP, bandwidth=30.0, rms=0.55)
    return Record({"v_r": noise}, STEP)


def road(key, samples: int = 4000) -> Record:
    roughness = jnp.asarray(reconstructed().roughness)
    return Record({"v_r": robson_road(key, samples, STEP, roughness=roughness)}, STEP)


def driven(inputs: Record) -> Record:
    source = quarter_car_source(reconstructed())
    return simulate(source, inputs, method=FixedStep(6)).checked().record


@pytest.fixture(scope="module")
def from_white_noise():
    record = driven(white_noise(4000))
    return {
        type(criterion).__name__: identify_variants(record, criterion, jax.random.key(0))
        for criterion in (RIEC(WINDOWS), DOLS())
    }


def validation_error(parameters) -> float:
    truth = driven(road(KEYS[2]))
    model = quarter_car_of_break_points(parameters)
    found = simulate(model, truth.select("v_r"), method=METHOD).checked().record
    return float(validate(found, truth, VALIDATED_STATES).total)


def values(refined) -> dict:
    return {**refined.known, **{name: refined[name] for name in refined.parameters}}


def refined_on_a_road(start, known):
    by = BY(channels=VALIDATED_STATES, initial_states=STATES["four states"], method=METHOD)
    record = driven(road(KEYS[1]))
    refined = refine(damper_system(), record, start, by, known=known, solver=SOLVER)
    assert bool(refined.converged)
    return values(refined)


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["B_id", "W_true"])
def test_refined_on_a_road_predicts_another_road_better_than_riec_and_dols(
    from_white_noise, variant
):
    begun = from_white_noise["RIEC"][variant]
    # Motions tell forces up to a factor: where no mass is known, K_t is.
    known = TRUE_MASSES if variant.endswith("true") else {"K_t": begun["K_t"]}
    start = {name: begun[name] for name in PARAMETERS if name not in known}
    error = validation_error(refined_on_a_road(start, known))
    assert error < 0.99 * validation_error(begun)
    assert error < 0.9 * validation_error(from_white_noise["DOLS"][variant])


@pytest.mark.slow
def test_free_break_points_predict_another_road_better_than_riec(from_white_noise):
    begun = from_white_noise["RIEC"]["B_id"]
    start = {name: begun[name] for name in PARAMETERS if name != "K_t"}
    freed = refined_on_a_road({**start, **INNER_PLACES}, {"K_t": begun["K_t"]})
    assert validation_error(freed) < 0.96 * validation_error(begun)
    assert -0.3 < freed["v_2"] < -0.1
    assert 0.1 < freed["v_3"] < 0.3


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


@pytest.mark.slow
def test_the_source_model_is_found_from_sensors_from_a_start_that_is_half_off():
    model = built_in_model("quarter-car-source")
    truth = {"M_e": 100.0, "K_c": 500e3, "K_m": 400e3, "B_m": 4000.0}
    channels = ("x2", "x3", "x4", "F_t")
    seen = simulate(model.build_system({}), white_noise(1000), method=FixedStep(24)).checked()
    record = seen.record.select("v_r", *channels)
    start = {name: value * (1.5, 0.5)[i % 2] for i, (name, value) in enumerate(truth.items())}
    by = BY(channels=channels, initial_states=STATES["seven states"], method=FixedStep(8))
    refined = refine(model, record, start, by)
    assert bool(refined.converged)
    for name, value in truth.items():
        np.testing.assert_allclose(refined[name], value, rtol=0.01)

"""How the study is put together; its numbers are compared with the published ones elsewhere."""

import equinox as eqx
import jax
import numpy as np
import pytest

import riecjax as rx
from riecjax.models.catalogue import built_in_model
from riecjax.models.quarter_car.identification import (
    quarter_car_by_body,
    quarter_car_by_wheel,
    quarter_car_system,
)
from riecjax.models.quarter_car.reconstruction import Pothole, reconstructed
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper import reproduction
from riecjax.paper.published import CRITERIA, INPUTS, TABLE_2, VARIANTS
from riecjax.simulation.inputs import pothole

# Coarse steps: what is tested is that ways of computing agree, not how accurately.
METHOD = rx.FixedStep(2)
KEY = jax.random.key(2024)
SHAPE = {"depth": 0.04, "length": 1.5, "ramp": 0.4}
SHAPES = eqx.tree_at(
    lambda s: (s.pothole, s.roughness),
    reconstructed(),
    (Pothole(**{name: np.array(value) for name, value in SHAPE.items()}), np.array(2e-5)),
)


def source() -> QuarterCarSource:
    built = built_in_model("quarter-car-source").build_system({})
    assert isinstance(built, QuarterCarSource)
    return built


@pytest.fixture(scope="module")
def training() -> rx.Record:
    record_key = jax.random.split(KEY, 3)[0]
    return reproduction.identification_record(source(), record_key, method=METHOD).checked().record


@pytest.fixture(scope="module")
def alone() -> reproduction.RoadResult:
    return eqx.filter_jit(reproduction.run_road)(KEY, source(), SHAPES, method=METHOD)


def test_identification_record_is_the_white_road_of_table_2(training):
    velocity = np.asarray(training["v_r"])
    assert velocity.size == 8000
    assert float(training.time_step) == 1 / 200
    np.testing.assert_allclose(np.sqrt(np.mean(velocity**2)), 0.55, rtol=1e-12)
    energy = np.abs(np.fft.rfft(velocity)) ** 2
    assert np.sum(energy[np.fft.rfftfreq(8000, 1 / 200) > 30.001]) < 1e-20 * np.sum(energy)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("criterion", "variant"),
    [("RIEC", "W_true"), ("RIEC", "B_id"), ("DOLS", "B_true"), ("DOLS", "W_id")],
)
def test_variants_equal_identify_with_its_equation_and_known_masses(criterion, variant, training):
    key = jax.random.key(9)
    made = reproduction.paper_criteria()[criterion]
    found = dict(
        zip(
            reproduction.PARAMETERS,
            reproduction.identify_variants(training, made, key)[VARIANTS.index(variant)],
        )
    )
    model = quarter_car_by_wheel() if variant.startswith("W") else quarter_car_by_body()
    known = {"M_us": 30.0, "M_s": 300.0} if variant.endswith("true") else {}
    settings = {"known": known, "intervals": rx.Naive(), "noise": "none"}
    expected = rx.identify(model, training, made, key=key, **settings)
    for name in reproduction.PARAMETERS:
        # The same normal equations, but in one block here and in many there.
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-8, err_msg=name)
    if known:
        assert (float(found["M_us"]), float(found["M_s"])) == (30.0, 300.0)


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["W_id", "B_true"])
def test_pothole_errors_are_those_of_the_identified_model_against_the_source(variant, alone):
    step = 1 / TABLE_2.rate
    velocity = pothole(600, step, **SHAPE)
    inputs = rx.Record({"v_r": velocity}, step)
    truth = rx.simulate(source(), inputs, method=METHOD).record
    place = CRITERIA.index("DOLS"), VARIANTS.index(variant)
    model = quarter_car_system(dict(zip(reproduction.PARAMETERS, alone.parameters[place])))
    predicted = rx.simulate(model, inputs, method=METHOD).record
    expected = [
        100 * np.linalg.norm(predicted[s] - truth[s]) / np.linalg.norm(truth[s])
        for s in ("x1", "x2", "x3", "x4")
    ]
    found = alone.errors[(*place, INPUTS.index("pothole"))]
    np.testing.assert_allclose(found, expected, rtol=1e-8)

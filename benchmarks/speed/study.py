"""The paper's study of one road: eight models identified and validated on two inputs."""

from collections.abc import Iterator

import equinox as eqx
import jax
import numpy as np

from benchmarks.speed.baselines.numpy_study import RoadInputs, study
from benchmarks.speed.baselines.quarter_car import car_of
from benchmarks.speed.simulation import SCIPY_TOLERANCE
from benchmarks.speed.timing import Comparison, Size, compare
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.paper.published import CRITERIA, TABLE_2, VARIANTS
from riecjax.paper.reproduction import (
    PARAMETERS,
    RoadResult,
    road_keys,
    run_road,
    stack_models,
    training_noise,
    validation_inputs,
)


@eqx.filter_jit
def roads(keys: jax.Array) -> RoadResult:
    shapes = reconstructed()
    source = quarter_car_source(shapes)
    return jax.vmap(lambda key: run_road(key, source, shapes))(keys)


def run(size: Size) -> Iterator[Comparison]:
    shapes = reconstructed()
    keys = jax.random.split(jax.random.key(0), size.roads)
    own = road_keys(keys[0])
    validation = validation_inputs(own.validation, shapes)
    inputs = RoadInputs(
        np.asarray(training_noise(own.training)),
        np.asarray(validation["road"]),
        np.asarray(validation["pothole"]),
    )
    car = car_of(quarter_car_source(shapes))
    plain = study(car, inputs, TABLE_2.rate, rtol=SCIPY_TOLERANCE)
    models = stack_models(roads(keys).parameters, CRITERIA, VARIANTS)
    ours = np.stack([np.asarray(models[name])[0] for name in PARAMETERS], axis=-1)
    off = np.abs(ours / plain.parameters - 1).max(axis=(1, 2))
    accuracy = {f"{c}_largest_difference": float(v) for c, v in zip(CRITERIA, off)}
    yield compare(
        "study",
        lambda: roads(keys),
        f"NumPy and SciPy, one road times {size.roads}",
        lambda: study(car, inputs, TABLE_2.rate, rtol=SCIPY_TOLERANCE),
        100,
        accuracy,
        repeats=min(size.repeats, 3),
        their_repeats=1,
        scale=size.roads,
    )

"""Validation trajectories of Section 5: one road and the pot-hole, by models of many roads.

Figures 9 and 10 show one model each. Here models identified on many roads predict one and the same
motion, so that a band shows how far they scatter.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from riecjax.models.quarter_car.identification import QuarterCar
from riecjax.models.quarter_car.reconstruction import Pothole, Reconstruction
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.published import CRITERIA, TABLE_2, VARIANTS
from riecjax.paper.reproduction import (
    VALIDATED_STATES,
    Parameters,
    RoadResult,
    pothole_velocity,
    road_keys,
    stack_models,
    validation_errors,
    validation_inputs,
)
from riecjax.records.record import Record
from riecjax.simulation.simulate import simulate

SHOWN_VARIANT = "B_id"


class Trajectories(eqx.Module):
    """Motion on one input, and what models identified on many roads predict of it.

    **Fields:** `time` in s; `source`, x1 to x4; `predicted` by criterion.
    """

    time: Float[Array, " n"]
    source: Float[Array, "n 4"]
    predicted: dict[str, Float[Array, "roads n 4"]]


def validation_trajectories(
    roads: RoadResult, key: Key[Array, ""], source: QuarterCarSource, shapes: Reconstruction
) -> dict[str, Trajectories]:
    """Of the variant B_id on the `road` that belongs to `key`, and on the `pothole`."""
    inputs = validation_inputs(road_keys(key).validation, shapes)
    models = stack_models(roads.parameters, CRITERIA, (SHOWN_VARIANT,))
    return {name: _trajectories(models, source, v) for name, v in inputs.items()}


@eqx.filter_jit
def _trajectories(models: Parameters, source: QuarterCarSource, velocity: Array) -> Trajectories:
    inputs = Record({"v_r": velocity}, 1 / TABLE_2.rate)

    def predict(parameters: Parameters) -> Array:
        return _states(simulate(QuarterCar.from_parameters(parameters), inputs).record)

    # Roads, criteria, and the one variant.
    predicted = jax.vmap(jax.vmap(jax.vmap(predict)))(models)[:, :, 0]
    return Trajectories(
        inputs.time,
        _states(simulate(source, inputs).record),
        {name: predicted[:, i] for i, name in enumerate(CRITERIA)},
    )


def _states(record: Record) -> Float[Array, "n 4"]:
    return jnp.stack([record[name] for name in VALIDATED_STATES], axis=-1)


RAMPS = (0.3, 0.6, 0.9, 1.2, 1.5, 1.8)
"""Metres over which the road falls into the hole; the reconstruction's is 1.29 m."""


@eqx.filter_jit
def errors_over_ramps(
    roads: RoadResult, source: QuarterCarSource, shapes: Reconstruction
) -> Float[Array, "ramps roads criteria variants 4"]:
    """p_i of x1 to x4 in percent, on pot-holes of the same depth and length with these ramps."""
    models = stack_models(roads.parameters, CRITERIA, VARIANTS)

    def on(ramp: Array) -> Array:
        hole = Pothole(shapes.pothole.depth, shapes.pothole.length, ramp)
        inputs = Record({"v_r": pothole_velocity(hole)}, 1 / TABLE_2.rate)
        truth = simulate(source, inputs).record
        return jax.vmap(lambda each: validation_errors(each, truth)[0])(models)

    return jax.lax.map(on, jnp.array(RAMPS))

"""How the wheel velocity's share of the error depends on the pot-hole's shape, which is lost."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.models.quarter_car.reconstruction import Pothole, Reconstruction
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.published import CRITERIA, TABLE_2, VARIANTS
from riecjax.paper.reproduction import (
    RoadResult,
    pothole_velocity,
    stack_models,
    validation_errors,
)
from riecjax.records.record import Record
from riecjax.simulation.simulate import simulate

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

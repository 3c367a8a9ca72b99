"""Section 6 of the paper: input bandwidth, engine mounts and sampling seeds varied, over roads.

On every road the white noise of Table 2 is cut off at each bandwidth, each of Table 6's source
models is driven with it, and the variant B_id is identified by DOLS and by RIEC with several draws
of windows. All of these models are validated on the two inputs of Section 5.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.estimation.assembly import stage_normal_equations
from riecjax.estimation.procedure import found_values, solve_stages
from riecjax.models.quarter_car.equations import quarter_car_by_body
from riecjax.models.quarter_car.reconstruction import Reconstruction, quarter_car_source
from riecjax.paper.published import TABLE_2, MountVariant
from riecjax.paper.reproduction import (
    PARAMETERS,
    paper_criteria,
    prediction_errors,
    road_keys,
    training_noise,
    validation_inputs,
)
from riecjax.records.record import Record
from riecjax.simulation.excitation import low_passed
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate


class Variations(NamedTuple):
    """What is varied.

    **Fields:** `bandwidths` of the input in Hz; `cases` of Table 6 by name; `roads`, their number;
    `draws` of random windows on each record.
    """

    bandwidths: tuple[float, ...]
    cases: tuple[str, ...]
    roads: int
    draws: int


class RoadVariations(eqx.Module):
    """One road under one engine mount, at every bandwidth.

    `models` are DOLS, and RIEC with each draw of windows.

    **Fields:** `parameters` in the order of `PARAMETERS`; `errors`, p_i of x1 to x4 in percent for
    each of `INPUTS`; whether all simulations behind a model were `successful`.
    """

    parameters: Float[Array, "bandwidths models parameters"]
    errors: Float[Array, "bandwidths models inputs 4"]
    successful: Bool[Array, "bandwidths models"]


def vary_road(
    key: Key[Array, ""],
    mount: MountVariant,
    bandwidths: Float[Array, " bandwidths"],
    shapes: Reconstruction,
    draws: int,
    *,
    method: FixedStep | None = None,
) -> RoadVariations:
    """Simulate, identify and validate on one random road; vmap over keys for many.

    The road of a key is that of [`run_road`][]: at 30 Hz and with the pathological mount, its first
    draw gives the models of Tables 3 to 5.
    """
    source = quarter_car_source(shapes, mount_rate=mount.stiffness, mount_damping=mount.damping)
    keys = road_keys(key)
    step = 1 / TABLE_2.rate
    noise = training_noise(keys.training)
    driven = jax.vmap(lambda bandwidth: low_passed(noise, step, bandwidth))(bandwidths)

    def identified(velocity: Array) -> tuple[Array, Array]:
        training = simulate(source, Record({"v_r": velocity}, step), method=method)
        return identify_by_body(training.record, keys.windows, draws), training.successful

    parameters, trained = jax.vmap(identified)(driven)
    models = {name: parameters[..., i] for i, name in enumerate(PARAMETERS)}
    errors, kept = [], trained[:, None]
    for velocity in validation_inputs(keys.validation, shapes).values():
        truth = simulate(source, Record({"v_r": velocity}, step), method=method)
        found, predicted = jax.vmap(
            jax.vmap(lambda model, t=truth: prediction_errors(model, t.record, method))
        )(models)
        errors.append(found)
        kept = kept & truth.successful & predicted
    return RoadVariations(parameters, jnp.stack(errors, axis=2), kept)


def identify_by_body(
    record: Record, key: Key[Array, ""], draws: int
) -> Float[Array, "models parameters"]:
    """The variant B_id by DOLS, and by RIEC with so many draws of windows; the first is `key`'s."""
    criteria = paper_criteria()
    rest = jax.random.split(jax.random.fold_in(key, 1), draws - 1)
    drawn = jnp.stack([key, *(rest[i] for i in range(draws - 1))])
    by_riec = jax.vmap(lambda each: by_body(record, criteria["RIEC"], each))(drawn)
    return jnp.concatenate([by_body(record, criteria["DOLS"])[None], by_riec])


def by_body(
    record: Record, criterion: AbstractCriterion, key: Key[Array, ""] | None = None
) -> Float[Array, " parameters"]:
    """The variant B_id by one criterion, in the order of `PARAMETERS`."""
    stages = stage_normal_equations(quarter_car_by_body(), record, criterion, key)
    values = found_values(solve_stages(stages, {}), {})
    return jnp.stack([values[name] for name in PARAMETERS])

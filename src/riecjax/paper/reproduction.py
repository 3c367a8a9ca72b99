"""Sections 4 and 5 of the paper on simulated roads: Tables 3, 4 and 5."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from riecjax.criteria.criterion import DOLS, RIEC, AbstractCriterion
from riecjax.criteria.windows import RandomWindows
from riecjax.equations.procedure import Procedure
from riecjax.estimation.stages import found_values, solve_stages
from riecjax.models.quarter_car.identification import (
    QuarterCar,
    body_equation,
    mass_equation,
    tyre_equation,
    wheel_equation,
)
from riecjax.models.quarter_car.reconstruction import Pothole, Reconstruction
from riecjax.models.quarter_car.source import QuarterCarSource, contact_share
from riecjax.paper.published import CRITERIA, TABLE_2, VARIANTS
from riecjax.records.record import Record
from riecjax.simulation.inputs import band_limited_noise, pothole, robson_road
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import Simulation, simulate
from riecjax.summaries.stage_sums import stage_normal_equations
from riecjax.validation.goodness_of_fit import percentage_error

TRUE_MASSES = {"M_us": 30.0, "M_s": 300.0}
VALIDATED_STATES = ("x1", "x2", "x3", "x4")
INPUTS = ("road", "pothole")
"""What models are validated on."""
POTHOLE_DURATION = 3.0
"""Seconds of the pot-hole's validation, enough for the body to come to rest."""

PARAMETERS = ("K_t", "M_us", "M_s", "K_s", "F_1", "F_2", "F_3", "F_4")

Parameters = dict[str, Float[Array, ""]]


class RoadResult(eqx.Module):
    """One road: everything that Tables 3 to 5 print, and the damper maps.

    **Fields:**

    - `parameters`: by criterion, then variant, then parameter name.
    - `errors`: p_i of x1 to x4 in percent, by input, then criterion, then variant; shape `(4,)`.
    - `contact`: share of the identification record in which the tyre touches the road.
    - `successful`: whether every simulation kept its solution.
    """

    parameters: dict[str, dict[str, Parameters]]
    errors: dict[str, dict[str, dict[str, Float[Array, " 4"]]]]
    contact: Float[Array, ""]
    successful: Array


class RoadKeys(NamedTuple):
    """Independent keys of one road: its white noise, the windows drawn, and the Robson road."""

    training: Key[Array, ""]
    windows: Key[Array, ""]
    validation: Key[Array, ""]


def road_keys(key: Key[Array, ""]) -> RoadKeys:
    """What is random on one road."""
    return RoadKeys(*jax.random.split(key, 3))


def training_noise(key: Key[Array, ""]) -> Float[Array, " n"]:
    """Road velocity of Table 2 in m/s."""
    return band_limited_noise(
        key,
        TABLE_2.sample_count,
        1 / TABLE_2.rate,
        bandwidth=TABLE_2.bandwidth,
        rms=TABLE_2.rms,
    )


def validation_inputs(key: Key[Array, ""], shapes: Reconstruction) -> dict[str, Array]:
    """Road velocities of Section 5 in m/s: a Robson `road` and the `pothole`."""
    road = robson_road(
        key, TABLE_2.sample_count, 1 / TABLE_2.rate, roughness=jnp.asarray(shapes.roughness)
    )
    return dict(zip(INPUTS, (road, pothole_velocity(shapes.pothole))))


def pothole_velocity(hole: Pothole) -> Float[Array, " n"]:
    """Road velocity of a pot-hole in m/s, at Table 2's rate."""
    return pothole(
        round(POTHOLE_DURATION * TABLE_2.rate),
        1 / TABLE_2.rate,
        depth=jnp.asarray(hole.depth),
        length=jnp.asarray(hole.length),
        ramp=jnp.asarray(hole.ramp),
    )


def identification_record(
    source: QuarterCarSource,
    key: Key[Array, ""],
    *,
    method: FixedStep | None = None,
) -> Simulation:
    """The source model on the white-noise road of Table 2."""
    return simulate(source, Record({"v_r": training_noise(key)}, 1 / TABLE_2.rate), method=method)


def paper_criteria() -> dict[str, AbstractCriterion]:
    """RIEC with the windows of Table 2, and DOLS."""
    windows = RandomWindows(TABLE_2.alpha, TABLE_2.beta, TABLE_2.windows, between_samples=True)
    return {"RIEC": RIEC(windows), "DOLS": DOLS()}


def identify_variants(
    record: Record, criterion: AbstractCriterion, key: Key[Array, ""]
) -> dict[str, Parameters]:
    """All four variants from one set of normal equations: only what is known differs."""
    equations = (tyre_equation(), mass_equation(), wheel_equation(), body_equation())
    tyre, masses, wheel, body = stage_normal_equations(
        Procedure(tuple((equation,) for equation in equations)), record, criterion, key
    )
    variants = {}
    for variant in VARIANTS:
        known = TRUE_MASSES if variant.endswith("true") else {}
        known = {name: jnp.asarray(value) for name, value in known.items()}
        last = wheel if variant.startswith("W") else body
        values = found_values(solve_stages([tyre, masses, last], known), known)
        variants[variant] = {name: values[name] for name in PARAMETERS}
    return variants


def run_road(
    key: Key[Array, ""],
    source: QuarterCarSource,
    shapes: Reconstruction,
    *,
    method: FixedStep | None = None,
) -> RoadResult:
    """Simulate, identify and validate on one random road; vmap over keys for many."""
    keys = road_keys(key)
    training = identification_record(source, keys.training, method=method)
    parameters = {
        name: identify_variants(training.record, criterion, keys.windows)
        for name, criterion in paper_criteria().items()
    }
    models = stack_models(parameters)
    errors, successful = {}, training.successful
    for name, velocity in validation_inputs(keys.validation, shapes).items():
        truth = simulate(source, Record({"v_r": velocity}, 1 / TABLE_2.rate), method=method)
        table, kept = validation_errors(models, truth.record, method)
        errors[name] = {
            criterion: {variant: table[i, j] for j, variant in enumerate(VARIANTS)}
            for i, criterion in enumerate(CRITERIA)
        }
        successful = successful & truth.successful & kept
    contact = contact_share(training.record["x1"], source)
    return RoadResult(parameters, errors, contact, successful)


def stack_models(
    parameters: dict[str, dict[str, Parameters]],
    criteria: Sequence[str] = CRITERIA,
    variants: Sequence[str] = VARIANTS,
) -> Parameters:
    """Every parameter as an array over criteria and variants, its last two axes."""
    return {
        name: jnp.stack(
            [jnp.stack([parameters[c][v][name] for v in variants], axis=-1) for c in criteria],
            axis=-2,
        )
        for name in PARAMETERS
    }


def validation_errors(
    models: Parameters, truth: Record, method: FixedStep | None = None
) -> tuple[Float[Array, "criteria variants 4"], Array]:
    """p_i of x1 to x4 in percent of each model, and whether all kept their solution."""
    errors, successful = jax.vmap(jax.vmap(lambda m: prediction_errors(m, truth, method)))(models)
    return errors, jnp.all(successful)


def prediction_errors(
    model: Parameters, truth: Record, method: FixedStep | None = None
) -> tuple[Float[Array, " 4"], Array]:
    """p_i of x1 to x4 in percent of one model, and whether it kept its solution."""
    run = simulate(QuarterCar.from_parameters(model), truth.select("v_r"), method=method)
    errors = [percentage_error(run.record[s], truth[s]) for s in VALIDATED_STATES]
    return jnp.stack(errors), run.successful

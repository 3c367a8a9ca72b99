"""Sections 4 and 5 of the paper on simulated roads: Tables 3 to 5, Figs 9 and 10, alpha, beta."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from riecjax import (
    DOLS,
    RIEC,
    AllWindows,
    Boxcar,
    FixedStep,
    RandomWindows,
    Record,
    find_model,
    simulate,
    staged,
)
from riecjax.estimation import solve
from riecjax.models.quarter_car.identification import (
    QuarterCar,
    body_equation,
    mass_equation,
    quarter_car_by_body,
    tyre_equation,
    wheel_equation,
)
from riecjax.models.quarter_car.reconstruction import Pothole, Reconstruction
from riecjax.models.quarter_car.source import QuarterCarSource, contact_share
from riecjax.paper.published import CRITERIA, TABLE_2, VARIANTS
from riecjax.simulation import Simulation, band_limited_noise, pothole, robson_road
from riecjax.studies import over_keys
from riecjax.summaries import NormalEquations, stage_normal_equations
from riecjax.validation import percentage_error

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
        key, TABLE_2.sample_count, 1 / TABLE_2.rate, bandwidth=TABLE_2.bandwidth, rms=TABLE_2.rms
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
    source: QuarterCarSource, key: Key[Array, ""], *, method: FixedStep | None = None
) -> Simulation:
    """The source model on the white-noise road of Table 2."""
    return simulate(source, Record({"v_r": training_noise(key)}, 1 / TABLE_2.rate), method=method)


def paper_criteria() -> dict[str, RIEC | DOLS]:
    """RIEC with the windows of Table 2, and DOLS."""
    windows = RandomWindows(TABLE_2.alpha, TABLE_2.beta, TABLE_2.windows, between_samples=True)
    return {"RIEC": RIEC(windows), "DOLS": DOLS()}


def identify_variants(
    record: Record, criterion: RIEC | DOLS, key: Key[Array, ""]
) -> dict[str, Parameters]:
    """All four variants from one set of normal equations: only what is known differs."""
    procedure = staged(tyre_equation(), mass_equation(), wheel_equation(), body_equation())
    tyre, masses, wheel, body = stage_normal_equations(procedure, record, criterion, key)
    variants = {}
    for variant in VARIANTS:
        known = TRUE_MASSES if variant.endswith("true") else {}
        known = {name: jnp.asarray(value) for name, value in known.items()}
        last = wheel if variant.startswith("W") else body
        values = _solved_in_turn([tyre, masses, last], known)
        variants[variant] = {name: values[name] for name in PARAMETERS}
    return variants


def by_body(
    record: Record, criterion: RIEC | DOLS, key: Key[Array, ""] | None = None
) -> Float[Array, " parameters"]:
    """The variant B_id by one criterion, in the order of `PARAMETERS`."""
    stages = stage_normal_equations(quarter_car_by_body(), record, criterion, key)
    values = _solved_in_turn(stages, {})
    return jnp.stack([values[name] for name in PARAMETERS])


def _solved_in_turn(stages: Sequence[NormalEquations], known: Mapping[str, Array]) -> Parameters:
    """The paper's procedure: each stage takes as known what those before it found."""
    values = dict(known)
    for stage in stages:
        equations = stage.total().fix(values)
        if equations.parameters:
            values |= dict(zip(equations.parameters, solve(equations).theta))
    return values


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
        table, finite = validation_errors(models, truth.record, method)
        errors[name] = {
            criterion: {variant: table[i, j] for j, variant in enumerate(VARIANTS)}
            for i, criterion in enumerate(CRITERIA)
        }
        successful = successful & truth.successful & finite
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


class Trajectories(eqx.Module):
    """Motion on one input, and what models identified on many roads predict of it.

    Figures 9 and 10 show one model each; many on one motion show how far they scatter.

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
    models = stack_models(roads.parameters, CRITERIA, ("B_id",))
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


LENGTHS = (0.01, 0.02, 0.035, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0)
"""Of windows in seconds, for alpha and for beta; in whole samples of 5 ms."""


class LengthMap(eqx.Module):
    """Parameters over pairs of window lengths in seconds, on several roads (Section 4).

    All windows of each pair at once, so that no sampling noise blurs the map.
    """

    alpha: Float[Array, " pairs"]
    beta: Float[Array, " pairs"]
    theta: Float[Array, "roads pairs parameters"]

    @property
    def of_table_2(self) -> int:
        """Place of the pair that Table 2 has."""
        alpha, beta = np.asarray(self.alpha), np.asarray(self.beta)
        return int(np.argmin(np.abs(alpha - TABLE_2.alpha) + np.abs(beta - TABLE_2.beta)))


def length_map(key: Key[Array, ""], source: QuarterCarSource, roads: int) -> LengthMap:
    """All pairs of `LENGTHS`, and each length almost alone: with one a sample longer."""
    step = 1 / TABLE_2.rate
    pairs = [(a, b) for a in LENGTHS for b in LENGTHS if a < b] + [(a, a + step) for a in LENGTHS]
    alpha, beta = (jnp.array(side) for side in zip(*pairs))
    theta = over_keys(estimates_over_lengths, key, roads, source, alpha, beta)
    return LengthMap(alpha, beta, theta)


def estimates_over_lengths(
    key: Key[Array, ""],
    source: QuarterCarSource,
    alpha: Float[Array, " pairs"],
    beta: Float[Array, " pairs"],
) -> Float[Array, "pairs parameters"]:
    """Parameters in the order of `PARAMETERS` on one random road; vmap over keys for many."""
    record = identification_record(source, road_keys(key).training).record
    longest = round(max(LENGTHS) * TABLE_2.rate) + 1

    def estimate(pair: tuple[Array, Array]) -> Float[Array, " parameters"]:
        return by_body(record, RIEC(AllWindows(*pair, longest_samples=longest), Boxcar(2)))

    return jax.lax.map(estimate, (alpha, beta))


SECOND_MASS = 1.0
TWO_MASS = {"m1": 10.0, "m2": SECOND_MASS, "omega_n": 100.0, "zeta": 0.5}
"""Published, in kg, rad/s and 1."""
DURATION, RATE = 20.0, 1000.0
"""s and Hz; the text gives neither. The rate is 60 times the natural frequency."""


class Demonstration(eqx.Module):
    """One realisation of Fig. 2, or many along a leading axis.

    **Fields:** `noise` white and of the same r.m.s. as `error`, the equation error, both in N;
    `noise_integral` and `error_integral` in N s; `bound`, 2 m2 v_max in N s.
    """

    noise: Float[Array, " n"]
    error: Float[Array, " n"]
    noise_integral: Float[Array, " n"]
    error_integral: Float[Array, " n"]
    bound: Float[Array, ""]


def demonstrate(key: Key[Array, ""]) -> Demonstration:
    """Drive the two masses by a white Gaussian force, and integrate; vmap over keys for many."""
    force_key, noise_key = jax.random.split(key)
    count = round(DURATION * RATE)
    masses = find_model("two-mass").build_system(TWO_MASS)
    force = jax.random.normal(force_key, (count,))
    run = simulate(masses, Record({"F": force}, 1 / RATE), method=FixedStep(1)).record
    error = run["error"]
    # A force of 1 N r.m.s. is as good as any: the model is linear.
    size = jnp.sqrt(jnp.mean(error**2))
    noise = jax.random.normal(noise_key, (count,))
    noise = noise * size / jnp.sqrt(jnp.mean(noise**2))
    largest = jnp.maximum(jnp.max(jnp.abs(run["dz"])), jnp.max(jnp.abs(run["dz"] + run["dd"])))
    return Demonstration(noise, error, _running(noise), _running(error), 2 * SECOND_MASS * largest)


def _running(values: Float[Array, " n"]) -> Float[Array, " n"]:
    """Integral from the start to each sample, by trapezoids."""
    steps = 0.5 * (values[1:] + values[:-1]) / RATE
    return jnp.concatenate([jnp.zeros(1), jnp.cumsum(steps)])


STRETCHES = 8


class WindowErrorMoments(eqx.Module):
    """Of one road, or of many along a leading axis.

    **Fields:** `by_start`, mean square error of the windows that start in each eighth of the
    record; `correlation`, the mean product of the errors of two different windows over their mean
    square, which is epsilon of eq. (18).
    """

    by_start: Float[Array, " stretches"]
    correlation: Float[Array, ""]


def window_error_moments(
    key: Key[Array, ""], roads: RoadResult, source: QuarterCarSource
) -> WindowErrorMoments:
    """Errors of the body's equation with what was identified of it (RIEC, variant B_id).

    **Arguments:** `roads`, as many as wanted, of a study that was made with `key`.
    """
    # The keys of [`over_keys`][], of which these roads were made.
    number = jnp.arange(roads.contact.shape[0], dtype=jnp.uint32)
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(number)
    return _over_roads(keys, roads.parameters["RIEC"]["B_id"], source)


@eqx.filter_jit
def _over_roads(
    keys: Key[Array, " roads"], found: Parameters, source: QuarterCarSource
) -> WindowErrorMoments:
    return jax.lax.map(lambda each: _moments(each[0], each[1], source), (keys, found))


def _moments(
    key: Key[Array, ""], found: Parameters, source: QuarterCarSource
) -> WindowErrorMoments:
    keys = road_keys(key)
    record = identification_record(source, keys.training).record
    rows = paper_criteria()["RIEC"].rows(body_equation(), record, keys.windows)
    theta = jnp.stack([found[name] for name in rows.parameters])
    error = rows.columns[0] - theta @ rows.columns[1:]
    count = error.shape[0]
    stretch = jnp.floor(rows.position * STRETCHES / record.sample_count).astype(int)
    inside = stretch[None, :] == jnp.arange(STRETCHES)[:, None]
    square = jnp.sum(jnp.where(inside, error[None, :] ** 2, 0.0), axis=1)
    number = jnp.sum(inside, axis=1)
    mean_square = jnp.mean(error**2)
    products = (jnp.sum(error) ** 2 - jnp.sum(error**2)) / (count * (count - 1))
    return WindowErrorMoments(square / jnp.maximum(number, 1), products / mean_square)

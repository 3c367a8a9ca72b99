"""Sections 2, 4 and 5 of the paper on simulated roads: Tables 3 to 5, Figs 2, 9 and 10.

Parameters of identified models are arrays whose last axis is in the order of [`PARAMETERS`][].
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

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
from riecjax.models.quarter_car import (
    Pothole,
    QuarterCarSource,
    Reconstruction,
    body_equation,
    mass_equation,
    quarter_car_by_body,
    tyre_equation,
    wheel_equation,
)
from riecjax.models.quarter_car.identification import quarter_car_system
from riecjax.paper.published import CRITERIA, INPUTS, TABLE_2, VARIANTS
from riecjax.simulation import AbstractSystem, Simulation, band_limited_noise, pothole, robson_road
from riecjax.summaries import NormalEquations, stage_normal_equations
from riecjax.validation import percentage_error

TRUE_MASSES = {"M_us": 30.0, "M_s": 300.0}
VALIDATED_STATES = ("x1", "x2", "x3", "x4")
POTHOLE_DURATION = 3.0
"""Seconds of the pot-hole's validation, enough for the body to come to rest."""
FORCES = ("F_1", "F_2", "F_3", "F_4")
PARAMETERS: tuple[str, ...] = ("K_t", "M_us", "M_s", "K_s", *FORCES)
STEP = 1 / TABLE_2.rate
"""Seconds from sample to sample."""


class RoadResult(eqx.Module):
    """One road, or many along a leading axis: all that Tables 3 to 5 print, and the damper maps.

    **Fields:**

    - `parameters` by each criterion, of each variant.
    - `errors`: p_i of x1 to x4 in percent, on each of `INPUTS`.
    - `contact`: share of the identification record in which the tyre touches the road.
    - `successful`: whether every simulation kept its solution.
    """

    parameters: Float[Array, "criteria variants parameters"]
    errors: Float[Array, "criteria variants inputs 4"]
    contact: Float[Array, ""]
    successful: Bool[Array, ""]

    def identified(self, variant: str, name: str) -> Float[np.ndarray, "*roads criteria"]:
        """Values of a parameter."""
        place = VARIANTS.index(variant), PARAMETERS.index(name)
        return np.asarray(self.parameters)[..., *place]

    def summed_error(self, variant: str, where: str) -> Float[np.ndarray, "*roads criteria"]:
        """p_1 + ... + p_4 in percent."""
        place = VARIANTS.index(variant), INPUTS.index(where)
        return np.asarray(self.errors)[..., *place, :].sum(axis=-1)


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
    bandwidth, rms = TABLE_2.bandwidth, TABLE_2.rms
    return band_limited_noise(key, TABLE_2.sample_count, STEP, bandwidth=bandwidth, rms=rms)


def validation_inputs(key: Key[Array, ""], shapes: Reconstruction) -> dict[str, Array]:
    """Road velocities of Section 5 in m/s: a Robson `road` and the `pothole`."""
    roughness = jnp.asarray(shapes.roughness)
    road = robson_road(key, TABLE_2.sample_count, STEP, roughness=roughness)
    return dict(zip(INPUTS, (road, pothole_velocity(shapes.pothole))))


def pothole_velocity(hole: Pothole) -> Float[Array, " n"]:
    """Road velocity of a pot-hole in m/s, at Table 2's rate."""
    depth, length, ramp = (jnp.asarray(leaf) for leaf in (hole.depth, hole.length, hole.ramp))
    count = round(POTHOLE_DURATION * TABLE_2.rate)
    return pothole(count, STEP, depth=depth, length=length, ramp=ramp)


def identification_record(
    source: QuarterCarSource, key: Key[Array, ""], *, method: FixedStep | None = None
) -> Simulation:
    """The source model on the white-noise road of Table 2."""
    return simulate(source, Record({"v_r": training_noise(key)}, STEP), method=method)


def paper_criteria() -> dict[str, RIEC | DOLS]:
    """RIEC with the windows of Table 2, and DOLS."""
    windows = RandomWindows(TABLE_2.alpha, TABLE_2.beta, TABLE_2.windows, between_samples=True)
    return {"RIEC": RIEC(windows), "DOLS": DOLS()}


def identify_variants(
    record: Record, criterion: RIEC | DOLS, key: Key[Array, ""]
) -> Float[Array, "variants parameters"]:
    """All four variants from one set of normal equations: only what is known differs."""
    model = staged(tyre_equation(), mass_equation(), wheel_equation(), body_equation())
    tyre, masses, wheel, body = stage_normal_equations(model, record, criterion, key)
    last, known = {"W": wheel, "B": body}, {"true": TRUE_MASSES, "id": {}}
    variants = (variant.split("_") for variant in VARIANTS)
    return jnp.stack([_solved_in_turn([tyre, masses, last[w]], known[m]) for w, m in variants])


def by_body(
    record: Record, criterion: RIEC | DOLS, key: Key[Array, ""] | None = None
) -> Float[Array, " parameters"]:
    """The variant B_id by one criterion."""
    stages = stage_normal_equations(quarter_car_by_body(), record, criterion, key)
    return _solved_in_turn(stages, {})


def _solved_in_turn(
    stages: list[NormalEquations], known: dict[str, float]
) -> Float[Array, " parameters"]:
    """The paper's stages: each stage takes as known what those before it found."""
    values = {name: jnp.asarray(value) for name, value in known.items()}
    for stage in stages:
        equations = stage.total().fix(values)
        if equations.parameters:
            values |= dict(zip(equations.parameters, solve(equations).theta))
    return jnp.stack([values[name] for name in PARAMETERS])


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
    criteria = paper_criteria().values()
    parameters = jnp.stack([identify_variants(training.record, c, keys.windows) for c in criteria])
    inputs = validation_inputs(keys.validation, shapes)
    errors, predicted = validation_errors(parameters, source, inputs, method)
    lift_off = source.lift_off_force / source.tyre_stiffness
    extension = training.record["x1"]
    contact = jnp.mean(extension <= lift_off, axis=-1, dtype=extension.dtype)
    return RoadResult(parameters, errors, contact, training.successful & jnp.all(predicted))


def validation_errors(
    models: Float[Array, "*models parameters"],
    source: QuarterCarSource,
    inputs: dict[str, Array],
    method: FixedStep | None = None,
) -> tuple[Float[Array, "*models inputs 4"], Bool[Array, "*models"]]:
    """p_i of x1 to x4 in percent on each input, and whether all simulations of a model held."""
    errors, successful = [], []
    for velocity in inputs.values():
        road = Record({"v_r": velocity}, STEP)
        truth = simulate(source, road, method=method)

        def error(model: Array, road: Record = road, truth: Simulation = truth) -> tuple:
            run = simulate(quarter_car_system(_named(model)), road, method=method)
            by_state = [percentage_error(run.record[s], truth.record[s]) for s in VALIDATED_STATES]
            return jnp.stack(by_state), run.successful & truth.successful

        percent, kept = jnp.vectorize(error, signature="(p)->(s),()")(models)
        errors.append(percent)
        successful.append(kept)
    return jnp.stack(errors, axis=-2), jnp.all(jnp.stack(successful), axis=0)


def _named(parameters: Float[Array, " parameters"]) -> dict[str, Float[Array, ""]]:
    return {name: parameters[i] for i, name in enumerate(PARAMETERS)}


class Trajectories(eqx.Module):
    """Motion on one input, and what models identified on many roads predict of it.

    Figures 9 and 10 show one model each; many on one motion show how far they scatter.

    **Fields:** `time` in s; `source`, x1 to x4; `predicted` by each criterion.
    """

    time: Float[Array, " n"]
    source: Float[Array, "n 4"]
    predicted: Float[Array, "roads criteria n 4"]


@eqx.filter_jit
def validation_trajectories(
    roads: RoadResult, key: Key[Array, ""], source: QuarterCarSource, shapes: Reconstruction
) -> dict[str, Trajectories]:
    """Of the variant B_id on the `road` that belongs to `key`, and on the `pothole`."""

    def motion(system: AbstractSystem, road: Record) -> Float[Array, "n 4"]:
        record = simulate(system, road).record
        return jnp.stack([record[name] for name in VALIDATED_STATES], axis=-1)

    trajectories = {}
    for where, velocity in validation_inputs(road_keys(key).validation, shapes).items():
        road = Record({"v_r": velocity}, STEP)
        predict = jax.vmap(
            jax.vmap(lambda model, road=road: motion(quarter_car_system(_named(model)), road))
        )
        predicted = predict(roads.parameters[:, :, VARIANTS.index("B_id")])
        trajectories[where] = Trajectories(road.time, motion(source, road), predicted)
    return trajectories


RAMPS = (0.3, 0.6, 0.9, 1.2, 1.5, 1.8)
"""Metres over which the road falls into the hole; the reconstruction's is 1.29 m."""


@eqx.filter_jit
def errors_over_ramps(
    roads: RoadResult, source: QuarterCarSource, shapes: Reconstruction
) -> Float[Array, "ramps roads criteria variants 4"]:
    """p_i of x1 to x4 in percent, on pot-holes of the same depth and length with these ramps."""

    def on(ramp: Array) -> Array:
        hole = Pothole(shapes.pothole.depth, shapes.pothole.length, ramp)
        inputs = {"pothole": pothole_velocity(hole)}
        return validation_errors(roads.parameters, source, inputs)[0][..., 0, :]

    return jax.lax.map(on, jnp.array(RAMPS))


LENGTHS = (0.01, 0.02, 0.035, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0)
"""Of windows in seconds, for alpha and for beta; in whole samples of 5 ms."""


PAIRS = np.array(
    [(a, b) for a in LENGTHS for b in LENGTHS if a < b] + [(a, a + STEP) for a in LENGTHS]
)
"""alpha and beta in seconds: of all lengths, and each length almost alone, with one a sample longer
(Section 4)."""
OF_TABLE_2 = int(np.argmin(np.abs(PAIRS - (TABLE_2.alpha, TABLE_2.beta)).sum(axis=1)))
"""Place of the pair that Table 2 has."""


def estimates_over_lengths(
    key: Key[Array, ""], source: QuarterCarSource, pairs: Float[Array, "pairs 2"]
) -> Float[Array, "pairs parameters"]:
    """Parameters by each pair of window lengths, on one random road; vmap over keys for many.

    All windows of each pair at once, so that no sampling noise blurs the map.
    """
    record = identification_record(source, road_keys(key).training).record
    longest = round(max(LENGTHS) * TABLE_2.rate) + 1

    def estimate(pair: Float[Array, " 2"]) -> Float[Array, " parameters"]:
        windows = AllWindows(pair[0], pair[1], longest_samples=longest)
        return by_body(record, RIEC(windows, Boxcar(2)))

    return jax.lax.map(estimate, pairs)


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

    def integral(values: Float[Array, " n"]) -> Float[Array, " n"]:
        """From the start to each sample, by trapezoids."""
        steps = 0.5 * (values[1:] + values[:-1]) / RATE
        return jnp.concatenate([jnp.zeros(1), jnp.cumsum(steps)])

    return Demonstration(noise, error, integral(noise), integral(error), 2 * SECOND_MASS * largest)


STRETCHES = 8


class WindowErrorMoments(eqx.Module):
    """Of one road, or of many along a leading axis.

    **Fields:** `by_start`, mean square error of the windows that start in each eighth of the
    record; `correlation`, the mean product of the errors of two different windows over their mean
    square, which is epsilon of eq. (18).
    """

    by_start: Float[Array, " stretches"]
    correlation: Float[Array, ""]


@eqx.filter_jit
def window_error_moments(
    key: Key[Array, ""], roads: RoadResult, source: QuarterCarSource
) -> WindowErrorMoments:
    """Errors of the body's equation with what was identified of it (RIEC, variant B_id).

    **Arguments:** `roads`, as many as wanted, of a study that was made with `key`.
    """

    def moments(road: tuple[Key[Array, ""], Float[Array, " parameters"]]) -> WindowErrorMoments:
        keys, parameters = road_keys(road[0]), _named(road[1])
        record = identification_record(source, keys.training).record
        rows = paper_criteria()["RIEC"].rows(body_equation(), record, keys.windows)
        theta = jnp.stack([parameters[name] for name in rows.parameters])
        error = rows.columns[0] - theta @ rows.columns[1:]
        count = error.shape[0]
        stretch = jnp.floor(rows.position * STRETCHES / record.sample_count).astype(int)
        inside = stretch[None, :] == jnp.arange(STRETCHES)[:, None]
        square = jnp.sum(jnp.where(inside, error[None, :] ** 2, 0.0), axis=1)
        mean_square = jnp.mean(error**2)
        products = (jnp.sum(error) ** 2 - jnp.sum(error**2)) / (count * (count - 1))
        by_start = square / jnp.maximum(jnp.sum(inside, axis=1), 1)
        return WindowErrorMoments(by_start, products / mean_square)

    # The keys of [`over_keys`][], of which these roads were made.
    number = jnp.arange(roads.contact.shape[0], dtype=jnp.uint32)
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(number)
    models = roads.parameters[:, CRITERIA.index("RIEC"), VARIANTS.index("B_id")]
    return jax.lax.map(moments, (keys, models))

"""The paper's study on simulated roads: Sections 2, 4, 5 and 6, and all of them together.

Parameters of identified models are arrays whose last axis is in the order of [`PARAMETERS`][].
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

import riecjax as rx
from riecjax.estimation import solve_stages
from riecjax.models.quarter_car import (
    Pothole,
    QuarterCarSource,
    Reconstruction,
    body_equation,
    mass_equation,
    quarter_car_by_body,
    quarter_car_source,
    quarter_car_system,
    tyre_equation,
    wheel_equation,
)
from riecjax.paper.published import CRITERIA, INPUTS, TABLE_2, TABLE_6, VARIANTS, MountVariant
from riecjax.simulation import (
    AbstractSystem,
    Simulation,
    band_limited_noise,
    low_passed,
    pothole,
    robson_road,
)
from riecjax.studies import over_keys
from riecjax.summaries import NormalEquations, stage_normal_equations
from riecjax.validation import percentage_error

TRUE_MASSES = {"M_us": 30.0, "M_s": 300.0}
TRUE = {**TRUE_MASSES, "K_t": 180e3, "K_s": 20e3}
"""Of the source, where the identified model has the same: masses, and stiffnesses that it has for
small motion."""
VALIDATED_STATES = ("x1", "x2", "x3", "x4")
POTHOLE_DURATION = 3.0
"""Seconds of the pot-hole's validation, enough for the body to come to rest."""
FORCES = ("F_1", "F_2", "F_3", "F_4")
UNITS = {"K_t": "N/m", "M_us": "kg", "M_s": "kg", "K_s": "N/m"} | dict.fromkeys(FORCES, "N")
PARAMETERS = tuple(UNITS)
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
    count = round(POTHOLE_DURATION * TABLE_2.rate)
    return pothole(count, STEP, **vars(jax.tree.map(jnp.asarray, hole)))


def identification_record(
    source: QuarterCarSource, key: Key[Array, ""], *, method: rx.FixedStep | None = None
) -> Simulation:
    """The source model on the white-noise road of Table 2."""
    return rx.simulate(source, rx.Record({"v_r": training_noise(key)}, STEP), method=method)


def paper_criteria() -> dict[str, rx.RIEC | rx.DOLS]:
    """RIEC with the windows of Table 2, and DOLS."""
    windows = rx.RandomWindows(TABLE_2.alpha, TABLE_2.beta, TABLE_2.windows, between_samples=True)
    return {"RIEC": rx.RIEC(windows), "DOLS": rx.DOLS()}


def identify_variants(
    record: rx.Record, criterion: rx.RIEC | rx.DOLS, key: Key[Array, ""]
) -> Float[Array, "variants parameters"]:
    """All four variants from one set of normal equations: only what is known differs."""
    model = rx.staged(tyre_equation(), mass_equation(), wheel_equation(), body_equation())
    tyre, masses, wheel, body = stage_normal_equations(model, record, criterion, key)
    last, known = {"W": wheel, "B": body}, {"true": TRUE_MASSES, "id": {}}
    variants = (variant.split("_") for variant in VARIANTS)
    return jnp.stack([_solved_in_turn([tyre, masses, last[w]], known[m]) for w, m in variants])


def by_body(
    record: rx.Record, criterion: rx.RIEC | rx.DOLS, key: Key[Array, ""] | None = None
) -> Float[Array, " parameters"]:
    """The variant B_id by one criterion."""
    stages = stage_normal_equations(quarter_car_by_body(), record, criterion, key)
    return _solved_in_turn(stages, {})


def _solved_in_turn(
    stages: list[NormalEquations], known: dict[str, float]
) -> Float[Array, " parameters"]:
    """The paper's stages: each stage takes as known what those before it found."""
    _, values = solve_stages(stages, {name: jnp.asarray(value) for name, value in known.items()})
    return jnp.stack([values[name] for name in PARAMETERS])


def run_road(
    key: Key[Array, ""],
    source: QuarterCarSource,
    shapes: Reconstruction,
    *,
    method: rx.FixedStep | None = None,
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


def motion(
    system: AbstractSystem, velocity: Float[Array, " n"], method: rx.FixedStep | None = None
) -> tuple[Float[Array, "4 n"], Bool[Array, ""]]:
    """x1 to x4 on a road, and whether the simulation kept its solution."""
    run = rx.simulate(system, rx.Record({"v_r": velocity}, STEP), method=method)
    return jnp.stack([run.record[name] for name in VALIDATED_STATES]), run.successful


def predictions(
    models: Float[Array, "*models parameters"],
    velocity: Float[Array, " n"],
    method: rx.FixedStep | None = None,
) -> tuple[Float[Array, "*models 4 n"], Bool[Array, "*models"]]:
    """The [`motion`][] of identified models."""

    def predicted(model: Float[Array, " parameters"]) -> tuple[Array, Array]:
        return motion(quarter_car_system(dict(zip(PARAMETERS, model))), velocity, method)

    return jnp.vectorize(predicted, signature="(p)->(s,n),()")(models)


def validation_errors(
    models: Float[Array, "*models parameters"],
    source: QuarterCarSource,
    inputs: dict[str, Array],
    method: rx.FixedStep | None = None,
) -> tuple[Float[Array, "*models inputs 4"], Bool[Array, "*models"]]:
    """p_i of x1 to x4 in percent on each input, and whether all simulations of a model held."""
    errors, successful = [], []
    for velocity in inputs.values():
        truth, held = motion(source, velocity, method)
        predicted, kept = predictions(models, velocity, method)
        errors.append(percentage_error(predicted, jnp.broadcast_to(truth, predicted.shape)))
        successful.append(kept & held)
    return jnp.stack(errors, axis=-2), jnp.all(jnp.stack(successful), axis=0)


class Trajectories(eqx.Module):
    """Motion on one input, and what models identified on many roads predict of it.

    Figures 9 and 10 show one model each; many on one motion show how far they scatter.

    **Fields:** `source`, x1 to x4; `predicted` by each criterion.
    """

    source: Float[Array, "4 n"]
    predicted: Float[Array, "roads criteria 4 n"]


@eqx.filter_jit
def validation_trajectories(
    roads: RoadResult, key: Key[Array, ""], source: QuarterCarSource, shapes: Reconstruction
) -> dict[str, Trajectories]:
    """Of the variant B_id on the `road` that belongs to `key`, and on the `pothole`."""
    models = roads.parameters[:, :, VARIANTS.index("B_id")]
    inputs = validation_inputs(road_keys(key).validation, shapes)
    return {
        where: Trajectories(motion(source, velocity)[0], predictions(models, velocity)[0])
        for where, velocity in inputs.items()
    }


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
        windows = rx.AllWindows(pair[0], pair[1], longest_samples=longest)
        return by_body(record, rx.RIEC(windows, rx.Boxcar(2)))

    return jax.lax.map(estimate, pairs)


SECOND_MASS = 1.0
"""kg, published, as all of the model's own values."""
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
    masses = rx.find_model("two-mass").build_system({})
    force = jax.random.normal(force_key, (count,))
    run = rx.simulate(masses, rx.Record({"F": force}, 1 / RATE), method=rx.FixedStep(1)).record
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
        keys, parameters = road_keys(road[0]), dict(zip(PARAMETERS, road[1]))
        record = identification_record(source, keys.training).record
        rows = paper_criteria()["RIEC"].rows(body_equation(), record, keys.windows)
        theta = jnp.stack([parameters[name] for name in rows.parameters])
        error = rows.columns[0] - theta @ rows.columns[1:]
        count = error.shape[0]
        stretch = jnp.floor(rows.position * STRETCHES / record.sample_count).astype(int)
        inside = stretch[None, :] == jnp.arange(STRETCHES)[:, None]
        square = jnp.sum(jnp.where(inside, error[None, :] ** 2, 0.0), axis=1)
        products = (jnp.sum(error) ** 2 - jnp.sum(error**2)) / (count * (count - 1))
        by_start = square / jnp.maximum(jnp.sum(inside, axis=1), 1)
        return WindowErrorMoments(by_start, products / jnp.mean(error**2))

    # The keys of [`over_keys`][], of which these roads were made.
    number = jnp.arange(roads.contact.shape[0], dtype=jnp.uint32)
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(number)
    models = roads.parameters[:, CRITERIA.index("RIEC"), VARIANTS.index("B_id")]
    return jax.lax.map(moments, (keys, models))


# Section 6: input bandwidth, engine mounts and sampling seeds varied, over roads. On every road
# the white noise of Table 2 is cut off at each bandwidth, each of Table 6's source models is driven
# with it, and the variant B_id is identified by DOLS and by RIEC with several draws of windows. All
# of these models are validated on the two inputs of Section 5.

Values = Array | np.ndarray
ROADS_AT_ONCE = 4
"""Each at all bandwidths."""


class RoadVariations(NamedTuple):
    """Roads under one engine mount, at every bandwidth.

    `models` are DOLS, and RIEC with each draw of windows.

    **Fields:** `parameters`; `errors`, p_i of x1 to x4 in percent on each of `INPUTS`; whether all
    simulations behind a model were `successful`.
    """

    parameters: Float[Values, "roads bandwidths models parameters"]
    errors: Float[Values, "roads bandwidths models inputs 4"]
    successful: Bool[Values, "roads bandwidths models"]


def vary_road(
    key: Key[Array, ""],
    mount: MountVariant,
    bandwidths: Float[Array, " bandwidths"],
    shapes: Reconstruction,
    draws: int,
    *,
    method: rx.FixedStep | None = None,
) -> RoadVariations:
    """Simulate, identify and validate on one random road; vmap over keys for many.

    The road of a key is that of [`run_road`][]: at 30 Hz and with the pathological mount, its first
    draw gives the models of Tables 3 to 5.
    """
    source = quarter_car_source({"K_m": mount.stiffness, "B_m": mount.damping}, shapes)
    keys, criteria = road_keys(key), paper_criteria()
    noise = training_noise(keys.training)
    # Windows are drawn by the road's own key first.
    rest = jax.random.split(jax.random.fold_in(keys.windows, 1), draws - 1)
    drawn = jnp.stack([keys.windows, *(rest[i] for i in range(draws - 1))])

    def identified(bandwidth: Array) -> tuple[Array, Array]:
        driven = rx.Record({"v_r": low_passed(noise, STEP, bandwidth)}, STEP)
        training = rx.simulate(source, driven, method=method)
        by_riec = jax.vmap(lambda key: by_body(training.record, criteria["RIEC"], key))(drawn)
        by_dols = by_body(training.record, criteria["DOLS"])
        return jnp.concatenate([by_dols[None], by_riec]), training.successful

    parameters, trained = jax.vmap(identified)(bandwidths)
    inputs = validation_inputs(keys.validation, shapes)
    errors, predicted = validation_errors(parameters, source, inputs, method)
    return RoadVariations(parameters, errors, trained[:, None] & predicted)


MODELS = {"DOLS": slice(0, 1), "RIEC": slice(1, None)}


class VariedStudy(NamedTuple):
    """What was found in each case of Table 6, in NumPy's arrays, at `bandwidths` in Hz."""

    bandwidths: Float[np.ndarray, " bandwidths"]
    cases: dict[str, RoadVariations]

    def identified(
        self, case: str, method: str, *names: str
    ) -> Float[np.ndarray, "roads bandwidths names"]:
        """Parameters in SI units, mean over the draws of windows."""
        values = np.asarray(self.cases[case].parameters)[:, :, MODELS[method]].mean(axis=2)
        return values[..., [PARAMETERS.index(name) for name in names]]

    def summed_error(
        self, case: str, method: str, where: str
    ) -> Float[np.ndarray, "roads bandwidths"]:
        """p_1 + ... + p_4 in percent, mean over draws; infinite where a simulation was lost."""
        models = MODELS[method]
        errors = self.cases[case].errors[:, :, models, INPUTS.index(where)].sum(axis=-1)
        kept = self.cases[case].successful[:, :, models] & np.isfinite(errors)
        return np.where(kept, errors, np.inf).mean(axis=-1)


BANDWIDTHS = (6.0, 15.0, 30.0)
"""Hz of Fig. 13: low, from where DOLS drifts, and high."""
STIFFER = 4.0
"""Factor on K_c that makes the damper follow the suspension more closely."""
METHOD = rx.FixedStep(12)
"""A stiffer damper needs shorter steps: K_c over its least slope is 3500 per second."""


class Hysteresis(eqx.Module):
    """One road at each of `BANDWIDTHS`, with the source's own compliance and a stiffer one.

    **Fields:** `velocity` of the suspension in m/s and `force` of the damper in N, of the source's
    own compliance; `width`, r.m.s. of the force's distance from the damper's curve at this
    velocity, over its r.m.s.; `by_dols`, what DOLS identifies (variant B_id).
    """

    velocity: Float[Array, "bandwidths n"]
    force: Float[Array, "bandwidths n"]
    width: Float[Array, "compliances bandwidths"]
    by_dols: Float[Array, "compliances bandwidths parameters"]


def hysteresis(key: Key[Array, ""], source: QuarterCarSource) -> Hysteresis:
    """What the damper's compliance does to its force, and to identified damper maps (Fig. 13).

    On one random road; vmap over keys for many.
    """
    noise = training_noise(road_keys(key).training)

    def at(compliance: Array, bandwidth: Array) -> Hysteresis:
        model = eqx.tree_at(lambda s: s.damper_compliance, source, compliance)
        driven = rx.Record({"v_r": low_passed(noise, STEP, bandwidth)}, STEP)
        record = rx.simulate(model, driven, method=METHOD).record
        relative = record["x3"] - record["x4"]
        force = source.damper(record["x7"])
        off = force - source.damper(relative)
        width = jnp.sqrt(jnp.mean(off**2) / jnp.mean(force**2))
        return Hysteresis(relative, force, width, by_body(record, rx.DOLS()))

    compliances = jnp.asarray(source.damper_compliance) * jnp.array([1.0, STIFFER])
    over_bandwidths = jax.vmap(at, in_axes=(None, 0))
    both = jax.vmap(over_bandwidths, in_axes=(0, None))(compliances, jnp.array(BANDWIDTHS))
    return Hysteresis(both.velocity[0], both.force[0], both.width, both.by_dols)


# The whole study: all that the tables, figures and statements of the paper rest on.


class Scale(NamedTuple):
    """How large a study is.

    **Fields:** `roads` behind the tables; `studied`, roads behind everything else;
    `demonstrations` of Section 2; `bandwidths` in Hz; `draws` of windows on each record.
    """

    roads: int
    studied: int
    demonstrations: int
    bandwidths: tuple[float, ...]
    draws: int


LOW = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5)
"""Hz; here nothing reaches the outer break points of the damper."""
FULL = Scale(
    roads=200,
    studied=24,
    demonstrations=64,
    bandwidths=(*LOW, *(float(f) for f in (*range(4, 17), *range(18, 31, 2)))),
    draws=2,
)
QUICK = Scale(
    roads=8,
    studied=4,
    demonstrations=24,
    bandwidths=(0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0),
    draws=1,
)


class Further(NamedTuple):
    """What a whole study has beyond Tables 3 to 5.

    **Fields:** its `scale`; `variations` of Section 6; `demonstrations` of Section 2;
    `window_errors`, for eq. (18); the `damper`'s hysteresis; `lengths`, parameters over the `PAIRS`
    of alpha and beta; `trajectories` of Figs 9 and 10; `ramps`, errors on pot-holes of other
    shapes.
    """

    scale: Scale
    variations: VariedStudy
    demonstrations: Demonstration
    window_errors: WindowErrorMoments
    damper: Hysteresis
    lengths: Float[Array, "roads pairs parameters"]
    trajectories: dict[str, Trajectories]
    ramps: Float[Array, "ramps roads criteria variants 4"]


class PaperStudy(NamedTuple):
    """What was computed: `roads`, all of Tables 3 to 5, and what is `further` in a whole study."""

    roads: RoadResult
    further: Further | None = None

    @property
    def parts(self) -> dict[str, Any]:
        """All that statements may rest on, by name; `ramps` are there to compare with."""
        return {
            "roads": self.roads,
            "ramps": None,
            **(self.further._asdict() if self.further else {}),
        }

    @property
    def road_count(self) -> int:
        """Number of roads behind the tables."""
        return int(np.size(self.roads.contact))


def run_study(
    scale: Scale | int,
    key: Key[Array, ""],
    shapes: Reconstruction,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> PaperStudy:
    """Compute it, with the same roads in every part.

    **Arguments:**

    - `scale` of the whole study, or a number of roads for the tables alone.
    - `progress`: called with what is computed, and the numbers of steps done and in all.
    """
    source = quarter_car_source(shapes=shapes)

    def over(
        what: str, experiment: Callable[..., Any], count: int, *args: Any, chunk: int = 8
    ) -> Any:
        def told(done: int) -> None:
            progress(what, done, count)

        told(0)
        return over_keys(experiment, key, count, *args, chunk=chunk, progress=told)

    def once(what: str, compute: Callable[..., Any], *args: Any) -> Any:
        progress(what, 0, 1)
        return compute(*args)

    if isinstance(scale, int):
        return PaperStudy(over("roads", run_road, scale, source, shapes))
    # Arrays, so that all mounts share what is compiled.
    settled = jax.tree.map(jnp.asarray, (np.array(scale.bandwidths), shapes))
    cases = {
        case: over(
            f"bandwidths, {case} engine mount",
            vary_road,
            scale.studied,
            *(jax.tree.map(jnp.asarray, mount), *settled, scale.draws),
            chunk=ROADS_AT_ONCE,
        )
        for case, mount in TABLE_6.items()
    }
    variations = VariedStudy(np.array(scale.bandwidths), jax.tree.map(np.asarray, cases))
    roads = over("roads", run_road, scale.roads, source, shapes)
    few, pairs = jax.tree.map(lambda leaf: leaf[: scale.studied], roads), jnp.asarray(PAIRS)
    computed = (
        roads,
        over("demonstrations of Section 2", demonstrate, scale.demonstrations),
        once("errors of windows", window_error_moments, key, few, source),
        over("hysteresis of the damper", hysteresis, scale.studied, source),
        over("window lengths", estimates_over_lengths, scale.studied, source, pairs),
        once("trajectories", validation_trajectories, few, key, source, shapes),
        errors_over_ramps(few, source, shapes),
    )
    # NumPy's arrays: JAX would compile a slice for each number that a figure reads.
    roads, *others = jax.tree.map(np.asarray, computed)
    return PaperStudy(roads, Further(scale, variations, *others))

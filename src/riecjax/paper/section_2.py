"""Section 2 of the paper: a one-mass model (Fig. 2), and errors of random windows, eq. (18)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from riecjax import FixedStep, Record, find_model, simulate
from riecjax.models.quarter_car.identification import body_equation
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.reproduction import (
    Parameters,
    RoadResult,
    identification_record,
    paper_criteria,
    road_keys,
)

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

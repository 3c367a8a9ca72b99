"""Errors of the paper's random windows on the quarter car, for eq. (18)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from riecjax.models.quarter_car.equations import body_equation
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.reproduction import (
    Parameters,
    RoadResult,
    identification_record,
    paper_criteria,
    road_keys,
)
from riecjax.studies.monte_carlo import keys_of

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
    count = roads.contact.shape[0]
    found = roads.parameters["RIEC"]["B_id"]
    return _over_roads(keys_of(key, count), found, source)


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

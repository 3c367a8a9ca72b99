"""Errors of the paper's random windows on the quarter car, for eq. (18)."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from riecjax.estimation.assembly import stage_normal_equations
from riecjax.estimation.procedure import found_values, solve_stages
from riecjax.models.quarter_car.equations import body_equation, quarter_car_by_body
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.reproduction import identification_record, paper_criteria, road_keys

STRETCHES = 8


class WindowErrorMoments(eqx.Module):
    """Of one road, or of many along a leading axis.

    **Fields:** `by_start`, mean square error of the windows that start in each eighth of the
    record; `correlation`, the mean product of the errors of two different windows over their mean
    square, which is epsilon of eq. (18).
    """

    by_start: Float[Array, " stretches"]
    correlation: Float[Array, ""]


def window_error_moments(key: Key[Array, ""], source: QuarterCarSource) -> WindowErrorMoments:
    """Errors of the body's equation, with what is identified on the same road (variant B_id)."""
    keys = road_keys(key)
    record = identification_record(source, keys.training).record
    criterion = paper_criteria()["RIEC"]
    stages = stage_normal_equations(quarter_car_by_body(), record, criterion, keys.windows)
    values = found_values(solve_stages(stages, {}), {})
    rows = criterion.rows(body_equation(), record, keys.windows)
    theta = jnp.stack([values[name] for name in rows.parameters])
    error = rows.columns[0] - theta @ rows.columns[1:]
    count = error.shape[0]
    stretch = jnp.floor(rows.position * STRETCHES / record.sample_count).astype(int)
    inside = stretch[None, :] == jnp.arange(STRETCHES)[:, None]
    square = jnp.sum(jnp.where(inside, error[None, :] ** 2, 0.0), axis=1)
    number = jnp.sum(inside, axis=1)
    mean_square = jnp.mean(error**2)
    products = (jnp.sum(error) ** 2 - jnp.sum(error**2)) / (count * (count - 1))
    return WindowErrorMoments(square / jnp.maximum(number, 1), products / mean_square)

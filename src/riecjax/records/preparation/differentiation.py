"""Derivatives of recorded signals."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.records.record import Record


def differentiate(record: Record, signal: str, name: str) -> Record:
    """Add the time derivative of a signal, by central differences of second order.

    Differentiation raises noise in proportion to frequency; prefer an integral criterion, which
    needs one derivative less, and filter first where it cannot be avoided.

    **Raises:** `DataError` for a missing signal.
    """
    unit = dict(record.units).get(signal)
    units = {} if unit is None else {name: f"{unit}/s"}
    return record.with_signals({name: central_difference(record[signal], record.time_step)}, units)


def central_difference(
    samples: Float[Array, " n"], time_step: Float[Array, ""]
) -> Float[Array, " n"]:
    """Second-order differences, one-sided at both ends."""
    if samples.shape[0] < 3:
        return jnp.broadcast_to((samples[-1] - samples[0]) / time_step, samples.shape)
    inner = samples[2:] - samples[:-2]
    first = -3 * samples[0] + 4 * samples[1] - samples[2]
    last = 3 * samples[-1] - 4 * samples[-2] + samples[-3]
    return jnp.concatenate([first[None], inner, last[None]]) / (2 * time_step)

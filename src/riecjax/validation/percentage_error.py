"""The paper's measure of prediction, eq. (28)."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from riecjax.records.record import Record


def percentage_error(
    predicted: Float[Array, "*batch n"],
    measured: Float[Array, "*batch n"],
    present: Bool[Array, " n"] | None = None,
) -> Float[Array, "*batch"]:
    """p_i of eq. (28): 100 ||predicted - measured|| / ||measured||, over the last axis.

    0 is perfect; predicting zero gives 100. Samples that are not `present` are left out.
    """
    error, reference = predicted - measured, measured
    if present is not None:
        kept = jnp.broadcast_to(present, measured.shape)
        error, reference = jnp.where(kept, error, 0.0), jnp.where(kept, measured, 0.0)
    distance = jnp.sqrt(jnp.sum(error**2, axis=-1))
    return 100 * distance / jnp.sqrt(jnp.sum(reference**2, axis=-1))


class Validation(dict[str, Array]):
    """p_i in percent by signal name; `total` is their sum, as in Table 5."""

    @property
    def total(self) -> Array:
        """Sum over the signals."""
        return sum(self.values(), start=jnp.zeros(()))


def present_in_both(one: Record, other: Record, signal: str) -> Bool[Array, " n"] | None:
    """Where neither record lacks its sample of a signal; `None` where neither ever does."""
    first, second = one.present((signal,)), other.present((signal,))
    if first is None or second is None:
        return second if first is None else first
    return first & second


def validate(predicted: Record, measured: Record, signals: Sequence[str]) -> Validation:
    """p_i of every signal of a simulated record against the measured one.

    Samples that either record lacks are left out.

    **Raises:** `DataError` if a signal is missing in either record.
    """
    return Validation(
        {
            s: percentage_error(predicted[s], measured[s], present_in_both(predicted, measured, s))
            for s in signals
        }
    )

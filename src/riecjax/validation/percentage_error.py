"""The paper's measure of prediction, eq. (28)."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.records.record import Record


def percentage_error(
    predicted: Float[Array, "*batch n"], measured: Float[Array, "*batch n"]
) -> Float[Array, "*batch"]:
    """p_i of eq. (28): 100 ||predicted - measured|| / ||measured||, over the last axis.

    0 is perfect; predicting zero gives 100.
    """
    error = jnp.sqrt(jnp.sum((predicted - measured) ** 2, axis=-1))
    return 100 * error / jnp.sqrt(jnp.sum(measured**2, axis=-1))


class Validation(dict[str, Array]):
    """p_i in percent by signal name; `total` is their sum, as in Table 5."""

    @property
    def total(self) -> Array:
        """Sum over the signals."""
        return sum(self.values(), start=jnp.zeros(()))


def validate(predicted: Record, measured: Record, signals: Sequence[str]) -> Validation:
    """p_i of every signal of a simulated record against the measured one.

    **Raises:** `DataError` if a signal is missing in either record.
    """
    return Validation({s: percentage_error(predicted[s], measured[s]) for s in signals})

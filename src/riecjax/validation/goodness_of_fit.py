"""How much of a signal's variation a prediction explains.

Unlike p_i of eq. (28) these do not depend on where a signal's zero is: a position far from zero
has a small p_i even if its motion is predicted badly.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from riecjax.records.record import Record


def nrmse_fit(
    predicted: Float[Array, "*batch n"],
    measured: Float[Array, "*batch n"],
    present: Bool[Array, " n"] | None = None,
) -> Float[Array, "*batch"]:
    """100 (1 - ||predicted - measured|| / ||measured - mean||) in percent, over the last axis.

    100 is perfect, 0 as good as the measured mean, below 0 worse than it. Samples that are not
    `present` are left out; of a signal that does not vary it is not a number.
    """
    error, spread, _ = _errors(predicted, measured, present)
    varies = spread > 0
    share = jnp.sum(error**2, axis=-1) / jnp.where(varies, spread, 1.0)
    # The root of 0 has no derivative, and a perfect prediction is where a fit wants to go.
    imperfect = share > 0
    root = jnp.where(imperfect, jnp.sqrt(jnp.where(imperfect, share, 1.0)), 0.0)
    return jnp.where(varies, 100 * (1 - root), jnp.nan)


def variance_accounted_for(
    predicted: Float[Array, "*batch n"],
    measured: Float[Array, "*batch n"],
    present: Bool[Array, " n"] | None = None,
) -> Float[Array, "*batch"]:
    """100 (1 - var(predicted - measured) / var(measured)) in percent, over the last axis.

    100 where the prediction is right but for a constant. Samples that are not `present` are left
    out; of a signal that does not vary it is not a number.
    """
    error, spread, kept = _errors(predicted, measured, present)
    varies = spread > 0
    share = _spread(error, kept) / jnp.where(varies, spread, 1.0)
    return jnp.where(varies, 100 * (1 - share), jnp.nan)


def _errors(
    predicted: Array, measured: Array, present: Array | None
) -> tuple[Float[Array, "*batch n"], Float[Array, "*batch"], Bool[Array, "*batch n"]]:
    """Error, zero where a sample lacks; the measured squares about the mean, summed; the mask."""
    kept = jnp.broadcast_to(True if present is None else present, measured.shape)
    return jnp.where(kept, predicted - measured, 0.0), _spread(measured, kept), kept


def _spread(values: Array, kept: Array) -> Array:
    count = jnp.maximum(jnp.sum(kept, axis=-1, keepdims=True), 1)
    mean = jnp.sum(jnp.where(kept, values, 0.0), axis=-1, keepdims=True) / count
    return jnp.sum(jnp.where(kept, values - mean, 0.0) ** 2, axis=-1)


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

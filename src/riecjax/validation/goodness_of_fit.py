"""How well predicted signals fit measured ones.

With the error e and the measured x of mean m and standard deviation s over n samples,

    p   = 100 |e| / |x|                eq. (28)
    fit = 100 (1 - |e| / |x - m|)      NRMSE fit
    VAF = 100 (1 - var(e) / var(x))    variance accounted for.

|x|^2 = n (s^2 + m^2) and |x - m|^2 = n s^2, so p = (100 - fit) s / sqrt(s^2 + m^2): of a position
far from zero p is small even if its motion is predicted badly, while fit and VAF do not depend on
where zero is. |e|^2 / |x - m|^2 = 1 - R^2: a fit of 80 % is an R^2 of 0.96, 50 % one of 0.75. VAF
leaves the error's mean out as well: it is 100 R^2 for errors of zero mean and larger otherwise.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.records.record import Record

PREDICTS_WELL = 80.0
"""Fit in percent from which a signal is predicted well: an error of a fifth of its deviation."""
PREDICTS_ROUGHLY = 50.0
"""Fit in percent from which a signal is predicted at all."""


def nrmse_fit(
    predicted: Float[Array, "*batch n"],
    measured: Float[Array, "*batch n"],
    present: Bool[Array, " n"] | None = None,
) -> Float[Array, "*batch"]:
    """100 (1 - ||predicted - measured|| / ||measured - mean||) in percent, over the last axis.

    100 is perfect, 0 as good as the measured mean, below 0 worse than it. Samples that are not
    `present` are left out. NaN of a signal that does not vary.
    """
    error, valid = _error(predicted, measured, present)
    spread = _spread(measured, valid)
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

    100 for a prediction that is off by a constant only. Samples that are not `present` are left
    out. NaN of a signal that does not vary.
    """
    error, valid = _error(predicted, measured, present)
    spread = _spread(measured, valid)
    varies = spread > 0
    share = _spread(error, valid) / jnp.where(varies, spread, 1.0)
    return jnp.where(varies, 100 * (1 - share), jnp.nan)


def percentage_error(
    predicted: Float[Array, "*batch n"],
    measured: Float[Array, "*batch n"],
    present: Bool[Array, " n"] | None = None,
) -> Float[Array, "*batch"]:
    """p_i of eq. (28): 100 ||predicted - measured|| / ||measured||, over the last axis.

    0 is perfect; predicting zero gives 100. Samples that are not `present` are left out.
    """
    error, valid = _error(predicted, measured, present)
    reference = jnp.where(valid, measured, 0.0)
    distance = jnp.sqrt(jnp.sum(error**2, axis=-1))
    return 100 * distance / jnp.sqrt(jnp.sum(reference**2, axis=-1))


def _error(
    predicted: Array, measured: Array, present: Array | None
) -> tuple[Float[Array, "*batch n"], Bool[Array, "*batch n"]]:
    """Error, zero where a sample is missing, and the mask of the samples that are not."""
    valid = jnp.broadcast_to(True if present is None else present, measured.shape)
    return jnp.where(valid, predicted - measured, 0.0), valid


def _spread(values: Array, valid: Array) -> Array:
    """Sum of squares about the mean."""
    count = jnp.maximum(jnp.sum(valid, axis=-1, keepdims=True), 1)
    mean = jnp.sum(jnp.where(valid, values, 0.0), axis=-1, keepdims=True) / count
    return jnp.sum(jnp.where(valid, values - mean, 0.0) ** 2, axis=-1)


class Validation(dict[str, Array]):
    """p_i in percent by signal name; `total` is their sum, as in Table 5."""

    @property
    def total(self) -> Array:
        """Sum over the signals."""
        return sum(self.values(), start=jnp.zeros(()))


def present_in_both(one: Record, other: Record, signal: str) -> Bool[Array, " n"] | None:
    """Where both records have their sample of a signal; `None` if they have all."""
    first, second = one.present((signal,)), other.present((signal,))
    if first is None or second is None:
        return second if first is None else first
    return first & second


def validate(predicted: Record, measured: Record, signals: Sequence[str]) -> Validation:
    """p_i of every signal of a simulated record, compared with the measured one.

    Samples that are missing in either record are left out.

    **Raises:** `DataError` if a signal is missing in either record.
    """
    return Validation(
        {
            s: percentage_error(predicted[s], measured[s], present_in_both(predicted, measured, s))
            for s in signals
        }
    )


class SignalFit(NamedTuple):
    """How well one signal is predicted, in percent, over `samples` samples."""

    p: Float[Array, ""]
    """Error of eq. (28); 0 is perfect."""
    fit: Float[Array, ""]
    """`nrmse_fit`; 100 is perfect, 0 the measured mean."""
    vaf: Float[Array, ""]
    """Variance accounted for; 100 is perfect but for a constant."""
    samples: int

    @property
    def grade(self) -> str:
        """well, roughly, not, worse than its mean; or unknown, of a signal that does not vary."""
        fit = float(self.fit)
        if np.isnan(fit):
            return "unknown"
        if fit >= PREDICTS_WELL:
            return "well"
        if fit >= PREDICTS_ROUGHLY:
            return "roughly"
        return "not" if fit >= 0 else "worse than its mean"


def signal_fit(
    predicted: Float[Array, " n"], measured: Float[Array, " n"], present: Bool[Array, " n"]
) -> SignalFit:
    """All measures of one signal's prediction over the samples that are `present`."""
    return SignalFit(
        percentage_error(predicted, measured, present),
        nrmse_fit(predicted, measured, present),
        variance_accounted_for(predicted, measured, present),
        int(jnp.sum(present)),
    )

"""Whether a refinement would find something else if its simulation took shorter steps.

At the optimum the sum of squares is formed once more in steps half as long. One step of Gauss and
Newton's method from there is how far the optimum moves: for a method of fourth order that is
15/16 of all that the steps do to the answer, and what is left at the shorter steps is 1/16.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.leaves import is_concrete, namespace
from riecjax.refinement.misfit import AbstractMisfit

OF_AN_ERROR = 0.2
"""Change in standard errors up to which steps do not matter: less adds 2 % to an interval."""
OF_A_VALUE = 1e-4
"""Change as a share of the parameter up to which they do not, however small its standard error:
that of exact data is made of such changes."""
OF_A_SIMULATION = 1e-5
"""Likewise, of what moves the simulation by its own size: of a parameter that is zero."""
ORDER = 4
"""Of the methods whose steps are chosen here."""


class Halved(NamedTuple):
    """How parameters change by halving the steps, whether that matters, and how much too large the
    largest change is."""

    change: Float[Array, " p"]
    coarse: Bool[Array, " p"]
    excess: Float[Array, ""]


class Optimum(NamedTuple):
    """What must be known of an optimum to look at it again.

    **Fields:** `theta` and `starts`; `size` of each parameter; `moment` and `information`, half the
    slope of the sum of squares, negated, and what is added to its curvature; `errors`, standard
    errors; `settled`, whether it is an optimum at all.
    """

    theta: Float[Array, " p"]
    starts: Float[Array, "windows s"]
    size: Float[Array, " p"]
    moment: Float[Array, " p"]
    information: Float[Array, "p p"]
    errors: Float[Array, " p"]
    settled: Bool[Array, ""]


def halve_steps(misfit: AbstractMisfit, at: Optimum) -> Halved:
    """What halving the steps of the simulation does to the optimum; nothing where there are none.

    Parameters that are not determined are passed over.
    """
    finer, xp = misfit.finer(2), namespace(at)
    zero = xp.zeros(at.theta.shape, at.theta.dtype)
    if finer is None:
        return Halved(zero, zero > 0, xp.max(zero))
    again = _normal_equations(*jax.lax.stop_gradient((finer, at.theta, at.starts)))
    gram, moment, rows = again
    at = jax.tree.map(jax.lax.stop_gradient, at) if xp is jnp else at
    curvature = gram + at.information
    scale = 1 / xp.sqrt(xp.maximum(xp.diagonal(curvature), xp.finfo(curvature.dtype).tiny))
    scaled = curvature * scale[:, None] * scale[None, :]
    usable = xp.all(xp.isfinite(scaled))
    scaled = xp.where(usable, scaled, xp.eye(scale.shape[0], dtype=scaled.dtype))
    change = scale * xp.linalg.solve(scaled, scale * (moment - at.moment))
    change = xp.where(usable, change, np.nan)
    rounding = np.sqrt(np.finfo(at.theta.dtype).eps)
    of_value = max(OF_A_VALUE, rounding)
    whole = xp.sqrt(rows / xp.maximum(xp.diagonal(gram), xp.finfo(gram.dtype).tiny))
    allowed = xp.maximum(of_value * xp.maximum(xp.abs(at.theta), at.size), 0)
    allowed = xp.maximum(allowed, of_value * OF_A_SIMULATION / OF_A_VALUE * whole)
    allowed = xp.maximum(allowed, OF_AN_ERROR * at.errors)
    judged = at.settled & xp.isfinite(at.errors)
    coarse = ~(xp.abs(change) <= allowed) & judged
    share = xp.where(xp.isfinite(change), xp.abs(change) / allowed, np.inf)
    return Halved(change, coarse, xp.max(xp.where(judged, share, 0.0), initial=0.0))


@eqx.filter_jit
def _normal_equations(
    misfit: AbstractMisfit, theta: Float[Array, " p"], starts: Float[Array, "windows s"]
) -> tuple[Float[Array, "p p"], Float[Array, " p"], Float[Array, ""]]:
    blocks, _ = misfit.blocks(misfit.expansion(theta, starts))
    total = blocks.flattened().total()
    return total.gram, total.moment, misfit.independent_rows()


def resolved(
    misfit: AbstractMisfit, halved: Halved, before: float
) -> tuple[AbstractMisfit | None, float]:
    """The misfit in steps that are short enough, or None to leave them, and the excess now.

    They are left where they do not matter, where the user chose them, at their limit, and where
    shortening them did not help the time `before`: at kinks no step ends.
    """
    if not is_concrete(halved) or misfit.room_for_steps == 1:
        return None, before
    excess = float(halved.excess)
    if excess <= 1 or (np.isfinite(before) and excess > before / 2):
        return None, excess
    factor = np.clip(np.ceil(excess ** (1 / ORDER)), 2, misfit.room_for_steps)
    return misfit.finer(int(factor)), excess

"""Whether a refinement would find something else if its simulation took shorter steps.

At the optimum the sum of squares is formed once more in steps half as long. One step of Gauss and
Newton's method from there is how far the optimum moves: for a method of fourth order that is
15/16 of all that the steps do to the answer, and what is left at the shorter steps is 1/16.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.leaves import Leaf, held_still, is_concrete, namespace, on_host
from riecjax.refinement.misfit import AbstractMisfit

OF_AN_ERROR = 0.2
"""Change in standard errors up to which steps do not matter: less adds 2 % to an interval."""
OF_A_VALUE = 1e-4
"""Change as a share of the parameter up to which they do not, however small its standard error:
that of exact data is made of such changes."""
OF_A_SIMULATION = 1e-5
"""Likewise, of what moves the simulation by its own size: of a parameter that is zero."""
ORDER = 4
"""Of the method whose steps are chosen here."""
LEAST_FACTOR = 4
"""By which steps are made shorter: each time, all is compiled anew."""
MOST_EXCESS = 1e8
"""Excess of a change beyond which it no longer says how many steps are needed."""
HELPED = 0.5
"""Share of a change that may be left after steps were made shorter."""


class Halved(NamedTuple):
    """How parameters change by halving the steps, how much they may, and where they must not.

    **Fields:** `change` of each; what of that is `allowed`; `coarse`, where it is more than that.
    """

    change: Float[Leaf, " p"]
    allowed: Float[Leaf, " p"]
    coarse: Bool[Leaf, " p"]

    def excess(self, change: Float[Leaf, " p"]) -> float:
        """A change at its worst, in what is allowed here (not under jit)."""
        share = np.abs(change) / np.asarray(self.allowed)
        return float(np.max(np.where(np.isfinite(share), share, np.inf)))


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
    if finer is None:
        zero = xp.zeros(at.theta.shape, at.theta.dtype)
        return Halved(zero, zero, zero > 0)
    # A check changes no derivative, and need not have one.
    if xp is jnp:
        finer, at = held_still((finer, at))
    again = _normal_equations(finer, at.theta, at.starts)
    at, (gram, moment, rows) = (at, again) if xp is jnp else on_host((at, again))
    finfo = np.finfo(at.theta.dtype)
    curvature = gram + at.information
    scale = 1 / xp.sqrt(xp.maximum(xp.diagonal(curvature), finfo.tiny))
    identity = xp.eye(scale.shape[0], dtype=curvature.dtype)
    scaled = curvature * scale[:, None] * scale[None, :] + finfo.eps * identity
    finite = xp.all(xp.isfinite(scaled))
    slope = scale * (moment - at.moment)
    change = scale * xp.linalg.solve(xp.where(finite, scaled, identity), slope)
    change = xp.where(finite, change, np.nan)
    of_value = max(OF_A_VALUE, float(np.sqrt(finfo.eps)))
    whole = xp.sqrt(rows / xp.maximum(xp.diagonal(gram), finfo.tiny))
    size = xp.maximum(xp.maximum(xp.abs(at.theta), at.size), OF_A_SIMULATION / OF_A_VALUE * whole)
    judged = at.settled & xp.isfinite(at.errors)
    allowed = xp.maximum(of_value * size, xp.where(judged, OF_AN_ERROR * at.errors, np.inf))
    return Halved(change, allowed, ~(xp.abs(change) <= allowed) & judged)


@eqx.filter_jit
def _normal_equations(
    misfit: AbstractMisfit, theta: Float[Array, " p"], starts: Float[Array, "windows s"]
) -> tuple[Float[Array, "p p"], Float[Array, " p"], Float[Array, ""]]:
    blocks, _ = misfit.blocks(misfit.expansion(theta, starts))
    total = blocks.flattened().total()
    return total.gram, total.moment, misfit.independent_rows()


def resolved(
    misfit: AbstractMisfit, halved: Halved, before: Halved | None
) -> AbstractMisfit | None:
    """The misfit in steps that are short enough, or None to leave them as they are.

    They are left where they do not matter, where the user chose them, at their limit, and where
    shortening them after `before` did not help: no step ends at a kink.
    """
    if not is_concrete(halved) or misfit.room_for_steps == 1 or not np.any(halved.coarse):
        return None
    excess = halved.excess(halved.change)
    if before is not None and before.excess(halved.change) > HELPED * before.excess(before.change):
        return None
    factor = np.ceil(min(excess, MOST_EXCESS) ** (1 / ORDER))
    return misfit.finer(int(min(max(factor, LEAST_FACTOR), misfit.room_for_steps)))

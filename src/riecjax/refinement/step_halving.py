"""Whether the steps of a simulation are part of the answer, told by halving them at the optimum.

A simulation in steps of length h errs by about c h^p, p the method's order, and so does the sum of
squares E_h that is made of it. To first order halving tells all: with c h^p the error at h, the
change by halving is (1 - 2^-p) c h^p, of order 4 fifteen sixteenths of the error itself.

What moves is not E but its optimum. At the optimum theta of E_h the slope vanishes,

    m_h - q = 0,      m = -J^T r, q the slope of priors,

while in half the steps m_{h/2} - q = m_{h/2} - m_h is left, which one Gauss-Newton step takes up:

    change = (G_{h/2} + information)^-1 (m_{h/2} - m_h).

So one expansion more says how far the optimum would move, where another search would say it at
several times the cost. Initial states are projected out of G and m, and follow.

Subtracting m_h and not q also leaves out what a search that ended early, or at a bound, left of the
slope: that is no matter of steps. A change matters beside the standard error; of nearly exact data,
whose standard errors are themselves made of such changes, beside the parameter.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.compilation import kept_jit
from riecjax.leaves import Leaf, held_still, is_concrete, namespace, on_host
from riecjax.refinement.objective import AbstractMisfit
from riecjax.refinement.optimum import Optimum

OF_AN_ERROR = 0.2
"""Change in standard errors up to which steps do not matter: it adds 2 % to a root mean square."""
OF_A_VALUE = 1e-4
"""Change as a share of the parameter up to which they do not, however small its standard error."""
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


class StepHalving(NamedTuple):
    """How parameters change by halving the steps.

    **Fields:** `change` of each; what of that is `allowed`; `coarse`, where it is more than that.
    """

    change: Float[Leaf, " p"]
    allowed: Float[Leaf, " p"]
    coarse: Bool[Leaf, " p"]

    # What diverged has no finite change, which counts as coarse.
    @np.errstate(all="ignore")
    def excess(self, change: Float[Leaf, " p"]) -> float:
        """A change at its worst, in what is allowed here (not under jit)."""
        share = np.abs(change) / np.asarray(self.allowed)
        return float(np.max(np.where(np.isfinite(share), share, np.inf)))


# Where a search diverged no number is finite, and the result says so.
@np.errstate(all="ignore")
def halve_steps(misfit: AbstractMisfit, at: Optimum, start: Float[Array, " p"]) -> StepHalving:
    """What halving the steps of the simulation does to the optimum; nothing where there are none.

    Parameters that are not determined are passed over.
    """
    theta, finer, xp = at.reached.theta, misfit.finer(2), namespace(at, start)
    if finer is None:
        zero = xp.zeros(theta.shape, theta.dtype)
        return StepHalving(zero, zero, zero > 0)
    # A check changes no derivative, and need not have one.
    if xp is jnp:
        finer, at, start = held_still((finer, at, start))
    again = _normal_equations(finer, at.reached.theta, at.reached.initial)
    if xp is np:
        at, again, start = on_host((at, again, start))
    (gram, moment, rows), theta = again, at.reached.theta
    finfo = np.finfo(theta.dtype)
    curvature = gram + at.information
    scale = 1 / xp.sqrt(xp.maximum(xp.diagonal(curvature), finfo.tiny))
    identity = xp.eye(scale.shape[0], dtype=curvature.dtype)
    scaled = curvature * scale[:, None] * scale[None, :] + finfo.eps * identity
    finite = xp.all(xp.isfinite(scaled))
    slope = scale * (moment - at.moment)
    change = scale * xp.linalg.solve(xp.where(finite, scaled, identity), slope)
    change = xp.where(finite, change, np.nan)
    of_value = max(OF_A_VALUE, float(np.sqrt(finfo.eps)))
    # G_ii theta_i^2 = rows: so large a theta_i moves each residual by 1, a channel by its sigma.
    whole = xp.sqrt(rows / xp.maximum(xp.diagonal(gram), finfo.tiny))
    size = xp.maximum(xp.abs(theta), xp.abs(start))
    size = xp.maximum(size, OF_A_SIMULATION / OF_A_VALUE * whole)
    errors = xp.sqrt(xp.diagonal(at.uncertainty.covariance))
    tested = at.converged & xp.isfinite(errors)
    allowed = xp.maximum(of_value * size, xp.where(tested, OF_AN_ERROR * errors, np.inf))
    return StepHalving(change, allowed, ~(xp.abs(change) <= allowed) & tested)


@kept_jit
def _normal_equations(
    misfit: AbstractMisfit, theta: Float[Array, " p"], initial: Float[Array, "windows s"]
) -> tuple[Float[Array, "p p"], Float[Array, " p"], Float[Array, ""]]:
    blocks, _ = misfit.blocks(misfit.expansion(theta, initial))
    total = blocks.flattened().total()
    return total.gram, total.moment, misfit.independent_rows()


def with_finer_steps(
    misfit: AbstractMisfit, halving: StepHalving, before: StepHalving | None
) -> AbstractMisfit | None:
    """The misfit in steps that are short enough, or None to leave them as they are.

    Of order p, steps k times as short leave k^-p of a change: k is the p-th root of the excess.
    They are left where they do not matter, where the user chose them, at their limit, and where
    shortening them after `before` did not help: no step ends at a kink.
    """
    limit = misfit.step_factor_limit
    if not is_concrete(halving) or limit == 1 or not np.any(halving.coarse):
        return None
    excess = halving.excess(halving.change)
    if before is not None and before.excess(halving.change) > HELPED * before.excess(before.change):
        return None
    factor = np.ceil(min(excess, MOST_EXCESS) ** (1 / ORDER))
    return misfit.finer(int(min(max(factor, LEAST_FACTOR), limit)))

"""The point at which a misfit is least, its derivatives, and whether finer steps would move it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from riecjax.leaves import Leaf, held_still, is_concrete, namespace, on_host
from riecjax.linear_algebra import solve_scaled
from riecjax.refinement.arrowhead import LevenbergMarquardt, Linearised, Point, Residual
from riecjax.refinement.coordinates import Coordinates, Laws
from riecjax.refinement.objective import AbstractMisfit, Expansion

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


Solver = optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser


class RefinementStatus(eqx.Enumeration):
    """How a refinement ended."""

    converged = "converged"
    out_of_steps = (
        "it used up its steps before it converged. Allow more (max_steps), start nearer, or use "
        "shorter windows first."
    )
    not_finite = (
        "the model has no finite residual at the start. Check the start's signs and sizes, or "
        "simulate over shorter windows. If the model is stiff, the steps may be too long for it: "
        "take more (OutputError(method=FixedStep(n))) or an implicit solver "
        "(method=Adaptive(1e-7, 1e-9, diffrax.Kvaerno5()))."
    )
    failed = (
        "no step took it further, and it is not at an optimum. Start nearer, or use shorter "
        "windows first."
    )


class Problem(eqx.Module):
    """A misfit in coordinates without bounds, with priors.

    **Fields:** `misfit`; `coordinates`; `laws`, bounds and priors; `variance` of a residual,
    against which priors are weighed.
    """

    misfit: AbstractMisfit
    coordinates: Coordinates
    laws: Laws
    variance: Float[Array, ""]

    def values(self, point: Point) -> tuple[Float[Array, " p"], Float[Array, "windows s"]]:
        """Parameters and starts of windows in their units."""
        starts = point.starts * self.misfit.start_scale()[None, :]
        return self.coordinates.values(point.parameters), starts

    def point(self, theta: Float[Array, " p"], starts: Float[Array, "windows s"]) -> Point:
        """The point of parameters and starts in their units."""
        return Point(self.coordinates.inverse(theta), starts / self.misfit.start_scale()[None, :])

    def linearised(self, point: Point) -> Linearised:
        """The residuals in coordinates, to first order."""
        theta, starts = self.values(point)
        ones = jnp.ones_like(point.parameters)
        _, slope = jax.jvp(self.coordinates.values, (point.parameters,), (ones,))
        scale = jnp.concatenate(
            [jnp.ones(1, slope.dtype), slope, self.misfit.start_scale().astype(slope.dtype)]
        )
        expansion = self.misfit.expansion(theta, starts)
        moments = expansion.moments() * (scale[:, None] * scale[None, :])[None]
        # A trial point that the model cannot stand is a poor one, and nothing else.
        finite = jnp.all(jnp.isfinite(moments), axis=(1, 2), keepdims=True)
        poor = jnp.zeros(moments.shape[1:], moments.dtype)
        poor = poor.at[0, 0].set(jnp.sqrt(jnp.finfo(moments.dtype).max))
        moments = jnp.where(finite, moments, poor[None])
        weight = jnp.asarray(self.laws.prior_weight) * jnp.sqrt(self.variance)
        prior, prior_slope = weight * (theta - self.laws.prior_mean), weight * slope
        lowest, highest = self.coordinates.limits()
        # A parameter that is pushed against its bound is held there.
        p = theta.shape[0]
        push = -jnp.sum(moments[:, 1 : 1 + p, 0], axis=0) - prior_slope * prior
        free = ~((point.parameters <= lowest) & (push < 0))
        free = (free & ~((point.parameters >= highest) & (push > 0))).astype(moments.dtype)
        kept = jnp.concatenate([jnp.ones(1), free, jnp.ones(moments.shape[-1] - 1 - p)])
        return Linearised(
            moments * (kept[:, None] * kept[None, :])[None],
            prior,
            prior_slope * free,
            lowest,
            highest,
            expansion,
        )


@eqx.filter_custom_jvp
def rotated_residual(point: Point, problem: Problem) -> tuple[Residual, Linearised]:
    """Residuals of each window, rotated into as many as there are columns; see `arrowhead`.

    **Returns:** these, and the linearised problem that they come from.
    """
    at = problem.linearised(point)
    return Residual(at.rotated()[:, :, 0], at.prior), at


@rotated_residual.def_jvp
def _rotated_residual_jvp(primals: Any, tangents: Any) -> Any:
    point, problem = primals
    along = tangents[0]
    at = problem.linearised(point)
    factors = at.rotated()
    p = point.parameters.shape[0]
    parameters = jnp.zeros_like(point.parameters) if along.parameters is None else along.parameters
    starts = jnp.zeros_like(point.starts) if along.starts is None else along.starts
    moved = jnp.einsum("wnp,p->wn", factors[:, :, 1 : 1 + p], parameters)
    moved = moved + jnp.einsum("wns,ws->wn", factors[:, :, 1 + p :], starts)
    residual = Residual(factors[:, :, 0], at.prior)
    # What comes beside the residual is looked at, never differentiated.
    aside = jax.tree.map(jnp.zeros_like, at)
    return (residual, at), (Residual(moved, at.prior_slope * parameters), aside)


def find_optimum(
    problem: Problem,
    start: Point,
    solver: Solver | None,
    max_steps: int,
    report: Callable[[float], None] | None,
) -> tuple[Point, RefinementStatus, Int[Array, ""], Expansion]:
    """The least point from a start, how the search ended, its steps, and the residuals there.

    Derivatives of the point by anything in `problem` follow from the implicit function theorem,
    forward and reverse, whatever the search did.
    """
    still = held_still((problem, start))
    solution = optx.least_squares(
        rotated_residual,
        default_solver(start.parameters.dtype, report) if solver is None else solver,
        still[1],
        args=still[0],
        has_aux=True,
        max_steps=max_steps,
        throw=False,
    )
    found = jax.lax.stop_gradient(solution.value)
    ended = RefinementStatus.where(
        solution.result == optx.RESULTS.nonlinear_max_steps_reached,
        RefinementStatus.out_of_steps,
        RefinementStatus.failed,
    )
    status = RefinementStatus.where(
        solution.result == optx.RESULTS.successful, RefinementStatus.converged, ended
    )
    at: Linearised = solution.aux
    return _implicit(found, problem), status, solution.stats["num_steps"], at.aside


def default_solver(dtype: Any, report: Callable[[float], None] | None = None) -> LevenbergMarquardt:
    """Levenberg-Marquardt at the tolerance that the precision allows."""
    return LevenbergMarquardt(1e-6 if dtype == jnp.float64 else 1e-4, report=report)


@eqx.filter_custom_jvp
def _implicit(point: Point, problem: Problem) -> Point:
    return point


@_implicit.def_jvp
def _implicit_jvp(primals: Any, tangents: Any) -> tuple[Point, Point]:
    """The gradient stays zero: its slope by the point times the point's change, with the whole
    second derivative, takes up its slope by the problem times the problem's change."""
    point, problem = primals
    change = tangents[1]
    moves = jax.tree.map(lambda t: t is not None, change, is_leaf=lambda t: t is None)
    moving, fixed = eqx.partition(problem, moves)
    flat, unravel = ravel_pytree(point)

    def gradient(at: Array, problem_leaves: Any) -> Array:
        problem = eqx.combine(problem_leaves, fixed)
        return ravel_pytree(problem.linearised(unravel(at)).gradient())[0]

    hessian = jax.jacfwd(gradient)(flat, moving)
    _, pushed = jax.jvp(lambda leaves: gradient(flat, leaves), (moving,), (change,))
    # What is held at a bound stays there.
    held = jnp.diagonal(hessian) == 0
    # Inverted, since reverse mode needs what depends on the change to be linear in it.
    identity = jnp.eye(flat.shape[0], dtype=flat.dtype)
    inverse = solve_scaled(hessian + jnp.diag(held.astype(flat.dtype)), identity)
    return point, unravel(-(inverse @ pushed))

"""The optimum of a misfit: how it is found, its derivatives, and how uncertain it is.

**Priors** are residuals. With v the variance of a residual, minus twice the log posterior is
E / v + ((theta - mean) / std)^2: to E, a prior adds the square of (theta - mean) sqrt(v) / std.

**Derivatives** follow from the implicit function theorem. At the optimum z of data d (records,
known values, all that the problem is made of) the gradient F(z, d) of E / 2 vanishes, and it stays
zero where d moves by dd:

    F_z dz + F_d dd = 0,      dz = -H^-1 F_d dd,      H = F_z = J^T J + sum_i r_i d^2 r_i / dz^2.

H is the whole second derivative: Gauss and Newton's J^T J leads to the optimum, but where residuals
are left it is not how the optimum moves. F is J^T r of forward derivatives; its own forward
derivatives are exact, one for each unknown. No step of the search is differentiated, and how it
came there does not matter.

**Uncertainty** is that of least squares linearised at the optimum, in the parameters' units. Normal
equations by blocks of time carry gradients (scores) g_b, which add up to zero; their scatter makes
the sandwich H^-1 (sum_b g_b g_b^T) H^-1, and blocks drawn anew make a bootstrap. A prior counts as
one more observation. Its information v / std^2 is spread over all blocks, so that resampling never
takes it away, and the variance of its own score, v^2 / std^2, is added between H^-1 and H^-1.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from riecjax.compilation import kept_jit
from riecjax.estimation.parameters import Sharing
from riecjax.leaves import held_still
from riecjax.linear_algebra import solve_scaled, symmetric_eigen, unit_scale
from riecjax.refinement.arrowhead import LevenbergMarquardt, Linearised, Point, Residual
from riecjax.refinement.coordinates import Constraints, Coordinates
from riecjax.refinement.objective import AbstractMisfit, Expansion
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.uncertainty.intervals import AbstractIntervals, Uncertainty, estimate_uncertainty

SILENT = 1e-20
"""Share of what is left that a parameter must be able to move by its own size to count at all."""
COLLINEAR = 1e-12
"""Curvature along a direction, relative to the parameters' own, that is no more than rounding."""
TAKES_PART = 0.1
"""Share of such a direction from which a parameter is called undetermined."""

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


class Reached(NamedTuple):
    """Where a search ended: parameters, initial states, what these leave, and in how many steps."""

    theta: Float[Array, " p"]
    initial: Float[Array, "windows s"]
    energy: Float[Array, " quantities"]
    status: RefinementStatus
    steps: Int[Array, ""]


class Optimum(NamedTuple):
    """An optimum and what is said of it.

    **Fields:** where it was `reached`, and whether the search `converged`; uncertainty, inflation,
    rms, bounds and blocks as of `Refined`; `moment`, half the slope of the misfit, negated;
    `information`, what priors and parameters that are held add to its curvature.
    """

    reached: Reached
    converged: Bool[Array, ""]
    uncertainty: Uncertainty
    inflation: Float[Array, " p"]
    rms: Float[Array, " quantities"]
    at_bound: Bool[Array, " p"]
    block_count: Int[Array, ""]
    block_length: Float[Array, ""]
    moment: Float[Array, " p"]
    information: Float[Array, "p p"]


class Problem(eqx.Module):
    """A misfit in coordinates without bounds, with priors.

    **Fields:** `misfit`; `coordinates`; `constraints`; `variance` of a residual.
    """

    misfit: AbstractMisfit
    coordinates: Coordinates
    constraints: Constraints
    variance: Float[Array, ""]

    def values(self, point: Point) -> tuple[Float[Array, " p"], Float[Array, "windows s"]]:
        """Parameters and initial states in their units."""
        initial = point.initial * self.misfit.initial_scale()[None, :]
        return self.coordinates.values(point.parameters), initial

    def point(self, theta: Float[Array, " p"], initial: Float[Array, "windows s"]) -> Point:
        """The point of parameters and initial states in their units."""
        return Point(
            self.coordinates.inverse(theta), initial / self.misfit.initial_scale()[None, :]
        )

    def linearised(self, point: Point) -> Linearised:
        """The residuals in coordinates, to first order."""
        theta, initial = self.values(point)
        ones = jnp.ones_like(point.parameters)
        _, slope = jax.jvp(self.coordinates.values, (point.parameters,), (ones,))
        scale = jnp.concatenate(
            [jnp.ones(1, slope.dtype), slope, self.misfit.initial_scale().astype(slope.dtype)]
        )
        expansion = self.misfit.expansion(theta, initial)
        moments = expansion.moments() * (scale[:, None] * scale[None, :])[None]
        # A trial point that the model cannot stand is a poor one, and nothing else.
        finite = jnp.all(jnp.isfinite(moments), axis=(1, 2), keepdims=True)
        poor = jnp.zeros(moments.shape[1:], moments.dtype)
        poor = poor.at[0, 0].set(jnp.sqrt(jnp.finfo(moments.dtype).max))
        moments = jnp.where(finite, moments, poor[None])
        weight = jnp.asarray(self.constraints.prior_weight) * jnp.sqrt(self.variance)
        prior, prior_slope = weight * (theta - self.constraints.prior_mean), weight * slope
        lowest, highest = self.coordinates.limits()
        # A parameter that is pushed against its bound is held there.
        p = theta.shape[0]
        push = -jnp.sum(moments[:, 1 : 1 + p, 0], axis=0) - prior_slope * prior
        free = ~((point.parameters <= lowest) & (push < 0))
        free = (free & ~((point.parameters >= highest) & (push > 0))).astype(moments.dtype)
        moving = jnp.concatenate([jnp.ones(1), free, jnp.ones(moments.shape[-1] - 1 - p)])
        return Linearised(
            moments * (moving[:, None] * moving[None, :])[None],
            prior,
            prior_slope * free,
            lowest,
            highest,
            expansion,
        )


@eqx.filter_custom_jvp
def reduced_residual(point: Point, problem: Problem) -> tuple[Residual, Linearised]:
    """Residuals of each window, reduced to as many as there are columns; see `arrowhead`.

    **Returns:** these, and the linearised problem that they come from.
    """
    at = problem.linearised(point)
    return Residual(at.factors()[:, :, 0], at.prior), at


@reduced_residual.def_jvp
def _reduced_residual_jvp(primals: Any, tangents: Any) -> Any:
    point, problem = primals
    along = tangents[0]
    at = problem.linearised(point)
    factors = at.factors()
    p = point.parameters.shape[0]
    parameters = jnp.zeros_like(point.parameters) if along.parameters is None else along.parameters
    initial = jnp.zeros_like(point.initial) if along.initial is None else along.initial
    moved = jnp.einsum("wnp,p->wn", factors[:, :, 1 : 1 + p], parameters)
    moved = moved + jnp.einsum("wns,ws->wn", factors[:, :, 1 + p :], initial)
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

    The point differentiates by anything in `problem`, forward and in reverse.
    """
    still = held_still((problem, start))
    solution = optx.least_squares(
        reduced_residual,
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
    """dz = -H^-1 F_d dd of the module's head."""
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


@kept_jit
def search(
    misfit: AbstractMisfit,
    constraints: Constraints,
    start: Float[Array, " p"],
    begun: Reached,
    sharing: Sharing,
    intervals: AbstractIntervals,
    solver: Solver | None,
    max_steps: int,
    progress: Callable[[float], None] | None,
) -> Optimum:
    """The optimum, searched from what was reached before; `start` gives the parameters' scale."""
    scale = jnp.where(start != 0, jnp.abs(start), 1.0)
    variance = residual_variance(misfit, begun.energy, start.shape[0])
    problem = Problem(misfit, constraints.coordinates(scale), constraints, variance)
    first = problem.point(begun.theta, begun.initial)
    point, status, steps, expansion = find_optimum(problem, first, solver, max_steps, progress)
    theta, initial = problem.values(point)
    status = RefinementStatus.where(
        begun.status == RefinementStatus.not_finite, RefinementStatus.not_finite, status
    )
    reached = Reached(theta, initial, expansion.energy, status, begun.steps + steps)
    at_bound = problem.coordinates.at_bound(theta)
    return _with_uncertainty(misfit, expansion, reached, at_bound, constraints, sharing, intervals)


def residual_variance(
    misfit: AbstractMisfit, energy: Float[Array, " quantities"], unknown: int
) -> Float[Array, ""]:
    """Variance of a residual, of those that may be taken as independent."""
    return jnp.sum(energy) / jnp.maximum(misfit.independent_rows() - unknown, 1)


def _with_uncertainty(
    misfit: AbstractMisfit,
    expansion: Expansion,
    reached: Reached,
    at_bound: Bool[Array, " p"],
    constraints: Constraints,
    sharing: Sharing,
    intervals: AbstractIntervals,
) -> Optimum:
    theta = reached.theta
    blocks, short = misfit.blocks(misfit.curved(theta, reached.initial, expansion))
    variance = residual_variance(misfit, expansion.energy, at_bound.shape[0])
    # Holding a parameter that sits on its bound needs no more than a steep slope against it, and
    # one that nothing depends on must not take the others with it.
    total = blocks.flattened().total()
    gram = total.gram
    curvature = jnp.diagonal(gram)
    known = variance * jnp.asarray(constraints.prior_weight) ** 2
    tiny = SILENT * jnp.sum(expansion.energy)
    silent = (curvature * theta**2 <= tiny) & (theta != 0) | (curvature == 0)
    held = at_bound | silent & (known == 0)
    held = held | _undetermined(gram + jnp.diag(known), held)
    information = known + jnp.where(held, jnp.maximum(curvature * 1e12, 1.0), 0.0)
    share = blocks.count / jnp.maximum(jnp.sum(blocks.count), 1)
    spread = jnp.diag(jnp.concatenate([jnp.zeros(1), information]))
    moments = blocks.moments + share[..., None, None] * spread[None, None]
    blocks = NormalEquations(moments, blocks.count, blocks.parameters)
    zero = {name: jnp.zeros(()) for name in misfit.names}
    shared = np.array([name not in sharing.individual for name in misfit.names])
    uncertainty, inflation, statistics = estimate_uncertainty(
        [blocks], {}, zero, short, misfit.longest_window, shared, intervals
    )
    used = jnp.sum(statistics.used)
    covariance = uncertainty.covariance
    if constraints.has_priors:
        informed = gram + jnp.diag(information)
        moved = solve_scaled(informed, jnp.diag(jnp.sqrt(variance) * constraints.prior_weight))
        covariance = covariance + variance * (moved @ moved.T)
    covariance = jnp.where(held[:, None] | held[None, :], jnp.nan, covariance)
    return Optimum(
        reached,
        reached.status == RefinementStatus.converged,
        eqx.tree_at(lambda u: u.covariance, uncertainty, covariance),
        inflation,
        misfit.rms(expansion.energy),
        at_bound,
        used,
        jnp.sum(short.durations) / used,
        total.moment,
        jnp.diag(information),
    )


def _undetermined(gram: Float[Array, "p p"], held: Bool[Array, " p"]) -> Bool[Array, " p"]:
    """Parameters that others can make up for, of those that are not held."""
    free = jnp.where(held, 0.0, 1.0)
    scale = unit_scale(jnp.diagonal(gram)) * free
    scaled = gram * scale[:, None] * scale[None, :] + jnp.diag(1 - free)
    sizes, directions = symmetric_eigen(jax.lax.stop_gradient(scaled))
    weak = sizes < COLLINEAR * gram.shape[0]
    return jnp.any(weak[None, :] & (jnp.abs(directions) > TAKES_PART), axis=1)

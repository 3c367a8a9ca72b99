"""The point at which a misfit is least, and its derivatives by all that the misfit is made of."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from riecjax.estimation.elimination import solve_scaled
from riecjax.leaves import held_still
from riecjax.refinement.arrowhead import LevenbergMarquardt, Linearised, Point, Residual
from riecjax.refinement.coordinates import Coordinates, Laws
from riecjax.refinement.misfit import AbstractMisfit, Expansion

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

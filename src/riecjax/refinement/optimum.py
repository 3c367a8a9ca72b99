"""The optimum of residuals: how it is found, its derivatives, and how uncertain it is.

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
one more observation, as in [`riecjax.estimation.constraints`][].

Levenberg-Marquardt for many windows that share parameters, each with initial states of its own.

Least squares in parameters z (p of them) and, of each of W windows, initial states s_w (s of them):

    E(z, s_1, ..., s_W) = sum_w |r_w(z, s_w)|^2 + |q(z)|^2,      q_i a prior's residual of z_i.

**Linearised.** With J_w = dr_w/dz, S_w = dr_w/ds_w and Q = diag(dq_i/dz_i), all that a step needs
are the moments [r_w J_w S_w]' [r_w J_w S_w] of each window. No s_w enters another window's
residual, so the normal equations of the step d = (x, y_1, ..., y_W) are an arrowhead,

    [ A    B_1  ...  B_W ] [ x   ]     [ a   ]     A = sum_w J_w' J_w + Q^2
    [ B_1' C_1           ] [ y_1 ]     [ c_1 ]     a = sum_w J_w' r_w + Q q
    [ :          .       ] [ :   ] = - [ :   ]     B_w = J_w' S_w
    [ B_W'           C_W ] [ y_W ]     [ c_W ]     C_w = S_w' S_w,  c_w = S_w' r_w,

in short G d = -g, with G = K'K and g = K'r of the Jacobian K of all residuals r, priors among them.

**Damped** after Marquardt (1963): lambda D is added to G, D its diagonal. D has the squared units
of the columns, so that steps do not depend on units. As D is diagonal, the damped matrix is an
arrowhead again, of A~ = A + lambda D_A and C~_w = C_w + lambda D_w. Its system is that of the least
squares [K; sqrt(lambda D)] d = -[r; 0] in all unknowns at once.

**Eliminated.** Row w gives y_w = -C~_w^-1 (c_w + B_w' x). Put into the first row:

    (A~ - sum_w B_w C~_w^-1 B_w') x = -(a - sum_w B_w C~_w^-1 c_w),

the Schur complement of the initial states. This is block elimination, and nothing is left out: x
and y are those of the full damped system. To damp the Schur complement of the undamped C_w instead,
as variable projection does, would be another method, whose initial states take undamped steps. Cost
is O(W s (p + s)^2 + p^3); the dense system's is O((p + W s)^3).

**Accepted** by the gain ratio. From (G + lambda D) d = -g follows d'G d = -g'd - lambda d'D d, so
that the linear model predicts the decrease

    |r|^2 - |r + K d|^2 = -2 g'd - d'G d = -g'd + lambda d'D d = work + damped.

A step is accepted where the true decrease is more than `ACCEPTED` of it; damping falls where it is
more than `GOOD`, and rises where the step is rejected.

**Finished** where the residual is orthogonal to all that the unknowns could change. The undamped
work is g'G^-1 g = |P r|^2, P the projection on the columns of K, so that sqrt(work / E) is the
cosine between residual and tangent space, the relative offset of Bates and Watts (1981).

**Precision.** Moments square the condition number of K. Every system is solved after scaling to a
diagonal of ones, where it is within a factor of its size of the least that any diagonal scaling
leaves (van der Sluis, 1969); damping, of eps at least, then adds to each eigenvalue, and Gaussian
elimination of a positive definite matrix needs no pivots. The Schur complement subtracts what the
initial states explain of the parameters' columns: where they explain all but a share t of one,
log10(1/t) digits of it are lost, where QR of the rows would lose half as many. Steps are corrected
by the next ones; what rounding leaves is an error of the gradient, well below a cosine of 1e-6.

Other solvers are optimistix's, which want a residual and its Jacobian. The Cholesky factor R of a
window's moments is one with as few rows as columns: R = U' [r J S], U having orthonormal columns,
which changes neither a sum of squares nor a step. So nothing that is carried from step to step
grows with the record. Of one window this is as fast as optimistix's Levenberg-Marquardt at equal
error, of 20 windows two to three times as fast: benchmarks/NOTES.md.

**Bounds.** A trial that would go beyond a bound is set on it, and what the slope pushes against its
bound is held there: its columns are zero, for this step and for all else that is said of the
optimum. So bounds that hold nothing change nothing.

**Steps of the simulation**, where there are some, are part of the answer if halving them moves it.
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

import dataclasses
import functools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Float, Int

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.estimation.constraints import (
    Constraints,
    constrained_blocks,
    constrained_uncertainty,
)
from riecjax.estimation.estimate import Estimate, RefinementStatus, Search
from riecjax.linear_algebra import solve_scaled, symmetric_eigen, triangular_factor, unit_scale
from riecjax.refinement.objective import (
    RIDGE,
    AbstractResiduals,
    Energies,
    Expansion,
    Initial,
    Theta,
)
from riecjax.uncertainty.intervals import AbstractIntervals, estimate_uncertainty

FIRST_DAMPING = 1e-2
"""Damping of the first step, relative to the curvature."""
DAMPING_DECREASE, DAMPING_INCREASE = 0.1, 4.0
"""Factors on the damping after a good step and after a rejected one."""
GOOD, ACCEPTED = 0.75, 0.01
"""Gain ratios above which damping falls, and above which a step is accepted."""
LITTLE_DAMPING = 0.5
"""Share of a step's work that damping takes, up to which the step is about the undamped one."""
NEARLY_FLAT = 1e-3
"""Cosine at which a search that no step takes further is at its optimum all the same: where the
model has kinks, the derivatives on the two sides of one differ by so much."""
NO_STEP = 1e-13
"""Step, as a share of a point, that rounding makes."""


class Point(NamedTuple):
    """Where a refinement stands: `parameters` in units of their scale, and `initial` states that
    are estimated, one row for each window."""

    parameters: Float[Array, " p"]
    initial: Initial


class Linearised(NamedTuple):
    """Least squares at a point, to first order.

    **Fields:** `moments`, Gram matrix of residual, its derivatives by the parameters and by the
    initial states, of each window; `prior` residuals and their slopes, one for each parameter; the
    `expansion` that it was made of.
    """

    moments: Float[Array, "windows columns columns"]
    prior: Float[Array, " p"]
    prior_slope: Float[Array, " p"]
    expansion: Expansion | None

    @property
    def energy(self) -> Float[Array, ""]:
        """Sum of squares."""
        return xp.sum(self.moments[:, 0, 0]) + xp.sum(self.prior**2)

    def gradient(self) -> Point:
        """Of half the sum of squares."""
        p = self.prior.shape[0]
        parameters = xp.sum(self.moments[:, 1 : 1 + p, 0], axis=0) + self.prior_slope * self.prior
        return Point(parameters, self.moments[:, 1 + p :, 0])

    def step(self, damping: Float[Array, ""]) -> tuple[Point, Float[Array, ""], Float[Array, ""]]:
        """The damped step, by the Schur complement of the initial states.

        **Returns:** the step d; its work -g'd; and damped, lambda d'D d.
        """
        p, columns = self.prior.shape[0], self.moments.shape[-1]
        gram = self.moments[:, 1:, 1:]
        gradient = self.gradient()
        curvature = xp.diagonal(gram, axis1=1, axis2=2)
        a = xp.sum(gram[:, :p, :p], axis=0) + xp.diag(self.prior_slope**2)
        # A column that is zero is damped too, or it would leave a pivot of zero.
        sizes, initial_sizes = (
            xp.where(size > 0, size, 1.0) for size in (xp.diagonal(a), curvature[:, p:])
        )
        right, schur = gradient.parameters, a + damping * xp.diag(sizes)
        following = None
        if columns > 1 + p:
            b = gram[:, :p, p:]
            identity = np.eye(gram.shape[-1] - p, dtype=gram.dtype)[None]
            c = gram[:, p:, p:] + damping * initial_sizes[:, :, None] * identity
            # C~^-1 [B' c] of each window: how initial states follow x, and where they go at x = 0.
            both = xp.concatenate([xp.swapaxes(b, 1, 2), gradient.initial[:, :, None]], axis=2)
            following = solve_scaled(c, both)
            taken = xp.einsum("wps,wsq->pq", b, following)
            right, schur = right - taken[:, p], schur - taken[:, :p]
        parameters = -solve_scaled(schur, right[:, None])[:, 0]
        initial = gradient.initial
        if following is not None:
            initial = -following[:, :, p] - following[:, :, :p] @ parameters
        work = -gradient.parameters @ parameters - xp.sum(gradient.initial * initial)
        size = sizes @ parameters**2 + xp.sum(initial_sizes * initial**2)
        return Point(parameters, initial), work, damping * size


SILENT = 1e-20
"""Share of what is left that a parameter must be able to move by its own size to count at all."""
COLLINEAR = 1e-12
"""Curvature along a direction, relative to the parameters' own, that is no more than rounding."""
TAKES_PART = 0.1
"""Share of such a direction from which a parameter is called undetermined."""
Solver = optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser
PROFILED = 1e-6
"""Share of the sum of squares that better initial states would still take off: as good as none."""
MOST_TRIALS = 8
"""Initial states that are tried for each window."""
OF_AN_ERROR = 0.2
"""Change in standard errors up to which steps do not matter: it adds 2 % to a root mean square."""
OF_A_VALUE = 1e-4
"""Change as a share of the parameter up to which they do not, however small its standard error."""
OF_A_SIMULATION = 1e-5
"""Likewise, of what moves the simulation by its own size: of a parameter that is zero."""


class Place(NamedTuple):
    """Where a search stands: parameters and initial states, the sum of squares that these leave and
    the r.m.s. of each quantity, whether its start was `lost`, and the steps it took; the
    `expansion` there, `None` where that is of other residuals."""

    theta: Theta
    initial: Initial
    cost: Float[Array, ""]
    rms: Energies
    lost: Bool[Array, ""]
    steps: Int[Array, ""]
    expansion: Expansion | None


class Found(NamedTuple):
    """What a search found: the estimate; of each parameter the change by halving the steps of the
    simulation that does not matter, `allowed`; and the `place` where it ended."""

    estimate: Estimate
    allowed: Float[Array, " p"]
    place: Place


def _by_one_program(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, compiled whole where its arguments are traced; where none is, only what it
    calls is. What is not finite is a status, and warns of nothing."""
    traced = eqx.filter_jit(function)

    @functools.wraps(function)
    def either(*given: Any) -> Any:
        with np.errstate(all="ignore"):
            return (traced if xp.are_traced(given) else function)(*given)

    return either


@_by_one_program
def begun(residuals: AbstractResiduals) -> Place:
    """The start, with what it leaves at the initial states that suit it best.

    Gauss and Newton's steps find these, while they make the sum of squares smaller.
    """
    start, initial = residuals.start, residuals.initial
    expansion = residuals.at(start, initial)._replace(simulated=())
    held, first = xp.stop_gradient((residuals, expansion))
    p = len(held.table.free)

    # The next initial states to try, the least energy so far, trials left, and whether to go on.
    def improved(trial: Initial, at: Expansion, least: Any, trials: Any) -> Any:
        moments = at.moments()[:, 1 + p :]
        better = xp.sum(at.energy) < xp.sum(least)
        energy = xp.where(better, at.energy, least)
        gradient = moments[:, :, :1]
        step = -solve_scaled(moments[:, :, 1 + p :], gradient, RIDGE)
        going = better & (-xp.sum(gradient * step) > PROFILED * xp.sum(energy))
        return trial + step[:, :, 0], energy, trials - 1, going & (trials > 0)

    energy = expansion.energy
    if residuals.initial_state_names:
        none = np.full(len(residuals.labels), np.inf, start.dtype)
        energy = xp.repeated_while(
            lambda state: state[3],
            lambda state: improved(state[0], held.at(held.start, state[0]), *state[1:3]),
            improved(held.initial, first, none, np.asarray(MOST_TRIALS)),
            beside=held,
        )[1]
    cost, rms = xp.sum(energy), residuals.rms(energy)
    return Place(start, initial, cost, rms, ~xp.isfinite(cost), np.asarray(0), expansion)


class Problem(NamedTuple):
    """Residuals of parameters in units of their `scale`; their bounds, and means and inverse
    deviations of their priors; `variance` of a residual."""

    residuals: AbstractResiduals
    bounds: tuple[Float[Array, " p"], Float[Array, " p"]]
    priors: tuple[Float[Array, " p"], Float[Array, " p"]]
    scale: Theta
    variance: Float[Array, ""]

    @classmethod
    def of(
        cls, residuals: AbstractResiduals, constraints: Constraints, cost: Float[Array, ""]
    ) -> "Problem":
        """With priors weighed against what is left where the sum of squares is `cost`."""
        names, start = residuals.table.free, residuals.start
        scale = xp.where(start != 0, xp.abs(start), 1.0)
        bounds, priors = (
            tuple(xp.asarray(one, scale.dtype) for one in pair)
            for pair in (constraints.limits(names), constraints.prior(names))
        )
        return cls(residuals, bounds, priors, scale, residual_variance(residuals, cost))

    def sides(self, point: Point) -> Float[Array, " p"]:
        """Which parameters are at their lower (-1) or upper (1) bound."""
        low, high = (end / self.scale for end in self.bounds)
        at = point.parameters
        return xp.where(at >= high, 1.0, xp.where(at <= low, -1.0, 0.0))

    def theta(self, point: Point) -> Theta:
        """The parameters in their units, of which those at a bound move with it."""
        (lower, upper), side = self.bounds, self.sides(point)
        inside = point.parameters * self.scale
        return xp.where(side < 0, lower, xp.where(side > 0, upper, inside))

    def linearised(self, point: Point, expansion: Expansion | None = None) -> Linearised:
        """The residuals to first order, by the parameters in units of their scale; of their
        expansion there, where it is known."""
        theta = self.theta(point)
        expansion = expansion or self.residuals.at(theta, point.initial)
        states = np.ones(point.initial.shape[1], theta.dtype)
        scale = xp.concatenate([np.ones(1, theta.dtype), self.scale, states])
        moments = expansion.moments() * (scale[:, None] * scale[None, :])[None]
        # A trial point that the model cannot stand is a poor one, and nothing else.
        finite = xp.all(xp.isfinite(moments), axis=(1, 2), keepdims=True)
        poor = np.zeros(moments.shape[1:], moments.dtype)
        poor[0, 0] = np.sqrt(np.finfo(moments.dtype).max)
        moments = xp.where(finite, moments, poor[None])
        mean, weight = self.priors
        weight = weight * xp.sqrt(self.variance)
        prior, slope = weight * (theta - mean), weight * self.scale
        # A parameter that is pushed against its bound is held there.
        p = theta.shape[0]
        push = -xp.sum(moments[:, 1 : 1 + p, 0], axis=0) - slope * prior
        free = (self.sides(point) * push <= 0).astype(moments.dtype)
        moving = xp.concatenate([np.ones(1), free, np.ones(moments.shape[-1] - 1 - p)])
        moments = moments * (moving[:, None] * moving[None, :])[None]
        return Linearised(moments, prior, slope * free, expansion._replace(simulated=()))


class Ended(NamedTuple):
    """Where a search stands: the point, the problem there, linearised problems so far, and whether
    it ended, and failed; of Levenberg-Marquardt's, its trial point, damping, and the decrease that
    is predicted."""

    point: Point
    accepted: Linearised
    steps: Int[Array, ""]
    ended: Bool[Array, ""]
    failed: Bool[Array, ""]
    trial: Point | None = None
    damping: Float[Array, ""] | None = None
    predicted: Float[Array, ""] | None = None


def levenberg_marquardt(
    problem: Problem,
    first: Point,
    expansion: Expansion | None,
    max_steps: int,
    report: Callable[[float], None] | None,
) -> Ended:
    """The search from a first point, with initial states eliminated window by window.

    It stops at a cosine between residual and tangent space that the precision allows, which unlike
    the size of a step depends on neither units nor damping.

    **Arguments:** `expansion` at the first point, if it is known; `report`, called with the sum of
    squares after each step.
    """
    precision = first.parameters.dtype
    flat_cosine = 1e-6 if precision == np.float64 else 1e-4

    def prepared(point: Point, at: Linearised, damping: Array, steps: Array) -> Ended:
        step, work, damped = at.step(damping)
        step = jax.tree.map(lambda leaf: xp.where(xp.isfinite(leaf), leaf, 0.0), step)
        flat = (work <= flat_cosine**2 * at.energy) & (damped <= LITTLE_DAMPING * work)
        still = [_largest(moved) <= NO_STEP * _largest(to) for moved, to in zip(step, point)]
        stuck = xp.all(xp.stack(still))
        if report is not None:
            tell = jax.debug.callback if xp.is_traced(at.energy) else lambda f, x: f(x)
            tell(report, at.energy)
        low, high = (end / problem.scale for end in problem.bounds)
        parameters = xp.clip(point.parameters + step.parameters, low, high)
        trial = Point(parameters, point.initial + step.initial)
        failed = stuck & ~flat & (work > NEARLY_FLAT**2 * at.energy)
        return Ended(point, at, steps, flat | stuck, failed, trial, damping, work + damped)

    def stepped(state: Any) -> Ended:
        """Accept or reject the trial point, and make the next one."""
        tried = problem.linearised(state.trial)
        decrease = state.accepted.energy - tried.energy
        ratio = decrease / state.predicted
        good = (decrease > 0) & (ratio > ACCEPTED)
        factor = xp.where(good, xp.where(ratio > GOOD, DAMPING_DECREASE, 1.0), DAMPING_INCREASE)
        damping = xp.maximum(state.damping * factor, xp.finfo(precision).eps).astype(precision)
        new, old = (state.trial, tried), (state.point, state.accepted)
        point, accepted = jax.tree.map(lambda new, old: xp.where(good, new, old), new, old)
        return prepared(point, accepted, damping, state.steps + 1)

    at, steps = problem.linearised(first, expansion), np.asarray(1)
    return xp.repeated_while(
        lambda state: (state.steps < max_steps) & ~state.ended,
        stepped,
        prepared(first, at, np.asarray(FIRST_DAMPING, precision), steps),
        beside=problem,
    )


def _largest(values: Array) -> Float[Array, ""]:
    return xp.max(xp.abs(values), initial=0.0)


@eqx.filter_jit
def by_optimistix(solver: Solver, problem: Problem, first: Point, max_steps: int) -> Ended:
    """The search by a solver of optimistix, of the residuals of each window reduced to as many as
    there are columns."""

    def reduced(point: Point, problem: Problem) -> tuple[Any, Linearised]:
        here = xp.stop_gradient(point)
        at = xp.stop_gradient(problem.linearised(here))
        factors, p = triangular_factor(at.moments), here.parameters.shape[0]
        # Zero, whose derivative is one: the Jacobian is that of the moments.
        change = jax.tree.map(operator.sub, point, here)
        moved = jnp.einsum("wnp,p->wn", factors[:, :, 1 : 1 + p], change.parameters)
        moved = moved + jnp.einsum("wns,ws->wn", factors[:, :, 1 + p :], change.initial)
        prior = at.prior + at.prior_slope * change.parameters
        return (factors[:, :, 0] + moved, prior), at

    solution = optx.least_squares(
        reduced, solver, first, args=problem, has_aux=True, max_steps=max_steps, throw=False
    )
    spent = solution.result == optx.RESULTS.nonlinear_max_steps_reached
    failed = ~spent & (solution.result != optx.RESULTS.successful)
    return Ended(solution.value, solution.aux, solution.stats["num_steps"], ~spent, failed)


@eqx.filter_custom_jvp
def _implicit(point: Point, problem: Problem) -> Point:
    return point


@_implicit.def_jvp
def _implicit_jvp(primals: Any, tangents: Any) -> tuple[Point, Point]:
    """dz = -H^-1 F_d dd of the module's head."""
    point, problem = primals
    flat, unravel = ravel_pytree(point)

    def gradient(at: Array, problem: Problem) -> Array:
        return ravel_pytree(problem.linearised(unravel(at)).gradient())[0]

    hessian = jax.jacfwd(lambda at: gradient(at, problem))(flat)
    _, pushed = eqx.filter_jvp(lambda moved: gradient(flat, moved), (problem,), (tangents[1],))
    # What is held at a bound stays there.
    held = jnp.diagonal(hessian) == 0
    # Inverted, since reverse mode needs what depends on the change to be linear in it.
    identity = jnp.eye(flat.shape[0], dtype=flat.dtype)
    inverse = solve_scaled(hessian + jnp.diag(held.astype(flat.dtype)), identity)
    return point, unravel(-(inverse @ pushed))


@_by_one_program
def search(
    residuals: AbstractResiduals,
    constraints: Constraints,
    start: Place,
    before: Place,
    intervals: AbstractIntervals,
    solver: Solver | None,
    max_steps: int,
    progress: Callable[[float], None] | None,
) -> Found:
    """The optimum, searched from a place that was reached `before`, the `start` or another."""
    problem = Problem.of(residuals, constraints, before.cost)
    first = Point(before.theta / problem.scale, before.initial)
    given = xp.stop_gradient((problem, first))
    if solver is None:
        ended = levenberg_marquardt(*given, xp.stop_gradient(before.expansion), max_steps, progress)
    else:
        ended = xp.in_double(by_optimistix, solver, *given, max_steps)
    point = ended.point
    if xp.are_traced(given):
        # The point differentiates by anything in `problem`, forward and in reverse.
        point = _implicit(jax.lax.stop_gradient(point), problem)
    theta, initial = problem.theta(point), point.initial
    converged = ended.ended & ~ended.failed & ~before.lost
    word, choose = RefinementStatus, RefinementStatus.where
    status = choose(ended.ended, word.failed, word.out_of_steps)
    status = choose(before.lost, word.not_finite, status)
    status = choose(converged, word.converged, status)
    expansion: Any = ended.accepted.expansion
    at_bound = problem.sides(point) != 0
    scores = expansion
    if residuals.curved is not None:
        scores = dataclasses.replace(residuals, curved=np.asarray(True)).at(theta, initial)
    blocks, short = residuals.blocks(scores)
    cost = xp.sum(expansion.energy)
    variance = residual_variance(residuals, cost)
    # What sits on its bound is held, and so is what nothing depends on, lest others go with it.
    total, names = blocks.flattened().total(), residuals.table.free
    gram, curvature = total.gram, xp.diagonal(total.gram)
    known = variance * xp.asarray(constraints.prior(names)[1]) ** 2
    silent = (curvature * theta**2 <= SILENT * cost) & (theta != 0) | (curvature == 0)
    held = at_bound | silent & (known == 0)
    # Parameters that others can make up for are held as well.
    free, informed = xp.where(held, 0.0, 1.0), gram + xp.diag(known)
    unit = unit_scale(xp.diagonal(informed)) * free
    scaled = informed * unit[:, None] * unit[None, :] + xp.diag(1 - free)
    sizes, directions = symmetric_eigen(xp.stop_gradient(scaled))
    weak = sizes < COLLINEAR * gram.shape[0]
    held = held | xp.any(weak[None, :] & (xp.abs(directions) > TAKES_PART), axis=1)
    nowhere = xp.zeros_like(theta)
    blocks = constrained_blocks(blocks, nowhere, held, known)
    shared = np.array([residuals.table[name].recording is None for name in names])
    uncertainty, inflation, statistics = estimate_uncertainty(
        [blocks],
        {},
        dict(zip(names, nowhere)),
        short,
        shared,
        intervals,
    )
    uncertainty = constrained_uncertainty(uncertainty, statistics, constraints, known, held)
    # To hold a parameter in a step needs no more than a steep slope.
    information = known + xp.where(held, xp.maximum(curvature * 1e12, 1.0), 0.0)
    change, whole = _halving(residuals, theta, initial, total.moment, information)
    of_value = max(OF_A_VALUE, float(np.sqrt(xp.finfo(theta.dtype).eps)))
    size = xp.maximum(xp.abs(theta), xp.abs(residuals.start))
    size = xp.maximum(size, OF_A_SIMULATION / OF_A_VALUE * whole)
    errors = xp.sqrt(xp.diagonal(uncertainty.covariance))
    tested = converged & xp.isfinite(errors)
    allowed = xp.maximum(of_value * size, xp.where(tested, OF_AN_ERROR * errors, np.inf))
    used = xp.sum(statistics.used)
    rms = residuals.rms(expansion.energy)
    place = Place(theta, initial, cost, rms, before.lost, before.steps + ended.steps, expansion)
    found = Search(
        status=status,
        steps=place.steps,
        rms_before=start.rms,
        rms=place.rms,
        cost_before=start.cost,
        cost=cost,
        initial_states=initial,
        step_change=change,
        coarse=~(xp.abs(change) <= allowed) & tested,
        steps_label="" if residuals.method is None else residuals.method.label,
        quantities=residuals.labels,
        quantity_units=residuals.units,
        initial_state_names=residuals.initial_state_names,
        by=(),
    )
    estimate = Estimate(
        theta=theta,
        uncertainty=uncertainty,
        table=residuals.table,
        inflation=inflation,
        at_bound=at_bound,
        block_count=used,
        block_length=xp.sum(short.durations) / used,
        search=found,
    )
    return Found(estimate, allowed, place)


def _halving(
    residuals: AbstractResiduals,
    theta: Theta,
    initial: Initial,
    moment: Float[Array, " p"],
    information: Float[Array, " p"],
) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
    """What halving the steps of the simulation does to the optimum, nothing where there are none;
    and the size of each parameter that moves the simulation by its own."""
    finer = None if residuals.method is None else residuals.method.finer(2)
    if finer is None:
        return xp.zeros_like(theta), xp.zeros_like(theta)
    # A check changes no derivative, and need not have one.
    halved, theta, initial, moment, information = xp.stop_gradient(
        (dataclasses.replace(residuals, method=finer), theta, initial, moment, information)
    )
    blocks, _ = halved.blocks(halved.at(theta, initial))
    total = blocks.flattened().total()
    curvature, slope = total.gram + xp.diag(information), total.moment - moment
    change = solve_scaled(curvature, slope[:, None], float(xp.finfo(theta.dtype).eps))[:, 0]
    # G_ii theta_i^2 = rows: so large a theta_i moves each residual by 1, a channel by its sigma.
    diagonal = xp.maximum(xp.diagonal(total.gram), xp.finfo(theta.dtype).tiny)
    return change, xp.sqrt(halved.independent_rows() / diagonal)


def residual_variance(residuals: AbstractResiduals, cost: Float[Array, ""]) -> Float[Array, ""]:
    """Variance of a residual, of those that may be taken as independent."""
    free = len(residuals.table.free)
    return cost / xp.maximum(residuals.independent_rows() - free, 1)

"""Levenberg-Marquardt for many windows that share parameters, each with initial states of its own.

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
is O(W s (p + s)^2 + p^3); the dense system's is O((p + W s)^3). Of one window nothing is saved, and
its initial states are taken for parameters.

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

Other solvers of optimistix want a residual and its Jacobian. The Cholesky factor R of a window's
moments is one with as few rows as columns: R = U' [r J S], U having orthonormal columns, which
changes neither a sum of squares nor a step. So nothing carried from step to step grows with the
record. Of one window this is as fast as optimistix's Levenberg-Marquardt at equal error, of 20
windows two to three times as fast: benchmarks/NOTES.md.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float

from riecjax.linear_algebra import solve_scaled, triangular_factor

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


class Point(eqx.Module):
    """Where a refinement stands.

    **Fields:** `parameters` in the coordinates of `Coordinates`; `initial` states that are
    estimated, one row for each window, in units of their scale.
    """

    parameters: Float[Array, " p"]
    initial: Float[Array, "windows s"]


class Linearised(eqx.Module):
    """Least squares at a point, to first order.

    **Fields:** `moments`, Gram matrix of residual, its derivatives by the parameters and by the
    initial states, of each window; `prior` residuals and their slopes, one for each parameter;
    `lowest` and `highest` values of the parameters that need be tried; `aside`, whatever else is
    known at the point.
    """

    moments: Float[Array, "windows columns columns"]
    prior: Float[Array, " p"]
    prior_slope: Float[Array, " p"]
    lowest: Float[Array, " p"]
    highest: Float[Array, " p"]
    aside: Any

    @property
    def energy(self) -> Float[Array, ""]:
        """Sum of squares."""
        return jnp.sum(self.moments[:, 0, 0]) + jnp.sum(self.prior**2)

    def gradient(self) -> Point:
        """Of half the sum of squares."""
        p = self.prior.shape[0]
        parameters = jnp.sum(self.moments[:, 1 : 1 + p, 0], axis=0) + self.prior_slope * self.prior
        return Point(parameters, self.moments[:, 1 + p :, 0])

    def step(self, damping: Float[Array, ""]) -> tuple[Point, Float[Array, ""], Float[Array, ""]]:
        """The damped step, by the Schur complement of the initial states.

        **Returns:** the step d; its work -g'd; and damped, lambda d'D d.
        """
        p, columns = self.prior.shape[0], self.moments.shape[-1]
        if self.moments.shape[0] == 1 and columns > 1 + p:
            whole, work, damped = self._initial_as_parameters().step(damping)
            return Point(whole.parameters[:p], whole.parameters[None, p:]), work, damped
        gram = self.moments[:, 1:, 1:]
        gradient = self.gradient()
        curvature = jnp.diagonal(gram, axis1=1, axis2=2)
        a = jnp.sum(gram[:, :p, :p], axis=0) + jnp.diag(self.prior_slope**2)
        # A column that is zero is damped too, or it would leave a pivot of zero.
        floor = jnp.finfo(gram.dtype).eps * jnp.max(curvature) + jnp.finfo(gram.dtype).tiny
        sizes = jnp.maximum(jnp.diagonal(a), floor)
        initial_sizes = jnp.maximum(curvature[:, p:], floor)
        right, schur = gradient.parameters, a + damping * jnp.diag(sizes)
        following = None
        if columns > 1 + p:
            b = gram[:, :p, p:]
            identity = jnp.eye(gram.shape[-1] - p, dtype=gram.dtype)[None]
            c = gram[:, p:, p:] + damping * initial_sizes[:, :, None] * identity
            # C~^-1 [B' c] of each window: how initial states follow x, and where they go at x = 0.
            both = jnp.concatenate([jnp.swapaxes(b, 1, 2), gradient.initial[:, :, None]], axis=2)
            following = jax.vmap(solve_scaled)(c, both)
            taken = jnp.einsum("wps,wsq->pq", b, following)
            right, schur = right - taken[:, p], schur - taken[:, :p]
        parameters = -solve_scaled(schur, right[:, None])[:, 0]
        initial = gradient.initial
        if following is not None:
            initial = -following[:, :, p] - following[:, :, :p] @ parameters
        work = -gradient.parameters @ parameters - jnp.sum(gradient.initial * initial)
        size = sizes @ parameters**2 + jnp.sum(initial_sizes * initial**2)
        return Point(parameters, initial), work, damping * size

    def _initial_as_parameters(self) -> "Linearised":
        """The same problem of one window, whose initial states are as any parameter."""
        none = jnp.zeros(self.moments.shape[-1] - 1 - self.prior.shape[0], self.moments.dtype)
        prior, slope = (jnp.concatenate([held, none]) for held in (self.prior, self.prior_slope))
        return Linearised(self.moments, prior, slope, self.lowest, self.highest, self.aside)

    def factors(self) -> Float[Array, "windows columns columns"]:
        """Residual (first column) and Jacobian of each window, in as many rows as columns."""
        return triangular_factor(self.moments)


class Residual(eqx.Module):
    """First columns of `factors`: `windows`, one row for each; and those of the `priors`."""

    windows: Float[Array, "windows columns"]
    priors: Float[Array, " p"]


class _State(eqx.Module):
    """Accepted problem, trial point, damping, and the two parts of the predicted decrease."""

    accepted: Linearised
    trial: Point
    damping: Float[Array, ""]
    work: Float[Array, ""]
    damped: Float[Array, ""]
    first: Bool[Array, ""]
    ended: Bool[Array, ""]
    result: optx.RESULTS


class LevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt on moments, with initial states eliminated window by window.

    Its function must return, aside, a [`Linearised`][] problem.

    **Arguments:** `rtol`, the cosine between residual and tangent space at which it stops, which
    unlike the size of a step depends on neither units nor damping; `report`, called with the sum of
    squares after each step.
    """

    rtol: float
    atol: float = 0.0
    norm: Any = optx.max_norm
    report: Any = None

    def init(
        self, fn: Any, y: Point, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any
    ) -> _State:
        """Before the first step."""
        dtype = y.parameters.dtype
        accepted = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), aux_struct)
        return _State(
            accepted,
            y,
            jnp.asarray(FIRST_DAMPING / DAMPING_DECREASE, dtype),
            jnp.ones((), dtype),
            jnp.zeros((), dtype),
            jnp.asarray(True),
            jnp.asarray(False),
            optx.RESULTS.successful,
        )

    def step(
        self, fn: Any, y: Point, args: Any, options: Any, state: _State, tags: Any
    ) -> tuple[Point, _State, Linearised]:
        """Accept or reject the trial point, and make the next one."""
        _, tried = fn(state.trial, args)
        decrease = state.accepted.energy - tried.energy
        ratio = decrease / (state.work + state.damped)
        good = state.first | ((decrease > 0) & (ratio > ACCEPTED))
        lower = state.first | (ratio > GOOD)
        factor = jnp.where(good, jnp.where(lower, DAMPING_DECREASE, 1.0), DAMPING_INCREASE)
        damping = jnp.maximum(state.damping * factor, jnp.finfo(factor.dtype).eps)
        point = jax.tree.map(lambda new, old: jnp.where(good, new, old), state.trial, y)
        accepted = jax.tree.map(lambda new, old: jnp.where(good, new, old), tried, state.accepted)
        step, work, damped = accepted.step(damping)
        step = jax.tree.map(lambda leaf: jnp.where(jnp.isfinite(leaf), leaf, 0.0), step)
        flat = (work <= self.rtol**2 * accepted.energy) & (damped <= LITTLE_DAMPING * work)
        stuck = self.norm(step) <= NO_STEP * self.norm(point)
        if self.report is not None:
            jax.debug.callback(self.report, accepted.energy)
        trial = Point(
            jnp.clip(point.parameters + step.parameters, accepted.lowest, accepted.highest),
            point.initial + step.initial,
        )
        result = optx.RESULTS.where(
            stuck & ~flat & (work > NEARLY_FLAT**2 * accepted.energy),
            optx.RESULTS.nonlinear_divergence,
            optx.RESULTS.successful,
        )
        state = _State(
            accepted, trial, damping, work, damped, jnp.asarray(False), flat | stuck, result
        )
        return point, state, accepted

    def terminate(
        self, fn: Any, y: Point, args: Any, options: Any, state: _State, tags: Any
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Whether the search is over."""
        return state.ended, state.result

    def postprocess(
        self,
        fn: Any,
        y: Point,
        aux: Linearised,
        args: Any,
        options: Any,
        state: _State,
        tags: Any,
        result: optx.RESULTS,
    ) -> tuple[Point, Linearised, dict[str, Any]]:
        """Nothing to add."""
        return y, aux, {}

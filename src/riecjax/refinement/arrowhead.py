"""Levenberg-Marquardt for many windows that share parameters, each with a start of its own.

The starts of different windows never meet in a residual, so the Gram matrix of the Jacobian is an
arrowhead: a block for the parameters, one small block for each window's start, and what couples
these to the parameters. Eliminating the starts window by window (Schur) leaves a system as small
as the parameters are few: the cost grows with the number of windows, not with its cube.

A least-squares solver needs of the residuals only their moments with their derivatives. Ours takes
these as they are; for any other solver of optimistix, residual and Jacobian are rotated into a
triangle of as many rows as there are columns, which changes neither a sum of squares nor a step.
Either way, what is carried from step to step does not grow with the record. Of one window, ours is
as fast as optimistix's Levenberg-Marquardt at equal error, of 20 windows with starts two to three
times as fast: `python -m benchmarks --only bypassed`.
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
LESS, MORE = 0.1, 4.0
"""Factors on the damping after a step that did as foretold, and after one that failed."""
AS_FORETOLD, FAILED = 0.75, 0.01
"""Share of the foretold decrease above which damping falls, and below which a step is undone."""
LITTLE_DAMPING = 0.5
"""Share of a step's work that damping takes, up to which the step is about the undamped one."""
NEARLY_FLAT = 1e-3
"""Cosine at which a search that no step takes further is at its optimum all the same: where the
model has kinks, the derivatives on the two sides of one differ by so much."""
NO_STEP = 1e-13
"""Step, as a share of a point, that rounding makes."""


class Point(eqx.Module):
    """Where a refinement stands.

    **Fields:** `parameters` in the coordinates of `Coordinates`; `starts`, the initial states that
    are estimated, one row for each window, in units of their scale.
    """

    parameters: Float[Array, " p"]
    starts: Float[Array, "windows s"]


class Linearised(eqx.Module):
    """Least squares at a point, to first order.

    **Fields:** `moments`, Gram matrix of residual, its derivatives by the parameters and by the
    start, of each window; `prior` residuals and their slopes, one for each parameter; `lowest` and
    `highest` values of the parameters that need be tried; `aside`, whatever else is known at the
    point.
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
        """Solution of (Gram matrix + damping x its diagonal) step = -gradient.

        Marquardt's (1963) scaling: steps do not hang on the units of the parameters.

        **Returns:** the step; its work, gradient times step, negated; and how much of that work is
        the damping's.
        """
        p, columns = self.prior.shape[0], self.moments.shape[-1]
        if self.moments.shape[0] == 1 and columns > 1 + p:
            whole, work, damped = self._starts_as_parameters().step(damping)
            return Point(whole.parameters[:p], whole.parameters[None, p:]), work, damped
        gram = self.moments[:, 1:, 1:]
        gradient = self.gradient()
        curvature = jnp.diagonal(gram, axis1=1, axis2=2)
        head = jnp.sum(gram[:, :p, :p], axis=0) + jnp.diag(self.prior_slope**2)
        floor = jnp.finfo(gram.dtype).eps * jnp.max(curvature) + jnp.finfo(gram.dtype).tiny
        sizes = jnp.maximum(jnp.diagonal(head), floor)
        start_sizes = jnp.maximum(curvature[:, p:], floor)
        right, schur = gradient.parameters, head + damping * jnp.diag(sizes)
        following = None
        if columns > 1 + p:
            coupling = gram[:, :p, p:]
            identity = jnp.eye(gram.shape[-1] - p, dtype=gram.dtype)[None]
            damped = gram[:, p:, p:] + damping * start_sizes[:, :, None] * identity
            both = jnp.concatenate(
                [jnp.swapaxes(coupling, 1, 2), gradient.starts[:, :, None]], axis=2
            )
            following = jax.vmap(solve_scaled)(damped, both)
            taken = jnp.einsum("wps,wsq->pq", coupling, following)
            right, schur = right - taken[:, p], schur - taken[:, :p]
        parameters = -solve_scaled(schur, right[:, None])[:, 0]
        starts = gradient.starts
        if following is not None:
            starts = -following[:, :, p] - following[:, :, :p] @ parameters
        work = -gradient.parameters @ parameters - jnp.sum(gradient.starts * starts)
        size = sizes @ parameters**2 + jnp.sum(start_sizes * starts**2)
        return Point(parameters, starts), work, damping * size

    def _starts_as_parameters(self) -> "Linearised":
        """The same problem of one window, whose start is as any parameter."""
        none = jnp.zeros(self.moments.shape[-1] - 1 - self.prior.shape[0], self.moments.dtype)

        def longer(values: Array) -> Array:
            return jnp.concatenate([values, none])

        prior, slope = longer(self.prior), longer(self.prior_slope)
        return Linearised(self.moments, prior, slope, self.lowest, self.highest, self.aside)

    def rotated(self) -> Float[Array, "windows columns columns"]:
        """Residual (first column) and Jacobian of each window, in as many rows as columns."""
        return triangular_factor(self.moments)


class Residual(eqx.Module):
    """Rotated residuals: `windows`, one row for each, and those of the `priors`."""

    windows: Float[Array, "windows columns"]
    priors: Float[Array, " p"]


class _State(eqx.Module):
    """Accepted problem, trial point, damping, and what was foretold of the trial."""

    accepted: Linearised
    trial: Point
    damping: Float[Array, ""]
    work: Float[Array, ""]
    damped: Float[Array, ""]
    first: Bool[Array, ""]
    ended: Bool[Array, ""]
    result: optx.RESULTS


class LevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt on moments, with the starts eliminated window by window.

    It stops where the residual is orthogonal to all that parameters and starts could change: where
    the cosine between them is `rtol` (the relative offset of Bates and Watts, 1981). Unlike the
    size of a step, that does not hang on units or damping.

    Its function must return, aside, a [`Linearised`][] problem.

    **Arguments:** `rtol`; `report`, called with the sum of squares after each step.
    """

    rtol: float
    atol: float = 0.0
    norm: Any = optx.max_norm
    report: Any = None

    def init(
        self,
        fn: Any,
        y: Point,
        args: Any,
        options: dict[str, Any],
        f_struct: Any,
        aux_struct: Any,
        tags: frozenset[object],
    ) -> _State:
        """Before the first step."""
        dtype = y.parameters.dtype
        accepted = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), aux_struct)
        return _State(
            accepted,
            y,
            jnp.asarray(FIRST_DAMPING / LESS, dtype),
            jnp.ones((), dtype),
            jnp.zeros((), dtype),
            jnp.asarray(True),
            jnp.asarray(False),
            optx.RESULTS.successful,
        )

    def step(
        self,
        fn: Any,
        y: Point,
        args: Any,
        options: dict[str, Any],
        state: _State,
        tags: frozenset[object],
    ) -> tuple[Point, _State, Linearised]:
        """Judge the trial point, and make the next one."""
        _, tried = fn(state.trial, args)
        fall = state.accepted.energy - tried.energy
        # Half of the work, and damping's half of it, is what a linear problem would give.
        ratio = fall / (state.work + state.damped)
        good = state.first | ((fall > 0) & (ratio > FAILED))
        factor = jnp.where(good, jnp.where(state.first | (ratio > AS_FORETOLD), LESS, 1.0), MORE)
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
            point.starts + step.starts,
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
        self,
        fn: Any,
        y: Point,
        args: Any,
        options: dict[str, Any],
        state: _State,
        tags: frozenset[object],
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Whether the search is over."""
        return state.ended, state.result

    def postprocess(
        self,
        fn: Any,
        y: Point,
        aux: Linearised,
        args: Any,
        options: dict[str, Any],
        state: _State,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[Point, Linearised, dict[str, Any]]:
        """Nothing to add."""
        return y, aux, {}

"""Covariances of estimates: jackknife, autocorrelated sandwich, and least squares' own."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from riecjax.linear_algebra import eliminate_with_pivots, solve_scaled, unit_scale
from riecjax.summaries.blocks import MOST_BLOCKS
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.uncertainty.block_statistics import Evidence
from riecjax.uncertainty.scores import in_order, scores, slope


def jackknife_covariance(evidence: Evidence) -> Float[Array, "p p"]:
    """Covariance from the estimates without each block in turn, all stages solved again.

    Solved for the change itself: without the block, the scores at the estimate sum to minus its
    own, and nothing is lost by subtracting two estimates that agree in most of their digits.
    """
    totals = [stage.total() for stage in evidence.stages]
    found = in_order(evidence.plan, evidence.values)
    scale = unit_scale(jnp.diagonal(slope(totals, evidence.plan)))
    least = 1e4 * jnp.finfo(scale.dtype).eps

    def without(blocks: list[NormalEquations], score: Float[Array, " p"]) -> Float[Array, " p"]:
        left = [
            NormalEquations(t.moments - b.moments, t.count - b.count, t.parameters)
            for t, b in zip(totals, blocks)
        ]
        matrix = slope(left, evidence.plan) * scale[:, None] * scale[None, :]
        change, pivots = eliminate_with_pivots(matrix, (-score * scale)[:, None])
        # Where only this block tells of a parameter, nothing is known without it.
        return jnp.where(jnp.min(pivots) > least, change[:, 0] * scale, -found)

    block_scores = scores(evidence.stages, evidence.plan, evidence.values)
    moved = jax.vmap(without)(evidence.stages, block_scores)
    factor = jnp.repeat((evidence.used - 1) / evidence.used, MOST_BLOCKS)
    held = jnp.tile(jnp.arange(MOST_BLOCKS), evidence.used.shape[0])
    inside = held < jnp.repeat(evidence.used, MOST_BLOCKS)
    moved = jnp.where(inside[:, None], moved, 0.0)
    return (factor[:, None] * moved).T @ moved


def sandwich_covariance(evidence: Evidence) -> Float[Array, "p p"]:
    """Slope^-1 S slope^-T, with S from scores whose autocorrelation counts.

    Newey and West's (1987) estimate with Bartlett's weights, which are the mean over all blocks of
    one length, overlapping ones included. That length is the blocks'.
    """
    series = evidence.fine_influence
    lag = jnp.maximum(jnp.round(evidence.length / evidence.short.seconds), 1).astype(jnp.int32)
    total = jnp.sum(jax.vmap(_overlapping_blocks)(series, lag), axis=0)
    blocks = jnp.sum(evidence.used)
    return total * blocks / jnp.maximum(blocks - 1, 1)


def _overlapping_blocks(
    series: Float[Array, "short p"], lag: Int[Array, ""]
) -> Float[Array, "p p"]:
    """Sum over k of (1 - |k| / lag) sum_t series[t] series[t + k]^T."""
    n = series.shape[0]
    running = jnp.pad(jnp.cumsum(series, axis=0), ((1, 0), (0, 0)))
    end = jnp.arange(1, 2 * n)
    block = running[jnp.minimum(end, n)] - running[jnp.clip(end - lag, 0, n)]
    block = jnp.where((end < n + lag)[:, None], block, 0.0)
    return block.T @ block / lag


def naive_covariance(evidence: Evidence) -> Float[Array, "p p"]:
    """sigma^2 (A^T A)^-1 of each stage, as if all rows were independent."""
    parts = []
    for i, names in evidence.plan:
        total = evidence.stages[i].total()
        others = {n: evidence.values[n] for n in total.parameters if n not in names}
        equations = total.fix(others)
        theta = jnp.stack([evidence.values[name] for name in names])
        freedom = jnp.maximum(equations.count - len(names), 1)
        variance = equations.residual_energy(theta) / freedom
        identity = jnp.eye(len(names), dtype=variance.dtype)
        parts.append(variance * solve_scaled(equations.gram, identity))
    return jax.scipy.linalg.block_diag(*parts)


def effective_freedom(evidence: Evidence) -> Float[Array, " p"]:
    """Degrees of freedom of each parameter's variance, by Satterthwaite's rule.

    A variance that many blocks share has one for each block but one; a variance that hangs on a
    few rare ones has few. With block variances s^2 estimated by squares u^2 of influence, of which
    u^4 / 3 estimates s^4, (sum s^2)^2 / sum s^4 is 3 (sum u^2)^2 / sum u^4; 1 at the least.
    """
    largest = jnp.max(jnp.abs(evidence.influence), axis=0)
    # Of unit size first: fourth powers of small influences would vanish.
    influence = evidence.influence / jnp.where(largest > 0, largest, 1.0)[None, :]
    squares = jnp.sum(influence**2, axis=0)
    fourths = jnp.sum(influence**4, axis=0)
    most = jnp.maximum(jnp.sum(evidence.used) - 1, 1).astype(squares.dtype)
    ratio = 3 * squares**2 / jnp.where(fourths > 0, fourths, 1.0) - 1
    return jnp.where(fourths > 0, jnp.clip(ratio, 1, most), most)

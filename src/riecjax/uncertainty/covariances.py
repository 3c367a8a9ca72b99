"""Covariances of estimates: the jackknife, a HAC sandwich, and least squares' own."""

# With u_b the influence of block b on the estimates (see `block_statistics`), all estimate the
# variance of `sum_b u_b`.
#
# - The jackknife leaves each block out in turn. To first order theta moves by -u_b; to all orders
#   by `-(J - J_b)^-1 psi_b`, which is larger where b holds much of what tells of a parameter (its
#   leverage J^-1 J_b is not small). So it errs on the wide side where few blocks tell (Efron and
#   Stein, 1981), which the plain sum of u_b u_b^T does not.
# - The HAC sandwich, `J^-1 S J^-T` with `S = sum_k (1 - |k| / L) sum_t psi_t psi_(t+k)^T` over
#   short blocks t (Newey and West, 1987), needs no cut between blocks of L short ones each: it
#   averages over all places of the cut, and is positive semidefinite as a mean of squares is.
# - Least squares' own, sigma^2 (A^T A)^-1, takes rows for independent. Windows that overlap share
#   their errors, and a record holds about duration / beta independent ones, however many are
#   summed: this is too small by orders of magnitude. Beside the others it counts those.

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from riecjax import tails
from riecjax.linear_algebra import eliminate_with_pivots, solve_scaled, unit_scale
from riecjax.summaries.blocks import MOST_BLOCKS
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.uncertainty.block_statistics import BlockStatistics, scores, slope

LEVEL = 0.01
"""Level of the test of whether recordings disagree."""


def jackknife_covariance(statistics: BlockStatistics) -> Float[Array, "p p"]:
    """Covariance from the estimates without each block in turn, all stages solved again.

    `sum_r (n_r - 1) / n_r sum_b d_b d_b^T` over the n_r blocks of record r, d_b the change of the
    estimate without block b.
    """
    unknowns, used, found = statistics.unknowns, statistics.used, statistics.estimate
    totals = [stage.total() for stage in statistics.blocks]
    scale = unit_scale(jnp.diagonal(slope(totals, unknowns)))
    least = 1e4 * jnp.finfo(scale.dtype).eps

    # Solved for the change itself: without the block, the scores at the estimate sum to minus its
    # own, and nothing is lost by subtracting two estimates that agree in most of their digits.
    def without(blocks: list[NormalEquations], score: Float[Array, " p"]) -> Float[Array, " p"]:
        left = [
            NormalEquations(t.clean - b.clean, t.count - b.count, t.parameters)
            for t, b in zip(totals, blocks)
        ]
        matrix = slope(left, unknowns) * scale[:, None] * scale[None, :]
        change, pivots = eliminate_with_pivots(matrix, (-score * scale)[:, None])
        # Where only this block tells of a parameter, nothing is known without it.
        return jnp.where(jnp.min(pivots) > least, change[:, 0] * scale, -found)

    block_scores = scores(statistics.blocks, unknowns, statistics.values)
    moved = jax.vmap(without)(statistics.blocks, block_scores)
    factor = jnp.repeat((used - 1) / used, MOST_BLOCKS)
    place = jnp.tile(jnp.arange(MOST_BLOCKS), used.shape[0])
    moved = jnp.where((place < jnp.repeat(used, MOST_BLOCKS))[:, None], moved, 0.0)
    return (factor[:, None] * moved).T @ moved


def sandwich_covariance(statistics: BlockStatistics) -> Float[Array, "p p"]:
    """Slope^-1 S slope^-T, with S from scores whose autocorrelation counts.

    Newey and West's (1987) estimate with Bartlett's weights, which are the mean over all blocks of
    one length, overlapping ones included. That length is the blocks'.
    """
    lag = jnp.round(statistics.length / statistics.short.seconds)
    lag = jnp.maximum(lag, 1).astype(jnp.int32)
    total = jnp.sum(jax.vmap(_overlapping_blocks)(statistics.short_influence, lag), axis=0)
    # Residuals sum to zero: as with any variance about a fitted mean, one of n squares is lost.
    blocks = jnp.sum(statistics.used)
    return total * blocks / jnp.maximum(blocks - 1, 1)


def _overlapping_blocks(
    series: Float[Array, "short p"], lag: Int[Array, ""]
) -> Float[Array, "p p"]:
    """Sum over k of (1 - |k| / lag) sum_t series[t] series[t + k]^T.

    A sum over `lag` terms that ends at t is c[t] - c[t - lag], c the running sum. Of its square,
    summed over all ends t (also those where it reaches beyond the series), a product of two terms
    |k| apart is in lag - |k| sums. So the weights come from one running sum, for any traced lag.
    """
    n = series.shape[0]
    running = jnp.pad(jnp.cumsum(series, axis=0), ((1, 0), (0, 0)))
    end = jnp.arange(1, 2 * n)
    block = running[jnp.minimum(end, n)] - running[jnp.clip(end - lag, 0, n)]
    block = jnp.where((end < n + lag)[:, None], block, 0.0)
    return block.T @ block / lag


def naive_covariance(statistics: BlockStatistics) -> Float[Array, "p p"]:
    """sigma^2 (A^T A)^-1 of each stage, as if all rows were independent."""
    parts = []
    for i, names in statistics.unknowns:
        total = statistics.blocks[i].total()
        others = {n: statistics.values[n] for n in total.parameters if n not in names}
        equations = total.fix(others)
        theta = jnp.stack([statistics.values[name] for name in names])
        freedom = jnp.maximum(equations.count - len(names), 1)
        variance = equations.residual_energy(theta) / freedom
        identity = jnp.eye(len(names), dtype=variance.dtype)
        parts.append(variance * solve_scaled(equations.gram, identity))
    return jax.scipy.linalg.block_diag(*parts)


def effective_freedom(statistics: BlockStatistics) -> Float[Array, " p"]:
    """Degrees of freedom of each parameter's variance, by Satterthwaite's rule.

    A variance that many blocks share has one for each block but one; a variance that a few rare
    blocks decide has few. With block variances s^2 estimated by squares u^2 of influence, of which
    u^4 / 3 estimates s^4, (sum s^2)^2 / sum s^4 is 3 (sum u^2)^2 / sum u^4; 1 at the least.
    """
    largest = jnp.max(jnp.abs(statistics.influence), axis=0)
    # Of unit size first: fourth powers of small influences would vanish.
    influence = statistics.influence / jnp.where(largest > 0, largest, 1.0)[None, :]
    squares = jnp.sum(influence**2, axis=0)
    fourths = jnp.sum(influence**4, axis=0)
    most = jnp.maximum(jnp.sum(statistics.used) - 1, 1).astype(squares.dtype)
    ratio = 3 * squares**2 / jnp.where(fourths > 0, fourths, 1.0) - 1
    return jnp.where(fourths > 0, jnp.clip(ratio, 1, most), most)


def record_inflation(
    influence: Float[Array, "records blocks p"], blocks_used: Float[Array, " records"]
) -> Float[Array, " p"]:
    """By how much standard errors must grow, for each parameter, because recordings disagree.

    If recordings differ only by chance, the sum of a record's influence has the variance of its
    blocks about their own mean, and the squares of the ratios follow chi-square (Cochran's test).
    Where that is refuted at the 1 % level, recordings and not blocks are the independent draws: the
    standard error then comes from the scatter between them, enlarged by Student's t for their small
    number. 1 otherwise, and for one record.

    **Arguments:** `influence` of each block of time on each estimate, zero in blocks that are not
    used; `blocks_used` of each record, 2 or more.
    """
    count = influence.shape[0]
    if count < 2:
        return jnp.ones(influence.shape[-1], influence.dtype)
    used = blocks_used[:, None].astype(influence.dtype)
    moved = jnp.sum(influence, axis=1)
    within = (jnp.sum(influence**2, axis=1) - moved**2 / used) * used / (used - 1)
    some = within > 0
    ratio = jnp.where(some, moved**2 / jnp.where(some, within, 1.0), 0.0)
    disagree = jnp.sum(ratio, axis=0) > tails.chi_square(LEVEL, count - 1)
    between = count / (count - 1) * jnp.sum(moved**2, axis=0)
    pooled = jnp.sum(influence**2, axis=(0, 1))
    known = pooled > 0
    student = float(tails.student(0.025, count - 1)) / tails.normal(0.025)
    factor = student * jnp.sqrt(between / jnp.where(known, pooled, 1.0))
    return jnp.where(disagree & known, jnp.maximum(factor, 1.0), 1.0)

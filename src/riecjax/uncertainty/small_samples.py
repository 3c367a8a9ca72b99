"""Bell and McCaffrey's sandwich for few blocks of time, with its degrees of freedom.

Residuals are small where few stretches decide an estimate, since it follows their errors: blocks
then scatter too little, whatever their number. The blocks' Gram matrices tell by how much, and how
many degrees of freedom are left.
"""

# Let s_b be the scores of block b at the truth, G_b its Gram matrix (in the slope's coordinates,
# see `block_statistics`), H = (sum G)^-1, and h^T the row of H that belongs to one parameter.
# Residuals at the estimate, which is H sum_c s_c away from the truth, give the block the influence
#
#     u_b = h^T (s_b - G_b H sum_c s_c).
#
# The variance is estimated by the quadratic form u^T B u, B = 1 on the diagonal and 1/2 between
# half blocks that follow one another: Newey and West's weights for a lag of two. Half blocks are
# taken since one cut between long blocks is as arbitrary as the next; half blocks with weight 1/2
# are the mean over the two cuts, and tell twice as many differences of so few blocks.
#
# Working model: errors alike all along, so that s_b has the covariance W_bb = sigma^2 G_b, and
# `OVERLAP` / 2 of the sum of both between neighbours. With r_b = W_b h and W_b, W the sums of W_bc
# over c, and over all, the influences then have the covariance
#
#     M_bc = h^T W_bc h - r_b^T q_c - q_b^T r_c + q_b^T W q_c,    q_b = H G_b h.
#
# So the form expects trace(B M), where it should expect h^T W h; the ratio, `seen`, is what it sees
# of the variance and is divided out. Its own variance, for Gaussian scores, is 2 trace(B M B M),
# that of a chi-square with `trace(B M)^2 / trace(B M B M)` degrees of freedom (Satterthwaite); they
# go to Student's t. Both are functions of the design alone. Errors that are not alike change what u
# is, and the form follows them; only the correction rests on the working model (Bell and McCaffrey,
# 2002; Imbens and Kolesar, 2016).

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from riecjax.linear_algebra import eliminate, unit_diagonal
from riecjax.summaries.blocks import ShortBlocks, merge_blocks
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.uncertainty.block_statistics import Unknowns, scores, slope

MOST_HALVES = 128
"""Half blocks of all records together: more, and nothing is few."""
OVERLAP = 0.15
"""Correlation of neighbouring half blocks' scores, as windows reach from one into the next: 0.19
for white errors, windows of any length up to half a block and a constant regressor, less for one
that moves."""
TOLD_BY_OTHERS = 1e-3
"""Weight of what all parameters' blocks say together, for one of which its own say nothing."""
TOLD_BY_NONE = 1e-6
"""Weight of the worst case, for where no parameter's blocks say anything."""


class FewBlocks(NamedTuple):
    """The corrected sandwich.

    **Fields:** `covariance`; `degrees_of_freedom` behind each variance; `seen`, the share of each
    variance that the scatter between blocks shows before it is corrected.
    """

    covariance: Float[Array, "p p"]
    degrees_of_freedom: Float[Array, " p"]
    seen: Float[Array, " p"]


def few_blocks_sandwich(
    short_blocks: list[NormalEquations],
    unknowns: Unknowns,
    values: Mapping[str, Array],
    short: ShortBlocks,
    used: Int[Array, " records"],
) -> FewBlocks:
    """Covariance and degrees of freedom by Bell and McCaffrey's (2002) rule.

    A parameter that one stretch alone tells of has no scatter between blocks: its variance is the
    other parameters' ratio to the working model, and without any the case that a half block's rows
    all err alike.

    **Arguments:** `short_blocks`, of each stage, leading axes `(records, short blocks)`;
    `used`, long blocks of each record, which are halved where short blocks are short enough.
    """
    records = short.number.shape[0]
    most = max(MOST_HALVES // records, 2)
    halves = jnp.minimum(2 * used, jnp.minimum(short.number, most))
    stages = [merge_blocks(stage, short, halves, most) for stage in short_blocks]
    totals = [stage.total() for stage in stages]
    whole, scale = unit_diagonal(slope(totals, unknowns))
    inverse = eliminate(whole, jnp.eye(scale.shape[0]))
    each = jax.vmap(lambda *blocks: slope(list(blocks), unknowns))(*stages)
    each = each * (scale[:, None] * scale[None, :])[None]
    variance = _working_variance(totals, unknowns, values)
    largest = jnp.max(variance)
    largest = jnp.where(largest > 0, largest, 1.0)
    working = each * (variance / largest)[None]
    beside = _beside(halves, used, most)

    # Sums of the working covariance over one block's neighbours, and over both.
    near = OVERLAP / 2 * (jnp.sum(beside, axis=1)[:, None, None] * working)
    near = working + near + OVERLAP / 2 * jnp.tensordot(beside, working, axes=1)
    everywhere = jnp.sum(near, axis=0)
    should = jnp.einsum("ji,ik,jk->j", inverse, everywhere, inverse)
    # Of unit variance, or fourth powers would be lost in 32-bit.
    rows = inverse / jnp.sqrt(should)[:, None]

    def expected(row: Float[Array, " p"]) -> tuple[Array, Array]:
        own = jnp.einsum("i,bij,j->b", row, working, row)
        both = near @ row
        follows = jnp.einsum("i,bij->bj", row, each) @ inverse
        covariance = jnp.diag(own) + OVERLAP / 2 * beside * (own[:, None] + own[None, :])
        shared = both @ follows.T
        covariance = covariance - shared - shared.T + follows @ everywhere @ follows.T
        form = covariance + beside @ covariance / 2
        return jnp.trace(form), jnp.sum(form * form.T)

    seen, scatter = jax.vmap(expected)(rows)
    moved = (scores(stages, unknowns, values) * scale[None, :]) @ rows.T
    shown = moved.T @ (moved + beside @ moved / 2)
    alike = largest * jnp.max(jnp.stack([total.count for total in totals])) / jnp.sum(halves)
    together = jnp.trace(shown) + TOLD_BY_NONE * alike
    together = together / (jnp.sum(seen) + TOLD_BY_NONE)
    share = jnp.sqrt(seen + TOLD_BY_OTHERS)
    covariance = (shown + jnp.diag(jnp.full(scale.shape, TOLD_BY_OTHERS * together))) / (
        share[:, None] * share[None, :]
    )
    size = scale * jnp.sqrt(should)
    some = scatter > 0
    freedom = jnp.where(some, seen**2 / jnp.where(some, scatter, 1.0), 1.0)
    return FewBlocks(covariance * size[:, None] * size[None, :], jnp.maximum(freedom, 1.0), seen)


def _working_variance(
    totals: list[NormalEquations], unknowns: Unknowns, values: Mapping[str, Array]
) -> Float[Array, "p p"]:
    """Variance of one row's error, between parameters of one stage; zero between stages."""
    parts = []
    for i, names in unknowns:
        total = totals[i]
        at = jnp.stack([jnp.asarray(values[name]) for name in total.parameters])
        # Exact data leave no more than rounding.
        rounding = jnp.finfo(at.dtype).eps * total.energy
        left = jnp.maximum(total.residual_energy(at), rounding) / jnp.maximum(total.count, 1)
        parts.append(jnp.full((len(names), len(names)), left))
    return jax.scipy.linalg.block_diag(*parts)


def _beside(
    halves: Int[Array, " records"], used: Int[Array, " records"], most: int
) -> Float[Array, "blocks blocks"]:
    """1 for two half blocks that follow one another in a record; 0 where they are long blocks."""
    record, place = np.divmod(np.arange(most * halves.shape[0]), most)
    follow = (record[:, None] == record) & (np.abs(place[:, None] - place) == 1)
    inside = (place < halves[record]) & (halves > used)[record]
    return jnp.where(follow & inside[:, None] & inside[None, :], 1.0, 0.0)

"""Bootstrap over blocks of time: whole procedures solved again from resampled normal equations."""

# A replicate draws blocks with replacement: block b counts w_b times, and the staged fit is solved
# from `sum w_b M_b`, M_b a block's moments. Its estimate theta* is divided by its own standard
# error, `t* = (theta* - theta) / s*`, and the quantiles of t* make the interval `theta - t*_hi s,
# theta - t*_lo s`. To divide is worth it: t has about the same law whatever the errors' size is (a
# pivot), so that ends are right to O(1/n) of n blocks rather than O(n^-1/2) (Hall, 1988, of
# one-sided ones), and lean where estimates are skewed. Blocks rather than rows are drawn since
# errors are correlated within a block (Kunsch, 1989). A replicate costs a weighted sum of a few
# dozen small matrices and an elimination; no row is seen again.

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from riecjax.linear_algebra import solve_scaled
from riecjax.summaries.blocks import MOST_BLOCKS
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.uncertainty.block_statistics import (
    BlockStatistics,
    as_vector,
    scores,
    slope,
    staged_values,
)

AT_ONCE = 250
"""Replicates worked on together: they share vector instructions, and memory stays small."""


def studentized_replicates(
    statistics: BlockStatistics, draws: Float[Array, "replicates records blocks_of_record"]
) -> Float[Array, "replicates p"]:
    """(estimate - value) / standard error of each replicate, for all parameters of all stages.

    A replicate draws as many blocks as a record has, with replacement, from each record. Its
    standard error is the sandwich of its own blocks, about the mean of each record: records are
    not drawn, so what differs between them does not move a replicate. NaN where a replicate leaves
    a parameter undetermined.

    **Arguments:** `draws`, see [`uniform_draws`][].
    """
    stages, unknowns, used = statistics.blocks, statistics.unknowns, statistics.used
    found = statistics.estimate
    moments = [stage.clean.reshape(stage.count.shape[0], -1) for stage in stages]

    def replicate(drawn: Float[Array, "records blocks_of_record"]) -> Float[Array, " p"]:
        weights = drawn_counts(drawn, used).astype(found.dtype).ravel()
        totals = [
            NormalEquations(
                (weights @ m).reshape(s.moments.shape[1:]), weights @ s.count, s.parameters
            )
            for m, s in zip(moments, stages)
        ]
        again = staged_values(totals, unknowns, statistics.known, _solve_definite)
        error = _standard_errors(
            scores(stages, unknowns, again),
            weights.reshape(used.shape[0], -1),
            slope(totals, unknowns),
        )
        moved = as_vector(unknowns, again) - found
        usable = (error > 0) & jnp.isfinite(error) & jnp.isfinite(moved)
        return jnp.where(usable, moved / jnp.where(usable, error, 1.0), jnp.nan)

    return jax.lax.map(replicate, draws, batch_size=AT_ONCE)


@functools.lru_cache(maxsize=4)
def uniform_draws(seed: int, replicates: int, records: int) -> np.ndarray:
    """Numbers from 0 to 1, one for each block that each replicate draws of each record.

    NumPy's: the same for every fit, so nothing is gained by compiling how they are made.
    """
    shape = (replicates, records, MOST_BLOCKS)
    return np.random.default_rng(seed).random(shape, np.float32)


def drawn_counts(
    drawn: Float[Array, "records blocks_of_record"], used: Int[Array, " records"]
) -> Int[Array, "records blocks_of_record"]:
    """How often each block is drawn, with as many draws from each record as it has blocks."""
    block = jnp.minimum((drawn * used[:, None]).astype(jnp.int32), used[:, None] - 1)
    place = np.arange(MOST_BLOCKS)
    # Eight bits hold them all, and four times as many are compared at once.
    asked = jnp.where(place[None, :] < used[:, None], block, -1).astype(jnp.int8)
    same = asked[:, :, None] == place.astype(np.int8)[None, None, :]
    return jnp.sum(same, axis=1, dtype=jnp.int8).astype(jnp.int32)


def _standard_errors(
    scores: Float[Array, "blocks p"],
    weights: Float[Array, "records blocks_of_record"],
    slope: Float[Array, "p p"],
) -> Float[Array, " p"]:
    # Elimination with every block's score on the right would take half as long again.
    inverse = solve_scaled(slope, jnp.eye(slope.shape[0], dtype=slope.dtype))
    moved = (scores @ inverse.T).reshape(*weights.shape, -1)
    total = jnp.einsum("rb,rbp->rp", weights, moved)
    squares = jnp.einsum("rb,rbp->rp", weights, moved**2)
    drawn = jnp.sum(weights, axis=1)[:, None]
    return jnp.sqrt(jnp.sum(jnp.maximum(squares - total**2 / drawn, 0.0), axis=0))


def _solve_definite(equations: NormalEquations) -> Float[Array, " p"]:
    """Solution of normal equations of full rank; see [`solve_scaled`][]."""
    return solve_scaled(equations.gram, equations.moment[:, None])[:, 0]

"""What uncertainty is judged from: sums, scores and influence of blocks of time."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from riecjax import tails
from riecjax.summaries.blocks import ShortBlocks
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.uncertainty.scores import Unknowns


class Evidence(NamedTuple):
    """What uncertainty is judged from.

    **Fields:**

    - `stages`: normal equations of each stage in blocks, `MOST_BLOCKS` of each record.
    - `plan`, `known`, `values`: what each stage finds, what is given, and everything by name.
    - `used`: how many of each record's blocks hold rows.
    - `influence`: of each of these blocks on each estimate, shape `(records * MOST_BLOCKS, p)`.
    - `fine_influence`: the same for the short blocks, shape `(records, short blocks, p)`.
    - `short`, `length`: the short blocks, and the seconds that a long one lasts.
    - `fine`: normal equations of each stage in short blocks, leading axes
      `(records, short blocks)`.
    """

    stages: list[NormalEquations]
    plan: Unknowns
    known: dict[str, Array]
    values: dict[str, Array]
    used: Int[Array, " records"]
    influence: Float[Array, "blocks p"]
    fine_influence: Float[Array, "records short p"]
    short: ShortBlocks
    length: Float[Array, ""]
    fine: list[NormalEquations]


LEVEL = 0.01


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
    reach = float(tails.student(0.025, count - 1)) / tails.normal(0.025)
    grown = reach * jnp.sqrt(between / jnp.where(known, pooled, 1.0))
    return jnp.where(disagree & known, jnp.maximum(grown, 1.0), 1.0)

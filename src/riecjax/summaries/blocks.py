"""Short blocks of time that sums are kept for, and longer ones made of them."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.leaves import Leaf, namespace
from riecjax.records.record import Record
from riecjax.summaries.normal_equations import NormalEquations

MOST_BLOCKS = 64
"""Blocks of a record at most: enough for a quantile of Student's t, and long blocks forgive errors
that stay correlated for long."""
FEWEST_WINDOWS = 2
"""Longest windows to a block at the least."""


class ShortBlocks(NamedTuple):
    """The blocks of start times that normal equations are kept for.

    **Fields:** `number` of blocks that hold each record, of the same or a longer axis of an
    array; `seconds` that a block of each record lasts.
    """

    number: Int[Leaf, " records"]
    seconds: Float[Leaf, " records"]

    @property
    def durations(self) -> Float[Leaf, " records"]:
        """Seconds of each record."""
        return self.seconds * self.number


def blocks_in_use(short: ShortBlocks, length: Float[Leaf, ""]) -> Int[Array, " records"]:
    """How many blocks of about a length in seconds to make of each record: 2 at least.

    Of a whole number of short blocks each, so that they come out even.
    """
    # Fewer than two blocks have no scatter. More than `MOST_BLOCKS` would cost memory in every
    # replicate and give the variance few more degrees of freedom than Student's t can tell apart.
    xp = namespace(length, short)
    each = xp.maximum(xp.round(xp.divide(length, short.seconds)), 1)
    most = xp.minimum(short.number, MOST_BLOCKS)
    return xp.clip(short.number // each, 2, most).astype(np.int32)


def merge_blocks(
    equations: NormalEquations,
    short: ShortBlocks,
    used: Int[Array, " records"],
    most: int = MOST_BLOCKS,
) -> NormalEquations:
    """Normal equations of longer blocks from those of short ones.

    **Arguments:** `equations` with leading axes `(records, short blocks)`; `used`, into how many
    each record's are added up.

    **Returns:** normal equations with one leading axis: `most` blocks of each record, of which
    those beyond `used` are empty. No block holds anything of two records.
    """

    def merged(values: Array) -> Array:
        return sum_blocks(values, short, used, most)

    return equations.each(merged, merged)


def sum_blocks(
    values: Float[Array, "records short *shape"],
    short: ShortBlocks,
    used: Int[Array, " records"],
    most: int = MOST_BLOCKS,
) -> Float[Array, "blocks *shape"]:
    """Sums over longer blocks of what is known of short ones; see [`merge_blocks`][]."""
    number = short.number[:, None]
    place = np.arange(values.shape[1])[None, :]
    # What is left over is spread, so that no last block is shorter than the others.
    group = jnp.where(place < number, place * used[:, None] // number, most)
    summed = jax.vmap(lambda v, g: jax.ops.segment_sum(v, g, num_segments=most))
    return summed(values, group).reshape(-1, *values.shape[2:])


def short_blocks(records: Sequence[Record], criterion: AbstractCriterion) -> ShortBlocks:
    """The short blocks of each record that normal equations are kept for."""
    samples = [criterion.block_samples(record) for record in records]
    xp = namespace([record.time_step for record in records])
    return ShortBlocks(
        np.array([-(-record.sample_count // k) for record, k in zip(records, samples)]),
        xp.stack([xp.multiply(k, record.time_step) for record, k in zip(records, samples)]),
    )

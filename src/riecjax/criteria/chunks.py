"""Long records chunk by chunk, so that memory does not grow with them."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from riecjax.records.record import Record

CHUNK = 2**14
"""Samples to a chunk: large beside a window, and its columns fit into a processor's cache."""
WHOLE = 2**17
"""Samples up to which a record is not cut, so that expressions may look at all of it."""
WHOLE_32_BIT = 2**14
"""The same in 32-bit, where running integrals over more samples would lose digits."""


def chunk_length(record: Record, block: int, reach: int) -> int:
    """Starts to a chunk, a whole number of blocks; the whole record if it is not much longer."""
    uncut = WHOLE if record.time_step.dtype == jnp.float64 else WHOLE_32_BIT
    if record.sample_count <= max(uncut, 4 * reach):
        return record.sample_count
    return -(-max(CHUNK, 4 * reach) // block) * block


def is_chunked(record: Record, block: int, reach: int) -> bool:
    """Whether a record is worked through in several chunks."""
    return chunk_length(record, block, reach) < record.sample_count


def in_chunks(
    record: Record,
    of_chunk: Callable[[Record, Int[Array, ""] | int, int], Any],
    *,
    block: int,
    reach: int,
    margin: int,
) -> Any:
    """What `of_chunk` makes of each block of starts of a record, stacked along a leading axis.

    **Arguments:**

    - `of_chunk`: takes a stretch of the record, the sample in it at which the chunk's first block
      begins, and its number of blocks, over which the arrays that it returns lead.
    - `block`: starts to a block; `reach`: samples that a window reaches beyond its start at most;
      `margin`: samples more on either side, for quadrature.
    """
    n = record.sample_count
    count, length = -(-n // block), chunk_length(record, block, reach)
    width = length + reach + 2 * margin
    if width >= n:
        return of_chunk(record, 0, count)

    def one(index: Array) -> Any:
        begin = jnp.clip(index * length - margin, 0, n - width)
        return of_chunk(record.stretch(begin, width), index * length - begin, length // block)

    chunks = jax.lax.map(one, jnp.arange(-(-n // length)))
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:count], chunks)

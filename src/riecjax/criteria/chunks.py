"""Long records chunk by chunk, so that memory does not grow with them."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from riecjax.records.record import Record

CHUNK = 2**14
"""Samples to a chunk: large beside a window, and its columns fit into a processor's cache."""
ROUND = 2**12
"""Samples to a chunk of a record that is filled up: some beyond its end are worked through."""
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


class StartBlocks(NamedTuple):
    """Blocks of starts, one after the other, and how many of the samples are no padding.

    **Fields:** `first` sample at which the first block begins; `size`, starts to a block; `number`
    of blocks; `unpadded`, how many samples are the recording's: no window reaches beyond. Padding
    fills an array up to a length that other recordings have too.
    """

    first: Int[Array, ""] | int
    size: Int[Array, ""] | int
    number: int
    unpadded: Int[Array, ""] | int

    def cut(
        self, values: Float[Array, "columns n"], number: int
    ) -> Float[Array, "columns number size"]:
        """The first of so many blocks of a size that is known, zero beyond the last sample."""
        assert isinstance(self.size, int)
        room = number * self.size
        # Room behind, so that no slice would begin earlier than asked for.
        padded = jnp.pad(values, ((0, 0), (0, room)))
        part = jax.lax.dynamic_slice_in_dim(padded, self.first, room, axis=1)
        return part.reshape(values.shape[0], number, self.size)

    def products(
        self, left: Float[Array, "a n"], right: Float[Array, "b n"]
    ) -> Float[Array, "blocks a b"]:
        """sum_u left[u] right[u]^T by blocks; what lies beyond counts to the last one."""
        n, number, size = left.shape[1], self.number, self.size
        if not isinstance(size, int):
            block = jnp.clip((jnp.arange(n) - self.first) // size, 0, number - 1)
            each = left.T[:, :, None] * right.T[:, None]
            return jax.ops.segment_sum(each, block, num_segments=number)
        # As many blocks of the same size as the samples could fill.
        room, precision = max(-(-n // size), number), jax.lax.Precision.HIGHEST
        blocks = self.cut(left, room), self.cut(right, room)
        sums = jnp.einsum("abu,cbu->bac", *blocks, precision=precision)
        return sums[:number].at[-1].add(jnp.sum(sums[number:], axis=0))


def in_chunks(
    record: Record,
    of_chunk: Callable[[Record, StartBlocks], Any],
    *,
    block: int,
    reach: int,
    margin: int,
    unpadded: Int[Array, ""] | None = None,
    first: Int[Array, ""] | int = 0,
    number: int | None = None,
) -> Any:
    """What `of_chunk` makes of each block of starts of a record, stacked along a leading axis.

    **Arguments:**

    - `of_chunk`: takes a stretch of the record and the blocks of starts in it, over which the
      arrays that it returns lead.
    - `block`: starts to a block; `reach`: samples that a window reaches beyond its start at most;
      `margin`: samples more on either side, for quadrature.
    - `unpadded`: samples before the padding, all by default. It may be traced: chunks
      beyond are not worked through, and what is returned for their blocks is zero.
    - `first` of the starts, and `number` of blocks from there: by default all that there are.
    """
    n = record.sample_count
    count = -(-n // block) if number is None else number
    if unpadded is None:
        length = chunk_length(record, block, reach)
    else:
        length = -(-max(ROUND, 4 * reach) // block) * block
    width = length + reach + 2 * margin
    if width >= n:
        return of_chunk(
            record, StartBlocks(first, block, count, n if unpadded is None else unpadded)
        )
    last = n - width if unpadded is None else jnp.maximum(unpadded - width, 0)

    def one(index: Array) -> Any:
        start = first + index * length
        begin = jnp.clip(start - margin, 0, last)
        here = width if unpadded is None else jnp.minimum(unpadded - begin, width)
        blocks = StartBlocks(start - begin, block, length // block, here)
        return of_chunk(record.stretch(begin, width), blocks)

    def unless_beyond(index: Array) -> Any:
        if unpadded is None:
            return one(index)
        # To learn the shapes and to loop it is traced once.
        once = jax.jit(one)
        shapes = jax.eval_shape(once, index)
        nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        return jax.lax.cond(first + index * length < unpadded, once, lambda _: nothing, index)

    chunks = jax.lax.map(unless_beyond, jnp.arange(-(-count * block // length)))
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:count], chunks)

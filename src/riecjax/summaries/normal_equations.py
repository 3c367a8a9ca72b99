"""Normal equations: all that least squares needs to know of its rows, and additive."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from riecjax.criteria.criterion import AbstractCriterion, Rows
from riecjax.errors import ModelError
from riecjax.leaves import Leaf, namespace
from riecjax.records.record import Record


class NormalEquations(eqx.Module):
    """Gram matrix of target and regressors, with the number of rows behind it.

    Additive over windows, records, blocks of time and machines: adding two gives what their rows
    stacked would give. A leading axis of blocks is allowed, see [`NormalEquations.total`][].

    **Fields:**

    - `moments`: `[y A]^T [y A]`, shape `(..., 1 + p, 1 + p)`.
    - `count`: number of rows, shape `(...)`.
    - `parameters`: names of the p regressors, in the order of the matrix.
    - `noise`: what of `moments` sensor noise adds in expectation, shape `(..., 1 + p, 1 + p)`;
      `None` where nothing is known of it.
    """

    moments: Float[Array, "*blocks columns columns"]
    count: Float[Array, "*blocks"]
    parameters: tuple[str, ...] = eqx.field(static=True)
    noise: Float[Array, "*blocks columns columns"] | None = None

    @property
    def clean(self) -> Float[Array, "*blocks columns columns"]:
        """The moments less what noise adds: those of the signals, in expectation."""
        return self.moments if self.noise is None else self.moments - self.noise

    @property
    def gram(self) -> Float[Array, "*blocks p p"]:
        """A^T A, less what noise adds."""
        return self.clean[..., 1:, 1:]

    @property
    def moment(self) -> Float[Array, "*blocks p"]:
        """A^T y, less what noise adds."""
        return self.clean[..., 1:, 0]

    @property
    def energy(self) -> Float[Array, "*blocks"]:
        """y^T y, noise included."""
        return self.moments[..., 0, 0]

    def each(
        self,
        of_matrix: Callable[[Array], Array],
        of_count: Callable[[Array], Array] = lambda count: count,
        parameters: tuple[str, ...] | None = None,
    ) -> "NormalEquations":
        """The same done to all matrices, and something to the numbers of rows."""
        names = self.parameters if parameters is None else parameters
        noise = None if self.noise is None else of_matrix(self.noise)
        return NormalEquations(of_matrix(self.moments), of_count(self.count), names, noise)

    def with_noise(self, noise: Array | None) -> "NormalEquations":
        """The same moments, of which this is noise."""
        return NormalEquations(self.moments, self.count, self.parameters, noise)

    def __add__(self, other: "NormalEquations") -> "NormalEquations":
        if self.parameters != other.parameters:
            raise ModelError(
                f"normal equations of different parameters cannot be added: {self.parameters} and "
                f"{other.parameters}. Bring both to the same ones by `embed`."
            )
        moments, count = self.moments + other.moments, self.count + other.count
        known = [noise for noise in (self.noise, other.noise) if noise is not None]
        noise = sum(known[1:], start=known[0]) if known else None
        return NormalEquations(moments, count, self.parameters, noise)

    def total(self) -> "NormalEquations":
        """The sum over the axis of blocks."""
        return self.each(lambda m: m.sum(0), lambda count: count.sum(0))

    def in_blocks_of_records(self) -> "NormalEquations":
        """Of leading axes `(records, blocks)`, the sum over the second."""
        return self.each(lambda m: m.sum(1), lambda count: count.sum(1))

    def flattened(self) -> "NormalEquations":
        """The same with one leading axis for all that there are."""
        shape = self.moments.shape[-2:]
        return self.each(lambda m: m.reshape(-1, *shape), lambda count: count.reshape(-1))

    def rename(self, parameters: tuple[str, ...]) -> "NormalEquations":
        """The same equations with other names for the regressors."""
        return self.each(lambda m: m, parameters=parameters)

    def embed(self, parameters: tuple[str, ...]) -> "NormalEquations":
        """The same equations among more parameters, with zeros for those that do not occur."""
        if missing := set(self.parameters) - set(parameters):
            raise ModelError(f"cannot leave out {sorted(missing)}; fix them instead.")
        index = jnp.array([0] + [1 + parameters.index(name) for name in self.parameters])
        size = 1 + len(parameters)

        def embedded(matrix: Array) -> Array:
            among = jnp.zeros((*matrix.shape[:-2], size, size), matrix.dtype)
            return among.at[..., index[:, None], index[None, :]].set(matrix)

        return self.each(embedded, parameters=parameters)

    def fix(self, known: Mapping[str, Array | float]) -> "NormalEquations":
        """The equations left when these parameters take these values: their columns join y.

        Names that do not occur here are ignored. Rows are not needed again, so that one set of
        normal equations serves every variant of what is known.
        """
        free = tuple(name for name in self.parameters if name not in known)
        # With y' = y - sum known_j a_j, the columns [y' A'] = [y A] T^T are a linear map of the old
        # ones, and so are their moments, T M T^T. In it y'^T y' is a difference of large numbers
        # where the known terms make up most of y, and loses as many digits as they share with it;
        # A'^T A' and the blocks' additivity are untouched.
        mix = jnp.zeros((1 + len(free), 1 + len(self.parameters)), self.moments.dtype)
        mix = mix.at[0, 0].set(1.0)
        for j, name in enumerate(self.parameters):
            if name in known:
                mix = mix.at[0, 1 + j].set(-jnp.asarray(known[name], mix.dtype))
            else:
                mix = mix.at[1 + free.index(name), 1 + j].set(1.0)
        return self.each(lambda matrix: mix @ matrix @ mix.T, parameters=free)

    @classmethod
    def of_rows(
        cls,
        rows: Rows,
        *,
        block_of_row: Int[Array, " rows"] | None = None,
        block_count: int = 1,
    ) -> "NormalEquations":
        """Those of rows, one for each of `block_count` blocks (leading axis)."""
        columns = rows.columns
        if block_of_row is None:
            return cls((columns @ columns.T)[None], rows.count()[None], rows.parameters)
        products = columns[:, None, :] * columns[None, :, :]
        moments = jax.ops.segment_sum(
            jnp.moveaxis(products, -1, 0), block_of_row, num_segments=block_count
        )
        valid = jnp.ones(columns.shape[1], bool) if rows.valid is None else rows.valid
        count = jax.ops.segment_sum(
            valid.astype(columns.dtype), block_of_row, num_segments=block_count
        )
        return cls(moments, count, rows.parameters)

    def residual_energy(self, theta: Float[Array, " p"]) -> Float[Array, "*blocks"]:
        """Sum of squared residuals at theta; below about 1e-16 of `energy` it is rounding."""
        return _energy(self.moments, theta)

    def noise_energy(self, theta: Float[Array, " p"]) -> Float[Array, "*blocks"]:
        """What sensor noise adds to `residual_energy` in expectation; 0 where none is known."""
        return jnp.zeros_like(self.energy) if self.noise is None else _energy(self.noise, theta)


def _energy(moments: Array, theta: Float[Array, " p"]) -> Array:
    v = jnp.concatenate([jnp.ones((1,), theta.dtype), -theta])
    return jnp.maximum(jnp.einsum("i,...ij,j->...", v, moments, v), 0.0)


def stack_normal_equations(parts: Sequence[NormalEquations], room: int = 0) -> NormalEquations:
    """Of one record after another, with empty blocks behind, up to as many as `room` or another."""
    most = max(room, *(part.count.shape[0] for part in parts))
    xp = namespace(parts)

    def filled_up(blocks: Array) -> Array:
        return xp.pad(blocks, [(0, most - blocks.shape[0])] + [(0, 0)] * (blocks.ndim - 1))

    noise = None
    if any(part.noise is not None for part in parts):
        each = [xp.zeros_like(p.moments) if p.noise is None else p.noise for p in parts]
        noise = xp.stack([filled_up(one) for one in each])
    return NormalEquations(
        xp.stack([filled_up(part.moments) for part in parts]),
        xp.stack([filled_up(part.count) for part in parts]),
        parts[0].parameters,
        noise,
    )


# Short blocks of time that sums are kept for, and longer ones made of them.

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

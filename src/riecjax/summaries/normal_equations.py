"""Normal equations: all that least squares needs to know of its rows, and additive."""

import functools
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from riecjax.criteria.criterion import AbstractCriterion, Rows
from riecjax.errors import ModelError
from riecjax.leaves import Leaf, namespace
from riecjax.records.record import Record

MOST_BLOCKS = 64
"""Blocks of a record at most: enough for a quantile of Student's t, and long blocks forgive errors
that stay correlated for long."""


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
    - `noise_of_source`: what each of the noise's sources adds to all blocks of a record, shape
      `(records, sources, 1 + p, 1 + p)`, as long as it is told apart.
    """

    moments: Float[Array, "*blocks columns columns"]
    count: Float[Array, "*blocks"]
    parameters: tuple[str, ...] = eqx.field(static=True)
    noise: Float[Array, "*blocks columns columns"] | None = None
    noise_of_source: Float[Array, "records sources columns columns"] | None = None

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

    def in_blocks(self, of_blocks: Callable[[Array], Array]) -> "NormalEquations":
        """The same with something done to the leading axes; sources are no longer told apart."""
        moments, count, noise = jax.tree.map(of_blocks, (self.moments, self.count, self.noise))
        return NormalEquations(moments, count, self.parameters, noise)

    def in_columns(self, of_matrix: Callable[[Array], Array], parameters: tuple[str, ...]) -> Self:
        """The same of other columns: something linear done to every matrix."""
        matrices = (self.moments, self.noise, self.noise_of_source)
        moments, noise, of_source = jax.tree.map(of_matrix, matrices)
        return replace(
            self, moments=moments, parameters=parameters, noise=noise, noise_of_source=of_source
        )

    def with_noise(self, noise: Array | None, of_source: Array | None = None) -> Self:
        """The same moments, of which this is noise."""
        return replace(self, noise=noise, noise_of_source=of_source)

    def __add__(self, other: "NormalEquations") -> "NormalEquations":
        if self.parameters != other.parameters:
            raise ModelError(
                f"normal equations of different parameters cannot be added: {self.parameters} and "
                f"{other.parameters}. Bring both to the same ones by `embed`."
            )
        pairs = ((self.noise, other.noise), (self.noise_of_source, other.noise_of_source))
        added = (
            mine if theirs is None else theirs if mine is None else mine + theirs
            for mine, theirs in pairs
        )
        moments, count = self.moments + other.moments, self.count + other.count
        return NormalEquations(moments, count, self.parameters, *added)

    def total(self) -> "NormalEquations":
        """The sum over the axis of blocks."""
        return self.in_blocks(lambda blocks: blocks.sum(0))

    def flattened(self) -> "NormalEquations":
        """The same with one leading axis for all that there are."""
        axes = self.count.ndim
        return self.in_blocks(lambda blocks: blocks.reshape(-1, *blocks.shape[axes:]))

    def merged(
        self, short: "ShortBlocks", used: Int[Array, " records"], most: int = MOST_BLOCKS
    ) -> "NormalEquations":
        """Those of longer blocks, of short ones with leading axes `(records, short blocks)`.

        **Arguments:** `used`, into how many each record's are added up.

        **Returns:** normal equations with one leading axis: `most` blocks of each record, of which
        those beyond `used` are empty. No block holds anything of two records.
        """
        return self.in_blocks(lambda values: sum_blocks(values, short, used, most))

    def embed(self, parameters: tuple[str, ...]) -> Self:
        """The same equations among more parameters, with zeros for those that do not occur."""
        if left_out := set(self.parameters) - set(parameters):
            raise ModelError(f"cannot leave out {sorted(left_out)}; fix them instead.")
        if parameters == self.parameters:
            return self
        # Behind the columns stands one of zeros, which is taken where a parameter does not occur.
        place = {name: 1 + j for j, name in enumerate(self.parameters)}
        index = np.array([0, *(place.get(name, 1 + len(place)) for name in parameters)])
        xp = namespace(self)

        def embedded(matrix: Array) -> Array:
            beside = [(0, 0)] * (matrix.ndim - 2) + [(0, 1), (0, 1)]
            return xp.pad(matrix, beside)[..., index[:, None], index[None, :]]

        return self.in_columns(embedded, parameters)

    def fix(self, known: Mapping[str, Array | float]) -> Self:
        """The equations left when these parameters take these values: their columns join y.

        Names that do not occur here are ignored. Rows are not needed again, so that one set of
        normal equations serves every variant of what is known.
        """
        free = [j for j, name in enumerate(self.parameters) if name not in known]
        # With y' = y - sum known_j a_j, the columns [y' A'] = [y A] T^T are a linear map of the old
        # ones, and so are their moments, T M T^T. In it y'^T y' is a difference of large numbers
        # where the known terms make up most of y, and loses as many digits as they share with it;
        # A'^T A' and the blocks' additivity are untouched.
        xp, dtype = namespace(self, known), self.moments.dtype
        target = [1.0, *(-known[name] if name in known else 0.0 for name in self.parameters)]
        target = xp.stack([xp.asarray(value, dtype) for value in target])
        regressors = np.eye(target.size, dtype=dtype)[[1 + j for j in free]]
        mix = xp.concatenate([target[None], regressors])
        names = tuple(self.parameters[j] for j in free)
        return self.in_columns(lambda matrix: mix @ matrix @ mix.T, names)

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


def sum_of_equations(
    equations: Sequence[NormalEquations], names: tuple[str, ...] | None = None
) -> NormalEquations:
    """A stage's normal equations: its equations' ones, residuals of all weighted alike.

    Among `names`, all that occur in order unless they are given.
    """
    if names is None:
        names = tuple(dict.fromkeys(name for one in equations for name in one.parameters))
    return functools.reduce(operator.add, (one.embed(names) for one in equations))


def stack_normal_equations(parts: Sequence[NormalEquations], room: int = 0) -> NormalEquations:
    """Of one record after another, with empty blocks behind, up to as many as `room` or another."""
    most = max(room, *(part.count.shape[0] for part in parts))
    xp = namespace(parts)

    def stacked(blocks: Sequence[Array], length: int) -> Array:
        behind = ([(0, length - b.shape[0])] + [(0, 0)] * (b.ndim - 1) for b in blocks)
        return xp.stack([xp.pad(b, pad) for b, pad in zip(blocks, behind)])

    noise = noise_of_source = None
    if any(part.noise is not None for part in parts):
        each = [xp.zeros_like(p.moments) if p.noise is None else p.noise for p in parts]
        noise = stacked(each, most)
    sources = [part.noise_of_source for part in parts if part.noise_of_source is not None]
    if sources:
        noise_of_source = stacked(sources, max(len(each) for each in sources))
    return NormalEquations(
        stacked([part.moments for part in parts], most),
        stacked([part.count for part in parts], most),
        parts[0].parameters,
        noise,
        noise_of_source,
    )


# Short blocks of time that sums are kept for, and longer ones made of them.

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


def sum_blocks(
    values: Float[Array, "records short *shape"],
    short: ShortBlocks,
    used: Int[Array, " records"],
    most: int = MOST_BLOCKS,
) -> Float[Array, "blocks *shape"]:
    """Sums over longer blocks of what is known of short ones; see [`NormalEquations.merged`][]."""
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

"""Normal equations: all that least squares needs to know of its rows, and additive."""

import dataclasses
import functools
import hashlib
import json
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Self, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int, Key, UInt32

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.criteria.criterion import AbstractCriterion, Rows
from riecjax.criteria.windows import LengthBins
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.equations.term import from_elsewhere
from riecjax.errors import ModelError
from riecjax.leaves import Leaf
from riecjax.records.record import Record
from riecjax.records.signal import Noise

MOST_BLOCKS = 64
"""Blocks of a record at most: enough for a quantile of Student's t, and long blocks forgive errors
that stay correlated for long."""


# Thousands of them are made and taken apart, which Equinox's modules are slow at.
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class NormalEquations:
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
    parameters: tuple[str, ...] = dataclasses.field(metadata={"static": True})
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

    def in_blocks(self, of_blocks: Callable[[Any], Leaf]) -> "NormalEquations":
        """The same with something done to the leading axes; sources are no longer told apart."""
        moments, count, noise = jax.tree.map(of_blocks, (self.moments, self.count, self.noise))
        return NormalEquations(moments, count, self.parameters, noise)

    def in_columns(self, of_matrix: Callable[[Array], Array], parameters: tuple[str, ...]) -> Self:
        """The same of other columns: something linear done to every matrix."""
        matrices = (self.moments, self.noise, self.noise_of_source)
        moments, noise, of_source = jax.tree.map(of_matrix, matrices)
        return dataclasses.replace(
            self, moments=moments, parameters=parameters, noise=noise, noise_of_source=of_source
        )

    def mixed(self, mix: Float[Array, "*blocks some columns"], parameters: tuple[str, ...]) -> Self:
        """The same of these combinations of columns, the first of which is the target."""
        return self.in_columns(lambda matrix: mix @ matrix @ xp.swapaxes(mix, -1, -2), parameters)

    def with_noise(self, noise: Leaf | None, of_source: Leaf | None = None) -> Self:
        """The same moments, of which this is noise."""
        return dataclasses.replace(self, noise=noise, noise_of_source=of_source)

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

        **Arguments:** `used`, into how many each record's are added up, `most` at most.

        **Returns:** normal equations with one leading axis: as many blocks of each record, see
        [`most_used`][], of which those beyond `used` are empty. No block holds anything of two
        records.
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
        dtype, size = self.moments.dtype, 1 + len(self.parameters)
        target = [1.0, *(-known[name] if name in known else 0.0 for name in self.parameters)]
        target = xp.stack(xp.broadcast_arrays(*target), axis=-1).astype(dtype)[..., None, :]
        regressors = np.eye(size, dtype=dtype)[[1 + j for j in free]]
        regressors = xp.broadcast_to(regressors, (*target.shape[:-2], *regressors.shape))
        mix = xp.concatenate([target, regressors], axis=-2)
        names = tuple(self.parameters[j] for j in free)
        return self.mixed(mix, names)

    @classmethod
    def of_rows(
        cls, rows: Rows, *, block_of_row: Int[Array, " rows"] | None = None, block_count: int = 1
    ) -> "NormalEquations":
        """Those of rows, one for each of `block_count` blocks (leading axis)."""
        columns = rows.columns
        if block_of_row is None:
            return cls((columns @ columns.T)[None], rows.count()[None], rows.parameters)
        valid = np.ones(columns.shape[1]) if rows.valid is None else rows.valid
        moments = xp.products_by_block(columns, block_of_row, block_count)
        count = xp.sum_by_block(valid.astype(columns.dtype), block_of_row, block_count)
        return cls(moments, count, rows.parameters)

    def residual_energy(self, theta: Float[Array, " p"]) -> Float[Array, "*blocks"]:
        """Sum of squared residuals at theta; below about 1e-16 of `energy` it is rounding."""
        return _energy(self.moments, theta)

    def noise_energy(self, theta: Float[Array, " p"]) -> Float[Array, "*blocks"]:
        """What sensor noise adds to `residual_energy` in expectation; 0 where none is known."""
        return xp.zeros_like(self.energy) if self.noise is None else _energy(self.noise, theta)


def _energy(moments: Array, theta: Float[Array, " p"]) -> Array:
    v = xp.concatenate([np.ones(1, theta.dtype), -theta])
    return xp.maximum(xp.einsum("i,...ij,j->...", v, moments, v), 0.0)


def sum_of_equations(
    equations: Sequence[NormalEquations], names: tuple[str, ...] | None = None
) -> NormalEquations:
    """A stage's normal equations: its equations' ones, residuals of all weighted alike.

    Among `names`, all that occur in order unless they are given.
    """
    if names is None:
        names = tuple(dict.fromkeys(name for one in equations for name in one.parameters))
    return functools.reduce(operator.add, (one.embed(names) for one in equations))


Sums = TypeVar("Sums", bound=NormalEquations)


def with_noise_alike(parts: Sequence[Sums]) -> Sequence[Sums]:
    """The same, with noise of zero beside those whose noise is known: nothing is taken off."""
    if all(part.noise is None for part in parts):
        return parts
    return [
        dataclasses.replace(part, noise=xp.zeros_like(part.moments)) if part.noise is None else part
        for part in parts
    ]


def stack_normal_equations(parts: Sequence[NormalEquations]) -> NormalEquations:
    """Of one record after another, with empty blocks behind, up to as many as another."""
    parts = with_noise_alike(parts)

    def stacked(name: str) -> Any:
        each = [blocks for part in parts if (blocks := getattr(part, name)) is not None]
        most = max((len(blocks) for blocks in each), default=0)
        behind = ([(0, most - len(b))] + [(0, 0)] * (b.ndim - 1) for b in each)
        return xp.stack([xp.pad(b, pad) for b, pad in zip(each, behind)]) if each else None

    return NormalEquations(
        stacked("moments"),
        stacked("count"),
        parts[0].parameters,
        stacked("noise"),
        stacked("noise_of_source"),
    )


# Short blocks of time that sums are kept for, and longer ones made of them.

FEWEST_WINDOWS = 2
"""Longest windows to a block at the least."""


class ShortBlocks(NamedTuple):
    """The blocks of start times that normal equations are kept for.

    **Fields:** `number` of blocks that hold each record, of the same or a longer axis of an
    array; `seconds` that a block of each record lasts; `longest_window`, seconds after which two
    rows share no data, 0 where none counts twice.
    """

    number: Int[Leaf, " records"]
    seconds: Float[Leaf, " records"]
    longest_window: Leaf | float = 0.0

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
    each = xp.maximum(xp.round(xp.divide(length, short.seconds)), 1)
    most = xp.minimum(short.number, MOST_BLOCKS)
    return xp.clip(short.number // each, 2, most).astype(np.int32)


def most_used(used: Int[Array, " records"], most: int = MOST_BLOCKS) -> int:
    """Room for blocks of each record: for as many as any uses, if that is known."""
    return most if xp.is_traced(used) else int(np.max(used))


def sum_blocks(
    values: Float[Array, "records short *shape"],
    short: ShortBlocks,
    used: Int[Array, " records"],
    most: int = MOST_BLOCKS,
) -> Float[Array, "blocks *shape"]:
    """Sums over longer blocks of what is known of short ones; see [`NormalEquations.merged`][]."""
    number, most = short.number[:, None], most_used(used, most)
    place = np.arange(values.shape[1])[None, :]
    # What is left over is spread, so that no last block is shorter than the others.
    group = xp.where(place < number, place * used[:, None] // number, most)
    every = most * group.shape[0]
    group = xp.where(group < most, group + most * np.arange(group.shape[0])[:, None], every)
    return xp.sum_by_block(values.reshape(-1, *values.shape[2:]), group.ravel(), every)


def short_blocks(records: Sequence[Record], criterion: AbstractCriterion) -> ShortBlocks:
    """The short blocks of each record that normal equations are kept for."""
    samples = [criterion.block_samples(record) for record in records]
    return ShortBlocks(
        np.array([-(-record.sample_count // k) for record, k in zip(records, samples)]),
        xp.stack([xp.multiply(k, record.time_step) for record, k in zip(records, samples)]),
        criterion.block_length,
    )


# What one recording says of each equation, kept as sums.


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Survey:
    """What only a check and figures ask for.

    **Fields:**

    - `noise`: mean outer product of what the signals' noise adds to a row, shape
      `(1 + p, 1 + p)`.
    - `quadrature`: outer products, summed, of the differences from rows integrated with the highest
      order, and of these, shape `(2, 1 + p, 1 + p)`; zero where there is no higher order.
    - `rows`: some of the rows, shape `(rows, 1 + p)`, and `start`, seconds from the recording's
      first sample to their windows, shape `(rows,)`.
    - `reach`: for each term with a basis, its prefix, least and largest argument.
    """

    noise: Float[Leaf, "columns columns"]
    quadrature: Float[Leaf, "2 columns columns"]
    rows: Float[Leaf, "rows columns"]
    start: Float[Leaf, " rows"]
    reach: dict[str, Float[Leaf, "2"]]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class EquationSums(NormalEquations):
    """Normal equations of one equation on one recording, over windows by bins of their lengths.

    Leading axes are `(bins, blocks)`, blocks those of time in which windows start, and of
    `noise_of_source` they are `(bins, sources)`.

    **Further fields:**

    - `survey`: `None` unless it was asked for.
    - `factor`: triangular factor of all rows, shape `(1 + p, 1 + p)`, where rows are so nearly
      collinear that their moments lose too many digits; else `None`.
    - `constant`: products of the rows of a column that is 1 throughout with its own rows, the
      target's and the regressors', of shape `(bins, blocks, 2 + p)`: what tells means from motion.
      `None` where rows were summed under `jit` or `vmap`, or combined afterwards.
    """

    survey: Survey | None = None
    factor: Float[Leaf, "columns columns"] | None = None
    constant: Float[Leaf, "bins blocks 1+columns"] | None = None

    def each(
        self, of_sums: Callable[[Leaf], Leaf], **others: Callable[[Leaf], Leaf | None]
    ) -> Self:
        """The same done to all sums by bins and blocks, and what is said of `others` by name."""
        by_name = dict.fromkeys(("moments", "count", "noise", "constant"), of_sums) | others
        there = {name: getattr(self, name) for name in by_name}
        changed = {n: by_name[n](leaf) for n, leaf in there.items() if leaf is not None}
        return dataclasses.replace(self, **changed)

    def of_bins(self, first: int, last: int) -> Self:
        """The sums of some bins of lengths, first and one beyond the last, in one."""

        def together(bins: Leaf) -> Leaf:
            return bins[first:last].sum(0, keepdims=True)

        return self.each(together, noise_of_source=together)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class RecordingSums:
    """Sums of all equations on one recording.

    **Fields:**

    - `stages`: equations of each stage of the model.
    - `blocks`: how many short blocks of time hold the recording; arrays may be longer.
    - `block_seconds`: that each of them lasts.
    - `offered`: rows there would be of one equation without gaps and masks; NaN if not known.
    - `samples`, `time_step`: of the recording.
    - `digest`: SHA-256 of its content and of all settings, zero where it was summed under `jit`.
    - `noise` of the recording's signals.
    """

    stages: tuple[tuple[EquationSums, ...], ...]
    blocks: Int[Leaf, ""]
    block_seconds: Float[Leaf, ""]
    offered: Float[Leaf, ""]
    samples: Int[Leaf, ""]
    time_step: Float[Leaf, ""]
    digest: UInt32[Leaf, "8"]
    noise: Noise = dataclasses.field(default_factory=Noise)

    def of_blocks(self, index: Int[np.ndarray, " blocks"]) -> "RecordingSums":
        """The sums of some of the blocks (not under jit)."""
        if index.size == int(self.blocks):
            return self

        # A factor of all rows has no parts, and what one source adds is spread evenly.
        share = index.size / int(self.blocks)
        some = self.each(
            lambda leaf: np.asarray(leaf[:, index], order="C"),
            noise_of_source=lambda leaf: share * leaf,
            factor=lambda _: None,
        )
        # Rows are not spread evenly over blocks, so that it is not known how many were offered.
        return dataclasses.replace(some, blocks=np.asarray(index.size), offered=np.asarray(np.nan))

    def in_blocks(self, most: int) -> "RecordingSums":
        """The same in so many blocks of time at most, neighbours added up (not under jit)."""
        held = int(self.blocks)
        if held <= most:
            return self
        first = -(-np.arange(most) * held // most)
        seconds = float(self.blocks) * float(self.block_seconds)
        return dataclasses.replace(
            self.each(lambda leaf: np.add.reduceat(np.asarray(leaf), first, axis=1)),
            blocks=np.asarray(most),
            block_seconds=np.asarray(seconds / most),
        )

    def each(self, *of_sums: Any, **others: Any) -> "RecordingSums":
        """The same done to the sums of every equation, see [`EquationSums.each`][]."""
        stages = (tuple(sums.each(*of_sums, **others) for sums in stage) for stage in self.stages)
        return dataclasses.replace(self, stages=tuple(stages))

    def of_bins(self, first: int, last: int) -> "RecordingSums":
        """The sums of some bins of lengths, first and one beyond the last, in one."""
        stages = (tuple(sums.of_bins(first, last) for sums in stage) for stage in self.stages)
        return dataclasses.replace(self, stages=tuple(stages))

    def scaled(self, factor: float) -> "RecordingSums":
        """Sums times a factor; triangular factors, whose squares are sums, times its root."""
        root = xp.sqrt(factor)

        def times(leaf: Leaf) -> Leaf:
            return leaf * factor

        scaled = self.each(times, noise_of_source=times, factor=lambda rows: rows * root)
        return dataclasses.replace(scaled, offered=self.offered * factor)


# What tells recordings and models apart: digests of all that sums depend on.


class Outline(eqx.Module):
    """The equations that recordings are summed for, as far as sums depend on them.

    **Fields:** `stages`, each equation's name and its columns; `parameters`, the columns but for
    those that hidden elements add; `units` by parameter; `fingerprint` of the equations' terms,
    empty where their numbers were traced.
    """

    stages: tuple[tuple[tuple[str, tuple[str, ...]], ...], ...] = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True)
    units: tuple[tuple[str, str], ...] = eqx.field(static=True)
    fingerprint: str = eqx.field(static=True)

    @classmethod
    def of(cls, model: Model) -> "Outline":
        """Of a model."""
        stages = tuple(tuple((e.name, e.parameters) for e in stage) for stage in model.stages)
        fingerprint = ""
        if xp.is_concrete(model):
            equations = [[_described(e) for e in stage] for stage in model.stages]
            written = json.dumps(equations, sort_keys=True, default=_without_address)
            fingerprint = hashlib.sha256(written.encode()).hexdigest()
        columns = (c for e in model.equations for t in e.terms for c in t.columns)
        parameters = tuple(dict.fromkeys(c.name for c in columns if not c.order))
        return cls(stages, parameters, tuple(model.units.items()), fingerprint)

    def is_of(self, other: "Outline") -> bool:
        """Whether both are of the same equations, as far as that is known."""
        known = bool(self.fingerprint and other.fingerprint)
        return self.stages == other.stages and (not known or self.fingerprint == other.fingerprint)


def digest_of(
    model: Model,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    bins: LengthBins | None,
) -> UInt32[np.ndarray, "8"]:
    """SHA-256 of a recording's samples and of all settings (not under jit).

    Functions of the signals count by their name and what they were compiled to, so that other
    versions of Python may tell recordings apart that are the same.
    """
    digest = hashlib.sha256()
    masks = {n: s.present for n, s in record.by_name.items() if s.present is not None}
    for arrays in (record.arrays, {name: ~np.asarray(mask) for name, mask in masks.items()}):
        for name, values in sorted(arrays.items()):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(values).data)
    settings = {
        "time_step": float(record.time_step),
        "criterion": criterion.describe(),
        "equations": [[_described(e) for e in stage] for stage in model.stages],
        "key": None if key is None else jax.random.key_data(key).tolist(),
        "bins": None if bins is None else bins.edges.tolist(),
        "noise": jax.tree.map(lambda taps: np.asarray(taps).tolist(), record.noise.kernels),
    }
    digest.update(json.dumps(settings, sort_keys=True, default=_without_address).encode())
    return np.frombuffer(digest.digest(), ">u4").astype(np.uint32)


def _described(equation: Equation) -> list[object]:
    """What an equation's sums depend on, as far as it has a name, a number or code."""
    return [equation.name, [_written(term) for term in equation.terms], _function(equation.where)]


def _written(value: Any) -> object:
    """A term, or a part of it, field by field. What is known of a coefficient moves no sum."""
    if isinstance(value, eqx.Module):
        fields = [field.name for field in dataclasses.fields(value)]
        parts = {name: getattr(value, name) for name in fields if name not in ("known", "unit")}
        written = {name: _written(part) for name, part in parts.items()}
        # Methods of a class from elsewhere; the name of this package's says which they are.
        kind, held = type(value), (vars(kind) for kind in from_elsewhere(type(value)))
        names = {name for own in held for name in own if not name.startswith(("__", "_abc"))}
        methods = [getattr(kind, name) for name in sorted(names)]
        return [kind.__name__, written, *(_function(getattr(m, "fget", m)) for m in methods)]
    if eqx.is_array(value):
        return np.asarray(value).tolist()
    return _function(value) if callable(value) else value


def _function(expression: str | Callable | None) -> object:
    """A signal's name, or a function's name with its code and what that refers to."""
    code = getattr(expression, "__code__", None)
    if code is None:
        return expression
    cells = [cell.cell_contents for cell in getattr(expression, "__closure__", None) or ()]
    constants = [value for value in code.co_consts if not hasattr(value, "co_code")]
    return [code.co_name, code.co_code.hex(), constants, list(code.co_names), cells]


def _without_address(value: object) -> str:
    """What is printed of an object but for where it lies in memory: elsewhere in other processes,
    which would then count a recording that two of them summed as two."""
    return re.sub(r" at 0x[0-9a-fA-F]+", "", str(value))

"""What one part of a recording says of each equation: the compiled half of the one pass.

Every equation's columns are sampled once, chunk by chunk, and sums over blocks of starts are made
of them: moments of all windows, rows averaged by hats, activity of terms, and, on request, a survey
for checks and figures. How a recording is cut into parts is the other half's, `one_pass`.
"""

# What the signals' noise adds to a row has no formula, since terms may be any expressions of the
# signals. So it is measured: white noise of each signal's level is added to the samples, and the
# columns without it are subtracted. The difference is exact where terms are linear in the signals,
# and right to first order in the noise where they are not.

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from riecjax.compilation import kept_jit
from riecjax.criteria.chunks import ROUND, StartBlocks, in_chunks
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.laws import LagBins
from riecjax.criteria.rows import Rows
from riecjax.criteria.windows import WindowSet
from riecjax.equations.dry_friction import InMotion
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import evaluate
from riecjax.equations.noisy_columns import Columns, NoisyColumns, sampled_columns
from riecjax.equations.procedure import Procedure
from riecjax.equations.term import Terms
from riecjax.records.record import Record
from riecjax.summaries.averages import activity, averaged_rows, thinned, underived
from riecjax.summaries.stage_sums import moments_of_drawn

PART = 2**17
"""Starts to a part of a long recording."""
FILLED = (2**12, 2**15)
"""Samples that shorter recordings are filled up to."""
NOISE = np.random.default_rng(0).standard_normal(2**16)
"""White noise of unit size, which is sent through the equations."""
APART = 9973
"""Samples between where two signals begin to take their noise."""
SELDOM = 8
"""Chunks of a record of which one tells what noise adds to averaged rows."""
Noise = Callable[[], Columns]
"""What noise adds to an equation's columns, evaluated only where it is asked for."""


class Lengths(NamedTuple):
    """Window lengths whose sums are kept apart: bins by the first axis.

    **Fields:** `lags`, the law in each bin; `reach`, no window of them is longer in samples.
    """

    lags: LagBins
    reach: int


class Request(NamedTuple):
    """What to sum, as far as it is compiled in.

    **Fields:** `block`, starts to a short block (a traced number where blocks are shorter than the
    longest window, or rows are drawn); `blocks` of an array; in each, rows that are `averaged`, of
    means of `thin` samples, none of expanded columns, and those that are `surveyed`, none unless a
    survey is asked for.
    """

    block: Int[Array, ""] | int
    blocks: int
    thin: int
    averaged: int
    surveyed: int


class Part(NamedTuple):
    """Samples of a recording, filled up behind, and which of its starts are summed here.

    **Fields:** `record`; `first` of the starts; `held`, samples that are the recording's (`None`:
    all of them, a number that is compiled in).
    """

    record: Record
    first: Int[Array, ""] | int
    held: Int[Array, ""] | None


class PartSums(NamedTuple):
    """What a part says of one equation, by blocks of starts.

    **Fields:** `moments`, sums, numbers of windows and what noise adds to the sums, then by bins;
    and by chunk what each source of noise adds, then by bins; `averaged` rows with a leading one,
    zero where there is none, and `noise`, outer products of what noise adds to these; `activity`,
    an `Activity` of each chunk; `survey`.
    """

    moments: tuple["BlockSums", ...]
    averaged: Float[Array, "blocks rows 2+p"]
    noise: Float[Array, "blocks 2+p 2+p"]
    activity: Any
    survey: "Surveyed | None"


class BlockSums(NamedTuple):
    """Sums over windows of some lengths, blocks first (of `of_source` chunks) and then bins."""

    moments: Array
    number: Array
    noise: Array | None
    of_source: Array | None


class Surveyed(NamedTuple):
    """Rows of some windows in each block, and where they start; the same by the finest quadrature,
    and what noise adds to them; least and largest argument of each basis."""

    rows: Float[Array, "blocks rows columns"]
    finer: Float[Array, "blocks rows columns"]
    noise: Float[Array, "blocks rows columns"]
    start: Float[Array, "blocks rows"]
    valid: Bool[Array, "blocks rows"]
    reach: dict[str, Float[Array, "1 2"]]


@kept_jit
def of_all_windows(
    procedure: Procedure,
    criterion: AbstractCriterion,
    part: Part,
    lengths: tuple[Lengths, ...],
    half: Int[Array, ""],
    band: tuple[Int[Array, ""], Int[Array, ""]],
    request: Request,
) -> list[list[PartSums]]:
    """What blocks of starts of a part say of each equation of each stage, where windows are summed.

    **Arguments:** `half` a hat's length in samples; `band`, shortest and longest lag of the law.
    """

    def equation_sums(
        equation: Equation, noisy: NoisyColumns, noise: Noise, record: Record, blocks: StartBlocks
    ) -> PartSums:
        columns = noisy.columns
        moments = tuple(_in_blocks(criterion, noisy, record, which, blocks) for which in lengths)
        sums = _part_sums(columns, noise, record, blocks, half, request, None, moments)
        if not request.surveyed:
            return sums
        windows = _some_windows(criterion, blocks, band, request.surveyed)
        survey = _surveyed(criterion, equation, columns, noise, windows, record, blocks)
        return sums._replace(survey=survey)

    return _in_chunks(procedure, criterion, part, equation_sums, lengths[-1].reach, request)


def _in_blocks(
    criterion: AbstractCriterion,
    noisy: NoisyColumns,
    record: Record,
    lengths: Lengths,
    blocks: StartBlocks,
) -> BlockSums:
    """Moments and numbers of windows of some lengths, and what noise adds.

    The closed form sums the windows that start in a block from running sums over the block and its
    reach, so that a block shorter than a window costs as much as one as long. Where windows are
    longer, neighbouring blocks are summed as one, and the first of them holds the sums.
    """
    size, wider = blocks.size, 1
    if isinstance(size, int):
        while wider * size < lengths.reach and blocks.number % (2 * wider) == 0:
            wider *= 2
        blocks = blocks._replace(size=wider * size, number=blocks.number // wider)

    def spread(sums: Array) -> Array:
        apart = jnp.swapaxes(sums, 0, 1)[:, None]
        behind = [(0, 0), (0, wider - 1)] + [(0, 0)] * (apart.ndim - 2)
        return jnp.pad(apart, behind).reshape(-1, *apart.shape[2:])

    found = criterion.moments_of(noisy.columns, lengths.lags, blocks, lengths.reach)
    noise = criterion.noise_of(noisy, record.noise, lengths.lags, blocks, lengths.reach)
    if noise is None:
        return BlockSums(spread(found[0]), spread(found[1]), None, None)
    return BlockSums(spread(found[0]), spread(found[1]), spread(noise.total), noise.of_source[None])


@kept_jit
def of_rows(
    procedure: Procedure,
    criterion: AbstractCriterion,
    part: Part,
    key: Key[Array, ""] | None,
    half: Int[Array, ""],
    request: Request,
) -> list[list[PartSums]]:
    """The same where a criterion has single rows: each sample's, or of windows that are drawn."""
    drawn = criterion.draw(part.record, key, part.held)

    def equation_sums(
        equation: Equation, noisy: NoisyColumns, noise: Noise, record: Record, blocks: StartBlocks
    ) -> PartSums:
        columns = noisy.columns
        sums, added = moments_of_drawn(criterion, noisy, record, drawn, blocks)
        of_noise = (None, None)
        if added is not None:
            of_noise = added.total[:, None], added.of_source[None, None]
        moments = (BlockSums(sums[0][:, None], sums[1][:, None], *of_noise),)
        bare = None if criterion.smoothness else underived(equation)
        sums = _part_sums(columns, noise, record, blocks, half, request, bare, moments)
        if not request.surveyed:
            return sums
        every = WindowSet(drawn.start[None], drawn.stop[None])
        survey = _surveyed(criterion, equation, columns, noise, every, record, blocks)
        return sums._replace(survey=survey)

    return _in_chunks(procedure, criterion, part, equation_sums, 0, request)


@kept_jit
def all_rows(
    procedure: Procedure, criterion: AbstractCriterion, part: Part, key: Key[Array, ""] | None
) -> list[list[Rows]]:
    """Every row of each equation of each stage."""
    drawn = criterion.draw(part.record, key, part.held)

    def rows(equation: Equation) -> Rows:
        columns = sampled_columns(equation, part.record, criterion.smoothness)
        return criterion.rows_of(columns, drawn, part.held)

    return [[rows(equation) for equation in stage] for stage in procedure.stages]


def _in_chunks(
    procedure: Procedure,
    criterion: AbstractCriterion,
    part: Part,
    equation_sums: Callable[[Equation, NoisyColumns, Noise, Record, StartBlocks], PartSums],
    reach: int,
    request: Request,
) -> list[list[PartSums]]:
    def of_chunk(record: Record, blocks: StartBlocks) -> list[list[PartSums]]:
        # Every survey has noisy rows: what they are made of is evaluated once, for all.
        disturbed = _disturbed(record) if request.surveyed else None

        def of_equation(equation: Equation) -> PartSums:
            noisy = criterion.noisy_columns(equation, record)
            noise = partial(_added_by_noise, equation, record, disturbed, criterion.smoothness)
            if request.surveyed:
                added = noise()
                noise = lambda: added  # noqa: E731
            return equation_sums(equation, noisy, noise, record, blocks)

        return [[of_equation(equation) for equation in stage] for stage in procedure.stages]

    block = request.block
    if not isinstance(block, int):
        held = part.record.sample_count if part.held is None else part.held
        return of_chunk(part.record, StartBlocks(part.first, block, request.blocks, held))
    return in_chunks(
        part.record,
        of_chunk,
        block=block,
        reach=reach,
        margin=criterion.test_function.margin,
        unpadded=part.held,
        first=part.first,
        number=request.blocks,
    )


def _part_sums(
    columns: Columns,
    noise: Noise,
    record: Record,
    blocks: StartBlocks,
    half: Int[Array, ""],
    request: Request,
    bare: np.ndarray | None,
    moments: tuple[BlockSums, ...],
) -> PartSums:
    thin, each = request.thin, request.averaged
    size = 2 + len(columns.parameters)
    nothing = jnp.zeros((blocks.number, size, size), columns.values.dtype)
    start = blocks.first + blocks.size * jnp.arange(blocks.number)[:, None]
    centres = (start + (jnp.arange(each) * blocks.size // each)[None, :] + half).ravel()

    def averaged(of: Columns) -> Float[Array, "blocks rows 2+p"]:
        rows, valid = averaged_rows(
            thinned(of, thin), (half + thin // 2) // thin, centres // thin, blocks.unpadded // thin
        )
        rows = jnp.pad(rows, ((0, 0), (1, 0)), constant_values=1.0)
        rows = jnp.where(valid[:, None], rows, 0.0)
        return rows.reshape(blocks.number, each, -1)

    def noise_gram() -> Float[Array, "blocks 2+p 2+p"]:
        added = averaged(noise())
        return jnp.einsum("bri,brj->bij", added, added)

    chunk = jnp.round(record.skipped / record.time_step / ROUND).astype(int)
    added = nothing
    if each:
        added = jax.lax.cond(chunk % SELDOM == 0, noise_gram, lambda: nothing)
    at = jnp.arange(columns.sample_count)
    there = (at >= blocks.first) & (at < blocks.first + blocks.size * blocks.number)
    there = there & (at < blocks.unpadded)
    there = there if columns.present is None else there & columns.present
    acts = activity(columns, there, bare)
    return PartSums(
        moments,
        averaged(columns) if each else nothing[:, :0],
        added,
        jax.tree.map(lambda leaf: leaf[None], acts),
        None,
    )


def _some_windows(
    criterion: AbstractCriterion,
    blocks: StartBlocks,
    band: tuple[Int[Array, ""], Int[Array, ""]],
    each: int,
) -> WindowSet:
    """Windows in each block, at places and of lengths that are drawn once for all."""
    place, length = np.random.default_rng(1).random((2, blocks.number, each))
    shortest, longest = band
    start = blocks.first + blocks.size * jnp.arange(blocks.number)[:, None]
    start = start + (place * blocks.size).astype(int)
    lag = shortest + (length * (longest - shortest + 1)).astype(int)
    return WindowSet(start, start + criterion.test_function.length_multiple * lag)


def _surveyed(
    criterion: AbstractCriterion,
    equation: Equation,
    columns: Columns,
    noise: Noise,
    windows: WindowSet,
    record: Record,
    blocks: StartBlocks,
) -> Surveyed:
    shape = windows.start.shape
    last = columns.sample_count - 1
    inside = (windows.stop < blocks.unpadded).ravel()
    flat = WindowSet(*(jnp.minimum(jnp.maximum(at, 0), last).ravel() for at in windows))

    def rows(of: Columns, by: AbstractCriterion) -> tuple[Array, Array]:
        found = by.rows_of(of, flat, blocks.unpadded)
        valid = inside if found.valid is None else inside & found.valid
        values = jnp.where(valid[:, None], found.columns.T, 0.0)
        return values.reshape(*shape, -1), valid.reshape(shape)

    values, valid = rows(columns, criterion)
    finer = criterion.finest()
    at = jnp.clip(jnp.floor(flat.start).astype(int), 0, last)
    return Surveyed(
        values,
        values if finer is criterion else rows(columns, finer)[0],
        rows(noise(), criterion)[0],
        record.elapsed[at].reshape(shape),
        valid,
        {name: reach[None] for name, reach in _reaches(equation, record, blocks.unpadded).items()},
    )


def _reaches(
    equation: Equation, record: Record, held: Int[Array, ""] | int
) -> dict[str, Float[Array, "2"]]:
    """Least and largest argument of each basis."""
    real = jnp.arange(record.sample_count) < held
    found = {}
    for term in equation.terms:
        term = term.term if isinstance(term, InMotion) else term
        if isinstance(term, Terms):
            argument, _ = evaluate(term.of, record)
            low = jnp.min(argument, where=real, initial=jnp.inf)
            found[term.prefix] = jnp.stack([low, jnp.max(argument, where=real, initial=-jnp.inf)])
    return found


def _added_by_noise(
    equation: Equation, record: Record, disturbed: Record | None, smoothness: int
) -> Columns:
    """What noise of its signals' sizes adds to an equation's columns."""
    noisy = sampled_columns(equation, disturbed or _disturbed(record), smoothness)
    return noisy - sampled_columns(equation, record, smoothness)


def _disturbed(record: Record) -> Record:
    """The record with white noise of its size on each signal; any stretch has the same."""
    first = jnp.round(record.skipped / record.time_step).astype(int)
    place = first + jnp.arange(record.sample_count)
    names = sorted(record.arrays)
    each = (place[None, :] + APART * np.arange(len(names))[:, None]) % NOISE.size
    sizes = jnp.stack([jnp.asarray(record.noise.std(name)) for name in names])
    noise = sizes[:, None] * jnp.asarray(NOISE, record.time_step.dtype)[each]
    added = {name: record.arrays[name] + own for name, own in zip(names, noise)}
    return record.with_signals(added, missing=record.missing)

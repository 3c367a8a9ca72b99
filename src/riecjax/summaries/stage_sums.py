"""What a model's equations make of records: sums of its equations, or of its stages.

Equations of a stage, records and blocks of time add up, so that one table of moments for each
equation, record and short block is all that needs to be kept.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from riecjax.compilation import kept_jit
from riecjax.criteria.chunks import StartBlocks, in_chunks
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.windows import WindowSet
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.equations.noisy_columns import Columns, NoisyColumns
from riecjax.records.record import Record
from riecjax.summaries.normal_equations import NormalEquations, short_blocks, sum_of_equations
from riecjax.summaries.sums import EquationSums, RecordingSums


@eqx.filter_jit
def stage_normal_equations(
    model: Model,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    *,
    blocks: bool = False,
) -> list[NormalEquations]:
    """Normal equations of each stage on one record.

    With `blocks`, the leading axis is one of short blocks of start times, each of
    `criterion.block_samples(record)` samples; without, and unless all windows are summed, it has
    length one.
    """
    parts = _of_equations(model, record, criterion, key, blocks)
    return [sum_of_equations(stage, names) for stage, names in zip(parts, model.stage_parameters)]


def traced_sums(
    model: Model,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    apart: bool = False,
) -> RecordingSums:
    """Moments of one record, for code that is traced: shapes are those of the record.

    `apart`: windows of each length by themselves, where the test function asks for that.
    """
    parts = _of_equations_compiled(model, record, criterion, key, True, apart)

    if not apart:
        parts = jax.tree.map(lambda leaf: leaf[None], parts)
    stages = tuple(
        tuple(
            EquationSums(e.moments, e.count, e.parameters, e.noise, e.noise_of_source)
            for e in stage
        )
        for stage in parts
    )
    offered = criterion.row_count(record)
    short = short_blocks([record], criterion)
    return RecordingSums(
        stages,
        short.number[0],
        short.seconds[0],
        np.asarray(np.nan if offered is None else float(offered)),
        np.asarray(record.sample_count),
        record.time_step,
        np.zeros(8, np.uint32),
        record.noise,
    )


def _of_equations(
    model: Model,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    blocks: bool,
    apart: bool = False,
) -> list[list[NormalEquations]]:
    samples = criterion.block_samples(record) if blocks else record.sample_count
    count = -(-record.sample_count // samples)

    # Rows of a stage's equations are summed, never interleaved: one Gram matrix per equation.
    def of(equation: Equation) -> NormalEquations:
        if criterion.in_closed_form:
            return moments_of_all(criterion, equation, record, apart)
        drawn = criterion.draw(record, key)
        cut = StartBlocks(0, jnp.asarray(samples), count, record.sample_count)
        noisy = criterion.noisy_columns(equation, record)
        return moments_of_drawn(criterion, noisy, drawn, cut)

    return [[of(equation) for equation in stage] for stage in model.stages]


def moments_of_all(
    criterion: AbstractCriterion, equation: Equation, record: Record, apart: bool
) -> NormalEquations:
    """Sums over all windows, for blocks of starts; `apart`, of each of the law's lengths along a
    leading axis."""
    assert criterion.windows is not None
    windows, weight, n = criterion.windows.every, criterion.test_function, record.sample_count
    lags, reach = criterion.law(record), windows.reach(n)
    if apart:
        lags = jax.tree.map(lambda leaf: leaf[:, None], lags)

    def flipped(sums: Any) -> Any:
        return jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), sums) if apart else sums

    def of_chunk(part: Record, blocks: StartBlocks) -> Any:
        noisy = criterion.noisy_columns(equation, part)

        def products(columns: Columns) -> Array:
            return weight.moments(columns, lags, blocks, reach)[0]

        noise = criterion.noise_of(noisy, lags, blocks, products)
        moments = weight.moments(noisy.columns, lags, blocks, reach)
        total, of_source = (None, None) if noise is None else (noise.total, noise.of_source[None])
        return flipped((*moments, total)), of_source

    block, margin = windows.block(n), weight.margin
    sums, of_source = in_chunks(record, of_chunk, block=block, reach=reach, margin=margin)
    moments, number, total = flipped(sums)
    of_source = None if of_source is None else of_source.sum(0)
    return NormalEquations(moments, number, equation.parameters, total, of_source)


def moments_of_drawn(
    criterion: AbstractCriterion,
    noisy: NoisyColumns,
    drawn: WindowSet,
    blocks: StartBlocks,
) -> NormalEquations:
    """Sums over rows of single windows or samples, for blocks of starts."""
    place = (drawn.start / blocks.size).astype(jnp.int32)
    place = jnp.clip(place, 0, blocks.number - 1) if blocks.number > 1 else None

    def sums(columns: Columns) -> NormalEquations:
        rows = criterion.rows_of(columns, drawn, blocks.unpadded)
        return NormalEquations.of_rows(rows, block_of_row=place, block_count=blocks.number)

    noise = criterion.noise_of(noisy, drawn, blocks, lambda c: sums(c).moments)
    found = sums(noisy.columns)
    return found if noise is None else found.with_noise(noise.total, noise.of_source)


_of_equations_compiled = kept_jit(_of_equations)

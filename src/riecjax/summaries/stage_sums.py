"""What a model's equations make of records: sums of its equations, or of its stages.

Equations of a stage, records and blocks of time add up, so that one table of moments for each
equation, record and short block is all that needs to be kept.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from riecjax.compilation import kept_jit
from riecjax.criteria.all_windows import Moments
from riecjax.criteria.chunks import StartBlocks
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.noise_moments import NoiseMoments
from riecjax.criteria.windows import WindowSet
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.equations.noisy_columns import Columns, NoisyColumns
from riecjax.records.record import Record
from riecjax.summaries.normal_equations import NormalEquations, short_blocks
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
    return [
        sum_of_equations([equations for equations, _ in stage], names)
        for stage, names in zip(parts, model.stage_parameters)
    ]


def sum_of_equations(equations: list[NormalEquations], names: tuple[str, ...]) -> NormalEquations:
    """A stage's normal equations: its equations' ones, residuals of all weighted alike."""
    total = equations[0].embed(names)
    for further in equations[1:]:
        total = total + further.embed(names)
    return total


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

    def in_bins(leaf: Array) -> Array:
        return leaf if apart else leaf[None]

    stages = tuple(
        tuple(
            EquationSums(
                in_bins(e.moments),
                in_bins(e.count),
                None,
                None,
                e.parameters,
                *(map(in_bins, (noise.total, noise.of_source)) if noise else (None, None)),
            )
            for e, noise in stage
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
) -> list[list[tuple[NormalEquations, NoiseMoments | None]]]:
    samples = criterion.block_samples(record) if blocks else record.sample_count
    count = -(-record.sample_count // samples)

    # Rows of a stage's equations are summed, never interleaved: one Gram matrix per equation.
    def of(equation: Equation) -> tuple[NormalEquations, NoiseMoments | None]:
        names = equation.parameters
        if criterion.in_closed_form:
            (moments, number), noise = criterion.sums(equation, record, apart)
        else:
            drawn = criterion.draw(record, key)
            cut = StartBlocks(0, jnp.asarray(samples), count, record.sample_count)
            noisy = criterion.noisy_columns(equation, record)
            (moments, number), noise = moments_of_drawn(criterion, noisy, record, drawn, cut)
        total = None if noise is None else noise.total
        return NormalEquations(moments, number, names, total), noise

    return [[of(equation) for equation in stage] for stage in model.stages]


def moments_of_drawn(
    criterion: AbstractCriterion,
    noisy: NoisyColumns,
    record: Record,
    drawn: WindowSet,
    blocks: StartBlocks,
) -> tuple[Moments, NoiseMoments | None]:
    """Sums over rows of single windows or samples, for blocks of starts, and what noise adds."""
    place = (drawn.start / blocks.size).astype(jnp.int32)
    place = jnp.clip(place, 0, blocks.number - 1) if blocks.number > 1 else None

    def sums(columns: Columns) -> Moments:
        rows = criterion.rows_of(columns, drawn, blocks.unpadded)
        found = NormalEquations.of_rows(rows, block_of_row=place, block_count=blocks.number)
        return found.moments, found.count

    noise = criterion.noise_of(noisy, record.noise, drawn, blocks, lambda c: sums(c)[0])
    return sums(noisy.columns), noise


_of_equations_compiled = kept_jit(_of_equations)

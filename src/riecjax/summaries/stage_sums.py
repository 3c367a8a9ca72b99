"""What a procedure's equations make of records: sums of its equations, or of its stages.

Equations of a stage, records and blocks of time add up, so that one table of moments for each
equation, record and short block is all that needs to be kept.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import Procedure
from riecjax.records.record import Record
from riecjax.summaries.blocks import short_blocks
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.sums import EquationSums, RecordingSums


@eqx.filter_jit
def stage_normal_equations(
    procedure: Procedure,
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
    parts = _of_equations(procedure, record, criterion, key, blocks)
    return [
        sum_of_equations(equations, names)
        for equations, names in zip(parts, procedure.stage_parameters)
    ]


def sum_of_equations(equations: list[NormalEquations], names: tuple[str, ...]) -> NormalEquations:
    """A stage's normal equations: its equations' ones, residuals of all weighted alike."""
    total = equations[0].embed(names)
    for further in equations[1:]:
        total = total + further.embed(names)
    return total


def traced_sums(
    procedure: Procedure,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
) -> RecordingSums:
    """Moments of one record, for code that is traced: shapes are those of the record."""
    parts = _of_equations_compiled(procedure, record, criterion, key, True)
    stages = tuple(
        tuple(
            EquationSums(e.moments[None], e.count[None], None, None, None, None, e.parameters)
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
    )


def _of_equations(
    procedure: Procedure,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    blocks: bool,
) -> list[list[NormalEquations]]:
    samples = criterion.block_samples(record) if blocks else record.sample_count
    count = -(-record.sample_count // samples)

    # Rows of a stage's equations are summed, never interleaved: one Gram matrix per equation.
    def of(equation: Equation) -> NormalEquations:
        if criterion.in_closed_form:
            return NormalEquations(*criterion.moments(equation, record), equation.parameters)
        rows = criterion.rows(equation, record, key)
        block = None
        if count > 1:
            block = jnp.clip((rows.position / samples).astype(jnp.int32), 0, count - 1)
        return NormalEquations.of_rows(rows, block_of_row=block, block_count=count)

    return [[of(equation) for equation in stage] for stage in procedure.stages]


_of_equations_compiled = eqx.filter_jit(_of_equations)

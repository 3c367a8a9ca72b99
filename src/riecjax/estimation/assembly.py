"""What a procedure's equations make of records: sums of its equations, or of its stages.

Equations of a stage, records and blocks of time add up, so that one table of moments for each
equation, record and short block is all that needs to be kept.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Key

from riecjax.criteria.criterion import AbstractCriterion, Rows
from riecjax.equations.equation import Equation
from riecjax.estimation.blocks import ShortBlocks
from riecjax.estimation.normal_equations import (
    NormalEquations,
    normal_equations,
    stack_normal_equations,
)
from riecjax.estimation.procedure import Procedure
from riecjax.estimation.sharing import Sharing
from riecjax.estimation.sums import EquationSums, RecordingSums
from riecjax.leaves import namespace
from riecjax.records.record import Record


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
    parts = _equation_by_equation(procedure, record, criterion, key, blocks)
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
    parts = _compiled(procedure, record, criterion, key)
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


@eqx.filter_jit
def _compiled(
    procedure: Procedure,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
) -> list[list[NormalEquations]]:
    return _equation_by_equation(procedure, record, criterion, key, True)


def _equation_by_equation(
    procedure: Procedure,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    blocks: bool,
) -> list[list[NormalEquations]]:
    if criterion.in_closed_form:
        return [[_moments(criterion, e, record) for e in stage] for stage in procedure.stages]
    samples = criterion.block_samples(record) if blocks else record.sample_count
    count = -(-record.sample_count // samples)

    # Rows of a stage's equations are summed, never interleaved: one Gram matrix per equation.
    def summed(equation: Equation) -> NormalEquations:
        rows = criterion.rows(equation, record, key)
        block = _block_of_row(rows, samples, count) if count > 1 else None
        return normal_equations(rows, block_of_row=block, block_count=count)

    return [[summed(equation) for equation in stage] for stage in procedure.stages]


def _moments(criterion: AbstractCriterion, equation: Equation, record: Record) -> NormalEquations:
    moments, count = criterion.moments(equation, record)
    return NormalEquations(moments, count, equation.parameters)


def _block_of_row(rows: Rows, samples: int, count: int) -> Int[Array, " rows"]:
    return jnp.clip((rows.position / samples).astype(jnp.int32), 0, count - 1)


def short_blocks(records: Sequence[Record], criterion: AbstractCriterion) -> ShortBlocks:
    """The short blocks of each record that normal equations are kept for."""
    samples = [criterion.block_samples(record) for record in records]
    xp = namespace([record.time_step for record in records])
    return ShortBlocks(
        np.array([-(-record.sample_count // k) for record, k in zip(records, samples)]),
        xp.stack([xp.multiply(k, record.time_step) for record, k in zip(records, samples)]),
    )


def all_normal_equations(
    procedure: Procedure,
    sharing: Sharing,
    records: list[Record],
    criterion: AbstractCriterion,
    keys: list[Key[Array, ""] | None],
) -> list[NormalEquations]:
    """Normal equations of each stage over all records, leading axes `(records, short blocks)`."""
    of_stages = []
    for i, (record, key) in enumerate(zip(records, keys)):
        stages = stage_normal_equations(procedure, record, criterion, key, blocks=True)
        of_stages.append([over_records(stage, sharing, i) for stage in stages])
    return [stack_normal_equations(parts) for parts in zip(*of_stages)]


def over_records(equations: NormalEquations, sharing: Sharing, index: int) -> NormalEquations:
    """Normal equations of one record, from 0, among the parameters of all records."""
    if not sharing.own:
        return equations
    names = equations.parameters
    return equations.rename(sharing.of_record(names, index)).embed(sharing.everywhere(names))


def stages_over_records(
    equations: list[list[NormalEquations]], sharing: Sharing
) -> tuple[list[NormalEquations], list[list[NormalEquations]]]:
    """Normal equations of stages, and of each equation, among the parameters of all records.

    **Arguments:** `equations` of each stage, with a leading axis of records.
    """
    apart = [[_over_all_records(e, sharing) for e in stage] for stage in equations]
    names = [tuple(dict.fromkeys(name for e in stage for name in e.parameters)) for stage in apart]
    return [sum_of_equations(stage, own) for stage, own in zip(apart, names)], apart


def _over_all_records(equations: NormalEquations, sharing: Sharing) -> NormalEquations:
    """The same of normal equations with a leading axis of records."""
    if not sharing.own:
        return equations
    every = [
        NormalEquations(equations.moments[i], equations.count[i], equations.parameters)
        for i in range(sharing.record_count)
    ]
    shared = [over_records(e, sharing, i) for i, e in enumerate(every)]
    return NormalEquations(
        jnp.stack([e.moments for e in shared]),
        jnp.stack([e.count for e in shared]),
        shared[0].parameters,
    )

"""What a procedure's equations make of records: normal equations of its stages, or rows.

Equations of a stage, records and blocks of time add up, so that one table of moments for each
stage, record and short block is all that needs to be kept.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
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
    if criterion.in_closed_form:
        return [
            _sum([_moments(criterion, e, record).embed(names) for e in stage])
            for stage, names in zip(procedure.stages, procedure.stage_parameters)
        ]
    samples = criterion.block_samples(record) if blocks else record.sample_count
    count = -(-record.sample_count // samples)
    collected = []
    for stage, names in zip(procedure.stages, procedure.stage_parameters):
        parts = [criterion.rows(equation, record, key).embed(names) for equation in stage]
        # Rows of a stage's equations are summed, never interleaved: one Gram matrix per equation.
        summed = [
            normal_equations(
                part,
                block_of_row=_block_of_row(part, samples, count) if count > 1 else None,
                block_count=count,
            )
            for part in parts
        ]
        collected.append(_sum(summed))
    return collected


def _moments(criterion: AbstractCriterion, equation: Equation, record: Record) -> NormalEquations:
    moments, count = criterion.moments(equation, record)
    return NormalEquations(moments, count, equation.parameters)


def _sum(parts: list[NormalEquations]) -> NormalEquations:
    total = parts[0]
    for further in parts[1:]:
        total = total + further
    return total


def _block_of_row(rows: Rows, samples: int, count: int) -> Int[Array, " rows"]:
    return jnp.clip((rows.position / samples).astype(jnp.int32), 0, count - 1)


def short_blocks(records: Sequence[Record], criterion: AbstractCriterion) -> ShortBlocks:
    """The short blocks of each record that normal equations are kept for."""
    samples = [criterion.block_samples(record) for record in records]
    xp = namespace([record.time_step for record in records])
    return ShortBlocks(
        tuple(-(-record.sample_count // k) for record, k in zip(records, samples)),
        xp.stack([xp.multiply(k, record.time_step) for record, k in zip(records, samples)]),
    )


def all_normal_equations(
    procedure: Procedure,
    sharing: Sharing,
    records: list[Record],
    criterion: AbstractCriterion,
    keys: list[Key[Array, ""] | None],
) -> tuple[list[NormalEquations], ShortBlocks]:
    """Normal equations of each stage over all records, leading axes `(records, short blocks)`."""
    per_record = []
    for i, (record, key) in enumerate(zip(records, keys)):
        stages = stage_normal_equations(procedure, record, criterion, key, blocks=True)
        per_record.append(
            [
                stage.rename(sharing.of_record(names, i)).embed(sharing.everywhere(names))
                if sharing.own
                else stage
                for stage, names in zip(stages, procedure.stage_parameters)
            ]
        )
    together = [stack_normal_equations(parts) for parts in zip(*per_record)]
    return together, short_blocks(records, criterion)


@eqx.filter_jit
def all_rows(
    procedure: Procedure,
    sharing: Sharing,
    records: list[Record],
    criterion: AbstractCriterion,
    keys: list[Key[Array, ""] | None],
) -> list[Rows]:
    """Rows of each stage over all records and all its equations."""
    return [
        Rows.concatenate(
            [
                criterion.rows(equation, record, key)
                .rename(sharing.of_record(equation.parameters, i))
                .embed(sharing.everywhere(names))
                for i, (record, key) in enumerate(zip(records, keys))
                for equation in stage
            ]
        )
        for stage, names in zip(procedure.stages, procedure.stage_parameters)
    ]

"""What a procedure's equations make of records: normal equations of its stages, or rows.

Equations of a stage, records and blocks of time add up, so that one table of moments for each
stage, record and short block is all that needs to be kept.
"""

from collections.abc import Sequence
from typing import NamedTuple

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
    parts = _equation_by_equation(procedure, record, criterion, key, blocks)
    return _stages(procedure, parts)


@eqx.filter_jit
def _stages_and_equations(
    procedure: Procedure,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
) -> tuple[list[NormalEquations], list[list[NormalEquations]]]:
    """Of each stage in blocks, and of its equations apart, if it has several, in one block."""
    parts = _equation_by_equation(procedure, record, criterion, key, True)
    apart = [[e.in_one_block() for e in stage] if len(stage) > 1 else [] for stage in parts]
    return _stages(procedure, parts), apart


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


def _stages(procedure: Procedure, parts: list[list[NormalEquations]]) -> list[NormalEquations]:
    return [
        _sum([equation.embed(names) for equation in stage])
        for stage, names in zip(parts, procedure.stage_parameters)
    ]


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


class Assembled(NamedTuple):
    """Normal equations of a procedure over all records.

    **Fields:**

    - `stages`: of each stage, leading axes `(records, short blocks)`.
    - `equations`: of each equation of a stage of several apart, leading axes `(records, 1)`; none
      of a stage of one. Residuals of the equations follow from them without another pass.
    - `short`: the short blocks.
    """

    stages: list[NormalEquations]
    equations: list[list[NormalEquations]]
    short: ShortBlocks


def all_normal_equations(
    procedure: Procedure,
    sharing: Sharing,
    records: list[Record],
    criterion: AbstractCriterion,
    keys: list[Key[Array, ""] | None],
) -> Assembled:
    """Normal equations of each stage, and of its equations, over all records."""

    def shared(equations: NormalEquations, i: int) -> NormalEquations:
        names = equations.parameters
        if not sharing.own:
            return equations
        return equations.rename(sharing.of_record(names, i)).embed(sharing.everywhere(names))

    of_stages, of_equations = [], []
    for i, (record, key) in enumerate(zip(records, keys)):
        stages, apart = _stages_and_equations(procedure, record, criterion, key)
        of_stages.append([shared(stage, i) for stage in stages])
        of_equations.append([[shared(e, i) for e in stage] for stage in apart])
    return Assembled(
        [stack_normal_equations(parts) for parts in zip(*of_stages)],
        [[stack_normal_equations(e) for e in zip(*stages)] for stages in zip(*of_equations)],
        short_blocks(records, criterion),
    )


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

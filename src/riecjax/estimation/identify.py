"""The verb of this library: identify a model's parameters from records."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Key

from riecjax.criteria.criterion import RIEC, AbstractCriterion, Rows
from riecjax.criteria.windows import MOST_BLOCKS, AllWindows
from riecjax.equations.equation import Equation
from riecjax.errors import DataError, IdentifiabilityError, ModelError
from riecjax.estimation.constant_side import raise_if_only_constant
from riecjax.estimation.estimate import Estimate, combination
from riecjax.estimation.heterogeneity import record_inflation
from riecjax.estimation.least_squares import gram_condition_limit
from riecjax.estimation.normal_equations import NormalEquations, normal_equations
from riecjax.estimation.procedure import (
    HasProcedure,
    Procedure,
    StageSolution,
    as_procedure,
    block_influence,
    small_sample_factor,
    solve_stages,
)
from riecjax.estimation.sharing import Sharing
from riecjax.leaves import is_concrete
from riecjax.records.record import Record


def identify(
    model: Equation | Procedure | HasProcedure,
    records: Record | Sequence[Record],
    criterion: AbstractCriterion,
    *,
    key: Key[Array, ""] | None = None,
    known: Mapping[str, float | Array] | None = None,
    own: Sequence[str] = (),
) -> Estimate:
    """Identify the parameters of a model that is linear in them.

    Works eagerly, with every check, and under `jax.jit`, `jax.vmap` and `jax.grad`, where checks
    of values are left to the result (`rank`, `condition_number`).

    **Arguments:**

    - `model`: an `Equation`, several as `staged(...)` or `simultaneous(...)`, or a `Model`.
    - `records`: one record or several, of any lengths; their normal equations add up.
    - `criterion`: `RIEC(RandomWindows(alpha, beta, count))` or `DOLS()`.
    - `key`: for random windows, `jax.random.key(seed)`. All equations share its windows.
    - `known`: parameters held at these values instead of being estimated.
    - `own`: parameters with a value of their own in each record, such as a sensor's offset; in
      the result `offset` becomes `offset[1]`, `offset[2]`, ...

    **Returns:** an [`Estimate`][].

    **Raises:** `ModelError` for an unknown parameter name, a missing key, or an equation with
    nothing to set its scale; `DataError` for a missing signal, a record shorter than a window, or
    no window between gaps; `IdentifiabilityError` if regressors are collinear, naming the
    combination that cannot be told apart.
    """
    procedure = as_procedure(model)
    recordings = [records] if isinstance(records, Record) else list(records)
    if not recordings:
        raise DataError("identification needs at least one record.")
    sharing = Sharing(procedure.parameters, own, len(recordings))
    given = known_values(procedure, sharing, known or {})
    plan = plan_stages(procedure, sharing, given)
    if criterion.needs_key and key is None:
        raise ModelError("random windows need a key: key=jax.random.key(seed).")
    for record in recordings:
        criterion.check(record)
    criterion = criterion.fitted(recordings)

    keys = record_keys(key, len(recordings))
    stages = all_normal_equations(procedure, sharing, recordings, criterion, keys)
    blocks = jnp.stack([independent_blocks(criterion, r, MOST_BLOCKS) for r in recordings])
    solutions, covariance, inflation = _solve(stages, given, blocks, sharing, None)
    if is_concrete(solutions):
        _raise_if_empty(stages, plan)
        raise_if_only_constant(procedure, recordings, given)
        _raise_if_not_finite(stages, plan)
        past_gram = _worst_condition(solutions) > gram_condition_limit(covariance.dtype)
        if past_gram and not in_closed_form(criterion):
            rows = all_rows(procedure, sharing, recordings, criterion, keys)
            solutions, covariance, inflation = _solve(stages, given, blocks, sharing, rows)
        _raise_if_unidentifiable(solutions, plan)

    units = {name: unit for name, unit in sharing.values(procedure.units).items()}
    return Estimate(
        theta=jnp.concatenate([stage.solution.theta for stage in solutions]),
        covariance=covariance,
        inflation=inflation,
        stages=tuple(solutions),
        known={name: jnp.asarray(value) for name, value in given.items()},
        criterion=criterion,
        parameters=tuple(name for stage in solutions for name in stage.parameters),
        units=tuple(units.items()),
        stage_names=tuple(plan[stage.stage][0] for stage in solutions),
        block_count=jnp.sum(blocks),
        rows_offered=tuple(
            _rows_offered(procedure.stages[stage.stage], recordings, criterion)
            for stage in solutions
        ),
    )


def signals_read(
    procedure: Procedure, record: Record, criterion: AbstractCriterion
) -> tuple[str, ...]:
    """Names of the record's signals that a criterion reads for a procedure's equations.

    Raises what `identify` would raise of this one record, before any arithmetic.

    **Raises:** `DataError` for a missing signal or a record shorter than a window; `ModelError`
    for an expression that fails.
    """
    criterion.check(record)
    read: set[str] = set()
    for stage in procedure.stages:
        for equation in stage:
            read |= equation.signals_read(record, criterion.smoothness)
            eqx.filter_eval_shape(criterion.rows, equation, record, jax.random.key(0))
    return tuple(name for name in record.arrays if name in read)


@eqx.filter_jit
def stage_normal_equations(
    procedure: Procedure,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    *,
    block_count: int = 1,
    blocks_used: Int[Array, ""] | None = None,
) -> list[NormalEquations]:
    """Normal equations of each stage on one record, in blocks of time along the leading axis.

    Of the `block_count` blocks only the first `blocks_used` hold rows, by default
    `independent_blocks(...)`.
    """
    if in_closed_form(criterion):
        return [
            _sum([_moments(criterion, e, record).embed(names) for e in stage])
            for stage, names in zip(procedure.stages, procedure.stage_parameters)
        ]
    used = blocks_used
    if used is None and block_count > 1:
        used = independent_blocks(criterion, record, block_count)
    collected = []
    for stage, names in zip(procedure.stages, procedure.stage_parameters):
        parts = [criterion.rows(equation, record, key).embed(names) for equation in stage]
        # Rows of a stage's equations are summed, never interleaved: one Gram matrix per equation.
        summed = [
            normal_equations(
                part,
                block_of_row=None if used is None else _block_of_row(part, record, used),
                block_count=block_count,
            )
            for part in parts
        ]
        collected.append(_sum(summed))
    return collected


def in_closed_form(criterion: AbstractCriterion) -> bool:
    """Whether a criterion sums over all its rows at once, so that there are no single ones."""
    return isinstance(criterion, RIEC) and isinstance(criterion.windows, AllWindows)


def _moments(criterion: AbstractCriterion, equation: Equation, record: Record) -> NormalEquations:
    assert isinstance(criterion, RIEC)
    moments, count = criterion.moments(equation, record)
    return NormalEquations(moments, count, equation.parameters)


def _sum(parts: list[NormalEquations]) -> NormalEquations:
    total = parts[0]
    for further in parts[1:]:
        total = total + further
    return total


def independent_blocks(criterion: AbstractCriterion, record: Record, most: int) -> Int[Array, ""]:
    """How many blocks of twice the longest window fit into a record: 2 at least, `most` at most."""
    if isinstance(criterion, RIEC) and isinstance(criterion.windows, AllWindows):
        return jnp.asarray(-(-record.sample_count // criterion.windows.block(record.sample_count)))
    length = jnp.maximum(2 * jnp.asarray(criterion.block_length), 2 * record.time_step)
    return jnp.clip(jnp.round(record.duration / length), 2, most).astype(jnp.int32)


def _block_of_row(rows: Rows, record: Record, used: Int[Array, ""]) -> Int[Array, " rows"]:
    share = rows.position / record.sample_count
    return jnp.clip((share * used).astype(jnp.int32), 0, used - 1)


def all_normal_equations(
    procedure: Procedure,
    sharing: Sharing,
    records: list[Record],
    criterion: AbstractCriterion,
    keys: list[Key[Array, ""] | None],
    blocks_used: list[Int[Array, ""]] | None = None,
) -> list[NormalEquations]:
    """Normal equations of each stage over all records.

    Blocks of all records stand one after the other along the leading axis, never a mixed one.
    """
    per_record = []
    for i, (record, key) in enumerate(zip(records, keys)):
        stages = stage_normal_equations(
            procedure,
            record,
            criterion,
            key,
            block_count=MOST_BLOCKS,
            blocks_used=None if blocks_used is None else blocks_used[i],
        )
        per_record.append(
            [
                stage.rename(sharing.of_record(names, i)).embed(sharing.everywhere(names))
                if sharing.own
                else stage
                for stage, names in zip(stages, procedure.stage_parameters)
            ]
        )
    return [
        NormalEquations(
            jnp.concatenate([_filled_up(part.moments, parts) for part in parts]),
            jnp.concatenate([_filled_up(part.count, parts) for part in parts]),
            parts[0].parameters,
        )
        for parts in zip(*per_record)
    ]


def _filled_up(blocks: Array, parts: Sequence[NormalEquations]) -> Array:
    """As many blocks as the record with most of them has; the further ones are empty."""
    most = max(part.count.shape[0] for part in parts)
    return jnp.pad(blocks, [(0, most - blocks.shape[0])] + [(0, 0)] * (blocks.ndim - 1))


@eqx.filter_jit
def _solve(
    stages: list[NormalEquations],
    known: Mapping[str, Array],
    blocks_used: Int[Array, " records"],
    sharing: Sharing,
    rows: list[Rows] | None,
) -> tuple[list[StageSolution], Array, Array]:
    """Solutions of the stages, covariance of all parameters, and its inflation by records."""
    solutions = solve_stages(stages, known, rows)
    influence = block_influence(stages, solutions, known)
    per_record = influence.reshape(blocks_used.shape[0], -1, influence.shape[-1])
    # What belongs to one recording cannot differ between recordings.
    shared = np.array([n not in sharing.individual for s in solutions for n in s.parameters])
    inflation = jnp.where(shared, record_inflation(per_record, blocks_used), 1.0)
    grown = influence * inflation[None, :]
    return solutions, small_sample_factor(jnp.sum(blocks_used)) * grown.T @ grown, inflation


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


def _rows_offered(
    stage: tuple[Equation, ...], records: list[Record], criterion: AbstractCriterion
) -> int | None:
    counts = [criterion.row_count(record) for record in records]
    known = [count for count in counts if count is not None]
    return len(stage) * sum(known) if len(known) == len(counts) else None


def known_values(
    procedure: Procedure, sharing: Sharing, known: Mapping[str, float | Array]
) -> dict[str, Array]:
    """Values held fixed, by name over all records: the equations' own and the user's.

    **Raises:** `ModelError` for a name that the model does not have.
    """
    names = {*procedure.parameters, *sharing.parameters}
    if unknown := [name for name in known if name not in names]:
        listed = ", ".join(sharing.parameters)
        raise ModelError(f"unknown parameter '{unknown[0]}'; the model has: {listed}.")
    merged = {**sharing.values(procedure.known), **sharing.values(known)}
    return {name: jnp.asarray(value, jnp.result_type(float)) for name, value in merged.items()}


def plan_stages(
    procedure: Procedure, sharing: Sharing, given: Mapping[str, Array]
) -> list[tuple[str, tuple[str, ...]]]:
    """(stage name, parameters it finds, over all records) for each stage."""
    plan = [
        (label, tuple(name for name in sharing.everywhere(names) if name not in given))
        for label, names in procedure.plan(sharing.settled(given))
    ]
    if not any(unknown for _, unknown in plan):
        raise ModelError("every parameter is known; nothing is left to identify.")
    return plan


def record_keys(key: Key[Array, ""] | None, count: int) -> list[Key[Array, ""] | None]:
    """The key that each of several records draws its windows with."""
    if key is None or count == 1:
        return [key] * count
    return list(jax.random.split(key, count))


def _worst_condition(solutions: list[StageSolution]) -> float:
    return max(float(stage.solution.condition_number) for stage in solutions)


def _raise_if_empty(stages: list[NormalEquations], plan: list[tuple[str, tuple[str, ...]]]) -> None:
    for equations, (label, unknown) in zip(stages, plan):
        if unknown and not bool(jnp.sum(equations.count) > 0):
            raise DataError(
                f"{label}: every window touches a missing or masked sample. Choose a smaller beta, "
                f"or repair the record's gaps."
            )


def _raise_if_not_finite(
    stages: list[NormalEquations], plan: list[tuple[str, tuple[str, ...]]]
) -> None:
    for equations, (label, _) in zip(stages, plan):
        if not bool(jnp.all(jnp.isfinite(equations.moments))):
            raise DataError(
                f"{label}: its terms are not finite numbers on this record: a division by zero, a "
                f"root of a negative number, or values too large to be squared. Scale the signals "
                f"to SI units and check the equation's expressions."
            )


def _raise_if_unidentifiable(
    solutions: list[StageSolution], plan: list[tuple[str, tuple[str, ...]]]
) -> None:
    for stage in solutions:
        if int(stage.solution.rank) < len(stage.parameters):
            which = combination(stage.parameters, np.asarray(stage.solution.weakest_direction))
            raise IdentifiabilityError(
                f"{plan[stage.stage][0]}: the record cannot tell these apart (collinear or silent "
                f"regressors): {which}, in units of each regressor's size. Excite the system more "
                f"richly, or hold one of them at a known value (on the command line: --set "
                f"NAME=VALUE)."
            )

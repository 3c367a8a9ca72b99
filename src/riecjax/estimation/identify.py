"""The verb of this library: identify a model's parameters from records."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key
from numpy.typing import ArrayLike

from riecjax.criteria.criterion import RIEC, AbstractCriterion, Rows
from riecjax.criteria.windows import DEFAULT_BAND
from riecjax.equations.equation import Equation
from riecjax.equations.sample_by_sample import raise_if_samples_mix
from riecjax.errors import DataError, IdentifiabilityError, MissingSignalError, ModelError, require
from riecjax.estimation.assembly import Assembled, all_normal_equations, all_rows
from riecjax.estimation.bursts import sizes_in_bursts
from riecjax.estimation.constant_target import constant_targets
from riecjax.estimation.estimate import MATTERING_SHARE, Estimate, combination
from riecjax.estimation.evidence import judge
from riecjax.estimation.intervals import (
    AbstractIntervals,
    BlockBootstrap,
    Naive,
    Uncertainty,
    naive_covariance,
)
from riecjax.estimation.least_squares import gram_condition_limit
from riecjax.estimation.procedure import (
    HasProcedure,
    Procedure,
    StageSolution,
    as_procedure,
    found_values,
    solve_stages,
)
from riecjax.estimation.sharing import Sharing
from riecjax.findings import Finding
from riecjax.leaves import is_concrete, is_number, on_host
from riecjax.records.record import Record, as_records

DOUBTFUL = 5.0
"""Standard errors within which an estimate of zero leaves its interval's width in doubt."""


def identify(
    model: Equation | Procedure | HasProcedure,
    records: Record | Sequence[Record],
    criterion: AbstractCriterion | None = None,
    *,
    key: Key[Array, ""] | None = None,
    known: Mapping[str, float | Array] | None = None,
    own: Sequence[str] = (),
    intervals: AbstractIntervals | None = None,
) -> Estimate:
    """Identify the parameters of a model that is linear in them.

    Works eagerly, with every check, and under `jax.jit`, `jax.vmap` and `jax.grad`, where checks
    of values are left to the result (`rank`, `condition_number`).

    **Arguments:**

    - `model`: an `Equation`, several as `staged(...)` or `simultaneous(...)`, or a `Model`.
    - `records`: one record or several, of any lengths; their normal equations add up.
    - `criterion`: `RIEC(AllWindows(alpha, beta))`, `RIEC(RandomWindows(alpha, beta, count))` or
      `DOLS()`. By default all windows of half the periods of the model's band (1 to 10 Hz for a
      model that names none).
    - `key`: for random windows, `jax.random.key(seed)`. All equations share its windows.
    - `known`: parameters held at these values instead of being estimated.
    - `own`: parameters with a value of their own in each record, such as a sensor's offset; in
      the result `offset` becomes `offset[1]`, `offset[2]`, ...
    - `intervals`: how uncertainty is judged, [`BlockBootstrap`][] by default; [`Sandwich`][] is
      cheaper where thousands of fits are vmapped.

    **Returns:** an [`Estimate`][].

    **Raises:** `ModelError` for an unknown parameter name, a missing key, or an equation with
    nothing to set its scale; `DataError` for a missing signal, a record shorter than a window, or
    no window between gaps; `IdentifiabilityError` if regressors are collinear, naming the
    combination that cannot be told apart.
    """
    if criterion is None:
        criterion = RIEC.of_band(getattr(model, "band", None) or DEFAULT_BAND)
    asked = pose(model, records, criterion, key=key, known=known, own=own)
    procedure, recordings, criterion, sharing, given, plan, keys = asked
    require("intervals", intervals or Naive(), AbstractIntervals, "intervals=rx.BlockBootstrap()")
    assembled = all_normal_equations(procedure, sharing, recordings, criterion, keys)
    stages = assembled.stages
    intervals = BlockBootstrap() if intervals is None else intervals
    window = jnp.asarray(criterion.block_length)
    solved = _solve(assembled, given, window, sharing, intervals, None)
    if is_concrete(solved.stages):
        raise_if_nothing_to_fit(plan, [s.count for s in stages], [s.moments for s in stages])
        for finding in constant_targets(procedure, sharing, recordings, criterion, given):
            raise IdentifiabilityError(finding.message, finding.code)
        past_gram = _worst_condition(solved.stages) > gram_condition_limit(window.dtype)
        if past_gram and not criterion.in_closed_form:
            rows = all_rows(procedure, sharing, recordings, criterion, keys)
            solved = _solve(assembled, given, window, sharing, intervals, rows)
        _raise_if_unidentifiable(solved.stages, plan)
        solved = solved._replace(
            stages=_where_they_act(solved, given, procedure, sharing, recordings)
        )

    units = {name: unit for name, unit in sharing.values(procedure.units).items()}
    return Estimate(
        theta=solved.theta,
        uncertainty=solved.uncertainty,
        naive=solved.naive,
        inflation=solved.inflation,
        stages=tuple(solved.stages),
        known={name: jnp.asarray(value) for name, value in given.items()},
        criterion=criterion,
        parameters=tuple(name for stage in solved.stages for name in stage.parameters),
        units=tuple(units.items()),
        stage_names=tuple(plan[stage.stage][0] for stage in solved.stages),
        equation_names=tuple(procedure.equation_names[stage.stage] for stage in solved.stages),
        block_count=solved.block_count,
        block_length=solved.length,
        rows_offered=tuple(
            _rows_offered(procedure.stages[stage.stage], recordings, criterion)
            for stage in solved.stages
        ),
    )


class Question(NamedTuple):
    """What is asked of records, before any arithmetic; see [`identify`][] for the arguments.

    **Fields:** `procedure`; `records`; `criterion` fitted to them; `sharing` of parameters; `given`
    values by name over all records; `plan`, (stage name, parameters it finds); `keys` of records.
    """

    procedure: Procedure
    records: list[Record]
    criterion: AbstractCriterion
    sharing: Sharing
    given: dict[str, Array]
    plan: list[tuple[str, tuple[str, ...]]]
    keys: list[Key[Array, ""] | None]


def pose(
    model: Equation | Procedure | HasProcedure,
    records: Record | Sequence[Record],
    criterion: AbstractCriterion,
    *,
    key: Key[Array, ""] | None,
    known: Mapping[str, float | Array] | None,
    own: Sequence[str],
) -> Question:
    """Everything that can be refused before arithmetic, for [`identify`][] and for a check alike.

    **Raises:** `ModelError` and `DataError` as [`identify`][].
    """
    procedure = as_procedure(model)
    require("the criterion", criterion, AbstractCriterion, WRITE_CRITERION)
    require_settings(key, known, own)
    recordings = as_records(records)
    sharing = Sharing(procedure.parameters, own, len(recordings))
    given = known_values(procedure, sharing, known or {})
    plan = plan_stages(procedure, sharing, given)
    if criterion.needs_key and key is None:
        raise ModelError("random windows need a key: key=jax.random.key(seed).")
    for record in recordings:
        criterion.check(record)
    criterion = criterion.fitted(recordings)
    _raise_if_samples_mix(procedure, recordings, criterion)
    keys = record_keys(key, len(recordings))
    return Question(procedure, recordings, criterion, sharing, given, plan, keys)


WRITE_CRITERION = (
    "rx.RIEC(rx.AllWindows(0.05, 0.5)), with the shortest and the longest window in seconds, or "
    "rx.DOLS()"
)


def require_settings(key: object, known: object, own: object) -> None:
    """Raise `ModelError` unless these are a key, values by name and names, or left out."""
    require_key(key)
    write = "known={'m': 2.0}: values by name"
    require("known", {} if known is None else known, Mapping, write)
    name = own if isinstance(own, str) else "offset"
    require("own", own, (list, tuple, set, frozenset), f"own=('{name}',): a tuple of names")


def require_key(key: object) -> None:
    """Raise `ModelError` for a seed, several keys or anything else in place of a key."""
    if key is None:
        return
    if isinstance(key, jax.Array):
        typed = jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
        # Keys of jax.random.PRNGKey are a row of whole numbers.
        if (typed and key.ndim == 0) or (key.dtype == jnp.uint32 and key.ndim == 1):
            return
        if typed or key.dtype == jnp.uint32:
            raise ModelError(
                f"the key is an array of {len(key)} keys. Write key=keys[0], or map over them by "
                f"jax.vmap."
            )
    seed = key if isinstance(key, int | np.integer) else 0
    require("the key", key, (), f"key=jax.random.key({int(seed)})")


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
            with _saying_whose_derivative(equation):
                read |= equation.signals_read(record, criterion.smoothness)
            eqx.filter_eval_shape(criterion.rows, equation, record, jax.random.key(0))
    return tuple(name for name in record.arrays if name in read)


@contextlib.contextmanager
def _saying_whose_derivative(equation: Equation) -> Iterator[None]:
    """Of a missing signal that the equation calls a derivative, say whose it is."""
    try:
        yield
    except MissingSignalError as error:
        below = [of for of, name in equation.derivatives if name == error.signal]
        known = next((of for of in below if of in error.available), "")
        raise MissingSignalError(error.signal, error.available, known) from None


class _Solved(NamedTuple):
    """Solutions of the stages with their uncertainty, grown by `inflation` where records disagree;
    `block_count` blocks of all records, of `length` seconds on average."""

    theta: Float[Array, " p"]
    stages: list[StageSolution]
    uncertainty: Uncertainty
    naive: Float[Array, " p"]
    inflation: Float[Array, " p"]
    block_count: Int[Array, ""]
    length: Float[Array, ""]


@eqx.filter_jit
def _solve(
    assembled: Assembled,
    known: Mapping[str, Array],
    longest_window: Float[Array, ""],
    sharing: Sharing,
    intervals: AbstractIntervals,
    rows: list[Rows] | None,
) -> _Solved:
    stages, short = assembled.stages, assembled.short
    apart = [[equation.flattened() for equation in stage] for stage in assembled.equations]
    solutions = solve_stages([stage.flattened() for stage in stages], known, rows, apart)
    values = found_values(solutions, known)
    # What belongs to one recording cannot differ between recordings.
    shared = np.array([n not in sharing.individual for s in solutions for n in s.parameters])
    judged = judge(stages, known, values, short, longest_window, shared, intervals)
    block_count = jnp.sum(judged.evidence.used)
    return _Solved(
        jnp.concatenate([stage.solution.theta for stage in solutions]),
        solutions,
        judged.uncertainty,
        jnp.sqrt(jnp.diagonal(naive_covariance(judged.evidence))),
        judged.inflation,
        block_count,
        jnp.sum(short.durations) / block_count,
    )


def _where_they_act(
    solved: _Solved,
    given: Mapping[str, Array],
    procedure: Procedure,
    sharing: Sharing,
    records: list[Record],
) -> list[StageSolution]:
    """The stages with the size of terms in doubt where they act, if that is in bursts."""
    values = found_values(on_host(solved.stages), given)
    errors = np.sqrt(np.diagonal(solved.uncertainty.covariance))
    errors = dict(zip([name for stage in solved.stages for name in stage.parameters], errors))

    def judged(stage: StageSolution) -> StageSolution:
        sizes = np.asarray(stage.relative_size)
        # What is large enough to matter over the whole record needs no closer look.
        doubtful = [
            name
            for name, size in zip(stage.parameters, sizes)
            if abs(float(values[name])) < DOUBTFUL * errors[name]
            and errors[name] * size < MATTERING_SHARE
        ]
        if not doubtful:
            return stage
        equations = procedure.stages[stage.stage]
        active = sizes_in_bursts(equations, sharing, records, values, stage.parameters, doubtful)
        larger = np.maximum(sizes, [active.get(name, 0.0) for name in stage.parameters])
        return eqx.tree_at(lambda s: s.relative_size, stage, larger)

    return [judged(stage) for stage in solved.stages]


def _rows_offered(
    stage: tuple[Equation, ...], records: list[Record], criterion: AbstractCriterion
) -> float | None:
    counts = [criterion.row_count(record) for record in records]
    known = [count for count in counts if count is not None]
    return len(stage) * sum(known) if len(known) == len(counts) else None


def known_values(
    procedure: Procedure, sharing: Sharing, known: Mapping[str, float | Array]
) -> dict[str, Array]:
    """Values held fixed, by name over all records: the equations' own and the user's.

    **Raises:** `ModelError` for a name that the model does not have, and for what is no finite
    number.
    """
    names = {*procedure.parameters, *sharing.parameters}
    if unknown := [name for name in known if name not in names]:
        listed = ", ".join(sharing.parameters)
        raise ModelError(f"unknown parameter '{unknown[0]}'; the model has: {listed}.")
    require_numbers(known)
    merged = {**sharing.values(procedure.known), **sharing.values(known)}
    return {name: jnp.asarray(value, jnp.result_type(float)) for name, value in merged.items()}


def require_numbers(known: Mapping[str, Any]) -> None:
    """Raise `ModelError` for a known value that is no single number, or not finite if it shows."""
    for name, value in known.items():
        if not is_number(value):
            raise ModelError(
                f"{name} is held at {value!r}: known values are single numbers, {name}=2.0."
            )
        if is_concrete(value) and not np.isfinite(float(value)):
            raise ModelError(f"{name} is held at {value}: give a finite number.")


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


def _raise_if_samples_mix(
    procedure: Procedure, records: list[Record], criterion: AbstractCriterion
) -> None:
    for record in records:
        if criterion.in_chunks(record) and is_concrete(record):
            for stage in procedure.stages:
                for equation in stage:
                    raise_if_samples_mix(equation, record)


def _worst_condition(solutions: list[StageSolution]) -> float:
    return max(float(stage.solution.condition_number) for stage in solutions)


def raise_if_nothing_to_fit(
    plan: list[tuple[str, tuple[str, ...]]],
    counts: Sequence[ArrayLike],
    sums: Sequence[ArrayLike],
) -> None:
    """Refuse a stage without rows, or with sums that are not finite numbers (not under jit).

    **Arguments:** of each stage of the `plan`, `counts` of its rows and `sums` of their products.

    **Raises:** `DataError` naming the stage.
    """
    for (label, unknown), count in zip(plan, counts):
        if unknown and not bool(np.sum(np.asarray(count)) > 0):
            raise DataError(
                f"{label}: every window touches a missing or masked sample. Choose a smaller beta, "
                f"or repair the record's gaps."
            )
    for (label, _), values in zip(plan, sums):
        if not bool(np.all(np.isfinite(values))):
            raise DataError(
                f"{label}: its terms are not finite numbers on this record: a division by zero, a "
                f"root of a negative number, or values too large to be squared. Scale the signals "
                f"to SI units and check the equation's expressions."
            )


def not_excited(stage_name: str, name: str) -> Finding:
    """That a parameter's regressor is zero throughout."""
    return Finding(
        "not_excited",
        f"{stage_name}: nothing in the record tells of {name}; its regressor is zero throughout. "
        f"Excite it, or hold it at a known value (on the command line: --set {name}=VALUE).",
    )


def _raise_if_unidentifiable(
    solutions: list[StageSolution], plan: list[tuple[str, tuple[str, ...]]]
) -> None:
    for stage in solutions:
        if int(stage.solution.rank) < len(stage.parameters):
            for name, size in zip(stage.parameters, np.asarray(stage.relative_size)):
                if size == 0:
                    silent = not_excited(plan[stage.stage][0], name)
                    raise IdentifiabilityError(silent.message, silent.code)
            which = combination(stage.parameters, np.asarray(stage.solution.weakest_direction))
            raise IdentifiabilityError(
                f"{plan[stage.stage][0]}: the record cannot tell these apart (collinear "
                f"regressors): {which}, in units of each regressor's size. Excite the system more "
                f"richly, or hold one of them at a known value (on the command line: --set "
                f"NAME=VALUE)."
            )

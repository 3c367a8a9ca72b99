"""The verb of this stage: refine parameters, from a start, of models that need not be linear."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from riecjax.errors import ModelError, renamed, require
from riecjax.estimation.estimated_parameters import AbstractEstimate
from riecjax.estimation.question import require_numbers, require_settings
from riecjax.estimation.sharing import Sharing, local_name
from riecjax.leaves import Leaf, is_concrete
from riecjax.linear_algebra import solve_scaled, symmetric_eigen, unit_scale
from riecjax.records.record import Record, Records, as_records
from riecjax.refinement.coordinates import Bounds, Laws, Prior
from riecjax.refinement.objective import AbstractMisfit, AbstractObjective, Expansion, Setup
from riecjax.refinement.optimum import (
    Optimum,
    Problem,
    RefinementStatus,
    Solver,
    find_optimum,
    halve_steps,
    resolved,
)
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.refined import Refined
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.task import record_keys
from riecjax.uncertainty.intervals import AbstractIntervals, Sandwich, Uncertainty, judge

SILENT = 1e-20
"""Share of what is left that a parameter must be able to move by its own size to count at all."""
COLLINEAR = 1e-12
"""Curvature along a direction, relative to the parameters' own, that is no more than rounding."""
TAKES_PART = 0.1
"""Share of such a direction from which a parameter is called undetermined."""
FURTHER_ROUNDS = 2
"""Fits after the first where there are priors, weighed against the scatter that was left before."""


@renamed(own="per_record")
def refine(
    model: Any,
    records: Records,
    start: AbstractEstimate | Mapping[str, float | Array],
    by: AbstractObjective | None = None,
    *,
    known: Mapping[str, float | Array] | None = None,
    bounds: Mapping[str, Bounds] | None = None,
    priors: Mapping[str, Prior] | None = None,
    per_record: Sequence[str] = (),
    key: Key[Array, ""] | None = None,
    intervals: AbstractIntervals | None = None,
    solver: Solver | None = None,
    max_steps: int = 100,
    progress: Callable[[float], None] | None = None,
) -> Refined:
    """Refine parameters by non-linear least squares, from a start.

    Works eagerly, with every check, and under `jax.jit`, `jax.vmap` and `jax.grad`. The result's
    `theta` differentiates with respect to records, windows and known values, by the implicit
    function theorem.

    **Arguments:**

    - `model`: what `by` needs. For [`OutputError`][], something to simulate: an `Equation`,
      `Procedure` or `Model`, an `AbstractSystem` whose fields are the parameters, or a function of
      the parameters by name that returns a system. For [`IntegralError`][], equations of motion:
      `Equation`s, a `Procedure`, `AbstractBalance`s.
    - `records`: one record or several, of any lengths.
    - `start`: an estimate, or values by name. What it names is free; of an estimate, what it
      estimated.
    - `by`: what is made small, [`OutputError`][] by default.
    - `known`: values held fixed. Parameters named nowhere keep the model's own values.
    - `bounds`: (lower, upper) by name, `None` where there is none.
    - `priors`: normal laws (mean, standard deviation) by name, weighed against the scatter that the
      fit leaves.
    - `per_record`: names of parameters that take a value of their own in each record. What is
      given for `offset` holds in every record, but for those given by their own name, `offset[2]`.
    - `key`: for random windows.
    - `intervals`: how uncertainty is judged, [`Sandwich`][] by default; [`BlockBootstrap`][]
      resamples the problem linearised at the optimum.
    - `solver`: an optimistix solver; Levenberg-Marquardt by default.
    - `max_steps`: steps that the search may take; fewer than it needs is a status of the result.
    - `progress`: called with the sum of squares after each step.

    **Raises:** `ModelError` for unknown names, values that are missing or out of bounds, a model
    that cannot be simulated; `DataError` for missing signals or records that are too short. A
    search that fails raises nothing: see `status` of the result.
    """
    recordings = as_records(records)
    require_settings(key, known, per_record)
    require("start", start, (AbstractEstimate, Mapping), "the result of rx.identify, or {'m': 2.0}")
    require("by", by or OutputError(), AbstractObjective, "by=rx.OutputError(), an object")
    require("intervals", intervals or Sandwich(), AbstractIntervals, "intervals=rx.Sandwich()")
    if solver is not None:
        write = "solver=optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8), or leave it out"
        require("the solver", solver, Solver, write)
    if isinstance(model, type):
        require(
            "the model", model, (), f"{model.__name__}(...), with a value for each of its fields"
        )
    objective = (OutputError() if by is None else by).suited(model)
    setup = _setup(objective, model, recordings, start, dict(known or {}), tuple(per_record), key)
    laws = Laws.of(
        setup.names, setup.values, setup.of_free(bounds or {}), setup.of_free(priors or {})
    )
    misfit = objective.misfit(setup)
    theta, starts = _stacked([setup.values[name] for name in setup.names]), misfit.first_starts()
    begun = _begin(misfit, theta, starts)
    settings = (setup.sharing, intervals or Sandwich(), solver, max_steps, progress)
    found, energy = _Found(theta, starts, begun.status, jnp.array(0)), begun.energy
    halved = None
    while True:
        found, energy, judged, optimum = _search(misfit, laws, theta, found, energy, *settings)
        for _ in range(FURTHER_ROUNDS if priors else 0):
            found, energy, judged, optimum = _search(misfit, laws, theta, found, energy, *settings)
        before, halved = halved, halve_steps(misfit, optimum)
        finer = resolved(misfit, halved, before)
        if finer is None:
            break
        misfit, begun = finer, _begin(finer, theta, starts)
    return Refined(
        theta=found.theta,
        uncertainty=judged.uncertainty,
        known={name: jnp.asarray(value) for name, value in setup.fixed.items()},
        status=found.status,
        steps=found.steps,
        rms_before=begun.rms,
        rms=judged.rms,
        cost_before=jnp.sum(begun.energy),
        cost=jnp.sum(energy),
        starts=found.starts,
        at_bound=judged.at_bound,
        inflation=judged.inflation,
        step_change=halved.change,
        coarse=halved.coarse,
        block_count=judged.block_count,
        block_length=judged.block_length,
        steps_label=misfit.steps_label,
        parameters=setup.names,
        units=tuple(setup.sharing.values(setup.units).items()),
        quantities=misfit.labels,
        quantity_units=misfit.units,
        start_names=misfit.start_names,
        by=tuple(objective.describe().items()),
    )


def _setup(
    objective: AbstractObjective,
    model: Any,
    records: list[Record],
    start: AbstractEstimate | Mapping[str, float | Array],
    known: dict[str, float | Array],
    per_record: tuple[str, ...],
    key: Key[Array, ""] | None,
) -> Setup:
    """Every parameter's value, and which are free."""
    parametric = objective.parametric(model, records[0])
    if objective.needs_key and key is None:
        raise ModelError("random windows need a key: key=jax.random.key(seed).")
    names, defaults, units = objective.parameters(parametric)
    carried: Mapping[str, float | Array] = {}
    if isinstance(start, AbstractEstimate):
        units = {**units, **dict(start.units)} if not names else units
        carried = start.known
        start = {name: start.single()[name] for name in start.parameters}
    given = {**start, **carried, **known}
    local = names or tuple(dict.fromkeys(local_name(name, per_record) for name in given))
    sharing = Sharing(local, per_record, len(records))
    if unknown := [n for n in given if n not in (*local, *sharing.parameters)]:
        raise ModelError(f"unknown parameter '{unknown[0]}'; the model has: {', '.join(local)}.")
    require_numbers(known)
    fixed = {**sharing.values(carried), **sharing.values(known)}
    values = {**sharing.values(defaults), **sharing.values(start), **fixed}
    if missing := [name for name in sharing.parameters if name not in values]:
        raise ModelError(
            f"no value is given for {', '.join(missing)}. Name it in start (to refine it) or in "
            f"known (to hold it)."
        )
    begun = sharing.values(start)
    free = tuple(n for n in sharing.parameters if n in begun and n not in fixed)
    if not free:
        raise ModelError("every parameter is known; nothing is left to refine.")
    dtype = records[0].time_step.dtype
    return Setup(
        parametric,
        records,
        record_keys(key, len(records)),
        {name: _number(values[name], dtype) for name in sharing.parameters},
        free,
        local,
        sharing,
        units,
    )


def _number(value: float | Leaf, dtype: Any) -> Leaf:
    return np.asarray(value, dtype) if is_concrete(value) else jnp.asarray(value, dtype)


class _Begun(NamedTuple):
    """What the start leaves, once starts of windows have settled, and whether it is finite."""

    energy: Float[Array, " quantities"]
    rms: Float[Array, " quantities"]
    status: RefinementStatus


@eqx.filter_jit
def _begin(
    misfit: AbstractMisfit, theta: Float[Array, " p"], starts: Float[Array, "windows s"]
) -> _Begun:
    energy = misfit.settled_energy(theta, starts)
    status = RefinementStatus.where(
        jnp.isfinite(jnp.sum(energy)), RefinementStatus.converged, RefinementStatus.not_finite
    )
    return _Begun(energy, misfit.rms(energy), status)


class _Found(NamedTuple):
    """Where a search ended."""

    theta: Float[Array, " p"]
    starts: Float[Array, "windows s"]
    status: RefinementStatus
    steps: Int[Array, ""]


class _Judged(NamedTuple):
    """What is said of an optimum."""

    uncertainty: Uncertainty
    inflation: Float[Array, " p"]
    rms: Float[Array, " quantities"]
    at_bound: Bool[Array, " p"]
    block_count: Int[Array, ""]
    block_length: Float[Array, ""]
    moment: Float[Array, " p"]
    information: Float[Array, "p p"]


@eqx.filter_jit
def _search(
    misfit: AbstractMisfit,
    laws: Laws,
    start: Float[Array, " p"],
    found: _Found,
    energy: Float[Array, " quantities"],
    sharing: Sharing,
    intervals: AbstractIntervals,
    solver: Solver | None,
    max_steps: int,
    progress: Callable[[float], None] | None,
) -> tuple[_Found, Float[Array, " quantities"], _Judged, Optimum]:
    """The optimum, searched from `found`, which left `energy`."""
    scale = jnp.where(start != 0, jnp.abs(start), 1.0)
    variance = _variance(misfit, energy, start.shape[0])
    problem = Problem(misfit, laws.coordinates(scale), laws, variance)
    point, status, steps, expansion = find_optimum(
        problem, problem.point(found.theta, found.starts), solver, max_steps, progress
    )
    theta, starts = problem.values(point)
    status = RefinementStatus.where(
        found.status == RefinementStatus.not_finite, RefinementStatus.not_finite, status
    )
    at_bound = problem.coordinates.at_bound(theta)
    judged = _judge(misfit, expansion, theta, at_bound, laws, sharing, intervals)
    optimum = Optimum(
        theta,
        starts,
        jnp.abs(start),
        judged.moment,
        judged.information,
        jnp.sqrt(jnp.diagonal(judged.uncertainty.covariance)),
        status == RefinementStatus.converged,
    )
    found = _Found(theta, starts, status, found.steps + steps)
    return found, expansion.energy, judged, optimum


def _variance(
    misfit: AbstractMisfit, energy: Float[Array, " quantities"], unknown: int
) -> Float[Array, ""]:
    """Variance of a residual, of those that may be taken as independent."""
    return jnp.sum(energy) / jnp.maximum(misfit.independent_rows() - unknown, 1)


def _judge(
    misfit: AbstractMisfit,
    expansion: Expansion,
    theta: Float[Array, " p"],
    at_bound: Bool[Array, " p"],
    laws: Laws,
    sharing: Sharing,
    intervals: AbstractIntervals,
) -> _Judged:
    """Uncertainty from the problem linearised at the optimum, in the parameters' units.

    A prior counts as one more observation. Its information is spread over all blocks of time, so
    that resampling them never takes it away, and its own variance is added.
    """
    blocks, short = misfit.blocks(expansion)
    variance = _variance(misfit, expansion.energy, at_bound.shape[0])
    # Holding a parameter that sits on its bound needs no more than a steep slope against it, and
    # one that nothing depends on must not take the others with it.
    total = blocks.flattened().total()
    gram = total.gram
    curvature = jnp.diagonal(gram)
    known = variance * jnp.asarray(laws.prior_weight) ** 2
    tiny = SILENT * jnp.sum(expansion.energy)
    silent = (curvature * theta**2 <= tiny) & (theta != 0) | (curvature == 0)
    held = at_bound | silent & (known == 0)
    held = held | _undetermined(gram + jnp.diag(known), held)
    information = known + jnp.where(held, jnp.maximum(curvature * 1e12, 1.0), 0.0)
    share = blocks.count / jnp.maximum(jnp.sum(blocks.count), 1)
    spread = jnp.diag(jnp.concatenate([jnp.zeros(1), information]))
    moments = blocks.moments + share[..., None, None] * spread[None, None]
    blocks = NormalEquations(moments, blocks.count, blocks.parameters)
    zero = {name: jnp.zeros(()) for name in misfit.names}
    shared = np.array([name not in sharing.individual for name in misfit.names])
    judged = judge([blocks], {}, zero, short, misfit.longest_window, shared, intervals)
    used = jnp.sum(judged.evidence.used)
    covariance = judged.uncertainty.covariance
    if laws.has_priors:
        informed = gram + jnp.diag(information)
        moved = solve_scaled(informed, jnp.diag(jnp.sqrt(variance) * laws.prior_weight))
        covariance = covariance + variance * (moved @ moved.T)
    covariance = jnp.where(held[:, None] | held[None, :], jnp.nan, covariance)
    return _Judged(
        eqx.tree_at(lambda u: u.covariance, judged.uncertainty, covariance),
        judged.inflation,
        misfit.rms(expansion.energy),
        at_bound,
        used,
        jnp.sum(short.durations) / used,
        total.moment,
        jnp.diag(information),
    )


def _undetermined(gram: Float[Array, "p p"], held: Bool[Array, " p"]) -> Bool[Array, " p"]:
    """Parameters that others can make up for, of those that are not held."""
    free = jnp.where(held, 0.0, 1.0)
    scale = unit_scale(jnp.diagonal(gram)) * free
    scaled = gram * scale[:, None] * scale[None, :] + jnp.diag(1 - free)
    sizes, directions = symmetric_eigen(jax.lax.stop_gradient(scaled))
    weak = sizes < COLLINEAR * gram.shape[0]
    return jnp.any(weak[None, :] & (jnp.abs(directions) > TAKES_PART), axis=1)


def _stacked(values: Sequence[Leaf]) -> Float[Array, " p"]:
    """In NumPy where nothing is traced: JAX would compile each small step."""
    return jnp.asarray(np.stack(values)) if is_concrete(values) else jnp.stack(values)

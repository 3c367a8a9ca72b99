"""Estimate a model's parameters, from records (`identify`) or from their sums (`estimate`)."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.criteria.criterion import Rows
from riecjax.elements.catalogue import findings_of_elements
from riecjax.equations.model import Model, as_model
from riecjax.errors import ModelError
from riecjax.estimation.constant_target import target_findings
from riecjax.estimation.constraints import NONE, Bounds, Constraints, constrained_uncertainty
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.excitation import raise_if_nothing_to_fit, raise_if_refused
from riecjax.estimation.parameters import ParameterTable, plan_parameters
from riecjax.estimation.projection import find_shapes
from riecjax.estimation.stages import (
    borne_out,
    level_covariance,
    solve_stages,
    stages_over_records,
)
from riecjax.linear_algebra import factor_of_gram, gram_condition_limit
from riecjax.records.record import Records
from riecjax.records.recording import explaining_errors, findings_of
from riecjax.settings import Identify, taking
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.summarise import ready, signals_read, summed, task
from riecjax.summaries.summary import Summary, as_summary
from riecjax.uncertainty.covariances import naive_covariance
from riecjax.uncertainty.intervals import (
    AbstractIntervals,
    estimate_uncertainty,
    intervals_of,
)

if TYPE_CHECKING:
    from riecjax.equations.equation import Equation


@taking(Identify)
def identify(model: "Equation | Model", records: Records, settings: Identify) -> Estimate:
    """Identify the parameters of a model that is linear in them.

    [`summarise`][] and [`estimate`][] in a row. Works eagerly, with every check, and under
    `jax.jit`, `jax.vmap` and `jax.grad`, where checks of values are left to the result (`rank`,
    `condition_number`).

    **Arguments:**

    - `model`: an `Equation`, several as `staged(...)` or `simultaneous(...)`, or a `Model`.
    - `records`: one record or several, of any lengths; their normal equations add up.
    - `criterion`: `RIEC(AllWindows(alpha, beta))`, `RIEC(RandomWindows(alpha, beta, count))` or
      `DOLS()`. By default all windows of half the periods of the model's band (1 to 10 Hz for a
      model that names none), or as `band`, `alpha`, `beta`, `windows`, `test_function` and
      `quadrature` say; see [`Fit`][riecjax.settings.Fit].
    - `key`: for random windows, `jax.random.key(seed)`. All equations share its windows.
    - `known`: parameters held at these values instead of being estimated.
    - `bounds`: (lower, upper) by name, `None` where there is none. What least squares would take
      beyond one is held there.
    - `priors`: normal distributions (mean, standard deviation) by name, each one more observation,
      weighed against what blocks of time tell of the parameter.
    - `per_record`: parameters with a separate value in each record, such as a sensor's offset;
      in the result `offset` becomes `offset[1]`, `offset[2]`, ...
    - `intervals`: how uncertainty is estimated, [`BlockBootstrap`][] by default, or `"sandwich"`,
      `"naive"`; [`Sandwich`][] is cheaper where thousands of fits are vmapped.
    - `noise` of the signals, whose mark on the windows' sums is taken off: judged from the samples
      unless it is given, see [`GivenNoise`][riecjax.records.GivenNoise]; `"none"` leaves the sums
      as they are.
    - `at_rest`: `"mask"`, the default, leaves out of the sums where a velocity rests at whose zero
      the equation jumps, as dry friction does; `"keep"` does not. See
      [`AtRest`][riecjax.equations.AtRest].

    **Returns:** an [`Estimate`][].

    **Raises:** `ModelError` for an unknown parameter name, an absent key, or an equation with
    nothing to set its scale; `DataError` for an absent signal, a record shorter than a window, or
    no window between gaps; `IdentifiabilityError` if regressors are collinear, naming the
    combination that cannot be told apart.
    """
    recordings = ready(as_model(model), records, settings.noise)
    asked = task(model, recordings, settings, settings.key, settings.at_rest)
    table = plan_parameters(asked.model, len(asked.records), settings.known, settings.per_record)
    intervals = intervals_of(settings.intervals)
    constraints = Constraints.of(table, settings.bounds, settings.priors)
    with explaining_errors(recordings, asked.model.says_change_of):
        found = estimated(asked.model, summed(asked), table, intervals, constraints)

    def otherwise(model: Model) -> Estimate:
        other = summed(asked._replace(model=model))
        return estimated(model, other, table, intervals, constraints)

    of_elements = findings_of_elements(asked.model, asked.records, found, otherwise)
    said = findings_of(
        recordings, lambda one: signals_read(asked.model, one.record, asked.criterion)
    )
    doubts = (*said, *of_elements)
    return dataclasses.replace(found, doubts=doubts) if doubts else found


def estimate(
    model: "Equation | Model",
    summaries: Summary | Sequence[Summary],
    *,
    known: Mapping[str, float | Array] | None = None,
    bounds: Mapping[str, Bounds] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    per_record: Sequence[str] = (),
    intervals: Literal["bootstrap", "sandwich", "naive"] | AbstractIntervals | None = None,
) -> Estimate:
    """Estimate the parameters of a model from what recordings say to it; no sample is read.

    Known values, bounds, priors, intervals, which recordings and which band of window lengths count
    can change from call to call; see [`Summary`][]. Results are those of [`identify`][] of the
    recordings.

    **Arguments:**

    - `model`: the one that the Summary was made for.
    - `summaries`: one, or several, of which each recording counts once.
    - `known`: parameters held at these values instead of being estimated.
    - `bounds`, `priors`: as of [`identify`][].
    - `per_record`: parameters with a separate value in each recording, such as a sensor's
      offset; `offset` becomes `offset[1]`, `offset[2]`, ... in the order of `summary.recordings`.
    - `intervals`: how uncertainty is estimated, [`BlockBootstrap`][] by default.

    **Returns:** an [`Estimate`][], which keeps the Summary.

    **Raises:** as [`identify`][], and `ModelError` for a Summary of another model, or for summaries
    that cannot be merged.
    """
    model, summary = as_model(model), as_summary(summaries)
    summary.require_model(model)
    table = plan_parameters(model, len(summary.recordings), known, per_record)
    constraints = Constraints.of(table, bounds, priors)
    return estimated(model, summary, table, intervals_of(intervals), constraints)


def estimated(
    model: Model,
    summary: Summary,
    table: ParameterTable,
    intervals: AbstractIntervals,
    constraints: Constraints = NONE,
) -> Estimate:
    """[`estimate`][] of what a table of parameters says, from sums that were made for the model."""
    given, modes = (table, intervals, constraints), None
    if not model.has_hidden:
        fit, totals = _solve(summary, *given)
    elif table.per_record:
        raise ModelError("per_record has no meaning yet for a model with hidden elements.")
    else:
        modes, other = (find_shapes(model, summary, table.known, rank) for rank in (0, 1))
        (fit, totals), (beside, _) = (_solve(found.summary, *given) for found in (modes, other))
        # Which lengths tell most of hidden elements is a choice among nearly equals, and what the
        # model and its integrals leave out weighs differently in each. As in an average over models
        # (Buckland, Burnham and Augustin 1997), what the choice moves is part of the variance. It
        # counts as far as both lengths know a parameter equally well, by the ratio of their
        # variances, and where the other shows the elements at all: what lies between is otherwise
        # the scatter of the poorer one.
        mine, its = (xp.diagonal(one.uncertainty.covariance) for one in (fit, beside))
        weight = xp.minimum(mine / xp.where(its > 0, its, xp.inf), 1.0)
        apart = xp.sqrt(weight) * (beside.theta - fit.theta)
        apart = xp.where(other.shown & xp.all(xp.isfinite(apart)), apart, 0.0)
        uncertainty = fit.uncertainty.widened(apart[:, None] * apart[None, :])
        fit = dataclasses.replace(fit, uncertainty=uncertainty)
    if xp.is_concrete(fit.stages):
        raise_if_nothing_to_fit(table, totals)
        # Sums that were made under jit have no constant to tell means from motion by.
        if modes is None and all(s.stages[0][0].constant is not None for s in summary.recordings):
            raise_if_refused(target_findings(model, fit.told_by_data, summary))
        # The condition number is known once the Gram matrix is solved, and mostly that is all.
        limit = gram_condition_limit(fit.theta.dtype)
        poor = modes is None and float(fit.condition_number) > limit
        if poor and (rows := _rows(summary, table)):
            fit, _ = _solve(summary, *given, rows)
    # Rows there would be without gaps are not known of another band than the criterion's.
    offered = sum(one.offered for one in summary.recordings)
    bands = [None] * len(model.stages) if modes is None else modes.bands
    whole = [summary.band == summary.in_law and band is None for band in bands]
    each = [len(of) if known else np.nan for of, known in zip(model.stages, whole)]
    fit = dataclasses.replace(
        fit,
        criterion=summary.criterion,
        stage_names=tuple(table.stages[stage.stage][0] for stage in fit.stages),
        equation_names=tuple(model.equation_names[stage.stage] for stage in fit.stages),
        rows_offered=offered * np.array([each[s.stage] for s in fit.stages]),
        summary=summary if xp.is_concrete(fit.stages, summary) else None,
    )
    if xp.is_concrete(fit.stages):
        raise_if_refused(fit.refusals())
    return fit


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _solve(
    summary: Summary,
    table: ParameterTable,
    intervals: AbstractIntervals,
    constraints: Constraints,
    rows: list[Rows] | None = None,
) -> tuple[Estimate, list[NormalEquations]]:
    """What recordings tell by themselves, by `rows` in place of their sums if there are some; and
    of each stage of the model, those that find nothing included, the totals to refuse it by."""
    equations = [[borne_out(equation) for equation in stage] for stage in summary.equations()]
    known, short = table.known, summary.short_blocks
    stages, shared = stages_over_records(equations, table)
    apart = [[e.flattened() for e in stage] if len(stage) > 1 else [] for stage in shared]
    flat = [stage.flattened() for stage in stages]
    solutions, values = solve_stages(flat, known, rows, apart, constraints, short)
    totals = [stage.total() for stage in flat]
    for solution in solutions:
        place = solution.stage
        stages[place] = solution.constrain(stages[place], values, constraints)
    # What belongs to one recording cannot differ between recordings.
    common = np.array([table[n].recording is None for s in solutions for n in s.parameters])
    uncertainty, inflation, statistics = estimate_uncertainty(
        stages, known, values, short, common, intervals
    )
    uncertainty = uncertainty.widened(level_covariance(statistics, summary.noise_freedom))
    theta, curvature, at_bound = (
        xp.concatenate(parts)
        for parts in zip(*((s.solution.theta, s.prior_curvature, s.at_bound) for s in solutions))
    )
    uncertainty = constrained_uncertainty(uncertainty, statistics, constraints, curvature, at_bound)
    # Nothing is said of the uncertainty of what is held.
    naive = xp.sqrt(xp.diagonal(naive_covariance(statistics)))
    naive = xp.where(at_bound, xp.nan, naive)
    block_count = xp.sum(statistics.used)
    fit = Estimate(
        theta=theta,
        uncertainty=uncertainty,
        table=table,
        inflation=inflation,
        at_bound=at_bound,
        block_count=block_count,
        block_length=xp.sum(short.durations) / block_count,
        naive=naive,
        stages=tuple(solutions),
    )
    return fit, totals


def _rows(summary: Summary, table: ParameterTable) -> list[Rows] | None:
    """Triangular factors in place of each stage's rows, over its equations and all records, where
    there are some.

    A recording that has none has moments that serve as well.
    """
    every = [e.factor for one in summary.recordings for stage in one.stages for e in stage]
    if all(factor is None for factor in every):
        return None
    found = []
    for i, stage in enumerate(summary.equations()):
        names = tuple(dict.fromkeys(n for e in stage for n in table.everywhere(e.parameters)))
        parts = []
        for j, equation in enumerate(stage):
            for k, one in enumerate(summary.recordings):
                factor = one.stages[i][j].factor
                if factor is None:
                    factor = factor_of_gram(equation.moments[k].sum(0))
                own = table.of_record(equation.parameters, k)
                part = np.zeros((1 + len(names), len(factor)))
                part[[0, *(1 + names.index(name) for name in own)]] = np.asarray(factor).T
                parts.append(part)
        columns = np.concatenate(parts, axis=1)
        found.append(Rows(columns, np.arange(columns.shape[1]), names))
    return found

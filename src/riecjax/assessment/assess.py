"""The verb that asks everything of recordings: estimate, refine, test and validate."""

from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Array, Float, Key

from riecjax.assessment.asked import Asked, require_memory_to_assess
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.suited import suited
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import AtRest, HasProcedure, Procedure, with_rests
from riecjax.errors import DataError, ModelError, require
from riecjax.estimation.check import (
    check,
    naming_copies,
    raise_if_not_carried,
    raise_if_refused,
    read_of,
    refusal_by,
)
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.excitation import excitations
from riecjax.estimation.identify import estimate as estimate_of
from riecjax.estimation.linearised import linearised
from riecjax.estimation.mode_evidence import mode_evidence
from riecjax.estimation.parameters import plan_parameters
from riecjax.estimation.resting import at_rest_findings
from riecjax.findings import Finding
from riecjax.leaves import on_host
from riecjax.models.model import as_model
from riecjax.records.noise_judgement import GivenNoise
from riecjax.records.record import Record, Records
from riecjax.records.recording import Recording
from riecjax.studies.drift import WindowSweep
from riecjax.studies.sweep import sweep_edges, window_sweep
from riecjax.summaries.summarise import summarise
from riecjax.summaries.summary import Summary
from riecjax.summaries.task import WRITE_CRITERION, ready
from riecjax.uncertainty.intervals import AbstractIntervals, BlockBootstrap

if TYPE_CHECKING:
    from riecjax.assessment.assessment import Assessment
    from riecjax.refinement.coordinates import Bounds, Prior
    from riecjax.refinement.objective import AbstractObjective


def assess(
    model: Equation | Procedure | HasProcedure,
    recordings: Records,
    criterion: AbstractCriterion | None = None,
    *,
    key: Key[Array, ""] | None = None,
    known: Mapping[str, float | Array] | None = None,
    per_record: Sequence[str] = (),
    intervals: AbstractIntervals | None = None,
    noise: GivenNoise = "auto",
    at_rest: AtRest | None = None,
    refine: "AbstractObjective | Literal['auto'] | None" = "auto",
    bounds: "Mapping[str, Bounds] | None" = None,
    priors: "Mapping[str, Prior] | None" = None,
    horizon: float | None = None,
    hold_out: float | None = None,
    validate_on: Records = (),
    sweep: bool = True,
    on_estimate: Callable[[Estimate], None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> "Assessment":
    """Identify a model's parameters from recordings, and find out how far to trust them.

    What `riecjax identify` does: [`check`][], [`identify`][], [`refine`][] where that is warranted
    or asked for, a sweep over window lengths, tests of what is left, and validation by simulation:
    all that needs no simulation from one pass over the samples. Not under jit.

    **Arguments:** as for [`identify`][], and

    - `recordings`: from [`read_recording`][], or bare records.
    - `refine`: `"auto"` refines by output error and keeps that as the answer only if what it leaves
      is white noise; what a refinement makes small, such as `rx.OutputError()`, makes its values
      the answer (an `rx.IntegralError()` takes the estimate's criterion); `None` for none.
    - `bounds`, `priors` of the refinement, as of [`refine`][]; priors, of one that is asked for.
    - `horizon`: seconds after which simulations start anew from what was recorded, in validation
      and in the refinement of `"auto"`; by default where the motion is unstable.
    - `hold_out`: keep this share at the end of each recording for validation by simulation.
    - `validate_on`: further recordings to simulate the identified model on.
    - `sweep`: whether to estimate against window length, which shows an inexact model, not of
      hidden modes.
    - `on_estimate`: called with the estimate before all that is slow, unless refinement answers.
    - `progress`: called with the sum of squares after each step of a refinement that was asked for.

    **Returns:** an [`Assessment`][].

    **Raises:** as [`identify`][], [`refine`][] and [`split`][riecjax.split], and
    `IdentifiabilityError` for what [`Check.answerable`][] denies. What cannot be tested or
    simulated raises nothing: it is a finding.
    """
    model = as_model(model)
    procedure = with_rests(model.build_procedure(), at_rest)
    recordings = ready(procedure, recordings, noise)
    if criterion is None:
        criterion = suited(procedure, model.band, [each.record for each in recordings])
    require("the criterion", criterion, AbstractCriterion, WRITE_CRITERION)
    _require_sense(hold_out, refine, (bounds, priors), horizon, per_record, validate_on)
    fitted = _concerned(procedure, recordings, criterion)
    halves = [(each, None) if hold_out is None else each.split(hold_out) for each in fitted]
    asked = Asked(
        model,
        procedure,
        criterion,
        [first for first, _ in halves],
        [last for _, last in halves if last is not None],
        _concerned(procedure, ready(procedure, validate_on), criterion) if validate_on else [],
        key,
        {"known": known, "per_record": per_record},
        BlockBootstrap() if intervals is None else intervals,
    )
    return _assessed(asked, (refine, (bounds, priors), horizon, progress), sweep, on_estimate)


def _require_sense(
    hold_out: float | None,
    refine: object,
    beforehand: tuple[object, object],
    horizon: float | None,
    per_record: Sequence[str],
    validate_on: Records,
) -> None:
    require("hold_out", 0.5 if hold_out is None else hold_out, Real, "hold_out=0.2, a share")
    require("horizon", 1.0 if horizon is None else horizon, Real, "horizon=2.0, in seconds")
    asked_for = refine is not None and not (isinstance(refine, str) and refine == "auto")
    if asked_for and not hasattr(type(refine), "specify"):
        require("refine", refine, (), "refine=rx.OutputError(), 'auto' or None")
    if horizon is not None and not horizon > 0:
        raise ModelError(f"horizon is a positive number of seconds; got {horizon:g}.")
    bounds, priors = beforehand
    if bounds and refine is None:
        raise ModelError("bounds belong to a refinement: give refine=rx.OutputError() with them.")
    if priors and not asked_for:
        raise ModelError(
            "priors belong to a refinement that is asked for, since the linear estimate, which may "
            "be the answer otherwise, knows of none: give refine=rx.OutputError() with them."
        )
    if per_record and validate_on:
        raise ModelError(
            "per_record gives a parameter no value on the recordings of validate_on: use one of "
            "the two."
        )


def _assessed(
    asked: Asked,
    refining_by: tuple[Any, ...],
    sweep: bool,
    on_estimate: Callable[[Estimate], None] | None,
) -> "Assessment":
    with naming_copies(asked.procedure, asked.fitted, asked.criterion):
        return _with_answer(asked, refining_by, sweep, on_estimate)


def _with_answer(
    asked: Asked,
    refining_by: tuple[Any, ...],
    sweep: bool,
    on_estimate: Callable[[Estimate], None] | None,
) -> "Assessment":
    procedure, records, criterion = asked.procedure, asked.records, asked.criterion
    require_memory_to_assess(procedure, records, criterion)
    # What is refused without arithmetic is refused before a sample is read.
    plan = plan_parameters(procedure, len(records), **asked.settings)
    # Read once: all that follows is made from these sums.
    sweep = sweep and not procedure.has_hidden
    bins = _bins(records, criterion) if sweep else None
    summary = summarise(procedure, records, criterion, key=asked.key, bins=bins, survey=True)
    estimate = on_host(estimate_of(procedure, summary, **asked.settings, intervals=asked.intervals))
    evidence = mode_evidence(procedure, estimate) if procedure.modes else []
    ordinary = linearised(procedure, summary, plan.given)
    excited = excitations(ordinary, plan)
    # What windows cannot tell from noise, output error may: it needs no derivative.
    raise_if_not_carried(evidence, excited)
    doubted = refusal_by(excited)
    if doubted is None or doubted.code != "unidentifiable" or refining_by[0] != "auto":
        raise_if_refused(excited)
    if on_estimate is not None and doubted is None:
        on_estimate(estimate)

    # Not earlier: to import all that simulates takes seconds.
    from riecjax.assessment import refining, trust
    from riecjax.assessment.assessment import Assessment
    from riecjax.assessment.beforehand import outside_bounds
    from riecjax.assessment.corrected import with_doubts

    checked = check(
        procedure,
        records,
        criterion,
        key=asked.key,
        **asked.settings,
        summary=ordinary,
        excited=excited,
    )
    checked = with_doubts(asked, estimate, checked)
    refused = doubted is not None
    refinement, validations, failed = refining.answered(asked, estimate, refused, *refining_by)
    if refinement is None or not refinement.chosen:
        raise_if_refused(excited)
        failed = [*failed, *outside_bounds(estimate, refining_by[1][0] or {})]
    residuals, choice, untested = trust.what_is_left(procedure, records, estimate, asked.again)
    return Assessment(
        model=asked.model,
        procedure=procedure,
        recordings=asked.fitted,
        validated_on=asked.further,
        checked=checked,
        estimate=estimate,
        sweep=_sweep(procedure, records, summary, asked.settings) if sweep else None,
        residuals=residuals,
        choice=choice,
        seeds=trust.seeds(asked),
        validations=validations,
        refinement=refinement,
        failures=[
            *failed,
            *_resting(asked, estimate),
            *untested,
            *trust.validated_on_fitted(asked),
        ],
        key=asked.key,
        modes=evidence,
    )


def _resting(asked: Asked, found: Estimate) -> list[Finding]:
    """What is said of velocities that rest."""

    def otherwise(procedure: Procedure) -> Estimate:
        summary = summarise(procedure, asked.records, asked.criterion, key=asked.key)
        return estimate_of(procedure, summary, **asked.settings, intervals=asked.intervals)

    return at_rest_findings(asked.procedure, asked.records, found, otherwise)


def _concerned(
    procedure: Procedure, recordings: list[Recording], criterion: AbstractCriterion
) -> list[Recording]:
    """The recordings with what is said of signals that the criterion reads."""
    return [each.concerning(read_of(procedure, each, criterion)) for each in recordings]


def _bins(
    records: list[Record], criterion: AbstractCriterion
) -> Float[np.ndarray, " edges"] | None:
    """Bins of window lengths that the sweep needs, where all windows are summed."""
    if not criterion.in_closed_form:
        return None
    try:
        return sweep_edges(records, criterion)
    except DataError:
        return None  # too short a record, which the check says


def _sweep(
    procedure: Procedure, records: list[Record], summary: Summary, settings: dict[str, Any]
) -> WindowSweep | None:
    if summary.criterion.windows is None:
        return None
    of = records if summary.bins is None else summary
    try:
        return on_host(window_sweep(procedure, of, summary.criterion, **settings))
    except DataError:
        return None

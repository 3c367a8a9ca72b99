"""The verbs that ask everything of recordings: estimate, refine, test and validate; or of sums.

[`assess`][] reads samples, [`assess_summary`][] what was summed of them, and `check_answering` says
beforehand whether there is an answer.
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from jaxtyping import Array, Key

from riecjax.assessment.asked import Asked, require_memory_to_assess, size_of
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.suited import suited
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import AtRest, HasProcedure, Procedure, with_rests
from riecjax.errors import DataError, IdentifiabilityError, ModelError, require
from riecjax.estimation.check import (
    Check,
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
from riecjax.estimation.mode_evidence import mode_evidence
from riecjax.estimation.mode_windows import linearised
from riecjax.estimation.parameters import plan_parameters
from riecjax.estimation.resting import at_rest_findings
from riecjax.findings import Finding
from riecjax.leaves import on_host
from riecjax.models.model import as_model
from riecjax.records.noise_judgement import GivenNoise
from riecjax.records.record import Records
from riecjax.records.recording import Recording, as_recordings, explaining_errors
from riecjax.summaries.summarise import summarise
from riecjax.summaries.summary import Summary
from riecjax.summaries.task import WRITE_CRITERION, ready
from riecjax.uncertainty.intervals import AbstractIntervals, BlockBootstrap, Sandwich
from riecjax.validation.sweep import sweep_edges, window_sweep

if TYPE_CHECKING:
    from riecjax.assessment.assessment import Assessment
    from riecjax.refinement.objective import AbstractObjective
    from riecjax.refinement.optimum import Bounds, Prior


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
    require("hold_out", 0.5 if hold_out is None else hold_out, Real, "hold_out=0.2, a share")
    require("horizon", 1.0 if horizon is None else horizon, Real, "horizon=2.0, in seconds")
    asked_for = refine is not None and not (isinstance(refine, str) and refine == "auto")
    if asked_for and not hasattr(type(refine), "specify"):
        require("refine", refine, (), "refine=rx.OutputError(), 'auto' or None")
    if horizon is not None and not horizon > 0:
        raise ModelError(f"horizon is a positive number of seconds; got {horizon:g}.")
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

    def concerned(some: Sequence[Recording]) -> list[Recording]:
        """The recordings with what is said of signals that the criterion reads."""
        return [each.concerning(read_of(procedure, each, criterion)) for each in some]

    fitted, held = concerned(recordings), []
    if hold_out is not None:
        fitted, held = map(list, zip(*(recording.split(hold_out) for recording in fitted)))
    further = concerned(ready(procedure, validate_on)) if validate_on else []
    settings = {"known": known, "per_record": per_record}
    intervals = BlockBootstrap() if intervals is None else intervals
    asked = Asked(model, procedure, criterion, fitted, held, further, key, settings, intervals)
    with naming_copies(procedure, fitted, criterion):
        refining_by = (refine, (bounds, priors), horizon, progress)
        return _answer(asked, refining_by, sweep, on_estimate)


def _answer(
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
    bins = None
    if sweep and criterion.in_closed_form:
        with contextlib.suppress(DataError):  # too short a record, which the check says
            bins = sweep_edges(records, criterion)
    with explaining_errors(asked.fitted):
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

    checked = check(
        procedure,
        records,
        criterion,
        key=asked.key,
        **asked.settings,
        summary=ordinary,
        excited=excited,
    )
    checked = trust.with_doubts(asked, estimate, checked)
    refused = doubted is not None
    refinement, validations, failed = refining.answered(asked, estimate, refused, *refining_by)
    if refinement is None or not refinement.chosen:
        raise_if_refused(excited)
        failed = [*failed, *refining.outside_bounds(estimate, refining_by[1][0] or {})]
    residuals, choice, untested = trust.what_is_left(procedure, records, estimate, asked.again)

    def estimated_otherwise(procedure: Procedure) -> Estimate:
        summary = summarise(procedure, records, criterion, key=asked.key)
        return estimate_of(procedure, summary, **asked.settings, intervals=asked.intervals)

    resting = at_rest_findings(procedure, records, estimate, estimated_otherwise)
    over_lengths = None
    if sweep and summary.criterion.windows is not None:
        swept = records if summary.bins is None else summary
        with contextlib.suppress(DataError):  # too short for any other length
            over_lengths = on_host(
                window_sweep(procedure, swept, summary.criterion, **asked.settings)
            )
    return Assessment(
        model=asked.model,
        procedure=procedure,
        recordings=asked.fitted,
        validated_on=asked.further,
        checked=checked,
        estimate=estimate,
        sweep=over_lengths,
        residuals=residuals,
        choice=choice,
        validations=validations,
        refinement=refinement,
        failures=[*failed, *resting, *untested, *trust.validated_on_fitted(asked)],
        key=asked.key,
        modes=evidence,
    )


def assess_summary(
    model: Equation | Procedure | HasProcedure,
    summary: Summary,
    *,
    procedure: Procedure | None = None,
    lengths: Summary | None = None,
    findings: Sequence[Finding] = (),
    known: Mapping[str, float | Array] | None = None,
    intervals: AbstractIntervals | None = None,
) -> "Assessment":
    """As [`assess`][riecjax.assess], without what needs samples: tests of residuals, refinement
    and simulation (not under jit).

    **Arguments:** `model`, `known` and `intervals` as for [`assess`][riecjax.assess];

    - `summary` of recordings by [`summarise`][riecjax.summarise].
    - `procedure`: what the model builds, where that is there already: equations that are built once
      compile once.
    - `lengths`: sums of the same recordings in bins of window lengths, for drift.
    - `findings` of the recordings, each with the parameters that it concerns, or for all; see
      [`recording_findings`][riecjax.estimation.recording_findings].

    **Raises:** as [`estimate`][riecjax.estimate], and `IdentifiabilityError` for what
    [`check`][riecjax.check] refuses.
    """
    from riecjax.assessment.assessment import Assessment

    model = as_model(model)
    procedure = model.build_procedure() if procedure is None else procedure
    found = on_host(estimate_of(procedure, summary, known=known, intervals=intervals))
    plan = plan_parameters(procedure, len(summary.recordings), known, ())
    excited = excitations(linearised(procedure, summary, plan.given), plan)
    raise_if_refused(excited)
    told = [*findings, *(finding for stage in excited for finding in stage.findings())]
    sweep = None
    if lengths is not None and not procedure.has_hidden:
        with contextlib.suppress(DataError):  # too short for any
            sweep = on_host(window_sweep(procedure, lengths, known=known))
    return Assessment(
        model=model,
        procedure=procedure,
        recordings=(),
        validated_on=(),
        checked=Check(told, excited, ()),
        estimate=found,
        sweep=sweep,
        modes=mode_evidence(procedure, found) if procedure.modes else (),
    )


class Answering(NamedTuple):
    """What was `checked`, and what answers.

    **Fields:** `by_refinement`: standard error of each parameter as a share of its value, where
    windows cannot tell parameters from noise, and output error from these recordings can.
    """

    checked: Check
    by_refinement: dict[str, float] | None

    @property
    def answerable(self) -> bool:
        """Whether there is an answer, by windows or by refinement."""
        return self.checked.answerable or self.by_refinement is not None


def check_answering(
    model: Equation | Procedure | HasProcedure,
    records: Records,
    criterion: AbstractCriterion,
    *,
    key: Key[Array, ""] | None = None,
    known: Mapping[str, float | Array] | None = None,
    per_record: Sequence[str] = (),
) -> Answering:
    """[`check`][], and where noise rules out an answer by windows, whether refinement has one.

    Windows need derivatives of what is recorded, whose noise grows with frequency; output error
    compares what was recorded. How well it answers is what [`assess`][] would find: at its optimum
    the bound of Cramer and Rao, where its residuals are white.

    **Raises:** as [`check`][].
    """
    described = as_model(model)
    procedure, recordings = described.build_procedure(), as_recordings(records)
    require_memory_to_assess(
        procedure, [each.record for each in recordings], criterion, checking=True
    )
    settings = {"known": known, "per_record": per_record}
    summary = summarise(procedure, recordings, criterion, key=key, survey=True)
    checked = check(procedure, recordings, criterion, key=key, summary=summary, **settings)
    if checked.refusal is None or checked.refusal.code != "unidentifiable":
        return Answering(checked, None)
    # Not earlier: to import all that simulates takes seconds.
    from riecjax.assessment.refining import answered

    parts = (described, procedure, criterion, recordings, [], [], key, settings, Sandwich())
    try:
        start = on_host(estimate_of(procedure, summary, **settings, intervals=Sandwich()))
    except IdentifiabilityError:
        return Answering(checked, None)
    refinement, _, _ = answered(Asked(*parts), start, True, "auto", (None, None), None, None)
    if refinement is None or refinement.refined is None or not refinement.chosen:
        return Answering(checked, None)
    refined = refinement.refined
    errors = zip(refined.parameters, refined.standard_errors)
    return Answering(checked, {n: float(e) / size_of(refined[n]) for n, e in errors})

"""The verbs that ask everything of recordings: estimate, refine, test and validate; or of sums.

[`assess`][] reads samples, [`assess_summary`][] what was summed of them, and `check_answering` says
beforehand whether there is an answer.
"""

import contextlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from jaxtyping import Array

from riecjax.assessment.asked import Asked, require_memory_to_assess, size_of
from riecjax.criteria.criterion import RIEC, AbstractCriterion
from riecjax.criteria.suited import criterion_for
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model, as_model, with_rests
from riecjax.errors import DataError, IdentifiabilityError
from riecjax.estimation.check import (
    Check,
    check_sums,
    linear_sums,
    naming_copies,
    raise_if_not_carried,
    raise_if_refused,
    read_of,
    refusal_by,
)
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.excitation import excitations
from riecjax.estimation.identify import estimated
from riecjax.estimation.parameters import plan_parameters
from riecjax.estimation.resting import at_rest_findings
from riecjax.findings import Finding
from riecjax.leaves import on_host
from riecjax.records.record import Records
from riecjax.records.recording import Recording, as_recordings, explaining_errors
from riecjax.settings import Assess, taking
from riecjax.settings import Check as CheckSettings
from riecjax.summaries.summarise import summarise
from riecjax.summaries.summary import Summary
from riecjax.summaries.task import ready
from riecjax.uncertainty.intervals import AbstractIntervals, Sandwich, intervals_of
from riecjax.validation.sweep import sweep_edges, sweep_of_sums

if TYPE_CHECKING:
    from riecjax.assessment.assessment import Assessment
    from riecjax.estimation.evidence import ModeEvidence


@taking(Assess)
def assess(model: Equation | Model, recordings: Records, settings: Assess) -> "Assessment":
    """Identify a model's parameters from recordings, and find out how far to trust them.

    What `riecjax identify` does: [`check`][], [`identify`][], [`refine`][] where that is warranted
    or asked for, a sweep over window lengths, tests of what is left, and validation by simulation:
    all that needs no simulation from one pass over the samples. Not under jit.

    **Arguments:** as for [`identify`][], and

    - `recordings`: from [`read_recording`][], or bare records.
    - `refine`: `"auto"` refines by output error and keeps that as the answer only if what it leaves
      is white noise; what a refinement makes small, such as `rx.OutputError()`, makes its values
      the answer (an `rx.IntegralError()` takes the estimate's criterion), `"output-error"` and
      `"integral"` likewise; `"none"` or `None` for none. `channels` and `loss` are of
      `"output-error"`.
    - `bounds`, `priors` of the refinement, as of [`refine`][]; priors, of one that is asked for.
    - `horizon`: seconds after which simulations start anew from what was recorded, in validation
      and in the refinement; by default where the motion is unstable.
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
    model = with_rests(as_model(model), settings.at_rest)
    recordings = ready(model, recordings, settings.noise)
    plain = [each.record for each in recordings]
    criterion = criterion_for(settings, model, plain)

    def concerned(some: Sequence[Recording]) -> list[Recording]:
        """The recordings with what is said of signals that the criterion reads."""
        return [each.concerning(read_of(model, each, criterion)) for each in some]

    fitted, held = concerned(recordings), []
    if settings.hold_out is not None:
        fitted, held = map(list, zip(*(each.split(settings.hold_out) for each in fitted)))
    further: Any = settings.validate_on
    further = concerned(ready(model, further)) if further else []
    # What is refused without arithmetic is refused before a sample is read.
    table = plan_parameters(model, len(fitted), settings.known, settings.per_record)
    intervals = intervals_of(settings.intervals)
    asked = Asked(model, criterion, fitted, held, further, table, intervals, settings)
    with naming_copies(model, fitted, criterion):
        return _answer(asked)


def _answer(asked: Asked) -> "Assessment":
    model, records, criterion = asked.model, asked.records, asked.criterion
    table, settings, key = asked.table, asked.settings, asked.settings.key
    require_memory_to_assess(model, records, criterion)
    # Read once: all that follows is made from these sums.
    sweep = settings.sweep and not model.has_hidden
    bins = None
    if sweep and criterion.all_windows is not None:
        with contextlib.suppress(DataError):  # too short a record, which the check says
            bins = sweep_edges(records, criterion)
    with explaining_errors(asked.fitted):
        summary = summarise(model, records, criterion, key=key, bins=bins, survey=True)
    estimate = on_host(estimated(model, summary, table, asked.intervals))
    evidence, ordinary = _about_hidden(model, estimate, summary)
    excited = excitations(ordinary, table)
    # What windows cannot tell from noise, output error may: it needs no derivative.
    raise_if_not_carried(evidence, excited)
    doubted = refusal_by(finding for stage in excited for finding in stage.findings())
    if doubted is None or doubted.code != "unidentifiable" or settings.refine != "auto":
        raise_if_refused(excited)
    if settings.on_estimate is not None and doubted is None:
        settings.on_estimate(estimate)

    # Not earlier: to import all that simulates takes seconds.
    from riecjax.assessment import refining, trust
    from riecjax.assessment.assessment import Assessment

    checked = check_sums(model, ready(model, records), table, ordinary, excited)
    checked = trust.with_doubts(asked, estimate, checked)
    refinement, validations, failed = refining.answered(asked, estimate, doubted is not None)
    if refinement is None or not refinement.chosen:
        raise_if_refused(excited)
        failed = [*failed, *refining.outside_bounds(estimate, settings.bounds)]
    residuals, choice, untested = trust.what_is_left(model, records, estimate, asked.again)
    resting = at_rest_findings(model, records, estimate, asked.otherwise)
    over_lengths = None
    if sweep and summary.criterion.windows is not None:
        with contextlib.suppress(DataError):  # too short for any other length
            if summary.bins is None and isinstance(summary.criterion, RIEC):
                edges = sweep_edges(records, summary.criterion)
                summary = summarise(model, records, summary.criterion.every, bins=edges)
            over_lengths = on_host(sweep_of_sums(summary, table))
    return Assessment(
        model=model,
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
        key=key,
        modes=evidence,
    )


def assess_summary(
    model: Equation | Model,
    summary: Summary,
    *,
    lengths: Summary | None = None,
    findings: Sequence[Finding] = (),
    known: Mapping[str, float | Array] | None = None,
    intervals: Literal["bootstrap", "sandwich", "naive"] | AbstractIntervals | None = None,
) -> "Assessment":
    """As [`assess`][riecjax.assess], without what needs samples: tests of residuals, refinement
    and simulation (not under jit).

    **Arguments:** `model`, `known` and `intervals` as for [`assess`][riecjax.assess];

    - `summary` of recordings by [`summarise`][riecjax.summarise].
    - `lengths`: sums of the same recordings in bins of window lengths, for drift.
    - `findings` of the recordings, each with the parameters that it concerns, or for all; see
      [`recording_findings`][riecjax.estimation.recording_findings].

    **Raises:** as [`estimate`][riecjax.estimate], and `IdentifiabilityError` for what
    [`check`][riecjax.check] refuses.
    """
    from riecjax.assessment.assessment import Assessment

    model = as_model(model)
    summary.require_model(model)
    table = plan_parameters(model, len(summary.recordings), known, ())
    estimate = on_host(estimated(model, summary, table, intervals_of(intervals)))
    evidence, ordinary = _about_hidden(model, estimate, summary)
    excited = excitations(ordinary, table)
    raise_if_refused(excited)
    sweep = None
    if lengths is not None and not model.has_hidden:
        with contextlib.suppress(DataError):  # too short for any
            lengths.require_model(model)
            sweep = on_host(sweep_of_sums(lengths, table))
    return Assessment(
        model=model,
        recordings=(),
        validated_on=(),
        checked=Check(
            [*findings, *(f for stage in excited for f in stage.findings())], excited, ()
        ),
        estimate=estimate,
        sweep=sweep,
        modes=evidence,
    )


def _about_hidden(
    model: Model, estimate: Estimate, summary: Summary
) -> tuple[list["ModeEvidence"], Summary]:
    """What speaks for hidden modes, and the sums, linearised about hidden elements."""
    evidence = []
    if model.modes:
        from riecjax.estimation.evidence import mode_evidence

        evidence = mode_evidence(model, estimate)
    return evidence, linear_sums(model, summary, estimate.table)


class Answering(NamedTuple):
    """What was `checked`, for which `criterion`, and what answers.

    **Fields:** `by_refinement`: standard error of each parameter as a share of its value, where
    windows cannot tell parameters from noise, and output error from these recordings can.
    """

    checked: Check
    criterion: AbstractCriterion
    by_refinement: dict[str, float] | None

    @property
    def refusal(self) -> Finding | None:
        """What rules out an answer both by windows and by refinement."""
        return self.checked.refusal if self.by_refinement is None else None


def check_answering(
    model: Equation | Model, records: Records, settings: CheckSettings
) -> Answering:
    """[`check`][], and where noise rules out an answer by windows, whether refinement has one.

    Windows need derivatives of what is recorded, whose noise grows with frequency; output error
    compares what was recorded. How well it answers is what [`assess`][] would find: at its optimum
    the bound of Cramer and Rao, where its residuals are white.

    **Raises:** as [`check`][].
    """
    model, recordings = as_model(model), as_recordings(records)
    plain, key = [each.record for each in recordings], settings.key
    criterion = criterion_for(settings, model, plain)
    require_memory_to_assess(model, plain, criterion, checking=True)
    summary = summarise(model, recordings, criterion, key=key, survey=True)
    table = plan_parameters(model, len(recordings), settings.known, settings.per_record)
    linear = linear_sums(model, summary, table)
    excited = excitations(linear, table)
    checked = check_sums(model, ready(model, recordings), table, linear, excited)
    by_refinement = None
    if checked.refusal is not None and checked.refusal.code == "unidentifiable":
        # Not earlier: to import all that simulates takes seconds.
        from riecjax.assessment.refining import answered

        unsaid = Assess(key=key)
        asked = Asked(model, criterion, recordings, [], [], table, Sandwich(), unsaid)
        with contextlib.suppress(IdentifiabilityError):
            start = on_host(estimated(model, summary, table, asked.intervals))
            refinement, _, _ = answered(asked, start, True)
            refined = None if refinement is None else refinement.answer
            if refined is not None:
                errors = zip(refined.parameters, refined.standard_errors)
                by_refinement = {name: float(e) / size_of(refined[name]) for name, e in errors}
    return Answering(checked, criterion, by_refinement)

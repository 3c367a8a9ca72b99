"""The verbs that ask everything of recordings: estimate, refine, test and validate; or of sums.

[`assess`][] reads samples, [`assess_summary`][] what was summed of them, and `check_answering` says
beforehand whether there is an answer.
"""

import contextlib
import functools
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from jaxtyping import Array, Key

from riecjax.assessment.advice import Asked, tried
from riecjax.assessment.demands import causes_found
from riecjax.assessment.doubt import Evidence
from riecjax.assessment.refining import (
    Problem,
    Refinement,
    Track,
    Validations,
    against_priors,
    unwarranted,
    validated,
)
from riecjax.assessment.verdict import Verdict, verdict
from riecjax.criteria.criterion import RIEC, AbstractCriterion
from riecjax.criteria.suited import criterion_for, suited
from riecjax.doubts.check import (
    Check,
    check_recordings,
    check_sums,
    looked_at,
    naming_copies,
    raise_if_not_carried,
    read_of,
)
from riecjax.doubts.influence import with_doubts
from riecjax.elements.catalogue import findings_of_elements
from riecjax.equations.model import Model, as_model, with_rests
from riecjax.errors import DataError, IdentifiabilityError, require
from riecjax.estimation.constraints import Constraints
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.evidence import element_tests
from riecjax.estimation.identify import estimate, estimated
from riecjax.estimation.parameters import plan_parameters
from riecjax.findings import Finding
from riecjax.leaves import size_of
from riecjax.records.recording import Recording, as_recordings, explaining_errors
from riecjax.runtime import REMEDY, require_memory
from riecjax.settings import Assess, taking
from riecjax.settings import Check as CheckSettings
from riecjax.shows import Drawn, show
from riecjax.summaries.summarise import ready, summarise
from riecjax.uncertainty.intervals import AbstractIntervals, Naive, Sandwich, intervals_of
from riecjax.validation.sweep import sweep_edges, sweep_of_sums, unlike_windows
from riecjax.validation.tests import own_tests, residuals_tested

if TYPE_CHECKING:
    from riecjax.equations.equation import Equation
    from riecjax.records.record import Record, Records
    from riecjax.summaries.summary import Summary

BYTES_PER_SAMPLE = 110.0
"""Of sums and checks at the peak of memory, for each signal; and, for each equation, of tests of
what it leaves."""
BYTES_PER_ROW = 320.0
"""Of a criterion that draws its windows, for each window and column."""


@dataclass(frozen=True, eq=False, repr=False)
class Assessment(Evidence, Drawn):
    """An estimate, and how far to trust it; made by [`assess`][].

    **Fields:** those of [`Evidence`][riecjax.assessment.doubt.Evidence], `key` of the windows, and
    the assessment `before` the last step that was followed.
    """

    key: Key[Array, ""] | None = None
    before: "Assessment | None" = None

    @property
    def refinement(self) -> Refinement | None:
        """The refinement, if one was asked for or `refine="auto"` tried one."""
        return self.test("refinement")

    @functools.cached_property
    def verdict(self) -> Verdict:
        """Which parameters can be trusted, how far, and what to do about the rest."""
        return verdict(self)

    def show(self) -> Path:
        """Write the report to a temporary folder and open it in the browser.

        **Returns:** the path of report.html.

        **Raises:** `DataError` if a package for reports is not installed.
        """
        return show(self)


@taking(Assess)
def assess(model: "Equation | Model", recordings: "Records", settings: Assess) -> Assessment:
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
    - `bounds`, `priors` of the estimate and of a refinement; of hidden elements only one that is
      asked for knows them.
    - `horizon`: seconds after which simulations start anew from what was recorded, in validation
      and in the refinement; by default where the motion is unstable.
    - `hold_out`: keep this share at the end of each recording for validation by simulation.
    - `validate_on`: further recordings to simulate the identified model on.
    - `sweep`: whether to estimate against window length, which shows an inexact model, not of
      hidden modes.
    - `tests` of your own, each a function that makes a [`Test`][riecjax.validation.Test] of the
      model, the records and the answer; what one raises is a finding.
    - `on_estimate`: called with the estimate before all that is slow, unless refinement answers.
    - `progress`: called with the sum of squares after each step of a refinement that was asked for.
    - `follow`: steps of advice to carry out, one after the other, as long as one helps.

    **Raises:** as [`identify`][], [`refine`][] and [`split`][riecjax.split], and
    `IdentifiabilityError` for what [`Check.answerable`][] denies. What cannot be tested or
    simulated raises nothing: it is a finding.
    """
    model = as_model(model)
    validate_on: Any = settings.validate_on
    further = ready(model, validate_on) if validate_on else []
    asked = Asked(model, ready(model, recordings, settings.noise), further, settings)
    assessment, steps, before = _assessed(asked), [], None
    for number in range(settings.follow + 1):
        trial = functools.partial(_trial, asked)
        helping = {step.options: step for step in tried(assessment, trial)}
        assessment = replace(assessment, tried=helping, followed=(*steps,), before=before)
        if number == settings.follow or not helping:
            break
        options, step = next(iter(helping.items()))
        asked = asked.with_options(options)
        steps.append(step)
        before, assessment = assessment, _assessed(asked)
    return assessment


def _trial(asked: Asked, options: Sequence[str]) -> Assessment:
    """An assessment with further options, without what is slow and what tells of no parameter."""
    asked = asked.with_options(options)
    refine = asked.settings.refine if "--refine" in options else "none"
    settings = replace(asked.settings, refine=refine, tests=(), on_estimate=None)
    return _assessed(asked._replace(further=[], settings=settings))


def _assessed(asked: Asked) -> Assessment:
    """The assessment of what is asked, as it is."""
    model, recordings, further, settings = asked
    model = with_rests(model, settings.at_rest).for_records([one.record for one in recordings])
    criterion = criterion_for(settings, model, [each.record for each in recordings])

    def concerning(some: Sequence[Recording]) -> list[Recording]:
        """The recordings with what is said of signals that the criterion reads."""
        # The sums raise what an equation refuses.
        return [each.concerning(read_of(model, each, criterion, summed=True)) for each in some]

    fitted, held = concerning(recordings), []
    if settings.hold_out is not None:
        parts = [each.split(settings.hold_out) for each in fitted]
        fitted, held = [part[0] for part in parts], [part[1] for part in parts]
    makers = settings.tests or ()
    require("tests", makers, (tuple, list), "tests=[make], a list of functions that make one each")
    further = concerning(further)
    records = [each.record for each in fitted]
    # What is refused without arithmetic is refused before a sample is read.
    table = plan_parameters(model, len(fitted), settings.known, settings.per_record)
    intervals, by_windows = intervals_of(settings.intervals), (None, "none", "auto")
    limits = settings.bounds, settings.priors
    constraints = Constraints.of(table, *limits, refined=settings.refine not in by_windows)

    def again(
        records: "list[Record]",
        model: Model = model,
        by: AbstractIntervals | None = None,
        criterion: AbstractCriterion = criterion,
    ) -> Estimate:
        """What is estimated in the same way from other records, equations or windows."""
        summary = summarise(model, records, criterion, key=settings.key)
        return estimated(model, summary, table, by or Naive(), constraints)

    with naming_copies(model, fitted, criterion):
        require_memory_to_assess(model, records, criterion)
        # Read once: all that follows is made from these sums.
        sweeps, bins = settings.sweep and not model.has_hidden, None
        if sweeps and criterion.all_windows is not None:
            with contextlib.suppress(DataError):  # too short a record, which the check says
                bins = sweep_edges(records, criterion)
        with explaining_errors(fitted, model.says_change_of):
            summary = summarise(model, records, criterion, key=settings.key, bins=bins, survey=True)
        estimate = estimated(model, summary, table, intervals, constraints)
        of_elements = element_tests(model, estimate)
        # Nothing else is asked of recordings that priors and bounds tell.
        table_of_data = estimate.told_by_data
        of_sums, linear = check_sums(model, summary, table_of_data, estimate.known)
        raise_if_not_carried(
            (one for test in of_elements for one in test.evidence), of_sums.excitations
        )
        refusal = of_sums.refusal
        # What windows cannot tell from noise, output error may: it needs no derivative.
        of_windows = refusal is not None and refusal.about.refuses == "windows"
        if not of_windows or settings.refine != "auto":
            of_sums.raise_if_refused()
        if settings.on_estimate is not None and refusal is None:
            settings.on_estimate(estimate)

        checked = check_recordings(model, as_recordings(records), table_of_data, linear, of_sums)
        checked = with_doubts(checked, estimate, model, records, again)
        unseen = [*(Track(part, number) for number, part in enumerate(held)), *map(Track, further)]
        problem = Problem(model, fitted, unseen, settings)
        refinement, validation = answered(problem, estimate, refusal is not None)
        failures = [*validation.failures, *against_priors(estimate, limits[1])]
        refined = None if refinement is None else refinement.answer
        if refined is None:
            of_sums.raise_if_refused()
        # Columns are weighed over all windows, also where others, or none, answer.
        by_windows, unlike = estimate, []
        if criterion.all_windows is None and not model.has_hidden:
            is_drawn = isinstance(criterion, RIEC)
            windows = criterion.every if is_drawn else suited(model, model.band, records)
            with contextlib.suppress(DataError, IdentifiabilityError):
                by_windows = again(records, criterion=windows)
                unlike = [] if is_drawn else unlike_windows(estimate, by_windows)
        residuals = residuals_tested(
            model, records, estimate, functools.partial(causes_found, checked), by_windows
        )
        failures += findings_of_elements(
            model, records, estimate, lambda other: again(records, other, intervals)
        )
        failures += [*unlike, *residuals.findings, *_validated_on_fitted(fitted, further)]
        sweep = None
        if sweeps and table_of_data.free and summary.criterion.windows is not None:
            with contextlib.suppress(DataError):  # too short for any other length
                if summary.bins is None and isinstance(summary.criterion, RIEC):
                    edges = sweep_edges(records, summary.criterion)
                    summary = summarise(model, records, summary.criterion.every, bins=edges)
                sweep = sweep_of_sums(summary, table_of_data)
    validation = validation if validation.runs else None
    own = own_tests(makers, model, records, estimate if refined is None else refined)
    tests = (*of_elements, sweep, *residuals.tests, refinement, validation, *own.tests)
    return Assessment(
        model=model,
        recordings=fitted,
        validated_on=further,
        checked=checked,
        estimate=estimate,
        tests=tuple(test for test in tests if test is not None),
        failures=[*failures, *own.findings],
        key=settings.key,
    )


def answered(
    problem: Problem, estimate: Estimate, refused: bool
) -> tuple[Refinement | None, Validations]:
    """The refinement of an estimate, which may be no more than a start (it was `refused`), if there
    is one, and the validation of what answers.

    **Raises:** as `refine`, for a refinement that was asked for.
    """
    model, settings, start = problem.model, problem.settings, estimate.values
    none, asked = settings.refine in (None, "none"), settings.refine not in (None, "none", "auto")
    horizon = None if asked else settings.horizon
    tracks = [track.within(horizon, model, start) for track in problem.unseen]
    before = validated(model, start, tracks)
    if none:
        return None, before
    if not asked and (why := "" if refused else unwarranted(estimate)):
        return Refinement(estimate, declined=why), before
    # Not earlier: to import all that simulates takes seconds.
    from riecjax.assessment.output_error_search import search_asked_for, search_by_itself

    refinement = (search_asked_for if asked else search_by_itself)(problem, estimate)
    if refinement.refined is None:
        return refinement, before
    values = refinement.refined.values
    after = validated(model, values, tracks)
    refinement = refinement._replace(start=estimate, simulations=after.after(before))
    if asked and not tracks:
        seen = [track.within(None, model, start) for track in problem.seen]
        on_fitted = validated(model, values, seen).after(validated(model, start, seen))
        refinement = refinement._replace(on_fitted=True, simulations=on_fitted)
    elif not asked and refinement.chosen and (worse := refinement.worse()):
        # By itself not where it predicts worse what neither answer was fitted to.
        name, earlier, later = worse[0]
        why = f"it predicts {name} worse: a fit of {later:.1f} %, where the linear estimate has"
        refinement = refinement._replace(declined=f"{why} {earlier:.1f} %")
    return refinement, after if refinement.chosen else before


def _validated_on_fitted(fitted: list[Recording], further: list[Recording]) -> Iterator[Finding]:
    """Recordings to validate on that the model was fitted to, which it follows in any case."""
    places = {(os.path.abspath(one.source), one.part) for one in fitted if one.source}
    for one in further:
        if (os.path.abspath(one.source), one.part) in places:
            yield Finding(
                "validated_on_fitted",
                f"{one.name} is validated on, and the model was fitted to it: that does not show "
                f"whether the model predicts. Validate on another recording, or hold out a part "
                f"(hold_out=0.3, --hold-out 0.3).",
            )


def require_memory_to_assess(
    model: Model,
    records: "Sequence[Record]",
    criterion: AbstractCriterion,
    *,
    checking: bool = False,
) -> None:
    """Refuse to assess a model on these records, or only to check them, without refining it, where
    the memory does not hold it.

    **Raises:** `MemoryError`.
    """
    samples, peak = sum(record.sample_count for record in records), 0.0
    for record in records:
        columns = len(model.equations) + len(record.arrays)
        peak += record.sample_count * BYTES_PER_SAMPLE * columns
        if criterion.needs_key:
            rows = float(criterion.row_count(record) or 0) * (len(model.parameter_names) + 1)
            peak += rows * BYTES_PER_ROW
    verb = "checking" if checking else "assessing"
    require_memory(f"{verb} the model on {samples} samples", peak, REMEDY)


def assess_summary(
    model: "Equation | Model",
    summary: "Summary",
    *,
    lengths: "Summary | None" = None,
    findings: Sequence[Finding] = (),
    known: Mapping[str, float | Array] | None = None,
    intervals: Literal["bootstrap", "sandwich", "naive"] | AbstractIntervals | None = None,
) -> Assessment:
    """As [`assess`][riecjax.assess], without what needs samples: tests of residuals, refinement
    and simulation (not under jit).

    **Arguments:** `model`, `known` and `intervals` as for [`assess`][riecjax.assess];

    - `summary` of recordings by [`summarise`][riecjax.summarise].
    - `lengths`: sums of the same recordings in bins of window lengths, for drift.
    - `findings` of the recordings, each with the parameters that it concerns, or for all; see
      [`recording_findings`][riecjax.doubts.recording_findings].

    **Raises:** as [`estimate`][riecjax.estimate], and `IdentifiabilityError` for what
    [`check`][riecjax.check] refuses.
    """
    model = as_model(model)
    found = estimate(model, summary, known=known, intervals=intervals)
    checked, _ = check_sums(model, summary, found.table, found.known)
    checked.raise_if_refused()
    sweep = None
    if lengths is not None and not model.has_hidden:
        with contextlib.suppress(DataError):  # too short for any
            lengths.require_model(model)
            sweep = sweep_of_sums(lengths, found.table)
    return Assessment(
        model=model,
        recordings=(),
        validated_on=(),
        checked=replace(checked, findings=[*findings, *checked.findings]),
        estimate=found,
        tests=(*element_tests(model, found), *([] if sweep is None else [sweep])),
    )


def check_answering(
    model: "Equation | Model", records: "Records", settings: CheckSettings
) -> Check:
    """[`check`][], and where noise rules out an answer by windows, whether refinement has one.

    Windows need derivatives of what is recorded, whose noise grows with frequency; output error
    compares what was recorded. How well it answers is what [`assess`][] would find: at its optimum
    the bound of Cramer and Rao, where its residuals are white.

    **Raises:** as [`check`][].
    """
    model, recordings = as_model(model), as_recordings(records)
    plain = [each.record for each in recordings]
    require_memory_to_assess(model, plain, criterion_for(settings, model, plain), checking=True)
    checked, summary, table = looked_at(model, recordings, settings)
    if checked.refusal is None or checked.refusal.about.refuses != "windows":
        return checked
    problem = Problem(model, recordings, [], Assess(key=settings.key, intervals=Sandwich()))
    with contextlib.suppress(IdentifiabilityError):
        start = estimated(model, summary, table, Sandwich())
        refinement, _ = answered(problem, start, True)
        if refinement is not None and (refined := refinement.answer) is not None:
            errors = zip(refined.parameters, refined.standard_errors)
            shares = {name: float(error) / size_of(refined[name]) for name, error in errors}
            return replace(checked, by_refinement=shares)
    return checked

"""All that is known of an answer, in numbers and codes; sentences and tables are `reporting`'s."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxtyping import Array, Key

from riecjax.assessment.verdict import Verdict, verdict
from riecjax.equations.model import Model
from riecjax.estimation.check import Check
from riecjax.estimation.estimate import AbstractEstimate, Estimate
from riecjax.findings import Finding
from riecjax.records.recording import Recording
from riecjax.refinement.refine import Refined
from riecjax.shows import Drawn, reported
from riecjax.validation.choice import WindowChoice
from riecjax.validation.residuals import EquationResidual, ResidualTests
from riecjax.validation.sweep import WindowSweep
from riecjax.validation.whiteness import Whiteness

if TYPE_CHECKING:
    from riecjax.estimation.evidence import ModeEvidence
    from riecjax.validation.held_out import HeldOut


class ValidationRun(NamedTuple):
    """A simulation of the identified model along a recording, compared with it in `held`."""

    recording: Recording
    held: "HeldOut"


class BeforeAfter(NamedTuple):
    """Simulations along one recording with the start of a refinement and with its result."""

    recording: Recording
    before: "HeldOut"
    after: "HeldOut"

    @property
    def worst_fits(self) -> tuple[float, float]:
        """The worst fit in percent of any signal before and after; -inf if a simulation failed."""

        def worst(held: "HeldOut") -> float:
            fits = [float(held.signals[n].fit) for n in held.judged] if held.ran else []
            return min((fit for fit in fits if fit == fit), default=-float("inf"))

        return worst(self.before), worst(self.after)


class Refinement(NamedTuple):
    """A refinement, whether its values are the answer, and what it did to predictions.

    **Fields:**

    - `refined`; `None` where `refine="auto"` found nothing that could be one.
    - `declined`: why its values are not the answer, of `refine="auto"`; empty where they are.
    - `whiteness` of what is left, of output error.
    - `simulations`, before and after, on held-out parts and further recordings, or if there are
      none, and the refinement was asked for, on those that were fitted (`on_fitted`).
    """

    refined: Refined | None = None
    declined: str = ""
    whiteness: Whiteness | None = None
    simulations: Sequence[BeforeAfter] = ()
    on_fitted: bool = False

    @property
    def answer(self) -> Refined | None:
        """The refined values, where they are the answer."""
        return None if self.declined else self.refined

    @property
    def chosen(self) -> bool:
        """Whether the refined values are the answer."""
        return self.answer is not None

    def findings(self) -> list[Finding]:
        """What a user should know of refined values that are the answer."""
        findings = [] if self.answer is None else self.answer.findings()
        for run in () if self.answer is None or self.on_fitted else self.simulations:
            before, after = run.worst_fits
            if after < before - 1:
                message = (
                    f"{run.recording.name}: the refined model predicts worse than the identified "
                    f"one (worst fit {before:.1f} % before, {after:.1f} % after): it was bent to "
                    f"the recording that it was fitted to. Use shorter windows (--horizon), or "
                    f"keep the estimate."
                )
                findings.append(Finding("refined_predicts_worse", message))
        return findings


@dataclass(frozen=True, eq=False, repr=False)
class Assessment(Drawn):
    """An estimate, and how far to trust it; made by [`assess`][].

    **Fields:**

    - `model`.
    - `recordings` that were estimated from, and those that it was only `validated_on`: with the
      steps and findings that concern signals which the criterion reads.
    - `checked`: what was looked at before the fit.
    - `estimate`.
    - `sweep`: estimates against window length, if asked for and possible.
    - `residuals`: tests of what is left, if they can be made.
    - `choice` of windows, for a criterion that has some.
    - `refinement`, if one was asked for or `refine="auto"` tried one.
    - `validations`: simulations with the values of `answer`.
    - `failures`: findings on what could not be tested or simulated.
    - `key` of the windows.
    - `modes`: what speaks for each stage's last hidden mode.
    """

    model: Model
    recordings: Sequence[Recording]
    validated_on: Sequence[Recording]
    checked: Check
    estimate: Estimate
    sweep: WindowSweep | None = None
    residuals: ResidualTests | None = None
    choice: WindowChoice | None = None
    validations: Sequence[ValidationRun] = ()
    refinement: Refinement | None = None
    failures: Sequence[Finding] = ()
    key: Key[Array, ""] | None = None
    modes: "Sequence[ModeEvidence]" = ()

    @property
    def answer(self) -> AbstractEstimate:
        """The refined values where those were asked for or chosen, else the linear estimate."""
        refined = None if self.refinement is None else self.refinement.answer
        return self.estimate if refined is None else refined

    @property
    def equation_residuals(self) -> Sequence[EquationResidual]:
        """What each equation leaves, where that can be tested."""
        return () if self.residuals is None else self.residuals.equations

    @property
    def verdict(self) -> Verdict:
        """Which parameters can be trusted, how far, and what to do about the rest."""
        return verdict(self)

    def findings(self) -> list[Finding]:
        """What a user should know, each thing once."""
        read = [f for r in (*self.recordings, *self.validated_on) for f in r.findings]
        before = [*read, *self.failures, *self.checked.findings]
        if self.answer is not self.estimate:
            # Said of windows, and not of what was chosen: a refused estimate leaves no other.
            before = [finding for finding in before if finding.code != "unidentifiable"]
        said = {"short_record"} & {finding.code for finding in before}
        results = (*self.modes, self.sweep, self.residuals, self.refinement)
        return [
            *before,
            *(finding for finding in self.estimate.findings() if finding.code not in said),
            *(f for result in results if result is not None for f in result.findings()),
            *(
                Finding("does_not_predict", f"{run.recording.name}: {run.held.verdict}")
                for run in self.validations
                if not run.held.predicts
            ),
        ]

    def parameters_of(self, finding: Finding) -> set[str]:
        """Parameters that a finding concerns: those it names, or of equations that read its
        signals."""
        table = self.answer.table
        if finding.parameters:
            return table.concerned(finding.parameters)
        # Of sums alone it is not known which equation reads which signal.
        if not finding.signals or not self.recordings:
            return set(table.free)
        smoothness, record = self.estimate.criterion.smoothness, self.recordings[0].record
        reading = [
            equation
            for equation in self.model.equations
            if equation.signals_read(record, smoothness) & set(finding.signals)
        ]
        return table.concerned(name for equation in reading for name in equation.parameters)

    def show(self) -> Path:
        """Write the report to a temporary folder and open it in the browser.

        **Returns:** the path of report.html.

        **Raises:** `DataError` if a package for reports is not installed.
        """
        return reported("plots", "open_report", self)

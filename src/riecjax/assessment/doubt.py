"""How far each parameter may be off: its scatter, and beside it what may be wrong.

An interval from one record describes scatter about the value that a criterion converges to. A
model that leaves something out, or a sensor that is off, has it converge beside the truth, which no
resampling shows. What may be wrong is a column of the equations (`riecjax.doubts`), and what
letting it in does to a parameter is how far the parameter may be off by it:

- **Demanded**: the recordings show it, as a fault of a sensor that is undone and all estimated once
  more; a term, a mode or a delay that explains what the model leaves, or a part of it; stages that
  refute each other's parameters; values that differ between short and long windows.
- **Blind**: nothing recorded tests it, as the course of an input between samples.

Each is a finding that says by what share of its value each parameter moves. Of findings of one code
the shares add up. Of several codes the largest counts: whatever is wrong makes all that correlates
with it look wrong as well.

**Resolution.** No criterion integrates samples, and no sensor is calibrated, better than `FINEST`.
"""

import contextlib
import dataclasses
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from riecjax.criteria.windows import AbstractWindows
from riecjax.doubts.check import Check, compared_relations, parameters_reading
from riecjax.doubts.kinematics import check_kinematics
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.errors import DataError, IdentifiabilityError
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding, in_percent
from riecjax.leaves import size_of
from riecjax.records.preparation.steps import undone
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.records.signal import noise_level
from riecjax.validation.equation_errors import EquationError
from riecjax.validation.residuals import window_errors
from riecjax.validation.tests import BUILT_IN, Test

if TYPE_CHECKING:
    from riecjax.assessment.advice import Step
    from riecjax.validation.residuals import EquationResidual
LEVEL = 0.98
"""Level of the interval that a doubt starts from: one relies on it, so it is to hold more often."""
TRUSTED = 0.1
"""Share of a value up to which a doubt leaves it good."""
FINEST = 1e-3
"""Share of a value below which nothing is claimed."""


@dataclass(frozen=True, eq=False, repr=False)
class Evidence:
    """All that is known of an estimate, from which a verdict follows.

    **Fields:**

    - `model`.
    - `recordings` that were estimated from, and those that it was only `validated_on`: with the
      steps and findings that concern signals which the criterion reads.
    - `checked`: what was looked at before the fit.
    - `estimate`.
    - `tests` that were asked for and could be made; `test` finds one by its name.
    - `failures`: findings on what could not be tested or simulated.
    - `tried`: options to steps that were tried and help; `None` where none was tried; and steps
      that were `followed` to get here.
    """

    model: Model
    recordings: Sequence[Recording]
    validated_on: Sequence[Recording]
    checked: Check
    estimate: Estimate
    tests: tuple[Test, ...] = ()
    failures: Sequence[Finding] = ()
    tried: "Mapping[tuple[str, ...], Step] | None" = None
    followed: "Sequence[Step]" = ()

    def tried_step(self, step: "Step") -> "Step | None":
        """A step as it was tried; `None` of one that does not help."""
        return step if not step.options or self.tried is None else self.tried.get(step.options)

    def test(self, name: str) -> Any:
        """The test of this name, `None` where it was not asked for or could not be made.

        `modes`: evidence of each stage's last hidden mode; `window_sweep`: estimates against window
        length; `residual_tests` of what equations leave; `refinement`; `validation`: simulations
        with the answer; and the names of your own.
        """
        return next((test for test in self.tests if test.name == name), None)

    @property
    def own_tests(self) -> tuple[Test, ...]:
        """Tests of a user's own."""
        return tuple(test for test in self.tests if test.name not in BUILT_IN)

    @property
    def answer(self) -> Estimate:
        """The refined values where those were asked for or chosen, else the linear estimate."""
        refinement = self.test("refinement")
        refined = None if refinement is None else refinement.answer
        return self.estimate if refined is None else refined

    @property
    def equation_residuals(self) -> "Sequence[EquationResidual]":
        """What each equation leaves, where that can be tested."""
        residuals = self.test("residual_tests")
        return () if residuals is None else residuals.equations

    def findings(self) -> list[Finding]:
        """What a user should know, each thing once."""
        read = [f for r in (*self.recordings, *self.validated_on) for f in r.findings]
        before = [*read, *self.failures, *self.checked.findings]
        if self.answer is not self.estimate:
            # Said of windows, and not of what was chosen: a refused estimate leaves no other.
            before = [finding for finding in before if finding.about.refuses != "windows"]
        said = {finding.code for finding in before if finding.about.short}
        return [
            *before,
            *(finding for finding in self.estimate.findings() if finding.code not in said),
            *(finding for test in self.tests for finding in test.findings()),
        ]

    def concerns_answer(self, finding: Finding) -> bool:
        """Whether it is about the answer: what windows leave is not about values that were refined
        until white noise was left."""
        refinement = self.test("refinement")
        left = refinement.whiteness if refinement is not None and refinement.chosen else None
        return finding.about.kind != "model" or left is None or not left.white

    def parameters_of(self, finding: Finding) -> set[str]:
        """Parameters that a finding concerns: those it names, or of equations that read its
        signals."""
        table = self.answer.table
        if finding.parameters:
            return table.concerned(finding.parameters)
        # Of sums alone it is not known which equation reads which signal.
        if not finding.signals or not self.recordings:
            return set(table.free)
        record, criterion = self.recordings[0].record, self.estimate.criterion
        return table.concerned(parameters_reading(self.model, record, criterion, finding.signals))


class Doubt(NamedTuple):
    """How far the `value` of one parameter may be off, in its unit.

    **Fields:** `low`, `high`: reach below and above the value by scatter; `wrong`, by what may be
    wrong, of the `finding` that says most of it, `None` where nothing is; `finest`, what is never
    claimed.
    """

    value: float
    low: float
    high: float
    wrong: float = 0.0
    finding: Finding | None = None
    finest: float = 0.0

    @property
    def scatter(self) -> float:
        """The larger reach of scatter."""
        return max(self.low, self.high)

    @property
    def size(self) -> float:
        """The larger reach of all of it."""
        return self.scatter + self.wrong + self.finest

    @property
    def share(self) -> float:
        """Its size over the value."""
        return self.size / size_of(self.value)

    @property
    def scatter_share(self) -> float:
        """Scatter over the value."""
        return self.scatter / size_of(self.value)

    @property
    def is_good(self) -> bool:
        """Whether it leaves the value good."""
        return self.share <= TRUSTED

    @property
    def is_wrong(self) -> bool:
        """Whether the recordings show that all of it may be wrong; or that the model is, which is
        too much for a good value and more than scatter."""
        if self.finding is None or self.finding.about.assumed:
            return False
        of_model = self.finding.about.kind == "model"
        least = max(self.scatter, TRUSTED * abs(self.value)) if of_model else abs(self.value)
        return self.wrong > least or self.wrong == abs(self.value) > 0

    @property
    def ends(self) -> tuple[float, float]:
        """Of the interval that counts all of it."""
        more = self.wrong + self.finest
        return self.value - self.low - more, self.value + self.high + more


def doubts(evidence: Evidence) -> dict[str, Doubt]:
    """Of each estimated parameter."""
    answer, found = evidence.answer, {}
    below, above = answer.uncertainty.reach(LEVEL)
    errors = np.asarray(answer.standard_errors)
    # By parameter and code, what findings state of it.
    stated: dict[str, dict[str, list[Finding]]] = defaultdict(lambda: defaultdict(list))
    for finding in evidence.findings():
        if (finding.doubt or finding.doubts) and evidence.concerns_answer(finding):
            for name in evidence.parameters_of(finding):
                stated[name][finding.code].append(finding)
    for name, low, high in zip(answer.parameters, below * errors, above * errors):
        value = float(answer[name])
        shares = {code: _stated(name, findings) for code, findings in stated[name].items()}
        worst = max(shares, key=lambda code: shares[code], default="")
        told = max(
            stated[name].get(worst, ()), key=lambda f: f.doubts.get(name, f.doubt), default=None
        )
        found[name] = Doubt(
            value=value,
            low=float(low),
            high=float(high),
            wrong=shares.get(worst, 0.0) * abs(value),
            finding=told,
            finest=FINEST * abs(value),
        )
    return found


def _stated(name: str, findings: Sequence[Finding]) -> float:
    """What findings of one code state of a parameter: of several recordings `doubts` are the same,
    since all are undone at once."""
    together = max((finding.doubts.get(name, 0.0) for finding in findings), default=0.0)
    return together + sum(finding.doubt for finding in findings if name not in finding.doubts)


SPOILT = 0.1
"""Share of a value that a sensor's fault moves it by, from which no equation is asked for more."""


def causes_found(
    checked: Check,
    model: Model,
    records: Sequence[Record],
    errors: Sequence[Sequence[EquationError]],
    estimate: Estimate,
) -> list[Finding]:
    """What explains most of what a model leaves: inputs that say nothing; else faults of sensors,
    and terms that it lacks; and what the course of inputs between samples may do.

    Of signals that contradict each other, or are not what their sensors saw, an equation blames the
    wrong one: then nothing is looked for.

    **Arguments:** what was `checked` before the fit; `errors` of each equation on each record.
    """
    # Not earlier: who only checks recordings waits for none of these.
    from riecjax.discovery.candidate import lacked
    from riecjax.doubts.equation_faults import can_be_weighed, demanded, finding_of
    from riecjax.doubts.sampled_inputs import between_samples

    silent = [*silent_inputs(model.equations, records, errors, estimate.criterion.windows)]
    if silent or not can_be_weighed(model, records, estimate):
        return silent
    assumed = between_samples(model, records, estimate)
    if any(
        (finding.about.disorder or finding.about.holds or finding.about.undo)
        and max(finding.doubts.values(), default=finding.doubt) > SPOILT
        for finding in checked.findings
    ):
        return assumed
    causes = demanded(model, records, estimate, lacked)
    return [*assumed, *(finding_of(cause, model, records) for cause in causes)]


NOISE_ALONE = 0.8
"""Share of a signal's deviation past which all of it is noise. A force of white noise is as well,
and drives the motion, which the equation then explains."""
NOTHING_EXPLAINED = 0.8
"""Share of the target, rms over windows, past which no motion answers to it."""


def silent_inputs(
    equations: Sequence[Equation],
    records: Sequence[Record],
    errors: Sequence[Sequence[EquationError]],
    windows: AbstractWindows | None,
) -> Iterator[Finding]:
    """`silent_input` of recorded inputs that are constant or only noise, and that explain nothing.

    **Arguments:** `errors` of each equation on each record.
    """
    for equation, of_records in zip(equations, errors, strict=True):
        if (name := _only_input(equation)) is None:
            continue
        for number, (record, error) in enumerate(zip(records, of_records, strict=True), 1):
            # In words, that a signal says nothing; values too large to be squared are no silence.
            with np.errstate(over="ignore", invalid="ignore"):
                values = record.signal(name).with_nan
                known = values[~np.isnan(values)]
                spread = float(np.std(known))
                said = ""
                if not spread > 1e-12 * float(np.max(np.abs(known))):
                    said = "never varies"
                elif float(noise_level(values)) > NOISE_ALONE * spread:
                    said = "is noise alone"
            if not said:
                continue
            over_windows = None if windows is None else window_errors([error], windows)
            left = error.relative_rms if over_windows is None else over_windows.relative_rms
            if not float(left) > NOTHING_EXPLAINED:
                continue
            where = f" in recording {number}" if len(records) > 1 else ""
            yield Finding(
                "silent_input",
                f"{name} {said}{where}, while the motion of {equation.name} moves: nothing sets "
                f"the scale of {', '.join(equation.parameters)}, which come out next to zero. "
                f"Check the sensor of {name}, its cable and its column.",
                (name,),
                equation.parameters,
                doubt=1.0,
                step=f"Check the sensor of {name}, its cable and its column",
            )


def _only_input(equation: Equation) -> str | None:
    """The signal of an equation's only known term."""
    inputs = [t.signal for t in equation.terms if not t.parameters]
    return inputs[0] if len(inputs) == 1 else None


def with_doubts(
    checked: Check,
    estimate: Estimate,
    model: Model,
    records: Sequence[Record],
    again: Callable[[list[Record]], Estimate],
) -> Check:
    """What was checked, with how far each fault moves each parameter as its `doubts`.

    **Arguments:** `again` estimates in the same way from other records.
    """
    # Share by which each parameter moves once all records have no such fault.
    doubts: dict[str, dict[str, float]] = {}
    for code in {finding.code for finding in checked.findings if finding.about.undo}:
        with contextlib.suppress(DataError, IdentifiabilityError):
            remedies = [_remedies(checked, code, model, one) for one in records]
            if not any(remedies):
                continue
            other = again([undone(one, options) for one, options in zip(records, remedies)])
            doubts[code] = {
                name: abs(float(other[name]) / float(estimate[name]) - 1)
                for name in estimate.parameters
                if name in other.parameters and float(estimate[name])
            }
    findings = []
    for finding in checked.findings:
        if moved := doubts.get(finding.code):
            name, share = max(moved.items(), key=lambda entry: entry[1])
            effect = f" Without it {name} changes by {in_percent(share)}."
            finding = finding._replace(message=finding.message + effect, doubts=moved)
        findings.append(finding)
    return dataclasses.replace(checked, findings=findings)


def _remedies(checked: Check, code: str, model: Model, record: Record) -> list[tuple[str, ...]]:
    """What takes faults of one code off a record: what is proposed, or, where that is not for all
    recordings, what this one shows by itself."""
    faults = [finding for finding in checked.findings if finding.code == code]
    if not all(finding.remedy for finding in faults):
        compared = compared_relations(model, record, checked.signals)
        faults = [one for one in check_kinematics(record, compared) if one.code == code]
    return [finding.remedy for finding in faults if finding.remedy]

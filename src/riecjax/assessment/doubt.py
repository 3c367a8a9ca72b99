"""How far each parameter may be off: its scatter, and beside it what is known to be wrong.

An interval from one record describes scatter about the value that a criterion converges to. A
model that leaves something out has it converge beside the truth, which no resampling shows. Four
things that an assessment measures do show it, and here become sizes in the parameter's own unit:

**Drift.** With an exact model windows of every length find the same value. How far estimates at
other lengths lie from the answer, beyond the scatter of the difference, is by how much the answer
is a matter of choice.

**What is left.** Let an equation leave the share q of its target, noise of the sensors taken off.
A fit leaves what is orthogonal to its regressors; that much again, or so, lay along them and went
into the parameters. A regressor of size s_j (of the target, per unit of parameter j) keeps a share
w_j of itself that no combination of the others explains, so an error of the size q along it moves
parameter j by q / (s_j w_j). What a model leaves out points anywhere: `ALONG` is the share of it
that is taken to lie along one regressor where tests say that it is the model's doing, `UNBLAMED`
where none does: forces that act on the machine and on no sensor leave as much, and bias little.

**Sensors.** What is found amiss with the recordings may say how far: a velocity that is 1.2 times
the position's derivative puts what reads either of them in doubt by a fifth.

How far a fault moves a parameter, the recordings say themselves: it is taken off, and all is
estimated once more.

**Resolution.** No criterion integrates samples, and no sensor is calibrated, better than `FINEST`.

A fault of a sensor is undone and all is estimated once more; what equations demand, a fault of a
sensor or a term that the model lacks, says by itself what it moves.
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
from riecjax.findings import Finding, class_of, in_percent
from riecjax.leaves import size_of
from riecjax.records.preparation.steps import undone
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.records.signal import noise_level
from riecjax.validation.equation_errors import EquationError
from riecjax.validation.residuals import window_errors
from riecjax.validation.tests import BUILT_IN, Test

if TYPE_CHECKING:
    from riecjax.validation.residuals import EquationResidual
LEVEL = 0.98
"""Level of the interval that a doubt starts from: one relies on it, so it is to hold more often."""
ALONG = 1.0
"""Share of what an equation leaves that is taken to lie along one regressor."""
UNBLAMED = 0.1
"""The same where no test says whose doing it is: the model's, or that of forces nobody recorded."""
STEADIER = 10.0
"""Times its drift and scatter by which what is left may move a value at most. What lies along a
regressor weighs differently at every window length, so a value that no length moves is not far
off; 10 holds of nearly all simulated systems (`python -m benchmarks.calibration verdicts`)."""
TRUSTED = 0.1
"""Share of a value up to which a doubt leaves it good."""
MOST_LEFT = 0.99
"""Share of a target past which no more is told of what an equation leaves."""
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
    """

    model: Model
    recordings: Sequence[Recording]
    validated_on: Sequence[Recording]
    checked: Check
    estimate: Estimate
    tests: tuple[Test, ...] = ()
    failures: Sequence[Finding] = ()

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

    **Fields:** `low`, `high`: reach below and above the value by scatter; `drift` over window
    lengths; `left_out`, by what the model leaves; `sensors`, by what is amiss with the recordings;
    `finest`, what is never claimed.
    """

    value: float
    low: float
    high: float
    drift: float = 0.0
    left_out: float = 0.0
    sensors: float = 0.0
    finest: float = 0.0

    @property
    def scatter(self) -> float:
        """The larger reach of scatter."""
        return max(self.low, self.high)

    @property
    def known_wrong(self) -> float:
        """What is known to be wrong beside scatter."""
        return self.drift + self.left_out + self.sensors

    @property
    def size(self) -> float:
        """The larger reach of all of it."""
        return self.scatter + self.known_wrong + self.finest

    def share(self, part: float) -> float:
        """A part of it over the value."""
        return part / size_of(self.value)

    def by_kind(self, kind: str) -> float:
        """What of it a kind of cause makes, over the value."""
        parts = {"model": self.drift + self.left_out, "sensors": self.sensors}
        return self.share(parts.get(kind, self.scatter))

    @property
    def ends(self) -> tuple[float, float]:
        """Of the interval that counts all of it."""
        more = self.known_wrong + self.finest
        return self.value - self.low - more, self.value + self.high + more


def doubts(evidence: Evidence) -> dict[str, Doubt]:
    """Of each estimated parameter.

    Where output error left white noise the model is as good as the record can tell, and neither
    drift nor residuals of the linear estimate concern refined values.
    """
    answer, refinement = evidence.answer, evidence.test("refinement")
    residuals, sweep = evidence.test("residual_tests"), evidence.test("window_sweep")
    below, above = answer.uncertainty.reach(LEVEL)
    errors = np.asarray(answer.standard_errors)
    left = refinement.whiteness if refinement is not None and refinement.chosen else None
    exact = left is not None and left.white
    # A fault that explains what is left moves these by a known amount.
    faults = () if residuals is None else residuals.faults
    known = {name for fault in faults for name in fault.doubts}
    # How far estimates in windows of other lengths lie from the answer, beyond chance.
    drift = {}
    if sweep is not None and not exact:
        names = {*sweep.parameters} & {*answer.parameters}
        drift = {name: sweep.away(name, float(answer[name])) for name in names}
    moves = {} if exact else left_out(evidence)
    # Of each kind of fault all that findings state, of kinds the worst.
    amiss: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for finding in evidence.findings():
        for name in evidence.parameters_of(finding):
            share = finding.doubts.get(name, finding.doubt)
            if share > 0:
                amiss[name][finding.code] += share * abs(float(answer[name]))

    def stated(name: str, of_model: bool) -> float:
        """The largest size of a kind of fault of the model, or of the recordings."""
        sizes = amiss[name].items()
        return max((s for c, s in sizes if (class_of(c).kind == "model") == of_model), default=0.0)

    by_name = {}
    for name, low, high in zip(answer.parameters, below * errors, above * errors):
        drifted, moved = (0.0 if name in known else by.get(name, 0.0) for by in (drift, moves))
        if sweep is not None:
            moved = min(moved, STEADIER * (drifted + max(float(low), float(high))))
        by_name[name] = Doubt(
            value=float(answer[name]),
            low=float(low),
            high=float(high),
            drift=drifted,
            left_out=moved + stated(name, of_model=True),
            sensors=stated(name, of_model=False),
            finest=FINEST * abs(float(answer[name])),
        )
    return by_name


def left_out(evidence: Evidence) -> Mapping[str, float]:
    """How far each parameter may be moved by what its equations leave that is not noise."""
    estimate = evidence.estimate
    excited = evidence.checked.excitations
    own = {n: float(share) for e in excited for n, share in zip(e.parameters, e.own_share)}
    # Equations of which a finding says that what they leave is the model's: one of their own, or
    # of another test on one of their parameters.
    residuals = evidence.equation_residuals
    blamed = {r.name for r in residuals if any(f.about.blames_model for f in r.findings())}
    others = (test for test in evidence.tests if test.name != "residual_tests")
    findings = (finding for test in others for finding in test.findings())
    named = {name for f in findings if f.about.blames_model for name in f.parameters}
    fits = estimate.equations.items()
    blamed |= {name for name, fit in fits if named & set(fit.parameters)}
    # A constant error is orthogonal to motion about a mean, and biases nothing.
    constant = {residual.name: residual.shared_energy for residual in residuals}
    moved: dict[str, float] = {}
    for stage, equations in zip(estimate.stages, estimate.equation_names):
        left = float(stage.relative_rms)
        if not left > 0:
            continue
        target = float(stage.residual_rms) / left * float(stage.count) ** 0.5
        # Measured by what the fit explains, it is q / (1 - q): of a target that is mostly left
        # over, the little that is explained is in doubt altogether.
        along = 0.0
        for fit, equation in zip(stage.equations, equations):
            rms = float(fit.residual_rms) * float(fit.count) ** 0.5
            rms *= float(fit.model_rms) / size_of(fit.relative_rms)
            rms *= (1 - constant.get(equation, 0.0)) ** 0.5
            share = min(rms / size_of(target), MOST_LEFT)
            along = max(along, (ALONG if equation in blamed else UNBLAMED) * share / (1 - share))
        for name, size in zip(stage.parameters, stage.relative_size):
            reach = float(size) * own.get(name, 1.0)
            if reach > 0:
                moved[name] = along / reach
    return moved


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
    and terms that it lacks.

    Of signals that contradict each other, or are not what their sensors saw, an equation blames the
    wrong one: then nothing is looked for.

    **Arguments:** what was `checked` before the fit; `errors` of each equation on each record.
    """
    # Not earlier: who only checks recordings waits for none of these.
    from riecjax.discovery.candidate import lacked
    from riecjax.doubts.equation_faults import demanded, finding_of

    silent = [*silent_inputs(model.equations, records, errors, estimate.criterion.windows)]
    if silent:
        return silent
    if any(
        (finding.about.disorder or finding.about.holds or finding.about.undo)
        and max(finding.doubts.values(), default=finding.doubt) > SPOILT
        for finding in checked.findings
    ):
        return []
    causes = demanded(model, records, estimate, lacked)
    return [finding_of(cause, model, records) for cause in causes]


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

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

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from riecjax.doubts.check import Check, parameters_reading
from riecjax.equations.model import Model
from riecjax.estimation.estimate import Estimate
from riecjax.findings import FINEST, Finding, Step
from riecjax.leaves import size_of
from riecjax.records.recording import Recording
from riecjax.validation.tests import BUILT_IN, Test

LEVEL = 0.98
"""Level of the interval that a doubt starts from: one relies on it, so it is to hold more often."""
TRUSTED = 0.1
"""Share of a value up to which a doubt leaves it good."""


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
    tried: Mapping[tuple[str, ...], Step] | None = None
    followed: Sequence[Step] = ()

    def tried_step(self, step: Step) -> Step | None:
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
    wrong; `largest`, findings that say so, the one that says most of it first and then those that
    say more than half as much; `finest`, what is never claimed; whether the recordings contradict
    it, `refuted`.
    """

    value: float
    low: float
    high: float
    wrong: float = 0.0
    largest: tuple[Finding, ...] = ()
    finest: float = 0.0
    refuted: bool = False

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
    def named(self) -> Finding | None:
        """What says most of `wrong` and knows what to do about it: not a symptom, but what it is
        of."""
        return max(self.largest, key=lambda finding: bool(finding.remedy), default=None)

    @property
    def is_good(self) -> bool:
        """Whether it leaves the value good."""
        return self.share <= TRUSTED and not self.refuted

    @property
    def is_wrong(self) -> bool:
        """Whether the recordings show that all of it may be wrong; or that the model is, which is
        too much for a good value and more than scatter."""
        if not self.largest or self.largest[0].about.assumed:
            return False
        of_model = self.largest[0].about.kind == "model"
        least = max(self.scatter, TRUSTED * abs(self.value)) if of_model else abs(self.value)
        return self.wrong > least or self.wrong == abs(self.value) > 0

    @property
    def ends(self) -> tuple[float, float]:
        """Of the interval that counts all of it."""
        more = self.wrong + self.finest
        return self.value - self.low - more, self.value + self.high + more


def doubts(evidence: Evidence, assumed: bool = True) -> dict[str, Doubt]:
    """Of each estimated parameter, by what is `assumed` as well."""
    answer, found = evidence.answer, {}
    below, above = answer.uncertainty.reach(LEVEL)
    errors = np.asarray(answer.standard_errors)
    # By parameter and code, what findings state of it.
    stated: dict[str, dict[str, list[Finding]]] = defaultdict(lambda: defaultdict(list))
    for finding in evidence.findings():
        states = (finding.doubt or finding.doubts) and (assumed or not finding.about.assumed)
        if states and evidence.concerns_answer(finding):
            for name in evidence.parameters_of(finding):
                stated[name][finding.code].append(finding)
    for name, low, high in zip(answer.parameters, below * errors, above * errors):
        value = float(answer[name])
        shares = {code: _stated(name, findings) for code, findings in stated[name].items()}
        ranked = sorted(shares, key=lambda code: -shares[code])
        wrong = max(shares.values(), default=0.0)
        found[name] = Doubt(
            value=value,
            low=float(low),
            high=float(high),
            wrong=wrong * abs(value),
            largest=tuple(
                finding
                for code in ranked
                if shares[code] > wrong / 2
                for finding in sorted(
                    stated[name][code], key=lambda f: -f.doubts.get(name, f.doubt)
                )
            ),
            finest=FINEST * abs(value),
            # By values with which all equations are left less.
            refuted=any(
                f.about.refutes and f.remedy for some in stated[name].values() for f in some
            ),
        )
    return found


def _stated(name: str, findings: Sequence[Finding]) -> float:
    """What findings of one code state of a parameter: of several recordings `doubts` are the same,
    since all are undone at once."""
    together = max((finding.doubts.get(name, 0.0) for finding in findings), default=0.0)
    return together + sum(finding.doubt for finding in findings if name not in finding.doubts)

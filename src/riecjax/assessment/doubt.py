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

**Resolution.** No criterion integrates samples, and no sensor is calibrated, better than `FINEST`.
"""

from collections import defaultdict
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from riecjax.assessment.asked import size_of
from riecjax.validation.residuals import NOTABLE_SHARED

if TYPE_CHECKING:
    from riecjax.assessment.assessment import Assessment

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
OF_THE_MODEL = ("unmodelled_mode", "hysteresis", "residual_follows_signal", "large_residual")
"""Findings that say of an equation that what it leaves is the model's doing."""


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


def doubts(assessment: "Assessment") -> dict[str, Doubt]:
    """Of each estimated parameter.

    Refined values that are an answer by themselves left white noise: the model is as good as the
    record can tell, and neither drift nor residuals of the linear estimate concern them.
    """
    answer, refinement = assessment.answer, assessment.refinement
    below, above = answer.uncertainty.reach(LEVEL)
    errors = np.asarray(answer.standard_errors)
    left_white = refinement is None or refinement.whiteness is None or refinement.whiteness.white
    exact = refinement is not None and refinement.chosen and left_white
    # A fault that explains what is left moves these by a known amount.
    faults = () if assessment.residuals is None else assessment.residuals.faults
    known = {name for fault in faults for name in fault.doubts}
    # How far estimates in windows of other lengths lie from the answer, beyond chance.
    sweep, drift = assessment.sweep, {}
    if sweep is not None and not exact:
        names = {*sweep.parameters} & {*answer.parameters}
        drift = {name: sweep.away(name, float(answer[name])) for name in names}
    left = {} if exact else left_out(assessment)
    # Of each kind of fault all of what is amiss with the recordings, of kinds the worst.
    amiss: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for finding in assessment.findings():
        for name in assessment.parameters_of(finding):
            share = finding.doubts.get(name, finding.doubt)
            if share > 0:
                amiss[name][finding.code] += share * abs(float(answer[name]))
    by_name = {}
    for name, low, high in zip(answer.parameters, below * errors, above * errors):
        scatter = float(low), float(high)
        drifted, moved = (0.0 if name in known else by.get(name, 0.0) for by in (drift, left))
        if sweep is not None:
            moved = min(moved, STEADIER * (drifted + max(scatter)))
        worst, value = max(amiss[name].values(), default=0.0), float(answer[name])
        by_name[name] = Doubt(value, *scatter, drifted, moved, worst, FINEST * abs(value))
    return by_name


def left_out(assessment: "Assessment") -> Mapping[str, float]:
    """How far each parameter may be moved by what its equations leave that is not noise."""
    estimate = assessment.estimate
    excited = assessment.checked.excitations
    own = {n: float(share) for e in excited for n, share in zip(e.parameters, e.own_share)}
    # Equations of which some test says that what they leave is the model's.
    tests = assessment.equation_residuals
    blamed = {t.name for t in tests if any(f.code in OF_THE_MODEL for f in t.findings())}
    if assessment.sweep is not None:
        drifting = {name for f in assessment.sweep.findings() for name in f.parameters}
        fits = estimate.equations.items()
        blamed |= {name for name, fit in fits if drifting & set(fit.parameters)}
    # By equation, the share of its windows' errors, as energy, that all of them have in common. A
    # constant error is orthogonal to motion about a mean, and biases nothing.
    constant = {
        test.name: min(test.windows.correlation, 1.0)
        for test in tests
        if test.windows is not None and test.windows.correlation > NOTABLE_SHARED
    }
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

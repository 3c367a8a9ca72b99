"""How far what was found before a fit moves parameters: it is undone, and all estimated anew.

**Stages.** A model whose equations are solved in stages takes a parameter from the first stage that
has it. An error of that stage shows nothing by itself: a sensor that is off may be made up for by
wrong values. Later equations that hold these parameters too tell: the parameter's own regressor
there is a column beside those of the later stage, whose coefficient is by how much the two
disagree. Solved together, the equations find values that all of them agree with best; what leaves
least of all equations, as shares of their targets, is the answer to trust.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from riecjax.doubts.causes import FEWEST, LEVEL
from riecjax.doubts.check import Check, compared_relations
from riecjax.doubts.columns import Asked, folds_of
from riecjax.doubts.equation_faults import HALF, MOVES, why_not_weighed
from riecjax.doubts.kinematics import check_kinematics
from riecjax.equations.model import Model
from riecjax.errors import DataError, IdentifiabilityError
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding, in_percent, joined
from riecjax.folds import Folds
from riecjax.records.preparation.steps import undone
from riecjax.records.record import Record


def with_doubts(
    checked: Check,
    estimate: Estimate,
    model: Model,
    records: Sequence[Record],
    again: Callable[..., Estimate],
) -> Check:
    """What was checked, with how far each fault moves each parameter as its `doubts`; and stages
    that refute each other.

    **Arguments:** `again` estimates in the same way from other records, and by another model.
    """
    # Share by which each parameter moves once all records have no such fault.
    doubts: dict[str, dict[str, float]] = {}
    for code in {finding.code for finding in checked.findings if finding.about.undo}:
        with contextlib.suppress(DataError, IdentifiabilityError):
            remedies = [_remedies(checked, code, model, one) for one in records]
            if not any(remedies):
                continue
            other = again([undone(one, options) for one, options in zip(records, remedies)])
            doubts[code] = estimate.moves_to(other)
    findings = []
    for finding in checked.findings:
        if moved := doubts.get(finding.code):
            name, share = max(moved.items(), key=lambda entry: entry[1])
            effect = f" Without it {name} changes by {in_percent(share)}."
            finding = finding._replace(message=finding.message + effect, doubts=moved)
        findings.append(finding)
    findings += refuted(model, records, estimate, again)
    return dataclasses.replace(checked, findings=findings)


def _remedies(checked: Check, code: str, model: Model, record: Record) -> list[tuple[str, ...]]:
    """What takes faults of one code off a record: what is proposed, or, where that is not for all
    recordings, what this one shows by itself."""
    faults = [finding for finding in checked.findings if finding.code == code]
    if not all(finding.remedy for finding in faults):
        compared = compared_relations(model, record, checked.signals)
        faults = [one for one in check_kinematics(record, compared) if one.code == code]
    return [finding.remedy for finding in faults if finding.remedy]


def refuted(
    model: Model, records: Sequence[Record], estimate: Estimate, again: Callable[..., Estimate]
) -> list[Finding]:
    """`stages_disagree`, of stages that refute shared parameters; arguments as of `with_doubts`."""
    if len(model.stages) < 2 or why_not_weighed(model, records, estimate):
        return []
    asked, earlier = Asked.of(model, estimate), set[str]()
    against: dict[str, set[str]] = {}
    for number, stage in enumerate(model.stages):
        own = {name for equation in stage for name in equation.parameters}
        for name in _refuted_by(asked, records, number, own & earlier - {*estimate.known}):
            against.setdefault(joined(model.equation_names[number]), set()).add(name)
        earlier |= own
    if not against:
        return []
    shared = sorted(set().union(*against.values()))
    says = "; ".join(f"{name} refutes {joined(sorted(names))}" for name, names in against.items())
    try:
        other = again([*records], model.solved_together())
    except (DataError, IdentifiabilityError) as error:
        message = f"{says} as earlier equations found them, and together they find none: {error}"
        return [Finding("stages_disagree", message, parameters=tuple(shared), doubt=1.0)]
    doubts = {
        name: share
        for name, share in estimate.moves_to(other).items()
        if abs(float(other[name] - estimate[name])) > MOVES * estimate.standard_error(name)
    }
    if not doubts:
        return []
    most = max(doubts, key=lambda name: doubts[name])
    left, of_other = (
        {name: float(fit.relative_rms) for name, fit in one.equations.items()}
        for one in (estimate, other)
    )
    energies = [sum(share**2 for share in of.values()) for of in (left, of_other)]
    better = energies[1] < HALF * energies[0]
    listed = joined(
        [f"{in_percent(of_other[n])} of {n} instead of {in_percent(left[n])}" for n in left]
    )
    trusted = "so that these are the values to trust" if better else "hardly less"
    message = (
        f"{says} as earlier equations found them. Solved together, {most} is "
        f"{float(other[most]):.4g} instead of {float(estimate[most]):.4g}, and the equations leave "
        f"{listed}, {trusted}."
    )
    return [
        Finding(
            "stages_disagree",
            message,
            parameters=tuple(doubts),
            doubts=doubts,
            remedy=("--together",) if better else (),
            step="Solve the equations of all stages together" if better else "",
        )
    ]


def _refuted_by(
    asked: Asked, records: Sequence[Record], number: int, shared: set[str]
) -> list[str]:
    """Parameters of earlier stages that the equations of a stage refute, each by itself."""
    if not shared:
        return []
    stage = asked.model.stages[number]
    names = [f"{number}.{name}" for equation in stage for name in equation.parameters]
    folds = folds_of(asked._replace(base=names, stages=[number]), records, [], "plain")
    if folds.number < FEWEST:
        return []
    # The target, less what shared parameters make of it.
    mix = np.eye(1 + len(folds.parameters))
    columns = [f"{number}.{name}" for name in sorted(shared)]
    mix[0, folds.columns(columns)] = [-asked.values[name] for name in sorted(shared)]
    samples, motion = (mix @ of @ mix.T for of in (folds.samples, folds.motion))
    less = Folds(samples, motion, folds.parameters)
    own = [name for name in folds.parameters if name not in columns]
    told = zip(sorted(shared), less.beside(own, columns))
    return [name for name, one in told if one.chance * len(columns) < LEVEL]

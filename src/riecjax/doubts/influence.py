"""How far what was found before a fit moves parameters: it is undone, and all estimated anew."""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Sequence

from riecjax.doubts.check import Check, compared_relations
from riecjax.doubts.kinematics import check_kinematics
from riecjax.doubts.shared_parameters import refuted
from riecjax.equations.model import Model
from riecjax.errors import DataError, IdentifiabilityError
from riecjax.estimation.estimate import Estimate
from riecjax.findings import in_percent
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
    together = functools.partial(again, [*records], model.solved_together())
    findings += refuted(model, records, estimate, together)
    return dataclasses.replace(checked, findings=findings)


def _remedies(checked: Check, code: str, model: Model, record: Record) -> list[tuple[str, ...]]:
    """What takes faults of one code off a record: what is proposed, or, where that is not for all
    recordings, what this one shows by itself."""
    faults = [finding for finding in checked.findings if finding.code == code]
    if not all(finding.remedy for finding in faults):
        compared = compared_relations(model, record, checked.signals)
        faults = [one for one in check_kinematics(record, compared) if one.code == code]
    return [finding.remedy for finding in faults if finding.remedy]

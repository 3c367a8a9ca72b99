"""What a fault of sensors does to the answer: estimated again without."""

from collections.abc import Sequence

import numpy as np

from riecjax.assessment.asked import Asked
from riecjax.errors import DataError, IdentifiabilityError
from riecjax.estimation.check import Check
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding
from riecjax.records import leave_out, shift
from riecjax.records.faults.derivative_pairs import Pair, compare
from riecjax.records.faults.relations import Relation, relations
from riecjax.records.preparation.filtering import with_gaps
from riecjax.records.record import Record, samples_with_nan

IN_TIME = ("late_signal", "low_passed")
IN_SIZE = ("wrong_gain",)
IN_ZERO = ("velocity_offset", "drifting_signal")
IN_REACH = ("stuck_sensor", "clipped")


def with_doubts(asked: Asked, estimate: Estimate, checked: Check) -> Check:
    """What was checked, with how far each fault moves each parameter as its `doubts`."""
    doubts = {
        code: _moved(asked, estimate, code, checked.findings)
        for code in {finding.code for finding in checked.findings}
        if code in (*IN_TIME, *IN_SIZE, *IN_ZERO, *IN_REACH)
    }

    def doubted(finding: Finding) -> Finding:
        moved = doubts.get(finding.code) or {}
        if not moved:
            return finding
        most = max(moved, key=lambda name: moved[name])
        said = f" Without it {most} changes by {100 * moved[most]:.2g} %."
        return finding._replace(message=finding.message + said, doubts=moved)

    findings = [doubted(finding) for finding in checked.findings]
    return Check(findings, checked.excitations, checked.signals) if doubts else checked


def _moved(
    asked: Asked, estimate: Estimate, code: str, findings: Sequence[Finding]
) -> dict[str, float]:
    """Share by which each parameter moves once all records have no such fault."""
    pairs = list(relations(asked.procedure.derivatives))
    signals = list(dict.fromkeys(n for f in findings if f.code == code for n in f.signals))
    try:
        records = [
            leave_out(record, *signals) if code in IN_REACH else _without(record, pairs, code)
            for record in asked.records
        ]
        again = asked.again(records)
    except (DataError, IdentifiabilityError):
        return {}
    return {
        name: abs(float(again[name]) / float(estimate[name]) - 1)
        for name in estimate.parameters
        if name in again.parameters and float(estimate[name])
    }


def _without(record: Record, pairs: Sequence[Relation], code: str) -> Record:
    for one in pairs:
        if {*one.names} <= {*record.arrays} and (pair := compare(record, one)) is not None:
            record = _mended(record, pair, code)
    return record


def _mended(record: Record, pair: Pair, code: str) -> Record:
    late = (pair.fit.delay + pair.fit.lag) * pair.step
    if code in IN_TIME:
        which = pair.relation.side(pair.suspect)[0 if late > 0 else 1]
        return shift(record, dict.fromkeys(which, abs(late))) if pair.is_late else record
    name, factor, zero = pair.suspect, 1.0, 0.0
    if code in IN_SIZE:
        factor = pair.scaling if pair.gain_is_off else 1.0
    else:
        name, size = pair.zeroed
        course = np.arange(record.sample_count) / record.sample_count - 0.5
        zero = size * (pair.offset + pair.drift * course)
    noise = record.noise.filtered(name, np.array([factor])) if factor != 1 else record.noise
    values = factor * samples_with_nan(record, name) - zero
    return with_gaps(record, {name: values}, noise=noise)

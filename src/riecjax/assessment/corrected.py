"""What a fault between a signal and its derivative does to the answer: estimated again without."""

from collections.abc import Sequence

import numpy as np

from riecjax.assessment.asked import Asked
from riecjax.errors import DataError, IdentifiabilityError
from riecjax.estimation.check import Check
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.identify import identify
from riecjax.findings import Finding
from riecjax.records import shift
from riecjax.records.faults.derivative_pairs import Pair, compare_pair
from riecjax.records.preparation.filtering import with_gaps
from riecjax.records.record import Record, samples_with_nan
from riecjax.uncertainty.intervals import Naive

IN_TIME, IN_SIZE = ("late_signal", "low_passed"), ("wrong_gain",)
IN_ZERO = ("velocity_offset", "drifting_signal")


def with_doubts(asked: Asked, estimate: Estimate, checked: Check) -> Check:
    """What was checked, with how far each fault of a pair moves each parameter as its `doubts`."""
    doubts = {
        code: _moved(asked, estimate, code)
        for code in {finding.code for finding in checked.findings}
        if code in (*IN_TIME, *IN_SIZE, *IN_ZERO)
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


def _moved(asked: Asked, estimate: Estimate, code: str) -> dict[str, float]:
    """Share by which each parameter moves once the pairs of all records have no such fault."""
    equations = asked.procedure.equations
    pairs = list(dict.fromkeys(pair for one in equations for pair in one.derivatives))
    try:
        records = [_without(record, pairs, code) for record in asked.records]
        again = identify(
            asked.procedure,
            records,
            asked.criterion,
            key=asked.key,
            **asked.settings,
            intervals=Naive(),
        )
    except (DataError, IdentifiabilityError):
        return {}
    return {
        name: abs(float(again[name]) / float(estimate[name]) - 1)
        for name in estimate.parameters
        if name in again.parameters and float(estimate[name])
    }


def _without(record: Record, pairs: Sequence[tuple[str, str]], code: str) -> Record:
    for names in pairs:
        if set(names) <= set(record.arrays) and (pair := compare_pair(record, *names)) is not None:
            record = _mended(record, pair, code)
    return record


def _mended(record: Record, pair: Pair, code: str) -> Record:
    late = (pair.fit.delay + pair.fit.lag) * pair.step
    if code in IN_TIME:
        which = pair.derivative if late > 0 else pair.signal
        return shift(record, {which: abs(late)}) if pair.is_late else record
    values, noise = samples_with_nan(record, pair.derivative), record.noise
    if code in IN_SIZE:
        factor = 1 / pair.fit.gain if pair.gain_is_off else 1.0
        values = factor * values
        noise = noise.filtered(pair.derivative, np.array([factor]))
    else:
        values = values - pair.offset - pair.drift * (np.arange(values.size) / values.size - 0.5)
    return with_gaps(record, {pair.derivative: values}, noise=noise)

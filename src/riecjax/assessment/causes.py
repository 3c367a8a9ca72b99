"""What is known to be wrong with recordings or a model, and how far each thing moves parameters.

A fault of a sensor is undone and all is estimated once more; what equations demand, a fault of a
sensor or a term that the model lacks, says by itself what it moves.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from riecjax.criteria.windows import AbstractWindows
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.errors import DataError, IdentifiabilityError
from riecjax.estimation.check import Check
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding
from riecjax.records import shift
from riecjax.records.faults.derivative_pairs import compare, relations
from riecjax.records.preparation.steps import undone
from riecjax.records.record import Record
from riecjax.records.signal import noise_level
from riecjax.validation.equation_errors import EquationError
from riecjax.validation.residuals import window_errors

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
        (finding.about.disorder or finding.about.undo == "itself")
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
    undoable = [
        f for f in checked.findings if f.about.undo and (f.remedy or f.about.undo != "itself")
    ]
    for code in {finding.code for finding in undoable}:
        faults = [finding for finding in undoable if finding.code == code]
        with contextlib.suppress(DataError, IdentifiabilityError):
            other = again([_undone(record, model, faults) for record in records])
            doubts[code] = {
                name: abs(float(other[name]) / float(estimate[name]) - 1)
                for name in estimate.parameters
                if name in other.parameters and float(estimate[name])
            }
    findings = []
    for finding in checked.findings:
        if moved := doubts.get(finding.code):
            name, share = max(moved.items(), key=lambda entry: entry[1])
            effect = f" Without it {name} changes by {100 * share:.2g} %."
            finding = finding._replace(message=finding.message + effect, doubts=moved)
        findings.append(finding)
    return dataclasses.replace(checked, findings=findings)


def _undone(record: Record, model: Model, faults: Sequence[Finding]) -> Record:
    """The record without faults of one code, as pairs of a signal and its derivative show them."""
    undo = faults[0].about.undo
    if undo == "itself":
        return undone(record, [fault.remedy for fault in faults])
    for relation in relations(model.derivatives):
        if not {*relation.names} <= {*record.arrays} or (pair := compare(record, relation)) is None:
            continue
        if undo == "delay":
            late = pair.fit.delay * pair.step
            which = pair.sides[0 if late > 0 else 1]
            record = shift(record, dict.fromkeys(which, abs(late))) if pair.is_late else record
        elif undo == "gain":
            factor = pair.scaling if pair.gain_is_off else 1.0
            record = record.with_signals({pair.suspect: factor * record.signal(pair.suspect)})
        else:
            name, size = pair.zeroed
            course = np.arange(record.sample_count) / record.sample_count - 0.5
            zero = size * (pair.offset + pair.drift * course)
            record = record.with_signals({name: record.signal(name) - zero})
    return record

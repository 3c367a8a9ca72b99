"""How far to trust an estimate: what is left, and simulations of what was identified.

Imported by [`assess`][riecjax.assess] once the estimate is there: to import all that simulates
takes seconds, and a reader at a terminal should not wait for it.
"""

import contextlib
import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Array

from riecjax.assessment.asked import Asked, Numbered
from riecjax.assessment.assessment import ValidationRun
from riecjax.equations.model import Model
from riecjax.errors import DataError, IdentifiabilityError, RiecjaxError
from riecjax.estimation.check import Check
from riecjax.estimation.estimate import AbstractEstimate, Estimate
from riecjax.estimation.parameters import values_in_recording
from riecjax.findings import Finding
from riecjax.records import leave_out, shift
from riecjax.records.faults.derivative_pairs import Relation, compare, relations
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.simulation.linearisation import growth
from riecjax.simulation.system import AbstractSystem
from riecjax.validation.choice import WindowChoice, window_choice
from riecjax.validation.equation_errors import errors_over_records
from riecjax.validation.input_faults import drifting_inputs, silent_inputs
from riecjax.validation.late_signals import late_signals
from riecjax.validation.residuals import ResidualTests, residual_tests


def what_is_left(
    model: Model,
    records: list[Record],
    estimate: Estimate,
    again: Callable[[list[Record]], Estimate],
) -> tuple[ResidualTests | None, WindowChoice | None, list[Finding]]:
    """Tests of the residual and the choice of windows it suggests, and what else is found.

    Where nothing can be tested, why. `again` estimates from other records.
    """
    windowed = estimate.criterion.windows is not None
    # A fit is not lost because what it leaves cannot be tested.
    try:
        errors = errors_over_records(model, records, estimate.values)
        silent = silent_inputs(model.equations, records, errors, estimate.criterion.windows)
        faults = tuple(silent) or tuple(late_signals(model, records, estimate))
        drifting = [] if faults else [*drifting_inputs(model, records, errors, estimate, again)]
        residuals = residual_tests(model, records, estimate, errors=errors, faults=faults)
        choice = window_choice(model, records, estimate, errors=errors) if windowed else None
    except RiecjaxError as error:
        return None, None, [Finding("residuals_not_tested", str(error))]
    return residuals, choice, drifting


def validated_on_fitted(asked: Asked) -> list[Finding]:
    """Recordings to validate on that the model was fitted to, which it follows in any case."""
    fitted = {(os.path.abspath(one.source), one.part) for one in asked.fitted if one.source}
    return [
        Finding(
            "validated_on_fitted",
            f"{one.name} is validated on, and the model was fitted to it: that does not show "
            f"whether the model predicts. Validate on another recording, or hold out a part "
            f"(hold_out=0.3, --hold-out 0.3).",
        )
        for one in asked.further
        if (os.path.abspath(one.source), one.part) in fitted
    ]


def horizons(
    asked: Asked, estimate: AbstractEstimate, recordings: Numbered, given: float | None
) -> list[float | None]:
    """Seconds over which to simulate each recording; `None` for all of it.

    Those given, or where the motion is unstable those in which differences grow by e^2.5.
    """
    if given is not None:
        return [given] * len(recordings)
    seconds: list[float | None] = []
    for number, recording in recordings:
        grows = None
        # What cannot be simulated is said where it is.
        with contextlib.suppress(RiecjaxError):
            system = system_of(asked.model, estimate.values, number, recording)
            grows = growth(system, recording.record)
        seconds.append(None if grows is None else grows.horizon)
    return seconds


def validated(
    model: Model,
    values: Mapping[str, Array],
    recordings: Numbered,
    windows: Sequence[float | None],
) -> tuple[list[ValidationRun], list[Finding]]:
    """Simulations with these values that could be made, and why the others could not."""
    if not recordings:
        return [], []
    from riecjax.validation.held_out import validate_held_out

    runs, failed = [], []
    for (number, recording), horizon in zip(recordings, windows):
        # A fit is not lost because its model cannot be simulated.
        try:
            system = system_of(model, values, number, recording)
            held = validate_held_out(system, recording.record, horizon=horizon)
            runs.append(ValidationRun(recording, held))
        except RiecjaxError as error:
            failed.append(Finding("not_validated", f"{recording.name}: {error}"))
    return runs, failed


def system_of(
    model: Model, values: Mapping[str, Array], number: int | None, recording: Recording
) -> AbstractSystem:
    """The model with these values, along a recording with or without parameters of its own."""
    names = model.parameter_names
    own = values if number is None else values_in_recording(names, values, number)
    return model.identified_system({name: own[name] for name in names}, recording.record)


IN_TIME = ("late_signal", "low_passed")
IN_SIZE = ("wrong_gain",)
IN_ZERO = ("velocity_offset", "drifting_signal")
IN_REACH = ("stuck_sensor", "clipped")


def with_doubts(asked: Asked, estimate: Estimate, checked: Check) -> Check:
    """What was checked, with how far each fault moves each parameter as its `doubts`."""
    codes = {f.code for f in checked.findings} & {*IN_TIME, *IN_SIZE, *IN_ZERO, *IN_REACH}
    pairs = list(relations(asked.model.derivatives))
    # Share by which each parameter moves once all records have no such fault.
    doubts: dict[str, dict[str, float]] = {}
    for code in codes:
        signals = dict.fromkeys(n for f in checked.findings if f.code == code for n in f.signals)
        with contextlib.suppress(DataError, IdentifiabilityError):
            other = asked.again(
                [
                    leave_out(record, *signals)
                    if code in IN_REACH
                    else _mended(record, pairs, code)
                    for record in asked.records
                ]
            )
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


def _mended(record: Record, pairs: Sequence[Relation], code: str) -> Record:
    """The record without what pairs of a signal and its derivative show of one kind of fault."""
    for relation in pairs:
        if not {*relation.names} <= {*record.arrays} or (pair := compare(record, relation)) is None:
            continue
        if code in IN_TIME:
            late = pair.fit.delay * pair.step
            which = relation.side(pair.suspect)[0 if late > 0 else 1]
            record = shift(record, dict.fromkeys(which, abs(late))) if pair.is_late else record
        elif code in IN_SIZE:
            factor = pair.scaling if pair.gain_is_off else 1.0
            record = record.with_signals({pair.suspect: factor * record.signal(pair.suspect)})
        else:
            name, size = pair.zeroed
            course = np.arange(record.sample_count) / record.sample_count - 0.5
            zero = size * (pair.offset + pair.drift * course)
            record = record.with_signals({name: record.signal(name) - zero})
    return record

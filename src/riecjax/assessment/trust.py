"""How far to trust an estimate: what is left, and simulations of what was identified.

Imported by [`assess`][riecjax.assess] once the estimate is there: to import all that simulates
takes seconds, and a reader at a terminal should not wait for it.
"""

import os
from collections.abc import Callable, Mapping, Sequence

from jaxtyping import Array

from riecjax.assessment.asked import Asked
from riecjax.assessment.assessment import ValidationRun
from riecjax.equations.procedure import Procedure
from riecjax.errors import RiecjaxError
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.estimated_parameters import AbstractEstimate
from riecjax.estimation.parameters import values_of_record
from riecjax.findings import Finding
from riecjax.models.model import Model
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.simulation.linearisation import growth
from riecjax.simulation.system import AbstractSystem
from riecjax.studies.choice import WindowChoice, window_choice
from riecjax.studies.monte_carlo import SeedScatter, seed_scatter
from riecjax.validation.equation_errors import errors_over_records
from riecjax.validation.held_out import validate_held_out
from riecjax.validation.input_faults import drifting_inputs, silent_inputs
from riecjax.validation.late_signals import late_signals
from riecjax.validation.residuals import ResidualTests, residual_tests


def seeds(asked: Asked) -> SeedScatter | None:
    """Scatter over other draws of windows, where some are drawn."""
    if not asked.criterion.needs_key or asked.key is None:
        return None
    return seed_scatter(
        asked.procedure, asked.records, asked.criterion, key=asked.key, **asked.settings
    )


def what_is_left(
    procedure: Procedure,
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
        errors = errors_over_records(procedure, records, estimate.values)
        silent = silent_inputs(procedure.equations, records, errors, estimate.criterion.windows)
        faults = tuple(silent) or tuple(late_signals(procedure, records, estimate))
        drifting = [] if faults else [*drifting_inputs(procedure, records, errors, estimate, again)]
        residuals = residual_tests(procedure, records, estimate, errors=errors, faults=faults)
        choice = window_choice(procedure, records, estimate, errors=errors) if windowed else None
    except RiecjaxError as error:
        return None, None, [Finding("residuals_not_tested", str(error))]
    return residuals, choice, drifting


Numbered = Sequence[tuple[int | None, Recording]]
"""Recordings, each with the number of the one whose own parameters it takes, if it has some."""


def seen(asked: Asked) -> Numbered:
    """What the model was fitted to."""
    return list(enumerate(asked.fitted))


def unseen(asked: Asked) -> Numbered:
    """What the model was not fitted to: last parts that were held out, and further recordings."""
    return [*enumerate(asked.held), *((None, recording) for recording in asked.further)]


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
    found: list[float | None] = []
    for number, recording in recordings:
        try:
            grows = growth(
                system_of(asked.model, estimate.values, number, recording), recording.record
            )
        except RiecjaxError:
            grows = None  # what cannot be simulated is said where it is
        found.append(None if grows is None else grows.horizon)
    return found


def validated(
    model: Model,
    values: Mapping[str, Array],
    recordings: Numbered,
    windows: Sequence[float | None],
) -> tuple[list[ValidationRun], list[Finding]]:
    """Simulations with these values that could be made, and why the others could not."""
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
    own = dict(values) if number is None else values_of_record(values, number)
    names = model.build_procedure().parameters
    return model.identified_system({name: own[name] for name in names}, recording.record)

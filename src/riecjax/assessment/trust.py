"""How far to trust an estimate: refinement, what is left, and simulations of what was identified.

Imported by [`assess`][riecjax.assess] once the estimate is there: to import all that simulates
takes seconds, and a reader at a terminal should not wait for it.
"""

from collections.abc import Callable, Mapping, Sequence

from jaxtyping import Array

from riecjax.assessment.asked import Asked
from riecjax.assessment.assessment import BeforeAfter, Refinement, ValidationRun
from riecjax.equations.procedure import Procedure
from riecjax.errors import RiecjaxError
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.parameters import values_of_record
from riecjax.findings import Finding
from riecjax.leaves import on_host
from riecjax.models.model import Model
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.refinement.coordinates import Bounds
from riecjax.refinement.integral_error import IntegralError
from riecjax.refinement.objective import AbstractObjective
from riecjax.refinement.refine import refine
from riecjax.refinement.refined import Refined
from riecjax.studies.choice import WindowChoice, window_choice
from riecjax.studies.monte_carlo import SeedScatter, seed_scatter
from riecjax.validation.equation_errors import errors_over_records
from riecjax.validation.held_out import validate_held_out
from riecjax.validation.residuals import ResidualTests, residual_tests

MOST_STEPS = 200
"""Steps that a refinement may take."""


def refined(
    asked: Asked,
    estimate: Estimate,
    by: AbstractObjective | None,
    bounds: Mapping[str, Bounds] | None,
    progress: Callable[[float], None] | None,
) -> Refined | None:
    """The refinement from an estimate, over the estimate's windows if no others are asked for.

    **Raises:** as `refine`.
    """
    if by is None:
        return None
    if isinstance(by, IntegralError) and by.criterion is None:
        by = IntegralError(estimate.criterion)
    return on_host(
        refine(
            asked.model,
            asked.records,
            estimate,
            by,
            per_record=asked.settings["per_record"],
            key=asked.key,
            intervals=asked.intervals,
            bounds=bounds,
            max_steps=MOST_STEPS,
            progress=progress,
        )
    )


def seeds(asked: Asked) -> SeedScatter | None:
    """Scatter over other draws of windows, where some are drawn."""
    if not asked.criterion.needs_key or asked.key is None:
        return None
    return seed_scatter(
        asked.procedure, asked.records, asked.criterion, key=asked.key, **asked.settings
    )


def what_is_left(
    procedure: Procedure, records: list[Record], estimate: Estimate
) -> tuple[ResidualTests | None, WindowChoice | None, list[Finding]]:
    """Tests of the residual and the choice of windows it suggests, or why there are none."""
    windowed = estimate.criterion.windows is not None
    # A fit is not lost because what it leaves cannot be tested.
    try:
        errors = errors_over_records(procedure, records, estimate.values)
        residuals = residual_tests(procedure, records, estimate, errors=errors)
        choice = window_choice(procedure, records, estimate, errors=errors) if windowed else None
    except RiecjaxError as error:
        return None, None, [Finding("residuals_not_tested", str(error))]
    return residuals, choice, []


Numbered = Sequence[tuple[int | None, Recording]]
"""Recordings, each with the number of the one whose own parameters it takes, if it has some."""


def unseen(asked: Asked) -> Numbered:
    """What the model was not fitted to: last parts that were held out, and further recordings."""
    return [*enumerate(asked.held), *((None, recording) for recording in asked.further)]


def validated(
    model: Model, values: Mapping[str, Array], recordings: Numbered
) -> tuple[list[ValidationRun], list[Finding]]:
    """Simulations with these values that could be made, and why the others could not."""
    names = model.build_procedure().parameters
    runs, failed = [], []
    for number, recording in recordings:
        own = dict(values) if number is None else values_of_record(values, number)
        # A fit is not lost because its model cannot be simulated.
        try:
            system = model.identified_system({n: own[n] for n in names}, recording.record)
            runs.append(ValidationRun(recording, validate_held_out(system, recording.record)))
        except RiecjaxError as error:
            failed.append(Finding("not_validated", f"{recording.name}: {error}"))
    return runs, failed


def before_after(
    asked: Asked, estimate: Estimate, refined: Refined | None, after: list[ValidationRun]
) -> Refinement | None:
    """Predictions with the start of the refinement and with its result.

    Without recordings to validate on, of those that were fitted.
    """
    if refined is None:
        return None
    recordings = unseen(asked)
    on_fitted = not recordings
    if on_fitted:
        recordings = list(enumerate(asked.fitted))
        after, _ = validated(asked.model, refined.values, recordings)
    before, _ = validated(asked.model, estimate.values, recordings)
    # By recording, not by name: files in different folders may share one.
    earlier = {id(run.recording): run.held for run in before}
    pairs = [
        BeforeAfter(run.recording, earlier[id(run.recording)], run.held)
        for run in after
        if id(run.recording) in earlier
    ]
    return Refinement(refined, pairs, on_fitted)

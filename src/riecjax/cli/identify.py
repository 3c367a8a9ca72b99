"""`riecjax identify`: parameters from recordings."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from riecjax.cli.criteria import CriterionOptions, criterion_options
from riecjax.cli.options import (
    SHARE,
    json_option,
    out_option,
    own_option,
    seed_option,
    set_option,
)
from riecjax.cli.recordings import (
    Recording,
    RecordingOptions,
    are_small,
    common_steps,
    load,
    record_options,
)
from riecjax.cli.refinement import RefinementOptions, refinement_options
from riecjax.errors import RiecjaxError
from riecjax.findings import Finding
from riecjax.runtime import start_jax

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Array, Float, Key

    from riecjax.criteria.criterion import AbstractCriterion
    from riecjax.equations.procedure import Procedure
    from riecjax.estimation.estimate import Estimate
    from riecjax.models.model import Model
    from riecjax.records.record import Record
    from riecjax.refinement.refined import Refined
    from riecjax.reporting.identification import ValidationRun
    from riecjax.reporting.refinement import Refinement
    from riecjax.studies.choice import WindowChoice
    from riecjax.studies.monte_carlo import SeedScatter
    from riecjax.studies.sweep import WindowSweep
    from riecjax.summaries.summary import Summary
    from riecjax.validation.residuals import ResidualTests


class ValidationPart(NamedTuple):
    """A recording, or a part of one, to simulate.

    **Fields:** `on`, what it is called; `record`; `number` (from 0) of the recording whose own
    parameters it takes, where it was one of those identified from.
    """

    on: str
    record: "Record"
    number: int | None


@click.command("identify")
@record_options
@click.option(
    "--model",
    "model_name",
    required=True,
    help="A built-in model (see 'riecjax models') or path/to/file.py[:object].",
)
@criterion_options
@refinement_options
@set_option
@own_option
@click.option(
    "--intervals",
    type=click.Choice(["bootstrap", "sandwich", "naive"]),
    default="bootstrap",
    show_default=True,
    help="How uncertainty is judged; naive takes overlapping windows for independent ones.",
)
@click.option(
    "--hold-out",
    type=SHARE,
    metavar="SHARE",
    help="Keep this share at the end of each recording for validation by simulation.",
)
@click.option(
    "--validate",
    "validation_files",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="RECORD",
    help="Simulate the identified model on this recording. Repeatable.",
)
@click.option(
    "--sweep/--no-sweep",
    default=True,
    show_default=True,
    help="Estimates against window length, which show an inexact model.",
)
@seed_option
@json_option
@out_option
def command(
    recordings: RecordingOptions,
    model_name: str,
    criteria: CriterionOptions,
    refining: RefinementOptions,
    known: dict[str, float],
    own: tuple[str, ...],
    intervals: str,
    hold_out: float | None,
    validation_files: tuple[Path, ...],
    sweep: bool,
    seed: int,
    as_json: bool,
    out: Path | None,
) -> None:
    """Identify a model's parameters from one or several recordings.

    A recording is a CSV, Parquet, MAT, NPZ or MDF file with time in seconds and the model's
    signals in SI units; --map and --scale bring a logger's columns to that.
    """
    if own and validation_files:
        raise click.UsageError(
            "--own gives a parameter no value on the recordings of --validate: use one of the two."
        )
    criteria.require_sense()
    refining.require_sense()
    start_jax(once=are_small([*recordings.files, *validation_files]), keep_compiled=True)
    import jax
    from rich.console import Console

    from riecjax.estimation.check import check, raise_if_refused
    from riecjax.estimation.excitation import excitations
    from riecjax.estimation.identify import estimate as estimated
    from riecjax.estimation.parameters import plan_parameters
    from riecjax.leaves import on_host
    from riecjax.models.catalogue import find_model
    from riecjax.reporting.estimate import estimate_entries, print_estimate
    from riecjax.reporting.output import emit, require_folder
    from riecjax.summaries.summarise import summarise
    from riecjax.uncertainty.intervals import BlockBootstrap, Naive, Sandwich

    if out is not None:
        require_folder(out)
    model = find_model(model_name)
    criterion = criteria.build(model)
    procedure = model.build_procedure()
    loaded = load(recordings.files, recordings, model, criterion)
    estimating, held = _parts(loaded, hold_out)
    further = load(validation_files, recordings, model, criterion)
    records = [recording.record for recording in estimating]
    key = jax.random.key(seed)
    settings = {"known": known, "per_record": own}
    # What is refused without arithmetic is refused before a sample is read.
    unknown = plan_parameters(procedure, len(records), **settings)
    kinds = {"bootstrap": BlockBootstrap(seed=seed), "sandwich": Sandwich(), "naive": Naive()}
    judge = kinds[intervals]
    # Read once: all that follows is made from these sums.
    bins = _bins(records, criterion) if sweep else None
    summary = summarise(procedure, records, criterion, key=key, bins=bins, survey=True)
    estimate = on_host(estimated(procedure, summary, **settings, intervals=judge))
    # What `riecjax check` refuses is refused here, before any of it is shown.
    excited = excitations(summary, unknown)
    raise_if_refused(excited)
    # What is asked for first is shown first: all that follows is about how far to trust it.
    shown = not as_json and refining.refine == "none"
    if shown:
        print_estimate(estimate_entries(model.name, estimate), Console())

    from riecjax.reporting.identification import (
        Identification,
        identification_document,
        print_identification,
        print_judgement,
    )
    from riecjax.reporting.identification_figures import identification_figures
    from riecjax.reporting.identification_page import identification_page

    checked = check(
        procedure, records, criterion, key=key, **settings, summary=summary, excited=excited
    )
    refined = refining.run(model, records, estimate, per_record=own, key=key, intervals=judge)
    found = estimate if refined is None else refined
    to_simulate = _to_simulate(held, further)
    validations, failed = validation_runs(model, found.values, to_simulate)
    residuals, choice, untested = _what_is_left(procedure, records, estimate)
    result = Identification(
        model=model.name,
        procedure=procedure,
        files=[str(recording.file) for recording in loaded],
        records=records,
        steps=common_steps(loaded),
        doubts=[
            *(finding for r in (*loaded, *further) for finding in r.findings),
            *failed,
            *untested,
        ],
        estimate=estimate,
        checked=checked,
        sweep=_sweep(procedure, records, summary, settings) if sweep else None,
        residuals=residuals,
        choice=choice,
        seeds=_seeds(procedure, records, criterion, key, settings),
        validations=validations,
        refinement=_before_after(model, estimate, refined, validations, to_simulate, estimating),
        key=key,
        seed=seed,
    )
    emit(
        identification_document(result),
        as_json=as_json,
        out=out,
        show=print_judgement if shown else print_identification,
        charts=lambda: identification_figures(result),
        page=identification_page,
    )


def _parts(
    loaded: list[Recording], hold_out: float | None
) -> tuple[list[Recording], list[Recording]]:
    """The recordings to estimate from, and those to validate on."""
    if hold_out is None:
        return loaded, []
    from riecjax.records.preparation import split

    halves = [split(recording.record, hold_out) for recording in loaded]
    estimating = [r._replace(record=first) for r, (first, _) in zip(loaded, halves)]
    return estimating, [r._replace(record=last) for r, (_, last) in zip(loaded, halves)]


def _bins(
    records: list["Record"], criterion: "AbstractCriterion"
) -> "Float[np.ndarray, ' edges'] | None":
    """Bins of window lengths that the sweep needs, where all windows are summed."""
    from riecjax.errors import DataError
    from riecjax.studies.sweep import sweep_edges

    if not criterion.in_closed_form:
        return None
    try:
        return sweep_edges(records, criterion)
    except DataError:
        return None  # too short a record, which the check says


def _sweep(
    procedure: "Procedure", records: list["Record"], summary: "Summary", settings: dict[str, Any]
) -> "WindowSweep | None":
    from riecjax.errors import DataError
    from riecjax.leaves import on_host
    from riecjax.studies.sweep import window_sweep

    if summary.criterion.windows is None:
        return None
    of = records if summary.bins is None else summary
    try:
        return on_host(window_sweep(procedure, of, summary.criterion, **settings))
    except DataError:
        return None


def _what_is_left(
    procedure: "Procedure", records: list["Record"], estimate: "Estimate"
) -> tuple["ResidualTests | None", "WindowChoice | None", list[Finding]]:
    """Tests of the residual and the choice of windows it suggests, or why there are none."""
    from riecjax.studies.choice import window_choice
    from riecjax.validation.equation_errors import errors_over_records
    from riecjax.validation.residuals import residual_tests

    windowed = estimate.criterion.windows is not None
    # A fit is not lost because what it leaves cannot be tested.
    try:
        errors = errors_over_records(procedure, records, estimate.values)
        residuals = residual_tests(procedure, records, estimate, errors=errors)
        choice = window_choice(procedure, records, estimate, errors=errors) if windowed else None
    except RiecjaxError as error:
        return None, None, [Finding("residuals_not_tested", str(error))]
    return residuals, choice, []


def _seeds(
    procedure: "Procedure",
    records: list["Record"],
    criterion: "AbstractCriterion",
    key: "Key[Array, '']",
    settings: dict[str, Any],
) -> "SeedScatter | None":
    from riecjax.studies.monte_carlo import seed_scatter

    if not criterion.needs_key:
        return None
    return seed_scatter(procedure, records, criterion, key=key, **settings)


def _before_after(
    model: "Model",
    estimate: "Estimate",
    refined: "Refined | None",
    after: list["ValidationRun"],
    to_simulate: list[ValidationPart],
    fitted: list[Recording],
) -> "Refinement | None":
    """Predictions with the start of the refinement and with its result.

    Without recordings kept for validation, of those that were fitted.
    """
    from riecjax.reporting.refinement import BeforeAfter, Refinement

    if refined is None:
        return None
    on_fitted = not to_simulate
    if on_fitted:
        to_simulate = [ValidationPart(r.file.name, r.record, i) for i, r in enumerate(fitted)]
        after, _ = validation_runs(model, refined.values, to_simulate)
    before, _ = validation_runs(model, estimate.values, to_simulate)
    earlier = {run.on: run.held for run in before}
    pairs = [BeforeAfter(r.on, earlier[r.on], r.held) for r in after if r.on in earlier]
    return Refinement(refined, pairs, on_fitted)


def _to_simulate(held: list[Recording], further: list[Recording]) -> list[ValidationPart]:
    return [
        *(ValidationPart(f"{r.file.name}, last part", r.record, i) for i, r in enumerate(held)),
        *(ValidationPart(r.file.name, r.record, None) for r in further),
    ]


def validation_runs(
    model: "Model", values: "Mapping[str, Array]", parts: list[ValidationPart]
) -> tuple[list["ValidationRun"], list[Finding]]:
    """Simulations of the identified model.

    **Returns:** those that could be made, and why the others could not.
    """
    from riecjax.estimation.parameters import values_of_record
    from riecjax.reporting.identification import ValidationRun
    from riecjax.validation.held_out import validate_held_out

    names = model.build_procedure().parameters
    runs, failed = [], []
    for on, record, number in parts:
        own = dict(values) if number is None else values_of_record(values, number)
        # A fit is not lost because its model cannot be simulated.
        try:
            system = model.identified_system({n: own[n] for n in names}, record)
            runs.append(ValidationRun(on, record, validate_held_out(system, record)))
        except RiecjaxError as error:
            failed.append(Finding("not_validated", f"{on}: {error}"))
    return runs, failed

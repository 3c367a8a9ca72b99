"""`riecjax identify`: parameters from recordings, from options to `assess` to `emit`."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from riecjax.cli import options
from riecjax.cli.job import JobCommand, changed_files, digests, input_files, job_of, job_option
from riecjax.cli.progress import Progress
from riecjax.runtime import start_jax

if TYPE_CHECKING:
    from collections.abc import Mapping

    from riecjax.equations.procedure import AtRest
    from riecjax.reporting.charts.chart import Chart
    from riecjax.reporting.document import Document
    from riecjax.reporting.page import Page


@click.command(
    "identify", cls=JobCommand, short_help="Identify a model's parameters from recordings."
)
@options.model_option
@options.record_options
@options.hidden_options
@options.criterion_options
@options.refinement_options
@options.set_option
@options.per_record_option
@click.option(
    "--intervals",
    type=click.Choice(["bootstrap", "sandwich", "naive"]),
    default="bootstrap",
    show_default=True,
    help="How uncertainty is judged; naive takes overlapping windows for independent ones.",
)
@click.option(
    "--hold-out",
    type=options.SHARE,
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
@options.at_rest_option
@click.option("--verbose", is_flag=True, help="Tell everything, not the verdict alone.")
@options.seed_option
@job_option
@options.json_option
@options.out_option
def command(
    recordings: options.RecordingOptions,
    model_name: str,
    hidden: options.HiddenOptions,
    criteria: options.CriterionOptions,
    refining: options.RefinementOptions,
    known: dict[str, float],
    per_record: tuple[str, ...],
    intervals: str,
    hold_out: float | None,
    validation_files: tuple[Path, ...],
    sweep: bool,
    at_rest: "AtRest | None",
    verbose: bool,
    seed: int,
    as_json: bool,
    out: Path | None,
) -> None:
    """Identify a model's parameters from one or several recordings.

    A recording is a file of text (CSV), JSON, Parquet, MATLAB, HDF5 or NPZ, or with an extra a
    spreadsheet, MDF4, TDMS or ROS bag. Units that it states are converted to SI; --map says which
    column is which signal, --unit in which unit it is where the file states none.
    """
    if per_record and validation_files:
        raise click.UsageError(
            "--per-record gives a parameter no value on the recordings of --validate: use one of "
            "the two."
        )
    criteria.require_sense()
    refining.require_sense(validates=hold_out is not None or bool(validation_files))
    start_jax(once=options.are_small([*recordings.files, *validation_files]), keep_compiled=True)
    from riecjax.compilation import load_ahead

    changed = changed_files(click.get_current_context())
    load_ahead("identify", model_name)
    import jax

    from riecjax.assessment.assess import assess
    from riecjax.reporting.output import require_folder
    from riecjax.uncertainty.intervals import BlockBootstrap, Naive, Sandwich

    if out is not None:
        require_folder(out)
    model = hidden.added_to(model_name)
    kinds = {"bootstrap": BlockBootstrap(seed=seed), "sandwich": Sandwich(), "naive": Naive()}
    with Progress() as progress:
        read = recordings.read(recordings.files, model)
        assessment = assess(
            model,
            read,
            criteria.build(model, read),
            key=jax.random.key(seed),
            known=known,
            per_record=per_record,
            intervals=kinds[intervals],
            refine=refining.objective(),
            bounds=dict(refining.bounds),
            priors=refining.known_before(),
            horizon=refining.validation_horizon,
            hold_out=hold_out,
            validate_on=recordings.read(validation_files, model),
            sweep=sweep,
            at_rest=at_rest,
            on_estimate=progress.show_estimate,
            progress=progress.refining,
        )
    # Not earlier: what reports are made with takes a second to import.
    from riecjax.reporting.identification import (
        identification_document,
        print_everything,
        print_identification,
    )
    from riecjax.reporting.output import emit

    def charts() -> "Mapping[str, Chart]":
        from riecjax.reporting.identification_figures import identification_figures

        return identification_figures(assessment)

    def page(document: "Document") -> "Page":
        from riecjax.reporting.identification_page import identification_page

        return identification_page(document)

    context = click.get_current_context()
    document = identification_document(assessment, context.obj or ())
    # Files that changed have been told of already.
    told = list(document["warnings"]) if verbose or as_json else []
    document["warnings"] += [finding._asdict() for finding in changed]
    document["job"] = job_of(context, out)
    document["provenance"]["files"] = digests(input_files(context), out)
    emit(
        document,
        as_json=as_json,
        out=out,
        show=print_everything if verbose else print_identification,
        charts=charts,
        page=page,
        warnings=told,
    )

"""`riecjax fleet`: parameters of groups of recordings, of which there may be many thousand."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from riecjax.cli import options
from riecjax.runtime import start_jax

if TYPE_CHECKING:
    from riecjax.equations.procedure import AtRest

pattern_options = options.collecting(
    (
        click.argument("files", metavar="PATTERN...", nargs=-1, required=True),
        *options.RECORD_OPTIONS[1:],
    ),
    options.RecordingOptions,
    "recordings",
)
"""The PATTERN... argument, and the options of how all that matches is read."""


@click.command("fleet", short_help="Identify a model's parameters from groups of recordings.")
@options.model_option
@click.option(
    "--by",
    default="file",
    show_default=True,
    metavar="file|folder|COLUMN[,COLUMN]",
    help="What is estimated together: each file, each folder, or all that agrees in keys of its "
    "path (vehicle=3/) or columns of its Parquet files.",
)
@click.option(
    "--span",
    type=options.POSITIVE,
    metavar="SECONDS",
    help="Estimate over time as well, in spans of about this length.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=0, max=4096),
    metavar="N",
    help="Processes that sum; 0 for none but this one. [default: one a core]",
)
@click.option("--scheduler", metavar="ADDRESS", help="Use the workers of this scheduler of Dask.")
@click.option("--strict", is_flag=True, help="End at the first recording that cannot be summed.")
@pattern_options
@options.hidden_options
@options.criterion_options
@options.set_option
@options.at_rest_option
@options.seed_option
@options.json_option
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    required=True,
    help="Folder for estimates.parquet, summaries.parquet and the report. A run that ended goes "
    "on from what it holds.",
)
def command(
    recordings: options.RecordingOptions,
    model_name: str,
    by: str,
    span: float | None,
    workers: int | None,
    scheduler: str | None,
    strict: bool,
    hidden: options.HiddenOptions,
    criteria: options.CriterionOptions,
    known: dict[str, float],
    at_rest: "AtRest | None",
    seed: int,
    as_json: bool,
    out: Path,
) -> None:
    """Identify a model's parameters from each group of recordings, of which there may be many.

    A pattern is a file, a folder, or as in 'drives/**/*.csv'; also the URL of a store that fsspec
    knows, 's3://bucket/drives/*.parquet'. A folder called '*.parquet' is a data set, whose files
    are one recording. The summaries.parquet of an earlier run is estimated anew, with other known
    values or groups, and no recording is read again.
    """
    if workers is not None and scheduler is not None:
        raise click.UsageError("--workers are of this machine, --scheduler has its own: give one.")
    criteria.require_sense()
    start_jax(keep_compiled=True)
    from riecjax.fleets.fleet import fleet
    from riecjax.fleets.kept import ESTIMATES, SUMMARIES
    from riecjax.fleets.report import fleet_document, fleet_figures, fleet_page, print_fleet
    from riecjax.reporting.output import emit, require_folder
    from riecjax.uncertainty.intervals import BlockBootstrap

    require_folder(out)
    model = hidden.added_to(model_name)
    began = time.monotonic()
    with _Told() as told:
        found = fleet(
            model,
            recordings.files,
            criteria.build(model) if criteria.is_given else None,
            by=by,
            span=span,
            known=known,
            intervals=BlockBootstrap(seed=seed),
            at_rest=at_rest,
            workers=workers,
            scheduler=scheduler,
            out=out,
            strict=strict,
            allow_duplicates=recordings.allow_duplicates,
            parts=recordings.parts,
            progress=told.progress,
            on_start=told.dashboard,
            **recordings.settings,
        )
    emit(
        fleet_document(found, click.get_current_context().obj or (), time.monotonic() - began),
        as_json=as_json,
        out=out,
        show=print_fleet,
        charts=lambda: fleet_figures(found),
        page=fleet_page,
        beside=(ESTIMATES, SUMMARIES),
    )


class _Told:
    """A bar with rate and time left on a terminal; elsewhere a line for each tenth."""

    def __init__(self) -> None:
        from rich import progress
        from rich.console import Console

        self._console = Console(stderr=True)
        what, rate = map(progress.TextColumn, ("{task.description}", "{task.fields[rate]}"))
        how_far = (progress.BarColumn(), progress.MofNCompleteColumn())
        columns = (what, *how_far, rate, progress.TimeRemainingColumn())
        self._bar = progress.Progress(*columns, console=self._console, transient=True)
        self._task, self._what, self._tenth, self._began = None, "", 0, 0.0

    def __enter__(self) -> "_Told":
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._console.is_terminal:
            self._bar.stop()

    def dashboard(self, address: str) -> None:
        """Say where Dask shows what it does."""
        if self._console.is_terminal:
            self._bar.console.print(f"Dask's dashboard: {address}", highlight=False)

    def progress(self, what: str, done: int, total: int, samples: int) -> None:
        """Show how far it is."""
        if what != self._what:
            self._what, self._tenth, self._began = what, -1, time.monotonic()
            self._task = self._bar.add_task(what, total=total, rate="")
        passed = max(time.monotonic() - self._began, 1e-3)
        rate = f"{samples / passed / 1e3:,.0f} thousand samples/s" if samples else ""
        if self._console.is_terminal and self._task is not None:
            self._bar.update(self._task, completed=done, total=total, rate=rate)
        elif total and 10 * done // total > self._tenth:
            self._tenth = 10 * done // total
            said = f"riecjax: {what}: {done} of {total}{f', {rate}' if rate else ''}"
            self._console.print(said, markup=False, highlight=False, soft_wrap=True)

"""`riecjax fleet`: parameters of groups of recordings, of which there may be many thousand."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from riecjax import settings
from riecjax.cli import Given, settings_command
from riecjax.fleets.settings import Fleets
from riecjax.runtime import start_jax
from riecjax.settings import FOLDER, TEXT, many, setting


@dataclass(frozen=True, kw_only=True)
class Patterns(settings.Settings):
    """Where recordings are."""

    files: Sequence[str] = many("PATTERN...", TEXT, required=True)


@dataclass(frozen=True, kw_only=True)
class Folder(settings.Document):
    """Where the result goes."""

    out: Path | None = setting("--out", FOLDER, required=True)
    """Folder for estimates.parquet, summaries.parquet and the report. A run that ended goes on from
    what it holds."""


@settings_command(
    "fleet",
    *(settings.ModelName, Patterns, Fleets, settings.Elements, Folder),
    short_help="Identify a model's parameters from groups of recordings.",
)
def command(given: Given) -> None:
    """Identify a model's parameters from each group of recordings, of which there may be many.

    A pattern is a file, a folder, or as in 'drives/**/*.csv'; also the URL of a store that fsspec
    knows, 's3://bucket/drives/*.parquet'. A folder called '*.parquet' is a data set, whose files
    are one recording. The summaries.parquet of an earlier run is estimated anew, with other known
    values or groups, and no recording is read again.
    """
    asked = given.take(Fleets)
    start_jax(keep_compiled=True)
    from riecjax.fleets.fleet import fleet
    from riecjax.fleets.kept import ESTIMATES, SUMMARIES
    from riecjax.fleets.report import fleet_document, fleet_figures, fleet_page, print_fleet
    from riecjax.reporting import emit, require_folder

    require_folder(given.out)
    model = given.model()
    began = time.monotonic()
    with _Told() as told:
        asked = replace(asked, out=given.out, progress=told.progress)
        found = fleet(model, given.files, **vars(asked))
    emit(
        fleet_document(found, given.arguments, time.monotonic() - began),
        as_json=given.as_json,
        out=given.out,
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
        is_silent = not self._console.is_terminal
        self._bar = progress.Progress(
            *columns, console=self._console, transient=True, disable=is_silent
        )
        self._task, self._what, self._tenth, self._began = None, "", 0, 0.0

    def __enter__(self) -> "_Told":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def progress(self, what: str, done: int, total: int, samples: int) -> None:
        """Show how far it is."""
        if what != self._what:
            self._what, self._tenth, self._began = what, -1, time.monotonic()
            self._task = self._bar.add_task(what, total=total, rate="")
        passed = max(time.monotonic() - self._began, 1e-3)
        rate = f"{samples / passed / 1e3:,.0f} thousand samples/s" if samples else ""
        assert self._task is not None
        self._bar.update(self._task, completed=done, total=total, rate=rate)
        if not self._console.is_terminal and total and 10 * done // total > self._tenth:
            self._tenth = 10 * done // total
            said = f"riecjax: {what}: {done} of {total}{f', {rate}' if rate else ''}"
            self._console.print(said, markup=False, highlight=False, soft_wrap=True)

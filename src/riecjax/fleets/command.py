"""`riecjax fleet`: parameters of groups of recordings, of which there may be many thousand."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from riecjax import settings
from riecjax.cli import Given, Progress, settings_command
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
    start_jax()
    from riecjax.fleets.fleet import fleet
    from riecjax.fleets.kept import ESTIMATES, SUMMARIES
    from riecjax.fleets.report import fleet_document, fleet_figures, fleet_page, print_fleet
    from riecjax.reporting import emit, require_folder

    require_folder(given.out)
    model = given.model()
    began = time.monotonic()
    with Progress(lines=True) as progress:
        asked = replace(asked, out=given.out, progress=progress.count)
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

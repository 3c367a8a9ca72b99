"""Where results go: the terminal, standard output as JSON, and a folder."""

import json
import os
import shutil
import uuid
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from riecjax.errors import DataError
from riecjax.reporting.charts.chart import Chart
from riecjax.reporting.document import Document
from riecjax.reporting.page import Page, render


def emit(
    document: Document,
    *,
    as_json: bool,
    out: Path | None,
    show: Callable[[Document, Console], None],
    charts: Callable[[], Mapping[str, Chart]],
    page: Callable[[Document], Page],
    warnings: Sequence[Mapping[str, Any]] | None = None,
) -> None:
    """Write the folder first, if one is asked for, then print, the answer before warnings.

    Warnings go to standard error: the document's, or only these.

    **Raises:** as [`write_folder`][riecjax.reporting.output.write_folder].
    """
    if out is not None:
        write_folder(out, document, charts(), page(document))
    if as_json:
        click.echo(json.dumps(document, indent=2, allow_nan=False))
    else:
        show(document, Console())
    told = Console(stderr=True)
    for warning in document.get("warnings", []) if warnings is None else warnings:
        # One line each for scripts; whoever looks at a terminal sees whole words.
        line = f"warning [{warning['code']}]: {warning['message']}"
        told.print(line, markup=False, highlight=False, soft_wrap=not told.is_terminal)
    if out is not None and not as_json:
        click.echo(f"wrote {out}/results.json, report.html and figures")


def write_folder(folder: Path, document: Document, charts: Mapping[str, Chart], page: Page) -> None:
    """results.json, a PNG of each chart and report.html, each whole or not at all.

    Everything is made in a temporary folder beside it first; only then files are moved in.

    **Raises:** `DataError` if the folder cannot be written, or a package for reports is missing.
    """
    require_report_packages()
    from riecjax.reporting.charts.printed import print_chart

    made = _folder_beside(folder)
    try:
        text = json.dumps(document, indent=2, allow_nan=False) + "\n"
        (made / "results.json").write_text(text, encoding="utf-8")
        pictures = {name: made / f"{name}.png" for name in charts}
        for name, chart in charts.items():
            print_chart(chart, pictures[name])
        (made / "report.html").write_text(
            render(page, document, charts, pictures), encoding="utf-8"
        )
        folder.mkdir(exist_ok=True)
        for file in made.iterdir():
            os.replace(file, folder / file.name)
    except OSError as error:
        raise DataError(f"cannot write to '{folder}': {error.strerror}.") from None
    finally:
        shutil.rmtree(made, ignore_errors=True)


def require_folder(folder: Path) -> None:
    """Make sure, before any work is done, that a folder can be written.

    **Raises:** `DataError` if not, or if a package for reports is missing.
    """
    require_report_packages()
    _folder_beside(folder).rmdir()


def _folder_beside(folder: Path) -> Path:
    """A temporary folder next to one that is to be written."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # What is made in a folder of tempfile's is its owner's alone, on Windows wherever it moves.
        made = folder.parent / f".{folder.name}.{uuid.uuid4().hex}"
        made.mkdir()
    except OSError as error:
        raise DataError(f"cannot write to '{folder}': {error.strerror}.") from None
    return made


def require_report_packages() -> None:
    """Make sure that figures and pages can be made.

    **Raises:** `DataError` with the remedy if a package is not installed.
    """
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401
        import plotly  # noqa: F401
    except ImportError:
        raise DataError(
            "figures and reports need matplotlib, plotly and jinja2; install them by "
            'pip install "riecjax[report]".'
        ) from None

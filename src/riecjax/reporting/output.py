"""Where results go: the terminal, standard output as JSON, and a folder."""

import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click
import msgspec
from rich.console import Console

from riecjax.charts import Chart
from riecjax.errors import DataError
from riecjax.extensions import require_packages
from riecjax.leaves import finite
from riecjax.reporting.document import Document, sealed
from riecjax.reporting.page import Page, render
from riecjax.standard_output import answer
from riecjax.whole_files import committing, is_stamped, no_folder, temporary

RESULTS, REPORT = "results.json", "report.html"
STAMPED = (".png", ".parquet")
"""Endings of files that bear a stamp by which a later run knows its own."""
Writer = Callable[[Path], None]
Kind = TypeVar("Kind")


def emit(
    document: Kind,
    *,
    as_json: bool,
    out: Path | None,
    show: Callable[[Kind, Console], None],
    charts: Callable[[], Mapping[str, Chart]] = dict,
    page: Callable[[Kind], Page] | None = None,
    warnings: Sequence[Mapping[str, Any]] | None = None,
    others: Mapping[str, Writer] | None = None,
    beside: Sequence[str] = (),
) -> None:
    """Write the folder, if one is asked for, and print, the answer before warnings.

    The document is plain data, or typed, a Struct of msgspec's.

    Who sits at a terminal reads while pictures are drawn; what a program gets comes last, so that
    it finds the folder, which no pipe that closes early prevents. Warnings go to standard error:
    the document's, or only these. `others` write further files of the folder, by name; `beside`
    names those that are in it already.

    **Raises:** as [`write_folder`][riecjax.reporting.output.write_folder].
    """
    plain = sealed(msgspec.to_builtins(document, enc_hook=finite))
    told = plain.get("warnings", []) if warnings is None else warnings

    def say() -> None:
        if as_json:
            answer(plain)
        else:
            show(document, Console())
        console = Console(stderr=True)
        for warning in told:
            # One line each for scripts; whoever looks at a terminal sees whole words.
            line = f"warning [{warning['code']}]: {warning['message']}"
            console.print(line, markup=False, highlight=False, soft_wrap=not console.is_terminal)

    is_watched = sys.stdout.isatty() and not as_json
    if is_watched:
        say()
    if out is not None and page is not None:
        write_folder(out, plain, charts(), page(document), others)
    if not is_watched:
        say()
    if out is not None and not as_json:
        further = "".join(f", {name}" for name in (*(others or ()), *beside))
        click.echo(f"wrote {out}/{RESULTS}, {REPORT}{further} and figures")


def write_folder(
    folder: Path,
    document: Document,
    charts: Mapping[str, Chart],
    page: Page,
    others: Mapping[str, Writer] | None = None,
) -> None:
    """results.json, a PNG of each chart and report.html, each whole or not at all.

    Everything is made in a temporary folder beside it first; only then files are moved in.
    results.json goes first and comes last, so that it never stands beside what belongs to another
    one, wherever this ends.

    **Raises:** `DataError` if the folder cannot be written, or without a package for reports.
    """
    require_packages("report")
    from riecjax.reporting.printed import print_chart

    with _folder_beside(folder) as made:
        pictures = {name: made / f"{name}.png" for name in charts}
        for name, chart in charts.items():
            print_chart(chart, pictures[name])
        report = render(page, document, charts, pictures)
        # Names of files need not be text in any encoding.
        (made / REPORT).write_text(report, encoding="utf-8", errors="backslashreplace")
        for name, write in (others or {}).items():
            write(made / name)
        text = json.dumps(sealed(document), indent=2, allow_nan=False) + "\n"
        (made / RESULTS).write_text(text, encoding="utf-8")
        with committing:
            folder.mkdir(exist_ok=True)
            names = {file.name for file in made.iterdir()}
            (folder / RESULTS).unlink(missing_ok=True)
            for file in folder.iterdir():
                if file.suffix in STAMPED and file.name not in names and is_stamped(file):
                    file.unlink()
            for name in sorted(names - {RESULTS}):
                (made / name).replace(folder / name)
            (made / RESULTS).replace(folder / RESULTS)


def require_folder(folder: Path) -> None:
    """Make sure, before any work is done, that a folder can be written.

    **Raises:** `DataError` if not, or without a package for reports.
    """
    require_packages("report")
    with _folder_beside(folder), contextlib.suppress(FileNotFoundError):
        if not folder.is_dir() and os.path.lexists(folder):
            raise NotADirectoryError
        if folder.is_dir() and not os.access(folder, os.W_OK):
            raise DataError(f"cannot write to '{folder}': it may not be written to.")
        folder.lstat()


@contextlib.contextmanager
def _folder_beside(folder: Path) -> Iterator[Path]:
    """A temporary folder next to one that is to be written."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with temporary(folder.parent, is_folder=True, mode=0o777) as made:
            yield made
    except OSError as error:
        raise DataError(no_folder(folder, error)) from None

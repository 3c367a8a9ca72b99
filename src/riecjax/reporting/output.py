"""Where results go: the terminal, standard output as JSON, and a folder."""

import json
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console

from riecjax.errors import DataError
from riecjax.reporting.charts.chart import Chart
from riecjax.reporting.page import Page

Document = dict[str, Any]
SCHEMA = 1
"""`schema` of every document: raised when the meaning of a key changes or a key goes; new keys do
not raise it."""


def emit(
    document: Document,
    *,
    as_json: bool,
    out: Path | None,
    show: Callable[[Document, Console], None],
    charts: Callable[[], Mapping[str, Chart]],
    page: Callable[[Document], Page],
) -> None:
    """Write the folder first, if one is asked for, then print.

    **Raises:** as [`write_folder`][riecjax.reporting.output.write_folder].
    """
    if out is not None:
        require_report_packages()
        write_folder(out, document, charts(), page(document))
    for warning in document.get("warnings", []):
        click.echo(f"warning [{warning['code']}]: {warning['message']}", err=True)
    if as_json:
        click.echo(json.dumps(document, indent=2, allow_nan=False))
        return
    show(document, Console())
    if out is not None:
        click.echo(f"wrote {out}/results.json, report.html and figures")


def write_folder(folder: Path, document: Document, charts: Mapping[str, Chart], page: Page) -> None:
    """results.json, a PNG of each chart and report.html, each whole or not at all.

    Everything is made in a temporary folder beside it first; only then files are moved in.

    **Raises:** `DataError` if the folder cannot be written, or a package for reports is missing.
    """
    require_report_packages()
    from riecjax.reporting.charts.printed import print_chart
    from riecjax.reporting.rendering import render

    made = _folder_beside(folder)
    try:
        (made / "results.json").write_text(json.dumps(document, indent=2, allow_nan=False) + "\n")
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
        return Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    except OSError as error:
        raise DataError(f"cannot write to '{folder}': {error.strerror}.") from None


def versions() -> dict[str, str]:
    """Versions of everything that a number depends on."""
    import platform
    from importlib.metadata import version

    packages = ("riecjax", "jax", "diffrax", "equinox", "optimistix", "numpy", "scipy")
    return {"python": platform.python_version()} | {name: version(name) for name in packages}


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
            "pip install 'riecjax[report]'."
        ) from None


def number(value: float | None, digits: int = 6) -> str:
    """A number for a table; `none` where there is none."""
    return "none" if value is None else f"{value:.{digits}g}"


def finite(value: ArrayLike) -> Any:
    """The number, or `None` where JSON has no word for it; of an array, nested lists of them."""
    if np.ndim(value):
        return [finite(each) for each in np.asarray(value)]
    number = np.asarray(value).item()
    return number if math.isfinite(number) else None

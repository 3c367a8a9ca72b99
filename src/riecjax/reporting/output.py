"""Where results go: the terminal, standard output as JSON, and a folder."""

import io
import json
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from riecjax.errors import DataError

Document = dict[str, Any]


def emit(
    document: Document,
    *,
    as_json: bool,
    out: Path | None,
    show: Callable[[Document, Console], None],
    figures: Callable[[], Mapping[str, Any]],
    title: str,
) -> None:
    """Write the folder first, if one is asked for, then print."""
    if out is not None:
        write_folder(out, document, figures(), title, show)
    for warning in document.get("warnings", []):
        click.echo(f"warning [{warning['code']}]: {warning['message']}", err=True)
    if as_json:
        click.echo(json.dumps(document, indent=2, allow_nan=False))
        return
    show(document, Console())
    if out is not None:
        click.echo(f"wrote {out}/results.json, report.html and figures")


def write_folder(
    folder: Path,
    document: Document,
    figures: Mapping[str, Any],
    title: str,
    show: Callable[[Document, Console], None],
) -> None:
    """results.json, figures and report.html, each whole or not at all.

    Everything is made in a temporary folder beside it first; only then files are moved in.
    """
    plt = require_plots()
    from riecjax.reporting.html import report_page

    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    except OSError as error:
        raise DataError(f"cannot write to '{folder}': {error.strerror}.") from None
    try:
        (made / "results.json").write_text(json.dumps(document, indent=2, allow_nan=False) + "\n")
        for name, figure in figures.items():
            figure.savefig(made / f"{name}.png", dpi=150)
        (made / "report.html").write_text(
            report_page(title, document, sorted(made.glob("*.png")), _as_text(document, show)),
            encoding="utf-8",
        )
        folder.mkdir(exist_ok=True)
        for file in made.iterdir():
            os.replace(file, folder / file.name)
    except OSError as error:
        raise DataError(f"cannot write to '{folder}': {error.strerror}.") from None
    finally:
        shutil.rmtree(made, ignore_errors=True)
        for figure in figures.values():
            if isinstance(figure, plt.Figure):
                plt.close(figure)


def _as_text(document: Document, show: Callable[[Document, Console], None]) -> str:
    console = Console(record=True, width=110, file=io.StringIO())
    show(document, console)
    return console.export_text()


def versions() -> dict[str, str]:
    """Versions of everything that a number depends on."""
    import platform
    from importlib.metadata import version

    packages = ("riecjax", "jax", "diffrax", "equinox", "optimistix", "numpy", "scipy")
    return {"python": platform.python_version()} | {name: version(name) for name in packages}


def require_plots() -> Any:
    """matplotlib's pyplot, without a screen, where jinja2 is there too.

    **Raises:** `DataError` with the remedy if it is not installed.
    """
    try:
        import jinja2  # noqa: F401
        import matplotlib
    except ImportError:
        raise DataError(
            "figures and reports need matplotlib and jinja2; install them by "
            "pip install 'riecjax[report]'."
        ) from None
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def number(value: float | None, digits: int = 6) -> str:
    """A number for a table; `none` where there is none."""
    return "none" if value is None else f"{value:.{digits}g}"


def finite(value: float) -> float | None:
    """The value, or `None` where JSON has no word for it."""
    return value if math.isfinite(value) else None

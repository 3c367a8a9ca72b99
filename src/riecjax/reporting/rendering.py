"""A page as one HTML file that needs nothing else: figures that zoom, and pictures for print."""

import base64
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from riecjax.reporting.charts.chart import Chart
from riecjax.reporting.charts.interactive import interactive
from riecjax.reporting.charts.layout import Spaces
from riecjax.reporting.document import Document
from riecjax.reporting.page import Page, Section, Table

SCREEN_INCH = 100
"""Pixels to an inch of the printed figure, at most, so that a small figure stays small."""


class _Figure(NamedTuple):
    name: str
    caption: str
    picture: str
    narrowest: int
    widest: int
    height: int
    data: Markup


class _Part(NamedTuple):
    """A section with its figures drawn."""

    anchor: str
    heading: str
    text: tuple[str, ...]
    tables: tuple[Table, ...]
    figures: tuple[_Figure, ...]


def render(
    page: Page, document: Document, charts: Mapping[str, Chart], pictures: Mapping[str, Path]
) -> str:
    """The page with the document's warnings and provenance.

    **Arguments:** `charts` by name, and under the same names the `pictures` of them, PNG files.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("riecjax.reporting"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    parts = [
        _part(f"section-{i + 1}", section, charts, pictures)
        for i, section in enumerate(page.sections)
    ]
    parts = [part for part in parts if part.text or part.tables or part.figures]
    return environment.get_template("report.html.j2").render(
        page=page,
        parts=parts,
        warnings=document.get("warnings", []),
        provenance=json.dumps(document.get("provenance", {}), indent=2, ensure_ascii=False),
        plotly=Markup(get_plotlyjs()) if any(part.figures for part in parts) else None,
    )


def _part(
    anchor: str, section: Section, charts: Mapping[str, Chart], pictures: Mapping[str, Path]
) -> _Part:
    figures = [_figure(n, charts[n], pictures[n]) for n in section.charts if n in charts]
    return _Part(
        anchor, section.heading, tuple(section.text), tuple(section.tables), tuple(figures)
    )


def _figure(name: str, chart: Chart, picture: Path) -> _Figure:
    drawn, narrowest = interactive(chart), round(Spaces.of(chart).width)
    return _Figure(
        name,
        chart.caption or name.replace("_", " "),
        base64.b64encode(picture.read_bytes()).decode(),
        narrowest,
        max(round(SCREEN_INCH * chart.size[0]), narrowest),
        drawn["layout"]["height"],
        _for_script(drawn),
    )


def _for_script(value: Any) -> Markup:
    """JSON that cannot end the script element it stands in."""
    plain = json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    return Markup(plain.replace("<", "\\u003c"))

"""A report: what it says, in plain data, and the HTML file that shows it."""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from riecjax.charts import Chart
from riecjax.reporting import Document, Table
from riecjax.reporting.interactive import Spaces, interactive

SCREEN_INCH = 100
"""Pixels to an inch of the printed figure, at most, so that a small figure stays small."""


@dataclass(frozen=True)
class Section:
    """A part of a page under a heading.

    **Fields:** `text`, paragraphs; `tables`; `charts`, names of those shown here. A name without a
    chart is skipped, such as that of curves which a model does not have; so are a table without
    rows and an empty section.
    """

    heading: str
    text: Sequence[str] = ()
    tables: Sequence[Table] = ()
    charts: Sequence[str] = ()


@dataclass(frozen=True)
class Page:
    """A report; `lead` stands under its title. Warnings and provenance come from the document.

    **Fields:** `answer`: what stands before all else; `groups`: titles of warnings that belong
    together, with their codes; without any, they are one list.

    Texts are plain: signs that mean something to HTML are escaped.
    """

    title: str
    lead: str
    sections: Sequence[Section]
    answer: Section | None = None
    groups: Sequence[tuple[str, Sequence[str]]] = ()


def render(
    page: Page, document: Document, charts: Mapping[str, Chart], pictures: Mapping[str, Path]
) -> str:
    """The page as one HTML file that needs nothing else, with the document's warnings.

    **Arguments:** `charts` by name, and under the same names the `pictures` of them, PNG files:
    shown where scripts don't run, and in print.
    """
    import jinja2
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    def figure(name: str) -> dict[str, Any]:
        chart = charts[name]
        drawn, narrowest = interactive(chart), round(Spaces.of(chart).width)
        # Inside a script element, "<" could end it.
        data = json.dumps(drawn, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
        return {
            "name": name,
            "caption": chart.caption or name.replace("_", " "),
            "picture": base64.b64encode(pictures[name].read_bytes()).decode(),
            "narrowest": narrowest,
            "widest": max(round(SCREEN_INCH * chart.size[0]), narrowest),
            "height": drawn["layout"]["height"],
            "data": Markup(data.replace("<", "\\u003c")),
        }

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("riecjax.reporting"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    parts = []
    for section in page.sections:
        figures = [figure(name) for name in section.charts if name in charts]
        tables = [table for table in section.tables if table.rows]
        if section.text or tables or figures:
            parts.append((replace(section, tables=tables), figures))
    # Warnings under the titles that list their codes; those that none lists come last.
    warnings = document.get("warnings", [])
    listed = {code for _, codes in page.groups for code in codes}
    rest = [warning for warning in warnings if warning["code"] not in listed]
    count = f"{len(rest)} warning{'s' if len(rest) != 1 else ''}"
    groups = [(title, [w for w in warnings if w["code"] in codes]) for title, codes in page.groups]
    return environment.get_template("report.html.j2").render(
        page=page,
        parts=parts,
        groups=[group for group in (*groups, (count, rest)) if group[1]],
        provenance=json.dumps(document.get("provenance", {}), indent=2, ensure_ascii=False),
        plotly=Markup(get_plotlyjs()) if any(figures for _, figures in parts) else None,
    )

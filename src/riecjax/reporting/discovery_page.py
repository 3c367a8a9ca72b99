"""The report of a discovery, and its figure."""

import numpy as np

from riecjax.discovery.discovery import Discovery
from riecjax.reporting.charts.chart import BLUE, GREY, Axis, Chart, Line, Panel, in_rows
from riecjax.reporting.discovery import (
    choice_in_words,
    path_table,
    rejected_table,
    widths_in_words,
)
from riecjax.reporting.document import Document
from riecjax.reporting.estimate import parameter_table
from riecjax.reporting.page import Page, Section


def discovery_page(document: Document) -> Page:
    """The page of a discovery's document."""
    rejected = rejected_table(document)
    text = [text for text in (widths_in_words(document), choice_in_words(document)) if text]
    return Page(
        f"What {document['model']} lacks",
        f"{document['offered']} candidates; {document['equation']}",
        (
            Section(
                "Terms",
                tables=[path_table(document), *([rejected] if rejected else [])],
                charts=("path",),
            ),
            Section("Parameters", text, tables=[parameter_table(document)]),
        ),
        Section("Answer", [document["sentence"]]),
    )


def discovery_figures(found: Discovery) -> dict[str, Chart]:
    """`path`: what is left unexplained with one term more each time."""
    panels = []
    for name, steps in found.paths.items():
        names = tuple(step.added.partition("@")[0] or found.start.name for step in steps)
        place = np.arange(len(steps))
        left = 100 * np.array([step.unexplained for step in steps])
        noise = left - 100 * np.array([max(step.of_motion, 0.0) for step in steps])
        marks = [
            Line(place, left, "unexplained", BLUE, markers=True),
            Line(place, np.where(noise > 0, noise, np.nan), "what noise makes", GREY, "dashed"),
        ]
        title = name if len(found.paths) > 1 else ""
        panels.append(
            Panel(marks, Axis(categories=names), Axis("unexplained / (%)", log=True), title=title)
        )
    if not panels:
        return {}
    caption = (
        "Share of the target's energy in blocks of time that coefficients were not fitted to, with "
        "one term more at each place."
    )
    rows = in_rows(panels, 2)
    return {"path": Chart(rows, caption, size=(8.0, 1.0 + 2.8 * len(rows)), legend=True)}

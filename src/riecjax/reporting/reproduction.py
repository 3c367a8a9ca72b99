"""Results of the reproduction: JSON document, tables on a terminal, figures."""

import io

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table as RichTable

from riecjax.models.quarter_car.identification import BREAK_POINTS
from riecjax.models.quarter_car.reconstruction import reconstruction_document
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.claims import evaluate_claims
from riecjax.paper.eigenstructure import ModeComparison, table_1
from riecjax.paper.published import CRITERIA, TABLE_2, VARIANTS, PublishedMode
from riecjax.paper.reproduction import RoadResult
from riecjax.paper.tables import Cell, Table, contact, table_3, table_4, table_5
from riecjax.reporting.charts.chart import (
    BLUE,
    DASHES,
    RUST,
    Axis,
    Chart,
    Dots,
    Level,
    Line,
    Panel,
    single,
)
from riecjax.reporting.output import Document, versions
from riecjax.reporting.page import Page, Section
from riecjax.reporting.page import Table as PageTable

SHOWN = {
    "3": ("Identified tyre stiffness (kN/m) and masses (kg)", {"K_t": 1e3}),
    "4": ("Identified suspension stiffness K_s (kN/m)", dict.fromkeys(VARIANTS, 1e3)),
    "5": ("Validation error, sum of p_i over x1 to x4 (%)", {}),
}
"""Heading of each table, and what its rows are divided by for reading."""


def reproduction_document(roads: RoadResult, *, seed: int) -> Document:
    """The document that `--json` prints and results.json holds."""
    tables = {"3": table_3(roads), "4": table_4(roads), "5": table_5(roads)}
    lost = int(np.sum(~np.asarray(roads.successful)))
    warnings = []
    if lost:
        message = f"{lost} roads lost a simulation; their numbers are not to be trusted."
        warnings.append({"code": "simulation_lost", "message": message})
    count = int(np.asarray(roads.contact).size)
    if count < 8:
        message = f"only {count} roads: means and ranges are rough. Use --roads 8 or more."
        warnings.append({"code": "few_roads", "message": message})
    return {
        "schema": 1,
        "tables": {"1": [_mode_entry(row) for row in table_1()]}
        | {number: _table_document(table) for number, table in tables.items()},
        "contact": _cell_document(contact(roads)),
        "summary": _summary(tables),
        "claims": [claim._asdict() for claim in evaluate_claims(roads)],
        "reconstruction": reconstruction_document(),
        "warnings": warnings,
        "provenance": {
            "seed": seed,
            "roads": count,
            "settings": TABLE_2._asdict(),
            "versions": versions(),
        },
    }


def print_reproduction(document: Document, console: Console) -> None:
    """Published numbers beside reproduced ones."""
    roads = document["provenance"]["roads"]
    console.print("[bold]Table 1[/bold]  Eigenstructure of the linearised source model")
    console.print(_mode_table(document["tables"]["1"]))
    for number, (heading, scales) in SHOWN.items():
        console.print(f"\n[bold]Table {number}[/bold]  {heading}, {roads} roads", highlight=False)
        console.print(_number_table(number, scales, document["tables"][number]))
    console.print()
    cell = document["contact"]
    low, high = cell["interval95"]
    console.print(
        f"tyre in contact: published {100 * cell['published']:.0f} %, reproduced "
        f"{100 * cell['reproduced']:.2f} % ({100 * low:.2f} .. {100 * high:.2f})",
        highlight=False,
    )
    for number, entry in document["summary"].items():
        console.print(
            f"Table {number}: largest distance {100 * entry['largest_distance']:.1f} %, mean "
            f"{100 * entry['mean_distance']:.1f} %, {entry['inside']} of {entry['numbers']} "
            f"published numbers inside the range over the roads",
            highlight=False,
        )
    for claim in document["claims"]:
        verdict = "holds" if claim["holds"] else "DOES NOT HOLD"
        console.print(f"claim {claim['id']}: {verdict}. {claim['statement']}", highlight=False)
    console.print(f"{document['reconstruction']['note']}", highlight=False)


def _summary(tables: dict[str, Table]) -> dict[str, dict[str, float]]:
    summary = {}
    for number, table in tables.items():
        cells = [cell for row in table.values() for cell in row.values()]
        distances = [abs(cell.deviation) for cell in cells]
        summary[number] = {
            "numbers": len(cells),
            "inside": sum(cell.inside for cell in cells),
            "largest_distance": max(distances),
            "mean_distance": float(np.mean(distances)),
        }
    return summary


def _table_document(table: Table) -> Document:
    return {
        row: {criterion: _cell_document(cell) for criterion, cell in cells.items()}
        for row, cells in table.items()
    }


def _cell_document(cell: Cell) -> Document:
    return {
        "published": cell.published,
        "reproduced": cell.reproduced,
        "interval95": [cell.low, cell.high],
        "inside": cell.inside,
    }


def _mode_entry(row: ModeComparison) -> Document:
    return {
        "published": _mode_document(row.published),
        "reproduced": _mode_document(row.reproduced),
        "agrees": bool(row.agrees),
    }


def _mode_document(mode: PublishedMode) -> Document:
    return {
        "eigenvalue": _complex(mode.eigenvalue),
        "frequency": mode.frequency,
        "damping_ratio": mode.damping_ratio,
        "wheel": _complex(mode.wheel),
        "body": _complex(mode.body),
        "engine_minus_body": _complex(mode.engine_minus_body),
    }


def _complex(value: complex) -> list[float]:
    return [complex(value).real, complex(value).imag]


def _mode_table(rows: list[Document]) -> RichTable:
    table = _plain_table()
    for heading in ("", "eigenvalue", "Hz", "zeta", "wheel", "body", "engine-body", "agrees"):
        table.add_column(heading, justify="left" if heading == "" else "right", no_wrap=True)
    for row in rows:
        for label in ("published", "reproduced"):
            mode = row[label]
            digits = 0 if mode["eigenvalue"][1] == 0 else 2
            table.add_row(
                "paper" if label == "published" else "here",
                _pair(mode["eigenvalue"], digits),
                "-" if mode["frequency"] is None else f"{mode['frequency']:.2f}",
                "-" if mode["damping_ratio"] is None else f"{mode['damping_ratio']:.2f}",
                *(_pair(mode[part], 2) for part in ("wheel", "body", "engine_minus_body")),
                "" if label == "published" else ("yes" if row["agrees"] else "NO"),
            )
    return table


def _plain_table() -> RichTable:
    return RichTable(caption_justify="left", box=None, padding=(0, 1, 0, 0))


def _pair(parts: list[float], digits: int) -> str:
    real, imaginary = parts
    if imaginary == 0:
        return f"{real:.{digits}f}"
    sign = "±" if imaginary > 0 else "∓"
    return f"{real:.{digits}f}{sign}{abs(imaginary):.{digits}f}i"


def _number_table(number: str, scales: dict[str, float], rows: Document) -> RichTable:
    table = _plain_table()
    table.add_column("", no_wrap=True)
    for criterion in CRITERIA:
        for column in (criterion, "here", "95 % of roads"):
            table.add_column(column, justify="right", no_wrap=True)
    digits = 1 if number == "5" else 2
    for name, row in rows.items():
        scale = scales.get(name, 1.0)
        cells: list[str] = []
        for criterion in CRITERIA:
            cell = row[criterion]
            low, high = (value / scale for value in cell["interval95"])
            cells += [
                f"{cell['published'] / scale:.1f}",
                f"{cell['reproduced'] / scale:.{digits}f}",
                f"{low:.{digits}f}..{high:.{digits}f}{' ' if cell['inside'] else '*'}",
            ]
        table.add_row(name, *cells)
    outside = any(not cell["inside"] for row in rows.values() for cell in row.values())
    if outside:
        table.caption = "* the published number, as rounded in print, lies outside"
    return table


def reproduction_page(document: Document) -> Page:
    """The page of report.html: the tables as printed on the terminal, and the charts."""
    console = Console(record=True, width=110, file=io.StringIO())
    print_reproduction(document, console)
    rows = [(line,) for line in console.export_text().splitlines()]
    return Page(
        "Best and Gordon (1999), reproduced",
        "",
        [
            Section("Tables", tables=[PageTable(("published and reproduced",), rows)]),
            Section("Figures", charts=("tables", "damper_maps", "curves")),
        ],
    )


def reproduction_charts(roads: RoadResult, source: QuarterCarSource) -> dict[str, Chart]:
    """`tables`, `damper_maps` (Fig. 7) and `curves` (Fig. 5, reconstructed)."""
    return {
        "tables": _ratio_chart(roads),
        "damper_maps": _damper_chart(roads, source),
        "curves": _curve_chart(source),
    }


def _ratio_chart(roads: RoadResult) -> Chart:
    tables = (("", table_3(roads)), ("K_s ", table_4(roads)), ("p ", table_5(roads)))
    cells = {
        f"{prefix}{row}  {criterion}": cell
        for prefix, table in tables
        for row, line in table.items()
        for criterion, cell in line.items()
    }
    marks: list[Line | Dots | Level] = [Level(0, "x")]
    for i, cell in enumerate(cells.values()):
        ends = [100 * (end / cell.published - 1) for end in (cell.low, cell.high)]
        color = BLUE if cell.inside else RUST
        marks += [
            Line(ends, [i, i], color=color, width=2),
            Dots([100 * cell.deviation], [i], color=color, size=4),
        ]
    return single(
        marks,
        Axis("reproduced against published / %"),
        Axis(categories=tuple(cells), reverse=True),
        "Reproduced against published: mean (dot) and 95 % of roads (line).",
        size=(7.5, 8.5),
    )


def _damper_chart(roads: RoadResult, source: QuarterCarSource) -> Chart:
    velocity = np.linspace(-1.2, 1.2, 241)
    force = np.asarray(source.damper(jnp.asarray(velocity))) / 1e3  # pyright: ignore[reportCallIssue]
    row = []
    for criterion in CRITERIA:
        marks = [Line(velocity, force, "source", color="#bfbfbf", width=4)]
        for variant, dashes in zip(VARIANTS, DASHES):
            points = [
                float(np.mean(roads.parameters[criterion][variant][f"F_{i}"])) / 1e3
                for i in range(1, 5)
            ]
            marks.append(Line(BREAK_POINTS, points, variant, dashes=dashes, markers=True))
        label = "" if row else "damper force / kN"
        row.append(Panel(marks, Axis("suspension velocity / (m/s)"), Axis(label), title=criterion))
    return Chart((row,), "Identified damper maps.", (9, 4), share_y=True, legend=True)


def _curve_chart(source: QuarterCarSource) -> Chart:
    curves = (
        (source.damper, np.linspace(-1.5, 1.5, 301), 1.0, "damper velocity / (m/s)"),
        (source.spring, np.linspace(-0.08, 0.08, 301), 1e3, "suspension deflection / mm"),
        (source.mount, np.linspace(-0.008, 0.008, 301), 1e3, "engine mount deflection / mm"),
    )
    row = []
    for curve, x, factor, label in curves:
        force = np.asarray(curve(jnp.asarray(x))) / 1e3  # pyright: ignore[reportCallIssue]
        row.append(Panel([Line(factor * x, force)], Axis(label), Axis("force / kN")))
    return Chart((row,), "Reconstructed characteristics of the source model.", (11, 3.6))

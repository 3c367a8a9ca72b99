"""Results of the reproduction: the JSON document, and tables on a terminal."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Console
from rich.table import Table as RichTable

from riecjax.findings import Finding
from riecjax.models.quarter_car.reconstruction import reconstruction_document
from riecjax.paper.claims import Claim
from riecjax.paper.published import CRITERIA, TABLE_2, VARIANTS, PublishedMode
from riecjax.paper.reproduction import RoadResult
from riecjax.paper.study import Scale
from riecjax.paper.tables import (
    Cell,
    contact,
    table_1,
    table_3,
    table_4,
    table_5,
)
from riecjax.reporting.document import SCHEMA, Document, finite, number, versions
from riecjax.reporting.page import Page, Section
from riecjax.reporting.tables import Table, say

FEW_ROADS = 8
COMPLEX = ("eigenvalue", "wheel", "body", "engine_minus_body")
"""What of a mode is a complex number."""
SHOWN = {
    "3": ("Identified tyre stiffness (kN/m) and masses (kg)", {"K_t": 1e3}),
    "4": ("Identified suspension stiffness K_s (kN/m)", dict.fromkeys(VARIANTS, 1e3)),
    "5": ("Validation error, sum of p_i over x1 to x4 (%)", {}),
}
"""Heading of each table, and what its rows are divided by for reading."""


def road_findings(roads: RoadResult, scale: Scale | None = None) -> Iterator[Finding]:
    """Roads that lost a simulation, and roads too few for means and ranges."""
    lost = int(np.sum(~np.asarray(roads.successful)))
    if lost:
        message = f"{lost} roads lost a simulation; their numbers are not to be trusted."
        yield Finding("simulation_lost", message)
    count = int(np.asarray(roads.contact).size)
    fewest = count if scale is None else min(count, scale.studied)
    if fewest < FEW_ROADS:
        remedy = f"Use --roads {FEW_ROADS} or more" if scale is None else "Use --full"
        which = "" if scale is None else f" behind all but the tables ({count} behind these)"
        message = f"only {fewest} roads{which}: means and ranges are rough. {remedy}."
        yield Finding("few_roads", message)


def reproduction_document(
    roads: RoadResult, claims: Sequence[Claim], *, seed: int, scale: Scale | None = None
) -> Document:
    """The document that `--json` prints and results.json holds.

    **Arguments:** `scale` of the whole study, `None` where only the tables were reproduced.
    """
    tables = {"3": table_3(roads), "4": table_4(roads), "5": table_5(roads)}
    summary = {}
    for name, table in tables.items():
        cells = [cell for row in table.values() for cell in row.values()]
        distances = [abs(cell.deviation) for cell in cells]
        summary[name] = {
            "numbers": len(cells),
            "inside": sum(cell.inside for cell in cells),
            "largest_distance": max(distances),
            "mean_distance": float(np.mean(distances)),
        }
    modes = [
        {
            "published": _mode_document(row.published),
            "reproduced": _mode_document(row.reproduced),
            "agrees": bool(row.agrees),
        }
        for row in table_1()
    ]
    numbers = {
        name: {
            row: {criterion: _cell_document(cell) for criterion, cell in cells.items()}
            for row, cells in table.items()
        }
        for name, table in tables.items()
    }
    return {
        "schema": SCHEMA,
        "tables": {"1": modes, **numbers},
        "contact": _cell_document(contact(roads)),
        "summary": summary,
        "claims": [
            {
                "id": claim.id,
                "statement": claim.statement,
                "holds": claim.holds,
                "evidence": {
                    each.what: {
                        "value": finite(each.value),
                        "interval95": None
                        if each.interval is None
                        else [*map(finite, each.interval)],
                        "at_least": each.at_least,
                        "at_most": each.at_most,
                        "holds": each.holds,
                    }
                    for each in claim.evidence
                },
                "note": claim.note,
            }
            for claim in claims
        ],
        "reconstruction": reconstruction_document(),
        "warnings": [finding._asdict() for finding in road_findings(roads, scale)],
        "provenance": {
            "seed": seed,
            "roads": int(np.asarray(roads.contact).size),
            "study": None if scale is None else scale._asdict(),
            "settings": TABLE_2._asdict(),
            "versions": versions(),
        },
    }


def _cell_document(cell: Cell) -> Document:
    return {
        "published": cell.published,
        "reproduced": cell.reproduced,
        "interval95": [cell.low, cell.high],
        "inside": cell.inside,
    }


def _mode_document(mode: PublishedMode) -> Document:
    return {
        name: [complex(value).real, complex(value).imag] if name in COMPLEX else value
        for name, value in mode._asdict().items()
        if name != "digits"
    }


def print_reproduction(document: Document, console: Console) -> None:
    """Published numbers beside reproduced ones."""

    def plain(*headings: str) -> RichTable:
        table = RichTable(caption_justify="left", box=None, padding=(0, 1, 0, 0))
        for heading in headings:
            table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
        return table

    roads = document["provenance"]["roads"]
    table = plain("", "eigenvalue", "Hz", "zeta", "wheel", "body", "engine-body", "agrees")
    for row in document["tables"]["1"]:
        table.add_row("paper", *mode_in_words(row["published"], "-"), "")
        agrees = "yes" if row["agrees"] else "NO"
        table.add_row("here", *mode_in_words(row["reproduced"], "-"), agrees)
    console.print("[bold]Table 1[/bold]  Eigenstructure of the linearised source model")
    console.print(table)
    for name, (heading, scales) in SHOWN.items():
        columns = ((criterion, "here", "95 % of roads") for criterion in CRITERIA)
        table, rows = plain("", *itertools.chain(*columns)), document["tables"][name]
        for row, cells in rows.items():
            words = numbers_in_words(name, cells, scales.get(row, 1.0), "..", (" ", "*"))
            table.add_row(row, *words)
        if any_outside(rows):
            table.caption = "* the published number, as rounded in print, lies outside"
        console.print(f"\n[bold]Table {name}[/bold]  {heading}, {roads} roads", highlight=False)
        console.print(table)
    cell = document["contact"]
    low, high = cell["interval95"]
    say(
        console,
        "",
        f"tyre in contact: published {100 * cell['published']:.0f} %, reproduced "
        f"{100 * cell['reproduced']:.2f} % ({100 * low:.2f} .. {100 * high:.2f})",
        *(
            f"Table {name}: largest distance {100 * entry['largest_distance']:.1f} %, mean "
            f"{100 * entry['mean_distance']:.1f} %, {entry['inside']} of {entry['numbers']} "
            f"published numbers inside the range over the roads"
            for name, entry in document["summary"].items()
        ),
        "",
    )
    for claim in document["claims"]:
        say(console, f"claim {claim['id']}: {_verdict(claim)}. {claim['statement']}")
        for what, entry in claim["evidence"].items():
            if not entry["holds"]:
                between = "" if entry["interval95"] is None else f" ({_range(entry)})"
                said = f"{number(entry['value'], 3)}{between}"
                say(console, f"    {what}: {said}{limits_in_words(entry, ', should be ')}")
        say(console, *([] if claim["holds"] else [f"    {claim['note']}"]))
    say(console, document["reconstruction"]["note"])


def _verdict(claim: Document) -> str:
    return "holds" if claim["holds"] else "DOES NOT HOLD"


def _range(entry: Document) -> str:
    low, high = (number(end, 3) for end in entry["interval95"])
    return f"{low} to {high}"


def limits_in_words(entry: Document, before: str = "") -> str:
    """What a number must be; nothing where it is there for comparison."""
    low, high = entry["at_least"], entry["at_most"]
    if low is None and high is None:
        return ""
    if low is not None and high is not None:
        return f"{before}from {low:g} to {high:g}"
    return f"{before}at most {high:g}" if low is None else f"{before}at least {low:g}"


def mode_in_words(mode: Document, missing: str = "") -> list[str]:
    """Eigenvalue, frequency, damping ratio, and the parts of the shape, as the paper prints them.

    **Arguments:** `missing`, what stands for the frequency and damping ratio of a real eigenvalue.
    """
    ratios = (mode["frequency"], mode["damping_ratio"])
    return [
        _pair_in_words(mode["eigenvalue"], 0 if mode["eigenvalue"][1] == 0 else 2),
        *(missing if ratio is None else f"{ratio:.2f}" for ratio in ratios),
        *(_pair_in_words(mode[part], 2) for part in ("wheel", "body", "engine_minus_body")),
    ]


def _pair_in_words(parts: list[float], digits: int) -> str:
    """A complex number as the paper prints one of a pair."""
    real, imaginary = parts
    if imaginary == 0:
        return f"{real:.{digits}f}"
    sign = "±" if imaginary > 0 else "∓"
    return f"{real:.{digits}f}{sign}{abs(imaginary):.{digits}f}i"


def numbers_in_words(
    table: str, cells: Document, scale: float, between: str, marks: tuple[str, str]
) -> Iterator[str]:
    """Published number, mean and range of each criterion in one row of a table.

    **Arguments:** `between` the ends of a range; `marks` after it, where the published number lies
    inside and where it does not.
    """
    digits = 1 if table == "5" else 2
    for criterion in CRITERIA:
        cell = cells[criterion]
        low, high = (value / scale for value in cell["interval95"])
        yield f"{cell['published'] / scale:.1f}"
        yield f"{cell['reproduced'] / scale:.{digits}f}"
        yield f"{low:.{digits}f}{between}{high:.{digits}f}{marks[not cell['inside']]}"


def any_outside(rows: Document) -> bool:
    """Whether a published number lies outside the range over the roads."""
    return any(not cell["inside"] for row in rows.values() for cell in row.values())


SECTIONS = {
    "Section 2: equation errors and windows": ((1, 2, 3), ("figure_2", "figure_3")),
    "Section 3: the models": ((4,), ("figure_5", "figure_6")),
    "Section 4: identification": ((5, 6, 7, 8), ("figure_7", "window_lengths")),
    "Section 5: validation": ((9, 10, 16), ("figure_8", "figure_9", "figure_10")),
    "Section 6: input bandwidth and engine mounts": (
        (11, 12, 13, 14, 15, 17),
        ("figure_11", "figure_12", "figure_13", "figure_14"),
    ),
}
"""Headings of the page, each with the numbers of its claims and its figures."""


def reproduction_page(document: Document) -> Page:
    """The page of report.html."""
    study, roads = document["provenance"]["study"], document["provenance"]["roads"]
    lead = (
        f"Tables 1, 3, 4 and 5 from {roads} simulated roads. The figures over bandwidth and "
        f"the statements that rest on them need riecjax reproduce --full."
        if study is None
        else f"The whole study: tables from {roads} simulated roads, everything else from "
        f"{study['studied']} of them."
    )
    modes = Table(
        ("", "eigenvalue / (1/s)", "Hz", "zeta", "wheel", "body", "engine minus body"),
        [
            (name, *mode_in_words(row[label]))
            for row in document["tables"]["1"]
            for label, name in (("published", "paper"), ("reproduced", "here"))
        ],
        "Table 1. Eigenstructure of the linearised source model.",
    )
    tables = {
        "Section 3: the models": [modes],
        "Section 4: identification": [_number_table(document, n) for n in ("3", "4")],
        "Section 5: validation": [_number_table(document, "5")],
    }
    statements = [(str(c["id"]), c["statement"], _verdict(c)) for c in document["claims"]]
    verdicts = Table(("", "statement", "here"), statements, "Statements of the paper.", "", False)
    reconstructed = (
        f"{document['reconstruction']['note'].capitalize()}: they are fitted to Tables 3 to 5, so "
        f"that these tables are no test of the method; Table 1, the comparison of the methods and "
        f"everything over bandwidth were not fitted to."
    )
    sections = [
        Section("At a glance", list(_glance(document)), [verdicts], ("tables",)),
        *(
            Section(
                heading,
                tables=[*tables.get(heading, []), *_evidence(document, ids)],
                charts=charts,
            )
            for heading, (ids, charts) in SECTIONS.items()
        ),
        Section("What is reconstructed", [reconstructed]),
    ]
    return Page("Best and Gordon (1999), reproduced", lead, sections)


def _glance(document: Document) -> Iterator[str]:
    yield (
        "RIEC integrates the equations of motion over random windows, DOLS fits them instant by "
        "instant. The variants find the suspension from the wheel's (W) or the body's (B) "
        "equation, with masses that are identified (id) or known (true). p_1 to p_4 are errors of "
        "prediction of tyre and suspension deflection, wheel and body velocity (x1 to x4), in "
        "percent (eq. 28)."
    )
    claims = document["claims"]
    held = sum(claim["holds"] for claim in claims)
    yield f"{held} of {len(claims)} statements of the paper hold here."
    for name, entry in document["summary"].items():
        yield (
            f"Table {name}: {entry['inside']} of {entry['numbers']} published numbers lie in the "
            f"range over the roads; the means are {100 * entry['mean_distance']:.1f} % off on "
            f"average, {100 * entry['largest_distance']:.1f} % at most."
        )
    cell = document["contact"]
    low, high = (100 * end for end in cell["interval95"])
    yield (
        f"The tyre touches the road for {100 * cell['reproduced']:.2f} % of the time ({low:.2f} to "
        f"{high:.2f}); published: {100 * cell['published']:.0f} %."
    )


def _evidence(document: Document, ids: tuple[int, ...]) -> Iterator[Table]:
    """One table for each statement, with every number behind it."""
    for claim in document["claims"]:
        if claim["id"] not in ids:
            continue
        rows = [
            (
                what,
                "" if not limits_in_words(entry) else "yes" if entry["holds"] else "NO",
                number(entry["value"], 3),
                "" if entry["interval95"] is None else _range(entry),
                limits_in_words(entry) or "for comparison",
            )
            for what, entry in claim["evidence"].items()
        ]
        yield Table(
            ("evidence", "holds", "value", "95 %", "must be"),
            rows,
            f"Claim {claim['id']} {_verdict(claim)}. {claim['statement']}",
            claim["note"],
        )


def _number_table(document: Document, name: str) -> Table:
    heading, scales = SHOWN[name]
    rows = document["tables"][name]
    lines = [
        [row, *numbers_in_words(name, cells, scales.get(row, 1.0), " to ", ("", " *"))]
        for row, cells in rows.items()
    ]
    header = [""]
    for criterion in CRITERIA:
        header += [f"{criterion}, paper", f"{criterion}, here", "95 % of roads"]
    star = "* The published number, as rounded in print, lies outside." if any_outside(rows) else ""
    return Table(header, lines, f"Table {name}. {heading}.", star)

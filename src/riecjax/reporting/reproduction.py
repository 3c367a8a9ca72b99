"""Results of the reproduction: the JSON document, and tables on a terminal."""

from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Console
from rich.table import Table as RichTable

from riecjax.findings import Finding
from riecjax.models.quarter_car.reconstruction import reconstruction_document
from riecjax.paper.claims import Claim, Evidence
from riecjax.paper.published import CRITERIA, TABLE_2, VARIANTS, PublishedMode
from riecjax.paper.reproduction import RoadResult
from riecjax.paper.study import Scale
from riecjax.paper.tables import (
    Cell,
    CellTable,
    ModeComparison,
    contact,
    table_1,
    table_3,
    table_4,
    table_5,
)
from riecjax.reporting.document import SCHEMA, Document, finite, number, versions
from riecjax.reporting.page import Page, Section, Table

FEW_ROADS = 8
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
    return {
        "schema": SCHEMA,
        "tables": {"1": [_mode_entry(row) for row in table_1()]}
        | {name: _table_document(table) for name, table in tables.items()},
        "contact": _cell_document(contact(roads)),
        "summary": _summary(tables),
        "claims": [_claim_document(claim) for claim in claims],
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


def print_reproduction(document: Document, console: Console) -> None:
    """Published numbers beside reproduced ones."""
    roads = document["provenance"]["roads"]
    console.print("[bold]Table 1[/bold]  Eigenstructure of the linearised source model")
    console.print(_mode_table(document["tables"]["1"]))
    for name, (heading, scales) in SHOWN.items():
        console.print(f"\n[bold]Table {name}[/bold]  {heading}, {roads} roads", highlight=False)
        console.print(_number_table(name, scales, document["tables"][name]))
    console.print()
    cell = document["contact"]
    low, high = cell["interval95"]
    console.print(
        f"tyre in contact: published {100 * cell['published']:.0f} %, reproduced "
        f"{100 * cell['reproduced']:.2f} % ({100 * low:.2f} .. {100 * high:.2f})",
        highlight=False,
    )
    for name, entry in document["summary"].items():
        console.print(
            f"Table {name}: largest distance {100 * entry['largest_distance']:.1f} %, mean "
            f"{100 * entry['mean_distance']:.1f} %, {entry['inside']} of {entry['numbers']} "
            f"published numbers inside the range over the roads",
            highlight=False,
        )
    console.print()
    for claim in document["claims"]:
        verdict = "holds" if claim["holds"] else "DOES NOT HOLD"
        console.print(f"claim {claim['id']}: {verdict}. {claim['statement']}", highlight=False)
        for what, entry in claim["evidence"].items():
            if not entry["holds"]:
                console.print(f"    {what}: {evidence_in_words(entry)}", highlight=False)
        if not claim["holds"]:
            console.print(f"    {claim['note']}", highlight=False)
    console.print(f"{document['reconstruction']['note']}", highlight=False)


def evidence_in_words(entry: Document) -> str:
    """The number with its interval and the limits it should keep."""
    words = number(entry["value"], 3)
    if entry["interval95"] is not None:
        low, high = (number(end, 3) for end in entry["interval95"])
        words += f" ({low} to {high})"
    return f"{words}{limits_in_words(entry, ', should be ')}"


def limits_in_words(entry: Document, before: str = "") -> str:
    """What a number must be; nothing where it is there for comparison."""
    low, high = entry["at_least"], entry["at_most"]
    if low is None and high is None:
        return ""
    if low is not None and high is not None:
        return f"{before}from {low:g} to {high:g}"
    return f"{before}at most {high:g}" if low is None else f"{before}at least {low:g}"


def _claim_document(claim: Claim) -> Document:
    return {
        "id": claim.id,
        "statement": claim.statement,
        "holds": claim.holds,
        "evidence": {each.what: _evidence_document(each) for each in claim.evidence},
        "note": claim.note,
    }


def _evidence_document(evidence: Evidence) -> Document:
    interval = evidence.interval
    return {
        "value": finite(evidence.value),
        "interval95": None if interval is None else [finite(end) for end in interval],
        "at_least": evidence.at_least,
        "at_most": evidence.at_most,
        "holds": evidence.holds,
    }


def _summary(tables: dict[str, CellTable]) -> dict[str, dict[str, float]]:
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
    return summary


def _table_document(table: CellTable) -> Document:
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
        table.add_row("paper", *mode_in_words(row["published"], "-"), "")
        agrees = "yes" if row["agrees"] else "NO"
        table.add_row("here", *mode_in_words(row["reproduced"], "-"), agrees)
    return table


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


def _plain_table() -> RichTable:
    return RichTable(caption_justify="left", box=None, padding=(0, 1, 0, 0))


def _pair_in_words(parts: list[float], digits: int) -> str:
    """A complex number as the paper prints one of a pair."""
    real, imaginary = parts
    if imaginary == 0:
        return f"{real:.{digits}f}"
    sign = "±" if imaginary > 0 else "∓"
    return f"{real:.{digits}f}{sign}{abs(imaginary):.{digits}f}i"


def _number_table(name: str, scales: dict[str, float], rows: Document) -> RichTable:
    table = _plain_table()
    table.add_column("", no_wrap=True)
    for criterion in CRITERIA:
        for column in (criterion, "here", "95 % of roads"):
            table.add_column(column, justify="right", no_wrap=True)
    for row, cells in rows.items():
        table.add_row(row, *numbers_in_words(name, cells, scales.get(row, 1.0), "..", (" ", "*")))
    if any_outside(rows):
        table.caption = "* the published number, as rounded in print, lies outside"
    return table


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


CLAIMS_OF = {
    "Section 2: equation errors and windows": (1, 2, 3),
    "Section 3: the models": (4,),
    "Section 4: identification": (5, 6, 7, 8),
    "Section 5: validation": (9, 10, 16),
    "Section 6: input bandwidth and engine mounts": (11, 12, 13, 14, 15, 17),
}
CHARTS_OF = {
    "Section 2: equation errors and windows": ("figure_2", "figure_3"),
    "Section 3: the models": ("figure_5", "figure_6"),
    "Section 4: identification": ("figure_7", "window_lengths"),
    "Section 5: validation": ("figure_8", "figure_9", "figure_10"),
    "Section 6: input bandwidth and engine mounts": (
        "figure_11",
        "figure_12",
        "figure_13",
        "figure_14",
    ),
}


def reproduction_page(document: Document) -> Page:
    """The page of report.html."""
    tables = {
        "Section 3: the models": [_modes_on_page(document["tables"]["1"])],
        "Section 4: identification": [_numbers_on_page(document, n) for n in ("3", "4")],
        "Section 5: validation": [_numbers_on_page(document, "5")],
    }
    sections = [
        Section("At a glance", list(_glance(document)), [_verdicts(document)], ("tables",)),
        *(
            Section(
                heading,
                tables=[*tables.get(heading, []), *_evidence(document, CLAIMS_OF[heading])],
                charts=charts,
            )
            for heading, charts in CHARTS_OF.items()
        ),
        Section("What is reconstructed", [_reconstruction(document)]),
    ]
    return Page("Best and Gordon (1999), reproduced", _lead(document), sections)


def _lead(document: Document) -> str:
    study = document["provenance"]["study"]
    roads = document["provenance"]["roads"]
    if study is None:
        return (
            f"Tables 1, 3, 4 and 5 from {roads} simulated roads. The figures over bandwidth and "
            f"the statements that rest on them need riecjax reproduce --full."
        )
    return (
        f"The whole study: tables from {roads} simulated roads, everything else from "
        f"{study['studied']} of them."
    )


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


def _verdicts(document: Document) -> Table:
    rows = [
        (str(claim["id"]), claim["statement"], "holds" if claim["holds"] else "DOES NOT HOLD")
        for claim in document["claims"]
    ]
    return Table(("", "statement", "here"), rows, "Statements of the paper.", numeric=False)


def _evidence(document: Document, ids: tuple[int, ...]) -> Iterator[Table]:
    """One table for each statement, with every number behind it."""
    for claim in document["claims"]:
        if claim["id"] not in ids:
            continue
        verdict = "holds" if claim["holds"] else "DOES NOT HOLD"
        rows = [
            (
                what,
                "" if not limits_in_words(entry) else "yes" if entry["holds"] else "NO",
                number(entry["value"], 3),
                "" if entry["interval95"] is None else _range(entry["interval95"]),
                limits_in_words(entry) or "for comparison",
            )
            for what, entry in claim["evidence"].items()
        ]
        yield Table(
            ("evidence", "holds", "value", "95 %", "must be"),
            rows,
            f"Claim {claim['id']} {verdict}. {claim['statement']}",
            claim["note"],
        )


def _range(ends: list[float | None]) -> str:
    low, high = (number(end, 3) for end in ends)
    return f"{low} to {high}"


def _modes_on_page(modes: list[Document]) -> Table:
    rows = [
        (name, *mode_in_words(row[label]))
        for row in modes
        for label, name in (("published", "paper"), ("reproduced", "here"))
    ]
    return Table(
        ("", "eigenvalue / (1/s)", "Hz", "zeta", "wheel", "body", "engine minus body"),
        rows,
        "Table 1. Eigenstructure of the linearised source model.",
    )


def _numbers_on_page(document: Document, name: str) -> Table:
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


def _reconstruction(document: Document) -> str:
    return (
        f"{document['reconstruction']['note'].capitalize()}: they are fitted to Tables 3 to 5, so "
        f"that these tables are no test of the method; Table 1, the comparison of the methods and "
        f"everything over bandwidth were not fitted to."
    )

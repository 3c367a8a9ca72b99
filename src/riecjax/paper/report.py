"""Results of the reproduction: the JSON document, tables on a terminal, and the page."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Console

from riecjax.findings import Finding, in_percent
from riecjax.leaves import finite, told
from riecjax.models.quarter_car import SPRING_RATE, quarter_car_source, reconstructed
from riecjax.paper.claims import Claim
from riecjax.paper.published import CRITERIA, TABLE_2, TABLE_6, VARIANTS, PublishedMode
from riecjax.paper.reproduction import PaperStudy
from riecjax.paper.tables import contact, number_tables, table_1
from riecjax.reporting import (
    SCHEMA,
    Document,
    Page,
    Section,
    Table,
    in_rich,
    number,
    print_table,
    say,
    versions,
)

FEW_ROADS = 8
COMPLEX = ("eigenvalue", "wheel", "body", "engine_minus_body")
"""What of a mode is a complex number."""


def road_findings(study: PaperStudy) -> Iterator[Finding]:
    """Roads that lost a simulation, and roads too few for means and ranges."""
    lost = int(np.sum(~np.asarray(study.roads.successful)))
    if lost:
        message = f"{lost} roads lost a simulation; their numbers are not to be trusted."
        yield Finding("simulation_lost", message)
    count, further = study.road_count, study.further
    fewest = count if further is None else min(count, further.scale.studied)
    if fewest < FEW_ROADS:
        remedy = f"Use --roads {FEW_ROADS} or more" if further is None else "Use --full"
        which = "" if further is None else f" behind all but the tables ({count} behind these)"
        message = f"only {fewest} roads{which}: means and ranges are rough. {remedy}."
        yield Finding("few_roads", message)


def reproduction_document(study: PaperStudy, claims: Sequence[Claim], *, seed: int) -> Document:
    """The document that `--json` prints and results.json holds."""
    tables, numbers, summary = number_tables(study.roads), {}, {}
    for name, table in tables.items():
        numbers[name] = {
            row: {criterion: cell._asdict() for criterion, cell in cells.items()}
            for row, cells in table.items()
        }
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
            "published": _mode_document(published),
            "reproduced": _mode_document(reproduced),
            "agrees": published == reproduced,
        }
        for published, reproduced in table_1()
    ]
    statements = [
        {
            **told(claim, "id", "statement", "holds"),
            "evidence": {
                what: told(evidence, "value", "interval95", "at_least", "at_most", "holds")
                for what, evidence in claim.evidence.items()
            },
            "note": claim.note,
        }
        for claim in claims
    ]
    return {
        "schema": SCHEMA,
        "tables": {"1": modes, **numbers},
        "contact": contact(study.roads)._asdict(),
        "summary": summary,
        "claims": statements,
        "reconstruction": reconstruction_document(),
        "warnings": [finding._asdict() for finding in road_findings(study)],
        "provenance": {
            "seed": seed,
            "roads": study.road_count,
            "study": study.further and study.further.scale._asdict(),
            "settings": TABLE_2._asdict(),
            "versions": versions(),
        },
    }


def _mode_document(mode: PublishedMode) -> Document:
    return {
        name: [complex(value).real, complex(value).imag] if name in COMPLEX else value
        for name, value in mode._asdict().items()
        if name != "digits"
    }


def reconstruction_document() -> Document:
    """What is published, derived and reconstructed, as plain data in SI units."""
    shapes, mount = reconstructed(), TABLE_6["pathological"]
    source, hole = quarter_car_source(shapes=shapes), shapes.pothole
    return {
        "note": "curves, pot-hole and road amplitude are reconstructed, not published",
        "published": {
            "K_t": finite(source.tyre_stiffness),
            "spring_rate": SPRING_RATE,
            "mount_rate": mount.stiffness,
            "mount_damping": mount.damping,
        },
        "derived_from_table_1": {
            "M_w": finite(source.wheel_mass),
            "M_b": finite(source.body_mass),
            "M_e": finite(source.engine_mass),
            "K_c": finite(source.damper_compliance),
        },
        "reconstructed": {
            **{f"damper_{name}": finite(value) for name, value in vars(shapes.damper).items()},
            **told(shapes, "stop_gaps", "stop_rates", "mount_cubic"),
            "pothole_depth_length_ramp": [*map(finite, (hole.depth, hole.length, hole.ramp))],
            "roughness": finite(shapes.roughness),
        },
    }


def mode_table(document: Document) -> Table:
    """Table 1: a line of the paper's and one of ours for each mode."""

    def pair(parts: list[float], digits: int) -> str:
        """A complex number as the paper prints one of a pair."""
        real, imaginary = parts
        if imaginary == 0:
            return f"{real:.{digits}f}"
        sign = "±" if imaginary > 0 else "∓"
        return f"{real:.{digits}f}{sign}{abs(imaginary):.{digits}f}i"

    rows = []
    for row in document["tables"]["1"]:
        for label, mode, agrees in (
            ("paper", row["published"], ""),
            ("here", row["reproduced"], "yes" if row["agrees"] else "NO"),
        ):
            eigenvalue, *shape = (mode[name] for name in COMPLEX)
            ratios = (mode["frequency"], mode["damping_ratio"])
            rows.append(
                [
                    label,
                    pair(eigenvalue, 0 if eigenvalue[1] == 0 else 2),
                    *("-" if ratio is None else f"{ratio:.2f}" for ratio in ratios),
                    *(pair(part, 2) for part in shape),
                    agrees,
                ]
            )
    header = ("", "eigenvalue", "Hz", "zeta", "wheel", "body", "engine-body", "agrees")
    return Table(header, rows, "Eigenstructure of the linearised source model")


HEADINGS = {
    "3": ("Identified tyre stiffness (kN/m) and masses (kg)", {"K_t": 1e3}),
    "4": ("Identified suspension stiffness K_s (kN/m)", dict.fromkeys(VARIANTS, 1e3)),
    "5": ("Validation error, sum of p_i over x1 to x4 (%)", {}),
}
"""Heading of each table of numbers, and what its rows are divided by for reading."""


def number_table(document: Document, name: str) -> Table:
    """Published number, mean and range of each criterion in each row of a table."""
    (heading, scales), table = HEADINGS[name], document["tables"][name]
    digits, rows, note = 1 if name == "5" else 2, [], ""
    for row, cells in table.items():
        words, scale = [row], scales.get(row, 1.0)
        for cell in (cells[criterion] for criterion in CRITERIA):
            low, high = (value / scale for value in cell["interval95"])
            mark = " " if cell["inside"] else "*"
            words += [
                f"{cell['published'] / scale:.1f}",
                f"{cell['reproduced'] / scale:.{digits}f}",
                f"{low:.{digits}f}..{high:.{digits}f}{mark}",
            ]
            if not cell["inside"]:
                note = "* the published number, as rounded in print, lies outside"
        rows.append(words)
    columns = (name for criterion in CRITERIA for name in (criterion, "here", "95 % of roads"))
    return Table(("", *columns), rows, heading, note)


def print_reproduction(document: Document, console: Console) -> None:
    """Published numbers beside reproduced ones."""

    def show(table: Table) -> None:
        printed = in_rich(table, table.header[1:])
        printed.padding = (0, 1, 0, 0)
        printed.caption, printed.caption_justify = table.note or None, "left"
        print_table(printed, console)

    modes = mode_table(document)
    console.print(f"[bold]Table 1[/bold]  {modes.caption}")
    show(modes)
    for name in HEADINGS:
        table, roads = number_table(document, name), document["provenance"]["roads"]
        heading = f"\n[bold]Table {name}[/bold]  {table.caption}, {roads} roads"
        console.print(heading, highlight=False)
        show(table)
    say(console, "", *_summary(document), "")
    for claim in document["claims"]:
        say(console, f"claim {claim['id']}: {_verdict(claim)}. {claim['statement']}")
        for what, entry in claim["evidence"].items():
            if not entry["holds"]:
                between = f" ({_range(entry)})" if entry["interval95"] else ""
                limits = f", should be {_limits(entry)}" if _limits(entry) else ""
                say(console, f"    {what}: {number(entry['value'], 3)}{between}{limits}")
        say(console, *([] if claim["holds"] else [f"    {claim['note']}"]))
    say(console, document["reconstruction"]["note"])


def _summary(document: Document) -> Iterator[str]:
    """How near the tables come to the published ones."""
    cell = document["contact"]
    low, high = (100 * end for end in cell["interval95"])
    yield (
        f"tyre in contact: published {in_percent(cell['published'], '.0f')}, reproduced "
        f"{100 * cell['reproduced']:.2f} % ({low:.2f} .. {high:.2f})"
    )
    for name, entry in document["summary"].items():
        yield (
            f"Table {name}: largest distance {100 * entry['largest_distance']:.1f} %, mean "
            f"{100 * entry['mean_distance']:.1f} %, {entry['inside']} of {entry['numbers']} "
            f"published numbers inside the range over the roads"
        )


def _verdict(claim: Document) -> str:
    return "holds" if claim["holds"] else "DOES NOT HOLD"


def _range(entry: Document) -> str:
    return " to ".join(number(end, 3) for end in entry["interval95"] or ())


def _limits(entry: Document) -> str:
    """What a number must be; nothing where it is there for comparison."""
    low, high = entry["at_least"], entry["at_most"]
    if low is not None and high is not None:
        return f"from {low:g} to {high:g}"
    return f"at least {low:g}" if low is not None else "" if high is None else f"at most {high:g}"


SECTIONS = {
    "Section 2: equation errors and windows": ((), (1, 2, 3), ("figure_2", "figure_3")),
    "Section 3: the models": (("1",), (4,), ("figure_5", "figure_6")),
    "Section 4: identification": (("3", "4"), (5, 6, 7, 8), ("figure_7", "window_lengths")),
    "Section 5: validation": (("5",), (9, 10, 16), ("figure_8", "figure_9", "figure_10")),
    "Section 6: input bandwidth and engine mounts": (
        (),
        (11, 12, 13, 14, 15, 17),
        ("figure_11", "figure_12", "figure_13", "figure_14"),
    ),
}
"""Headings of the page, each with its tables, the numbers of its claims and its figures."""


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
    words = (
        "RIEC integrates the equations of motion over random windows, DOLS fits them instant by "
        "instant. The variants find the suspension from the wheel's (W) or the body's (B) "
        "equation, with masses that are identified (id) or known (true). p_1 to p_4 are errors of "
        "prediction of tyre and suspension deflection, wheel and body velocity (x1 to x4), in "
        "percent (eq. 28)."
    )
    claims = document["claims"]
    held = sum(claim["holds"] for claim in claims)
    glance = [words, f"{held} of {len(claims)} statements of the paper hold here."]
    glance += [f"{line[0].upper()}{line[1:]}." for line in _summary(document)]
    statements = [(str(c["id"]), c["statement"], _verdict(c)) for c in claims]
    verdicts = Table(
        ("claim", "statement", "here"), statements, "Statements of the paper.", "", False
    )
    sections = [Section("At a glance", glance, [verdicts], ("tables",))]
    for heading, (names, ids, charts) in SECTIONS.items():
        tables = []
        for name in names:
            table = mode_table(document) if name == "1" else number_table(document, name)
            tables.append(dataclasses.replace(table, caption=f"Table {name}. {table.caption}."))
        tables += [_evidence(claim) for claim in claims if claim["id"] in ids]
        sections.append(Section(heading, tables=tables, charts=charts))
    reconstruction = (
        f"{document['reconstruction']['note'].capitalize()}: they are fitted to Tables 3 to 5, so "
        f"that these tables are no test of the method; Table 1, the comparison of the methods and "
        f"everything over bandwidth were not fitted to."
    )
    sections.append(Section("What is reconstructed", [reconstruction]))
    return Page("Best and Gordon (1999), reproduced", lead, sections)


def _evidence(claim: Document) -> Table:
    """Every number behind a statement."""
    rows = [
        (
            what,
            "" if not _limits(entry) else "yes" if entry["holds"] else "NO",
            number(entry["value"], 3),
            _range(entry),
            _limits(entry) or "for comparison",
        )
        for what, entry in claim["evidence"].items()
    ]
    return Table(
        ("evidence", "holds", "value", "95 %", "must be"),
        rows,
        f"Claim {claim['id']} {_verdict(claim)}. {claim['statement']}",
        claim["note"],
    )

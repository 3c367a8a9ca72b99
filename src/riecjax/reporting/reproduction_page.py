"""The report of the reproduction: the paper's tables and figures, section by section."""

from collections.abc import Iterator

from riecjax.paper.published import CRITERIA
from riecjax.reporting.document import Document, number
from riecjax.reporting.page import Page, Section, Table
from riecjax.reporting.reproduction import (
    SHOWN,
    any_outside,
    limits_in_words,
    mode_in_words,
    numbers_in_words,
)

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
        "Section 3: the models": [_mode_table(document["tables"]["1"])],
        "Section 4: identification": [_number_table(document, n) for n in ("3", "4")],
        "Section 5: validation": [_number_table(document, "5")],
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


def _mode_table(modes: list[Document]) -> Table:
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


def _reconstruction(document: Document) -> str:
    return (
        f"{document['reconstruction']['note'].capitalize()}: they are fitted to Tables 3 to 5, so "
        f"that these tables are no test of the method; Table 1, the comparison of the methods and "
        f"everything over bandwidth were not fitted to."
    )

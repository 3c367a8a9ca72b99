"""The report of a fleet: what it says, section by section."""

from riecjax.reporting.document import Document
from riecjax.reporting.fleet import (
    changes_table,
    differing_table,
    estimates_table,
    left_out_table,
    spread_table,
    worst_table,
)
from riecjax.reporting.page import Page, Section, Table


def fleet_page(document: Document) -> Page:
    """The page of a fleet's document."""
    counts = document["recordings"]
    by = ", ".join(document["by"])
    lead = (
        f"{document['groups']} groups by {by}; {counts['summed']} recordings of "
        f"{counts['samples']} samples, {counts['seconds'] / 3600:.3g} hours."
    )
    differing = differing_table(document)
    spread = [spread_table(document)] if document["parameters"] else []
    spread += _some(estimates_table(document))
    sections = (
        Section(
            "Parameters over groups",
            tables=[*spread, *([differing] if differing else [])],
            charts=("groups",),
        ),
        Section("Parameters over time", tables=_some(changes_table(document)), charts=("courses",)),
        Section(
            "Recordings",
            tables=[
                *_some(left_out_table(document)),
                *_some(worst_table(document)),
                *_some(_findings_table(document)),
            ],
        ),
    )
    return Page(
        f"Fleet: {document['model']}",
        lead,
        sections,
        Section("Answer", [document["sentence"]]),
    )


def _some(table: Table | None) -> list[Table]:
    return [] if table is None else [table]


def _findings_table(document: Document) -> Table | None:
    of_recordings, of_groups = document["findings"], document["group_findings"]
    codes = dict.fromkeys([*of_recordings, *of_groups])
    rows = [[code, *(str(of.get(code, 0)) for of in (of_recordings, of_groups))] for code in codes]
    header = ("finding", "recordings", "groups")
    return Table(header, rows, "What is amiss, and how often") if rows else None

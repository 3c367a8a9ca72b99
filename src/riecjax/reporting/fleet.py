"""Results of a fleet: the document, what is said in a sentence, and tables on a terminal."""

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from rich.console import Console

from riecjax.fleets.fleet import Fleet
from riecjax.fleets.groups import Entry
from riecjax.fleets.spread import ALARMS, Spread
from riecjax.fleets.sums import DONE, Row
from riecjax.reporting.charts.chart import (
    BLUE,
    GREY,
    RUST,
    SERIES,
    Axis,
    Chart,
    Dots,
    Level,
    Line,
    Panel,
    in_rows,
    labelled,
)
from riecjax.reporting.document import (
    SCHEMA,
    Document,
    finite,
    number,
    probability,
    versions,
)
from riecjax.reporting.page import Page, Section, Table
from riecjax.reporting.tables import in_rich, print_table

LISTED = 50
"""Groups, changes and recordings of each kind that a document lists; the tables hold all."""
SHOWN = 10
"""The same that a terminal shows."""
NAMED = 3
"""Groups that a sentence names."""


def fleet_document(found: Fleet, command: Sequence[str] = (), seconds: float = 0.0) -> Document:
    """The document that `--json` prints and results.json holds, whatever the fleet's size.

    **Arguments:** `command`: the arguments of `riecjax` that made it; `seconds` that it took.
    """
    groups = {entry.group for entry in found.entries if entry.status == DONE}
    summed = [row for row in found.recordings if row.status == DONE]
    codes = Counter(code for row in summed for code in {f["code"] for f in _findings(row)})
    answered = [entry for entry in found.entries if entry.status == DONE]
    listed = sorted(groups)[:LISTED]
    return {
        "schema": SCHEMA,
        "model": found.model.name,
        "by": list(found.by),
        "criterion": found.criterion.describe(),
        "sentence": sentence(found),
        "groups": len(groups),
        "recordings": {
            "summed": _count(summed),
            "left_out": len(found.failures),
            "samples": found.samples,
            "seconds": sum(row.seconds for row in summed),
        },
        "parameters": {one.parameter: _spread_entries(one, found) for one in found.spreads},
        "changes": [change._asdict() for change in found.changes[:LISTED]],
        "changes_count": len(found.changes),
        "estimates": [e._asdict() for e in answered if e.group in listed],
        "findings": dict(codes.most_common()),
        "group_findings": dict(_of_groups(answered).most_common()),
        "left_out": [{"recording": r.whole_name, "why": r.status} for r in found.failures[:LISTED]],
        "changed": [*found.changed[:LISTED]],
        "unanswered": [{"group": e.group, "why": e.status} for e in found.unanswered[:LISTED]],
        "worst": [_worst_entries(row) for row in _worst(summed)[:LISTED]],
        "rate": found.rate,
        "warnings": [],
        "provenance": {
            "versions": versions(),
            "command": list(command),
            "seconds": round(seconds, 3),
        },
    }


def _spread_entries(one: Spread, found: Fleet) -> Document:
    levels = Counter(
        e.verdict for e in found.entries if e.parameter == one.parameter and e.status == DONE
    )
    return {
        "unit": one.unit,
        **{name: finite(getattr(one, name)) for name in NUMBERS},
        "groups": one.groups,
        "verdicts": {str(level): count for level, count in levels.most_common()},
        "differing": [group._asdict() for group in one.differing[:LISTED]],
        "differing_count": len(one.differing),
    }


NUMBERS = ("mean", "std_error", "between", "within", "share", "p_value", "centre")


def _of_groups(entries: Sequence[Entry]) -> Counter[str]:
    """By code of a finding, groups that have it."""
    pairs = {(e.group, code) for e in entries for code in e.findings.split(",") if code}
    return Counter(code for _, code in pairs)


def _count(rows: Iterable[Row]) -> int:
    """Recordings, of which a long one has many rows."""
    return len({(row.name, row.part) for row in rows})


def _findings(row: Row) -> list[dict[str, Any]]:
    return json.loads(row.findings)


def _worst(rows: Sequence[Row]) -> list[Row]:
    """Recordings with something amiss, first what puts most in doubt."""
    amiss = [row for row in rows if row.findings != "[]"]
    return sorted(
        amiss,
        key=lambda row: (-max(f["doubt"] for f in _findings(row)), -len(_findings(row)), row.name),
    )


def _worst_entries(row: Row) -> Document:
    found = _findings(row)
    worst = max(found, key=lambda f: f["doubt"])
    return {
        "recording": row.whole_name,
        "codes": list(dict.fromkeys(f["code"] for f in found)),
        "doubt": worst["doubt"],
        "message": worst["message"],
    }


def sentence(found: Fleet) -> str:
    """What was found, in a sentence or two of plain English."""
    groups = len({entry.group for entry in found.entries if entry.status == DONE})
    summed = _count(row for row in found.recordings if row.status == DONE)
    several = f"{groups} group{'s' if groups != 1 else ''}"
    head = several if groups == summed else f"{several} of {summed} recordings"
    standing = [one for one in found.spreads if one.differing]
    standing.sort(key=lambda one: -max(abs(group.away) for group in one.differing))
    if not found.spreads:
        said = f"{head}: too few to compare."
    elif not standing:
        said = f"{head}: none differs from the rest by more than chance."
    else:
        said = f"{head}: {'; '.join(map(_standing_out, standing[:NAMED]))}."
    if found.changes:
        count = len({change.group for change in found.changes})
        names = sorted({change.parameter for change in found.changes})
        said += f" Over time {', '.join(names)} changed in {count} recording{'s' * (count > 1)}."
    if lost := len(found.unanswered):
        said += f" {lost} group{'s have' if lost > 1 else ' has'} no answer."
    if lost := len(found.failures):
        said += f" {lost} recording{'s were' if lost > 1 else ' was'} left out."
    if lost := len(found.changed):
        said += (
            f" {lost} recording{'s' * (lost > 1)} went on changing while summed "
            f"({found.changed[0]}{', ...' * (lost > 1)}): run it again once nothing writes there."
        )
    return said


def _standing_out(one: Spread) -> str:
    first = one.differing[:NAMED]
    listed = ", ".join(f"{group.group} ({100 * group.away:+.2g} %)" for group in first)
    more = len(one.differing) - len(first)
    return f"{one.parameter} differs in {listed}{f' and {more} more' if more else ''}"


def spread_table(document: Document) -> Table:
    """Each parameter over the groups."""
    rows = [
        [
            name,
            one["unit"],
            str(one["groups"]),
            number(one["mean"]),
            number(one["std_error"], 2),
            number(one["between"], 2),
            number(one["within"], 2),
            f"{100 * one['share']:.0f} %",
            probability(one["p_value"]),
            str(one["differing_count"]),
        ]
        for name, one in document["parameters"].items()
    ]
    header = (
        *("parameter", "unit", "groups", "mean", "std error", "between", "within"),
        *("share between", "p", "differ"),
    )
    note = (
        "Between: standard deviation of groups beyond chance; within: the typical standard error "
        "of a group; share between: of all variance; p: of so much spread by chance."
    )
    return Table(header, rows, "Parameters over groups", note)


def estimates_table(document: Document, most: int = LISTED) -> Table | None:
    """Each group's own values, of no more than so many rows."""
    rows = [
        [
            one["group"],
            one["parameter"],
            one["unit"],
            *(number(one[name]) for name in ("value", "low95", "high95")),
            one["verdict"],
        ]
        for one in document["estimates"]
    ]
    header = ("group", "parameter", "unit", "value", "low 95 %", "high 95 %", "verdict")
    return Table(header, rows, "Parameters of each group") if 0 < len(rows) <= most else None


def differing_table(document: Document, most: int = LISTED) -> Table | None:
    """Groups that differ from the rest."""
    rows = [
        [
            group["group"],
            name,
            number(group["value"]),
            number(one["centre"]),
            f"{100 * group['away']:+.2g} %",
            probability(group["adjusted"]),
        ]
        for name, one in document["parameters"].items()
        for group in one["differing"][:most]
    ]
    if not rows:
        return None
    header = ("group", "parameter", "value", "most have", "away", "adjusted p")
    note = (
        f"Of groups that are called different, {100 * document['rate']:.0f} % are not, on average."
    )
    whole = sum(one["differing_count"] for one in document["parameters"].values())
    note += _further(whole - len(rows))
    return Table(header, rows, "Groups that differ from the rest", note)


def changes_table(document: Document, most: int = LISTED) -> Table | None:
    """Steps of parameters over time."""
    rows = [
        [
            change["group"],
            change["parameter"],
            number(change["time"], 4),
            number(change["before"]),
            number(change["after"]),
        ]
        for change in document["changes"][:most]
    ]
    header = ("recording", "parameter", "at / s", "before", "after")
    note = f"In {100 * ALARMS:.0f} % of courses without a step one is found."
    note += _further(document["changes_count"] - len(rows))
    return Table(header, rows, "Changes over time", note) if rows else None


def _further(count: int) -> str:
    return f" {count} more: estimates.parquet." if count else ""


def left_out_table(document: Document, most: int = LISTED) -> Table | None:
    """Recordings that are in no group, groups that have no answer, and why."""
    rows = [[one["recording"], one["why"]] for one in document["left_out"][:most]]
    rows += [[one["group"], one["why"]] for one in document["unanswered"][:most]]
    if not rows:
        return None
    return Table(("recording or group", "why"), rows, "Without an answer", numeric=False)


def worst_table(document: Document, most: int = LISTED) -> Table | None:
    """Recordings with something amiss, the worst first."""
    rows = [
        [
            one["recording"],
            ", ".join(one["codes"]),
            f"{100 * one['doubt']:.2g} %" if one["doubt"] else "",
            one["message"],
        ]
        for one in document["worst"][:most]
    ]
    header = ("recording", "findings", "doubt", "the worst of them")
    return Table(header, rows, "Recordings with something amiss", numeric=False) if rows else None


def print_fleet(document: Document, console: Console) -> None:
    """The sentence and the tables, the longest cut short."""
    console.print(document["sentence"], markup=False, highlight=False, soft_wrap=True)
    tables = (
        estimates_table(document),
        spread_table(document) if document["parameters"] else None,
        differing_table(document, SHOWN),
        changes_table(document, SHOWN),
        left_out_table(document, SHOWN),
    )
    for table in filter(None, tables):
        console.print()
        console.print(table.caption, style="bold", markup=False, highlight=False)
        print_table(in_rich(table), console)
        if table.note:
            console.print(table.note, markup=False, highlight=False)
    counts, seconds = document["recordings"], document["provenance"]["seconds"]
    rate = counts["samples"] / max(seconds, 1e-3)
    console.print(
        f"\n{counts['samples']} samples of {counts['summed']} recordings in {seconds:.3g} s, "
        f"{number(rate, 2)} a second.",
        markup=False,
        highlight=False,
    )


COLUMNS = 2
COURSES = 4
"""Recordings whose courses are drawn: those that change first."""


def fleet_figures(found: Fleet) -> dict[str, Chart]:
    """`groups`, if there are enough to compare, and `courses` over time, if there are some."""
    figures = {}
    if found.spreads:
        panels = [_over_groups(one, found.entries) for one in found.spreads]
        figures["groups"] = _chart(
            panels,
            "Values of all groups in the order of their size, with 95 % intervals. Groups that "
            "differ from the rest, and not by chance, stand out; the line is what most have.",
        )
    if courses := _courses(found):
        figures["courses"] = _chart(
            courses,
            "Estimates from spans of time, with their standard errors; vertical lines are steps "
            "that chance does not explain.",
        )
    return figures


def _chart(panels: Sequence[Panel], caption: str) -> Chart:
    rows = in_rows(panels, COLUMNS)
    return Chart(rows, caption, size=(8.0, 1.0 + 2.4 * len(rows)), legend=True)


def _over_groups(one: Spread, entries: Sequence[Entry]) -> Panel:
    some = [
        e
        for e in entries
        if e.parameter == one.parameter and e.status == DONE and e.verdict != "do not use"
    ]
    ordered = sorted(some, key=lambda e: e.value or 0.0)
    values, low, high = (
        np.array([getattr(e, name) for e in ordered], float)
        for name in ("value", "low95", "high95")
    )
    rank = np.arange(1, len(ordered) + 1)
    standing = {group.group for group in one.differing}
    out = np.array([e.group in standing for e in ordered], bool)
    marks = [
        Line(rank, values, "groups", BLUE, width=1.0, markers=len(rank) <= 60, low=low, high=high),
        Level(one.centre, label="what most have", color=GREY, dashes="dashed"),
        Dots(rank[out], values[out], "differ from the rest", RUST, size=5),
    ]
    return Panel(marks, Axis("group, by size"), Axis(labelled(one.parameter, one.unit)))


def _courses(found: Fleet) -> list[Panel]:
    if not found.over_time:
        return []
    stepping = list(dict.fromkeys(change.group for change in found.changes))
    names = list(dict.fromkeys((*stepping, *(entry.group for entry in found.over_time))))[:COURSES]
    parameters = list(dict.fromkeys(e.parameter for e in found.over_time if e.parameter))
    return [_course(found, name, names) for name in parameters]


def _course(found: Fleet, parameter: str, names: Sequence[str]) -> Panel:
    marks, unit = [], ""
    for name, color in zip(names, SERIES):
        some = [e for e in found.over_time if (e.group, e.parameter) == (name, parameter)]
        unit = next((e.unit for e in some if e.unit), unit)
        middle = [0.5 * (e.start + e.end) for e in some]
        values = np.array([e.value for e in some], float)
        errors = np.array([e.std_error for e in some], float)
        marks.append(Line(middle, values, name, color, markers=True, width=1.0, error=errors))
        marks += [
            Level(change.time, "x", color=color)
            for change in found.changes
            if (change.group, change.parameter) == (name, parameter)
        ]
    return Panel(marks, Axis("time / s"), Axis(labelled(parameter, unit)))


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

"""Results of a fleet: the document, what is said in a sentence, and tables on a terminal."""

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.errors import DataError
from riecjax.fleets.groups import Entry
from riecjax.fleets.spread import ALARMS, RATE, Change, Spread
from riecjax.fleets.sums import DONE, Row
from riecjax.models.model import Model
from riecjax.reporting.charts.chart import (
    BLUE,
    GREY,
    LARGE,
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
from riecjax.reporting.page import Page, Section
from riecjax.reporting.tables import Table, View, in_rich, print_table, say
from riecjax.shows import Shown

LISTED = 50
"""Groups, changes and recordings of each kind that a document lists; the tables hold all."""
SHOWN = 10
"""The same that a terminal shows."""
NAMED = 3
"""Groups that a sentence names."""
COURSES = 4
"""Recordings whose courses are drawn: those that change first."""
FINEST, HOUR = 1e-3, 3600
"""Seconds of what takes no time, and of an hour."""


@dataclass(frozen=True, eq=False, repr=False)
class Fleet(Shown):
    """Parameters of groups of recordings; made by [`fleet`][].

    **Fields:**

    - `model`; `by`, what groups are; `criterion` that made the sums.
    - `entries`: one for each parameter of each group, and one for each recording that failed.
    - `over_time`: the same for each span of time of each recording, if asked for.
    - `spreads` of each parameter over groups, and `changes` over time.
    - `recordings`: one row for each, or for each stretch of a long one, without its sums.
    - `changed`: sources that went on changing while they were summed, and count as they were then.
    - `rate` of false discoveries among groups that are called different.
    """

    model: Model
    by: tuple[str, ...]
    criterion: AbstractCriterion
    entries: Sequence[Entry]
    over_time: Sequence[Entry]
    spreads: Sequence[Spread]
    changes: Sequence[Change]
    recordings: Sequence[Row]
    changed: Sequence[str] = ()
    rate: float = RATE

    @property
    def failures(self) -> list[Row]:
        """Recordings that are in no group, whose `status` says why."""
        return [row for row in self.recordings if row.status != DONE]

    @property
    def unanswered(self) -> list[Entry]:
        """Groups that could not be estimated, whose `status` says why."""
        lost = {row.status for row in self.failures}
        return [e for e in self.entries if e.status != DONE and e.status not in lost]

    @property
    def samples(self) -> int:
        """Of all recordings that were summed."""
        return sum(row.samples for row in self.recordings)

    def to_frame(self) -> Any:
        """All entries, those over time last, as a frame of pandas.

        **Raises:** `DataError` without pandas.
        """
        try:
            import pandas as pd
        except ImportError:
            raise DataError(
                'frames need pandas; install it by pip install "riecjax[frames]".'
            ) from None
        return pd.DataFrame([*self.entries, *self.over_time], columns=list(Entry._fields))

    def view(self) -> View:
        """What is printed of it."""
        document = fleet_document(self)
        tables = [spread_table(document), differing_table(document), left_out_table(document)]
        return View(document["sentence"], tables)


def fleet_document(found: Fleet, command: Sequence[str] = (), seconds: float = 0.0) -> Document:
    """The document that `--json` prints and results.json holds, whatever the fleet's size.

    **Arguments:** `command`: the arguments of `riecjax` that made it; `seconds` that it took.
    """
    answered = [entry for entry in found.entries if entry.status == DONE]
    groups = {entry.group for entry in answered}
    summed = [row for row in found.recordings if row.status == DONE]
    findings = [(row, json.loads(row.findings)) for row in summed]
    codes = Counter(code for _, some in findings for code in {f["code"] for f in some})
    of_groups = {(e.group, code) for e in answered for code in e.findings.split(",") if code}
    listed = sorted(groups)[:LISTED]
    # First what puts most in doubt.
    amiss = sorted(
        ((row, some, max(some, key=lambda f: f["doubt"])) for row, some in findings if some),
        key=lambda each: (-each[2]["doubt"], -len(each[1]), each[0].name),
    )
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
        "parameters": {
            spread.parameter: {
                "unit": spread.unit,
                **{name: finite(getattr(spread, name)) for name in NUMBERS},
                "groups": spread.groups,
                "verdicts": dict(
                    Counter(
                        str(e.verdict) for e in answered if e.parameter == spread.parameter
                    ).most_common()
                ),
                "differing": [group._asdict() for group in spread.differing[:LISTED]],
                "differing_count": len(spread.differing),
            }
            for spread in found.spreads
        },
        "changes": [change._asdict() for change in found.changes[:LISTED]],
        "changes_count": len(found.changes),
        "estimates": [e._asdict() for e in answered if e.group in listed],
        "findings": dict(codes.most_common()),
        "group_findings": dict(Counter(code for _, code in of_groups).most_common()),
        "left_out": [{"recording": r.whole_name, "why": r.status} for r in found.failures[:LISTED]],
        "changed": [*found.changed[:LISTED]],
        "unanswered": [{"group": e.group, "why": e.status} for e in found.unanswered[:LISTED]],
        "worst": [
            {
                "recording": row.whole_name,
                "codes": list(dict.fromkeys(f["code"] for f in some)),
                "doubt": worst["doubt"],
                "message": worst["message"],
            }
            for row, some, worst in amiss[:LISTED]
        ],
        "rate": found.rate,
        "warnings": [],
        "provenance": {
            "versions": versions(),
            "command": list(command),
            "seconds": round(seconds, 3),
        },
    }


NUMBERS = ("mean", "std_error", "between", "within", "share", "p_value", "centre")


def _count(rows: Iterable[Row]) -> int:
    """Recordings, of which a long one has many rows."""
    return len({(row.name, row.part) for row in rows})


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
        clauses = []
        for spread in standing[:NAMED]:
            first = spread.differing[:NAMED]
            listed = ", ".join(f"{group.group} ({100 * group.away:+.2g} %)" for group in first)
            more = len(spread.differing) - len(first)
            further = f" and {more} more" if more else ""
            clauses.append(f"{spread.parameter} differs in {listed}{further}")
        said = f"{head}: {'; '.join(clauses)}."
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


def estimates_table(document: Document, most: int = LISTED) -> Table:
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
    return Table(header, rows if len(rows) <= most else [], "Parameters of each group")


def differing_table(document: Document, most: int = LISTED) -> Table:
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
    header = ("group", "parameter", "value", "most have", "away", "adjusted p")
    note = (
        f"Of groups that are called different, {100 * document['rate']:.0f} % are not, on average."
    )
    whole = sum(one["differing_count"] for one in document["parameters"].values())
    note += _further(whole - len(rows))
    return Table(header, rows, "Groups that differ from the rest", note)


def changes_table(document: Document, most: int = LISTED) -> Table:
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
    return Table(header, rows, "Changes over time", note)


def _further(count: int) -> str:
    return f" {count} more: estimates.parquet." if count else ""


def left_out_table(document: Document, most: int = LISTED) -> Table:
    """Recordings that are in no group, groups that have no answer, and why."""
    rows = [[one["recording"], one["why"]] for one in document["left_out"][:most]]
    rows += [[one["group"], one["why"]] for one in document["unanswered"][:most]]
    return Table(("recording or group", "why"), rows, "Without an answer", numeric=False)


def worst_table(document: Document, most: int = LISTED) -> Table:
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
    return Table(header, rows, "Recordings with something amiss", numeric=False)


def print_fleet(document: Document, console: Console) -> None:
    """The sentence and the tables, the longest cut short."""
    say(console, document["sentence"], wrapped=False)
    for table in (
        estimates_table(document),
        spread_table(document),
        differing_table(document, SHOWN),
        changes_table(document, SHOWN),
        left_out_table(document, SHOWN),
    ):
        if table.rows:
            say(console, "")
            say(console, table.caption, style="bold")
            print_table(in_rich(table), console)
            say(console, *filter(None, [table.note]))
    counts, seconds = document["recordings"], document["provenance"]["seconds"]
    rate = counts["samples"] / max(seconds, FINEST)
    say(
        console,
        "",
        f"{counts['samples']} samples of {counts['summed']} recordings in {seconds:.3g} s, "
        f"{number(rate, 2)} a second.",
    )


def fleet_figures(found: Fleet) -> dict[str, Chart]:
    """`groups`, if there are enough to compare, and `courses` over time, if there are some."""
    captions = {
        "groups": "Values of all groups in the order of their size, with 95 % intervals. Groups "
        "that differ from the rest, and not by chance, stand out; the line is what most have.",
        "courses": "Estimates from spans of time, with their standard errors; vertical lines are "
        "steps that chance does not explain.",
    }
    stepping = list(dict.fromkeys(change.group for change in found.changes))
    names = list(dict.fromkeys((*stepping, *(entry.group for entry in found.over_time))))[:COURSES]
    parameters = list(dict.fromkeys(e.parameter for e in found.over_time if e.parameter))
    panels = {
        "groups": [_over_groups(spread, found.entries) for spread in found.spreads],
        "courses": [_over_time(found, parameter, names) for parameter in parameters],
    }
    return {
        name: Chart(in_rows(some), captions[name], legend=True)
        for name, some in panels.items()
        if some
    }


def _over_groups(spread: Spread, entries: Sequence[Entry]) -> Panel:
    some = [
        e
        for e in entries
        if e.parameter == spread.parameter and e.status == DONE and e.verdict != "do not use"
    ]
    ordered = sorted(some, key=lambda e: e.value or 0.0)
    values, low, high = (
        np.array([getattr(e, name) for e in ordered], float)
        for name in ("value", "low95", "high95")
    )
    rank = np.arange(1, len(ordered) + 1)
    standing = {group.group for group in spread.differing}
    out = np.array([e.group in standing for e in ordered], bool)
    few = len(rank) <= LISTED
    marks = [
        Line(rank, values, "groups", BLUE, width=1.0, markers=few, low=low, high=high),
        Level(spread.centre, label="what most have", color=GREY, dashes="dashed"),
        Dots(rank[out], values[out], "differ from the rest", RUST, size=LARGE),
    ]
    return Panel(marks, Axis("group, by size"), Axis(labelled(spread.parameter, spread.unit)))


def _over_time(found: Fleet, parameter: str, names: Sequence[str]) -> Panel:
    marks, unit = [], ""
    for name, color in zip(names, SERIES):
        some = [e for e in found.over_time if (e.group, e.parameter) == (name, parameter)]
        unit = next((e.unit for e in some if e.unit), unit)
        middle = [0.5 * (e.start + e.end) for e in some]
        values, errors = (
            np.array([getattr(e, n) for e in some], float) for n in ("value", "std_error")
        )
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
    lead = (
        f"{document['groups']} groups by {', '.join(document['by'])}; {counts['summed']} "
        f"recordings of {counts['samples']} samples, {counts['seconds'] / HOUR:.3g} hours."
    )
    of_recordings, of_groups = document["findings"], document["group_findings"]
    codes = dict.fromkeys([*of_recordings, *of_groups])
    rows = [[code, *(str(of.get(code, 0)) for of in (of_recordings, of_groups))] for code in codes]
    findings = Table(("finding", "recordings", "groups"), rows, "What is amiss, and how often")
    over_groups = (spread_table(document), estimates_table(document), differing_table(document))
    recordings = (left_out_table(document), worst_table(document), findings)
    sections = (
        Section("Parameters over groups", tables=over_groups, charts=("groups",)),
        Section("Parameters over time", tables=[changes_table(document)], charts=("courses",)),
        Section("Recordings", tables=recordings),
    )
    answer = Section("Answer", [document["sentence"]])
    return Page(f"Fleet: {document['model']}", lead, sections, answer)

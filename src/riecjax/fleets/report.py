"""Results of a fleet: the document, what is said in a sentence, and tables on a terminal."""

import functools
import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console

from riecjax import Model, charts
from riecjax.charts import Axis, Chart, Dots, Level, Line, Panel, in_rows, labelled
from riecjax.criteria import AbstractCriterion
from riecjax.extensions import require_packages
from riecjax.findings import in_percent
from riecjax.fleets.groups import Entry
from riecjax.fleets.order import DONE, Row
from riecjax.fleets.spread import ALARMS, RATE, Change, Spread, changes, spreads
from riecjax.leaves import told
from riecjax.reporting import (
    SCHEMA,
    Document,
    Page,
    Section,
    Table,
    View,
    in_rich,
    number,
    print_table,
    probability,
    say,
    versions,
)
from riecjax.shows import Shown

LISTED = 50
"""Groups, changes and recordings of each kind that a document lists; the tables hold all."""
SHOWN = 10
"""The same that a terminal shows."""
NAMED = 3
"""Groups and parameters that a sentence names."""
COURSES = 4
"""Recordings whose courses are drawn: those that change first."""
NUMBERS = ("mean", "std_error", "between", "within", "share", "p_value", "centre")
"""What is told of a spread."""
FINEST, HOUR = 1e-3, 3600
"""Seconds of what takes no time, and of an hour."""


@dataclass(frozen=True, eq=False, repr=False)
class Fleet(Shown):
    """Parameters of groups of recordings; made by [`fleet`][].

    **Fields:**

    - `model`; `by`, what groups are; `criterion` that made the sums.
    - `entries`: one for each parameter of each group, and one for each recording that failed.
    - `over_time`: the same for each span of time of each recording, if asked for.
    - `recordings`: one row for each, or for each stretch of a long one, without its sums.
    - `changed`: sources that went on changing while they were summed, and count as they were then.
    """

    model: Model
    by: tuple[str, ...]
    criterion: AbstractCriterion
    entries: Sequence[Entry]
    over_time: Sequence[Entry]
    recordings: Sequence[Row]
    changed: Sequence[str] = ()

    @functools.cached_property
    def spreads(self) -> list[Spread]:
        """Of each parameter, how it is spread over groups."""
        return spreads(self.entries)

    @functools.cached_property
    def changes(self) -> list[Change]:
        """Steps of parameters over time."""
        return changes(self.over_time)

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
        require_packages("frame")
        import pandas as pd

        return pd.DataFrame([*self.entries, *self.over_time], columns=list(Entry._fields))

    def view(self) -> View:
        """What is printed of it."""
        document = fleet_document(self)
        tables = tables_of(document, LISTED)
        return View(document["sentence"], [tables[n] for n in ("spreads", "differing", "left out")])


def fleet_document(fleet: Fleet, command: Sequence[str] = (), seconds: float = 0.0) -> Document:
    """The document that `--json` prints and results.json holds, whatever the fleet's size.

    **Arguments:** `command`: the arguments of `riecjax` that made it; `seconds` that it took.
    """
    answered = [entry for entry in fleet.entries if entry.status == DONE]
    groups = sorted({entry.group for entry in answered})
    summed = [row for row in fleet.recordings if row.status == DONE]
    findings = [(row, json.loads(row.findings)) for row in summed]
    codes = Counter(code for _, some in findings for code in {f["code"] for f in some})
    of_groups = {(e.group, code) for e in answered for code in e.findings.split(",") if code}
    # First what puts most in doubt.
    amiss = sorted(
        ((row, some, max(some, key=lambda f: f["doubt"])) for row, some in findings if some),
        key=lambda each: (-each[2]["doubt"], -len(each[1]), each[0].name),
    )
    verdicts = {
        spread.parameter: Counter(
            str(e.verdict) for e in answered if e.parameter == spread.parameter
        )
        for spread in fleet.spreads
    }
    return {
        "schema": SCHEMA,
        "model": fleet.model.name,
        "by": list(fleet.by),
        "criterion": fleet.criterion.describe(),
        "sentence": sentence(fleet),
        "groups": len(groups),
        "recordings": {
            "summed": _count(summed),
            "left_out": len(fleet.failures),
            "samples": fleet.samples,
            "seconds": sum(row.seconds for row in summed),
        },
        "parameters": {
            spread.parameter: {
                **told(spread, "unit", *NUMBERS, "groups"),
                "verdicts": dict(verdicts[spread.parameter].most_common()),
                "differing": [group._asdict() for group in spread.differing[:LISTED]],
                "differing_count": len(spread.differing),
            }
            for spread in fleet.spreads
        },
        "changes": [change._asdict() for change in fleet.changes[:LISTED]],
        "changes_count": len(fleet.changes),
        "estimates": [e._asdict() for e in answered if e.group in groups[:LISTED]],
        "findings": dict(codes.most_common()),
        "group_findings": dict(Counter(code for _, code in of_groups).most_common()),
        "left_out": [{"recording": r.whole_name, "why": r.status} for r in fleet.failures[:LISTED]],
        "changed": [*fleet.changed[:LISTED]],
        "unanswered": [{"group": e.group, "why": e.status} for e in fleet.unanswered[:LISTED]],
        "worst": [
            {
                "recording": row.whole_name,
                "codes": list(dict.fromkeys(f["code"] for f in some)),
                **{name: worst[name] for name in ("doubt", "message")},
            }
            for row, some, worst in amiss[:LISTED]
        ],
        "rate": RATE,
        "warnings": [],
        "provenance": {
            "versions": versions(),
            "command": list(command),
            "seconds": round(seconds, 3),
        },
    }


def _count(rows: Iterable[Row]) -> int:
    """Recordings, of which a long one has many rows."""
    return len({(row.name, row.part) for row in rows})


def sentence(fleet: Fleet) -> str:
    """What was found, in a sentence or two of plain English."""
    groups = len({entry.group for entry in fleet.entries if entry.status == DONE})
    summed = _count(row for row in fleet.recordings if row.status == DONE)
    head = f"{groups} group{'s' * (groups != 1)}"
    head += f" of {summed} recordings" * (groups != summed)
    differing = [spread for spread in fleet.spreads if spread.differing]
    differing.sort(key=lambda spread: -max(abs(group.away) for group in spread.differing))
    if not fleet.spreads:
        text = f"{head}: too few to compare."
    elif not differing:
        text = f"{head}: none differs from the rest by more than chance."
    else:
        clauses = []
        for spread in differing[:NAMED]:
            first = spread.differing[:NAMED]
            listed = ", ".join(f"{group.group} ({100 * group.away:+.2g} %)" for group in first)
            more = len(spread.differing) - len(first)
            clauses.append(
                f"{spread.parameter} differs in {listed}{f' and {more} more' * bool(more)}"
            )
        text = f"{head}: {'; '.join(clauses)}."
    if count := len({change.group for change in fleet.changes}):
        names = ", ".join(sorted({change.parameter for change in fleet.changes}))
        text += f" Over time {names} changed in {count} recording{'s' * (count > 1)}."
    if count := len(fleet.unanswered):
        text += f" {count} group{'s have' if count > 1 else ' has'} no answer."
    if count := len(fleet.failures):
        text += f" {count} recording{'s were' if count > 1 else ' was'} left out."
    if count := len(fleet.changed):
        text += (
            f" {count} recording{'s' * (count > 1)} went on changing while summed "
            f"({fleet.changed[0]}{', ...' * (count > 1)}): run it again once nothing writes there."
        )
    return text


few = functools.partial(number, digits=2)
COLUMNS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "recording or group": ("name", str),
    "value": ("value", number),
    "low 95 %": ("low95", number),
    "high 95 %": ("high95", number),
    "mean": ("mean", number),
    "std error": ("std_error", few),
    "between": ("between", few),
    "within": ("within", few),
    "share between": ("share", lambda share: in_percent(share, ".0f")),
    "p": ("p_value", probability),
    "differ": ("differing_count", str),
    "most have": ("centre", number),
    "away": ("away", lambda share: f"{100 * share:+.2g} %"),
    "adjusted p": ("adjusted", probability),
    "at / s": ("time", lambda time: number(time, 4)),
    "before": ("before", number),
    "after": ("after", number),
    "findings": ("codes", ", ".join),
    "doubt": ("doubt", lambda share: in_percent(share) if share else ""),
    "the worst of them": ("message", str),
}
"""Of a column the key of what it shows, and how that is said; of any other its header, as text."""


def tables_of(document: Document, most: int) -> dict[str, Table]:
    """Tables of a document by what they are of; lists are cut short after so many rows."""
    spreads = [{"parameter": name, **entry} for name, entry in document["parameters"].items()]
    differing = [spread | group for spread in spreads for group in spread["differing"][:most]]
    changes = [{"recording": change["group"], **change} for change in document["changes"][:most]]
    left_out = [{"name": each["recording"], **each} for each in document["left_out"][:most]]
    left_out += [{"name": each["group"], **each} for each in document["unanswered"][:most]]
    recordings, groups = document["findings"], document["group_findings"]
    findings = [
        {"finding": code, "recordings": recordings.get(code, 0), "groups": groups.get(code, 0)}
        for code in recordings | groups
    ]
    estimates = document["estimates"]

    def table(
        entries: Sequence[Document], columns: str, caption: str, note: str = "", **look: bool
    ) -> Table:
        header = columns.split(", ")
        cells = [COLUMNS.get(name, (name, str)) for name in header]
        rows = [[said(entry[key]) for key, said in cells] for entry in entries]
        return Table(header, rows, caption, note, **look)

    def further(whole: int, rows: Sequence[object]) -> str:
        return f" {whole - len(rows)} more: estimates.parquet." if whole > len(rows) else ""

    return {
        "estimates": table(
            estimates if len(estimates) <= LISTED else (),
            "group, parameter, unit, value, low 95 %, high 95 %, verdict",
            "Parameters of each group",
        ),
        "spreads": table(
            spreads,
            "parameter, unit, groups, mean, std error, between, within, share between, p, differ",
            "Parameters over groups",
            "Between: standard deviation of groups beyond chance; within: the typical standard "
            "error of a group; share between: of all variance; p: of so much spread by chance.",
        ),
        "differing": table(
            differing,
            "group, parameter, value, most have, away, adjusted p",
            "Groups that differ from the rest",
            f"Of groups that are called different, {in_percent(document['rate'], '.0f')} are "
            f"not, on average."
            + further(sum(spread["differing_count"] for spread in spreads), differing),
        ),
        "changes": table(
            changes,
            "recording, parameter, at / s, before, after",
            "Changes over time",
            f"In {in_percent(ALARMS, '.0f')} of courses without a step one is found."
            + further(document["changes_count"], changes),
        ),
        "left out": table(left_out, "recording or group, why", "Without an answer", numeric=False),
        "worst": table(
            document["worst"][:most],
            "recording, findings, doubt, the worst of them",
            "Recordings with something amiss",
            numeric=False,
        ),
        "findings": table(findings, "finding, recordings, groups", "What is amiss, and how often"),
    }


def print_fleet(document: Document, console: Console) -> None:
    """The sentence and the tables, the longest cut short."""
    say(console, document["sentence"], wrapped=False)
    tables = tables_of(document, SHOWN)
    for name in ("estimates", "spreads", "differing", "changes", "left out"):
        if (table := tables[name]).rows:
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
    some = [e for e in entries if e.parameter == spread.parameter and e.status == DONE]
    ordered = sorted(some, key=lambda e: e.value or 0.0)
    ordered = [e for e in ordered if e.verdict != "do not use"]
    values, low, high = np.array([(e.value, e.low95, e.high95) for e in ordered], float).T
    rank = np.arange(1, len(ordered) + 1)
    standing = {group.group for group in spread.differing}
    out = np.array([e.group in standing for e in ordered], bool)
    few = len(rank) <= LISTED
    marks = [
        Line(rank, values, "groups", charts.BLUE, width=1.0, markers=few, low=low, high=high),
        Level(spread.centre, label="what most have", color=charts.GREY, dashes="dashed"),
        Dots(rank[out], values[out], "differ from the rest", charts.RUST, size=charts.LARGE),
    ]
    return Panel(marks, Axis("group, by size"), Axis(labelled(spread.parameter, spread.unit)))


def _over_time(found: Fleet, parameter: str, names: Sequence[str]) -> Panel:
    marks, unit = [], ""
    for name, color in zip(names, charts.SERIES):
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
    tables = tables_of(document, LISTED)
    lead = (
        f"{document['groups']} groups by {', '.join(document['by'])}; {counts['summed']} "
        f"recordings of {counts['samples']} samples, {counts['seconds'] / HOUR:.3g} hours."
    )
    over_groups, recordings = (
        [tables[name] for name in names]
        for names in (("spreads", "estimates", "differing"), ("left out", "worst", "findings"))
    )
    sections = (
        Section("Parameters over groups", tables=over_groups, charts=("groups",)),
        Section("Parameters over time", tables=[tables["changes"]], charts=("courses",)),
        Section("Recordings", tables=recordings),
    )
    answer = Section("Answer", [document["sentence"]])
    return Page(f"Fleet: {document['model']}", lead, sections, answer)

"""A discovery in plain data, in a sentence, and as tables on a terminal."""

import functools
import shlex
from collections.abc import Sequence

import numpy as np
from rich.console import Console

from riecjax.assessment.verdict import joined
from riecjax.discovery import Discovery, Step
from riecjax.equations.hidden_elements import HiddenMode, ModeParameters, accelerated
from riecjax.findings import option_for
from riecjax.reporting.charts.chart import BLUE, GREY, Axis, Chart, Line, Panel, in_rows
from riecjax.reporting.checking import share_in_words
from riecjax.reporting.document import SCHEMA, Document, finite, number, probability, told, versions
from riecjax.reporting.equations import equation_in_words
from riecjax.reporting.estimate import known_entries, parameter_entries, parameter_table
from riecjax.reporting.page import Page, Section
from riecjax.reporting.tables import Table, in_rich, print_table, say

NOTABLE = 0.05
"""Share of what is unexplained that noise must make to be told."""
percent = functools.partial(share_in_words, digits=2)


def discovery_document(
    found: Discovery, command: Sequence[str] = (), model_file: str | None = None
) -> Document:
    """The document that `--json` prints and results.json holds.

    **Arguments:** `command`: the arguments of `riecjax` that made it; `model_file`, where the model
    was written to.
    """
    equations = found.model.equations
    terms = {
        one.candidate.name: {
            **told(one.candidate, "meaning", "equation"),
            "parameters": list(one.candidate.columns),
            **told(one, "width", "width_unit"),
            "width_std_error": finite(one.width_error),
            "chosen_again": finite(one.share),
        }
        for one in found.chosen
    }
    if found.mode is not None:  # as one of the terms that were found
        (equation,) = found.paths
        terms["mode"] = {
            "meaning": _mode_in_words(found.mode),
            "equation": equation,
            "parameters": list(ModeParameters.of(len(found.start.modes))),
            "width": None,
            "width_unit": "",
            "width_std_error": None,
            "chosen_again": None,
        }
    words = [*map(equation_in_words, equations)]
    words += [f"with {_mode_in_words(found.mode)}"] if found.mode else []
    return {
        "schema": SCHEMA,
        "model": found.start.name,
        "criterion": found.estimate.criterion.describe(),
        "sentence": sentence(found),
        "chosen": list(found.names),
        "terms": terms,
        "path": [
            {"equation": name, **told(step, *Step._fields)}
            for name, steps in found.paths.items()
            for step in steps
        ],
        "rejected": [one._asdict() for one in found.rejected],
        "offered": found.offered,
        "held_out": found.held_out,
        "delays": {name: finite(late) for name, late in found.delays.items()},
        "parameters": _parameters(found),
        "known": known_entries(found.estimate),
        "equation": "; ".join(words),
        "model_file": model_file,
        "warnings": [f._asdict() for f in (*found.findings, *found.estimate.findings())],
        "provenance": {"versions": versions(), "command": list(command)},
    }


def _parameters(found: Discovery) -> Document:
    """As of any estimate, with what the choice of terms adds to its errors."""
    entries = parameter_entries(found.estimate)
    for name, entry in entries.items():
        own, whole = entry["std_error"], found.errors.get(name)
        if own and whole is not None and whole > own:
            value, ratio = entry["value"], whole / own
            entry["std_error"] = finite(whole)
            entry["interval95"] = [
                None if end is None else value + ratio * (end - value)
                for end in entry["interval95"]
            ]
    return entries


def sentence(found: Discovery) -> str:
    """What was found, in a sentence or two of plain English."""
    if not found.offered and found.mode is None:
        return "No candidate could be told apart from the model's own terms."
    chosen = [(one.candidate.name, one.candidate.meaning) for one in found.chosen]
    names = [f"{name} ({meaning})" if meaning else name for name, meaning in chosen]
    if found.mode is not None:
        names.append(f"mode ({_mode_in_words(found.mode)})")
    if not names:
        first = next(iter(found.paths.values()))[0]
        what = "No candidate is missing" if found.leaves_more else "No term is missing"
        what = what if found.leaves_more or found.delays else "Nothing is missing"
        return (
            f"{what}: none of {found.offered} candidates explains more than chance "
            f"would, and {percent(first.unexplained)} of the target's energy is "
            f"unexplained{_noise(first)}.{_something_else(found)}{_late(found)}"
        )
    ends = [(name, of[0], of[-1]) for name, of in found.paths.items() if len(of) > 1]
    several = len(found.paths) > 1 or found.mode is not None
    said = "; ".join(
        f"{percent(after.unexplained)} of the target's energy{where} is unexplained instead of "
        f"{percent(before.unexplained)}{_noise(after)}"
        for name, before, after in ends
        for where in [f" in {name}" if several else ""]
    )
    verb, them = ("is", "it") if len(names) == 1 else ("are", "them")
    further = _something_else(found) + _late(found)
    # Terms may only make up for a fault of the recordings.
    faults = {f"{f.code} of {' and '.join(f.signals)}": f.remedy for f in found.amiss if f.remedy}
    if faults:
        remedy = shlex.join(next(iter(faults.values())))
        further += (
            f" But terms may stand for what is amiss with the recordings, {joined(list(faults))}: "
            f"mend that first ({remedy})."
        )
    return f"{joined(names)} {verb} missing: with {them} {said}.{further}"


def _mode_in_words(mode: HiddenMode) -> str:
    return f"a hidden mode on {mode.on} near {mode.hz:.3g} Hz"


def _something_else(found: Discovery) -> str:
    """Where what is left is more than noise, that no candidate is what is missing."""
    beside = "" if found.mode is None or found.chosen else " No terms were looked for beside it."
    if not found.leaves_more:
        return beside
    left = " Most of what is left is no noise: something that is no candidate is missing"
    bodies = {on: "" for e in found.model.equations for on in accelerated(e)}
    if found.mode is not None:
        return f"{left} too.{beside} Add terms to the model by hand."
    if not bodies:
        return f"{left}; no equation holds an inertia."
    return f"{left}, such as a mode beside terms (identify with --add-mode {' or '.join(bodies)})."


def _late(found: Discovery) -> str:
    """Of which recordings the terms are, where some signals are late in those that were given."""
    if not found.delays:
        return ""
    delays, remedy = [], []
    for name, late in found.delays.items():
        which = name if late > 0 else f"all but {name}"
        delays.append(f"{which} comes {number(1e3 * abs(late), 3)} ms late")
        remedy += option_for("--shift", [name], f"{late:.4g}")
    return (
        f" {joined(delays)}; all this is of recordings with it in time: identify with "
        f"{shlex.join(remedy)}."
    )


def _noise(step: Step) -> str:
    """How much of what is left the sensors' noise makes."""
    left = max(step.of_motion, 0.0)
    share = 1 - left / step.unexplained if step.unexplained > 0 else 0.0
    if share < NOTABLE:
        return ""
    return f", {'nearly all' if share > 1 - NOTABLE else f'{100 * share:.0f} %'} of it noise"


def path_table(document: Document) -> Table:
    """What is unexplained, with one term more on each line."""
    several = len({one["equation"] for one in document["path"]}) > 1
    rows = [
        [
            *([one["equation"]] if several else []),
            f"+ {one['added']}" if one["added"] else document["model"],
            percent(one["unexplained"]),
            percent(max(one["of_motion"], 0.0)),
            percent(one["std_error"]) if one["added"] and one["std_error"] is not None else "",
            probability(one["chance"]) if one["added"] and one["chance"] is not None else "",
        ]
        for one in document["path"]
    ]
    header = ("terms", "unexplained", "without noise", "std error of the step", "chance")
    note = (
        "Share of the target's energy, by the windows of each fit."
        if "mode" in document["terms"]
        else "Share of the target's energy in blocks of time that coefficients were not fitted to; "
        "chance: that any one of all candidates stands out as much and explains nothing."
    )
    return Table(("equation", *header) if several else header, rows, "Terms one by one", note)


def rejected_table(document: Document) -> Table:
    """What came nearest of all that was not taken."""
    cells = {
        "would explain, of what is left": lambda one: percent(one["gain"]),
        "chance": lambda one: probability(one["chance"]),
    }
    rejected = [(one["name"], one) for one in document["rejected"]]
    return Table.of("candidate", rejected, cells, "Not taken")


def choice_in_words(document: Document) -> str:
    """What intervals say of the choice of terms."""
    if document["held_out"]:
        return (
            f"Terms were chosen without the last {100 * document['held_out']:.0f} % of each "
            f"recording, from which alone values and intervals are."
        )
    if not document["terms"]:
        return ""
    again = ", ".join(
        f"{name} {100 * one['chosen_again']:.0f} %"
        for name, one in document["terms"].items()
        if one["chosen_again"] is not None
    )
    if not again or "mode" in document["terms"]:
        return "Intervals take the choice of terms for given."
    return f"Standard errors include the choice; in data drawn again it fell on {again}."


def choice_lines(document: Document) -> list[str]:
    """Widths of laws that have one, and what intervals say of the choice."""
    widths = []
    for name, term in document["terms"].items():
        if term["width"] is not None:
            error = term["width_std_error"]
            width = number(term["width"], 4) + (f" +- {number(error, 2)}" if error else "")
            widths.append(f"{name} has the width {width} {term['width_unit']}".rstrip())
    return [*filter(None, (f"{'; '.join(widths)}." if widths else "", choice_in_words(document)))]


def print_discovery(document: Document, console: Console) -> None:
    """The sentence, the path, the parameters and the equation."""
    say(console, document["sentence"], wrapped=False)
    for table in (path_table(document), rejected_table(document)):
        if table.rows:
            say(console, "")
            say(console, table.caption, style="bold", wrapped=False)
            print_table(in_rich(table), console)
    say(console, "")
    print_table(in_rich(parameter_table(document)), console)
    lines = [*choice_lines(document), "", document["equation"]]
    if document["model_file"]:
        lines.append(f"model: {document['model_file']}, for riecjax identify and simulate")
    say(console, *lines, wrapped=False)


def discovery_page(document: Document) -> Page:
    """The page of a discovery's document."""
    terms = [path_table(document), rejected_table(document)]
    return Page(
        f"What {document['model']} lacks",
        f"{document['offered']} candidates; {document['equation']}",
        (
            Section("Terms", tables=terms, charts=("path",)),
            Section("Parameters", choice_lines(document), tables=[parameter_table(document)]),
        ),
        Section("Answer", [document["sentence"]]),
    )


def discovery_figures(found: Discovery) -> dict[str, Chart]:
    """`path`: what is left unexplained with one term more each time."""
    panels = []
    for name, steps in found.paths.items():
        names = tuple(step.added or found.start.name for step in steps)
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
    return {"path": Chart(in_rows(panels), caption, legend=True)}

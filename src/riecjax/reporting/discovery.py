"""A discovery in plain data, in a sentence, and as tables on a terminal."""

import functools
import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import UNSET, UnsetType
from rich.console import Console

from riecjax.assessment.next_steps import joined
from riecjax.discovery import Discovery, Step
from riecjax.equations.hidden_elements import HiddenMode, ModeParameters, accelerated
from riecjax.estimation.estimate import known_entries, parameter_entries
from riecjax.findings import option_for
from riecjax.reporting.answer import (
    FilePart,
    Known,
    Number,
    Parameter,
    Part,
    Settings,
    WarningPart,
    read,
)
from riecjax.reporting.charts.chart import BLUE, GREY, Axis, Chart, Line, Panel, in_rows
from riecjax.reporting.document import SCHEMA, number, probability, share_in_words, versions
from riecjax.reporting.equations import equation_in_words
from riecjax.reporting.page import Page, Section
from riecjax.reporting.parameters import parameter_table
from riecjax.reporting.tables import Table, in_rich, print_table, say

NOTABLE = 0.05
"""Share of what is unexplained that noise must make to be told."""
percent = functools.partial(share_in_words, digits=2)


class TermPart(Part):
    """A candidate that was taken, or a hidden mode."""

    meaning: str
    equation: str
    parameters: list[str]
    width: Number = None
    width_unit: str = ""
    width_std_error: Number = None
    chosen_again: Number = None


class PathStep(Part):
    """A line of the path: a term more, and what is unexplained with it."""

    equation: str
    added: str
    unexplained: Number
    of_motion: Number
    std_error: Number
    chance: Number


class RejectedPart(Part):
    """A candidate that was not taken."""

    name: str
    gain: Number
    chance: Number


class DiscoveryProvenance(Part):
    """What a discovery was made by and from."""

    versions: dict[str, str]
    command: list[str]
    files: list[FilePart] | UnsetType = UNSET


class DiscoveryAnswer(Part, kw_only=True):
    """The document that `riecjax discover --json` prints and results.json holds."""

    schema: int = SCHEMA
    model: str
    criterion: Settings
    sentence: str
    chosen: list[str]
    terms: dict[str, TermPart]
    path: list[PathStep]
    rejected: list[RejectedPart]
    offered: int
    held_out: Number
    delays: dict[str, Number]
    parameters: dict[str, Parameter]
    known: dict[str, Known]
    equation: str
    model_file: str | None
    warnings: list[WarningPart]
    provenance: DiscoveryProvenance
    job: dict[str, Any] | UnsetType = UNSET


def discovery_answer(
    found: Discovery, command: Sequence[str] = (), model_file: str | None = None
) -> DiscoveryAnswer:
    """The document of a discovery.

    **Arguments:** `command`: the arguments of `riecjax` that made it; `model_file`, where the model
    was written to.
    """
    terms = {
        chosen.candidate.name: {
            "meaning": chosen.candidate.meaning,
            "equation": chosen.candidate.equation,
            "parameters": chosen.candidate.columns,
            "width": chosen.width,
            "width_unit": chosen.width_unit,
            "width_std_error": chosen.width_error,
            "chosen_again": chosen.share,
        }
        for chosen in found.chosen
    }
    words = [*map(equation_in_words, found.model.equations)]
    if found.mode is not None:  # as one of the terms that were found
        (equation,), meaning = found.paths, _mode_in_words(found.mode)
        names = list(ModeParameters.of(len(found.start.modes)))
        terms["mode"] = {"meaning": meaning, "equation": equation, "parameters": names}
        words.append(f"with {meaning}")
    parameters = parameter_entries(found.estimate)
    for name, entry in parameters.items():
        # As of any estimate, with what the choice of terms adds to its errors.
        own, whole = entry["std_error"], found.errors.get(name)
        if own and whole is not None and whole > own:
            value, ratio = entry["value"], whole / own
            entry["std_error"] = whole
            entry["interval95"] = [
                None if end is None else value + ratio * (end - value)
                for end in entry["interval95"]
            ]
    return read(
        DiscoveryAnswer,
        {
            "model": found.start.name,
            "criterion": found.estimate.criterion.describe(),
            "sentence": sentence(found),
            "chosen": found.names,
            "terms": terms,
            "path": [
                {"equation": name, **step._asdict()}
                for name, steps in found.paths.items()
                for step in steps
            ],
            "rejected": [rejected._asdict() for rejected in found.rejected],
            "offered": found.offered,
            "held_out": found.held_out,
            "delays": found.delays,
            "parameters": parameters,
            "known": known_entries(found.estimate),
            "equation": "; ".join(words),
            "model_file": model_file,
            "warnings": [f._asdict() for f in (*found.findings, *found.estimate.findings())],
            "provenance": {"versions": versions(), "command": list(command)},
        },
    )


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


def path_table(answer: DiscoveryAnswer) -> Table:
    """What is unexplained, with one term more on each line."""
    cells = {
        "equation": lambda step: step.equation,
        "terms": lambda step: f"+ {step.added}" if step.added else answer.model,
        "unexplained": lambda step: percent(step.unexplained),
        "without noise": lambda step: percent(max(step.of_motion, 0.0)),
        "std error of the step": lambda step: (
            percent(step.std_error) if step.added and step.std_error is not None else ""
        ),
        "chance": lambda step: (
            probability(step.chance) if step.added and step.chance is not None else ""
        ),
    }
    if len({step.equation for step in answer.path}) <= 1:
        del cells["equation"]
    note = (
        "Share of the target's energy, by the windows of each fit."
        if "mode" in answer.terms
        else "Share of the target's energy in blocks of time that coefficients were not fitted to; "
        "chance: that any one of all candidates stands out as much and explains nothing."
    )
    rows = [[cell(step) for cell in cells.values()] for step in answer.path]
    return Table(tuple(cells), rows, "Terms one by one", note)


def rejected_table(answer: DiscoveryAnswer) -> Table:
    """What came nearest of all that was not taken."""
    cells = {
        "would explain, of what is left": lambda rejected: percent(rejected.gain),
        "chance": lambda rejected: probability(rejected.chance),
    }
    rejected = [(rejected.name, rejected) for rejected in answer.rejected]
    return Table.of("candidate", rejected, cells, "Not taken")


def choice_in_words(answer: DiscoveryAnswer) -> str:
    """What intervals say of the choice of terms."""
    if answer.held_out:
        return (
            f"Terms were chosen without the last {100 * answer.held_out:.0f} % of each "
            f"recording, from which alone values and intervals are."
        )
    if not answer.terms:
        return ""
    again = ", ".join(
        f"{name} {100 * term.chosen_again:.0f} %"
        for name, term in answer.terms.items()
        if term.chosen_again is not None
    )
    if not again or "mode" in answer.terms:
        return "Intervals take the choice of terms for given."
    return f"Standard errors include the choice; in data drawn again it fell on {again}."


def choice_lines(answer: DiscoveryAnswer) -> list[str]:
    """Widths of laws that have one, and what intervals say of the choice."""
    widths = []
    for name, term in answer.terms.items():
        if term.width is not None:
            error = f" +- {number(term.width_std_error, 2)}" if term.width_std_error else ""
            width = f"{number(term.width, 4)}{error} {term.width_unit}"
            widths.append(f"{name} has the width {width}".rstrip())
    return [*filter(None, (f"{'; '.join(widths)}." if widths else "", choice_in_words(answer)))]


def print_discovery(answer: DiscoveryAnswer, console: Console) -> None:
    """The sentence, the path, the parameters and the equation."""
    say(console, answer.sentence, wrapped=False)
    for table in (path_table(answer), rejected_table(answer)):
        if table.rows:
            say(console, "")
            say(console, table.caption, style="bold", wrapped=False)
            print_table(in_rich(table), console)
    say(console, "")
    print_table(in_rich(parameter_table(answer)), console)
    lines = [*choice_lines(answer), "", answer.equation]
    if answer.model_file:
        lines.append(f"model: {answer.model_file}, for riecjax identify and simulate")
    say(console, *lines, wrapped=False)


def discovery_page(answer: DiscoveryAnswer) -> Page:
    """The page of a discovery."""
    terms = [path_table(answer), rejected_table(answer)]
    return Page(
        f"What {answer.model} lacks",
        f"{answer.offered} candidates; {answer.equation}",
        (
            Section("Terms", tables=terms, charts=("path",)),
            Section("Parameters", choice_lines(answer), tables=[parameter_table(answer)]),
        ),
        Section("Answer", [answer.sentence]),
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

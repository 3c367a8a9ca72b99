"""A discovery in plain data, in a sentence, and as tables on a terminal."""

import functools
import shlex
from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
from msgspec import UNSET
from rich.console import Console

from riecjax.charts import BLUE, GREY, Axis, Chart, Line, Panel, in_rows
from riecjax.discovery import Discovery, Step
from riecjax.elements.catalogue import discovered_kinds
from riecjax.findings import in_percent, joined, option_for
from riecjax.leaves import finite
from riecjax.reporting import Page, Section, Table, View, in_rich, print_table, say
from riecjax.reporting.answer import Answer, part_of
from riecjax.reporting.document import (
    SCHEMA,
    Document,
    number,
    probability,
    share_in_words,
    versions,
)
from riecjax.reporting.equations import equation_in_words
from riecjax.reporting.parameters import parameter_table
from riecjax.shows import view_of

NOTABLE = 0.05
"""Share of what is unexplained that noise must make to be told."""
percent = functools.partial(share_in_words, digits=2)


def discovery_document(
    found: Discovery, command: Sequence[str] = (), model_file: str | None = None
) -> Document:
    """The document that `riecjax discover --json` prints and results.json holds.

    **Arguments:** `command`: the arguments of `riecjax` that made it; `model_file`, where the model
    was written to.
    """
    widths = ("width", "width_unit", "width_std_error", "chosen_again")
    terms = {
        chosen.candidate.name: {
            "meaning": chosen.candidate.meaning,
            "equation": chosen.candidate.equation,
            "parameters": chosen.candidate.columns,
            **dict(zip(widths, chosen[1:])),
        }
        for chosen in found.chosen
    }
    if found.element is not None:  # as one of the terms that were found
        (equation,), meaning = found.paths, found.element.described
        names = found.element.hidden
        terms["mode"] = {"meaning": meaning, "equation": equation, "parameters": names}
        terms["mode"] |= dict(zip(widths, (None, "", None, None)))
    answer = parameters_of(found)
    return finite(
        {
            "schema": SCHEMA,
            "model": found.start.name,
            "criterion": answer.criterion,
            "sentence": sentence(found),
            "chosen": found.names,
            "terms": terms,
            "path": [
                {"equation": name, **step._asdict()}
                for name, steps in found.paths.items()
                for step in steps
            ],
            "rejected": found.rejected,
            "offered": found.offered,
            "held_out": found.held_out,
            "delays": found.delays,
            "parameters": msgspec.to_builtins(answer.parameters),
            "known": msgspec.to_builtins(answer.known),
            "equation": equation_of(found),
            "model_file": model_file,
            "warnings": [f._asdict() for f in (*found.findings, *found.estimate.findings())],
            "provenance": {"versions": versions(), "command": command},
        },
    )


def parameters_of(found: Discovery) -> Answer:
    """Parameters as of any estimate, with what the choice of terms adds to their errors."""
    answer = part_of(found.estimate)
    for name, entry in answer.parameters.items():
        entry.naive_std_error = entry.effective_windows = UNSET
        error, whole = entry.std_error, found.errors.get(name)
        if error and whole is not None and whole > error:
            value, ratio = entry.value or 0.0, whole / error
            low, high = (end and value + ratio * (end - value) for end in entry.interval95)
            entry.std_error, entry.interval95 = float(whole), (low, high)
    return answer


def equation_of(found: Discovery) -> str:
    """The equations of motion that were found."""
    mode = [] if found.element is None else [f"with {found.element.described}"]
    return "; ".join([*map(equation_in_words, found.model.equations), *mode])


def sentence(found: Discovery) -> str:
    """What was found, in a sentence or two of plain English."""
    if not found.offered and found.element is None:
        return "No candidate could be told apart from the model's own terms."
    chosen = [(one.candidate.name, one.candidate.meaning) for one in found.chosen]
    names = [f"{name} ({meaning})" if meaning else name for name, meaning in chosen]
    if found.element is not None:
        names.append(f"{found.element.kind} ({found.element.described})")
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
    several = len(found.paths) > 1 or found.element is not None
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


def _something_else(found: Discovery) -> str:
    """Where what is left is more than noise, that no candidate is what is missing."""
    beside = "" if found.element is None or found.chosen else " No terms were looked for beside it."
    if not found.leaves_more:
        return beside
    left = " Most of what is left is no noise: something that is no candidate is missing"
    if found.element is not None:
        return f"{left} too.{beside} Add terms to the model by hand."
    equations = found.model.equations
    for kind in discovered_kinds():
        places = dict.fromkeys(of for e in equations for of in kind.places(e, equations))
        if places:
            return (
                f"{left}, such as a {kind.kind} beside terms (identify with {kind.option()} "
                f"{' or '.join(places)})."
            )
    return f"{left}; no equation holds an inertia."


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
    return f", {'nearly all' if share > 1 - NOTABLE else in_percent(share, '.0f')} of it noise"


def path_table(found: Discovery) -> Table:
    """What is unexplained, with one term more on each line."""
    path = [(name, step) for name, steps in found.paths.items() for step in steps]
    cells = {
        "terms": lambda step: f"+ {step.added}" if step.added else found.start.name,
        "unexplained": lambda step: percent(finite(step.unexplained)),
        "without noise": lambda step: percent(finite(max(step.of_motion, 0.0))),
        "std error of the step": lambda step: (
            percent(step.std_error) if step.added and np.isfinite(step.std_error) else ""
        ),
        "chance": lambda step: (
            probability(step.chance) if step.added and np.isfinite(step.chance) else ""
        ),
    }
    note = (
        "Share of the target's energy in blocks of time that coefficients were not fitted to; "
        "chance: that any one of all candidates stands out as much and explains nothing."
        if found.element is None
        else "Share of the target's energy, by the windows of each fit."
    )
    table = Table.of("equation", path, cells, "Terms one by one", note)
    several = len(found.paths) > 1
    return table if several else replace(table, header=[*cells], rows=[r[1:] for r in table.rows])


def rejected_table(found: Discovery) -> Table:
    """What came nearest of all that was not taken."""
    cells = {
        "would explain, of what is left": lambda rejected: percent(finite(rejected.gain)),
        "chance": lambda rejected: probability(finite(rejected.chance)),
    }
    rejected = [(rejected.name, rejected) for rejected in found.rejected]
    return Table.of("candidate", rejected, cells, "Not taken")


def choice_lines(found: Discovery) -> list[str]:
    """Widths of laws that have one, and what intervals say of the choice."""
    widths = []
    for term in found.chosen:
        if term.width is not None:
            error = f" +- {number(term.width_error, 2)}" if term.width_error > 0 else ""
            width = f"{number(term.width, 4)}{error} {term.width_unit}"
            widths.append(f"{term.candidate.name} has the width {width}".rstrip())
    again = ", ".join(
        f"{chosen.candidate.name} {in_percent(chosen.share, '.0f')}"
        for chosen in found.chosen
        if np.isfinite(chosen.share)
    )
    choice = ""
    if found.held_out:
        choice = (
            f"Terms were chosen without the last {in_percent(found.held_out, '.0f')} of each "
            f"recording, from which alone values and intervals are."
        )
    elif again and found.element is None:
        choice = f"Standard errors include the choice; in data drawn again it fell on {again}."
    elif found.chosen or found.element is not None:
        choice = "Intervals take the choice of terms for given."
    return [*filter(None, (f"{'; '.join(widths)}." if widths else "", choice))]


def print_discovery(found: Discovery, model_file: str | None, console: Console) -> None:
    """The sentence, the path, the parameters and the equation."""
    say(console, sentence(found), wrapped=False)
    for table in (path_table(found), rejected_table(found)):
        if table.rows:
            say(console, "")
            say(console, table.caption, style="bold", wrapped=False)
            print_table(in_rich(table), console)
    say(console, "")
    print_table(in_rich(parameter_table(parameters_of(found))), console)
    lines = [*choice_lines(found), "", equation_of(found)]
    if model_file:
        lines.append(f"model: {model_file}, for riecjax identify and simulate")
    say(console, *lines, wrapped=False)


def discovery_page(found: Discovery) -> Page:
    """The page of a discovery."""
    terms, parameters = [path_table(found), rejected_table(found)], parameters_of(found)
    return Page(
        f"What {found.start.name} lacks",
        f"{found.offered} candidates; {equation_of(found)}",
        (
            Section("Terms", tables=terms, charts=("path",)),
            Section("Parameters", choice_lines(found), tables=[parameter_table(parameters)]),
        ),
        Section("Answer", [sentence(found)]),
    )


@view_of.register
def _(found: Discovery) -> View:
    tables = [path_table(found), rejected_table(found), parameter_table(parameters_of(found))]
    return View(sentence(found), tables, [*choice_lines(found), equation_of(found)])


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

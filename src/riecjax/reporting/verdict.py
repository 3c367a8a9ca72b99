"""A verdict in plain data and on a terminal: the answer first, then what to do about it."""

import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from riecjax.assessment.causes import Cause, Step
from riecjax.assessment.verdict import Verdict, percent
from riecjax.reporting.document import Document, ends_of, finite, number
from riecjax.reporting.tables import print_table

MOST_STEPS = 3
"""Things to do next that are told."""
STYLES = {"good": "green", "caution": "yellow", "do not use": "bold red"}
REPLACED = {"--alpha": "--band", "--beta": "--band"}
"""Options that a new one replaces, beside its own kind."""
VALUES = {"--band": 2, "--out": 1, "--json": 0}
"""How many words follow an option that a suggested command leaves out: a folder that holds a
result is not written over."""


def verdict_entries(verdict: Verdict, command: Sequence[str] = ()) -> Document:
    """The part of the document about the verdict.

    **Arguments:** `command`: the arguments of `riecjax` that made the result, which the commands
    of what to do next are made of; none without.
    """
    return {
        "sentence": verdict.sentence,
        "parameters": {
            name: {
                "level": one.level,
                "reason": one.reason,
                "doubt": [finite(end) for end in one.doubt],
                "share": finite(one.share),
            }
            for name, one in verdict.parameters.items()
        },
        "causes": [_cause(cause) for cause in verdict.causes],
        "next": list(_next(verdict.causes, command)),
    }


def _cause(cause: Cause) -> Document:
    return {
        "kind": cause.kind,
        "phrase": cause.phrase,
        "parameters": list(cause.parameters),
        "share": finite(cause.share),
        "codes": list(dict.fromkeys(finding.code for finding in cause.findings)),
    }


def _next(causes: Sequence[Cause], command: Sequence[str]) -> Iterator[Document]:
    """What to do, with a command that does it; what has one comes first, but for what voids all."""
    urgent = {cause.step: cause.voids for cause in reversed(causes) if cause.step is not None}
    steps = sorted(reversed(urgent), key=lambda step: (not urgent[step], not step.options))
    different: dict[object, Step] = {}
    for step in steps:  # two causes may ask for the same
        different.setdefault(step.options or step.words, step)
    for step in [*different.values()][:MOST_STEPS]:
        run = as_typed(_with(command, step.options))
        yield {
            "words": step.words,
            "options": list(step.options),
            "command": run if command and step.options else None,
        }


def as_typed(arguments: Sequence[str]) -> str:
    """`riecjax` with these arguments, as this system's shell takes it."""
    # To cmd.exe a single quote is a letter like others.
    join = subprocess.list2cmdline if sys.platform == "win32" else shlex.join
    return join(["riecjax", *arguments])


def _sum(old: str, new: str) -> str:
    return f"{float(old) + float(new):.6g}"


UPDATED: dict[str, Callable[[str, str], str]] = {
    **dict.fromkeys(("--shift", "--clock", "--unfilter"), _sum),
    "--scale": lambda old, new: f"{float(old) * float(new):.6g}",
    "--unit": lambda old, new: new,
}
"""Options of a signal that may be given once, and what a further one makes of that."""


def _with(command: Sequence[str], options: Sequence[str]) -> list[str]:
    """A command with further options, and without those that they replace."""
    kept, given = [], list(command)
    left_out = {"--json", "--out", *(REPLACED[one] for one in options if one in REPLACED)}
    while given:
        word = given.pop(0)
        option, _, value = word.partition("=")
        if option not in left_out:
            kept += [option, value] if option in UPDATED and value else [word]
        elif not value:
            del given[: VALUES[option]]
    return _merged(kept, options)


def _merged(command: Sequence[str], options: Sequence[str]) -> list[str]:
    """A command with further options; one that it gives a signal already is brought up to date.

    What is found amiss is that of the record as prepared: what is left of a delay adds to what was
    taken off.
    """
    if len(options) % 2:
        return [*command, *options]
    kept, more = list(command), []
    for option, value in zip(options[::2], options[1::2]):
        name, _, new = value.partition("=")
        given = (i for i in range(1, len(kept)) if kept[i - 1] == option in UPDATED)
        old = next((i for i in given if kept[i].partition("=")[0] == name), None)
        if old is None:
            more += [option, value]
        else:
            before = kept[old].partition("=")[2]
            kept[old] = f"{name}={UPDATED[option](before, new)}"
    return [*kept, *more]


def print_verdict(document: Document, console: Console) -> None:
    """Sentence, table, reasons and what to do next."""
    entries = document["verdict"]
    console.print(Text(entries["sentence"], style="bold"))
    console.print()
    print_table(_table(document), console)
    for line in reasons_in_words(entries):
        console.print(line, highlight=False, markup=False)
    for step in entries["next"]:
        console.print()
        ending = ":" if step["command"] else "."
        console.print(f"{step['words']}{ending}", highlight=False, markup=False)
        if step["command"]:
            # Not wrapped: a command is to be pasted.
            console.print(f"  {step['command']}", highlight=False, markup=False, soft_wrap=True)


def _table(document: Document) -> Table:
    """The answer with its doubt and level; standard errors are in the full table."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    for column in ("parameter", "value", "95 % interval", "doubt", "unit", "verdict"):
        right = column in ("value", "95 % interval", "doubt")
        table.add_column(column, justify="right" if right else "left", no_wrap=True)
    for name, entry in document["parameters"].items():
        judged = document["verdict"]["parameters"][name]
        table.add_row(
            Text(name),
            number(entry["value"]),
            "?" if None in entry["interval95"] else " .. ".join(ends_of(entry["interval95"])),
            doubt_in_words(judged["share"]),
            Text(entry["unit"]),
            Text(judged["level"], style=STYLES[judged["level"]]),
        )
    for name, entry in document["known"].items():
        table.add_row(Text(name), number(entry["value"]), "known", "", Text(entry["unit"]), "")
    return table


def doubt_in_words(share: float | None) -> str:
    """A doubt as a share of its value."""
    return "?" if share is None else percent(share)


def reasons_in_words(entries: Document) -> Iterator[str]:
    """Why what is not good is not, parameters with the same reason together."""
    by_reason: dict[str, list[str]] = {}
    for name, judged in entries["parameters"].items():
        if judged["level"] != "good":
            by_reason.setdefault(judged["reason"], []).append(name)
    for reason, names in by_reason.items():
        yield f"{', '.join(names)}: {reason}"

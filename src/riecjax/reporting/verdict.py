"""A verdict in plain data and on a terminal: the answer first, then what to do about it."""

import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence

from rich.console import Console

from riecjax.assessment.verdict import Cause, Step, Verdict
from riecjax.reporting.document import Document, ends_of, told
from riecjax.reporting.estimate import parameter_table
from riecjax.reporting.tables import in_rich, print_table, say

MOST_STEPS = 3
"""Things to do next that are told."""
WithOptions = Callable[[Sequence[str]], Sequence[str]]
"""Arguments of `riecjax`, those that made a result, with further options in their places."""
STYLES = {"good": "green", "caution": "yellow", "do not use": "bold red"}


def verdict_entries(verdict: Verdict, with_options: WithOptions | None = None) -> Document:
    """The part of the document about the verdict.

    **Arguments:** `with_options` makes arguments of `riecjax` that do what to do next; without,
    there is no command for it.
    """
    return {
        "sentence": verdict.sentence,
        "parameters": {
            name: told(judged, "level", "reason", "doubt", "share")
            for name, judged in verdict.parameters.items()
        },
        "causes": [
            {
                **told(cause, "kind", "phrase", "parameters", "share"),
                "codes": list(dict.fromkeys(finding.code for finding in cause.findings)),
            }
            for cause in verdict.causes
        ],
        "next": list(_next(verdict.causes, with_options)),
    }


def _next(causes: Sequence[Cause], with_options: WithOptions | None) -> Iterator[Document]:
    """What to do, with a command that does it; what has one comes first, but for what voids all."""
    urgent = {cause.step: cause.voids for cause in reversed(causes) if cause.step is not None}
    steps = sorted(reversed(urgent), key=lambda step: (not urgent[step], not step.options))
    different: dict[object, Step] = {}
    for step in steps:  # two causes may ask for the same
        different.setdefault(step.options or step.words, step)
    for step in [*different.values()][:MOST_STEPS]:
        proposed = with_options(step.options) if with_options and step.options else None
        yield {
            "words": step.words,
            "options": list(step.options),
            "command": as_typed(proposed) if proposed else None,
        }


def as_typed(arguments: Sequence[str]) -> str:
    """`riecjax` with these arguments, as this system's shell takes it."""
    # To cmd.exe a single quote is a letter like others.
    join = subprocess.list2cmdline if sys.platform == "win32" else shlex.join
    return join(["riecjax", *arguments])


def print_verdict(document: Document, console: Console) -> None:
    """Sentence, table, reasons and what to do next."""
    entries = document["verdict"]
    say(console, entries["sentence"], style="bold")
    say(console, "")
    # The answer with its doubt and level; standard errors are in the full table.
    columns = ("value", "95 % interval", "doubt", "unit", "verdict")
    table = parameter_table(
        document, columns, lambda ends: "?" if None in ends else " .. ".join(ends_of(ends))
    )
    print_table(in_rich(table, columns[:3], STYLES), console)
    say(console, *reasons_in_words(entries))
    for step in entries["next"]:
        say(console, "", f"{step['words']}{':' if step['command'] else '.'}")
        if step["command"]:
            # Not wrapped: a command is to be pasted.
            say(console, f"  {step['command']}", wrapped=False)


def reasons_in_words(entries: Document) -> Iterator[str]:
    """Why what is not good is not, parameters with the same reason together."""
    by_reason: dict[str, list[str]] = {}
    for name, judged in entries["parameters"].items():
        if judged["level"] != "good":
            by_reason.setdefault(judged["reason"], []).append(name)
    for reason, names in by_reason.items():
        yield f"{', '.join(names)}: {reason}"

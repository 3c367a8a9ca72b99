"""A verdict in plain data and on a terminal: the answer first, then what to do about it."""

import operator
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence

from rich.console import Console

from riecjax.assessment.verdict import Cause, Step, Verdict, percent
from riecjax.reporting.document import Document, ends_of, finite, number
from riecjax.reporting.tables import Table, in_rich, print_table, say

MOST_STEPS = 3
"""Things to do next that are told."""
STYLES = {"good": "green", "caution": "yellow", "do not use": "bold red"}
EXCLUDED = {"--alpha": ("--band",), "--beta": ("--band",), "--band": ("--alpha", "--beta")}
"""Options that an option does not go with."""
VALUES = {"--band": 2, "--json": 0}
"""How many words follow an option, where that is not one."""
RESULT = ("--json", "--out")
"""Options that a proposed command leaves out: a folder that holds a result is not written over."""
LISTED = (
    *("--add-mode", "--add-spring", "--unknown-offset", "--unknown-gain", "--per-record"),
    *("--leave-out", "--notch"),
)
"""Options that stand once more for each further value. All others that are proposed stand once, or
once for each signal."""
COMBINED: dict[str, Callable[[float, float], float]] = {
    **dict.fromkeys(("--shift", "--clock", "--unfilter"), operator.add),
    "--scale": operator.mul,
}
"""What a further value of a signal makes of the one given. What is found amiss is that of the
record as prepared: what is left of a delay adds to what was taken off."""


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


def _with(command: Sequence[str], options: Sequence[str]) -> list[str]:
    """A command with further options in place of those that they replace."""
    given, proposed = _grouped(command), _grouped(options)
    excluded = {other for group in proposed for other in EXCLUDED.get(group[0], ())}
    kept = [group for group in given if group[0] not in (*RESULT, *excluded)]
    for option, *values in proposed:
        if option in LISTED:
            kept += [] if [option, *values] in kept else [[option, *values]]
            continue
        name, _, new = values[-1].partition("=")
        places = [
            i
            for i, (word, *held) in enumerate(kept)
            if word == option and (not new or held[-1].partition("=")[0] == name)
        ]
        if places and option in COMBINED:
            before = kept[places[0]][-1].partition("=")[2]
            values = [f"{name}={COMBINED[option](float(before), float(new)):.6g}"]
        kept = [group for i, group in enumerate(kept) if i not in places[1:]]
        if places:
            kept[places[0]] = [option, *values]
        else:
            kept.append([option, *values])
    return [word for group in kept for word in group]


def _grouped(words: Sequence[str]) -> list[list[str]]:
    """Each option with the words that may be its values; other words one by one."""
    groups, left = [], list(words)
    while left:
        option, equals, value = left.pop(0).partition("=")
        if not option.startswith("--"):
            groups.append([f"{option}{equals}{value}"])
            continue
        groups.append([option, *([value] if equals else [])])
        while not equals and left and len(groups[-1]) <= VALUES.get(option, 1):
            if left[0].startswith("--"):
                break
            groups[-1].append(left.pop(0))
    return groups


def print_verdict(document: Document, console: Console) -> None:
    """Sentence, table, reasons and what to do next."""
    entries = document["verdict"]
    say(console, entries["sentence"], style="bold")
    say(console, "")
    # The answer with its doubt and level; standard errors are in the full table.
    rows = []
    for name, entry in document["parameters"].items():
        judged, ends = entries["parameters"][name], entry["interval95"]
        interval = "?" if None in ends else " .. ".join(ends_of(ends))
        doubt = doubt_in_words(judged["share"])
        value = number(entry["value"])
        rows.append((name, value, interval, doubt, entry["unit"], judged["level"]))
    for name, entry in document["known"].items():
        rows.append((name, number(entry["value"]), "known", "", entry["unit"], ""))
    header = ("parameter", "value", "95 % interval", "doubt", "unit", "verdict")
    print_table(in_rich(Table(header, rows), header[1:4], STYLES), console)
    say(console, *reasons_in_words(entries))
    for step in entries["next"]:
        say(console, "", f"{step['words']}{':' if step['command'] else '.'}")
        if step["command"]:
            # Not wrapped: a command is to be pasted.
            say(console, f"  {step['command']}", wrapped=False)


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

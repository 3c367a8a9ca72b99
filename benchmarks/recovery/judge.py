"""What a user gets from a faulty recording, held against what the sound one gives.

Both go through `riecjax identify` in this process: without refinement, which takes the longest and
says nothing of sensors, and without the sweep over window lengths, which asks about the model.
"""

import contextlib
import functools
import io
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from benchmarks.recovery.faults import FAULTS, recorded
from benchmarks.recovery.machines import MACHINES, RATE, SAMPLES, Machine
from riecjax.cli.identify import command
from riecjax.cli.main import run
from riecjax.findings import class_of

OPTIONS = ("--json", "--refine", "none", "--no-sweep")
UNTREATED = {
    "align": ("--align", "none"),
    "outliers": ("--outliers", "keep"),
    "at_rest": ("--at-rest", "keep"),
    "allow_duplicates": ("--allow-duplicates",),
}
"""Options of today that leave a recording as it is, by the parameter of the command."""
MOVED, AT_LEAST = 3.0, 0.005
"""Standard errors, and share of its value, by which a parameter moves that a fault harms."""
NARROWER = 0.9
"""Share of the sound recording's standard error below which a fault feigns knowledge."""
FAR = 1e9
"""Standard errors that stand for any more, and for what is not a number."""


class Finding(NamedTuple):
    """What the command says of a recording, as far as it is compared."""

    code: str
    signals: tuple[str, ...]
    parameters: tuple[str, ...]
    remedy: tuple[str, ...]
    message: str


class Answer(NamedTuple):
    """Of one call: each parameter's value and standard error, and what was found.

    **Fields:** `error`: of a call without an answer, its code and message.
    """

    values: dict[str, float]
    errors: dict[str, float]
    findings: tuple[Finding, ...]
    error: str = ""


class Outcome(NamedTuple):
    """A fault of a machine's recording, and what became of it.

    **Fields:** `moved`, by how many of the sound recording's standard errors the answer moves at
    the most where nothing is corrected, and `which` parameter; `harmed`, whether that counts, or
    intervals are too narrow; `said`, codes that the sound recording does not lead to; `after`, as
    `moved`, of the answer with what the command corrects by itself and what it proposes
    (`remedy`), or `None` where there is neither.
    """

    fault: str
    machine: str
    severity: str
    seed: int
    moved: float
    which: str
    harmed: bool
    said: tuple[str, ...]
    detected: bool
    named: bool
    refused: str
    remedy: tuple[str, ...]
    after: float | None


def written(parts: Iterable[tuple[float, dict[str, np.ndarray]]], folder: Path) -> list[str]:
    """Recordings as text files; a missing sample is an empty cell."""
    files = []
    for number, (start, rows) in enumerate(parts):
        file = folder / f"recording_{number}.csv"
        count = len(next(iter(rows.values())))
        columns = [start + np.arange(count) / RATE, *rows.values()]
        lines = [",".join(f"{v:.9g}" for v in row) for row in zip(*columns)]
        text = "\n".join([",".join(["t", *rows]), *lines]) + "\n"
        file.write_text(text.replace("nan", ""))
        files.append(str(file))
    return files


def answered(machine: Machine, files: Sequence[str], options: Sequence[str] = ()) -> Answer:
    """What `riecjax identify` says."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = run(["identify", *files, "--model", machine.model, *OPTIONS, *options])
    if status == 1:
        error = json.loads(out.getvalue())["error"]
        return Answer({}, {}, (), f"{error['code']}: {error['message']}")
    if status:
        return Answer({}, {}, (), f"usage: {err.getvalue()}")
    document = json.loads(out.getvalue())
    found = document["parameters"]
    said = [
        Finding(
            w["code"],
            tuple(w["signals"]),
            tuple(w["parameters"]),
            tuple(w.get("remedy", ())),
            w["message"],
        )
        for w in document["warnings"]
    ]
    values = {name: _number(p["value"]) for name, p in found.items()}
    return Answer(values, {n: _number(p["std_error"]) for n, p in found.items()}, tuple(said))


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


@functools.cache
def _untreated() -> tuple[str, ...]:
    known = {parameter.name for parameter in command.params if isinstance(parameter, click.Option)}
    return tuple(word for name, words in UNTREATED.items() if name in known for word in words)


def distance(answer: Answer, sound: Answer) -> tuple[float, str, bool]:
    """By how many standard errors of the sound recording an answer differs, where, whether it
    counts.
    """
    far = {}
    for name, value in sound.values.items():
        moved = abs(answer.values.get(name, np.nan) - value)
        counts = not moved <= max(MOVED * sound.errors[name], AT_LEAST * abs(value))
        far[name] = (counts, float(min(np.nan_to_num(moved / sound.errors[name], nan=FAR), FAR)))
    which = max(far, key=lambda name: far[name])
    return far[which][1], which, far[which][0]


def judged(
    fault: str, machine: Machine, severity: str, seed: int, noise: float, folder: Path
) -> tuple[Outcome, Answer]:
    """A faulty recording beside the sound one of the same motion and noise."""
    sound = sound_answer(machine.name, seed, noise, folder, machine.samples)
    files = written(recorded(machine, fault, severity, seed, noise), folder)
    answer = answered(machine, files)
    known = {(f.code, f.signals) for f in sound.findings}
    new = [f for f in answer.findings if (f.code, f.signals) not in known and counts(f.code)]
    treated = bool(new or answer.error) and bool(_untreated())
    plain = answered(machine, files, _untreated()) if treated else answer
    moved, which, harmed = (0.0, "", True) if plain.error else distance(plain, sound)
    harmed |= any(plain.errors.get(n, 0.0) < NARROWER * e for n, e in sound.errors.items())
    kind = FAULTS[fault]
    signal = getattr(machine, kind.on) if kind.on else ""
    of_kind = [f for f in new if f.code in kind.codes]
    naming = [f for f in of_kind if not (signal and f.signals) or signal in f.signals]
    remedy = next((f.remedy for f in (*naming, *new) if f.remedy), ())
    last = answered(machine, files, remedy) if remedy else answer
    corrected = bool(remedy) or (plain != answer and not answer.error)
    after = None if last.error or not corrected else distance(last, sound)[0]
    refusal = any(re.search(rf"\b{code}\b", answer.error) for code in kind.codes)
    outcome = Outcome(
        fault,
        machine.name,
        severity,
        seed,
        moved,
        which,
        harmed,
        tuple(dict.fromkeys(f.code for f in new)),
        bool(new or answer.error),
        bool(naming) or refusal,
        answer.error,
        remedy,
        after,
    )
    return outcome, answer


HELD, RESTING = 6, 0.005
"""Samples for which friction holds a machine at the least, and share of all that is rest."""


def counts(code: str) -> bool:
    """Whether a finding speaks of sensors, the model or noise, and not of amount or computing."""
    return class_of(code).kind not in ("data", "computation")


def rests(name: str, seed: int, noise: float, samples: int = SAMPLES) -> bool:
    """Whether a machine rests for more than `RESTING` of the time: its velocity, without noise, is
    smaller than noise of this share, in stretches of `HELD` samples at the least."""
    rows = recorded(MACHINES[name]._replace(samples=samples), None, "", seed, 0.0)[0][1]
    velocity = rows[MACHINES[name].velocity]
    size = noise * float(np.std(velocity))
    still = np.concatenate([[False], np.abs(velocity) < size, [False]])
    ends = np.flatnonzero(np.diff(still.astype(np.int8))).reshape(-1, 2)
    held = np.diff(ends)
    return bool(held[held >= HELD].sum() > RESTING * velocity.size)


@functools.lru_cache(maxsize=256)
def sound_answer(
    name: str, seed: int, noise: float, folder: Path, samples: int = SAMPLES
) -> Answer:
    """Of the recording without a fault."""
    machine = MACHINES[name]._replace(samples=samples)
    files = written(recorded(machine, None, "", seed, noise), folder)
    answer = answered(machine, files)
    if answer.error:
        raise RuntimeError(f"{name}, seed {seed}: the sound recording is refused: {answer.error}")
    return answer

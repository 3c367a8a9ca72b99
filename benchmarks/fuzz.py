"""Damaged recordings through the whole command line: a right answer, a warning, or one line.

    python -m benchmarks.fuzz [--cases 1000] [--seed 0] [--quick] [--only MUTATION] [--keep DIR]

A wrong number without a warning is the one thing that must not come out.
"""

import argparse
import contextlib
import io
import json
import os
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.mutations import NAMES, TRUTH, Case, mutated, rigs
from riecjax.cli.main import run

CLOSE = 0.05
"""Share of a parameter that an answer may be off: what one machine differs from the next of its
kind. The sound recording is answered within a tenth of that."""
STANDARD_ERRORS = 5.0
"""The same in standard errors as stated: with 20 blocks of time, once in 10,000 answers."""
SLOWEST = 30.0
"""Seconds that a case may take. The slowest compile some ten stages anew."""
QUICK = ("--no-sweep", "--windows", "500")


class Outcome(NamedTuple):
    """`verdict` is refused, warned, right, or WRONG, in which case `why` says in which way."""

    verdict: str
    why: str
    seconds: float


def outcome(case: Case, options: tuple[str, ...] = ()) -> Outcome:
    """Identify from a case's file, written to the working folder, and judge what comes out."""
    Path(case.file).write_bytes(case.content)
    out, err = io.StringIO(), io.StringIO()
    began = time.perf_counter()
    try:
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("error")
            status = run(["identify", case.file, *case.options, *options])
    except Exception:
        lines = traceback.format_exc().strip().splitlines()
        return Outcome("WRONG", f"traceback: {lines[-1]} {lines[-3]}", time.perf_counter() - began)
    seconds = time.perf_counter() - began
    return Outcome(*judged(status, out.getvalue(), err.getvalue()), seconds)


def judged(status: int, out: str, err: str) -> tuple[str, str]:
    """The verdict on what a call printed, and what it is based on."""
    said = [line for line in err.splitlines() if not line.startswith("warning [")]
    if status in (1, 2):
        if not _one_line(status, out, said):
            return "WRONG", f"status {status}, but printed: {out[:200]!r} {err[:500]!r}"
        return "refused", said[0]
    if status != 0 or said:
        return "WRONG", f"status {status}: {err[:500]!r}"
    document = json.loads(out, parse_constant=_refuse)
    if document["warnings"]:
        return "warned", ", ".join(sorted({w["code"] for w in document["warnings"]}))
    off = [_off(name, document["parameters"][name]) for name in TRUTH]
    return ("WRONG", "; ".join(filter(None, off))) if any(off) else ("right", "")


def _one_line(status: int, out: str, said: list[str]) -> bool:
    """Whether a refusal is one line, and with status 1 the same in one JSON document."""
    if len(said) != 1 or not said[0].startswith("riecjax: "):
        return False
    if status == 2:
        return not out
    with contextlib.suppress(json.JSONDecodeError, KeyError, TypeError):
        document = json.loads(out, parse_constant=_refuse)
        return (
            f"riecjax: {document['error']['message']}" == said[0] and "parameters" not in document
        )
    return False


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no JSON")


def _off(name: str, found: dict[str, Any]) -> str:
    """In words, a parameter that is further off than it may be."""
    far = abs(found["value"] - TRUTH[name])
    if far <= max(CLOSE * abs(TRUTH[name]), STANDARD_ERRORS * (found["std_error"] or 0.0)):
        return ""
    return f"{name} = {found['value']:.5g} +- {found['std_error']:.2g}, not {TRUTH[name]:g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help=f"with {' '.join(QUICK)}")
    parser.add_argument("--only", action="append", choices=NAMES, metavar="MUTATION")
    parser.add_argument("--keep", type=Path, help="where files with wrong outcomes are kept")
    parser.add_argument("--verbose", action="store_true", help="print what each case led to")
    arguments = parser.parse_args()
    names = arguments.only or NAMES
    machines = rigs()
    counts: dict[str, Counter[str]] = {name: Counter() for name in names}
    slowest: dict[str, float] = dict.fromkeys(names, 0.0)
    wrong: list[str] = []
    keep = arguments.keep.absolute() if arguments.keep else None
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for number in range(arguments.cases):
            name = names[number % len(names)]
            case = mutated(name, machines, np.random.default_rng([arguments.seed, number]))
            found = outcome(case, QUICK if arguments.quick else ())
            if found.seconds > SLOWEST:
                found = found._replace(verdict="WRONG", why=f"took {found.seconds:.0f} s")
            counts[name][found.verdict] += 1
            slowest[name] = max(slowest[name], found.seconds)
            line = f"{number:5} {name} {case.file} {found.verdict} {found.why}"
            if arguments.verbose:
                print(f"{line} ({found.seconds:.1f} s)", flush=True)
            if found.verdict == "WRONG":
                wrong.append(line)
                if keep:
                    keep.mkdir(parents=True, exist_ok=True)
                    os.replace(case.file, keep / f"{number}{Path(case.file).suffix}")
    _print(counts, slowest)
    print(*wrong, sep="\n")


def _print(counts: dict[str, Counter[str]], slowest: dict[str, float]) -> None:
    verdicts = ("refused", "warned", "right", "WRONG")
    print(f"{'mutation':<20} {'cases':>6} " + " ".join(f"{v:>8}" for v in verdicts) + "  slowest")
    for name, count in sorted(counts.items()):
        numbers = " ".join(f"{count[verdict]:8}" for verdict in verdicts)
        print(f"{name:<20} {count.total():6} {numbers} {slowest[name]:7.1f} s")
    total = sum(counts.values(), Counter())
    numbers = " ".join(f"{total[verdict]:8}" for verdict in verdicts)
    print(f"{'all':<20} {total.total():6} {numbers} {max(slowest.values()):7.1f} s")


if __name__ == "__main__":
    main()

"""Damaged recordings through the readers and the command line: an answer, a warning, or one line.

    python -m benchmarks.robustness [--reading 100000] [--identify 10000] [--seed 0] [--quick]
        [--only MUTATION] [--keep DIR] [--verbose]

A traceback, a raw warning, a hang, 2 GB of memory or a wrong number without a word must not come
out. Each case is drawn from the seed and
its number, so that one can be run again alone.
"""

import argparse
import contextlib
import functools
import io
import json
import logging
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.robustness.formats import ALL_WRITERS, SLOW
from benchmarks.robustness.mutations import NAMES, TRUTH, Case, mutated, rigs
from benchmarks.robustness.watched import Watched
from riecjax.cli.main import run
from riecjax.doubts.reading import read_recordings
from riecjax.errors import RiecjaxError, printable

CLOSE = 0.05
"""Share of a parameter that an answer may be off: what one machine differs from the next of its
kind. The sound recording is answered within a tenth of that."""
STANDARD_ERRORS = 5.0
"""The same in standard errors as stated: with 20 blocks of time, once in 10,000 answers."""
SLOWEST = {"reading": 10.0, "identify": 60.0}
"""Seconds of the processor that a case may take. The slowest compile some ten stages anew."""
PATIENCE = 120.0
"""Seconds of the processor that a process may use before it counts as hanging."""
LARGEST = 2e9
"""Bytes that a case may take."""
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


def read_outcome(case: Case) -> Outcome:
    """Read a case's file, written to the working folder, and judge what comes out."""
    Path(case.file).write_bytes(case.content)
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = read_recordings(case.file)
    except (RiecjaxError, MemoryError) as error:
        said = str(error)
        in_order = said.isprintable() and "took longer" not in said
        verdict = "refused" if in_order else "WRONG"
        return Outcome(verdict, said[:500], time.perf_counter() - began)
    except Exception:
        lines = traceback.format_exc().strip().splitlines()
        return Outcome("WRONG", f"traceback: {lines[-1]} {lines[-3]}", time.perf_counter() - began)
    seconds = time.perf_counter() - began
    for one in found:
        record = one.record
        for name, values in {**record.arrays, "time": record.time}.items():
            if not np.isfinite(np.asarray(values)).all():
                return Outcome("WRONG", f"{name!r} is not finite", seconds)
        said = [one.name, *record.arrays, *one.steps, *(f.message for f in one.findings)]
        if bad := [each for each in said if printable(each) != each]:
            return Outcome("WRONG", f"not printable: {bad[0]!r}", seconds)
    codes = sorted({f.code for one in found for f in one.findings})
    return Outcome("warned" if codes else "right", ", ".join(codes), seconds)


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
    off = []
    for name, truth in TRUTH.items():
        value, error = (document["parameters"][name][key] for key in ("value", "std_error"))
        if abs(value - truth) > max(CLOSE * abs(truth), STANDARD_ERRORS * (error or 0.0)):
            off.append(f"{name} = {value:.5g} +- {error:.2g}, not {truth:g}")
    return ("WRONG", "; ".join(off)) if off else ("right", "")


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


class Fuzzed(NamedTuple):
    """A case by its number, and what it led to."""

    number: int
    case: Case
    outcome: Outcome
    memory: float


def run_case(kind: str, seed: int, number: int, names: list[str], quick: bool) -> tuple[Case, Any]:
    """Case `number` of a kind, made and judged in this process, in a folder of its own."""
    name = names[number % len(names)]
    rng = np.random.default_rng([seed, number])
    formats = [file for file in ALL_WRITERS if file not in SLOW or rng.random() < 0.1]
    # What making a case says, as of a text that a format refuses, is not what reading it says.
    logging.disable()
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        case = mutated(name, rigs(), rng, formats)
    logging.disable(logging.NOTSET)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        if kind == "reading":
            return case, read_outcome(case)
        return case, outcome(case, QUICK if quick else ())


def fuzzed(
    kind: str,
    numbers: Iterable[int],
    seed: int = 0,
    names: Iterable[str] = NAMES,
    quick: bool = False,
) -> Iterator[Fuzzed]:
    """Cases of `reading` or `identify`, each judged as it comes back from a watched process."""
    names = list(names)
    with Watched(run_case, PATIENCE) as watched:
        for number in numbers:
            ran = watched(kind, seed, number, names, quick)
            if ran.result is None:
                case = Case(names[number % len(names)], "?", b"", ())
                yield Fuzzed(number, case, Outcome("WRONG", ran.ended, 0.0), 0.0)
                continue
            case, found = ran.result
            found = found._replace(seconds=ran.seconds)
            for much, why in (
                (ran.printed, f"printed {ran.printed[:300]!r}"),
                (ran.seconds > SLOWEST[kind], f"took {ran.seconds:.0f} s"),
                (ran.memory > LARGEST, f"took {ran.memory / 1e9:.1f} GB"),
            ):
                if much and found.verdict != "WRONG":
                    found = found._replace(verdict="WRONG", why=why)
            yield Fuzzed(number, case, found, ran.memory)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--reading", type=int, default=100_000, help="cases that are only read")
    parser.add_argument("--identify", type=int, default=10_000, help="cases through identify")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help=f"with {' '.join(QUICK)}")
    parser.add_argument("--only", action="append", choices=NAMES, metavar="MUTATION")
    parser.add_argument("--keep", type=Path, help="where files with wrong outcomes are kept")
    parser.add_argument("--verbose", action="store_true", help="print what each case led to")
    arguments = parser.parse_args()
    tell = functools.partial(print, flush=True)
    for kind in ("reading", "identify"):
        numbers = range(arguments.first, arguments.first + getattr(arguments, kind))
        if numbers:
            names = arguments.only or NAMES
            cases = fuzzed(kind, numbers, arguments.seed, names, arguments.quick)
            _report(kind, cases, arguments.keep, tell if arguments.verbose else None)


def _report(
    kind: str, cases: Iterable[Fuzzed], keep: Path | None, tell: Callable[[str], None] | None
) -> None:
    """Count what came out, keep what was wrong, and print both."""
    counts: dict[str, Counter[str]] = {}
    slowest: dict[str, float] = {}
    wrong, memory, began = [], 0.0, time.perf_counter()
    for number, case, found, held in cases:
        name = case.mutation
        counts.setdefault(name, Counter())[found.verdict] += 1
        slowest[name] = max(slowest.get(name, 0.0), found.seconds)
        memory = max(memory, held)
        line = f"{number:5} {name} {case.file} {found.verdict} {found.why}"
        if tell:
            tell(f"{line} ({found.seconds:.1f} s)")
        if found.verdict == "WRONG":
            wrong.append(line)
            if keep:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"{number}{Path(case.file).suffix}").write_bytes(case.content)
    print(f"\n{kind}: {time.perf_counter() - began:.0f} s, {memory / 1e9:.2f} GB at the peak")
    verdicts = ("refused", "warned", "right", "WRONG")
    print(f"{'mutation':<20} {'cases':>6} " + " ".join(f"{v:>8}" for v in verdicts) + "  slowest")
    every = (sum(counts.values(), Counter()), max(slowest.values()))
    for name, (count, most) in [*((n, (counts[n], slowest[n])) for n in counts), ("all", every)]:
        numbers = " ".join(f"{count[verdict]:8}" for verdict in verdicts)
        print(f"{name:<20} {count.total():6} {numbers} {most:7.1f} s")
    print(*wrong, sep="\n", flush=True)

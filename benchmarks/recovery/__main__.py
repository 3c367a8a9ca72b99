"""Faulty recordings of known machines through `riecjax identify`: `python -m benchmarks.recovery`.

    python -m benchmarks.recovery [--only FAULT ...] [--models car drag axis pendulum dry]
        [--severities mild middle severe] [--seeds N] [--clean N] [--json FILE] [--verbose]
    python -m benchmarks.recovery --page

A fault harms where it moves a parameter by more than three standard errors and half a percent from
what the sound recording of the same motion and noise gives, or narrows an interval by a tenth.
With `--json` results are kept, beside those of other faults and machines that the file holds
already; `--page` writes the table of docs/warnings.md from benchmarks/faults.json.
"""

import argparse
import json
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import scipy.stats

from benchmarks.recorded import FOLDER, filled_in, write_json
from benchmarks.recovery.faults import FAULTS, SEVERITIES
from benchmarks.recovery.machines import MACHINES
from riecjax.runtime import start_jax

NOISE = 0.01
CLEAN_SEEDS = 1000
"""Seeds of clean recordings begin here."""
CURED = 3.0
"""Standard errors within which an answer is right after the remedy."""

PAGE = FOLDER.parent / "docs" / "warnings.md"
BEGIN = "<!-- measured: python -m benchmarks.recovery -->"

Cells = list[dict[str, Any]]


def line(cell: dict[str, Any]) -> str:
    """One case in a line."""
    after = "" if cell["after"] is None else f" after {cell['after']:.3g}"
    said = ", ".join(cell["said"]) or cell["refused"][:90] or "nothing"
    verdict = "named" if cell["named"] else "detected" if cell["detected"] else "MISSED"
    verdict = f"{verdict if cell['harmed'] or cell['detected'] else 'unseen'}{after}"
    harm = f"{cell['which']} {cell['moved']:.3g} se" + ("" if cell["harmed"] else ", no harm")
    head = f"{cell['machine']:<9} {cell['fault']:<24} {cell['severity']:<7} {cell['seed']:<3}"
    return f"{head} {harm:<26} {verdict:<22} {said} {' '.join(cell['remedy'])}"


def shares(cells: Iterable[dict[str, Any]]) -> tuple[str, str, str, str]:
    """Of some cases: how many are harmed, and of these detected, named, and right afterwards."""
    some = list(cells)
    harmed = [cell for cell in some if cell["harmed"]]
    treated = [cell for cell in harmed if cell["after"] is not None]
    cured = sum(cell["after"] <= CURED for cell in treated)
    found = [sum(cell[what] for cell in harmed) for what in ("detected", "named")]
    parts = (*found, cured)
    of = (len(harmed), len(harmed), len(treated))
    told = [f"{n} of {m}" if m else "-" for n, m in zip(parts, of)]
    return (f"{len(harmed)} of {len(some)}", told[0], told[1], told[2])


def false_alarms(codes: Sequence[Sequence[str]]) -> dict[str, Any]:
    """Share of sound recordings with each code, and its Wilson interval."""
    counts = Counter(code for found in codes for code in set(found))
    found: dict[str, Any] = {"recordings": len(codes), "codes": {}}
    for code, count in counts.most_common():
        interval = scipy.stats.binomtest(count, len(codes)).proportion_ci(method="wilson")
        found["codes"][code] = {"count": count, "low": interval.low, "high": interval.high}
    return found


def page() -> str:
    """docs/warnings.md with the tables of what is recorded."""
    return filled_in(PAGE, BEGIN, tables(json.loads((FOLDER / "faults.json").read_text())))


def tables(document: dict[str, Any]) -> str:
    """In Markdown: of each fault, and of codes that sound recordings lead to."""
    cells = document["cases"]
    rows = ["| fault | harmed | of these detected | named | right after |", "|---|---|---|---|---|"]
    for fault in [name for name in FAULTS if any(cell["fault"] == name for cell in cells)]:
        told = shares(cell for cell in cells if cell["fault"] == fault)
        rows.append(f"| {' | '.join((fault, *told))} |")
    rows.append(f"| {' | '.join(('all', *shares(cells)))} |")
    alarms = document["clean"]
    if alarms is None:
        return "\n".join(rows)
    every = alarms["recordings"]
    told = [
        f"`{code}` {one['count']} ({100 * one['low']:.2g} to {100 * one['high']:.2g} %)"
        for code, one in alarms["codes"].items()
    ]
    return "\n".join(rows) + f"\n\nOn {every} sound recordings: {', '.join(told) or 'nothing'}."


def cases(arguments: argparse.Namespace, folder: Path) -> Iterable[dict[str, Any]]:
    """All that is asked for, machine by machine: each compiles its own programs."""
    from benchmarks.recovery.judge import judged

    for name in arguments.models:
        # What the one before has compiled serves no other, and memory maps are few.
        jax.clear_caches()
        machine = MACHINES[name]
        for fault in arguments.only or FAULTS:
            if FAULTS[fault].machines and name not in FAULTS[fault].machines:
                continue
            for severity in FAULTS[fault].severities():
                for seed in range(arguments.seeds if severity in arguments.severities else 0):
                    began = time.perf_counter()
                    outcome, answer = judged(fault, machine, severity, seed, NOISE, folder)
                    cell = outcome._asdict()
                    seconds = f"({time.perf_counter() - began:.1f} s)"
                    print(line(cell), seconds if arguments.verbose else "", flush=True)
                    for finding in answer.findings if arguments.verbose else ():
                        print(f"    {finding.code}: {finding.message}")
                    yield cell


def clean(arguments: argparse.Namespace, folder: Path) -> list[tuple[str, ...]]:
    """Codes of findings on sound recordings, of the machines in turn."""
    from benchmarks.recovery.judge import counts, rests, sound_answer

    found = []
    for name in arguments.models:
        jax.clear_caches()
        for seed in range(arguments.models.index(name), arguments.clean, len(arguments.models)):
            answer = sound_answer(name, CLEAN_SEEDS + seed, NOISE, folder)
            codes = tuple(f.code for f in answer.findings if counts(f.code))
            if "at_rest" in codes and rests(name, CLEAN_SEEDS + seed, NOISE):
                codes = tuple(code for code in codes if code != "at_rest")  # it is
            if codes:
                print(f"{name:<9} sound, seed {CLEAN_SEEDS + seed}: {', '.join(codes)}", flush=True)
            for finding in answer.findings if arguments.verbose else ():
                print(f"    {finding.code}: {finding.message}")
            found.append(codes)
    return found


def kept(file: Path | None, cells: Cells, alarms: dict[str, Any] | None) -> dict[str, Any]:
    """The document with these results, and those of other cases that the file holds."""
    document: dict[str, Any] = {"cases": [], "clean": None}
    if file is not None and file.exists():
        document = json.loads(file.read_text())
    keys = ("fault", "machine", "severity", "seed")
    done = {tuple(cell[key] for key in keys) for cell in cells}
    others = [c for c in document["cases"] if tuple(c[key] for key in keys) not in done]
    return {"cases": [*others, *cells], "clean": alarms or document["clean"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="FAULT", choices=FAULTS)
    parser.add_argument("--models", nargs="+", choices=MACHINES, default=list(MACHINES))
    parser.add_argument("--severities", nargs="+", choices=SEVERITIES, default=SEVERITIES)
    parser.add_argument("--seeds", type=int, default=1, help="of motion and noise, for each case")
    parser.add_argument("--clean", type=int, default=0, help="sound recordings beside them")
    parser.add_argument("--json", type=Path, help="where results are kept")
    parser.add_argument("--verbose", action="store_true", help="print every finding")
    parser.add_argument("--page", action="store_true", help="write the documentation's table")
    arguments = parser.parse_args()
    if arguments.page:
        PAGE.write_text(page(), encoding="utf-8")
        return
    start_jax(keep_compiled=True)
    with tempfile.TemporaryDirectory() as folder:
        cells: Cells = []
        for cell in cases(arguments, Path(folder)):
            cells.append(cell)
            if arguments.json:
                write_json(arguments.json, kept(arguments.json, [cell], None))
        alarms = false_alarms(clean(arguments, Path(folder))) if arguments.clean else None
    if arguments.json:
        write_json(arguments.json, kept(arguments.json, cells, alarms))
    print(tables({"cases": cells, "clean": alarms}))


if __name__ == "__main__":
    main()

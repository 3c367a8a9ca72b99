"""Faulty recordings of known machines through `riecjax identify`: `python -m benchmarks.recovery`.

    python -m benchmarks.recovery [--only FAULT ...] [--models car drag axis pendulum dry]
        [--severities mild middle severe] [--seeds N] [--clean N] [--blocks N ...]
        [--json FILE] [--verbose]
    python -m benchmarks.recovery --page

A fault harms where it moves a parameter by more than three standard errors and half a percent from
what the sound recording of the same motion and noise gives, or narrows an interval by a tenth.
With `--blocks` recordings last so many blocks of twice the longest window, in turn, which shows how
long one must be for what is told of it; the faults are those of `OF_EQUATIONS` unless some are
named. In minutes: `--blocks 4 8 15 30 60 --severities middle --clean 50`.

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

from benchmarks.recorded import FOLDER, filled_in, table, write_json
from benchmarks.recovery.faults import FAULTS, SEVERITIES
from benchmarks.recovery.machines import MACHINES, Machine
from riecjax.runtime import start_jax

NOISE = 0.01
CLEAN_SEEDS = 1000
"""Seeds of clean recordings begin here."""
OF_EQUATIONS = (
    "late force",
    "low-passed force",
    "zero of force",
    "drift of force",
    "clock of force",
    "gain of velocity",
)
"""Faults that only what equations leave can tell of, and one that two sensors tell of."""
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
    document = json.loads((FOLDER / "faults.json").read_text())
    lengths = f"\n\n{by_blocks(document['blocks'])}" if "blocks" in document else ""
    return filled_in(PAGE, BEGIN, tables(document) + lengths)


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


def by_blocks(results: dict[str, dict[str, Any]]) -> str:
    """In Markdown: by blocks that recordings last, what is told of faults and of no fault."""
    head = ("blocks", "harmed", "of these detected", "named", "right after", "said of sound ones")
    rows = []
    for blocks, document in results.items():
        alarms = document["clean"] or {"recordings": 0, "codes": {}}
        told = ", ".join(f"`{code}` {one['count']}" for code, one in alarms["codes"].items())
        of = f"{told or 'nothing'} of {alarms['recordings']}" if document["clean"] else "-"
        rows.append((blocks, *shares(document["cases"]), of))
    return table(head, rows)


def of_length(name: str, blocks: int | None) -> Machine:
    return MACHINES[name] if blocks is None else MACHINES[name].lasting(blocks)


def cases(
    arguments: argparse.Namespace, folder: Path, blocks: int | None
) -> Iterable[dict[str, Any]]:
    """All that is asked for, machine by machine: each compiles its own programs."""
    from benchmarks.recovery.judge import judged

    for name in arguments.models:
        # What the one before has compiled serves no other, and memory maps are few.
        jax.clear_caches()
        machine = of_length(name, blocks)
        for fault in arguments.only or (FAULTS if blocks is None else OF_EQUATIONS):
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


def clean(arguments: argparse.Namespace, folder: Path, blocks: int | None) -> list[tuple[str, ...]]:
    """Codes of findings on sound recordings, of the machines in turn."""
    from benchmarks.recovery.judge import counts, rests, sound_answer

    found = []
    for name in arguments.models:
        jax.clear_caches()
        length = of_length(name, blocks).samples
        for seed in range(arguments.models.index(name), arguments.clean, len(arguments.models)):
            answer = sound_answer(name, CLEAN_SEEDS + seed, NOISE, folder, length)
            codes = tuple(f.code for f in answer.findings if counts(f.code))
            if "at_rest" in codes and rests(name, CLEAN_SEEDS + seed, NOISE, length):
                codes = tuple(code for code in codes if code != "at_rest")  # it is
            if codes:
                print(f"{name:<9} sound, seed {CLEAN_SEEDS + seed}: {', '.join(codes)}", flush=True)
            for finding in answer.findings if arguments.verbose else ():
                print(f"    {finding.code}: {finding.message}")
            found.append(codes)
    return found


def keep(
    file: Path | None, blocks: int | None, cells: Cells, alarms: dict[str, Any] | None
) -> None:
    """Write these results, beside those of other cases and lengths that the file holds."""
    if file is None:
        return
    whole: dict[str, Any] = json.loads(file.read_text()) if file.exists() else {}
    empty: dict[str, Any] = {"cases": [], "clean": None}
    whole = empty | whole
    document = whole
    if blocks is not None:
        document = whole.setdefault("blocks", {}).setdefault(str(blocks), empty)
    keys = ("fault", "machine", "severity", "seed")
    done = {tuple(cell[key] for key in keys) for cell in cells}
    others = [c for c in document["cases"] if tuple(c[key] for key in keys) not in done]
    document |= {"cases": [*others, *cells], "clean": alarms or document["clean"]}
    write_json(file, whole)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="FAULT", choices=FAULTS)
    parser.add_argument("--models", nargs="+", choices=MACHINES, default=list(MACHINES))
    parser.add_argument("--severities", nargs="+", choices=SEVERITIES, default=SEVERITIES)
    parser.add_argument("--seeds", type=int, default=1, help="of motion and noise, for each case")
    parser.add_argument("--clean", type=int, default=0, help="sound recordings beside them")
    parser.add_argument("--blocks", nargs="+", type=int, default=[None], help="of recordings")
    parser.add_argument("--json", type=Path, help="where results are kept")
    parser.add_argument("--verbose", action="store_true", help="print every finding")
    parser.add_argument("--page", action="store_true", help="write the documentation's table")
    arguments = parser.parse_args()
    if arguments.page:
        PAGE.write_text(page(), encoding="utf-8")
        return
    start_jax(keep_compiled=True)
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        for blocks in arguments.blocks:
            cells: Cells = []
            for cell in cases(arguments, Path(folder), blocks):
                cells.append(cell)
                keep(arguments.json, blocks, [cell], None)
            found = clean(arguments, Path(folder), blocks) if arguments.clean else None
            alarms = None if found is None else false_alarms(found)
            keep(arguments.json, blocks, [], alarms)
            results[str(blocks)] = {"cases": cells, "clean": alarms}
            print(tables(results[str(blocks)]), flush=True)
    if arguments.blocks != [None]:
        print(by_blocks(results))


if __name__ == "__main__":
    main()

"""A fleet of recordings: speed, memory, discoveries, what breaks, tasks that do nothing.

    python -m benchmarks.fleet [--recordings 10000] [--folder DIR] [--kills 50] [--samples 10000000]
        [--only speed discoveries breaks tasks one_pass long soak scaling] [--json FILE]
    python -m benchmarks.fleet --page

Twenty groups, two of which have dampers that are worn by 15 %, and one file in a hundred cut off.
Results are kept beside those of other parts that the file holds; `--page` writes docs/scale.md.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from tests.machines import DRAG_TRUTH, drag_fleet

from benchmarks.fleet.breaks import breaks
from benchmarks.fleet.commands import MODEL, command, run
from benchmarks.fleet.weeks import long, one_pass
from benchmarks.recorded import FOLDER, filled_in, write_json
from riecjax.fleets.engine import SETTINGS, cores
from riecjax.fleets.order import TOGETHER
from riecjax.records.writing import write_record
from riecjax.runtime import start_jax

GROUPS, WORN = 20, (4, 11)
COMPARED = 300
"""Recordings that `identify` is timed on."""
REPETITIONS = 100
PAGE = FOLDER.parent / "docs" / "scale.md"
BEGIN = "<!-- measured: python -m benchmarks.fleet -->"
LENGTHS, WEAR, BROKEN = (4000, 8000, 12000), 0.15, 0.01
SIDE_BY_SIDE = 500
"""Drives that are simulated at once."""


def write_fleet(folder: Path, recordings: int) -> None:
    """Folders `vehicle=00`, ... with recordings of these lengths in turn, as Parquet."""
    shutil.rmtree(folder, ignore_errors=True)
    rng = np.random.default_rng([0, 1])
    for group in range(GROUPS):
        place = folder / f"vehicle={group:02}"
        place.mkdir(parents=True)
        kept = (1 - WEAR) if group in WORN else 1.0
        damping = {name: kept * DRAG_TRUTH[name] for name in ("r", "r2")}
        count, number = recordings // GROUPS, 0
        for length in LENGTHS:
            wanted = count // 3 + (length == LENGTHS[0]) * (count % 3)
            for first in range(0, wanted, SIDE_BY_SIDE):
                some = min(SIDE_BY_SIDE, wanted - first)
                for record in drag_fleet(some, length, 1000 * group + number, **damping):
                    file = place / f"{number:05}.parquet"
                    write_record(file, record)
                    if rng.random() < BROKEN:
                        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
                    number += 1


def identified(folder: Path) -> float:
    """Seconds to read and identify a recording, one call after the other."""
    import riecjax as rx

    start_jax(keep_compiled=True)
    model = rx.find_model(MODEL)
    files = sorted(folder.rglob("*.parquet"))
    some = files[:: max(len(files) // COMPARED, 1)]

    def each() -> int:
        done = 0
        for file in some:
            try:
                rx.identify(model, rx.read_recording(file, model=model))
                done += 1
            except rx.DataError:
                continue
        return done

    each()  # compiles
    began = time.perf_counter()
    done = each()
    return (time.perf_counter() - began) / done


def identified_as_a_worker_would(folder: Path) -> float:
    """The same in a process with the settings of a worker."""
    settings = SETTINGS["distributed.nanny.pre-spawn-environ"]
    code = (
        "import sys; from pathlib import Path; from benchmarks.fleet.__main__ import identified; "
        "print(identified(Path(sys.argv[1])))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder)],
        env={**os.environ, **{name: str(value) for name, value in settings.items()}},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return float(done.stdout.split()[-1])


def speed(folder: Path, work: Path) -> dict[str, Any]:
    """One worker and two, and the same recordings by `identify`, before and after one worker."""
    before = identified_as_a_worker_would(folder)
    runs = [run(folder, work / "out1", 1)]
    one = (before + identified_as_a_worker_would(folder)) / 2
    runs.append(run(folder, work / "out2", 2))
    count = sum(1 for _ in folder.rglob("*.parquet"))
    table = work / "out2" / "summaries.parquet"
    same = table.read_bytes() == (work / "out1" / "summaries.parquet").read_bytes()
    began = time.perf_counter()
    subprocess.run(command(table, work / "again", 0), check=True, stdout=subprocess.DEVNULL)
    return {
        "recordings": count,
        "runs": runs,
        "speedup": runs[0]["seconds"] / runs[1]["seconds"],
        "identify_seconds": one,
        "overhead": runs[0]["seconds"] / (one * count) - 1,
        "same_bits": same,
        "summary_bytes": table.stat().st_size / count,
        "estimated_again_seconds": time.perf_counter() - began,
    }


def scaling(folder: Path, work: Path) -> dict[str, Any]:
    """1, 2, 4 and more workers, to one a core: of machines with more than two."""
    counts = [2**n for n in range(cores().bit_length())]
    run(folder, work / "compiles", 1)
    return {
        "cores": cores(),
        "recordings": sum(1 for _ in folder.rglob("*.parquet")),
        "runs": [run(folder, work / f"scaling{workers}", workers) for workers in counts],
    }


def discoveries(table: Path) -> dict[str, Any]:
    """Groups that are called different, of recordings drawn again with replacement from each."""
    from riecjax.fleets.groups import Settings, estimated, group, part_of
    from riecjax.fleets.kept import read_rows
    from riecjax.fleets.order import Order
    from riecjax.fleets.spread import RATE, spreads
    from riecjax.fleets.sums import DONE
    from riecjax.models.catalogue import find_model
    from riecjax.summaries.summary import Summary

    start_jax(keep_compiled=True)
    rows = [row for row in read_rows(table) if row.status == DONE]
    by_group: dict[str, list[Any]] = {}
    for row in rows:
        by_group.setdefault(json.loads(row.keys)["vehicle"], []).append(part_of(row, 10**6))
    criterion = Summary.from_bytes(rows[0].sums).criterion
    packed = Order(find_model(MODEL), criterion, None, by=("vehicle",)).packed()
    rng, shares, missed = np.random.default_rng(0), [], 0
    worn = {f"{number:02}" for number in WORN}
    for _ in range(REPETITIONS):
        drawn = []
        for name, parts in by_group.items():
            picked = rng.integers(len(parts), size=len(parts))
            drawn.append(group(name, [parts[i]._replace(lengths=None) for i in picked]))
        found = spreads(estimated(packed, Settings(), drawn))
        called = [(one.group, spread.parameter) for spread in found for one in spread.differing]
        wrong = [pair for pair in called if not (pair[0] in worn and pair[1] in ("r", "r2"))]
        shares.append(len(wrong) / max(len(called), 1))
        missed += len({(name, "r") for name in worn} - set(called))
    return {
        "repetitions": REPETITIONS,
        "rate": RATE,
        "false_share": float(np.mean(shares)),
        "worn_missed": missed,
        "worn": REPETITIONS * len(worn),
    }


def nothing(number: int) -> int:
    """A task that takes no time."""
    return number


def tasks(count: int) -> dict[str, Any]:
    """Tasks that do nothing: what handing them over costs."""
    from riecjax.fleets.engine import Cluster

    with Cluster(2) as runs:
        list(runs.each(nothing, ((n,) for n in range(100))))
        began = time.perf_counter()
        done = sum(1 for _ in runs.each(nothing, ((n,) for n in range(count))))
        seconds = time.perf_counter() - began
    return {"tasks": done, "seconds": seconds, "milliseconds_a_task": 1e3 * seconds / done}


def page() -> str:
    """docs/scale.md with the figures that are recorded."""
    return filled_in(PAGE, BEGIN, words(json.loads((FOLDER / "fleet.json").read_text())))


def words(document: dict[str, Any]) -> str:
    """What was measured, in Markdown."""
    said = []
    if (found := document.get("speed")) is not None:
        rows = [
            f"| {one['workers']} | {one['seconds']:.0f} s | {one['samples_per_second']:,.0f} | "
            f"{one['peak_bytes'] / 1e9:.1f} GB |"
            for one in found["runs"]
        ]
        said += [
            f"**{found['recordings']} recordings** of 4000 to 12000 samples, on two cores that "
            f"scheduler and client share:\n",
            "| workers | time | samples a second | memory of all processes |",
            "|---|---|---|---|",
            *rows,
            "",
            f"Two workers are {found['speedup']:.2f} times as fast as one, and end in the same "
            f"bits. To read a recording and `identify` from it takes "
            f"{1e3 * found['identify_seconds']:.0f} ms of one core; the fleet with one worker, "
            f"which also checks sensors, looks for drift, keeps all sums and reports, takes "
            f"{100 * found['overhead']:.0f} % more. A summary is "
            f"{found['summary_bytes'] / 1e3:.0f} kB on disk, and all groups are estimated again "
            f"from them in {found['estimated_again_seconds']:.0f} s.",
        ]
    if (found := document.get("discoveries")) is not None:
        said += [
            f"\n**Worn dampers** (15 %, two of twenty groups), in {found['repetitions']} "
            f"repetitions of recordings drawn again from the sums: "
            f"{found['worn'] - found['worn_missed']} of {found['worn']} found; of all that was "
            f"called different {100 * found['false_share']:.1f} % was not (stated rate "
            f"{100 * found['rate']:.0f} %).",
        ]
    if (found := document.get("breaks")) is not None:
        said += [
            f"\n**Broken off**: {found['workers_killed']} workers killed at random moments; the "
            f"command killed {found['commands_killed']} times, Dask's scheduler "
            f"{found['schedulers_killed']} times, the disk full {found['disks_full']} times, each "
            f"time run again; {found['files_changed']} files changed meanwhile: {found['wrong']} "
            f"results that differ by a bit.",
        ]
    if (found := document.get("tasks")) is not None:
        said += [
            f"\n**Scheduler**: {found['tasks']} tasks that do nothing take {found['seconds']:.0f} "
            f"s, {found['milliseconds_a_task']:.2f} ms each.",
        ]
    if (found := document.get("long")) is not None:
        said += [
            f"\n**Weeks in one recording**: {found['samples']:,} samples of seven columns, a data "
            f"set of files of 100,000 rows, on two workers: {found['seconds']:.0f} s "
            f"({found['samples_per_second']:,.0f} samples a second), "
            f"{found['peak_bytes'] / 1e9:.1f} GB of all processes together{_growth(found)}.",
        ]
    if (found := document.get("soak")) is not None:
        said += [
            f"\nA soak of {found['seconds'] / 60:.0f} minutes since, {found['samples']:,} samples "
            f"beside other work on the same cores: {found['peak_bytes'] / 1e9:.1f} GB"
            f"{_growth(found)}.",
        ]
    if (found := document.get("one_pass")) is not None:
        said += [
            f"\nThe sums of {found['samples']:,} samples, read in {found['stretches']} stretches "
            f"with what their windows reach beside, differ from those of one pass over all of them "
            f"by {found['difference']:.1g} of their size; windows counted: {found['counted']}.",
        ]
    if (found := document.get("scaling")) is not None:
        first = found["runs"][0]
        rows = [
            f"| {run['workers']} | {run['seconds']:.0f} s | {run['samples_per_second']:,.0f} | "
            f"{first['seconds'] / run['seconds']:.1f} |"
            for run in found["runs"]
        ]
        said += [
            f"\n**More cores**: {found['recordings']} recordings on a machine of "
            f"{found['cores']} cores:\n",
            f"| workers | time | samples a second | times {first['workers']} |",
            "|---|---|---|---|",
            *rows,
        ]
    if {"speed", "tasks"} <= {*document}:
        said += ["", *_further(document["speed"], document["tasks"])]
    return "\n".join(said)


def _growth(found: dict[str, Any]) -> str:
    more = 100 * found.get("growth", 0.0)
    return f", in the last quarter {more:+.0f} % against the second" if "growth" in found else ""


def _further(speed: dict[str, Any], tasks: dict[str, Any]) -> list[str]:
    """What more workers and samples take, from a core's rate and the cost of a task."""
    rate = speed["runs"][1]["samples_per_second"] / 2
    task = TOGETHER * speed["runs"][0]["seconds"] / speed["recordings"]
    most = 1e3 * task / tasks["milliseconds_a_task"]
    rows = []
    for workers in (10, 100, 1000):
        busy = min(workers, most)
        rows.append(
            f"| {workers} | {busy * rate:,.0f} | {1e10 / (busy * rate) / 60:,.3g} min | "
            f"{1e12 / (busy * rate) / 3600:,.3g} h |"
        )
    return [
        f"A task sums {TOGETHER} recordings in {task:.2g} s, and costs the scheduler "
        f"{tasks['milliseconds_a_task']:.2g} ms: it keeps up to about {most:,.0f} workers busy. "
        f"With {rate:,.0f} samples a second and core, as here with two, that makes\n",
        "| workers | samples a second | 1e10 samples | 1e12 samples |",
        "|---|---|---|---|",
        *rows,
    ]


PARTS = ("speed", "discoveries", "breaks", "tasks", "one_pass", "long")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--recordings", type=int, default=10_000)
    parser.add_argument("--folder", type=Path, help="where they are, or are to be")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--samples", type=int, default=10_000_000, help="of the long recording")
    parser.add_argument("--tasks", type=int, default=100_000, help="that do nothing")
    parser.add_argument("--only", nargs="+", choices=(*PARTS, "soak", "scaling"), default=PARTS)
    parser.add_argument("--json", type=Path, help="where results are kept")
    parser.add_argument("--page", action="store_true", help="write the documentation's page")
    given = parser.parse_args()
    if given.page:
        PAGE.write_text(page(), encoding="utf-8")
        return
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        folder = given.folder or work / "fleet"
        if not folder.exists():
            write_fleet(folder, given.recordings)
        if "discoveries" in given.only and "speed" not in given.only:
            run(folder, work / "out2", 2)
        for part in given.only:
            found = {
                "speed": lambda: speed(folder, work),
                "scaling": lambda: scaling(folder, work),
                "discoveries": lambda: discoveries(work / "out2" / "summaries.parquet"),
                "breaks": lambda: breaks(folder, work, given.kills),
                "tasks": lambda: tasks(given.tasks),
                "one_pass": lambda: one_pass(work),
                "long": lambda: long(work, given.samples),
                "soak": lambda: long(work, given.samples),
            }[part]()
            print(part, json.dumps(found, indent=2), flush=True)
            if given.json:
                before = json.loads(given.json.read_text()) if given.json.exists() else {}
                write_json(given.json, {**before, part: found})


if __name__ == "__main__":
    main()

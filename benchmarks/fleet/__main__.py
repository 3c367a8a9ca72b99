"""A fleet of recordings: speed, memory, more cores, what breaks, weeks in one recording.

    python -m benchmarks.fleet [--recordings 10000] [--folder DIR] [--kills 50] [--samples 10000000]
        [--only each speed breaks long soak scaling] [--json FILE]
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
from benchmarks.fleet.commands import MODEL, command, run, spent
from benchmarks.fleet.weeks import long
from benchmarks.recorded import FOLDER, filled_in, write_json
from riecjax.fleets.engine import SETTINGS
from riecjax.records.writing import write_record
from riecjax.runtime import start_jax

GROUPS, WORN = 20, (4, 11)
COMPARED = 300
"""Recordings that `identify` is timed on."""
PARTS = ("each", "speed", "breaks", "long", "soak", "scaling")
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
    """CPU seconds to read and identify a recording, one call after the other."""
    import riecjax as rx

    start_jax()
    model = rx.find_model(MODEL)
    files = sorted(folder.rglob("*.parquet"))
    some = files[:: max(len(files) // COMPARED, 1)]

    def identify_all() -> int:
        done = 0
        for file in some:
            try:
                rx.identify(model, rx.read_recording(file, model=model))
                done += 1
            except rx.DataError:
                continue
        return done

    identify_all()  # imports, and starts the process that reads files
    began = sum(spent().values())
    done = identify_all()
    return (sum(spent().values()) - began) / done


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


def each(folder: Path, work: Path) -> dict[str, Any]:
    """What a recording takes of one core: by `identify`, before and after, and in a fleet."""
    before = identified_as_a_worker_would(folder)
    whole = run(folder, work / "each", 1)
    count = sum(1 for _ in folder.rglob("*.parquet"))
    return {
        "recordings": count,
        "identify_seconds": (before + identified_as_a_worker_would(folder)) / 2,
        "fleet_seconds": whole["cpu_seconds"] / count,
        "run": whole,
    }


def speed(folder: Path, work: Path) -> dict[str, Any]:
    """One worker and two."""
    runs = [run(folder, work / f"out{workers}", workers) for workers in (1, 2)]
    count = sum(1 for _ in folder.rglob("*.parquet"))
    table = work / "out2" / "summaries.parquet"
    same = table.read_bytes() == (work / "out1" / "summaries.parquet").read_bytes()
    began = time.perf_counter()
    subprocess.run(command(table, work / "again", 0), check=True, stdout=subprocess.DEVNULL)
    return {
        "recordings": count,
        "runs": runs,
        "speedup": runs[0]["seconds"] / runs[1]["seconds"],
        "same_bits": same,
        "summary_bytes": table.stat().st_size / count,
        "estimated_again_seconds": time.perf_counter() - began,
    }


def scaling(folder: Path, work: Path) -> dict[str, Any]:
    """1, 2, 4 and more workers, to one a core: of machines with more than two."""
    counts = [2**n for n in range(len(os.sched_getaffinity(0)).bit_length())]
    return {
        "cores": len(os.sched_getaffinity(0)),
        "recordings": sum(1 for _ in folder.rglob("*.parquet")),
        "runs": [run(folder, work / f"scaling{workers}", workers) for workers in counts],
    }


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
            f"bits. A summary is {found['summary_bytes'] / 1e3:.0f} kB on disk, and all groups are "
            f"estimated again from them in {found['estimated_again_seconds']:.0f} s.",
        ]
    if (found := document.get("each")) is not None:
        said += [
            f"\n**Each recording**, of {found['recordings']}: to read it and "
            f"`identify` from it takes {1e3 * found['identify_seconds']:.0f} ms of one core. In a "
            f"fleet with one worker it takes {1e3 * found['fleet_seconds']:.0f} ms of all "
            f"processes together: their start, checks of sensors, a look for drift, all sums on "
            f"disk and the report included.",
        ]
    if (found := document.get("breaks")) is not None:
        said += [
            f"\n**Broken off**: {found['workers_killed']} workers killed at random moments; the "
            f"command killed {found['commands_killed']} times, the disk full "
            f"{found['disks_full']} times, each time run again: {found['wrong']} results that "
            f"differ by a bit.",
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
    return "\n".join(said)


def _growth(found: dict[str, Any]) -> str:
    more = 100 * found.get("growth", 0.0)
    return f", in the last quarter {more:+.0f} % against the second" if "growth" in found else ""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--recordings", type=int, default=10_000)
    parser.add_argument("--folder", type=Path, help="where they are, or are to be")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--samples", type=int, default=10_000_000, help="of the long recording")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=("speed", "breaks", "long"))
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
        for part in given.only:
            found = {
                "each": lambda: each(folder, work),
                "speed": lambda: speed(folder, work),
                "scaling": lambda: scaling(folder, work),
                "breaks": lambda: breaks(folder, work, given.kills),
                "long": lambda: long(work, given.samples),
                "soak": lambda: long(work, given.samples),
            }[part]()
            print(part, json.dumps(found, indent=2), flush=True)
            if given.json:
                before = json.loads(given.json.read_text()) if given.json.exists() else {}
                write_json(given.json, {**before, part: found})


if __name__ == "__main__":
    main()

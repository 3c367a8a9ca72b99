"""How far off the forecasts of long runs are: `python -m benchmarks.forecasts [--only NAME]`.

Each command runs twice small and once large, each in a process of its own that keeps what it
compiles. What the large one takes beyond the second small one, in seconds and in bytes at its peak,
is compared with what it said beforehand beyond the small one. Written to benchmarks/forecasts.json.
"""

import argparse
import contextlib
import io
import json
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.afresh import environment, last_line
from benchmarks.writing import write_json
from riecjax.cli.main import run
from riecjax.work import Work, listening

FILE = Path(__file__).with_suffix(".json")


class Case(NamedTuple):
    """A command, with `{n}` for its small and its large number, and what makes its file first."""

    command: str
    small: int
    large: int
    made_by: str = ""


SIMULATE = "simulate {model} --input white-noise --seed 1 --duration {{n}} --out {{n}}.{ending}"
CAR = SIMULATE.format(model="quarter-car-source", ending="parquet")
CAR_TEXT = SIMULATE.format(model="quarter-car-source", ending="csv")
DRAG = SIMULATE.format(model="drag-oscillator", ending="parquet")
CASES = {
    "simulate": Case(CAR_TEXT, 40, 5000),
    "car": Case("identify {n}.parquet --model quarter-car", 40, 5000, CAR),
    "car, text": Case("identify {n}.csv --model quarter-car", 40, 5000, CAR_TEXT),
    "drag": Case("identify {n}.parquet --model drag-oscillator", 40, 5000, DRAG),
    "check": Case("check {n}.parquet --model quarter-car", 40, 5000, CAR),
    "mode": Case("identify {n}.parquet --model quarter-car --add-mode x4", 40, 2500, CAR),
    "random windows": Case(
        "identify 40.parquet --model quarter-car --windows {n} --seed 1", 2000, 4_000_000, CAR
    ),
    "up-sampling": Case("identify 40.parquet --model drag-oscillator --upsample {n}", 2, 100, DRAG),
    "resampling": Case(
        "identify 40.parquet --model drag-oscillator --resample {n}", 210, 40_000, DRAG
    ),
    "output error": Case(
        "identify {n}.parquet --model drag-oscillator --refine output-error", 40, 2500, DRAG
    ),
    "study": Case("reproduce --roads {n}", 16, 160),
}


def measured(command: list[str]) -> dict[str, Any]:
    """Seconds, bytes at the peak and what was said of them, of a command in this process."""
    said: list[Work] = []
    began = time.perf_counter()
    with (
        contextlib.redirect_stdout(io.StringIO()),
        listening(lambda _, work: said.append(work)),
    ):
        assert run(command) == 0
    return {
        "seconds": time.perf_counter() - began,
        "bytes": 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        "said_seconds": sum(work.seconds for work in said),
        "said_bytes": max((work.bytes for work in said), default=0.0),
    }


def afresh(case: Case, size: int, folder: Path) -> dict[str, Any]:
    """The same in a new process that finds what earlier ones compiled."""
    made_for = size if "{n}." in case.command else 40
    commands = [case.made_by.format(n=made_for)] if case.made_by else []
    found = [
        last_line(
            [sys.executable, "-m", __spec__.name, "--run", *command.split()],
            cwd=folder,
            env=environment(str(folder)) | PATH,
        )
        for command in (*commands, case.command.format(n=size))
    ]
    return found[-1]


PATH = {"PYTHONPATH": str(Path(__file__).parents[1])}


def compared(case: Case, folder: Path) -> dict[str, float]:
    """What the large run takes beyond the small one, and what it said."""
    afresh(case, case.small, folder)
    small, large = (afresh(case, size, folder) for size in (case.small, case.large))
    return {name: large[name] - small[name] for name in large}


def main() -> None:
    if sys.argv[1:2] == ["--run"]:
        print(json.dumps(measured(sys.argv[2:])))
        return
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", action="append", choices=CASES, metavar="NAME")
    arguments = parser.parse_args()
    document = {}
    for name in arguments.only or CASES:
        with tempfile.TemporaryDirectory() as folder:
            found = compared(CASES[name], Path(folder))
        document[name] = {k: round(v, 1) if "seconds" in k else round(v) for k, v in found.items()}
        print(
            f"{name:<16} {found['seconds']:6.1f} s, said {found['said_seconds']:6.1f} s "
            f"({found['said_seconds'] / max(found['seconds'], 0.1):4.2f}); "
            f"{found['bytes'] / 1e9:5.2f} GB, said {found['said_bytes'] / 1e9:5.2f} GB",
            flush=True,
        )
    if not arguments.only:
        write_json(FILE, document)


if __name__ == "__main__":
    main()

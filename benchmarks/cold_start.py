"""From the start of a process to its table: `python -m benchmarks.cold_start [--repeats 3]`.

`riecjax identify` on 8000 rows, first with nothing compiled before, then again with what the first
one kept; `riecjax models`. Written to benchmarks/cold_start.json.
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.afresh import environment
from benchmarks.writing import write_json

FILE = Path(__file__).with_name("cold_start.json")
RIECJAX = (sys.executable, "-c", "from riecjax.cli.main import main; main()")
RECORDING = "drive.csv"
LAST_ROW = "F_4"
"""The parameter in the last row of the quarter car's table."""
TARGETS = {"identify_first_s": 4.0, "identify_again_s": 2.5, "models_s": 0.5}


def until(last: str, arguments: tuple[str, ...], folder: Path, cache: str) -> tuple[float, float]:
    """Seconds until a line that begins with `last`, and until the end."""
    began, shown = time.perf_counter(), 0.0
    with subprocess.Popen(
        [*RIECJAX, *arguments],
        cwd=folder,
        env=environment(cache),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith(last):
                shown = time.perf_counter() - began
    assert process.returncode == 0
    return shown, time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    identify = ("identify", RECORDING, "--model", "quarter-car")
    times: dict[str, list[float]] = {}

    def note(name: str, seconds: float) -> None:
        times.setdefault(name, []).append(seconds)

    with tempfile.TemporaryDirectory() as folder:
        make = ("simulate", "quarter-car-source", "--input", "white-noise", "--out", RECORDING)
        subprocess.run([*RIECJAX, *make], cwd=folder, check=True, capture_output=True)
        for _ in range(arguments.repeats):
            with tempfile.TemporaryDirectory() as cache:
                for which in ("first", "again"):
                    table, end = until(LAST_ROW, identify, Path(folder), cache)
                    note(f"identify_{which}_s", table)
                    note(f"identify_{which}_all_checks_s", end)
                note("models_s", until("quarter-car", ("models",), Path(folder), cache)[1])
    found = {name: round(statistics.median(values), 2) for name, values in times.items()}
    for name, value in found.items():
        target = TARGETS.get(name)
        verdict = (
            "" if target is None else f"target {target:g}, {'met' if value < target else 'NOT MET'}"
        )
        print(f"{name:<32} {value:6.2f} s  {verdict}")
    write_json(FILE, found)


if __name__ == "__main__":
    main()

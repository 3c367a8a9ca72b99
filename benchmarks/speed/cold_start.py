"""From the start of a process to its answer.

    python -m benchmarks.speed cold_start [--against DIR]

`riecjax identify` on 8000 rows, on a terminal of its own: until the estimate is on the screen, and
until the verdict on refined and tested values is, first with nothing compiled before, then again
with what the first one kept; the same of a model that is right, whose values are refined, and of a
shorter recording after that; and `riecjax models`. Beside them a bare import of jax and diffrax, in
whose time they are told. Written to benchmarks/cold_start.json.

`--against` names a checkout of another commit, whose commands run in turn with ours; then ratios
are told, and nothing is written.
"""

import os
import pty
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.recorded import FOLDER, environment, write_json

FILE = FOLDER / "cold_start.json"
HERE = FOLDER.parent
RIECJAX = (sys.executable, "-c", "from riecjax.cli.main import main; main()")
IMPORT = (sys.executable, "-c", "import jax, diffrax")
RECORDING, RIGHT, SHORTER = "drive.csv", "duffing.csv", "shorter.csv"
LAST_ROW = b"F_4"
"""The parameter in the last row of the quarter car's table."""
VERDICT = b"Values:"
TARGETS = {
    "estimate_first": 3.4,
    "verdict_first": 9.0,
    "estimate_again": 1.7,
    "verdict_again": 4.5,
    "refined_first": 9.0,
    "refined_again": 4.5,
    "refined_shorter": 4.5,
}
"""Times a bare import."""


def settings(cache: str, checkout: Path) -> dict[str, str]:
    """The environment of a process that runs the sources of a checkout."""
    return environment(cache) | {"PYTHONPATH": str(checkout / "src")}


def until(
    words: Sequence[bytes],
    command: tuple[str, ...],
    folder: Path,
    environment: dict[str, str],
) -> list[float]:
    """Seconds until each of some words is first on the screen."""
    ours, theirs = pty.openpty()
    began, screen = time.perf_counter(), b""
    shown = [float("nan")] * len(words)
    with subprocess.Popen(
        command, cwd=folder, env=environment, stdout=theirs, stderr=theirs, close_fds=True
    ) as process:
        os.close(theirs)
        while True:
            try:
                part = os.read(ours, 65536)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            screen += part
            now = time.perf_counter() - began
            shown = [now if at != at and word in screen else at for word, at in zip(words, shown)]
    os.close(ours)
    assert process.returncode == 0, screen.decode(errors="replace")
    return shown


def seconds_of(command: tuple[str, ...], folder: Path, environment: dict[str, str]) -> float:
    """How long a command takes."""
    began = time.perf_counter()
    subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
    return time.perf_counter() - began


def times_of(checkout: Path, folder: Path) -> dict[str, float]:
    """Every time once, with nothing compiled before."""
    identify = (*RIECJAX, "identify", RECORDING, "--model", "quarter-car")
    refined = {
        file: (*RIECJAX, "identify", file, "--model", "duffing") for file in (RIGHT, SHORTER)
    }
    with tempfile.TemporaryDirectory() as cache:
        of = settings(cache, checkout)
        found = {"import_s": seconds_of(IMPORT, folder, of)}
        for which in ("first", "again"):
            table, verdict = until((LAST_ROW, VERDICT), identify, folder, of)
            found |= {f"estimate_{which}_s": table, f"verdict_{which}_s": verdict}
            (found[f"refined_{which}_s"],) = until((VERDICT,), refined[RIGHT], folder, of)
        (found["refined_shorter_s"],) = until((VERDICT,), refined[SHORTER], folder, of)
        found["models_s"] = seconds_of((*RIECJAX, "models"), folder, of)
    return found


def medians(times: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: round(statistics.median(one[name] for one in times), 2) for name in times[0]}


def main(repeats: int = 3, against: Path | None = None) -> None:
    checkouts = [HERE, *([against.absolute()] if against else [])]
    times: list[list[dict[str, float]]] = [[] for _ in checkouts]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for model, file in (("quarter-car-source", RECORDING), ("duffing", RIGHT)):
            make = ("simulate", model, "--input", "white-noise", "--out", file)
            subprocess.run([*RIECJAX, *make], cwd=folder, check=True, capture_output=True)
        lines = (folder / RIGHT).read_text().splitlines(keepends=True)
        (folder / SHORTER).write_text("".join(lines[: int(0.95 * len(lines))]))
        for turn in range(repeats):
            # Each goes first as often as the other: a machine's load drifts.
            for which in sorted(range(len(checkouts)), reverse=bool(turn % 2)):
                times[which].append(times_of(checkouts[which], folder))
    ours, *others = (medians(each) for each in times)
    for name, value in ours.items():
        target = TARGETS.get(name.removesuffix("_s"))
        ratio = value / ours["import_s"]
        verdict = f"asked {target:g}, {'met' if ratio <= target else 'NOT MET'}" if target else ""
        beside = "".join(f"  {value / other[name]:5.2f} of theirs" for other in others)
        print(f"{name:<20} {value:6.2f} s  {ratio:5.2f} imports{beside}  {verdict}")
    if not others:
        write_json(FILE, ours)

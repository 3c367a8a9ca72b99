"""What users wait for: whole processes, and the first and the next call in one.

    python -m benchmarks.speed instant [--against DIR] [--only CASE ...] [--repeats 3]
    python -m benchmarks.speed instant --check

Each command runs in a process of its own, `first` in a home where nothing was kept, `again` in the
same one; calls of the library are timed inside a process that has imported JAX. Beside the seconds
stand ratios to a bare import of jax and diffrax in the same run, what is asked, and how many
programs were compiled until the linear answer. Written to benchmarks/instant.json.

`--against` names a checkout of another commit, whose commands run in turn with ours; its seconds
are kept beside ours. `--check` writes nothing: it fails where a case takes twice as many bare
imports as is recorded, or where a call of the linear answer compiles a program.
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.recorded import FOLDER, environment, filled_in, last_line, table, write_json

FILE = FOLDER / "instant.json"
PAGE = FOLDER.parent / "docs" / "speed.md"
BEGIN = "<!-- measured: python -m benchmarks.speed instant -->"
HERE = FOLDER.parent
MEASURED = HERE.parent / "shared" / "data"
RIECJAX = (sys.executable, "-c", "from riecjax.cli.main import main; main()")
IMPORT = (sys.executable, "-c", "import jax, diffrax; jax.numpy.zeros(1) + 1")
BARE = "import"
MODELS = """
import riecjax as rx
plate = rx.Equation(rx.Term("m", "x", derivative=2, measured=("v",), unit="kg"),
                    rx.Term("d", "x", derivative=1, unit="N s/m"), rx.Term("k", "x", unit="N/m"),
                    -rx.Term(1.0, "u"))
shaken = rx.Model("shaken", "", stages=rx.Equation(rx.Term("m", "a", derivative=2, unit="kg"),
                              rx.Term("d", "a", derivative=1, unit="N s/m"),
                              rx.Term("k", "a", unit="N/m"), -rx.Term(1.0, "u", derivative=2)),
                  band=(0.3, 3.0))
"""
CALLS = """
import json, time
import jax
import riecjax as rx
rx.start_jax()
jax.numpy.zeros(1) + 1
compiled = 0
def listen(event, seconds, **_):
    global compiled
    compiled += event.endswith("backend_compile_duration")
jax.monitoring.register_event_duration_secs_listener(listen)
model = rx.find_model("quarter-car")
record = rx.read_recording("drive.csv", model=model)
import riecjax.assessment.assess
call = {call}
times, programs = [], []
for _ in range(4):
    compiled, began = 0, time.perf_counter()
    call()
    times.append(time.perf_counter() - began)
    programs.append(compiled)
print(json.dumps({{"first": times[0], "again": sorted(times[1:])[1], "programs": programs[0]}}))
"""


class Case(NamedTuple):
    """**Fields:** `command`, or a `call` of the library; `asked`, seconds (times a bare import
    where it is `in_imports`) of the first time and the next; `in_words`, for the table."""

    in_words: str
    asked: tuple[float, float]
    command: tuple[str, ...] = ()
    call: str = ""
    in_imports: bool = False


def identify(*words: str) -> tuple[str, ...]:
    return (*RIECJAX, "identify", *words)


def without_refining(*words: str) -> tuple[str, ...]:
    return identify(*words, "--refine", "none")


TEN = tuple(f"ten{seed}.csv" for seed in range(10))
STEPS = tuple(f"step{number}.csv" for number in range(4))
EMPS = (str(MEASURED / "emps" / "DATA_EMPS.mat"), "--model", "emps", "--map", "q=qm", "--map",
        "force=vir", "--scale", "vir=35.1507")  # fmt: skip
CASES = {
    "identify": Case(
        "`riecjax identify` of README's recording", (2.0, 2.0),
        identify("drive.csv", "--model", "quarter-car"), in_imports=True,
    ),
    "refined": Case(
        "a right model, 5 % noise, refined", (6.0, 6.0),
        identify("drag.csv", "--model", "drag-oscillator"), in_imports=True,
    ),
    "rx.identify": Case(
        "`rx.identify` in a process that has imported JAX", (0.25, 0.04),
        call="lambda: rx.identify(model, record)",
    ),
    "rx.assess": Case(
        "`rx.assess` there", (1.5, 0.6), call="lambda: rx.assess(model, record)",
    ),
    "emps": Case("EMPS, 24 841 samples, position only", (4.0, 4.0), without_refining(*EMPS)),
    "ten": Case(
        "ten recordings of 10 s at 1 kHz", (10.0, 10.0),
        without_refining(*TEN, "--model", "quarter-car"),
    ),
    "steps": Case(
        "four step tests, 1 400 samples in all", (3.0, 3.0),
        without_refining(*STEPS, "--model", "models.py:plate"),
    ),
    "bumps": Case(
        "41 000 samples of accelerations, bumps of 1.7 to 6.7 s", (5.0, 5.0),
        without_refining("shaken.csv", "--model", "models.py:shaken"),
    ),
}  # fmt: skip


def response(
    force: Callable[[np.ndarray], np.ndarray],
    seconds: float,
    rate: float,
    constants: Sequence[float],
) -> dict[str, np.ndarray]:
    """An oscillator's motion under a force, by twenty steps of Runge and Kutta a sample."""
    mass, damping, stiffness = constants
    fine, count = 20, int(seconds * rate)
    step = 1 / (rate * fine)
    at = force(np.arange(2 * count * fine + 1) * step / 2)
    motion, found = np.zeros(2), np.zeros((count, 3))

    def slope(state: np.ndarray, pushed: float) -> np.ndarray:
        return np.array([state[1], (pushed - damping * state[1] - stiffness * state[0]) / mass])

    for sample in range(count):
        found[sample] = *motion, slope(motion, at[2 * sample * fine])[1]
        for part in range(sample * fine, (sample + 1) * fine):
            one = slope(motion, at[2 * part])
            two = slope(motion + step / 2 * one, at[2 * part + 1])
            three = slope(motion + step / 2 * two, at[2 * part + 1])
            four = slope(motion + step * three, at[2 * part + 2])
            motion = motion + step / 6 * (one + 2 * two + 2 * three + four)
    t = np.arange(count) / rate
    return {"t": t, "x": found[:, 0], "v": found[:, 1], "a": found[:, 2], "u": force(t)}


def write(path: Path, columns: dict[str, np.ndarray]) -> None:
    rows = np.transpose([*columns.values()])
    np.savetxt(path, rows, "%.9g", ",", header=",".join(columns), comments="")


def make_recordings(folder: Path) -> None:
    """What the cases read."""
    simulate = (*RIECJAX, "simulate", "quarter-car-source", "--input", "white-noise")
    run = {"cwd": folder, "check": True, "capture_output": True}
    subprocess.run((*simulate, "--seed", "1", "--out", "drive.csv"), **run)
    for seed, file in enumerate(TEN):
        options = ("--seed", str(seed), "--duration", "10", "--rate", "1000", "--out", file)
        subprocess.run((*simulate, *options), **run)
    make = (*RIECJAX, "simulate", "drag-oscillator", "--input", "white-noise", "--out", "drag.csv")
    subprocess.run(make, **run)
    rng = np.random.default_rng(0)
    rows = np.genfromtxt(folder / "drag.csv", delimiter=",", names=True)
    drag = {name: rows[name] for name in rows.dtype.names or ()}
    for name in drag.keys() - {"t"}:
        drag[name] = drag[name] + 0.05 * drag[name].std() * rng.standard_normal(drag[name].size)
    write(folder / "drag.csv", drag)
    for number, file in enumerate(STEPS):
        size = 5.0 * (1 + number)
        made = response(lambda t, size=size: size * (t > 0.2), 3.5, 100.0, (2.0, 4.0, 300.0))
        for name in ("x", "v"):
            noise = 0.01 * made[name].std() * rng.standard_normal(made[name].size)
            made[name] = made[name] + noise
        made.pop("a")
        write(folder / file, made)
    tones = np.geomspace(0.1, 3.0, 25)
    phases = rng.uniform(0, 2 * np.pi, tones.size)
    made = response(
        lambda t: np.sin(2 * np.pi * np.outer(t, tones) + phases).sum(1), 205.0, 200.0,
        (10.0, 8.0, 100.0),
    )  # fmt: skip
    made["a"] = made["a"] + 0.02 * made["a"].std() * rng.standard_normal(made["a"].size)
    write(folder / "shaken.csv", {name: made[name] for name in ("t", "a", "u")})
    (folder / "models.py").write_text(MODELS)


def seconds_of(command: Sequence[str], folder: Path, of: dict[str, str]) -> float:
    """How long a process takes."""
    began = time.perf_counter()
    done = subprocess.run(command, cwd=folder, env=of, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr or done.stdout
    return time.perf_counter() - began


def times_of(checkout: Path, folder: Path, cases: Sequence[str]) -> dict[str, dict[str, float]]:
    """Every case once, with nothing kept before; of calls also the programs compiled at first."""
    found = {}
    for name in cases:
        case = CASES[name]
        with tempfile.TemporaryDirectory() as home:
            of = environment(home) | {"PYTHONPATH": str(checkout / "src"), "HOME": home}
            if case.call:
                of["OPENBLAS_NUM_THREADS"] = "1"
                code = CALLS.format(call=case.call)
                found[name] = last_line((sys.executable, "-c", code), cwd=folder, env=of)
            else:
                found[name] = {
                    when: seconds_of(case.command, folder, of) for when in ("first", "again")
                }
        print(f"{checkout.name}: {name} {found[name]}", flush=True)
    with tempfile.TemporaryDirectory() as home:
        found[BARE] = {"first": seconds_of(IMPORT, folder, environment(home))}
    return found


def medians(turns: Sequence[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    return {
        name: {
            what: round(statistics.median(turn[name][what] for turn in turns), 3)
            for what in figures
        }
        for name, figures in turns[0].items()
    }


def page(measured: dict[str, dict[str, dict[str, float]]]) -> str:
    """In Markdown: seconds first and again, what is asked, and what the other commit took, each in
    imports of the run that it was measured in."""
    ours, theirs = measured["ours"], measured.get("before", {})
    bare = ours[BARE]["first"]

    def told(of: dict[str, dict[str, float]], name: str, case: Case) -> str:
        pair, bare = (of[name]["first"], of[name]["again"]), of[BARE]["first"]
        if case.in_imports:
            return " / ".join(f"{value / bare:.1f} imports" for value in pair)
        return " / ".join(f"{value:.2g} s" for value in pair)

    rows = []
    for name, case in CASES.items():
        if name not in ours:
            continue
        unit = " imports" if case.in_imports else " s"
        met = all(
            ours[name][when] <= limit * (bare if case.in_imports else 1)
            for when, limit in zip(("first", "again"), case.asked)
        )
        asked = " / ".join(f"{limit:g}" for limit in case.asked) + unit
        rows.append([
            case.in_words, told(ours, name, case), asked + ("" if met else ", **not met**"),
            told(theirs, name, case) if name in theirs else "",
        ])  # fmt: skip
    return table(("", "first / again", "asked", "before"), rows)


CHECKED = ("identify", "rx.identify", "rx.assess", "emps")


def slower(found: dict[str, dict[str, float]], recorded: dict[str, dict[str, float]]) -> list[str]:
    """What takes twice as many bare imports as is recorded, or compiles."""
    bare, before = found[BARE]["first"], recorded[BARE]["first"]
    ratios = {
        f"{name}, {when}": (figures[when] / bare, recorded[name][when] / before)
        for name, figures in found.items()
        for when in ("first", "again")
        if name != BARE
    }
    told = [
        f"{name}: {now:.2f} imports, recorded {then:.2f}"
        for name, (now, then) in ratios.items()
        if now > 2 * then
    ]
    compiled = [name for name, figures in found.items() if figures.get("programs")]
    return [*told, *(f"{name} compiles {found[name]['programs']:g} programs" for name in compiled)]


def main(
    against: Path | None = None,
    only: tuple[str, ...] = tuple(CASES),
    repeats: int = 3,
    check: bool = False,
) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_recordings(folder)
        if check:
            cases = [case for case in CHECKED if case != "emps" or MEASURED.exists()]
            recorded = json.loads(FILE.read_text())["ours"]
            # Another program on the machine slows one run: what is really slower stays so.
            told = slower(times_of(HERE, folder, cases), recorded)
            told = told and slower(times_of(HERE, folder, cases), recorded)
            sys.exit("\n".join(told) or 0)
        checkouts = {"ours": HERE} | ({"before": against.absolute()} if against else {})
        turns: dict[str, list[dict[str, dict[str, float]]]] = {which: [] for which in checkouts}
        for turn in range(repeats):
            # Each goes first as often as the other: a machine's load drifts.
            for which in sorted(checkouts, reverse=bool(turn % 2)):
                turns[which].append(times_of(checkouts[which], folder, only))
    measured = {which: medians(each) for which, each in turns.items()}
    print(page(measured))
    if set(only) == set(CASES):
        recorded = json.loads(FILE.read_text()) if FILE.exists() else {}
        write_json(FILE, recorded | measured)
        PAGE.write_text(filled_in(PAGE, BEGIN, page(recorded | measured)), encoding="utf-8")

"""What a Summary saves, and what it costs: `python -m benchmarks.speed summaries [--only ...]`.

- `lengths`: the first and the second call of `identify`, and the functions that they compile, where
  64 recordings are all of other lengths, and where they are of one; and for 16 lengths one by one.
- `questions`: other known values, intervals and bands from one Summary of 10^6 samples, against
  `identify` of all samples anew, with the largest relative difference of the two.
- `cost`: seconds of `summarise` against all of `identify`, and bytes of what it keeps, for the
  paper's record and for 10^6 samples.

First calls are timed in processes of their own, which find nothing compiled before. Writes
benchmarks/summaries.json.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from benchmarks.recorded import FOLDER, environment, last_line, write_json
from benchmarks.speed.timing import seconds
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import AllWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.identify import estimate, identify
from riecjax.models.quarter_car.identification import quarter_car_by_body
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.paper.reproduction import identification_record
from riecjax.records.record import Record
from riecjax.runtime import start_jax
from riecjax.summaries.summarise import summarise
from riecjax.uncertainty.intervals import BlockBootstrap, Sandwich

FILE = FOLDER / "summaries.json"
STEP, REPEATS, BINS = 1e-3, 5, 12
SAMPLES = 10**6
OF_OTHER_LENGTHS = [5000 + 37 * i for i in range(64)]
ONE_BY_ONE = [5000 + i for i in range(16)]
LENGTHS = {
    "64 recordings of 64 lengths": (OF_OTHER_LENGTHS, True),
    "64 recordings of 5000": ([5000] * 64, True),
    "16 lengths one by one": (ONE_BY_ONE, False),
    "16 times 5000 one by one": ([5000] * 16, False),
}
"""Samples of recordings, and whether one call takes them all."""


def made_record(samples: int, seed: int = 0) -> Record:
    """m dv/dt + c v + k x = u, with noise on u, on a motion of random frequencies."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(samples)
    x, v, a = np.zeros((3, samples))
    for hertz in rng.uniform(0.5, 8.0, 6):
        w, phase = 2 * np.pi * hertz, rng.uniform(0, 2 * np.pi)
        x += np.sin(w * t + phase) / w
        v += np.cos(w * t + phase)
        a -= np.sin(w * t + phase) * w
    u = 2.0 * a + 3.0 * v + 400.0 * x + rng.normal(size=samples)
    return Record({"x": x, "v": v, "u": u}, STEP)


def equation() -> Equation:
    return Equation(
        Term("m", "v", derivative=1), Term("c", "v"), Term("k", "x"), -Term(1.0, "u"), name="mass"
    )


def criterion(alpha: float = 0.05, beta: float = 0.5) -> RIEC:
    return RIEC(AllWindows(alpha, beta))


def medians(works: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Seconds of each, in turn, after a call of each that is not counted."""
    for work in works.values():
        work()
    times = [{name: seconds(work) for name, work in works.items()} for _ in range(REPEATS)]
    return {name: float(np.median([turn[name] for turn in times])) for name in works}


def largest_difference(one: Estimate, other: Estimate) -> float:
    """Of two estimates' parameters, relative."""
    return float(np.max(np.abs(np.asarray(one.theta) / np.asarray(other.theta) - 1)))


def first_calls(which: str) -> dict[str, float]:
    """Seconds of both calls and functions that each compiled, in this process."""
    counts, together = LENGTHS[which]
    records = [made_record(count, seed) for seed, count in enumerate(counts)]
    compiled = []

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        if event.endswith("backend_compile_duration"):
            compiled.append(duration_secs)

    def work() -> list[Any]:
        calls = [records] if together else [[record] for record in records]
        return [identify(equation(), call, criterion()).theta for call in calls]

    jax.monitoring.register_event_duration_secs_listener(listen)
    first = seconds(work)
    functions = len(compiled)
    second = seconds(work)
    return {
        "first_s": first,
        "second_s": second,
        "functions": functions,
        "functions_again": len(compiled) - functions,
        "compiling_s": sum(compiled),
    }


def lengths() -> dict[str, dict[str, float]]:
    """Of each of `LENGTHS`, in a process of its own; and how the first two compare."""
    found = {}
    for which in LENGTHS:
        with tempfile.TemporaryDirectory() as empty:
            command = [sys.executable, "-m", "benchmarks.speed.summaries", "--point", which]
            found[which] = last_line(command, env=environment(empty))
        show(which, found[which])
    names = list(LENGTHS)
    for other, same in (names[:2], names[2:]):
        ratios = {key: found[other][key] / found[same][key] for key in ("first_s", "second_s")}
        found[f"{other} over {same}"] = ratios
        show(f"{other} over {same}", ratios)
    return found


def questions() -> dict[str, dict[str, float]]:
    """Each question to one Summary, against the same to the samples."""
    model, record = equation(), made_record(SAMPLES)
    summary = summarise(model, record, criterion(), bins=BINS)
    # Windows of some of its bins exactly, so that both sums are of the same windows.
    other = summary.lengths_of((3, 9))
    whole, narrow = (summary, criterion()), (summary.between(*other), criterion(*other))
    asked = {
        "the same": (*whole, {"intervals": BlockBootstrap()}),
        "k known": (*whole, {"known": {"k": 400.0}}),
        "k known, another value": (*whole, {"known": {"k": 390.0}}),
        "Sandwich": (*whole, {"intervals": Sandwich()}),
        "another band": (*narrow, {}),
    }
    found = {}
    for name, (of, by, settings) in asked.items():

        def answer(of: Any = of, settings: Any = settings) -> Any:
            return estimate(model, of, **settings)

        def anew(by: Any = by, settings: Any = settings) -> Any:
            return identify(model, record, by, **settings)

        times = medians(
            {
                "estimate": lambda answer=answer: answer().covariance,
                "identify": lambda anew=anew: anew().covariance,
            }
        )
        found[name] = {
            "estimate_ms": 1e3 * times["estimate"],
            "identify_ms": 1e3 * times["identify"],
            "largest_relative_difference": largest_difference(answer(), anew()),
        }
        show(name, found[name])
    return found


def cost() -> dict[str, dict[str, float]]:
    """Summaries of different content, for two records."""
    source = quarter_car_source(reconstructed())
    paper = identification_record(source, jax.random.key(0)).record
    paper = paper.select("x1", "x2", "x3", "x4", "F_t")
    return {
        "the paper's record": cost_of("the paper's record", quarter_car_by_body(), paper),
        f"{SAMPLES} samples": cost_of(f"{SAMPLES} samples", equation(), made_record(SAMPLES)),
    }


def cost_of(name: str, model: Any, record: Record) -> dict[str, float]:
    def summed(**kept: Any) -> Any:
        return summarise(model, record, criterion(), **kept)

    settings = {"plain": {}, "bins": {"bins": BINS}, "bins_survey": {"bins": BINS, "survey": True}}
    works: dict[str, Callable[[], Any]] = {
        kind: lambda kept=kept: summed(**kept).recordings for kind, kept in settings.items()
    }
    works["identify"] = lambda: identify(model, record, criterion()).covariance
    times = medians(works)
    samples = sum(np.asarray(values).nbytes for values in record.arrays.values())
    found = {"identify_s": times["identify"], "samples_bytes": samples}
    for kind, kept in settings.items():
        found[f"{kind}_s"] = times[kind]
        found[f"{kind}_over_identify"] = times[kind] / times["identify"]
        found[f"{kind}_bytes"] = summed(**kept).byte_count
    show(name, found)
    return found


KINDS = {f.__name__: f for f in (lengths, questions, cost)}


def show(name: str, figures: dict[str, Any]) -> None:
    print(f"{name:<36} " + "  ".join(f"{key} {value:.4g}" for key, value in figures.items()))
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--point", choices=LENGTHS, help="measure these first calls only")
    parser.add_argument("--only", nargs="*", default=[], choices=KINDS, help="parts")
    arguments = parser.parse_args()
    start_jax()
    if arguments.point:
        print(json.dumps(first_calls(arguments.point)))
        return
    found = json.loads(FILE.read_text()) if arguments.only and FILE.exists() else {}
    for name in arguments.only or KINDS:
        found[name] = KINDS[name]()
    write_json(FILE, found)


if __name__ == "__main__":
    main()

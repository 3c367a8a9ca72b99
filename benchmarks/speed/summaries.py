"""What a Summary saves, and what it costs: `python -m benchmarks.speed summaries [--only ...]`.

- `questions`: other known values, intervals and bands from one Summary of 10^6 samples, against
  `identify` of all samples anew, with the largest relative difference of the two.
- `cost`: seconds of `summarise` against all of `identify`, and bytes of what it keeps, for the
  paper's record and for 10^6 samples.

Writes benchmarks/summaries.json.
"""

import json
import sys
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from benchmarks.recorded import FOLDER, write_json
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


KINDS = {f.__name__: f for f in (questions, cost)}


def show(name: str, figures: dict[str, Any]) -> None:
    print(f"{name:<36} " + "  ".join(f"{key} {value:.4g}" for key, value in figures.items()))
    sys.stdout.flush()


def main(only: tuple[str, ...] = tuple(KINDS)) -> None:
    start_jax()
    found = json.loads(FILE.read_text()) if FILE.exists() else {}
    for name in only:
        found[name] = KINDS[name]()
    write_json(FILE, found)

"""What sensor noise does to answers, and whether intervals know. Written to sensor_noise.json.

    python -m benchmarks.calibration sensor_noise [--only PROBLEM] [--seeds N] [--noise none]

`drag`, `quarter-car`, `hidden-cars` and `coulomb` are noisy recordings whose truth is known;
`--page` writes the tables of docs/sensor_noise.md.
Every recording is identified by itself, as a user would, with nothing said but the model.

Each figure stands beside what is asked of it and whether that is met, with its Monte Carlo standard
error. It is `clearly_missed` more than three of those beyond: then `--check`, which takes few
seeds and writes nothing, exits with 1. A bias is in units of the estimate's own standard deviation.
"""

import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tests.machines import DRAG, DRAG_BOUND, noisy

import riecjax as rx
from benchmarks.calibration import noise_problems as problems
from benchmarks.calibration import noise_table
from benchmarks.calibration.noise_answers import (
    FEWEST,
    Fits,
    Run,
    accuracy,
    answered,
    coverage,
    fit_all,
    identified,
    judged,
)
from benchmarks.recorded import FOLDER, write_json

POSITION_BOUND = (0.00181, 0.0293, 0.0144, 0.00153)
"""As `DRAG_BOUND`, of position alone."""
MOST_ROADS = 200
MOST_SHIFT = 0.5
"""Standard errors by which noise may move the mean of a parameter of hidden cars."""
OUT = FOLDER / "sensor_noise.json"


def drag(run: Run) -> dict[str, Any]:
    """With velocity and by position alone: the linear stage, and the final answer."""
    model = rx.find_model("drag-oscillator")
    report: dict[str, Any] = {}
    for velocity, label in ((True, "with velocity"), (False, "position only")):
        of = report[label] = {}
        for noise in (0.001, 0.01, 0.05, 0.2):

            def all_of(seeds: int, noise: float = noise, velocity: bool = velocity) -> Any:
                seen = ("x", "dx", "u") if velocity else ("x", "u")
                return (DRAG.record(noise, seed).select(*seen) for seed in range(seeds))

            bound = problems.drag_bound(noise, velocity=velocity)
            asked = {
                "bias": 0.4 if noise == 0.2 else 0.2,
                "ratio": (3.0, 0.0),
                "pooled": (0.92, 0.98),
            }
            if not velocity:
                asked = {"bias": 0.25, "ratio": (2.5, 0.0), "pooled": (0.9, 0.98)}
            linear = fit_all(all_of(run.seeds), identified(model, run))
            final = fit_all(all_of(run.final_seeds), answered(model, run))
            of[f"{100 * noise:g} %"] = {
                "bound_percent": (100 * bound / list(DRAG.truth.values())).tolist(),
                "linear": accuracy(linear, DRAG.truth, bound=bound, **asked),
                "final": accuracy(
                    final, DRAG.truth, bound=bound, ratio=(1.1, 2.0), pooled=(0.92, 0.97)
                ),
            }
        published = list(DRAG_BOUND.values()) if velocity else POSITION_BOUND
        off = problems.drag_bound(0.05, velocity=velocity) / list(DRAG.truth.values())
        of["bound, off the published"] = judged(np.max(np.abs(off / published - 1)), 0.005)
    return report


def quarter_car(run: Run) -> dict[str, Any]:
    """The reduced model on sensors of the source model, against the same roads without noise."""
    model = rx.find_model("quarter-car")
    fit = identified(model, run)
    report: dict[str, Any] = {}
    for car in problems.CARS:
        roads = problems.car_roads(car, min(run.seeds, MOST_ROADS))

        def records(noise: float, roads: list[Any] = roads) -> list[rx.Record]:
            shares = dict.fromkeys(problems.CAR_SENSORS, noise)
            drawn = (noisy(r, shares, seed) for seed, r in enumerate(roads))
            return [rx.Record.from_samples(one, time_step=0.005) for one in drawn]

        exact = records(0.0)
        clean = fit_all(exact, identified(model, run))
        # What the criterion converges to: all roads' sums in one solve.
        target = np.asarray(rx.identify(model, exact, intervals=rx.Naive(), **run.options).theta)
        of = report[car] = {"converges_to": dict(zip(clean.names, target.tolist()))}
        hits = clean.covers(target)
        of["0 %"] = {"coverage": coverage(hits, clean.names, (0.93, 0.97), (0.9, 1.0))}
        for noise in (0.01, 0.05, 0.2):
            found = fit_all(records(noise), fit)
            of[f"{100 * noise:g} %"] = {
                "refused": judged(found.refused, 0),
                "shift": shifts(found, clean, 0.4 if noise == 0.2 else 0.2),
                "coverage": coverage(found.covers(target), found.names, (0.93, 0.97), (0.9, 1.0)),
            }
    return report


def shifts(found: Fits, clean: Fits, most: float | None) -> dict[str, dict[str, Any]]:
    """By how many standard errors noise moves each parameter from that of the same road without."""
    shift = (found.theta - clean.theta[found.kept]) / found.errors
    errors = shift.std(axis=0) / np.sqrt(len(shift))
    each = zip(found.names, shift.mean(axis=0), errors)
    return {name: judged(mean, most, most and -most, error) for name, mean, error in each}


def hidden_cars(run: Run) -> dict[str, Any]:
    """Cars of random masses, which hide their engines, against the same roads without noise.

    With the noise judged and given, with and without recorded accelerations, and with the engine
    as a hidden mode.
    """
    roads = problems.hidden_car_roads(max(FEWEST, run.seeds // 5))
    plain = rx.find_model("quarter-car")
    engine = plain.with_elements(rx.HiddenMode("x4"))
    every = (*problems.CAR_SENSORS, *problems.ACCELERATIONS)
    report: dict[str, Any] = {}
    for label, model, sensors in (
        ("reduced", plain, problems.CAR_SENSORS),
        ("reduced, accelerations", plain, every),
        ("with a mode", engine, problems.CAR_SENSORS),
    ):
        exact = [{name: road[name] for name in sensors} for road in roads]
        clean = fit_all((rx.Record(one, 0.005) for one in exact), identified(model, run))
        of = report[label] = {}
        for noise in (0.01, 0.05, 0.2):
            # 20 % is reported: a mode drowns in it.
            most = None if noise == 0.2 else MOST_SHIFT
            for way in ("judged", "given"):
                fits = []
                for seed, one in enumerate(exact):
                    shares = dict.fromkeys(sensors, noise)
                    measured = rx.Record(noisy(one, shares, seed), 0.005)
                    said = {name: noise * np.std(values) for name, values in one.items()}
                    options = run.options if way == "judged" else {"noise": said}
                    fits.append(partial(rx.identify, model, measured, **options))
                found = fit_all(fits, lambda fit: fit())
                of[f"{100 * noise:g} %, {way}"] = {
                    "refused": judged(found.refused, None if most is None else 0),
                    "shift": shifts(found, clean, most),
                }
    return report


def coulomb(run: Run) -> dict[str, Any]:
    """Dry friction from position and force: noise on the first, on both; a sign written by hand.

    The final answer, and the linear stage below it.
    """
    signals, report = problems.dry_motion(), {}
    for label, model, sensors, share in (
        ("position", problems.DRY_BY_BASIS, ("x",), 4),
        ("position and force", problems.DRY_BY_BASIS, ("x", "u"), 16),
        ("position, own sign", problems.DRY_BY_SIGN, ("x",), 16),
    ):
        seeds = max(FEWEST, run.seeds // share)
        for noise in (0.01, 0.05):
            shares = dict.fromkeys(sensors, noise)
            drawn = partial(problems.recordings, signals, shares, problems.DRY_STEP, seeds)
            report[f"{label}, {100 * noise:g} %"] = {
                "linear": accuracy(fit_all(drawn(), identified(model, run)), problems.DRY),
                "final": accuracy(
                    fit_all(drawn(), answered(model, run)), problems.DRY, each=(0.9, 0.99)
                ),
            }
    return report


PROBLEMS: dict[str, Callable[[Run], dict[str, Any]]] = {
    "drag": drag,
    "quarter-car": quarter_car,
    "hidden-cars": hidden_cars,
    "coulomb": coulomb,
}


def figures_of(report: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every judged figure of a report, with its path."""
    if isinstance(report, dict):
        if "met" in report:
            yield " / ".join(path), report
        else:
            for name, part in report.items():
                yield from figures_of(part, (*path, name))


def show(problem: str, report: dict[str, Any]) -> int:
    """Print what misses what is asked; return how many clearly do."""
    asked = [
        one for one in figures_of(report, (problem,)) if any(e is not None for e in one[1]["asked"])
    ]
    for path, figure in asked:
        if not figure["met"]:
            ends = " to ".join(f"{end:g}" for end in figure["asked"] if end is not None)
            value = f"{figure['value']:9.3g} +- {figure['standard_error']:.2g}"
            verdict = "CLEARLY" if figure["clearly_missed"] else ""
            print(f"{path:68}{value:22} asked {ends:14}{verdict}")
    met, clearly = (sum(one[key] for _, one in asked) for key in ("met", "clearly_missed"))
    print(f"{problem}: {met} of {len(asked)} met, {clearly} clearly missed")
    return clearly


def main(
    only: tuple[str, ...] = tuple(PROBLEMS),
    seeds: int = 0,
    noise: str = "auto",
    check: bool = False,
    page: bool = False,
    out: Path = OUT,
) -> int:
    """`seeds` are those of the noise of `drag`; other problems take a share."""
    if page:
        noise_table.PAGE.write_text(noise_table.page(), encoding="utf-8")
        return 0
    rx.start_jax()
    run = Run(seeds or (40 if check else 400), noise)
    document = json.loads(out.read_text()) if out.exists() else {}
    missed = 0
    for problem in only:
        began = time.perf_counter()
        report = PROBLEMS[problem](run)
        seconds = time.perf_counter() - began
        missed += show(problem, report)
        print(f"{problem}: {seconds:.0f} s", flush=True)
        if not check:
            entry = {"seeds": run.seeds, "seconds": seconds, **report}
            document.setdefault(run.noise, {})[problem] = entry
            write_json(out, document)
    return int(check and missed > 0)

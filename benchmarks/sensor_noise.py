"""What sensor noise does to answers, and whether intervals know. Written to sensor_noise.json.

    python -m benchmarks.sensor_noise [problem ...] [--seeds N] [--noise none] [--check]

`drag`, `quarter-car`, `coulomb` and `duffing` are noisy recordings whose truth is known; `ways`
are batches and files of the first; `choice` is the default test function against others; `clean`
what the correction for noise does where there is none; `cost` its seconds; `figure` a picture.
Every recording is identified by itself, as a user would, with nothing said but the model.

Each figure stands beside what is asked of it and whether that is met, with its Monte Carlo standard
error. It is `clearly_missed` more than three of those beyond: then `--check`, which takes few
seeds and writes nothing, exits with 1. A bias is in units of the estimate's own standard deviation.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

import riecjax as rx
from benchmarks import drag_problem, noise_picture
from benchmarks import noise_problems as problems
from benchmarks.noise_answers import (
    CORRECTS,
    FEWEST,
    Run,
    accuracy,
    answered,
    coverage,
    fit_all,
    identified,
    judged,
)
from benchmarks.writing import write_json
from riecjax.records.record import stack_records

POSITION_BOUND = (0.00181, 0.0293, 0.0144, 0.00153)
"""As `drag_problem.BOUND`, of position alone."""
MOST_ROADS = 200
OUT = Path(__file__).parent / "sensor_noise.json"


def drag(run: Run) -> dict[str, Any]:
    """With velocity and by position alone: the linear stage, and the final answer."""
    model = rx.find_model("drag-oscillator")
    report: dict[str, Any] = {}
    for velocity, label in ((True, "with velocity"), (False, "position only")):
        of = report[label] = {}
        for noise in (0.001, 0.01, 0.05, 0.2):

            def all_of(seeds: int, noise: float = noise, velocity: bool = velocity) -> Any:
                drawn = (problems.drag_signals(s, noise, velocity=velocity) for s in range(seeds))
                return (problems.as_recorded(model, one, 0.01) for one in drawn)

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
                "bound_percent": (100 * bound / list(drag_problem.TRUTH.values())).tolist(),
                "linear": accuracy(linear, drag_problem.TRUTH, bound=bound, **asked),
                "final": accuracy(
                    final, drag_problem.TRUTH, bound=bound, ratio=(1.1, 2.0), pooled=(0.92, 0.97)
                ),
            }
        published = list(drag_problem.BOUND.values()) if velocity else POSITION_BOUND
        off = problems.drag_bound(0.05, velocity=velocity) / list(drag_problem.TRUTH.values())
        of["bound, off the published"] = judged(np.max(np.abs(off / published - 1)), 0.005)
    return report


def ways(run: Run, seeds: int = 8) -> dict[str, Any]:
    """Largest distance in standard errors, of a batch and of files, from records one by one.

    Of the batch with noise that is given: under `vmap` it is judged by differences alone.
    """
    model = rx.find_model("drag-oscillator")
    drawn = [problems.drag_signals(seed, 0.05, velocity=True) for seed in range(seeds)]
    records = [problems.as_recorded(model, one, 0.01) for one in drawn]
    files = [problems.as_recorded(model, one, 0.01, by_file=True) for one in drawn]
    clean = problems.drag_signals(None, 0.0, velocity=True)
    stated = {"noise": {name: 0.05 * clean[name].std() for name in ("x", "dx")}}
    by_itself = identified(model, run)
    given = identified(model, Run(run.seeds, "auto"), **(stated if CORRECTS else {}))
    vmapped = jax.vmap(lambda arrays: given(rx.Record(arrays, 0.01)).theta)(
        stack_records(records).arrays
    )

    def apart(theta: Any, fit: Callable[[Any], Any]) -> dict[str, Any]:
        alone = fit_all(records, fit)
        return judged(np.max(np.abs(theta - alone.theta) / alone.errors), 1e-3)

    return {
        "vmapped": apart(np.asarray(vmapped), given),
        "by_file": apart(fit_all(files, by_itself).theta, by_itself),
    }


def quarter_car(run: Run) -> dict[str, Any]:
    """The reduced model on sensors of the source model, against the same roads without noise."""
    model = rx.find_model("quarter-car")
    fit = identified(model, run)
    report: dict[str, Any] = {}
    for car in problems.CARS:
        roads = problems.car_roads(car, min(run.seeds, MOST_ROADS))

        def records(noise: float, roads: list[Any] = roads) -> list[rx.Record]:
            shares = dict.fromkeys(problems.CAR_SENSORS, noise)
            drawn = (problems.noisy(r, shares, seed) for seed, r in enumerate(roads))
            return [problems.as_recorded(model, one, 0.005) for one in drawn]

        exact = records(0.0)
        clean = fit_all(exact, identified(model, run))
        # What the criterion converges to: all roads' sums in one solve.
        target = np.asarray(rx.identify(model, exact, intervals=rx.Naive(), **run.options).theta)
        of = report[car] = {"converges_to": dict(zip(clean.names, target.tolist()))}
        hits = clean.covers(target)
        of["0 %"] = {"coverage": coverage(hits, clean.names, (0.93, 0.97), (0.9, 1.0))}
        for noise in (0.01, 0.05, 0.2):
            found = fit_all(records(noise), fit)
            shift = (found.theta - clean.theta[found.kept]) / found.errors
            most = 0.4 if noise == 0.2 else 0.2
            errors = shift.std(axis=0) / np.sqrt(len(shift))
            of[f"{100 * noise:g} %"] = {
                "refused": judged(found.refused, 0),
                "shift": {
                    n: judged(s, most, -most, e)
                    for n, s, e in zip(found.names, shift.mean(axis=0), errors)
                },
                "coverage": coverage(found.covers(target), found.names, (0.93, 0.97), (0.9, 1.0)),
            }
    return report


def coulomb(run: Run) -> dict[str, Any]:
    """Dry friction from position and force: noise on the first, on both; a sign written by hand.

    The final answer, and the linear stage below it.
    """
    signals, report = problems.dry_motion(), {}
    for label, model, noisy, share in (
        ("position", problems.DRY_BY_BASIS, ("x",), 4),
        ("position and force", problems.DRY_BY_BASIS, ("x", "u"), 16),
        ("position, own sign", problems.DRY_BY_SIGN, ("x",), 16),
    ):
        seeds = max(FEWEST, run.seeds // share)
        for noise in (0.01, 0.05):
            shares = dict.fromkeys(noisy, noise)
            drawn = partial(problems.recordings, model, signals, shares, problems.DRY_STEP, seeds)
            report[f"{label}, {100 * noise:g} %"] = {
                "linear": accuracy(fit_all(drawn(), identified(model, run)), problems.DRY),
                "final": accuracy(
                    fit_all(drawn(), answered(model, run)), problems.DRY, each=(0.9, 0.99)
                ),
            }
    return report


def duffing(run: Run) -> dict[str, Any]:
    """Median relative norm of the error in percent, of the linear stage and of the final answer."""
    model, report = problems.FREE_DUFFING, {}
    true = np.array(list(problems.DUFFING.values()))
    for count, asked in ((401, 0.25), (1001, 0.15), (2001, 0.09)):

        def norms(fit: Callable[[Any], Any], most: float | None, count: int = count) -> Any:
            signals, step = problems.duffing_motion(count), 20 / (count - 1)
            shares = dict.fromkeys(signals, 0.05)
            found = fit_all(problems.recordings(model, signals, shares, step, run.final_seeds), fit)
            norm = problems.relative_norms(found.theta - true, problems.DUFFING)
            # The standard error of a median, were it normal, is 1.25 times a mean's.
            error = 1.25 * norm.std() / np.sqrt(norm.size)
            return {**judged(np.median(norm), most, None, error), "refined": found.refined}

        report[f"{count} samples"] = {
            "seeds": run.final_seeds,
            "bound": problems.duffing_bound(count, 0.05),
            "linear": norms(identified(model, run), None),
            "final": norms(answered(model, run), asked),
        }
    return report


def choice(run: Run) -> dict[str, Any]:
    """Error of what `--test-function auto` takes for a missing velocity, over that of choices made
    by hand: hats and bumps of several lengths."""
    made = {
        f"{function.name}, {alpha:g} to {beta:g} s": rx.RIEC(rx.AllWindows(alpha, beta), function)
        for function in (rx.Hat(), rx.Bump(lengths=8))
        for alpha, beta in ((0.06, 0.5), (0.25, 1.0), (0.25, 2.0), (0.5, 2.0), (1.0, 4.0))
    }
    drag, report = rx.find_model("drag-oscillator"), {}
    for label, model, truth, signals, step, levels in (
        (
            "drag",
            drag,
            drag_problem.TRUTH,
            problems.drag_signals(None, 0.0, velocity=False),
            1 / drag_problem.RATE,
            (0.001, 0.01, 0.05, 0.2),
        ),
        ("linear", *problems.linear_motion(), (0.001, 0.01, 0.05, 0.2)),
        (
            "friction",
            problems.DRY_BY_BASIS,
            problems.DRY,
            problems.dry_motion(),
            problems.DRY_STEP,
            (0.01,),
        ),
    ):
        for noise in levels:
            given = partial(
                problems.recordings, model, signals, {"x": noise}, step, run.final_seeds
            )

            def error(fit: Callable[[Any], Any], given: Any = given, truth: Any = truth) -> float:
                """Root mean square of relative errors, the geometric mean of all parameters."""
                found = fit_all(given(), fit)
                if found.refused:
                    return np.inf
                off = found.theta / [truth[name] for name in found.names] - 1
                return float(np.exp(np.mean(np.log(np.mean(off**2, axis=0)) / 2)))

            by_hand = {n: error(identified(model, run, criterion=c)) for n, c in made.items()}
            best = min(by_hand, key=lambda name: by_hand[name])
            own = error(identified(model, run))
            report[f"{label}, {100 * noise:g} %"] = {
                "best": best,
                "over_best": judged(own / by_hand[best], 1.3),
                "by_hand": {name: e / by_hand[best] for name, e in by_hand.items()},
            }
    return report


def clean(run: Run) -> dict[str, Any]:
    """Without noise: what the correction and what finer integrals change, in standard errors."""
    uncorrected = Run(run.seeds, "none")
    roads = problems.car_roads("paper", FEWEST)
    drag_clean = [problems.drag_signals(None, 0.0, velocity=True)]
    report = {}
    for name, drawn, step in (("drag-oscillator", drag_clean, 0.01), ("quarter-car", roads, 0.005)):
        model = rx.find_model(name)
        records = [problems.as_recorded(model, one, step) for one in drawn]
        plain = fit_all(records, identified(model, uncorrected))
        band = model.band or (1.0, 10.0)
        orders = {
            order: fit_all(
                records,
                identified(model, uncorrected, criterion=rx.RIEC.of_band(band, rx.Boxcar(order))),
            )
            for order in (2, 4)
        }

        def change(one: Any, other: Any, plain: Any = plain) -> Iterator[tuple[str, float]]:
            moved = np.mean(np.abs(one.theta - other.theta) / plain.errors, axis=0)
            return zip(plain.names, moved.tolist())

        report[name] = {"records": len(records)}
        report[name]["order 4 for 2"] = dict(change(orders[4], orders[2]))
        if CORRECTS:
            corrected = fit_all(records, identified(model, Run(run.seeds, "auto")))
            report[name]["correction"] = {n: judged(c, 0.1) for n, c in change(corrected, plain)}
    return report


def cost(run: Run, repeats: int = 41) -> dict[str, Any]:
    """Warm seconds to identify, medians, with the correction and without in turn."""
    report: dict[str, Any] = {}
    ways = ("none", "auto") if CORRECTS else ("none",)
    for count, times in ((8000, repeats), (1_000_000, 11), (10_000_000, 3)):
        for name, record in long_records(count).items():
            model, seconds = rx.find_model(name), {way: [] for way in ways}
            fits = {way: identified(model, Run(run.seeds, way)) for way in ways}
            for i in range(times + 1):
                for way, fit in fits.items():
                    began = time.perf_counter()
                    jax.block_until_ready(fit(record).theta)
                    seconds[way] += [time.perf_counter() - began] if i else []  # the first compiles
            medians = {way: float(np.median(taken)) for way, taken in seconds.items()}
            own: dict[str, Any] = {"seconds": medians}
            report[f"{name}, {count} samples"] = own
            if CORRECTS:
                # Each pair ran side by side, under the same load.
                own["ratio"] = float(np.median(np.divide(seconds["auto"], seconds["none"])))
    return report


def long_records(count: int) -> dict[str, rx.Record]:
    """Of so many samples, with 1 % noise."""
    t = np.arange(count) / drag_problem.RATE
    driven = rx.Record.from_samples({"u": drag_problem.force(t)}, time_step=1 / drag_problem.RATE)
    system = rx.find_model("drag-oscillator").build_system({})
    source = rx.find_model("quarter-car-source").build_system({})
    made = {
        "drag-oscillator": (rx.simulate(system, driven).record, ("x", "dx"), ("u",)),
        "quarter-car": (
            problems.car_motion(jax.random.key(0), source, count),
            problems.CAR_SENSORS,
            (),
        ),
    }
    found = {}
    for name, (record, sensors, exact) in made.items():
        signals = {n: np.asarray(record[n]) for n in (*sensors, *exact)}
        noisy = problems.noisy(signals, dict.fromkeys(sensors, 0.01), 0)
        found[name] = rx.Record.from_samples(noisy, time_step=float(record.time_step))
    return found


PROBLEMS: dict[str, Callable[[Run], dict[str, Any]]] = {
    "drag": drag,
    "ways": ways,
    "quarter-car": quarter_car,
    "coulomb": coulomb,
    "duffing": duffing,
    "choice": choice,
    "clean": clean,
    "cost": cost,
    "figure": noise_picture.draw,
}
CHECKED = ("drag", "ways", "quarter-car", "coulomb", "duffing", "clean")


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


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("problem", nargs="*", help=f"of {', '.join(PROBLEMS)}; all by default")
    parser.add_argument("--seeds", type=int, help="of the noise of `drag`; others take a share")
    parser.add_argument("--noise", choices=("auto", "none"), default="auto")
    parser.add_argument("--check", action="store_true", help="few seeds; fail if clearly missed")
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    chosen = arguments.problem or (CHECKED if arguments.check else tuple(PROBLEMS))
    if unknown := set(chosen) - set(PROBLEMS):
        parser.error(f"unknown problem {', '.join(unknown)}; there are {', '.join(PROBLEMS)}.")
    rx.start_jax()
    run = Run(arguments.seeds or (40 if arguments.check else 400), arguments.noise)
    # A library that does not correct answers as one that is told not to.
    stands_for = run.noise if CORRECTS else "none"
    document = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    missed = 0
    for problem in chosen:
        began = time.perf_counter()
        report = PROBLEMS[problem](run)
        seconds = time.perf_counter() - began
        missed += show(problem, report)
        print(f"{problem}: {seconds:.0f} s", flush=True)
        if not arguments.check:
            entry = {"seeds": run.seeds, "seconds": seconds, **report}
            document.setdefault(stands_for, {})[problem] = entry
            write_json(arguments.out, document)
    return int(arguments.check and missed > 0)


if __name__ == "__main__":
    raise SystemExit(main())

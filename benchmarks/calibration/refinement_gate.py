"""When `refine="auto"` takes the refined values.

    python -m benchmarks.calibration refinement_gate [--seeds N] [--only CASE] [--work]

Shares of noise seeds in which output error is chosen, for models that are right and for one that is
not, with white noise of 0.1 to 20 % of each signal's deviation on every sensor (not on the input,
which is a command):

- `drag`: the oscillator of tests/machines.py, position and velocity recorded;
- `drag, position`: position alone, its velocity by local polynomials as of `riecjax identify`;
- `car`: the quarter car's identification model on 20 s of white noise, all its sensors;
- `upright`: a pendulum that a noisy controller holds upright, refined over windows;
- `reduced car`: the same model on the motion of the source model, whose engine it lacks.

Beside each: the largest whiteness statistic that was seen, why the others were declined, and of the
right models the root mean square of (refined - truth) / standard error. `--work` measures the
seconds of an expansion over its counted work (`OutputMisfit.work`) instead. Written to
benchmarks/refinement_gate.json.
"""

import argparse
import collections
import functools
import time
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tests.machines import (
    DRAG,
    STANDARD,
    UPRIGHT,
    UPRIGHT_TRUTH,
    car_signals,
    noisy,
    upright_signals,
)

import riecjax as rx
from benchmarks.recorded import FOLDER, write_json
from riecjax.records.preparation import with_local_derivative
from riecjax.runtime import start_jax

FILE = FOLDER / "refinement_gate.json"
NOISE = (0.001, 0.01, 0.05, 0.2)
CAR = {
    "K_t": 180e3,
    "M_us": 30.0,
    "M_s": 300.0,
    "K_s": 20e3,
    "F_1": -1200.0,
    "F_2": -800.0,
    "F_3": 800.0,
    "F_4": 1100.0,
}
Case = tuple[str, Mapping[str, np.ndarray], float, tuple[str, ...], Mapping[str, float] | None]
"""Model, signals without noise, time step, commands, and the truth if the model is right."""


def drag() -> Case:
    return "drag-oscillator", DRAG.signals(), DRAG.shape.step, ("u",), DRAG.truth


def drag_position() -> Case:
    model, signals, step, commands, truth = drag()
    return model, {name: signals[name] for name in ("u", "x")}, step, commands, truth


def car() -> Case:
    return "quarter-car", car_signals("quarter-car", CAR), STANDARD.step, ("v_r",), CAR


def reduced_car() -> Case:
    return "quarter-car", car_signals("quarter-car-source"), STANDARD.step, ("v_r",), None


def upright() -> Case:
    return "upright", upright_signals(), 0.01, ("torque",), UPRIGHT_TRUTH


CASES: dict[str, tuple[Callable[[], Case], int]] = {
    "drag": (drag, 100),
    "drag, position": (drag_position, 50),
    "car": (car, 10),
    "upright": (upright, 50),
    "reduced car": (reduced_car, 10),
}
"""Each with the number of its seeds."""


def model_of(case: Case) -> Any:
    return UPRIGHT if case[0] == "upright" else rx.find_model(case[0])


def recording(case: Case, noise: float, seed: int) -> rx.Record:
    _, signals, step, commands, _ = case
    shares = {name: noise for name in signals if name not in commands}
    record = rx.Record.from_samples(noisy(signals, shares, 900 + seed), time_step=step)
    for name, of in getattr(model_of(case), "derived", {}).items():
        if name not in signals and of in record.arrays:
            record, _ = with_local_derivative(record, of, name)
    return record


def assessed(case: Case, noise: float, seed: int) -> rx.Assessment:
    record = recording(case, noise, seed)
    return rx.assess(model_of(case), record, sweep=False, intervals=rx.Sandwich())


def shares(case: Case, noise: float, seeds: int) -> dict[str, Any]:
    chosen, largest, declined, off = 0, [], collections.Counter(), []
    for seed in range(seeds):
        try:
            refinement = assessed(case, noise, seed).refinement
        except rx.IdentifiabilityError:
            declined["neither windows nor refinement answer"] += 1
            continue
        assert refinement is not None
        chosen += refinement.chosen
        if refinement.whiteness is not None:
            largest.append(refinement.whiteness.largest)
        if refinement.declined:
            declined[" ".join(refinement.declined.split()[:6])] += 1
        truth, refined = case[-1], refinement.refined
        if truth is not None and refined is not None and refinement.chosen:
            errors = zip(refined.parameters, np.asarray(refined.standard_errors))
            off.append([(float(refined[name]) - truth[name]) / float(e) for name, e in errors])
    return {
        "seeds": seeds,
        "chosen": chosen / seeds,
        "whiteness": {"least": min(largest, default=None), "most": max(largest, default=None)},
        "declined": dict(declined),
        "rms_error_over_std_error": np.sqrt(np.mean(np.square(off), axis=0)).tolist()
        if off
        else [],
    }


def seconds_per_work() -> dict[str, float]:
    """Warm seconds of an expansion over its steps x states x tangents."""
    from riecjax.assessment import refining

    found = {}
    for name in ("drag", "car", "upright"):
        case = CASES[name][0]()
        record = recording(case, 0.01, 0)
        model = model_of(case)
        by = refining.OutputError()
        specified = by.specify(model, [record], dict(case[-1] or {}), {}, (), None)
        misfit = by.misfit(specified)
        expand = jax.jit(lambda m, t, i: m.expansion(t, i).moments())
        arguments = (misfit, jnp.asarray(specified.theta), misfit.first_initial())
        jax.block_until_ready(expand(*arguments))
        began = time.perf_counter()
        for _ in range(5):
            jax.block_until_ready(expand(*arguments))
        taken = (time.perf_counter() - began) / 5
        found[name] = taken / misfit.work
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", action="store_true")
    parser.add_argument("--once", action="store_true", help="compile as for small files")
    parser.add_argument("--seeds", type=int, help="fewer of them, for a look")
    parser.add_argument("--only", choices=CASES)
    arguments = parser.parse_args()
    start_jax(once=arguments.once, keep_compiled=True)
    if arguments.work:
        print(seconds_per_work())
        return
    document: dict[str, Any] = {}
    for name, (build, seeds) in CASES.items():
        if arguments.only not in (None, name):
            continue
        case = functools.cache(build)()
        for noise in (0.0, *NOISE) if case[-1] is None else NOISE:
            count = min(seeds, arguments.seeds or seeds) if noise else 1
            document.setdefault(name, {})[f"{100 * noise:g} %"] = shares(case, noise, count)
            print(name, f"{100 * noise:g} %", document[name][f"{100 * noise:g} %"], flush=True)
    if arguments.only is None and arguments.seeds is None:
        write_json(FILE, document)


if __name__ == "__main__":
    main()

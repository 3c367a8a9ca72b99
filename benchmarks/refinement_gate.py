"""When `refine="auto"` takes the refined values: `python -m benchmarks.refinement_gate`.

Shares of noise seeds in which output error is chosen, for models that are right and for one that is
not, with white noise of 0.1 to 20 % of each signal's deviation on every sensor (not on the input,
which is a command):

- `drag`: the oscillator of benchmarks/drag_problem.py, position and velocity recorded;
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
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import riecjax as rx
from benchmarks import drag_problem
from benchmarks.writing import write_json
from riecjax.records.preparation import with_local_derivative
from riecjax.runtime import start_jax

FILE = Path(__file__).with_suffix(".json")
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
PENDULUM = {"p1": 20.0, "p2": 0.3}
UPRIGHT = rx.Equation(
    rx.Term(1.0, "theta", derivative=2, measured=("dtheta", "ddtheta")),
    -rx.Term("p1", lambda signals: jnp.sin(signals["theta"]), unit="1/s^2"),
    rx.Term("p2", "theta", derivative=1, measured=("dtheta",), unit="1/s"),
    -rx.Term(1.0, "torque"),
    name="upright",
)
Case = tuple[str, Mapping[str, np.ndarray], float, tuple[str, ...], Mapping[str, float] | None]
"""Model, signals without noise, time step, commands, and the truth if the model is right."""


def drag() -> Case:
    return (
        "drag-oscillator",
        drag_problem.signals(),
        1 / drag_problem.RATE,
        ("u",),
        drag_problem.TRUTH,
    )


def drag_position() -> Case:
    model, signals, step, commands, truth = drag()
    return model, {name: signals[name] for name in ("u", "x")}, step, commands, truth


def _car(model: str, parameters: Mapping[str, float], truth: Mapping[str, float] | None) -> Case:
    step = 0.005
    road = rx.simulation.band_limited_noise(jax.random.key(1), 4000, step, bandwidth=30.0, rms=0.55)
    system = rx.find_model(model).build_system(parameters)
    run = rx.simulate(system, rx.Record({"v_r": road}, step)).record
    names = ("v_r", "x1", "x2", "x3", "x4", "dx3", "dx4", "F_t")
    return "quarter-car", {n: np.asarray(run[n]) for n in names}, step, ("v_r",), truth


def car() -> Case:
    return _car("quarter-car", CAR, CAR)


def reduced_car() -> Case:
    return _car("quarter-car-source", {}, None)


def upright() -> Case:
    """A pendulum held upright for 10 s, by a controller that is shaken."""
    step, fine, count = 0.01, 20, 1000
    rng = np.random.default_rng(3)
    times = np.arange(count) * step
    tones = [(w, rng.uniform(0, 6)) for w in (1.9, 4.3, 7.1, 11.0)]
    shaken = np.sum([6 * np.sin(w * times + p) for w, p in tones], axis=0)
    p1, p2 = PENDULUM.values()
    theta, rate, rows, torque = 0.05, 0.0, [], 0.0
    for i in range(count):
        # Torque at the next sample from this one's state: linear between samples, as simulated.
        following = shaken[i] - 60 * theta - 8 * rate
        rows.append((torque, theta, rate))
        state, h = np.array([theta, rate]), step / fine
        for k in range(fine):
            level = [torque + (following - torque) * (k + c) / fine for c in (0, 0.5, 1)]

            def slope(s: np.ndarray, u: float) -> np.ndarray:
                return np.array([s[1], p1 * np.sin(s[0]) - p2 * s[1] + u])

            a = slope(state, level[0])
            b = slope(state + h / 2 * a, level[1])
            c = slope(state + h / 2 * b, level[1])
            d = slope(state + h * c, level[2])
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
        (theta, rate), torque = state, following
    columns: dict[str, np.ndarray] = dict(zip(("torque", "theta", "dtheta"), np.array(rows).T))
    return "upright", columns, step, ("torque",), PENDULUM


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
    rng = np.random.default_rng(1000 + seed)
    noisy = {
        name: x if name in commands else x + noise * np.std(x) * rng.standard_normal(x.size)
        for name, x in signals.items()
    }
    record = rx.Record.from_samples(noisy, time_step=step)
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

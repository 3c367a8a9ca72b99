"""The paper's source model, found from outside: how well each step predicts. To source_model.json.

    python -m benchmarks.paper source_model [--seeds N] [--out FILE]

On white-noise roads of the paper's Table 2 the quarter car is identified from x1 to x4 and F_t, at
0 and 5 % of sensor noise: as it is (`reduced`); with a hidden mode on the body (`mode`); with that,
and a spring in series with the damper (`mode and spring`), whose stiffness is refined from the
wheel's motion alone, the damper's map staying RIEC's; and with the map that the same refinement
finds (`refined map`). Nothing is taken from the source model but its recordings.

Each model is simulated on a Robson road and over the paper's pot-hole, and its errors p_i (eq. 28)
of x1 to x4 are added up, in percent, as in Table 5. Over the pot-hole the tyre leaves the road,
which no linear tyre does: `lifting tyre` has a tyre whose force stays where it is recorded to stay.
"""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tests.machines import noisy

import riecjax as rx
from benchmarks.recorded import FOLDER, write_json
from riecjax.equations import RoofFunctions
from riecjax.models.quarter_car.identification import (
    BREAK_POINTS,
    body_equation,
    mass_equation,
    suspension_velocity,
    tyre_equation,
    tyre_velocity,
    wheel_equation,
)
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.paper.published import TABLE_2, TABLE_5
from riecjax.paper.reproduction import (
    FORCES,
    VALIDATED_STATES,
    identification_record,
    road_keys,
    validation_inputs,
)
from riecjax.refinement import ByFunction
from riecjax.validation import percentage_error

rx.start_jax()
OUT = FOLDER / "source_model.json"
NOISES = (0.0, 0.05)
SENSORS = ("x1", "x2", "x3", "x4", "F_t")
POINTS = (-1.0, -0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5, 1.0)
"""Break points of the refined map in m/s."""
STIFF = 1e6
"""K_series in N/m that refinement starts from: hardly a spring at all."""
TABLE_3_TRUTH = {"M_us": 30.0, "M_s": 200.0, "M_mode": 100.0, "K_series": 500e3}
RATES = {"x1": tyre_velocity, "x2": suspension_velocity}


def car(points: tuple[float, ...], tyre: rx.Equation) -> rx.Model:
    """The quarter car with its mode, and a spring in series with a damper of this map."""
    made = rx.staged(tyre, mass_equation(), body_equation(points)).with_rates(RATES)
    return made.with_elements(rx.HiddenMode("x4")).with_elements(rx.SeriesSpring("F_1"))


def lifting(lift: float) -> rx.Equation:
    """A tyre that pulls no further than at this deflection in m."""
    law = rx.Terms("T", RoofFunctions((-0.02, 0.0, lift, 0.05)), of="x1", unit="N")
    return rx.Equation(rx.Term(1.0, "F_t"), -law, name="tyre", unit="N")


def wheel_alone() -> ByFunction:
    """Wheel and damper between the recorded tyre force and the recorded body."""
    model = rx.staged(wheel_equation(POINTS)).with_rates({"x2": suspension_velocity})
    model = model.with_elements(rx.SeriesSpring("F_1"))
    return ByFunction(lambda values: rx.equation_system(model, values))


WHEEL = wheel_alone()
REDUCED = rx.find_model("quarter-car")
WITH_MODE = REDUCED.with_elements(rx.HiddenMode("x4"))


def models(
    record: rx.Record,
) -> tuple[dict[str, rx.simulation.AbstractSystem], dict[str, float]]:
    """Systems that predict, by what they know, and some parameters."""
    reduced, mode = rx.identify(REDUCED, record), rx.identify(WITH_MODE, record)
    forces = jnp.stack([jnp.asarray(mode[name]) for name in FORCES])
    start = {"M_us": mode["M_us"], "K_s": mode["K_s"], "K_series": STIFF}
    finer = RoofFunctions(BREAK_POINTS).interpolate(forces, jnp.asarray(POINTS))
    start |= {f"F_{i}": force for i, force in enumerate(finer, 1)}
    by = rx.OutputError(channels=("x2", "x3"))
    refined = rx.refine(WHEEL, record.select("x2", "x3", "x4", "F_t"), start, by)
    found = {**mode.values, "K_series": refined["K_series"]}
    best = {**found, **dict(refined.values)}
    road = rx.Record({"v_r": np.zeros(2)}, 1 / TABLE_2.rate)
    tyre, law = contact(record)
    systems: dict[str, rx.simulation.AbstractSystem] = {
        "reduced": REDUCED.identified_system(reduced.values, road),
        "mode": WITH_MODE.identified_system(mode.values, road),
        "mode and spring": rx.equation_system(car(BREAK_POINTS, tyre_equation()), found),
        "refined map": rx.equation_system(car(POINTS, tyre_equation()), best),
        "refined map, lifting tyre": rx.equation_system(car(POINTS, tyre), {**best, **law}),
    }
    named = {name: float(best[name]) for name in TABLE_3_TRUTH}
    return systems, named | {"M_us, reduced": float(reduced["M_us"])}


def contact(record: rx.Record) -> tuple[rx.Equation, dict[str, Any]]:
    """The tyre's law: straight up to the force that is recorded most often at its largest."""
    force, deflection = (np.asarray(record[name]) for name in ("F_t", "x1"))
    # The largest force is where the tyre hangs: noise adds to it, the median of the top does not.
    largest = np.median(force[deflection >= np.quantile(deflection, 0.995)])
    near = force < 0.8 * largest
    stiffness = np.sum(force[near] * deflection[near]) / np.sum(deflection[near] ** 2)
    lift = float(largest / stiffness)
    law = {"T_1": -0.02 * stiffness, "T_2": 0.0, "T_3": largest, "T_4": largest}
    return lifting(lift), law


def errors(system: rx.simulation.AbstractSystem, truth: rx.Record) -> float:
    """Sum of p_1 to p_4 in percent."""
    run = rx.simulate(system, truth.select("v_r"), method=rx.FixedStep(8))
    return float(sum(percentage_error(run.record[s], truth[s]) for s in VALIDATED_STATES))


def study(seeds: int, noise: float) -> dict[str, Any]:
    """Means and standard errors over roads."""
    shapes = reconstructed()
    source = quarter_car_source(shapes=shapes)
    sums: dict[str, dict[str, list[float]]] = {"road": {}, "pothole": {}}
    parameters: dict[str, list[float]] = {}
    for seed, key in enumerate(jax.random.split(jax.random.key(181), seeds)):
        keys = road_keys(key)
        made = identification_record(source, keys.training).record
        signals = {name: np.asarray(made[name]) for name in SENSORS}
        measured = noisy(signals, dict.fromkeys(SENSORS, noise), seed)
        systems, named = models(rx.Record(measured, 1 / TABLE_2.rate))
        for name, value in named.items():
            parameters.setdefault(name, []).append(value)
        for kind, velocity in validation_inputs(keys.validation, shapes).items():
            drive = rx.Record({"v_r": velocity}, 1 / TABLE_2.rate)
            truth = rx.simulate(source, drive).record
            for name, system in systems.items():
                sums[kind].setdefault(name, []).append(errors(system, truth))
        last = {kind: {n: round(v[-1], 1) for n, v in of.items()} for kind, of in sums.items()}
        print(f"{100 * noise:g} %, road {seed + 1}: {last} {named}", flush=True)
    return {
        "sum_of_errors_percent": {
            kind: {name: _mean(values) for name, values in of.items()} for kind, of in sums.items()
        },
        "parameters": {name: _mean(values) for name, values in parameters.items()},
    }


def _mean(values: list[float]) -> dict[str, float]:
    error = np.std(values, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
    return {"mean": round(float(np.mean(values)), 4), "std_error": round(float(error), 4)}


def main(seeds: int = 12, out: Path = OUT) -> None:
    report: dict[str, Any] = {
        "roads": seeds,
        "published": {kind: TABLE_5["B_id"][kind] for kind in ("road", "pothole")},
        "truth": TABLE_3_TRUTH,
    }
    for noise in NOISES:
        report[f"{100 * noise:g} %"] = study(seeds, noise)
    write_json(out, report)

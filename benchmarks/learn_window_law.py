"""Learn the law of window lengths, w(T), that predicts other roads best, and judge it on more.

    python -m benchmarks.learn_window_law [--roads 24] [--held-out 64]

Each model is identified from the source model on a road of white noise, and predicts the source
model on a Robson road. The error that is made small is the paper's, eq. (28), summed over x1 to x4.
It is differentiated by the law's weights, through simulation of the identified model, the three
stages and all windows. Held-out roads are others of both kinds.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from benchmarks.writing import write_json
from riecjax.criteria.laws import RatioLaw
from riecjax.criteria.windows import AllWindows
from riecjax.models.quarter_car.identification import QuarterCar, quarter_car_by_body
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.published import TABLE_2
from riecjax.paper.reproduction import VALIDATED_STATES, identification_record
from riecjax.records.record import Record
from riecjax.simulation.inputs import robson_road
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate
from riecjax.studies.law_learning import (
    LearnedLaw,
    Prediction,
    as_prediction,
    learn_law,
    validation_errors,
)
from riecjax.studies.monte_carlo import over_keys

ALPHA, BETA, PARTS = 0.02, 2.0, 12
METHOD = FixedStep(6)
TRAINING_SEED, HELD_OUT_SEED = 2000, 3000
CHUNK = 8


def pair_of_roads(
    key: Key[Array, ""], source: QuarterCarSource, roughness: Array
) -> tuple[Record, Record]:
    """The source model on a road of white noise, and on a Robson road."""
    noise_key, road_key = jax.random.split(key)
    step = 1 / TABLE_2.rate
    training = identification_record(source, noise_key, method=METHOD).record
    road = robson_road(road_key, TABLE_2.sample_count, step, roughness=roughness)
    return training, simulate(source, Record({"v_r": road}, step), method=METHOD).record


def roads(seed: int, count: int) -> tuple[list[Record], list[Record]]:
    """Pairs of roads, each in a list of its own."""
    shapes = reconstructed()
    source, roughness = quarter_car_source(shapes), jnp.asarray(shapes.roughness)
    pairs = over_keys(pair_of_roads, jax.random.key(seed), count, source, roughness, chunk=CHUNK)
    training, validation = (
        [jax.tree.map(lambda leaf, i=i: leaf[i], records) for i in range(count)]
        for records in pairs
    )
    return training, validation


def judged(
    prediction: Prediction, held_out: tuple[list[Record], list[Record]], windows: AllWindows
) -> np.ndarray:
    """p_i of each state on each pair of roads, in percent."""
    training, validation = held_out
    parts = [
        validation_errors(prediction, training[i : i + CHUNK], validation[i : i + CHUNK], windows)
        for i in range(0, len(training), CHUNK)
    ]
    return np.concatenate([np.asarray(part) for part in parts])


def gain(of: np.ndarray, over: np.ndarray) -> dict[str, Any]:
    """By how many percentage points, road by road, one law's summed error is below another's."""
    by = np.sum(over, axis=1) - np.sum(of, axis=1)
    return {
        "mean": float(by.mean()),
        "standard_error": float(by.std(ddof=1) / np.sqrt(len(by))),
        "standard_deviation": float(by.std(ddof=1)),
        "share_of_roads_better": float(np.mean(by > 0)),
        "relative": float(by.mean() / np.mean(np.sum(over, axis=1))),
    }


def edges() -> np.ndarray:
    """Lengths in s at which the law's parts meet."""
    return np.geomspace(ALPHA, BETA + 1 / TABLE_2.rate, PARTS + 1)


def best_part(
    prediction: Prediction, seen: tuple[list[Record], list[Record]]
) -> tuple[RatioLaw, int]:
    """The law of the one part that alone does best where the law was learned: a length, no law."""
    laws = [RatioLaw(row) for row in np.eye(PARTS)]
    found = [judged(prediction, seen, AllWindows(ALPHA, BETA, law=law)).sum() for law in laws]
    best = int(np.nanargmin(found))
    return laws[best], best


def compared(laws: dict[str, AllWindows], prediction: Prediction, count: int) -> dict[str, Any]:
    """The laws on roads that none was learned from."""
    held_out = roads(HELD_OUT_SEED, count)
    errors = {name: judged(prediction, held_out, windows) for name, windows in laws.items()}
    return {
        "roads": count,
        "error": {
            name: {
                "sum": float(np.sum(found, axis=1).mean()),
                "scatter_over_roads": float(np.sum(found, axis=1).std(ddof=1)),
                "by_state": dict(zip(VALIDATED_STATES, found.mean(axis=0).tolist())),
            }
            for name, found in errors.items()
        },
        "gain_over_paper": gain(errors["learned"], errors["paper"]),
        "gain_over_wide": gain(errors["learned"], errors["wide"]),
        "gain_over_narrow": gain(errors["learned"], errors["narrow"]),
    }


def learn(seen: tuple[list[Record], list[Record]], starts: int, steps: int) -> dict[str, Any]:
    """The learned law, in plain data."""
    began = time.perf_counter()
    learned: LearnedLaw = learn_law(
        quarter_car_by_body(),
        *seen,
        QuarterCar.from_parameters,
        alpha=ALPHA,
        beta=BETA,
        parts=PARTS,
        signals=VALIDATED_STATES,
        key=jax.random.key(0),
        method=METHOD,
        starts=starts,
        max_steps=steps,
    )
    return {
        "band": [ALPHA, BETA],
        "edges": edges().tolist(),
        "weights": np.asarray(learned.weights).tolist(),
        "learned_from": len(seen[0]),
        "converged": bool(learned.converged),
        "steps": int(learned.steps),
        "error_from_each_start": np.asarray(learned.errors).tolist(),
        "seconds": round(time.perf_counter() - began),
    }


def printed(found: dict[str, Any]) -> None:
    """What was learned, and what it is worth."""
    for low, high, weight in zip(edges(), edges()[1:], found["weights"]):
        print(f"  {low:6.3f} to {high:6.3f} s  {weight:8.4f}  {'#' * round(40 * weight)}")
    seen, held_out = found["error_where_learned"], found["held_out"]
    for name, error in held_out["error"].items():
        print(
            f"{name:<8} {seen[name]:.2f} % where learned, {error['sum']:.2f} % on "
            f"{held_out['roads']} held-out roads, scatter {error['scatter_over_roads']:.2f}"
        )
    for rival in ("paper", "wide", "narrow"):
        by = held_out[f"gain_over_{rival}"]
        print(
            f"learned over {rival}: {by['mean']:.3f} +- {by['standard_error']:.3f} points "
            f"({100 * by['relative']:.1f} %), better on "
            f"{100 * by['share_of_roads_better']:.0f} % of the roads"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--roads", type=int, default=24, help="pairs of roads to learn from")
    parser.add_argument("--held-out", type=int, default=64, help="pairs of roads to judge on")
    parser.add_argument("--starts", type=int, default=6, help="searches")
    parser.add_argument("--steps", type=int, default=40, help="most steps of each search")
    parser.add_argument("--judge", action="store_true", help="only judge the law in --out again")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/window_law.json"))
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if arguments.judge:
        found = json.loads(arguments.out.read_text())
        seen = roads(TRAINING_SEED, found["learned_from"])
    else:
        seen = roads(TRAINING_SEED, arguments.roads)
        found = learn(seen, arguments.starts, arguments.steps)
    prediction = as_prediction(
        quarter_car_by_body(), QuarterCar.from_parameters, VALIDATED_STATES, method=METHOD
    )
    learned = RatioLaw(np.array(found["weights"]))
    narrow, part = best_part(prediction, seen)
    laws = {
        "learned": AllWindows(ALPHA, BETA, law=learned),
        "narrow": AllWindows(ALPHA, BETA, law=narrow),
        "paper": AllWindows(TABLE_2.alpha, TABLE_2.beta),
        "wide": AllWindows(ALPHA, BETA),
    }
    found["narrow"] = edges()[part : part + 2].tolist()
    found["error_where_learned"] = {
        name: float(judged(prediction, seen, windows).sum(axis=1).mean())
        for name, windows in laws.items()
    }
    found["held_out"] = compared(laws, prediction, arguments.held_out)
    printed(found)
    write_json(arguments.out, found)


if __name__ == "__main__":
    main()

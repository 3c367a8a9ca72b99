"""Do the intervals cover? Nominal 95 % intervals over many simulated roads.

    python -m benchmarks.coverage [--roads 200]

The value to cover is what the criterion converges to on an ever longer record: the solution of
the normal equations summed over all roads. (Its distance from the source's true value is bias,
which no interval from one record can know.) The textbook covariance, which takes overlapping
windows for independent, stands beside for comparison.
"""

import argparse
import json

import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Array, Key

from riecjax.estimation.identify import stage_normal_equations
from riecjax.estimation.normal_equations import NormalEquations
from riecjax.estimation.procedure import block_sandwich, solve_stages
from riecjax.models.quarter_car.equations import quarter_car_by_body, quarter_car_by_wheel
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.reproduction import TRUE_MASSES, identification_record, paper_criteria
from riecjax.studies.monte_carlo import over_keys

BLOCKS = 40
PROCEDURES = {"W": quarter_car_by_wheel, "B": quarter_car_by_body}


def one_road(key: Key[Array, ""], source: QuarterCarSource) -> dict[str, dict[str, Array]]:
    """Estimates, standard errors (block sandwich and textbook) and moments of every variant."""
    record_key, window_key = jax.random.split(key)
    record = identification_record(source, record_key).record
    criterion = paper_criteria()["RIEC"]
    results = {}
    for side, procedure in PROCEDURES.items():
        stages = stage_normal_equations(
            procedure(), record, criterion, window_key, block_count=BLOCKS
        )
        for masses, known in (("id", {}), ("true", TRUE_MASSES)):
            given = {name: jnp.asarray(value) for name, value in known.items()}
            solutions = solve_stages(stages, given)
            found = {
                name: value
                for stage in solutions
                for name, value in zip(stage.parameters, stage.solution.theta)
            }
            textbook = []
            for stage in solutions:
                total = stages[stage.stage].total().fix({**given, **found_before(stage, found)})
                variance = stage.residual_rms**2 * jnp.diagonal(jnp.linalg.inv(total.gram))
                textbook.append(jnp.sqrt(variance))
            covariance = block_sandwich(stages, solutions, given, BLOCKS)
            results[f"{side}_{masses}"] = {
                "theta": jnp.stack(list(found.values())),
                "sandwich": jnp.sqrt(jnp.diagonal(covariance)),
                "textbook": jnp.concatenate(textbook),
                "moments": [stage.total().moments for stage in stages],
            }
    return results


def found_before(stage, found: dict[str, Array]) -> dict[str, Array]:
    return {name: value for name, value in found.items() if name not in stage.parameters}


def limit(side: str, masses: str, moments: list[Array]) -> dict[str, float]:
    """What the criterion converges to: the solution of all roads' normal equations."""
    names = PROCEDURES[side]().stage_parameters
    stages = [
        NormalEquations(jnp.sum(m, axis=0)[None], jnp.ones(1), n) for m, n in zip(moments, names)
    ]
    known = TRUE_MASSES if masses == "true" else {}
    given = {name: jnp.asarray(value) for name, value in known.items()}
    return {
        name: float(value)
        for stage in solve_stages(stages, given)
        for name, value in zip(stage.parameters, stage.solution.theta)
    }


def study(roads: int, seed: int = 0) -> dict[str, dict[str, dict[str, float]]]:
    """Coverage of every parameter of every variant."""
    source = quarter_car_source(reconstructed())
    result = over_keys(one_road, jax.random.key(seed), roads, source)
    reach = {
        "sandwich": scipy.stats.t.ppf(0.975, BLOCKS - 1),
        "textbook": scipy.stats.norm.ppf(0.975),
    }
    report: dict[str, dict[str, dict[str, float]]] = {}
    for variant, arrays in result.items():
        side, masses = variant.split("_")
        target = limit(side, masses, arrays["moments"])
        report[variant] = {}
        for i, (name, value) in enumerate(target.items()):
            error = np.abs(np.asarray(arrays["theta"][:, i]) - value)
            report[variant][name] = {
                kind: float(np.mean(error < reach[kind] * np.asarray(arrays[kind][:, i])))
                for kind in reach
            }
    return report


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--roads", type=int, default=200)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    report = study(arguments.roads)
    print(json.dumps({"roads": arguments.roads, "coverage": report}, indent=2))
    for kind in ("sandwich", "textbook"):
        values = [cell[kind] for row in report.values() for cell in row.values()]
        print(f"{kind}: nominal 95 % intervals cover {min(values):.1%} to {max(values):.1%}")


if __name__ == "__main__":
    main()

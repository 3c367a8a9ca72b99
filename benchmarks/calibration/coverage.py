"""Do the intervals cover? Nominal 95 % intervals over many simulated roads.

    python -m benchmarks.calibration coverage [--roads 800]

The value to cover is what the criterion converges to on an ever longer record: the solution of the
normal equations summed over all roads. Its distance from the source's true value is bias, which no
interval from one record can know; it stands in a column of its own, in percent.

Three cases: the paper's source model, the same with white noise of 5 % of its r.m.s. on every
signal, and the reduced model itself as the source (no model error; 1 % noise on the tyre force,
without which the tyre's equation would hold to the last digit and nothing would scatter).

Beside the bootstrap stand the HAC sandwich with Student's t, and least squares' own covariance,
which takes overlapping windows for independent ones.
"""

from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

import riecjax as rx
from benchmarks.recorded import write_json
from riecjax.estimation.stages import solve_stages
from riecjax.models.quarter_car.identification import (
    quarter_car_by_body,
    quarter_car_by_wheel,
    quarter_car_system,
)
from riecjax.models.quarter_car.reconstruction import quarter_car_source
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.published import TABLE_2
from riecjax.paper.reproduction import TRUE_MASSES, identification_record
from riecjax.simulation.inputs import band_limited_noise
from riecjax.studies.monte_carlo import over_keys
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.one_pass import stage_normal_equations
from riecjax.uncertainty.intervals import Uncertainty

MODELS = {"W": quarter_car_by_wheel, "B": quarter_car_by_body}
READ = ("x1", "x2", "x3", "x4", "F_t")
WINDOWS = rx.AllWindows(TABLE_2.alpha, TABLE_2.beta, longest_samples=128)
INTERVALS = {"bootstrap": rx.BlockBootstrap(), "sandwich": rx.Sandwich(), "naive": rx.Naive()}
REDUCED = {
    "K_t": 178e3,
    "M_us": 23.2,
    "M_s": 302.7,
    "K_s": 20.7e3,
    "F_1": -1200.0,
    "F_2": -870.0,
    "F_3": 830.0,
    "F_4": 1130.0,
}
"""The reduced model as the source: about what is identified from the paper's."""


class Case(NamedTuple):
    """Where records come from, the true values, and the masses that variants "true" know."""

    make: Any
    truth: dict[str, float]
    masses: dict[str, float]

    def known(self, masses: str) -> dict[str, float]:
        """What is known of the masses: "id" or "true"."""
        return self.masses if masses == "true" else {}


class Road(NamedTuple):
    """One road, by variant: estimates, uncertainties by kind, and stages' moments."""

    theta: dict[str, Array]
    uncertainty: dict[str, dict[str, Uncertainty]]
    moments: dict[str, list[Array]]


def noisy(record: rx.Record, key: Key[Array, ""], shares: dict[str, float]) -> rx.Record:
    """White noise on signals, each of a share of its r.m.s."""
    keys = jax.random.split(key, len(READ))
    disturbed = {
        name: record[name]
        + shares.get(name, 0.0) * jnp.std(record[name]) * jax.random.normal(k, record[name].shape)
        for k, name in zip(keys, READ)
    }
    return rx.Record(disturbed, record.time_step)


def source_record(key: Key[Array, ""], source: QuarterCarSource, noise: float) -> rx.Record:
    """The paper's record, with noise on every signal."""
    record_key, noise_key = jax.random.split(key)
    record = identification_record(source, record_key).record
    return noisy(record, noise_key, dict.fromkeys(READ, noise))


def reduced_record(key: Key[Array, ""]) -> rx.Record:
    """The same from the reduced model, with noise on the tyre force."""
    road_key, noise_key = jax.random.split(key)
    step = 1 / TABLE_2.rate
    road = band_limited_noise(
        road_key, TABLE_2.sample_count, step, bandwidth=TABLE_2.bandwidth, rms=TABLE_2.rms
    )
    model = quarter_car_system({k: jnp.asarray(v) for k, v in REDUCED.items()})
    record = rx.simulate(model, rx.Record({"v_r": road}, step)).record
    return noisy(record, noise_key, {"F_t": 0.01})


def one_road(key: Key[Array, ""], case: Case) -> Road:
    """Every variant identified on one road."""
    record = case.make(key)
    criterion = rx.RIEC(WINDOWS)
    theta, uncertainty, moments = {}, {}, {}
    for side, build in MODELS.items():
        stages = stage_normal_equations(build(), record, criterion, None)
        for masses in ("id", "true"):
            variant = f"{side}_{masses}"
            found = {
                kind: rx.identify(
                    build(),
                    record,
                    criterion,
                    known=case.known(masses),
                    intervals=intervals,
                )
                for kind, intervals in INTERVALS.items()
            }
            theta[variant] = found["bootstrap"].theta
            uncertainty[variant] = {kind: each.uncertainty for kind, each in found.items()}
            moments[variant] = [stage.total().moments for stage in stages]
    return Road(theta, uncertainty, moments)


def limit(side: str, known: dict[str, float], moments: list[Array]) -> dict[str, float]:
    """What the criterion converges to: the solution of all roads' normal equations."""
    names = MODELS[side]().stage_parameters
    stages = [
        NormalEquations(jnp.sum(m, axis=0)[None], jnp.ones(1), n) for m, n in zip(moments, names)
    ]
    given = {name: jnp.asarray(value) for name, value in known.items()}
    _, found = solve_stages(stages, given)
    return {name: float(value) for name, value in found.items() if name not in given}


def covered(uncertainty: Uncertainty, errors: np.ndarray) -> np.ndarray:
    """For each parameter, the share of the roads whose interval holds the target.

    **Arguments:** `errors`, estimates less targets, shape `(roads, p)`.
    """
    below, above = uncertainty.reach(0.95)
    scale = np.sqrt(np.diagonal(uncertainty.covariance, axis1=1, axis2=2))
    return np.mean((errors <= below * scale) & (-errors <= above * scale), axis=0)


def study(case: Case, roads: int, seed: int = 0) -> dict[str, Any]:
    """Coverage and bias of every parameter of every variant."""
    result = over_keys(one_road, jax.random.key(seed), roads, case)
    result = jax.tree.map(np.asarray, result, is_leaf=eqx.is_array)
    report: dict[str, Any] = {}
    truth = case.truth
    for variant, theta in result.theta.items():
        side, masses = variant.split("_")
        target = limit(side, case.known(masses), result.moments[variant])
        errors = theta - np.array(list(target.values()))
        shares = {kind: covered(result.uncertainty[variant][kind], errors) for kind in INTERVALS}
        report[variant] = {}
        for i, (name, value) in enumerate(target.items()):
            report[variant][name] = {
                "converges_to": value,
                "bias_percent": 100 * (value / truth[name] - 1) if name in truth else None,
                **{kind: float(share[i]) for kind, share in shares.items()},
            }
    return report


def main(roads: int = 800, out: Path | None = None) -> None:
    jax.config.update("jax_enable_x64", True)
    source = quarter_car_source()
    truth = {"K_t": 180e3, **TRUE_MASSES}
    exact, disturbed = (partial(source_record, source=source, noise=share) for share in (0.0, 0.05))
    cases = {
        "source model": Case(exact, truth, TRUE_MASSES),
        "5 % measurement noise": Case(disturbed, truth, TRUE_MASSES),
        "no model error": Case(reduced_record, REDUCED, {n: REDUCED[n] for n in TRUE_MASSES}),
    }
    reports = {}
    for name, case in cases.items():
        reports[name] = study(case, roads)
        for kind in INTERVALS:
            shares = [row[kind] for rows in reports[name].values() for row in rows.values()]
            print(f"{name}, {kind}: 95 % intervals cover {min(shares):.1%} to {max(shares):.1%}")
    if out is not None:
        write_json(out, {"roads": roads, "cases": reports})

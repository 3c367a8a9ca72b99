"""Refined against RIEC and DOLS: sum of p_i on Robson roads, for Table 6's cases and all variants.

    python -m benchmarks.paper refined_quarter_car [--roads 8]

Each road is four random keys: of three records to fit, of RIEC's windows, and of the Robson road on
which everything is validated as in Table 5. The records:

- `white`: the white noise of Table 2, 0.55 m/s r.m.s.;
- `quiet`: the same at 0.3 m/s, about the r.m.s. velocity of the Robson road;
- `road`: a Robson road, another one than that of the validation.

RIEC and DOLS identify as in the reproduction, from each. From RIEC's estimate of the white noise
the model is then refined on each:

- `output`: output error of x1 to x4 over the whole record, which begins at rest; each channel in
  units of its standard deviation, so that the criterion is the sum of p_i^2. Motions alone tell
  forces only up to a common factor: where the masses are not known, K_t is RIEC's;
- `output with F_t`: the tyre force too, in units of its standard deviation, and K_t free;
- `tiles`: as `output`, over tiles of 1 s, each from its measured start;
- `output, v free`: as `output`, with the damper map's inner break points free too;
- `integral, v free`: integral error of the wheel's or the body's motion over all windows of 0.05 to
  0.5 s; K_s, F_i and the inner break points are free, the rest is RIEC's of the same record.

The variants W and B differ in the equation that K_s and F_i are identified from. Output errors know
no equation but only what is free: W and B then are two starts of one search.
"""

import argparse
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from benchmarks.recorded import FOLDER, write_json
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import AllWindows
from riecjax.models.quarter_car.identification import (
    BREAK_POINTS,
    FORCES,
    INNER,
    VELOCITIES,
    body_balance,
    damper_system,
    quarter_car_of_break_points,
    wheel_balance,
)
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.published import TABLE_2, TABLE_6, VARIANTS
from riecjax.paper.reproduction import (
    TRUE_MASSES,
    VALIDATED_STATES,
    Parameters,
    identification_record,
    identify_variants,
    paper_criteria,
)
from riecjax.records.record import Record, stack_records
from riecjax.refinement.integral_error import IntegralError
from riecjax.refinement.objective import ByFunction
from riecjax.refinement.optimum import LevenbergMarquardt
from riecjax.refinement.output_error import OutputError, Tiles
from riecjax.refinement.refine import Refined, refine
from riecjax.simulation.inputs import band_limited_noise, robson_road
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate
from riecjax.studies.monte_carlo import over_keys
from riecjax.validation.held_out import percentage_error

STEP = 1 / TABLE_2.rate
PLACES: dict[str, float] = dict(zip(VELOCITIES, BREAK_POINTS))
# The reduced model's fastest motion, 14 Hz, is resolved to 1e-5 by 4 steps of 1.25 ms.
METHOD = FixedStep(4)
REST: dict[str, float | Array] = dict.fromkeys(VALIDATED_STATES, 0.0)
# The source model was driven by roads that are straight lines between samples.
FROM_REST = partial(OutputError, initial_states=REST, method=METHOD, intersample="lines")
WHOLE = FROM_REST(channels=VALIDATED_STATES)
WITH_FORCE = FROM_REST(channels=(*VALIDATED_STATES, "F_t"))
TILED = OutputError(
    Tiles(samples=round(TABLE_2.rate)),
    channels=VALIDATED_STATES,
    initial_states="measured",
    method=METHOD,
    intersample="lines",
)
INTEGRAL = IntegralError(RIEC(AllWindows(TABLE_2.alpha, TABLE_2.beta, longest_samples=128)))
# Each sample that crosses a break point is a kink of the sum of squares: its gradient never falls
# to rounding. An offset of 1e-3, where Bates and Watts (1981) stop, is far inside the intervals.
SOLVER = LevenbergMarquardt(1e-3)
RECORDS = ("white", "quiet", "road")
QUIET = 0.3
SCALE = ("K_t",)
"""What tells the scale of forces where neither masses are known nor a force is compared."""
REFINED = ("output", "output with F_t", "tiles", "output, v free", "integral, v free")
BASELINES = tuple(f"{way}, {record}" for record in RECORDS for way in ("RIEC", "DOLS"))
WAYS = (*BASELINES, *(f"{way}, {record}" for record in RECORDS for way in REFINED))
OUT = FOLDER / "refined_quarter_car.json"


class Fitted(NamedTuple):
    """What was found from a record, by variant."""

    parameters: dict[str, Parameters]
    converged: dict[str, Bool[Array, ""]]


class Road(NamedTuple):
    """One road, by how parameters were found and variant.

    **Fields:** `errors`, p_i of x1 to x4 in percent, shape `(4,)`; `converged`; `places`, inner
    break points in m/s where they were free, shape `(2,)`.
    """

    errors: dict[str, dict[str, Float[Array, " 4"]]]
    converged: dict[str, dict[str, Bool[Array, ""]]]
    places: dict[str, dict[str, Float[Array, " 2"]]]


def one_road(key: Key[Array, ""], source: QuarterCarSource) -> Road:
    """Identify and refine on three records, validate on a road that none of them saw."""
    record_key, window_key, validation_key = jax.random.split(key, 3)
    records = stack_records(records_to_fit(source, record_key))
    identified = {
        name: jax.vmap(lambda r, by=by: identify_variants(r, by, window_key))(records)
        for name, by in paper_criteria().items()
    }
    start = _of_record(identified["RIEC"], RECORDS.index("white"))
    fitted = jax.vmap(lambda r, own: refine_all(r, start, own))(records, identified["RIEC"])
    truth = on_road(source, validation_key)
    road = Road({}, {}, {})
    for i, label in enumerate(RECORDS):
        for name, by_variant in identified.items():
            found = _of_record(by_variant, i)
            road.errors[f"{name}, {label}"] = errors_of(found, truth)
        for name, batch in fitted.items():
            one, way = _of_record(batch, i), f"{name}, {label}"
            road.errors[way] = errors_of(one.parameters, truth)
            road.converged[way] = one.converged
            if "v free" in name:
                road.places[way] = {
                    v: jnp.stack([found[p] for p in INNER]) for v, found in one.parameters.items()
                }
    return road


def _of_record(batch: Any, index: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], batch)


def records_to_fit(source: QuarterCarSource, key: Key[Array, ""]) -> list[Record]:
    """In the order of `RECORDS`, each from a key of its own."""
    white_key, quiet_key, road_key = jax.random.split(key, 3)
    noise = band_limited_noise(
        quiet_key, TABLE_2.sample_count, STEP, bandwidth=TABLE_2.bandwidth, rms=QUIET
    )
    return [
        identification_record(source, white_key).record,
        simulate(source, Record({"v_r": noise}, STEP)).record,
        on_road(source, road_key),
    ]


def refine_all(
    record: Record, start: dict[str, Parameters], own: dict[str, Parameters]
) -> dict[str, Fitted]:
    """Every way from RIEC's estimate of the white noise; by integrals from that of the record."""
    return {
        "output": by_output(WHOLE, (), record, start),
        "output with F_t": by_output(WITH_FORCE, (), record, start),
        "tiles": by_output(TILED, (), record, start),
        "output, v free": by_output(WHOLE, INNER, record, start),
        "integral, v free": by_integral(record, own),
    }


def on_road(source: QuarterCarSource, key: Key[Array, ""]) -> Record:
    """The source model on a Robson road of Table 2's length."""
    roughness = jnp.asarray(reconstructed().roughness)
    road = robson_road(key, TABLE_2.sample_count, STEP, roughness=roughness)
    return simulate(source, Record({"v_r": road}, STEP)).record


def errors_of(found: dict[str, Parameters], truth: Record) -> dict[str, Float[Array, " 4"]]:
    """p_i of x1 to x4 in percent, of every variant."""

    def one(parameters: Parameters) -> Float[Array, " 4"]:
        model = quarter_car_of_break_points(parameters)
        predicted = simulate(model, truth.select("v_r"), method=METHOD).record
        return jnp.stack([percentage_error(predicted[s], truth[s]) for s in VALIDATED_STATES])

    errors = jax.vmap(one)(_together(found, VARIANTS))
    return {variant: errors[i] for i, variant in enumerate(VARIANTS)}


def by_output(
    by: OutputError, inner: tuple[str, ...], record: Record, start: dict[str, Parameters]
) -> Fitted:
    """Every variant by output error; those of the same masses in one batch."""
    fitted = Fitted({}, {})
    for masses, held in (("id", SCALE), ("true", tuple(TRUE_MASSES))):
        variants = [v for v in VARIANTS if v.endswith(masses)]
        held = () if masses == "id" and by is WITH_FORCE else held

        def one(begin: Parameters, held: tuple[str, ...] = held) -> tuple[Parameters, Array]:
            known = {n: begin[n] for n in held}
            free = {n: value for n, value in begin.items() if n not in held}
            free |= {n: jnp.asarray(PLACES[n]) for n in inner}
            refined = refine(damper_system(), record, free, by, known=known, solver=SOLVER)
            return _values(refined), refined.converged

        _keep(fitted, variants, jax.vmap(one)(_together(start, variants)))
    return fitted


def by_integral(record: Record, start: dict[str, Parameters]) -> Fitted:
    """Every variant by the integral error of its equation; those of one equation in one batch."""
    fitted = Fitted({}, {})
    for side, balance, mass in (("W", wheel_balance(), "M_us"), ("B", body_balance(), "M_s")):
        variants = [v for v in VARIANTS if v.startswith(side)]

        def one(
            begin: Parameters, balance: ByFunction = balance, mass: str = mass
        ) -> tuple[Parameters, Array]:
            free = {n: begin[n] for n in ("K_s", *FORCES)}
            free |= {n: jnp.asarray(PLACES[n]) for n in INNER}
            known = {mass: begin[mass]}
            refined = refine(balance, record, free, INTEGRAL, known=known, solver=SOLVER)
            return {**begin, **_values(refined)}, refined.converged

        _keep(fitted, variants, jax.vmap(one)(_together(start, variants)))
    return fitted


def _together(found: dict[str, Parameters], variants: Sequence[str]) -> Parameters:
    """Every parameter as an array over variants."""
    return jax.tree.map(lambda *values: jnp.stack(values), *(found[v] for v in variants))


def _keep(fitted: Fitted, variants: Sequence[str], batch: tuple[Parameters, Array]) -> None:
    """Each variant of a batch under its name."""
    for i, variant in enumerate(variants):
        fitted.parameters[variant], fitted.converged[variant] = _of_record(batch, i)


def _values(refined: Refined) -> Parameters:
    """What was refined and what was known."""
    return {**refined.known, **dict(zip(refined.parameters, refined.theta))}


def summary(result: Road) -> dict[str, Any]:
    """By variant and way: mean sum of p_i, its scatter, and how often it is below RIEC and DOLS."""
    report: dict[str, Any] = {}
    for variant in VARIANTS:
        total = {way: result.errors[way][variant].sum(axis=1) for way in WAYS}
        report[variant] = {}
        for way in WAYS:
            row: dict[str, Any] = {
                "sum_of_p": float(total[way].mean()),
                "scatter": float(total[way].std(ddof=1)),
                "p": result.errors[way][variant].mean(axis=0).tolist(),
            }
            if way in result.converged:
                row["converged"] = float(result.converged[way][variant].mean())
                row["share_of_roads_below"] = {
                    base: float(np.mean(total[way] < total[base])) for base in BASELINES
                }
            if way in result.places:
                row["break_points"] = result.places[way][variant].mean(axis=0).tolist()
            report[variant][way] = row
    return report


def show(case: str, report: dict[str, Any]) -> None:
    print(f"\n{case}: mean sum of p_i in percent; % of roads below RIEC / DOLS of the white noise")
    print(" " * 24 + "".join(f"{variant:>15}" for variant in VARIANTS))
    for way in WAYS:
        cells = []
        for variant in VARIANTS:
            row = report[variant][way]
            below = row.get("share_of_roads_below", {})
            shares = "/".join(f"{100 * below[base]:.0f}" for base in BASELINES[:2]) if below else ""
            cells.append(f"{row['sum_of_p']:6.1f} {shares:>8}")
        print(f"{way:24}" + "".join(cells), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--roads", type=int, default=8)
    parser.add_argument("--cases", nargs="+", choices=list(TABLE_6), default=list(TABLE_6))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    report: dict[str, Any] = {"roads": arguments.roads, "seed": arguments.seed, "cases": {}}
    for case in arguments.cases:
        began = time.perf_counter()
        mount = TABLE_6[case]
        source = quarter_car_source(
            reconstructed(), mount_rate=mount.stiffness, mount_damping=mount.damping
        )
        result = over_keys(
            one_road, jax.random.key(arguments.seed), arguments.roads, source, chunk=4
        )
        report["cases"][case] = summary(jax.tree.map(np.asarray, result))
        show(case, report["cases"][case])
        print(f"{time.perf_counter() - began:.0f} s", flush=True)
        write_json(arguments.out, report)


if __name__ == "__main__":
    main()

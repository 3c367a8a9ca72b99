"""The whole source model fitted to what sensors would see: are its parameters found?

    python -m benchmarks.paper source_fit [--seeds 24]

Suspension deflection x2, velocities of wheel and body x3 and x4, and tyre force F_t, 10 s at 200 Hz
on the white-noise road of Table 2, from rest. The curves are known, and of the masses and rates
either M_e, K_m, B_m and K_c are free, or all seven. Searches begin 50 % off, each parameter by
itself too low or too high. Those for all seven go over tiles of 0.125 s first, which forgive a poor
start, from the measured deflection and velocities. The record is simulated with four times the
steps that the fit takes, so that integration errors do not cancel.

Noise is white, 1 % of each channel's standard deviation, drawn anew for each seed. There the fit is
the best of as many searches as `SEARCHES` says: from some starts the one for all seven ends
elsewhere, with next to no mass of the engine.
"""

import argparse
import itertools
import json
import time
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from benchmarks.calibration.coverage import covered
from benchmarks.recorded import FOLDER, write_json
from riecjax.models.catalogue import built_in_model
from riecjax.paper.published import TABLE_2
from riecjax.records.record import Record
from riecjax.refinement.optimum import RefinementStatus
from riecjax.refinement.output_error import OutputError, Tiles
from riecjax.refinement.refine import Refined, refine
from riecjax.simulation.inputs import band_limited_noise
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate
from riecjax.studies.monte_carlo import over_keys
from riecjax.uncertainty.intervals import BlockBootstrap, Sandwich, Uncertainty

MODEL = built_in_model("quarter-car-source")
TRUTH = {p.name: float(p.default or 0.0) for p in MODEL.simulation_parameters}
CHANNELS = ("x2", "x3", "x4", "F_t")
FREE = {"four": ("M_e", "K_c", "K_m", "B_m"), "seven": tuple(TRUTH)}
STATES = tuple(f"x{i}" for i in range(1, 8))
STARTS = {"known": dict.fromkeys(STATES, 0.0), "estimated": "estimated"}
INTERVALS = {"sandwich": Sandwich(), "bootstrap": BlockBootstrap()}
SECONDS = 10.0
NOISE = 0.01
OFF = (0.5, 1.5)
COMBINATIONS = 16
SEARCHES = {4: 1, 7: 4}
"""Searches for each seed of noise, by how many parameters are free."""
FINE, COARSE = FixedStep(32), FixedStep(8)
# The roads that were simulated are straight lines between samples.
BY = partial(OutputError, channels=CHANNELS, method=COARSE, intersample="lines")
TILED = BY(Tiles(samples=25), initial_states="measured")
WARM_UP = 30
OUT = FOLDER / "source_fit.json"


class Fit(NamedTuple):
    """One search: parameters, sum of squares, and how it ended."""

    theta: Float[Array, " p"]
    cost: Float[Array, ""]
    status: RefinementStatus
    steps: Array


class Judged(NamedTuple):
    """The best of several searches, and its uncertainty by kind of intervals."""

    best: Fit
    uncertainty: dict[str, Uncertainty]


def drive(key: Key[Array, ""]) -> Record:
    """What the sensors would see without noise."""
    samples, step = round(SECONDS * TABLE_2.rate), 1 / TABLE_2.rate
    road = band_limited_noise(key, samples, step, bandwidth=TABLE_2.bandwidth, rms=TABLE_2.rms)
    source = MODEL.build_system({})
    seen = simulate(source, Record({"v_r": road}, step), method=FINE).checked().record
    return seen.select("v_r", *CHANNELS)


def fit(record: Record, start: dict[str, Array], starts: str) -> Fit:
    """Search from a start."""
    if len(start) == len(TRUTH):
        start = _values(refine(MODEL, record, start, TILED, max_steps=WARM_UP))
    found = refine(MODEL, record, start, compared(starts))
    return Fit(found.theta, found.cost, found.status, found.steps)


def compared(starts: str) -> OutputError:
    return BY(initial_states=STARTS[starts])


def _values(found: Refined) -> dict[str, Array]:
    return dict(zip(found.parameters, found.theta))


def first_guesses(free: tuple[str, ...], count: int) -> dict[str, Array]:
    """Every parameter 50 % too low or too high: so many combinations, spread over all."""
    every = np.array(list(itertools.product(OFF, repeat=len(free))))
    chosen = every[np.linspace(0, len(every) - 1, count).round().astype(int)]
    return {name: jnp.asarray(TRUTH[name] * chosen[:, i]) for i, name in enumerate(free)}


@eqx.filter_jit
def from_all_starts(record: Record, guesses: dict[str, Array], starts: str) -> Fit:
    return jax.vmap(lambda guess: fit(record, guess, starts))(guesses)


def noisy_fit(
    key: Key[Array, ""], record: Record, guesses: dict[str, Array], starts: str
) -> Judged:
    """One seed: the best of the searches, judged by going on from where it ended."""
    keys = jax.random.split(key, len(CHANNELS))
    disturbed = {
        name: record[name]
        + NOISE * jnp.std(record[name]) * jax.random.normal(k, record[name].shape)
        for k, name in zip(keys, CHANNELS)
    }
    noisy = record.with_signals(disturbed)
    found = jax.vmap(lambda guess: fit(noisy, guess, starts))(guesses)
    least = jnp.argmin(found.cost)
    best = jax.tree.map(lambda leaf: leaf[least], found)
    # Not the order of the guesses: a dictionary that is traced comes back sorted.
    start = dict(zip((name for name in TRUTH if name in guesses), best.theta))
    judged = {
        kind: refine(MODEL, noisy, start, compared(starts), intervals=each).uncertainty
        for kind, each in INTERVALS.items()
    }
    return Judged(best, judged)


def converged(found: Fit) -> np.ndarray:
    """Which searches ended at an optimum."""
    return np.asarray(found.status == RefinementStatus.converged)


def without_noise(record: Record, free: tuple[str, ...], starts: str) -> dict[str, Any]:
    """Largest relative error over the searches that converged, and how many did."""
    found = from_all_starts(record, first_guesses(free, COMBINATIONS), starts)
    truth = np.array([TRUTH[name] for name in free])
    errors = np.abs(np.asarray(found.theta) / truth - 1)
    within = np.all(errors < 0.01, axis=1)
    return {
        "searches": len(errors),
        "converged": int(converged(found).sum()),
        "all_within_1_percent": int(within.sum()),
        "largest_error_percent_where_within": dict(
            zip(free, (100 * errors[within].max(axis=0, initial=0.0)).tolist())
        ),
        "median_steps": float(np.median(np.asarray(found.steps))),
    }


def with_noise(record: Record, free: tuple[str, ...], starts: str, seeds: int) -> dict[str, Any]:
    """Relative errors over seeds, and the share of seeds whose interval holds the truth."""
    guesses = first_guesses(free, SEARCHES[len(free)])
    found = over_keys(noisy_fit, jax.random.key(7), seeds, record, guesses, starts)
    truth = np.array([TRUTH[name] for name in free])
    errors = np.asarray(found.best.theta) - truth
    report: dict[str, Any] = {"seeds": seeds, "converged": int(converged(found.best).sum())}
    shares = {kind: covered(each, errors) for kind, each in found.uncertainty.items()}
    report["parameters"] = {
        name: {
            "mean_error_percent": float(100 * errors[:, i].mean() / truth[i]),
            "scatter_percent": float(100 * errors[:, i].std(ddof=1) / truth[i]),
            "largest_error_percent": float(100 * np.abs(errors[:, i]).max() / truth[i]),
            **{f"inside_{kind}": float(share[i]) for kind, share in shares.items()},
        }
        for i, name in enumerate(free)
    }
    return report


def study(seeds: int) -> dict[str, Any]:
    """Both sets of free parameters, starts known and estimated, without and with noise."""
    record = drive(jax.random.key(3))
    report: dict[str, Any] = {"seconds": SECONDS, "noise": NOISE, "channels": CHANNELS}
    for label, free in FREE.items():
        for starts in STARTS:
            began = time.perf_counter()
            part = {
                "without_noise": without_noise(record, free, starts),
                "with_noise": with_noise(record, free, starts, seeds),
            }
            report[f"{label}, starts {starts}"] = part
            print(f"{label}, starts {starts} ({time.perf_counter() - began:.0f} s)", flush=True)
            print(json.dumps(part, indent=1), flush=True)
    return report


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    write_json(arguments.out, study(arguments.seeds))


if __name__ == "__main__":
    main()

"""The source model on 40 s of road: against SciPy at equal error, numba, and 64 roads at once."""

from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from benchmarks.speed.baselines.numba_quarter_car import numba_solution
from benchmarks.speed.baselines.quarter_car import car_of, numpy_solution
from benchmarks.speed.timing import Comparison, Size, compare
from riecjax.models.quarter_car.reconstruction import quarter_car_source
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.records.record import Record
from riecjax.simulation.inputs import band_limited_noise
from riecjax.simulation.method import AbstractMethod, Adaptive, FixedStep
from riecjax.simulation.simulate import simulate

RATE, COUNT = 200.0, 8000
SCIPY_TOLERANCE = 3e-6
"""The loosest round tolerance at which SciPy is as accurate as eight fixed steps per sample."""


def noise(key: Array) -> Float[Array, " n"]:
    return band_limited_noise(key, COUNT, 1 / RATE, bandwidth=30.0, rms=0.55)


def states(
    source: QuarterCarSource, velocity: Array, method: AbstractMethod
) -> Float[Array, "n 7"]:
    record = simulate(source, Record({"v_r": velocity}, 1 / RATE), method=method).record
    return jnp.stack([record[name] for name in source.state_names], axis=1)


def relative_error(found: np.ndarray, truth: np.ndarray) -> float:
    """Largest error of any state, relative to that state's largest value."""
    return float(np.max(np.abs(found - truth) / np.abs(truth).max(0)))


@eqx.filter_jit
def one_road(source: QuarterCarSource, velocity: Array) -> Float[Array, "n 7"]:
    return states(source, velocity, FixedStep())


@eqx.filter_jit
def many_roads(source: QuarterCarSource, velocities: Array) -> Float[Array, "roads n 7"]:
    return jax.vmap(lambda velocity: states(source, velocity, FixedStep()))(velocities)


def run(size: Size) -> Iterator[Comparison]:
    source = quarter_car_source()
    velocity = noise(jax.random.key(0))
    car, sampled = car_of(source), np.asarray(velocity)
    truth = np.asarray(states(source, velocity, Adaptive(rtol=1e-10, atol=1e-12)))
    ours = relative_error(np.asarray(one_road(source, velocity)), truth)
    by_scipy = relative_error(numpy_solution(car, sampled, RATE, SCIPY_TOLERANCE), truth)
    by_numba = relative_error(numba_solution(car, sampled, RATE, 8), truth)
    yield compare(
        "simulate-one",
        lambda: one_road(source, velocity),
        "SciPy RK45 at equal error, right-hand side in NumPy",
        lambda: numpy_solution(car, sampled, RATE, SCIPY_TOLERANCE),
        300,
        {"ours": ours, "baseline": by_scipy},
        repeats=size.repeats,
        their_repeats=2,
    )
    limit = compare(
        "simulate-one-limit",
        lambda: one_road(source, velocity),
        "the same scheme in numba, one thread",
        lambda: numba_solution(car, sampled, RATE, 8),
        0.4,
        {"ours": ours, "baseline": by_numba},
        repeats=2 * size.repeats,
    )
    yield limit
    velocities = jax.vmap(noise)(jax.random.split(jax.random.key(1), size.batch))
    together = np.asarray(many_roads(source, velocities))
    alone = np.asarray(one_road(source, velocities[-1]))
    yield compare(
        "simulate-batch",
        lambda: many_roads(source, velocities),
        f"{size.batch} times simulate-one",
        lambda: one_road(source, velocity),
        1.7,
        {"ours": ours, "difference_from_one_by_one": relative_error(together[-1], alone)},
        repeats=size.repeats,
        scale=size.batch,
    )

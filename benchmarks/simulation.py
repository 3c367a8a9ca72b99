"""Simulation of the source model against SciPy, at equal error, and of a batch of roads."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.integrate
from jaxtyping import Array, Float

from benchmarks.timing import Comparison, compare, median_seconds
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.records.record import Record
from riecjax.simulation.excitation import band_limited_noise
from riecjax.simulation.method import Adaptive, FixedStep
from riecjax.simulation.simulate import simulate

RATE, COUNT, SCIPY_SECONDS, BATCH = 200.0, 8000, 4.0, 64
# The loosest round tolerance at which SciPy is as accurate as eight fixed steps per sample.
SCIPY_TOLERANCE = 3e-6


def road(seed: int) -> Record:
    noise = band_limited_noise(jax.random.key(seed), COUNT, 1 / RATE, bandwidth=30.0, rms=0.55)
    return Record({"v_r": noise}, 1 / RATE)


def states(source: QuarterCarSource, inputs: Record, method: FixedStep | Adaptive) -> Array:
    record = simulate(source, inputs, method=method).record
    return jnp.stack([record[name] for name in source.state_names], axis=1)


def relative_error(found: np.ndarray, truth: np.ndarray) -> float:
    """Largest error of any state, relative to that state's largest value."""
    return float(np.max(np.abs(found - truth) / np.abs(truth).max(0)))


def numpy_source(source: Any) -> Callable[[float, np.ndarray, float], np.ndarray]:
    """The same right-hand side written in plain NumPy, as a SciPy user would."""
    damper, spring, mount = source.damper, source.spring, source.mount
    c0 = float(damper.low_speed_rate)
    rates = np.asarray(damper.high_speed_rates)
    knees = np.asarray(damper.knees)
    gaps = np.asarray(spring.gaps)
    stops = np.asarray(spring.stop_rates)
    k, k3 = float(mount.rate), float(mount.cubic)
    lift = float(source.lift_off_force)
    ks = float(spring.rate)

    def derivative(_: float, x: np.ndarray, v: float) -> np.ndarray:
        x1, x2, x3, x4, x5, x6, x7 = x
        side = 1 if x7 > 0 else 0
        c, knee = rates[side], knees[side]
        bend = 1 + (x7 / knee) ** 2
        damping = x7 * (c + (c0 - c) / bend**0.5)
        slope = c + (c0 - c) * bend**-1.5
        force = ks * x2 - stops[0] * max(-x2 - gaps[0], 0.0) + stops[1] * max(x2 - gaps[1], 0.0)
        engine = k * x5 + k3 * x5**3 + 4000.0 * (x4 - x6)
        tyre = min(180e3 * x1, lift)
        return np.array(
            [
                v - x3,
                x3 - x4,
                (tyre - force - damping) / 30.0,
                (force + damping - engine) / 200.0,
                x4 - x6,
                engine / 100.0,
                500e3 / slope * (x3 - x4 - x7),
            ]
        )

    return derivative


def scipy_solution(
    source: QuarterCarSource, velocity: Float[np.ndarray, " n"], rtol: float
) -> Float[np.ndarray, "n 7"]:
    derivative, time = numpy_source(source), np.arange(velocity.size) / RATE
    solution = scipy.integrate.solve_ivp(
        lambda t, x: derivative(t, x, float(np.interp(t, time, velocity))),
        (0.0, time[-1]),
        np.zeros(7),
        t_eval=time,
        method="RK45",
        rtol=rtol,
        atol=rtol * 1e-3,
        max_step=1 / RATE,
    )
    return solution.y.T


def run() -> list[Comparison]:
    """`simulate-one` (40 s) and `simulate-batch` (64 roads)."""
    source, inputs, method = quarter_car_source(reconstructed()), road(0), FixedStep()
    truth = np.asarray(states(source, inputs, Adaptive(rtol=1e-10, atol=1e-12)))
    ours = median_seconds(lambda: states(source, inputs, method), 9)
    count = round(SCIPY_SECONDS * RATE)
    velocity = np.asarray(inputs["v_r"])[:count]
    scaled = COUNT / count
    theirs = scaled * median_seconds(lambda: scipy_solution(source, velocity, SCIPY_TOLERANCE), 1)
    accuracy = {
        "ours": relative_error(np.asarray(states(source, inputs, method)), truth),
        "baseline": relative_error(
            scipy_solution(source, velocity, SCIPY_TOLERANCE), truth[:count]
        ),
    }
    one = compare("simulate-one", ours, "SciPy RK45, first 4 s times 10", theirs, 300, accuracy)

    keys = jax.random.split(jax.random.key(1), BATCH)

    @eqx.filter_jit
    def batch(source: QuarterCarSource, keys: Array) -> Array:
        def one_road(key: Array) -> Array:
            noise = band_limited_noise(key, COUNT, 1 / RATE, bandwidth=30.0, rms=0.55)
            return states(source, Record({"v_r": noise}, 1 / RATE), method)

        return jax.vmap(one_road)(keys)

    together = median_seconds(lambda: batch(source, keys), 3)
    return [
        one,
        compare("simulate-batch", together, "64 times simulate-one", BATCH * ours, 1.7, accuracy),
    ]

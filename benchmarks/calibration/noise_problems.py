"""Recordings whose truth is known, with noise on their sensors; and the least error they allow.

White noise of a share of each signal's standard deviation, from `numpy.random.default_rng(100 +
seed)`. Motions are simulated finely, by SciPy where a sign or long free motion asks for it.
"""

import functools
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key
from tests.machines import DRAG, Signals, drag_oscillator, noisy, slide

import riecjax as rx
from riecjax.models.quarter_car.reconstruction import quarter_car_source
from riecjax.paper.published import TABLE_2
from riecjax.simulation.inputs import band_limited_noise
from riecjax.simulation.system import AbstractSystem
from riecjax.studies import over_keys, predicted_standard_errors

CAR_SENSORS: tuple[str, ...] = ("x1", "x2", "x3", "x4", "F_t")


def drag_bound(noise: float, *, velocity: bool) -> np.ndarray:
    """Cramer-Rao bounds of the standard deviations, the initial state being unknown too."""
    clean = DRAG.signals()
    sigma = {name: noise * clean[name].std() for name in ("x", "dx")[: 1 + velocity]}
    record = DRAG.record()
    bounds = predicted_standard_errors(
        drag_oscillator(), DRAG.truth, record, channels=tuple(sigma), sigma=sigma
    )
    return np.array(list(bounds.values()))


CARS: dict[str, dict[str, float]] = {
    "paper": {},
    "heavier": {"M_w": 42.0, "M_b": 340.0, "M_e": 140.0, "K_t": 240e3, "K_c": 800e3, "K_m": 600e3},
}


def car_roads(car: str, roads: int) -> list[dict[str, np.ndarray]]:
    """The source model's sensors on white-noise roads of 40 s at 200 Hz, as the command draws."""
    source = rx.find_model("quarter-car-source").build_system(CARS[car])
    return one_by_one(over_keys(_car_road, jax.random.key(0), roads, source, chunk=20))


def one_by_one(batch: Mapping[str, Any]) -> list[dict[str, np.ndarray]]:
    """Signals of each member of a batch."""
    arrays = {name: np.asarray(values) for name, values in batch.items()}
    return [dict(zip(arrays, each)) for each in zip(*arrays.values(), strict=True)]


def _car_road(key: Key[Array, ""], source: AbstractSystem) -> dict[str, Array]:
    record = car_motion(key, source, TABLE_2.sample_count)
    return {name: record[name] for name in CAR_SENSORS}


ACCELERATIONS: tuple[str, ...] = ("dx3", "dx4")
LIGHTEST, HEAVIEST = 0.7, 1.4
"""Times the paper's masses."""


def hidden_car_roads(roads: int) -> list[dict[str, np.ndarray]]:
    """As `car_roads`, with accelerations, each of a car with masses of its own."""
    listed = rx.find_model("quarter-car-source").system.parameters
    masses = {q.name: q.default for q in listed if q.name in ("M_w", "M_b", "M_e")}

    def road(key: Key[Array, ""], names: Any) -> dict[str, Array]:
        own, drive = jax.random.split(key)
        factors = jax.random.uniform(own, (3,), minval=LIGHTEST, maxval=HEAVIEST)
        car = {name: factor * masses[name] for name, factor in zip(masses, factors)}
        record = car_motion(drive, quarter_car_source(car), TABLE_2.sample_count)
        return {name: record[name] for name in (*CAR_SENSORS, *ACCELERATIONS)}

    return one_by_one(over_keys(road, jax.random.key(56), roads, None, chunk=20))


def car_motion(key: Key[Array, ""], source: AbstractSystem, count: int) -> rx.Record:
    step = 1 / TABLE_2.rate
    road = band_limited_noise(key, count, step, bandwidth=TABLE_2.bandwidth, rms=TABLE_2.rms)
    return rx.simulate(source, rx.Record({"v_r": road}, step)).record


# A mass on a spring with dry friction, as a user would write it from docs/writing_a_model.md.
DRY = {"m": 12.5, "k": 8000.0, "f_viscous": 45.0, "f_coulomb": 20.0}
DRY_STEP, DRY_COUNT = 1e-3, 20001
_TONES = np.array([0.7, 1.9, 3.1, 3.7, 4.3, 5.3, 7.1])
_PHASES = np.random.default_rng(6).uniform(0, 2 * np.pi, _TONES.size)
_FORCE = 40.0


def _dry_force(t: Any) -> Any:
    return _FORCE * np.cos(2 * np.pi * np.multiply.outer(t, _TONES) + _PHASES).sum(axis=-1)


def _direction(signals: Mapping[str, Array]) -> Array:
    return jnp.sign(signals["dx"])


def _dry(*friction: rx.Term) -> rx.Model:
    equation = rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("dx", "ddx"), unit="kg"),
        rx.Term("k", "x", unit="N/m"),
        *friction,
        -rx.Term(1.0, "u"),
        name="rig",
        unit="N",
    )
    return rx.Model("rig", "with dry friction", stages=equation, derived={"dx": "x"})


DRY_BY_BASIS = _dry(rx.Terms("f", rx.friction(), "dx"))
DRY_BY_SIGN = _dry(
    rx.Term("f_viscous", "x", derivative=1, measured=("dx",), unit="N s/m"),
    rx.Term("f_coulomb", _direction, unit="N"),
)
"""The same with a function of the user's own."""


@functools.cache
def dry_motion() -> dict[str, np.ndarray]:
    """Position and force from rest."""
    times = np.arange(DRY_COUNT) * DRY_STEP
    m, k, c, f = DRY.values()

    def acceleration(t: float, x: float, v: float, direction: float) -> float:
        return (_dry_force(t) - c * v - f * direction - k * x) / m

    x = slide(acceleration, times, tolerance=1e-10)["x"]
    return {"x": x, "u": _dry_force(times)}


def recordings(
    signals: Signals, shares: Mapping[str, float], step: float, seeds: int
) -> Iterator[rx.Record]:
    """One recording for each seed of the noise."""
    for seed in range(seeds):
        yield rx.Record.from_samples(noisy(signals, shares, seed), time_step=step)

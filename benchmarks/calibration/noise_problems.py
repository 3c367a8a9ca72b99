"""Recordings whose truth is known, with noise on their sensors; and the least error they allow.

White noise of a share of each signal's standard deviation, from `numpy.random.default_rng(100 +
seed)`. Motions are simulated finely, by SciPy where a sign or long free motion asks for it.
"""

import functools
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.integrate
from jaxtyping import Array, Key
from tests.machines import (
    DRAG,
    Signals,
    drag_force,
    drag_oscillator,
    drag_signals,
    noisy,
    slide,
)

import riecjax as rx
from riecjax.paper.published import TABLE_2
from riecjax.simulation.inputs import band_limited_noise
from riecjax.simulation.system import AbstractSystem
from riecjax.studies.input_design import inverse, levels_of, plan_experiment
from riecjax.studies.monte_carlo import over_keys

CAR_SENSORS: tuple[str, ...] = ("x1", "x2", "x3", "x4", "F_t")


def as_recorded(model: Any, signals: Signals, time_step: float) -> Any:
    """What a user hands to `identify`: the record, or what is read of a file of these signals.

    A file is read where identification refuses the bare record because a derivative is missing,
    which reading with the model forms.
    """
    record = rx.Record.from_samples(dict(signals), time_step=time_step)
    # Equations say of no signal what it is the derivative of.
    derived = set(getattr(model, "derived", {})) - set(signals)
    if not (derived and _must_be_read(model, tuple(signals))):
        return record
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.npz"
        columns: dict[str, Any] = {"t": np.arange(record.sample_count) * time_step, **signals}
        np.savez(path, **columns)
        return rx.read_recording(path, model=model)


@functools.cache
def _must_be_read(model: Any, names: tuple[str, ...]) -> bool:
    rng = np.random.default_rng(0)
    arrays = {name: np.cumsum(rng.standard_normal(4000)) for name in names}
    try:
        rx.identify(model, rx.Record.from_samples(arrays, time_step=0.01), intervals=rx.Naive())
    except rx.DataError:
        return True
    except rx.RiecjaxError:
        return False  # it looked at the samples, and walked off at random
    return False


def drag_sensors(seed: int | None, noise: float, *, velocity: bool) -> dict[str, np.ndarray]:
    found = drag_signals(seed, noise)
    return found if velocity else {name: found[name] for name in ("x", "u")}


def drag_bound(noise: float, *, velocity: bool) -> np.ndarray:
    """Least standard deviation of each parameter."""
    clean = DRAG.signals()
    sigma = {name: noise * clean[name].std() for name in ("x", "dx")[: 1 + velocity]}
    record = DRAG.record()
    covariance = bound(drag_oscillator(), DRAG.truth, record, sigma)
    return np.sqrt(np.diagonal(covariance))


def bound(
    system: Any,
    values: Mapping[str, float],
    record: rx.Record,
    sigma: Mapping[str, float],
    **settings: Any,
) -> np.ndarray:
    """Cramer-Rao bound of the parameters' covariance, the initial state being unknown too."""
    plan = plan_experiment(system, values, record, channels=tuple(sigma), sigma=sigma, **settings)
    information, _ = plan.information(levels_of(plan, record))
    size = np.abs(list(values.values()))
    return np.asarray(inverse(information))[: size.size, : size.size] * np.outer(size, size)


CARS: dict[str, dict[str, float]] = {
    "paper": {},
    "heavier": {"M_w": 42.0, "M_b": 340.0, "M_e": 140.0, "K_t": 240e3, "K_c": 800e3, "K_m": 600e3},
}


def car_roads(car: str, roads: int) -> list[dict[str, np.ndarray]]:
    """The source model's sensors on white-noise roads of 40 s at 200 Hz, as the command draws."""
    source = rx.find_model("quarter-car-source").build_system(CARS[car])
    made = over_keys(_car_road, jax.random.key(0), roads, source, chunk=20)
    made = {name: np.asarray(values) for name, values in made.items()}
    return [{name: values[i] for name, values in made.items()} for i in range(roads)]


def _car_road(key: Key[Array, ""], source: AbstractSystem) -> dict[str, Array]:
    record = car_motion(key, source, TABLE_2.sample_count)
    return {name: record[name] for name in CAR_SENSORS}


def car_motion(key: Key[Array, ""], source: AbstractSystem, count: int) -> rx.Record:
    step = 1 / TABLE_2.rate
    road = band_limited_noise(key, count, step, bandwidth=TABLE_2.bandwidth, rms=TABLE_2.rms)
    return rx.simulate(source, rx.Record({"v_r": road}, step)).record


LINEAR = {"m": 1.5, "c": 3.0, "k": 60.0}


def linear_motion() -> tuple[rx.Equation, dict[str, float], dict[str, np.ndarray], float]:
    """Equation, truth, position and force, and time step of a damped oscillator."""
    equation = rx.Equation(
        rx.Term("m", "x", derivative=2),
        rx.Term("c", "x", derivative=1),
        rx.Term("k", "x"),
        -rx.Term(1.0, "u"),
    )
    step = 0.01
    record = rx.Record({"u": drag_force(step * np.arange(2001))}, step)
    run = rx.simulate(rx.equation_system(equation, LINEAR), record, method=rx.FixedStep(8))
    signals = {name: np.asarray(run.record[name]) for name in ("x", "u")}
    return equation, LINEAR, signals, step


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


def _dry(*friction: rx.Term | rx.Terms) -> rx.Model:
    equation = rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("dx", "ddx"), unit="kg"),
        rx.Term("k", "x", unit="N/m"),
        *friction,
        -rx.Term(1.0, "u"),
        name="rig",
        unit="N",
    )
    return rx.Model("rig", "with dry friction", procedure=lambda: equation, derived={"dx": "x"})


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


DUFFING = {"d": 0.15, "k1": 4.0, "k3": 1.5}


def _cube(signals: Mapping[str, Array]) -> Array:
    return signals["y"] ** 3


FREE_DUFFING = rx.Equation(
    rx.Term(1.0, "y", derivative=2, measured=("dy", "ddy")),
    rx.Term("d", "y", derivative=1, measured=("dy",)),
    rx.Term("k1", "y"),
    rx.Term("k3", _cube),
    name="duffing",
)
"""y'' + d y' + k1 y + k3 y^3 = 0: the mass is known, and nothing drives it."""


@functools.cache
def duffing_motion(count: int) -> dict[str, np.ndarray]:
    d, k1, k3 = DUFFING.values()
    run = scipy.integrate.solve_ivp(
        lambda _, s: [s[1], -d * s[1] - k1 * s[0] - k3 * s[0] ** 3],
        (0, 20),
        [1.5, 0.0],
        t_eval=np.linspace(0, 20, count),
        rtol=1e-10,
        atol=1e-12,
    )
    return {"y": run.y[0], "dy": run.y[1]}


def relative_norms(errors: np.ndarray, truth: Mapping[str, float]) -> np.ndarray:
    """|error| / |truth| of parameter vectors in percent."""
    return 100 * np.linalg.norm(errors, axis=-1) / np.linalg.norm(list(truth.values()))


def duffing_bound(count: int, noise: float) -> float:
    """Median relative norm, in percent, of errors that are normal with the bound's covariance."""
    clean = duffing_motion(count)
    record = rx.Record.from_samples({**clean, "u": np.zeros(count)}, time_step=20 / (count - 1))
    sigma = {name: noise * values.std() for name, values in clean.items()}
    covariance = bound(
        rx.find_model("duffing"),
        DUFFING,
        record,
        sigma,
        known={"m": 1.0, "k2": 0.0},
        initial_state={"y": 1.5},
    )
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(np.zeros(len(DUFFING)), covariance, 200_000)
    return float(np.median(relative_norms(draws, DUFFING)))


def recordings(
    model: Any, signals: Signals, shares: Mapping[str, float], step: float, seeds: int
) -> Iterator[Any]:
    """One recording for each seed of the noise."""
    for seed in range(seeds):
        yield as_recorded(model, noisy(signals, shares, seed), step)

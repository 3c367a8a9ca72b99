"""Silverbox refined: five parameters by output error, and what they lack.

Fitted on the official train slice by multiple shooting; scored, as in `silverbox`, by simulation of
the test slices. What the plain Duffing equation lacks shows in two ways:

- The record's means are removed beforehand, and with them the mean force that k2 y^2 makes. Writing
  k2 (y^2 - q), with q the mean square of the record, takes no parameter.
- Refitted on parts of the arrow, whose amplitude grows, the damping grows with it by several
  standard errors while the stiffness stays (`damping_over_amplitude`). Of the terms that do so,
  `- Fc tanh(y' / vs)`, a dead zone of the damping force, leaves least on the train slice; a slow
  hidden state in its place leaves more the slower it is, so it is no matter of temperature.
"""

import dataclasses
import itertools
import time
from collections.abc import Iterator, Mapping
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import riecjax as rx
from benchmarks.measured.silverbox import FACTOR, STEP, TRAIN
from riecjax.refinement.output_error import Tiles
from riecjax.simulation.system import AbstractSystem

WINDOW = 1000
"""Samples of a window, as recorded: 110 periods, 35 time constants."""
PARTS = 6
DEAD_ZONE = {"Fc": 1e-4, "vs": 20.0}
"""Start of the dead zone, V and V/s; a tenth of a percent of the force, and a usual velocity."""


class Circuit(AbstractSystem):
    """m y'' + d y' - Fc tanh(y' / vs) + k1 y + k2 (y^2 - q) + k3 y^3 = u, in volts."""

    m: Float[Array, ""]
    d: Float[Array, ""]
    k1: Float[Array, ""]
    k2: Float[Array, ""]
    k3: Float[Array, ""]
    Fc: Float[Array, ""]
    vs: Float[Array, ""]
    q: Float[Array, ""]

    states: ClassVar = (("y", "V"), ("dy", "V/s"))
    inputs: ClassVar = (("u", "V"),)

    def derivative(self, state: Array, inputs: Array) -> Array:
        y, dy = state[0], state[1]
        spring = y * (self.k1 + y * (self.k2 + y * self.k3)) - self.k2 * self.q
        damper = self.d * dy - self.Fc * jnp.tanh(dy / self.vs)
        return jnp.stack([dy, (inputs[0] - damper - spring) / self.m])


class Fit(NamedTuple):
    refined: rx.Estimate
    seconds: float


def circuit(values: Mapping[str, float]) -> Circuit:
    zero = {"Fc": 0.0, "vs": 1.0, "q": 0.0}
    return Circuit(**{name: jnp.asarray(value) for name, value in {**zero, **values}.items()})


def fitted(fine: rx.Record, start: Mapping[str, float], known: Mapping[str, float]) -> Fit:
    """The circuit on a slice that was up-sampled by `FACTOR`, from a start."""
    by = rx.OutputError(Tiles(samples=WINDOW * FACTOR), channels=("y",), method=rx.FixedStep(1))
    fine = as_recorded(fine)
    began = time.perf_counter()
    refined = rx.refine(circuit({**start, **known}), fine, start, by, known=known)
    float(refined.search.cost)
    return Fit(refined, time.perf_counter() - began)


def as_recorded(fine: rx.Record) -> rx.Record:
    """Without samples between those that were recorded, which would tell the same again."""
    recorded = np.arange(fine.sample_count) % FACTOR == 0
    return fine.with_signals({"y": dataclasses.replace(fine.signal("y"), present=recorded)})


def slice_of(fine: rx.Record, first: int, last: int) -> rx.Record:
    """Samples of the record from `first` to before `last`, up-sampled."""
    lost = round(float(fine.start_time) / STEP)
    return fine.part((first - lost) * FACTOR, (last - 1 - lost) * FACTOR + 1)


def score(system: AbstractSystem, fine: rx.Record, first: int, last: int) -> float:
    """Simulation error in mV on the samples of a slice, from its recorded start."""
    y, dt = np.asarray(slice_of(fine, first, last)["y"]), float(fine.time_step)
    before = np.asarray(slice_of(fine, first - 1, first + 2)["y"])
    start = {"y": y[0], "dy": (before[FACTOR + 1] - before[FACTOR - 1]) / (2 * dt)}
    part = slice_of(fine, first, last).select("u")
    run = rx.simulate(system, part, method=rx.FixedStep(1), initial_state=start).checked()
    error = (np.asarray(run.record["y"]) - y)[::FACTOR]
    return 1e3 * float(np.sqrt(np.mean(error[50:] ** 2)))


def models(fine: rx.Record, estimate: Mapping[str, float]) -> Iterator[tuple[str, Fit]]:
    """Refined models, from the integral estimate of the plain one on."""
    train = slice_of(fine, *TRAIN)
    mean_square = float(np.mean(np.asarray(fine["y"]) ** 2))
    plain = fitted(train, estimate, {"q": 0.0, "Fc": 0.0, "vs": 1.0})
    yield "Duffing, 5 parameters", plain
    start = {name: float(plain.refined[name]) for name in estimate}
    yield "k2 (y^2 - q), 5", fitted(train, start, {"q": mean_square, "Fc": 0.0, "vs": 1.0})
    yield "and - Fc tanh(y'/vs), 7", fitted(train, {**start, **DEAD_ZONE}, {"q": mean_square})


def damping_over_amplitude(
    fine: rx.Record, values: Mapping[str, float], arrow: tuple[int, int]
) -> Iterator[tuple[float, float, float]]:
    """(r.m.s. of y in mV, change of d in %, its standard error in %) for parts of the arrow."""
    edges = np.linspace(*arrow, PARTS + 1).astype(int)
    for first, last in itertools.pairwise(edges):
        part = slice_of(fine, first, last)
        held = {n: v for n, v in values.items() if n not in ("d", "k1")}
        found = fitted(part, {"d": values["d"], "k1": values["k1"]}, held).refined
        yield (
            1e3 * float(np.std(np.asarray(part["y"]))),
            100 * (float(found["d"]) / values["d"] - 1),
            100 * float(found.standard_error("d")) / values["d"],
        )

"""Built-in models simulated by their equations against systems written by hand, in Markdown.

`python -m benchmarks.equation_systems [MODEL ...]`: 40 s at 200 Hz by eight steps a sample. Values,
seconds (blocked, both in turn), and seconds of compiling, of the motion and of its derivative by
every parameter, which refinement needs.
"""

import sys
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

import riecjax as rx
from benchmarks.recorded import table
from benchmarks.speed.timing import seconds
from riecjax.equations import RoofFunctions
from riecjax.models.catalogue import built_in_model
from riecjax.models.quarter_car.identification import (
    BREAK_POINTS,
)
from riecjax.runtime import start_jax
from riecjax.simulation import AbstractSystem, band_limited_noise

STEP, COUNT, REPEATS = 1 / 200, 8000, 9
SIZES = {"emps": 60.0, "emps-asymmetric": 60.0, "duffing": 20.0, "drag-oscillator": 20.0}
"""Of the inputs, in r.m.s.; 0.5 of others."""


class ByHand(AbstractSystem):
    """A right-hand side `law(values, state, input)` with values of its parameters."""

    law: Callable[..., list[Array]] = eqx.field(static=True)
    like: tuple[Any, Any, Any] = eqx.field(static=True)
    values: dict[str, Array]
    states = property(lambda self: self.like[0])  # pyright: ignore[reportAssignmentType]
    inputs = property(lambda self: self.like[1])  # pyright: ignore[reportAssignmentType]
    reversing = property(lambda self: self.like[2])  # pyright: ignore[reportAssignmentType]

    def derivative(self, state: Array, inputs: Array) -> Array:
        return jnp.stack(self.law(self.values, dict(zip(self.state_names, state)), inputs))


def axis(p, x, u):
    forward, backward = (p.get(f"Fv{side}", p.get("Fv")) for side in ("_pos", "_neg"))
    ahead, back = (p.get(f"Fc{side}", p.get("Fc")) for side in ("_pos", "_neg"))
    rest = jnp.where(x["dq"] < 0, backward * x["dq"] - back, 0.0)
    friction = jnp.where(x["dq"] > 0, forward * x["dq"] + ahead, rest)
    return [x["dq"], (u[0] - p.get("offset", 0.0) - friction) / p["M"]]


def quarter_car(p, x, u):
    damper = RoofFunctions(BREAK_POINTS).interpolate(
        jnp.stack([p[f"F_{i}"] for i in range(1, 5)]), x["x3"] - x["x4"]
    )
    force = p["K_s"] * x["x2"] + damper
    rates = {"x1": u[0] - x["x3"], "x2": x["x3"] - x["x4"], "x4": force / p["M_s"]}
    rates["x3"] = (p["K_t"] * x["x1"] - force) / p["M_us"]
    return [rates[name] for name in x]


def duffing(p, x, u):
    spring = x["y"] * (p["k1"] + x["y"] * (p["k2"] + x["y"] * p["k3"]))
    return [x["dy"], (u[0] - p["d"] * x["dy"] - spring) / p["m"]]


def drag(p, x, u):
    force = u[0] - (p["r"] + p["r2"] * jnp.abs(x["dx"])) * x["dx"] - p["k"] * x["x"]
    return [x["dx"], force / p["m"]]


def pendulum(p, x, u):
    return [x["dtheta"], p["p1"] * jnp.sin(x["theta"]) - p["p2"] * x["dtheta"]]


LAWS = {"quarter-car": quarter_car, "quarter-car-wheel": quarter_car, "duffing": duffing}
LAWS |= {"emps": axis, "emps-asymmetric": axis, "drag-oscillator": drag, "pendulum": pendulum}


def measured(name: str) -> list[str]:
    """One row of the table."""
    model = built_in_model(name)
    values = {q.name: jnp.asarray(q.default) for q in model.parameters}
    made = rx.equation_system(model, values)
    start = {"theta": 3.0} if name == "pendulum" else {}
    wave = band_limited_noise(
        jax.random.key(0), COUNT, STEP, bandwidth=20.0, rms=SIZES.get(name, 0.5)
    )
    record = rx.Record(dict.fromkeys(made.input_names or ("u",), wave), STEP)
    by_hand = ByHand(LAWS[name], (made.states, made.inputs, made.reversing), values)

    def motion(values: dict[str, Array], system: Any) -> dict[str, Array]:
        system = eqx.tree_at(lambda s: s.values, system, values)
        found = rx.simulate(system, record, initial_state=start).record
        return {n: found[n] for n in found.signals}

    cells: list[str] = []
    for function in (eqx.filter_jit(motion), eqx.filter_jit(jax.jacfwd(motion))):
        works = [lambda s=s: function(values, s) for s in (made, by_hand)]  # noqa: B023
        compiling = " / ".join(f"{seconds(work):.1f}" for work in works)
        if not cells:
            here, there = (work() for work in works)
            common = here.keys() & there.keys()
            apart = [np.abs(here[n] - there[n]).max() / np.ptp(there[n]) for n in common]
            cells = [name, f"{max(apart):.1e}"]
        turns = np.array([[seconds(work) for work in works] for _ in range(REPEATS)])
        ours, theirs = 1e3 * np.median(turns, axis=0)
        ratio = np.median(turns[:, 0] / turns[:, 1])
        cells += [f"{ours:.1f} / {theirs:.1f} ms", f"{ratio:.2f}", f"{compiling} s"]
    return cells


if __name__ == "__main__":
    start_jax()
    head = ("model", "difference", "motion", "ratio", "compiling")
    rows = [measured(name) for name in sys.argv[1:] or LAWS]
    print(table((*head, "derivative", "ratio", "compiling"), rows))

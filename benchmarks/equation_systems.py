"""Built-in models simulated by their equations, against right-hand sides written by hand.

`python -m benchmarks.equation_systems [MODEL ...]`: 40 s at 200 Hz by eight steps a sample. The
largest difference of a signal as a share of its range, and milliseconds (blocked, both in turn) of
the motion, and of its derivative by every parameter, as refinement needs.
"""

import sys
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import riecjax as rx
from benchmarks.recorded import table
from benchmarks.speed.timing import seconds
from riecjax.equations import RoofFunctions
from riecjax.models.quarter_car import BREAK_POINTS
from riecjax.runtime import start_jax
from riecjax.simulation import AbstractSystem, band_limited_noise

STEP, COUNT, REPEATS = 1 / 200, 8000, 9
RMS = {"emps": 60.0, "emps-asymmetric": 60.0, "duffing": 20.0, "drag-oscillator": 20.0}


class ByHand(AbstractSystem):
    """The right-hand side of a model, with the states of the system that its equations make."""

    name: str = eqx.field(static=True)
    values: dict[str, jax.Array]
    states: Any = eqx.field(static=True)
    inputs: Any = eqx.field(static=True)

    @property
    def reversing(self) -> tuple[str, ...]:  # pyright: ignore
        return ("dq",) if self.name.startswith("emps") else ()

    def derivative(self, state: jax.Array, inputs: jax.Array) -> jax.Array:
        return jnp.stack(right_hand_side(self.name, self.values, state, inputs))


def right_hand_side(name: str, p: Mapping[str, Any], state: Any, u: Any) -> list:
    if name.startswith("quarter-car"):
        x1, x2, x3, x4 = (state[i] for i in range(4))
        forces = jnp.stack([p[f"F_{i}"] for i in range(1, 5)])
        force = p["K_s"] * x2 + RoofFunctions(BREAK_POINTS).interpolate(forces, x3 - x4)
        return [u[0] - x3, x3 - x4, (p["K_t"] * x1 - force) / p["M_us"], force / p["M_s"]]
    x, v = state[0], state[1]
    if name == "duffing":
        spring = x * (p["k1"] + x * (p["k2"] + x * p["k3"]))
        return [v, (u[0] - p["d"] * v - spring) / p["m"]]
    if name == "drag-oscillator":
        return [v, (u[0] - (p["r"] + p["r2"] * jnp.abs(v)) * v - p["k"] * x) / p["m"]]
    if name == "pendulum":
        return [v, p["p1"] * jnp.sin(x) - p["p2"] * v + u[0]]
    p = {"offset": jnp.zeros(()), **p} | {k + s: p[k] for k in p for s in ("_pos", "_neg")}
    ahead, back = p["Fv_pos"] * v + p["Fc_pos"], p["Fv_neg"] * v - p["Fc_neg"]
    friction = jnp.where(v > 0, ahead, jnp.where(v < 0, back, 0.0))
    return [v, (u[0] - p["offset"] - friction) / p["M"]]


def measured(name: str) -> list[str]:
    """One row of the table."""
    made: Any = rx.find_model(name).build_system({})
    by_hand = ByHand(name=name, values=made.values, states=made.states, inputs=made.inputs)
    rms, start = RMS.get(name, 0.5), {"theta": 3.0} if name == "pendulum" else {}
    wave = band_limited_noise(jax.random.key(0), COUNT, STEP, bandwidth=20.0, rms=rms)
    record = rx.Record(dict.fromkeys(made.input_names, wave), STEP)

    def motion(values: dict[str, jax.Array], system: Any) -> dict[str, jax.Array]:
        system = eqx.tree_at(lambda s: s.values, system, values)
        found = rx.simulate(system, record, initial_state=start).record
        return {signal: found[signal] for signal in found.signals}

    row: list[str] = []
    for function in (eqx.filter_jit(motion), eqx.filter_jit(jax.jacfwd(motion))):
        works = [lambda s=s, f=function: f(made.values, s) for s in (made, by_hand)]
        here, there = (jax.block_until_ready(work()) for work in works)
        turns = np.array([[seconds(work) for work in works] for _ in range(REPEATS)])
        ours, theirs = 1e3 * np.median(turns, axis=0)
        if not row:
            common = here.keys() & there.keys()
            shares = (np.abs(here[n] - there[n]).max() / np.ptp(there[n]) for n in common)
            row = [name, f"{max(shares):.0e}"]
        row += [f"{ours:.1f} / {theirs:.1f} ms", f"{np.median(turns[:, 0] / turns[:, 1]):.2f}"]
    return row


if __name__ == "__main__":
    start_jax()
    names = ("quarter-car", "quarter-car-wheel", *RMS, "pendulum")
    head = ("model", "difference", "motion", "ratio", "derivative", "ratio")
    print(table(head, [measured(name) for name in sys.argv[1:] or names]))

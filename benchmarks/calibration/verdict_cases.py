"""Systems with known truth, right and wrong models of them, and sensors with and without faults.

Oscillators of six kinds are integrated by Runge-Kutta at ten steps per sample, all of a kind at
once, under forces that are sums of sines and so known at every instant. Each is then recorded with
noise and one fault at most, and described by a model that is right or leaves one thing out.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

import riecjax as rx
from riecjax.equations.model import as_model

RATE = 200.0
SAMPLES = 6000
STEPS = 10
"""Runge-Kutta steps per sample."""
TONES = 120
NOISES = (0.0, 0.01, 0.05)

Series = Float[np.ndarray, "systems samples"]
Values = dict[str, Float[np.ndarray, " systems"]]


def _body(*more: rx.Term, name: str = "body") -> rx.Equation:
    return rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("v",), unit="kg"),
        rx.Term("c", "x", derivative=1, measured=("v",), unit="N s/m"),
        rx.Term("k", "x", unit="N/m"),
        *more,
        -rx.Term(1.0, "u"),
        name=name,
        unit="N",
    )


LINEAR = _body(name="linear")
FRICTION = _body(rx.Term("f", rx.odd("v", 0), unit="N"), name="friction")
DRAG = _body(rx.Term("r2", rx.odd("v", 2), unit="N s^2/m^2"), name="drag")
CUBIC = _body(rx.Term("k3", rx.odd("x", 3), unit="N/m^3"), name="cubic")
COUPLED = rx.simultaneous(
    rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("v",), unit="kg"),
        rx.Term("k", "x", unit="N/m"),
        rx.Term("c2", rx.difference("v", "v2"), unit="N s/m"),
        rx.Term("k2", rx.difference("x", "x2"), unit="N/m"),
        -rx.Term(1.0, "u"),
        name="driven",
        unit="N",
    ),
    rx.Equation(
        rx.Term("m2", "x2", derivative=2, measured=("v2",), unit="kg"),
        -rx.Term("c2", rx.difference("v", "v2"), unit="N s/m"),
        -rx.Term("k2", rx.difference("x", "x2"), unit="N/m"),
        name="carried",
        unit="N",
    ),
)


class Kind(NamedTuple):
    """A model, the physics behind the recordings, and what the model leaves out of it."""

    name: str
    model: rx.Equation | rx.Model
    left_out: str = ""


KINDS = (
    Kind("linear", LINEAR),
    Kind("friction", FRICTION),
    Kind("drag", DRAG),
    Kind("cubic", CUBIC),
    Kind("coupled", COUPLED),
    Kind("mode left out", LINEAR, "mode"),
    Kind("friction left out", LINEAR, "friction"),
    Kind("cubic left out", LINEAR, "cubic"),
    Kind("second body left out", LINEAR, "coupled"),
)
FAULTS = (
    "none",
    "late force",
    "differentiated velocity",
    "short",
    "position only",
    "coarse",
    "force with offset",
    "velocity times 1.2",
    "disturbed",
    "clipped force",
)


class Case(NamedTuple):
    """A model, a record or several, the parameters' true values, windows, if not the usual, and
    true values `beside_mode`, where one that the model leaves out is added."""

    kind: str
    fault: str
    noise: float
    model: rx.Equation | rx.Model
    record: rx.Record | list[rx.Record]
    truth: dict[str, float]
    criterion: rx.RIEC | None = None
    beside_mode: Mapping[str, float] = MappingProxyType({})


def draw(kind: Kind, rng: np.random.Generator, systems: int) -> Values:
    """Random parameters: 0.8 to 5 Hz, damping 3 to 25 %, and what the kind has beside."""
    m = np.exp(rng.uniform(np.log(0.5), np.log(500), systems))
    omega = 2 * np.pi * np.exp(rng.uniform(np.log(0.8), np.log(5), systems))
    zeta = np.exp(rng.uniform(np.log(0.03), np.log(0.25), systems))
    physics = kind.left_out or kind.name
    values = {"m": m, "c": 2 * zeta * omega * m, "k": m * omega**2}
    share = rng.uniform(0.05, 0.4, systems)
    second = omega * np.exp(rng.uniform(np.log(1.3), np.log(5), systems))
    if physics in ("mode", "coupled"):
        m2, zeta2 = share * m, rng.uniform(0.03, 0.3, systems)
        values |= {"m2": m2, "k2": m2 * second**2, "c2": 2 * zeta2 * second * m2}
        if kind.name == "coupled":
            del values["c"]
    # By the size of a force of one newton per kilogram: a few to thirty percent of what acts.
    scale = m * rng.uniform(0.1, 0.6, systems)
    if physics == "friction":
        values["f"] = scale
    if physics == "drag":
        values["r2"] = scale * omega**2
    if physics == "cubic":
        values["k3"] = scale * omega**6
    return values


def simulate(values: Values, rng: np.random.Generator, disturbed: bool) -> dict[str, Series]:
    """Motions of all systems of one kind, at the samples."""
    systems = values["m"].size
    low, high = 0.3 + 0 * values["m"], 12.0 + 0 * values["m"]
    frequency = rng.uniform(low[:, None], high[:, None], (systems, TONES))
    phase = rng.uniform(0, 2 * np.pi, (systems, TONES))
    time = np.arange(SAMPLES * STEPS * 2 + 1) / (RATE * STEPS * 2)
    force = np.stack([tones(time, f, p) for f, p in zip(frequency, phase)]) * values["m"][:, None]
    hidden = 0.0 * force
    if disturbed:
        other = rng.uniform(0.3, 12.0, (systems, TONES)), rng.uniform(0, 6.3, (systems, TONES))
        hidden = np.stack([0.08 * tones(time, f, p) for f, p in zip(*other)])
        hidden *= values["m"][:, None]
    state = integrated(values, force + hidden)
    return {
        "x": state[0],
        "v": state[1],
        "x2": state[2],
        "v2": state[3],
        "u": force[:, : -1 : 2 * STEPS],
    }


def tones(time: np.ndarray, frequency: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """A sum of sines, 3 rms."""
    total = np.zeros(time.size)
    for f, p in zip(frequency, phase):
        total += np.sin(2 * np.pi * f * time + p)
    return total * np.sqrt(2 / TONES) * 3


def integrated(values: Values, force: Series) -> list[Series]:
    """x, v, x2, v2 at the samples, of a force known at `2 STEPS` instants to each of them."""

    def get(name: str) -> np.ndarray:
        return values.get(name, 0.0 * values["m"])

    m, c, k, m2, c2, k2 = (get(n) for n in ("m", "c", "k", "m2", "c2", "k2"))
    f, r2, k3 = get("f"), get("r2"), get("k3")
    second = np.where(m2 > 0, m2, 1.0)
    steep = 1e3  # of the friction's step, per (m/s): far below a sample's change of speed

    def rates(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        x, v, x2, v2 = s
        link = c2 * (v - v2) + k2 * (x - x2)
        own = c * v + k * x + k3 * x**3 + f * np.tanh(steep * v) + r2 * v * abs(v)
        return np.stack([v, (u - own - link) / m, v2, link / second])

    h = 1 / (RATE * STEPS)
    state = np.zeros((4, m.size))
    kept = np.empty((4, m.size, SAMPLES))
    for n in range(SAMPLES):
        kept[:, :, n] = state
        for i in range(STEPS):
            a, b, e = (force[:, 2 * (n * STEPS + i) + j] for j in range(3))
            d1 = rates(state, a)
            d2 = rates(state + h / 2 * d1, b)
            d3 = rates(state + h / 2 * d2, b)
            d4 = rates(state + h * d3, e)
            state = state + h / 6 * (d1 + 2 * d2 + 2 * d3 + d4)
    return list(kept)


def recorded(
    motion: Mapping[str, np.ndarray],
    fault: str,
    noise: float,
    rng: np.random.Generator,
    signals: tuple[str, ...],
) -> rx.Record:
    """One system's record by sensors with noise and a fault."""
    rows = {name: np.asarray(motion[name]) for name in signals}
    step = 1 / RATE
    if fault == "late force":
        rows["u"] = np.roll(rows["u"], int(rng.integers(1, 4)))
    if fault == "force with offset":
        rows["u"] = rows["u"] + 0.2 * np.std(rows["u"])
    if fault == "velocity times 1.2":
        rows["v"] = 1.2 * rows["v"]
    rows = {
        name: row + noise * np.std(row) * rng.standard_normal(row.size)
        for name, row in rows.items()
    }
    if fault == "clipped force":
        limit = 1.5 * np.std(rows["u"])
        rows["u"] = np.clip(rows["u"], -limit, limit)
    if fault == "differentiated velocity":
        rows["v"] = np.gradient(rows["x"], step)
    if fault == "position only":
        rows = {name: row for name, row in rows.items() if not name.startswith("v")}
    if fault == "short":
        rows = {name: row[1000:2000] for name, row in rows.items()}
    if fault == "coarse":
        rows, step = {name: row[::6] for name, row in rows.items()}, 6 * step
    return rx.Record(rows, step)


def cases(kind: Kind, fault: str, seed: int, systems: int) -> list[Case]:
    """`systems` cases of a kind with a fault, over the noises in turn."""
    key = [seed, KINDS.index(kind), FAULTS.index(fault)]
    rng = np.random.default_rng(key)
    values = draw(kind, rng, systems)
    motion = simulate(values, rng, fault == "disturbed")
    model = kind.model
    parameters = as_model(model).parameter_names
    signals = ("x", "v", "u", *(("x2", "v2") if kind.name == "coupled" else ()))
    if fault == "position only" and kind.name in ("friction", "drag", "coupled"):
        fault = "none"  # these equations read the velocity
    found = []
    for i in range(systems):
        noise = NOISES[i % len(NOISES)]
        record = recorded({n: s[i] for n, s in motion.items()}, fault, noise, rng, signals)
        truth = {name: float(values[name][i]) for name in parameters}
        own = {"m": truth["m"]}
        if kind.left_out in ("mode", "coupled"):
            # What a body without the other stands for: both, as they move together when slow.
            truth["m"] = float(values["m"][i] + values["m2"][i])
        found.append(Case(kind.name, fault, noise, model, record, truth, beside_mode=own))
    return found

"""Eight classes of recordings by which a verdict is easily misled, with known truth.

Machines are integrated by Runge-Kutta at ten steps per sample or more, all of a class at once. Some
models are right and what is recorded tells little; others leave one thing out that motion of this
kind hides.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

import riecjax as rx
from benchmarks.calibration.verdict_cases import KINDS, Case, draw, recorded, simulate

STEPS = 10
"""Runge-Kutta steps per sample."""
TONES = 6

State = Float[np.ndarray, "states systems"]
Force = Callable[[float | np.ndarray], np.ndarray]


def log_uniform(rng: np.random.Generator, low: float, high: float, size: int) -> np.ndarray:
    """Random numbers whose logarithms are spread evenly."""
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


def integrated(
    rates: Callable[[State, float], State], start: State, step: float, samples: int
) -> Float[np.ndarray, "states systems samples"]:
    """States of all systems at the samples."""
    h, state = step / STEPS, np.array(start, float)
    kept = np.empty((*state.shape, samples))
    for n in range(samples):
        kept[..., n] = state
        for i in range(STEPS):
            at = n * step + i * h
            d1 = rates(state, at)
            d2 = rates(state + h / 2 * d1, at + h / 2)
            d3 = rates(state + h / 2 * d2, at + h / 2)
            d4 = rates(state + h * d3, at + h)
            state = state + h / 6 * (d1 + 2 * d2 + 2 * d3 + d4)
    return kept


def sines(
    rng: np.random.Generator, systems: int, low: float, high: float, tones: int = TONES
) -> Force:
    """Sums of sines of one root mean square, a function of time."""
    frequency = log_uniform(rng, low, high, systems * tones).reshape(systems, tones)
    phase = rng.uniform(0, 2 * np.pi, (systems, tones))

    def force(time: float | np.ndarray) -> np.ndarray:
        angle = 2 * np.pi * np.multiply.outer(frequency, time)
        shape = (systems, tones) + (1,) * np.ndim(time)
        return np.sum(np.sin(angle + phase.reshape(shape)), axis=1) * np.sqrt(2 / tones)

    return force


def noisy(rng: np.random.Generator, level: float, **rows: np.ndarray) -> dict[str, np.ndarray]:
    """Rows with white noise, a share of each one's deviation."""
    return {
        name: row + level * np.std(row) * rng.standard_normal(row.size)
        for name, row in rows.items()
    }


SPINDLE = rx.Equation(
    rx.Term("J", "w", derivative=1, unit="kg m^2"),
    rx.Term("B", "w", unit="N m s"),
    -rx.Term(1.0, "T"),
    name="spindle",
    unit="N m",
)


def one_way(rng: np.random.Generator, systems: int) -> list[Case]:
    """A spindle that turns one way, against a constant torque that its model lacks."""
    return _spindles("one way", rng, systems, tones=4, turning=True)


def one_tone(rng: np.random.Generator, systems: int) -> list[Case]:
    """A spindle driven by one tone, of every other one of which a constant torque is missing."""
    return _spindles("one tone", rng, systems, tones=1, turning=False)


def _spindles(
    kind: str, rng: np.random.Generator, systems: int, tones: int, turning: bool
) -> list[Case]:
    step, samples = 0.005, 4000
    inertia = log_uniform(rng, 1e-5, 1e-1, systems)
    damping = inertia / log_uniform(rng, 0.3, 4, systems)
    force = sines(rng, systems, 0.2, 8 if tones > 1 else 3, tones)
    speed = rng.uniform(40, 120, systems) * turning
    # Of all that turns the spindle, a tenth to a half.
    constant = damping * np.where(turning, speed, 20) * rng.uniform(0.1, 0.5, systems)
    if not turning:
        constant *= np.arange(systems) % 2
    size = inertia * rng.uniform(20, 60, systems)
    mean = damping * speed + constant * turning
    friction = constant * np.where(turning, 1, -1)

    def rates(w: State, at: float) -> State:
        return (mean + size * force(at) - damping * w - friction) / inertia

    w = integrated(rates, speed[None], step, samples)[0]
    torque = mean[:, None] + size[:, None] * force(step * np.arange(samples))
    found = []
    for i in range(systems):
        level = (0.001, 0.005, 0.02)[i % 3]
        record = rx.Record(noisy(rng, level, w=w[i], T=torque[i]), step)
        truth = {"J": float(inertia[i]), "B": float(damping[i])}
        fault = "constant missing" if constant[i] else "none"
        found.append(Case(kind, fault, level, SPINDLE, record, truth))
    return found


FRONT_ARM, REAR_ARM, MASS = 1.1, 1.6, 1500.0


def _front(s: Mapping[str, Any]) -> Any:
    """Slip angle of the front axle."""
    return s["delta"] - (s["vy"] + FRONT_ARM * s["r"]) / s["vx"]


def _rear(s: Mapping[str, Any]) -> Any:
    """Slip angle of the rear axle."""
    return -(s["vy"] - REAR_ARM * s["r"]) / s["vx"]


CAR = rx.staged(
    rx.Equation(
        rx.Term(MASS, "ay", unit="N"),
        -rx.Term("Cf", _front, unit="N/rad"),
        -rx.Term("Cr", _rear, unit="N/rad"),
        name="lateral",
    ),
    rx.Equation(
        rx.Term("Iz", "r", derivative=1, unit="kg m^2"),
        -rx.Term("Cf", lambda s: FRONT_ARM * _front(s), unit="N/rad"),
        rx.Term("Cr", lambda s: REAR_ARM * _rear(s), unit="N/rad"),
        name="yaw",
    ),
)


def lever_arm(rng: np.random.Generator, systems: int, ahead: float | None = None) -> list[Case]:
    """A car by its single-track model, the accelerometer ahead of the mass centre or behind it."""
    step, samples = 0.01, 6000
    inertia = rng.uniform(1800, 3200, systems)
    front, rear = rng.uniform(6e4, 1.2e5, systems), rng.uniform(9e4, 1.6e5, systems)
    lever = rng.uniform(0.2, 0.8, systems) * rng.choice([-1, 1], systems)
    lever = lever if ahead is None else np.full(systems, ahead)
    speed, steering = rng.uniform(15, 25, systems), sines(rng, systems, 0.1, 2.5)

    def slips(state: State, at: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        vx = speed + 3 * np.sin(2 * np.pi * 0.03 * at)
        alpha = 0.012 * steering(at) - (state[0] + FRONT_ARM * state[1]) / vx
        return front * alpha, -rear * (state[0] - REAR_ARM * state[1]) / vx, vx

    def rates(state: State, at: float) -> State:
        f, r, vx = slips(state, at)
        return np.stack([(f + r) / MASS - state[1] * vx, (FRONT_ARM * f - REAR_ARM * r) / inertia])

    motion = integrated(rates, np.zeros((2, systems)), step, samples)
    time = step * np.arange(samples)
    found = []
    for i in range(systems):
        level = (0.0, 0.01, 0.03)[i % 3]
        vy, r = motion[:, i]
        vx = speed[i] + 3 * np.sin(2 * np.pi * 0.03 * time)
        delta = 0.012 * steering(time)[i]
        f = front[i] * (delta - (vy + FRONT_ARM * r) / vx)
        b = -rear[i] * (vy - REAR_ARM * r) / vx
        seen = (f + b) / MASS + lever[i] * (FRONT_ARM * f - REAR_ARM * b) / inertia[i]
        rows = noisy(rng, level, delta=delta, r=r, ay=seen, vx=vx, vy=vy)
        truth = {"Cf": float(front[i]), "Cr": float(rear[i]), "Iz": float(inertia[i])}
        found.append(Case("lever arm", "wrong stage", level, CAR, rx.Record(rows, step), truth))
    return found


BODY = KINDS[0].model


def short_pulses(rng: np.random.Generator, systems: int, shortest: float = 1.2) -> list[Case]:
    """A mass on a spring, struck by a hammer whose pulses last from `shortest` to four samples.

    Of every other one all pulses begin at the same place between samples, as of a trigger.
    """
    step, samples, blows = 0.002, 6000, 12
    mass = log_uniform(rng, 0.5, 50, systems)
    omega = 2 * np.pi * log_uniform(rng, 2, 8, systems)
    damping = 2 * rng.uniform(0.03, 0.1, systems) * omega * mass
    stiffness = mass * omega**2
    width = step * rng.uniform(shortest, 4, systems)
    peak = 20 * mass * rng.uniform(0.8, 1.2, (blows, systems)) * 2 * step / width
    starts = 0.3 + np.arange(blows)[:, None] + rng.uniform(0, 0.3, (blows, systems))
    triggered = 2 * step * np.round(starts / (2 * step)) + rng.uniform(0, step, systems)
    starts = np.where(np.arange(systems) % 2, triggered, starts)

    def force(at: float) -> np.ndarray:
        inside = (at - starts) / width
        return np.sum(peak * np.sin(np.pi * inside) * ((inside >= 0) & (inside < 1)), axis=0)

    def rates(state: State, at: float) -> State:
        x, v = state
        return np.stack([v, (force(at) - damping * v - stiffness * x) / mass])

    motion = integrated(rates, np.zeros((2, systems)), step, samples)
    forces = np.stack([force(step * n) for n in range(samples)], axis=1)
    found = []
    for i in range(systems):
        level = (0.0, 0.001, 0.01)[i % 3]
        rows = noisy(rng, level, x=motion[0, i], v=motion[1, i], u=forces[i])
        truth = {"m": float(mass[i]), "c": float(damping[i]), "k": float(stiffness[i])}
        found.append(Case("short pulses", "pulses", level, BODY, rx.Record(rows, step), truth))
    return found


def held_signals(rng: np.random.Generator, systems: int) -> list[Case]:
    """A mass on a spring, of which one signal comes over a slow bus and is repeated until then."""
    values = draw(KINDS[0], rng, systems)
    motion = simulate(values, rng, False)
    found = []
    for i in range(systems):
        level, every = (0.0, 0.01, 0.05)[i % 3], int(rng.integers(2, 7))
        record = recorded({n: s[i] for n, s in motion.items()}, "none", level, rng, ("x", "v", "u"))
        name = ("x", "v", "u")[int(rng.integers(3))]
        slow = np.asarray(record[name])[::every]
        record = record.with_signals({name: np.repeat(slow, every)[: record.sample_count]})
        truth = {n: float(values[n][i]) for n in ("m", "c", "k")}
        found.append(Case("held signals", f"{name} held", level, BODY, record, truth))
    return found


SHAKER = rx.Equation(
    rx.Term("m1", "a1", unit="kg"),
    rx.Term("m2", "a2", unit="kg"),
    -rx.Term(1.0, "F"),
    name="shaker",
    unit="N",
)


def accelerations(rng: np.random.Generator, systems: int) -> list[Case]:
    """Two masses on a soft spring, of which accelerometers alone tell; windows of their band."""
    step, samples = 0.002, 5000
    first, second = (log_uniform(rng, 2, 50, systems) for _ in range(2))
    omega = 2 * np.pi * log_uniform(rng, 3, 12, systems)
    stiffness = second * omega**2
    damping = 0.1 * second * omega
    force, size = sines(rng, systems, 6, 40), 5 * first

    def link(state: State) -> np.ndarray:
        return stiffness * (state[0] - state[2]) + damping * (state[1] - state[3])

    def rates(state: State, at: float) -> State:
        between = link(state)
        return np.stack(
            [state[1], (size * force(at) - between) / first, state[3], between / second]
        )

    motion = integrated(rates, np.zeros((4, systems)), step, samples)
    pushed = size[:, None] * force(step * np.arange(samples))
    between = np.stack([link(motion[..., n]) for n in range(samples)], axis=1)
    by = rx.RIEC(rx.AllWindows(0.025, 0.25))
    found = []
    for i in range(systems):
        level = (0.01, 0.05, 0.2)[i % 3]
        a1, a2 = (pushed[i] - between[i]) / first[i], between[i] / second[i]
        record = rx.Record(noisy(rng, level, a1=a1, a2=a2, F=pushed[i]), step)
        truth = {"m1": float(first[i]), "m2": float(second[i])}
        found.append(Case("accelerations", "none", level, SHAKER, record, truth, by))
    return found


ARM = rx.Equation(
    rx.Term("kS", rx.odd("velocity", 0), unit="V"),
    rx.Term("kV", "position", derivative=1, measured=("velocity",), unit="V s"),
    rx.Term("kA", "position", derivative=2, measured=("velocity",), unit="V s^2"),
    rx.Term("kG", lambda s: np.cos(s["position"]), unit="V"),
    -rx.Term(1.0, "voltage"),
    name="arm",
    unit="V",
)


def step_tests(rng: np.random.Generator, systems: int) -> list[Case]:
    """A geared arm under slow ramps and steps of voltage, its velocity a mean over some time."""
    fine, coarse = 0.001, 20
    truth = {
        "kS": rng.uniform(0.1, 0.4, systems),
        "kV": rng.uniform(0.8, 2.5, systems),
        "kA": rng.uniform(0.05, 0.2, systems),
        "kG": rng.uniform(0.3, 1.0, systems),
    }
    taps = rng.choice([1, 20, 40, 60], systems)
    tests = ((1, 0.6, 0.0), (-1, 0.6, 0.0), (1, 0.0, 4.0), (-1, 0.0, 4.0))
    records: list[list[rx.Record]] = [[] for _ in range(systems)]
    for sign, ramp, level in tests:
        seconds = 12 if ramp else 3
        angle, speed = np.full(systems, -1.4 * sign), np.zeros(systems)
        kept = np.empty((3, systems, round(seconds / fine)))
        for n in range(kept.shape[-1]):
            volts = sign * (level + ramp * n * fine)
            kept[:, :, n] = angle, speed, np.full(systems, volts)
            for _ in range(4):
                net = volts - truth["kG"] * np.cos(angle)
                way = np.where(np.abs(speed) > 1e-9, np.sign(speed), np.sign(net))
                faster = net - truth["kV"] * speed - truth["kS"] * way
                after = speed + fine / 4 * faster / truth["kA"]
                sticks = (np.abs(speed) < 1e-9) & (np.abs(net) <= truth["kS"])
                speed = np.where(sticks | (after * speed < 0), 0.0, after)
                angle = angle + fine / 4 * speed
        for i in range(systems):
            a, w, u = kept[:, i]
            outside = np.flatnonzero(np.abs(a) > 1.8)
            w = np.convolve(w, np.ones(taps[i]) / taps[i])[: w.size]
            rows = [row[: outside[0] if outside.size else None : coarse] for row in (a, w, u)]
            tick = 2 * np.pi / 4096
            signals = {
                "position": tick * np.round(rows[0] / tick),
                "velocity": rows[1] + 0.01 * rng.standard_normal(rows[1].size),
                "voltage": rows[2] + 0.01 * rng.standard_normal(rows[2].size),
            }
            records[i].append(rx.Record(signals, fine * coarse))
    return [
        Case(
            "step tests",
            f"mean over {taps[i]} ms" if taps[i] > 1 else "none",
            0.01,
            ARM,
            records[i],
            {name: float(of[i]) for name, of in truth.items()},
            rx.RIEC(rx.AllWindows(0.06, 0.3)),
        )
        for i in range(systems)
    ]


def load_on_spring(rng: np.random.Generator, systems: int) -> list[Case]:
    """A motor that turns a load by a spring, seen from the motor as if both were one body.

    What a body with the other stands for: both, as they move together when slow.
    """
    step, samples = 0.002, 8000
    inertia = log_uniform(rng, 1e-4, 1e-1, systems)
    load = inertia * rng.uniform(0.2, 2, systems)
    damping = (inertia + load) / log_uniform(rng, 0.2, 2, systems)
    omega = 2 * np.pi * log_uniform(rng, 4, 40, systems)
    stiffness = load * omega**2
    link = 2 * rng.uniform(0.02, 0.1, systems) * load * omega
    force, size = sines(rng, systems, 0.3, 12, 12), 30 * (inertia + load)

    def rates(state: State, at: float) -> State:
        q, w, ql, wl = state
        between = stiffness * (q - ql) + link * (w - wl)
        return np.stack(
            [w, (size * force(at) - damping * w - between) / inertia, wl, between / load]
        )

    motion = integrated(rates, np.zeros((4, systems)), step, samples)
    torque = size[:, None] * force(step * np.arange(samples))
    found = []
    for i in range(systems):
        level = (0.0, 0.01, 0.05)[i % 3]
        record = rx.Record(noisy(rng, level, w=motion[1, i], T=torque[i]), step)
        truth = {"J": float(inertia[i] + load[i]), "B": float(damping[i])}
        own = {"J": float(inertia[i])}
        found.append(
            Case(
                "load on a spring", "mode left out", level, SPINDLE, record, truth, beside_mode=own
            )
        )
    return found


VALUES = 150
"""Judged values of each class."""
CLASSES = {
    "one way": (one_way, VALUES // 2 + 5),
    "one tone": (one_tone, VALUES // 2),
    "lever arm": (lever_arm, VALUES // 3),
    "short pulses": (short_pulses, VALUES // 3),
    "held signals": (held_signals, VALUES // 3),
    "accelerations": (accelerations, VALUES // 2),
    "step tests": (step_tests, -(-VALUES // 4)),
    "load on a spring": (load_on_spring, VALUES // 2),
}
"""Each with as many systems as make so many values; of some that turn one way nothing is told."""


def class_cases(name: str, seed: int, most: int | None = None, **asked: float) -> list[Case]:
    """The cases of a class, or fewer of them; what is `asked` of its machines beside."""
    make, systems = CLASSES[name]
    rng = np.random.default_rng([seed, [*CLASSES].index(name)])
    return make(rng, min(most or systems, systems), **asked)

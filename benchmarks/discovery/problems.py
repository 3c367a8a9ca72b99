"""Motions whose equations are known, and models that lack some of their terms.

Simulated between reversals, so that dry friction switches where the velocity does; noise is white,
a share of the position's and of the velocity's standard deviation.
"""

import functools
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.integrate
from jaxtyping import Array

import riecjax as rx

Acceleration = Callable[[float, float, float, float], float]
"""Of time, position, velocity and the direction of sliding."""
COUNT, RATE = 4001, 100
AXIS_COUNT, AXIS_RATE = 8001, 400
WIDTH = 0.2


class Problem(NamedTuple):
    """A model that lacks terms, and what these are.

    **Fields:** `start`; `missing`, names of the candidates that make it whole; `whole`, the model
    with all of them; `motion`, signals of a seed without noise, and `time_step`.
    """

    name: str
    start: rx.Equation
    missing: frozenset[str]
    whole: rx.Equation | rx.equations.Procedure
    motion: Callable[[int], dict[str, np.ndarray]]
    time_step: float

    def record(self, noise: float, motion: int, seed: int) -> rx.Record:
        """One of its motions with noise on position and velocity."""
        signals = dict(self.motion(motion))
        rng = np.random.default_rng(1000 + seed)
        for name in ("x", "dx"):
            spread = noise * signals[name].std()
            signals[name] = signals[name] + spread * rng.standard_normal(signals[name].size)
        return rx.Record.from_samples(signals, time_step=self.time_step)


def tones(times: np.ndarray | float, frequencies: list[float], size: float, seed: int):
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(frequencies))
    each = [np.sin(2 * np.pi * f * np.asarray(times) + p) for f, p in zip(frequencies, phases)]
    return size / np.sqrt(len(frequencies)) * np.sum(each, axis=0)


def moved(
    acceleration: Acceleration, times: np.ndarray, start: float = 0.0
) -> dict[str, np.ndarray]:
    """Position and velocity from rest, reversal by reversal; what sticks waits to be let go."""
    x, v = np.empty(times.size), np.empty(times.size)
    now, place = float(times[0]), start
    while True:
        direction = _let_go(acceleration, now, place)
        if direction == 0.0:
            then = now + 0.25 * float(times[1] - times[0])
            inside = (times >= now) & (times <= then)
            x[inside], v[inside] = place, 0.0
        else:
            run = _slid(acceleration, now, place, direction, float(times[-1]))
            then = float(run.t[-1])
            inside = (times >= now) & (times <= then)
            x[inside], v[inside] = run.sol(times[inside])
            place = float(run.y[0, -1])
        now = then
        if now >= times[-1]:
            return {"x": x, "dx": v}


def _let_go(acceleration: Acceleration, now: float, place: float) -> float:
    """In which direction it slides off; 0 where it sticks."""
    for direction in (1.0, -1.0):
        if acceleration(now, place, 0.0, direction) * direction > 0:
            return direction
    return 0.0


def _slid(acceleration: Acceleration, now: float, place: float, direction: float, end: float):
    def reversal(t: float, state: np.ndarray) -> float:
        return state[1] if t > now + 1e-9 else direction

    reversal.terminal, reversal.direction = True, -direction  # type: ignore[attr-defined]
    return scipy.integrate.solve_ivp(
        lambda t, s: [s[1], acceleration(t, s[0], s[1], direction)],
        (now, end),
        [place, 0.0],
        events=reversal,
        dense_output=True,
        rtol=1e-8,
        atol=1e-10,
        max_step=0.1,
    )


_FORCE = [0.13, 0.31, 0.53, 0.71, 0.97, 1.3, 1.9, 2.3]


def _driven(size: float, force: Callable[[float, float, float], float], late: float = 0.0):
    """Motions of 1.5 kg under tones, and a force of position, velocity and direction.

    **Arguments:** `late`, seconds by which the tones come late in the recording.
    """

    @functools.cache
    def motion(seed: int) -> dict[str, np.ndarray]:
        times = np.arange(COUNT) / RATE

        def drive(t: np.ndarray | float):
            return tones(t, _FORCE, size, seed)

        found = moved(lambda t, x, v, d: (drive(t) - force(x, v, d)) / 1.5, times)
        return {**found, "u": drive(times - late)}

    return motion


@functools.cache
def _axis(seed: int) -> dict[str, np.ndarray]:
    times = np.arange(AXIS_COUNT) / AXIS_RATE

    def drive(t: np.ndarray | float):
        # Strong enough that it hardly ever sticks.
        return tones(t, [0.5, 0.9, 1.3, 1.7, 2.3], 250.0, seed)

    def acceleration(t: float, x: float, v: float, d: float) -> float:
        viscous, dry = (240.0, 24.0) if d < 0 else (167.0, 18.0)
        return float(drive(t) - viscous * v - dry * d) / 95.0

    return {**moved(acceleration, times), "u": drive(times)}


@functools.cache
def _pendulum(seed: int) -> dict[str, np.ndarray]:
    start = float(np.random.default_rng(seed).uniform(2.0, 2.8))
    return moved(
        lambda t, x, v, d: -64.2 * np.sin(x) - 0.07 * v - 0.05 * v * abs(v),
        np.arange(COUNT) / RATE,
        start,
    )


def _sine(signals: Mapping[str, Array]) -> Array:
    return jnp.sin(signals["x"])


_INERTIA = rx.Term("m", "x", derivative=2, measured=("dx",), unit="kg")
_FORCE_TERM = -rx.Term(1.0, "u")
_VISCOUS = rx.Term("c", "x", derivative=1, measured=("dx",), unit="N s/m")
_SPRING = rx.Term("k", "x", unit="N/m")
_SWING = (
    rx.Term(1.0, "x", derivative=2, measured=("dx",)),
    rx.Term("p1", _sine, unit="1/s^2"),
    rx.Term("p2", "x", derivative=1, measured=("dx",), unit="1/s"),
)


def _mass(*terms: rx.Term | rx.Terms) -> rx.Equation:
    return rx.Equation(_INERTIA, *terms, _FORCE_TERM, name="mass", unit="N")


def _swing(*terms: rx.Term) -> rx.Equation:
    return rx.Equation(*_SWING, *terms, name="pendulum", unit="rad/s^2")


STROKE = 0.1
"""Displacement within which the hysteresis turns round."""


@functools.cache
def _hysteretic(seed: int) -> dict[str, np.ndarray]:
    """A mass on a spring with Dahl's friction."""

    def rates(t: float, state: np.ndarray) -> list[float]:
        x, v, z = state
        force = tones(t, _FORCE, 20.0, seed) - 0.8 * v - 20 * x - 4 * z
        return [v, float(force) / 1.5, (v - abs(v) * z) / STROKE]

    return _recorded(rates, 3, (_FORCE, 20.0), seed, 0.02)


def _recorded(
    rates: Callable[[float, np.ndarray], list[float]], states: int,
    drive: tuple[list[float], float], seed: int, step: float,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Position and velocity, the first two of so many states, and the tones."""
    times = np.arange(COUNT) / RATE
    run = scipy.integrate.solve_ivp(
        rates, (0, times[-1]), [0.0] * states, t_eval=times, rtol=1e-8, atol=1e-10, max_step=step
    )
    return {"x": run.y[0], "dx": run.y[1], "u": tones(times, *drive, seed)}


def _carrying(
    body: tuple[float, float, float, float], carried: tuple[float, float, float],
    drive: tuple[list[float], float], step: float,
):  # fmt: skip
    """Motions of a mass that carries another one on a spring and a damper.

    **Arguments:** `body`: mass, damping, linear and cubic stiffness; `carried`: mass, hertz,
    damping; `drive`: tones and their size; `step`, the solver's longest.
    """
    m, c, k, k3 = body
    mass, hertz, damping = carried
    stiffness = mass * (2 * np.pi * hertz) ** 2

    @functools.cache
    def motion(seed: int) -> dict[str, np.ndarray]:
        def rates(t: float, state: np.ndarray) -> list[float]:
            x, v, y, w = state
            between = stiffness * (x - y) + damping * (v - w)
            force = tones(t, *drive, seed) - c * v - k * x - k3 * x**3 - between
            return [v, float(force) / m, w, between / mass]

        return _recorded(rates, 4, drive, seed, step)

    return motion


_UP_TO_TEN = [0.7 + 0.41 * i for i in range(23)]
LATE = 0.033
"""Seconds by which the force comes late in a recording."""


PROBLEMS = {
    problem.name: problem
    for problem in (
        Problem(
            "duffing",
            _mass(),
            frozenset({"stiffness", "cubic_stiffness", "coulomb", "viscous"}),
            _mass(
                _VISCOUS,
                _SPRING,
                rx.Term("k3", rx.odd("x", 3)),
                rx.Term("dry", rx.odd("dx", 0)),
            ),
            _driven(30.0, lambda x, v, d: 0.8 * v + 1.5 * d + 20 * x + 15 * x**3),
            1 / RATE,
        ),
        Problem(
            "drag",
            _mass(),
            frozenset({"stiffness", "viscous", "quadratic_drag"}),
            _mass(_VISCOUS, _SPRING, rx.Term("r2", rx.odd("dx", 2))),
            _driven(14.0, lambda x, v, d: 0.8 * v + 0.5 * v * abs(v) + 20 * x),
            1 / RATE,
        ),
        Problem(
            "axis",
            _mass(),
            frozenset({"viscous", "coulomb", "asymmetry", "offset"}),
            _mass(
                _VISCOUS,
                rx.Term("dry", rx.odd("dx", 0)),
                rx.Term("differs", rx.even("dx", 1)),
                rx.Term("weight", rx.constant),
            ),
            _axis,
            1 / AXIS_RATE,
        ),
        Problem(
            "pendulum",
            _swing(),
            frozenset({"quadratic_drag"}),
            _swing(rx.Term("r2", rx.odd("dx", 2))),
            _pendulum,
            1 / RATE,
        ),
        Problem(
            "dead_zone",
            _mass(),
            frozenset({"viscous", "dead_zone"}),
            _mass(_VISCOUS, rx.Terms("gap", rx.equations.DeadZone(WIDTH), "x")),
            _driven(14.0, lambda x, v, d: 2 * v + 60 * (x - np.clip(x, -WIDTH, WIDTH))),
            1 / RATE,
        ),
        Problem(
            "hysteresis",
            _mass(_SPRING),
            frozenset({"viscous", "dahl"}),
            rx.staged(_mass(_SPRING, _VISCOUS, rx.Term("loop", "z"))).with_memories(
                rx.equations.Dahl("z", "dx", STROKE)
            ),
            _hysteretic,
            1 / RATE,
        ),
    )
}
OTHERS = {
    problem.name: problem
    for problem in (
        Problem(
            "late_force",
            _mass(),
            frozenset({"delay", "stiffness", "viscous", "quadratic_drag"}),
            PROBLEMS["drag"].whole,
            _driven(14.0, lambda x, v, d: 0.8 * v + 0.5 * v * abs(v) + 20 * x, LATE),
            1 / RATE,
        ),
        Problem(
            "hidden_mode",
            _mass(_VISCOUS, _SPRING),
            frozenset({"mode"}),
            _mass(_VISCOUS, _SPRING),
            _carrying((1.5, 0.8, 20.0, 0.0), (0.5, 1.5, 0.8), (_FORCE, 20.0), 0.05),
            1 / RATE,
        ),
        Problem(
            "mode_and_spring",
            _mass(_VISCOUS, _SPRING),
            frozenset({"mode", "cubic_stiffness"}),
            _mass(_VISCOUS, _SPRING, rx.Term("k3", rx.odd("x", 3))),
            _carrying((2.0, 4.0, 800.0, 2e6), (0.5, 6.0, 1.13), (_UP_TO_TEN, 14.0), 0.01),
            1 / RATE,
        ),
    )
}
"""What is missing and no term. Models that lack nothing are those of the problems above."""

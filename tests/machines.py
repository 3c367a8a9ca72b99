"""The machines of tests and benchmarks: recordings whose truth is known.

A machine moves in closed form (`MACHINES`: the motion is given, its force follows from the
equation), by SciPy (`DRAG`, `PROBLEMS`, `joint`, `body_with_mode`, `body_with_lag`) or by the
package's own simulator (`simulated`: quarter cars, two masses). Only the last compiles a function.
Three record shapes, `SHORT`, `STANDARD` and `LONG`: what one test compiles serves others:

    record = MACHINES["duffing"].record(noise=0.01, seed=3, shape=SHORT)
    assert_close(rx.identify(MACHINES["duffing"].model, record), MACHINES["duffing"].truth)
"""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.integrate
import scipy.signal

import riecjax as rx

Signals = Mapping[str, np.ndarray]


class Shape(NamedTuple):
    """How many samples a record has, and how many a second."""

    count: int  # pyright: ignore[reportIncompatibleMethodOverride]
    rate: int

    @property
    def step(self) -> float:
        return 1 / self.rate

    @property
    def times(self) -> np.ndarray:
        return np.arange(self.count) / self.rate


SHORT = Shape(2000, 100)
STANDARD = Shape(6000, 200)
LONG = Shape(20_000, 200)


def noisy(
    signals: Signals, shares: float | Mapping[str, float], seed: int = 0
) -> dict[str, np.ndarray]:
    """Signals with white noise of a share of each one's standard deviation.

    **Arguments:** `shares`: of each signal that has noise, or of all of them.
    """
    rng = np.random.default_rng(100 + seed)
    if not isinstance(shares, Mapping):
        shares = dict.fromkeys(signals, shares)
    disturbed = dict(signals)
    for name, share in shares.items():
        spread = share * np.std(signals[name])
        disturbed[name] = signals[name] + spread * rng.standard_normal(signals[name].size)
    return disturbed


def tones(
    times: np.ndarray | float, hertz: Sequence[float], size: float, seed: int
) -> np.ndarray | float:
    """Sines of equal size and random phases; `size`: root of 2 times the sum's deviation."""
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(hertz))
    each = [np.sin(2 * np.pi * f * np.asarray(times) + p) for f, p in zip(hertz, phases)]
    return size / np.sqrt(len(hertz)) * np.sum(each, axis=0)


@dataclass(frozen=True)
class Machine:
    """A machine, the model that is right for it, and how it moves.

    **Fields:** `model`, or its name in the catalogue; `truth`; `motion`, exact signals by the seed
    of their drive; `shape` of its records unless another is asked for; `sensors`, the signals that
    have noise; `start`, a model that lacks the terms `missing`.
    """

    model: Any
    truth: Mapping[str, float]
    motion: Callable[[int, Shape], dict[str, np.ndarray]]
    shape: Shape = STANDARD
    sensors: tuple[str, ...] = ("x", "dx")
    start: Any = None
    missing: frozenset[str] = frozenset()

    def signals(
        self, noise: float = 0.0, seed: int = 0, *, drive: int = 0, shape: Shape | None = None
    ) -> dict[str, np.ndarray]:
        """Exact signals of a drive, with white noise of a share of each sensor's deviation."""
        # Motions are kept, and a test may write into its samples.
        exact = {k: v.copy() for k, v in self.motion(drive, shape or self.shape).items()}
        return noisy(exact, dict.fromkeys(self.sensors, noise), seed) if noise else exact

    def record(
        self, noise: float = 0.0, seed: int = 0, *, drive: int = 0, shape: Shape | None = None
    ) -> rx.Record:
        signals = self.signals(noise, seed, drive=drive, shape=shape)
        return rx.Record.from_samples(signals, time_step=(shape or self.shape).step)


# Motions in closed form: position, velocity and acceleration are given, the force follows.


def waves(times: np.ndarray, seed: int, travel: float, band: tuple[float, float]) -> list:
    """Position, velocity and acceleration of 20 tones; `travel`: the position's deviation."""
    rng = np.random.default_rng([seed, 20])
    omega, phases = 2 * np.pi * rng.uniform(*band, 20), rng.uniform(0, 2 * np.pi, 20)
    sizes = travel * np.sqrt(2 / np.sum(omega**-2.0)) / omega
    angles = np.multiply.outer(times, omega) + phases
    return [
        np.sum(sizes * omega**order * np.cos(angles + 0.5 * np.pi * order), axis=-1)
        for order in range(3)
    ]


@dataclass(frozen=True)
class Given:
    """A motion in closed form, and the force that it takes.

    **Fields:** `load`, the force from position, velocity and acceleration; `names` of these three
    and of the force; `travel` and `band` in hertz of the motion.
    """

    load: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    names: tuple[str, str, str, str] = ("x", "dx", "ddx", "u")
    travel: float = 0.3
    band: tuple[float, float] = (0.1, 3.0)

    def __call__(self, seed: int, shape: Shape) -> dict[str, np.ndarray]:
        moved = waves(shape.times, seed, self.travel, self.band)
        return dict(zip(self.names, [*moved, self.load(*moved)]))


def _sine(signals: Any) -> Any:
    return jnp.sin(signals["x"])


_INERTIA = rx.Term("m", "x", derivative=2, measured=("dx",), unit="kg")
_VISCOUS = rx.Term("c", "x", derivative=1, measured=("dx",), unit="N s/m")
_SPRING = rx.Term("k", "x", unit="N/m")


def mass(*terms: rx.Term) -> rx.Equation:
    """m x'' + these terms = u."""
    return rx.Equation(_INERTIA, *terms, -rx.Term(1.0, "u"), name="mass", unit="N")


MACHINES = {
    "linear": Machine(
        mass(_VISCOUS, _SPRING),
        {"m": 1.5, "c": 3.0, "k": 60.0},
        Given(lambda x, v, a: 1.5 * a + 3 * v + 60 * x),
        sensors=("x", "dx", "ddx"),
    ),
    "drag": Machine(
        "drag-oscillator",
        {"m": 1.5, "r": 0.8, "r2": 0.5, "k": 20.0},
        Given(lambda x, v, a: 1.5 * a + 0.8 * v + 0.5 * v * abs(v) + 20 * x),
        sensors=("x", "dx", "ddx"),
    ),
    "duffing": Machine(
        "duffing",
        {"m": 1.0, "d": 0.5, "k1": 100.0, "k2": 0.0, "k3": 1000.0},
        Given(lambda y, v, a: a + 0.5 * v + 100 * y + 1000 * y**3, ("y", "dy", "ddy", "u")),
        sensors=("y", "dy", "ddy"),
    ),
}
"""Machines of one coordinate, exact to rounding; the acceleration is recorded too."""

# The oscillator with drag that peers were measured on, by SciPy.

DRAG_TRUTH = MACHINES["drag"].truth
DRAG_START = {"m": 1.0, "r": 1.0, "r2": 1.0, "k": 10.0}
DRAG_BOUND = {"m": 0.00118, "r": 0.0213, "r2": 0.0105, "k": 0.00113}
"""Cramer-Rao bound at 5 % noise, as a share of the true value; the initial state is unknown too."""


def drag_force(times: np.ndarray | float) -> np.ndarray | float:
    return tones(times, [0.1, 0.3, 0.5, 0.7, 0.9, 1.3, 2.0], 14.0, 0)


@functools.cache
def _drag_motion(_drive: int, shape: Shape) -> dict[str, np.ndarray]:
    m, r, r2, k = DRAG_TRUTH.values()
    times = shape.times
    run = scipy.integrate.solve_ivp(
        lambda t, s: [s[1], (drag_force(t) - r * s[1] - r2 * s[1] * abs(s[1]) - k * s[0]) / m],
        (0, times[-1]),
        [0.0, 0.0],
        t_eval=times,
        rtol=1e-10,
        atol=1e-12,
    )
    return {"u": np.asarray(drag_force(times)), "x": run.y[0], "dx": run.y[1]}


DRAG = Machine("drag-oscillator", DRAG_TRUTH, _drag_motion, Shape(2001, 100))
"""m x'' + r x' + r2 x'|x'| + k x = u from rest, under seven tones."""


def drag_signals(seed: int | None = None, noise: float = 0.05) -> dict[str, np.ndarray]:
    """Force, position and velocity; with a seed, noise of a share of each one's deviation."""
    return DRAG.signals() if seed is None else DRAG.signals(noise, seed)


def drag_record(
    seed: int | None = None, noise: float = 0.05, count: int = DRAG.shape.count
) -> rx.Record:
    signals = {name: values[:count] for name, values in drag_signals(seed, noise).items()}
    return rx.Record.from_samples(signals, time_step=DRAG.shape.step)


def drag_oscillator() -> rx.simulation.AbstractSystem:
    return rx.find_model("drag-oscillator").build_system(dict.fromkeys(DRAG_TRUTH, 1.0))


def drag_fleet(
    count: int, samples: int, seed: int, noise: float = 0.01, **changed: float
) -> list[rx.Record]:
    """Oscillators with drag at 200 Hz, side by side, under nine tones of random phases."""
    step, hertz = STANDARD.step, np.geomspace(0.1, 3.0, 9)
    m, r, r2, k = (changed.get(name, value) for name, value in DRAG_TRUTH.items())
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, (count, hertz.size, 1))
    half = 2 * np.pi * hertz[:, None] * (0.5 * step * np.arange(2 * samples))
    u = 14 / np.sqrt(hertz.size) * np.sin(half + phases).sum(1)
    x, v = np.zeros((2, count, samples))

    def rates(place: int, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return v, (u[:, place] - r * v - r2 * v * np.abs(v) - k * x) / m

    for i in range(samples - 1):
        a, b = x[:, i], v[:, i]
        k1 = rates(2 * i, a, b)
        k2 = rates(2 * i + 1, a + 0.5 * step * k1[0], b + 0.5 * step * k1[1])
        k3 = rates(2 * i + 1, a + 0.5 * step * k2[0], b + 0.5 * step * k2[1])
        k4 = rates(2 * i + 2, a + step * k3[0], b + step * k3[1])
        x[:, i + 1], v[:, i + 1] = (
            old + step / 6 * (p + 2 * q + 2 * s + t)
            for old, p, q, s, t in zip((a, b), k1, k2, k3, k4)
        )
    signals = {"u": u[:, ::2], "x": x, "dx": v}
    for name in ("x", "dx"):
        size = noise * signals[name].std(axis=1, keepdims=True)
        signals[name] = signals[name] + size * rng.standard_normal((count, samples))
    return [
        rx.Record.from_samples({name: of[i] for name, of in signals.items()}, time_step=step)
        for i in range(count)
    ]


# Machines that stick, switch, remember or carry a mass, by SciPy, and models that lack a term.

Acceleration = Callable[[float, float, float, float], Any]
"""Of time, position, velocity and the direction of sliding."""


def slide(
    acceleration: Acceleration,
    times: np.ndarray,
    start: float = 0.0,
    tolerance: float = 1e-8,
    longest: float = 0.1,
) -> dict[str, np.ndarray]:
    """Position and velocity from rest, reversal by reversal; what sticks waits to be let go.

    **Arguments:** `tolerance` and `longest` step of the solver, in the motion's units.
    """
    x, v = np.empty(times.size), np.empty(times.size)
    now, place = float(times[0]), start
    while True:
        sides = [d for d in (1.0, -1.0) if acceleration(now, place, 0.0, d) * d > 0]
        if not sides:
            then = now + 0.25 * float(times[1] - times[0])
            inside = (times >= now) & (times <= then)
            x[inside], v[inside] = place, 0.0
        else:
            run = _until_reversal(
                acceleration, (now, float(times[-1])), place, sides[0], tolerance, longest
            )
            then = float(run.t[-1])
            inside = (times >= now) & (times <= then)
            x[inside], v[inside] = run.sol(times[inside])
            place = float(run.y[0, -1])
        now = then
        if now >= times[-1]:
            return {"x": x, "dx": v}


def _until_reversal(acceleration, span, place, direction, tolerance, longest):
    def reversal(t: float, state: np.ndarray) -> float:
        return state[1] if t > span[0] + 1e-9 else direction

    reversal.terminal, reversal.direction = True, -direction  # type: ignore[attr-defined]
    return scipy.integrate.solve_ivp(
        lambda t, s: [s[1], acceleration(t, s[0], s[1], direction)],
        span,
        [place, 0.0],
        events=reversal,
        dense_output=True,
        rtol=tolerance,
        atol=tolerance / 100,
        max_step=longest,
    )


TONES_SHAPE = Shape(4001, 100)
EIGHT_TONES = [0.13, 0.31, 0.53, 0.71, 0.97, 1.3, 1.9, 2.3]
"""Frequencies in hertz of a force that excites springs, dampers and friction."""
STROKE = 0.1
"""Displacement within which the hysteresis turns round."""
WIDTH, LATE = 0.2, 0.033
"""Half of the dead zone, and seconds by which the force comes late in a recording."""


def _under_tones(size: float, force: Callable[[float, float, float], float], late: float = 0.0):
    """Motions of 1.5 kg under tones, and a force of position, velocity and direction."""

    @functools.cache
    def motion(drive: int, shape: Shape) -> dict[str, np.ndarray]:
        moved = slide(
            lambda t, x, v, d: (tones(t, EIGHT_TONES, size, drive) - force(x, v, d)) / 1.5,
            shape.times,
        )
        return {**moved, "u": np.asarray(tones(shape.times - late, EIGHT_TONES, size, drive))}

    return motion


@functools.cache
def _asymmetric_axis(drive: int, shape: Shape) -> dict[str, np.ndarray]:
    def force(t: Any) -> Any:
        # Strong enough that it hardly ever sticks.
        return tones(t, [0.5, 0.9, 1.3, 1.7, 2.3], 250.0, drive)

    def acceleration(t: float, x: float, v: float, d: float) -> float:
        viscous, dry = (240.0, 24.0) if d < 0 else (167.0, 18.0)
        return float(force(t) - viscous * v - dry * d) / 95.0

    return {**slide(acceleration, shape.times), "u": force(shape.times)}


@functools.cache
def _free_pendulum(drive: int, shape: Shape) -> dict[str, np.ndarray]:
    start = float(np.random.default_rng(drive).uniform(2.0, 2.8))
    return slide(
        lambda t, x, v, d: -64.2 * np.sin(x) - 0.07 * v - 0.05 * v * abs(v), shape.times, start
    )


def _smooth(rates: Callable, states: int, hertz: Sequence[float], size: float, longest: float):
    """Motions by `rates(time, state, force)` from rest; position and velocity are first."""

    @functools.cache
    def motion(drive: int, shape: Shape) -> dict[str, np.ndarray]:
        times = shape.times
        run = scipy.integrate.solve_ivp(
            lambda t, state: rates(state, float(tones(t, hertz, size, drive))),
            (0, times[-1]),
            [0.0] * states,
            t_eval=times,
            rtol=1e-8,
            atol=1e-10,
            max_step=longest,
        )
        return {"x": run.y[0], "dx": run.y[1], "u": np.asarray(tones(times, hertz, size, drive))}

    return motion


def _dahl(state: np.ndarray, force: float) -> list[float]:
    """A mass on a spring with Dahl's friction."""
    x, v, z = state
    return [v, (force - 0.8 * v - 20 * x - 4 * z) / 1.5, (v - abs(v) * z) / STROKE]


def _carrying(body: tuple[float, float, float, float], carried: tuple[float, float, float]):
    """Rates of a mass that carries another on a spring and a damper.

    **Arguments:** `body`: mass, damping, linear and cubic stiffness; `carried`: mass, hertz,
    damping.
    """
    (m, c, k, k3), (light, hertz, damping) = body, carried
    stiffness = light * (2 * np.pi * hertz) ** 2

    def rates(state: np.ndarray, force: float) -> list[float]:
        x, v, y, w = state
        between = stiffness * (x - y) + damping * (v - w)
        return [v, (force - c * v - k * x - k3 * x**3 - between) / m, w, between / light]

    return rates


_CUBIC, _DRY = rx.Term("k3", rx.odd("x", 3)), rx.Term("dry", rx.odd("dx", 0))
_QUADRATIC = rx.Term("r2", rx.odd("dx", 2))
_SWING = (
    rx.Term(1.0, "x", derivative=2, measured=("dx",)),
    rx.Term("p1", _sine, unit="1/s^2"),
    rx.Term("p2", "x", derivative=1, measured=("dx",), unit="1/s"),
)


def _swing(*terms: rx.Term) -> rx.Equation:
    return rx.Equation(*_SWING, *terms, name="pendulum", unit="rad/s^2")


def _problem(start, missing: str, whole, motion, shape: Shape = TONES_SHAPE, **truth: float):
    return Machine(
        whole,
        truth,
        motion,
        shape,
        start=start,
        missing=frozenset(missing.replace(",", " ").split()),
    )


PROBLEMS = {
    "duffing": _problem(
        mass(),
        "stiffness cubic_stiffness coulomb viscous",
        mass(_VISCOUS, _SPRING, _CUBIC, _DRY),
        _under_tones(30.0, lambda x, v, d: 0.8 * v + 1.5 * d + 20 * x + 15 * x**3),
        m=1.5, c=0.8, k=20.0, k3=15.0, dry=1.5,
    ),
    "drag": _problem(
        mass(),
        "stiffness viscous quadratic_drag",
        mass(_VISCOUS, _SPRING, _QUADRATIC),
        _under_tones(14.0, lambda x, v, d: 0.8 * v + 0.5 * v * abs(v) + 20 * x),
        m=1.5, c=0.8, k=20.0, r2=0.5,
    ),
    "axis": _problem(
        mass(),
        "viscous coulomb asymmetry offset",
        mass(_VISCOUS, _DRY, rx.Term("differs", rx.even("dx", 1)), rx.Term("weight", rx.constant)),
        _asymmetric_axis,
        Shape(8001, 400),
        m=95.0, c=203.5, dry=21.0, differs=-36.5, weight=-3.0,
    ),
    "pendulum": _problem(
        _swing(), "quadratic_drag", _swing(_QUADRATIC), _free_pendulum, p1=64.2, p2=0.07, r2=0.05
    ),
    "dead_zone": _problem(
        mass(),
        "viscous dead_zone",
        mass(_VISCOUS, rx.Terms("gap", rx.equations.DeadZone(WIDTH), "x")),
        _under_tones(14.0, lambda x, v, d: 2 * v + 60 * (x - np.clip(x, -WIDTH, WIDTH))),
        m=1.5, c=2.0, gap_1=60.0,
    ),
    "hysteresis": _problem(
        mass(_SPRING),
        "viscous dahl",
        rx.staged(mass(_SPRING, _VISCOUS, rx.Term("loop", "z"))).with_elements(
            rx.elements.Dahl("z", "dx", STROKE)
        ),
        _smooth(_dahl, 3, EIGHT_TONES, 20.0, 0.02),
        m=1.5, c=0.8, k=20.0, loop=4.0,
    ),
}  # fmt: skip
"""Machines of which discovery is given the model `start`, which lacks the terms `missing`."""
OTHERS = {
    "late_force": _problem(
        mass(),
        "delay stiffness viscous quadratic_drag",
        PROBLEMS["drag"].model,
        _under_tones(14.0, lambda x, v, d: 0.8 * v + 0.5 * v * abs(v) + 20 * x, LATE),
    ),
    "hidden_mode": _problem(
        mass(_VISCOUS, _SPRING),
        "mode",
        mass(_VISCOUS, _SPRING),
        _smooth(_carrying((1.5, 0.8, 20.0, 0.0), (0.5, 1.5, 0.8)), 4, EIGHT_TONES, 20.0, 0.05),
    ),
    "mode_and_spring": _problem(
        mass(_VISCOUS, _SPRING),
        "mode cubic_stiffness",
        mass(_VISCOUS, _SPRING, _CUBIC),
        _smooth(
            _carrying((2.0, 4.0, 800.0, 2e6), (0.5, 6.0, 1.13)),
            4, [0.7 + 0.41 * i for i in range(23)], 14.0, 0.01,
        ),
    ),
}  # fmt: skip
"""What is missing and no term. Models that lack nothing are those of the problems above."""

# A body with an oscillator on it, or a spring in series with its damper, that its model lacks.

MODE_TRUTH = {"m": 20.0, "c": 60.0, "k": 4000.0, "M_mode": 6.0, "K_mode": 21e3, "B_mode": 120.0}
LAG_TRUTH = {"m": 20.0, "c": 200.0, "k": 4000.0, "K_series": 10e3}
"""The spring in series makes the damper's force lag by 20 ms."""
BODY = rx.Equation(
    rx.Term("m", "v", derivative=1, unit="kg"),
    rx.Term("c", "v", unit="N s/m"),
    rx.Term("k", "x", unit="N/m"),
    -rx.Term(1.0, "F"),
    name="body",
    unit="N",
)
MODE_MODEL = rx.staged(BODY).with_elements(rx.HiddenMode("v"))
LAG_MODEL = rx.staged(BODY).with_elements(rx.SeriesSpring("c"))


def body_matrix(
    damping: float, mode: Sequence[float] | None = None, series: float | None = None
) -> np.ndarray:
    """State matrix of x and v, of the damper's force with a spring in series, of a mode's x and v.

    **Arguments:** `mode`: mass, stiffness, damping; `series`: stiffness.
    """
    m, k = LAG_TRUTH["m"], LAG_TRUTH["k"]
    first = 2 if series is None else 3
    a = np.zeros((first + 2 * (mode is not None),) * 2)
    a[0, 1] = 1.0
    a[1, :2] = -k / m, -damping / m
    if series is not None:
        a[1, 1:3] = 0, -1 / m
        a[2, 1:3] = series, -series / damping
    if mode is not None:
        heavy, stiff, loss = mode
        coupled = [0, 1, first, first + 1]
        pull = np.array([-stiff, -loss, stiff, loss])
        a[1, coupled] += pull / m
        a[first, first + 1] = 1.0
        a[first + 1, coupled] = -pull / heavy
    return a


def body(
    a: np.ndarray,
    count: int = STANDARD.count,
    seed: int = 3,
    *,
    mass: float = LAG_TRUTH["m"],
    force: float = 300.0,
) -> dict[str, np.ndarray]:
    """Position, velocity and force at 200 Hz of a body of this state matrix, x and v first.

    The force is noise up to 40 Hz, linear between samples of eight times the rate.
    """
    finer, step = 8, STANDARD.step
    b = np.zeros((len(a), 1))
    b[1] = 1 / mass
    rng = np.random.default_rng(seed)
    sharp = scipy.signal.butter(6, 40.0, fs=finer / step, output="sos")
    drive = force * np.asarray(scipy.signal.sosfilt(sharp, rng.standard_normal(count * finer)))
    times = np.arange(drive.size) * step / finer
    _, states, _ = scipy.signal.lsim((a, b, np.eye(len(a)), np.zeros_like(b)), drive, times)
    return {"x": states[::finer, 0], "v": states[::finer, 1], "F": drive[::finer]}


def body_with_mode(mode: bool = True, count: int = STANDARD.count) -> dict[str, np.ndarray]:
    """The body of `MODE_TRUTH`, with the mass that it carries or without."""
    carried = tuple(MODE_TRUTH.values())[3:]
    return body(body_matrix(MODE_TRUTH["c"], carried if mode else None), count)


def body_with_lag(
    count: int = STANDARD.count,
    seed: int = 3,
    mode: Sequence[float] | None = None,
    series: float = LAG_TRUTH["K_series"],
) -> dict[str, np.ndarray]:
    return body(body_matrix(LAG_TRUTH["c"], mode, series), count, seed)


# A drive: motor and load, and a spring between them, before which there may be play.

_TWIST = rx.difference("q_m", "q_l")
_MOTOR = rx.Equation(
    rx.Term("J_m", "q_m", derivative=2, unit="kg m^2"),
    rx.Term("d_m", "q_m", derivative=1, unit="N m s/rad"),
    rx.Term("k", _TWIST, unit="N m/rad"),
    -rx.Term(1.0, "tau"),
    name="motor",
    unit="N m",
)
_LOAD = rx.Equation(
    rx.Term("J_l", "q_l", derivative=2, unit="kg m^2"),
    rx.Term("d_l", "q_l", derivative=1, unit="N m s/rad"),
    -rx.Term("k", _TWIST, unit="N m/rad"),
    name="load",
    unit="N m",
)
DRIVE = rx.staged(_MOTOR, _LOAD)


# A joint that sticks: J q'' + d q' + (Fc + Fs e^-(q'/vs)^2) sign(q') + mgl sin(q) = tau.

JOINT_TRUTH = {"J": 0.8, "d": 1.2, "Fc": 2.0, "Fs": 1.5, "mgl": 6.0}
STRIBECK = 0.15
"""Velocity in rad/s at which sliding friction has lost 63 % of its rise."""
JOINT_SHAPE = Shape(20_001, 500)
JOINT_SENSORS = ("clean", "velocity", "encoder")


def _joint_direction(signals: Any) -> Any:
    return jnp.sign(signals["dq"])


def _stribeck(signals: Any) -> Any:
    return jnp.sign(signals["dq"]) * jnp.exp(-((signals["dq"] / STRIBECK) ** 2))


def _gravity(signals: Any) -> Any:
    return jnp.sin(signals["q"])


JOINT = rx.Equation(
    rx.Term("J", "q", derivative=2, measured=("dq",), unit="kg m^2"),
    rx.Term("d", "q", derivative=1, measured=("dq",), unit="N m s"),
    rx.Term("Fc", _joint_direction, unit="N m"),
    rx.Term("Fs", _stribeck, unit="N m"),
    rx.Term("mgl", _gravity, unit="N m"),
    -rx.Term(1.0, "tau"),
    name="joint",
    unit="N m",
)


@functools.cache
def joint(seed: int, shape: Shape = JOINT_SHAPE) -> dict[str, np.ndarray]:
    """Position, velocity and torque under twelve tones from 0.3 to 1.6 Hz.

    It sticks for 4 % of the time.
    """
    rng, count = np.random.default_rng(seed), 12
    hertz = np.linspace(0.3, 1.6, count) + rng.uniform(-0.05, 0.05, count)
    phases, size = rng.uniform(0, 2 * np.pi, count), 9.0 * np.sqrt(2 / count)
    inertia, viscous, coulomb, rise, weight = JOINT_TRUTH.values()

    def torque(time: Any) -> Any:
        return size * np.sin(2 * np.pi * np.multiply.outer(time, hertz) + phases).sum(-1)

    def acceleration(time: float, q: float, v: float, direction: float) -> float:
        friction = direction * (coulomb + rise * math.exp(-((v / STRIBECK) ** 2)))
        return (torque(time) - viscous * v - friction - weight * math.sin(q)) / inertia

    moved = slide(acceleration, shape.times)
    return {"q": moved["x"], "dq": moved["dx"], "tau": torque(shape.times)}


def joint_record(motion: Signals, sensors: str, seed: int) -> rx.Record:
    """A joint's motion as recorded.

    **Arguments:** `sensors`: `clean`; `velocity`: positions in steps of 1e-4 rad, 5 % noise on the
    torque, 1 % on the velocity; `encoder`: the same without the velocity.
    """
    rng = np.random.default_rng((seed, 1))
    q, dq, tau = motion["q"], motion["dq"], motion["tau"]
    if sensors != "clean":
        tau = tau + 0.05 * tau.std() * rng.normal(size=tau.size)
        q = 1e-4 * np.round(q / 1e-4)
        dq = dq + 0.01 * dq.std() * rng.normal(size=dq.size)
    signals = {"q": q, "tau": tau} | ({} if sensors == "encoder" else {"dq": dq})
    return rx.Record.from_samples(signals, time_step=JOINT_SHAPE.step)


# Machines of the catalogue by the package's own simulator.


@functools.lru_cache(maxsize=32)
def simulated(
    model: str,
    seed: int = 0,
    shape: Shape = STANDARD,
    *,
    bandwidth: float = 30.0,
    rms: float = 0.55,
    truth: tuple[tuple[str, float], ...] = (),
) -> rx.Record:
    """All signals of a model of the catalogue under band-limited noise, without noise of sensors.

    The defaults are the white-noise road of the quarter cars: `quarter-car`, and
    `quarter-car-source` with its engine. **Arguments:** `truth`: parameters other than the
    model's defaults.
    """
    known = rx.find_model(model)
    drive = rx.simulation.band_limited_noise(
        jax.random.key(seed), shape.count, shape.step, bandwidth=bandwidth, rms=rms
    )
    system = known.build_system(dict(truth))
    inputs = rx.Record({known.inputs[0].name: drive}, shape.step)
    return rx.simulate(system, inputs).checked().record


# A pendulum that a controller holds upright while it is shaken.

UPRIGHT_TRUTH = {"p1": 20.0, "p2": 0.3}
UPRIGHT = rx.Equation(
    rx.Term(1.0, "theta", derivative=2, measured=("dtheta", "ddtheta")),
    -rx.Term("p1", lambda signals: jnp.sin(signals["theta"]), unit="1/s^2"),
    rx.Term("p2", "theta", derivative=1, measured=("dtheta",), unit="1/s"),
    -rx.Term(1.0, "torque"),
    name="upright",
)


def upright_signals() -> dict[str, np.ndarray]:
    """10 s at 100 Hz."""
    step, fine, count = 0.01, 20, 1000
    rng = np.random.default_rng(3)
    times = np.arange(count) * step
    shakes = [(w, rng.uniform(0, 6)) for w in (1.9, 4.3, 7.1, 11.0)]
    shaken = np.sum([6 * np.sin(w * times + p) for w, p in shakes], axis=0)
    p1, p2 = UPRIGHT_TRUTH.values()
    state, rows, torque, h = np.array([0.05, 0.0]), [], 0.0, step / fine

    def slope(s: np.ndarray, u: float) -> np.ndarray:
        return np.array([s[1], p1 * np.sin(s[0]) - p2 * s[1] + u])

    for i in range(count):
        # Torque at the next sample from this one's state: linear between samples, as simulated.
        following = shaken[i] - 60 * state[0] - 8 * state[1]
        rows.append((torque, *state))
        for k in range(fine):
            level = [torque + (following - torque) * (k + c) / fine for c in (0, 0.5, 1)]
            a = slope(state, level[0])
            b = slope(state + h / 2 * a, level[1])
            c = slope(state + h / 2 * b, level[1])
            d = slope(state + h * c, level[2])
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
        torque = following
    return dict(zip(("torque", "theta", "dtheta"), np.array(rows).T))

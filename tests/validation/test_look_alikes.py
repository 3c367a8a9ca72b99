"""What looks like something else: causes that leave much the same of an equation, each told apart.

Every motion is integrated here, in fine steps, by the classical Runge-Kutta method; the torque or
force that moves it is known in closed form, and so is what its model lacks.
"""

import functools
import re
from collections.abc import Callable, Mapping, Sequence

import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx

STEP, SAMPLES = 0.005, 4000
State = tuple[float, ...]
Rate = Callable[[State, float], State]
Tones = Sequence[tuple[float, float, float]]
"""Of each its size, its frequency in hertz and its phase."""


def summed(tones: Tones, time: np.ndarray) -> np.ndarray:
    return sum((a * np.sin(2 * np.pi * f * time + p) for a, f, p in tones), np.zeros_like(time))


def broad(seed: int, size: float, low: float, high: float, count: int = 40) -> Tones:
    """Tones of random frequencies and phases; `size`: the standard deviation of their sum."""
    rng = np.random.default_rng(seed)
    each = size * np.sqrt(2 / count)
    return [(each, *rng.uniform((low, 0), (high, 2 * np.pi))) for _ in range(count)]


def integrated(
    rate: Rate, start: State, drive: np.ndarray, samples: int = SAMPLES, step: float = STEP
) -> np.ndarray:
    """States by sample, under a drive that is given twice in each of the integrator's steps."""
    fine = (drive.size - 1) // (2 * (samples - 1))
    h, state, course = step / fine, start, [start]
    values = drive.tolist()
    for place in range(0, 2 * fine * (samples - 1), 2):
        now, midway, then = values[place : place + 3]
        a = rate(state, now)
        b = rate(tuple(x + 0.5 * h * dx for x, dx in zip(state, a)), midway)
        c = rate(tuple(x + 0.5 * h * dx for x, dx in zip(state, b)), midway)
        d = rate(tuple(x + h * dx for x, dx in zip(state, c)), then)
        state = tuple(
            x + h / 6 * (p + 2 * q + 2 * r + s) for x, p, q, r, s in zip(state, a, b, c, d)
        )
        if (place + 2) % (2 * fine) == 0:
            course.append(state)
    return np.array(course).T


def fine_times(samples: int = SAMPLES, fine: int = 10, step: float = STEP) -> np.ndarray:
    """At which `integrated` reads its drive."""
    return step / (2 * fine) * np.arange(2 * fine * (samples - 1) + 1)


TIMES, FINE = STEP * np.arange(SAMPLES), fine_times()


def recorded(signals: Mapping[str, np.ndarray], noise: float = 0.01, seed: int = 0) -> rx.Record:
    """A record with white noise of a share of each signal's standard deviation."""
    rng = np.random.default_rng(seed)
    noisy = {n: v + noise * np.std(v) * rng.standard_normal(v.size) for n, v in signals.items()}
    return rx.Record.from_samples(noisy, time_step=STEP)


class Told:
    """What is said of a recording: `codes`, all `words` of findings and steps, and `advised`, the
    options of what is to be done next."""

    def __init__(self, model, record: rx.Record):
        self.assessment = rx.assess(model, record)
        self.findings = self.assessment.findings()
        self.verdict = self.assessment.verdict
        self.codes = {finding.code for finding in self.findings}
        steps = [cause.step for cause in self.verdict.causes if cause.step is not None]
        self.advised = [word for step in steps for word in step.options]
        self.words = " ".join([f.message for f in self.findings] + [s.words for s in steps])

    def __repr__(self) -> str:
        said = "".join(f"\n  {f.code} {f.remedy}: {f.message}" for f in self.findings)
        return f"{self.verdict.sentence} Advised: {self.advised}{said}"

    def names(self, pattern: str) -> bool:
        """Whether a finding or a step names something."""
        return re.search(pattern, self.words, re.IGNORECASE) is not None

    def trusted_in_error(self, truth: Mapping[str, float]) -> list[str]:
        """Parameters called good that are off by more than twice their doubt."""
        judged = ((name, self.verdict.parameters[name]) for name in truth)
        return [
            name
            for name, one in judged
            if one.level == "good" and abs(one.value - truth[name]) > 2 * one.share * one.value
        ]


CONSTANT = r"constant part|constant is missing|dry friction|zero of (the )?(sensor|input)|offset"
DELAYED = {"late_signal", "low_passed"}


SPINDLE = rx.Equation(  # J w' + B w = T
    rx.Term("J", "w", derivative=1, unit="kg m^2"),
    rx.Term("B", "w", unit="N m s"),
    -rx.Term(1.0, "T"),
    name="spindle",
    unit="N m",
)
ONE_WAY = {
    "one tone": [(0.008, 1.3, 0.0)],
    "many tones": [(0.008, 1.3, 0.0), (0.003, 0.41, 1.0), (0.008, 2.7, 2.0), (0.011, 6.1, 4.0)],
    "slowly about a working point": [(0.004, 0.25, 0.5)],
}


@functools.cache
def one_way(tones: str) -> dict[str, np.ndarray]:
    """A spindle that dry friction of 0.003 N m brakes all along, near 90 rad/s."""
    torque = 0.003 + 9e-5 * 90 + summed(ONE_WAY[tones], FINE)

    def rate(state: State, torque: float) -> State:
        (w,) = state
        return ((torque - 9e-5 * w - 0.003 * np.sign(w)) / 1.2e-4,)

    (w,) = integrated(rate, (90.0,), torque)
    assert w.min() > 20  # one way
    return {"w": w, "T": torque[:: (FINE.size - 1) // (SAMPLES - 1)]}


@pytest.mark.parametrize("tones", ONE_WAY)
def test_a_constant_that_one_way_motion_lacks_is_no_delay(tones):
    told = Told(SPINDLE, recorded(one_way(tones)))
    assert told.names(CONSTANT), told
    assert "--shift" not in told.advised, told
    assert "hysteresis" not in told.codes, told
    assert not told.trusted_in_error({"J": 1.2e-4, "B": 9e-5}), told


AXIS = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("v",), unit="kg"),
    rx.Term("c", "x", derivative=1, measured=("v",), unit="N s/m"),
    rx.Term("k", "x", unit="N/m"),
    -rx.Term(1.0, "F"),
    name="axis",
    unit="N",
)
UNDAMPED = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("v",), unit="kg"),
    rx.Term("k", "x", unit="N/m"),
    -rx.Term(1.0, "F"),
    name="oscillator",
    unit="N",
)


@functools.cache
def axis(
    damping: float = 9.0, friction: float = 0.0, mass: float = 2.0, delay: float = 0.0
) -> dict[str, np.ndarray]:
    """A body on a spring of 400 N/m; the `delay` in samples is that of the force's sensor."""
    tones = broad(4, 30.0, 0.3, 8.0)

    def rate(state: State, force: float) -> State:
        x, v = state
        drag = damping * v + friction * ((v > 0) - (v < 0))
        return v, (force - 400.0 * x - drag) / mass

    x, v = integrated(rate, (0.0, 0.0), summed(tones, FINE))
    return {"x": x, "v": v, "F": summed(tones, TIMES - delay * STEP)}


@pytest.mark.parametrize("friction", [1.5, 6.0])
def test_dry_friction_that_is_missing_is_neither_late_nor_hysteresis(friction):
    told = Told(AXIS, recorded(axis(friction=friction)))
    assert not told.codes & {*DELAYED, "hysteresis"}, told
    assert told.names(r"friction|sign\(|sign of|direction of"), told
    assert not told.trusted_in_error({"m": 2.0, "c": 9.0, "k": 400.0}), told


@pytest.mark.parametrize("damping", [0.16, 1.0])
def test_a_dashpot_that_is_missing_is_no_delay(damping):
    told = Told(UNDAMPED, recorded(axis(damping=damping, mass=0.4)))
    assert "--shift" not in told.advised, told
    assert "--unfilter" not in told.advised, told
    follows = [f.signals for f in told.findings if f.code == "residual_follows_signal"]
    assert told.names(r"damp|viscous|dashpot|friction") or ("v",) in follows, told
    assert not told.trusted_in_error({"m": 0.4, "k": 400.0}), told


@pytest.mark.raises_finding("late_signal")
@pytest.mark.parametrize("noise", [0.001, 0.01])
def test_a_force_that_is_late_is_told_with_its_delay_and_shifted_next(noise):
    told = Told(AXIS, recorded(axis(delay=2.3), noise))
    (late,) = (finding for finding in told.findings if finding.code == "late_signal")
    assert late.signals == ("F",)
    option, value = late.remedy
    assert option == "--shift"
    assert float(value.removeprefix("F=")) == pytest.approx(2.3 * STEP, abs=0.05 * STEP)
    assert told.advised[:2] == list(late.remedy), told
    assert not told.trusted_in_error({"m": 2.0, "c": 9.0, "k": 400.0}), told


ZEROS = {"F": 3.0, "x": 0.0075}


@pytest.mark.parametrize("signal", ZEROS)
def test_a_zero_is_told_where_a_spring_is_and_never_as_a_gain(signal):
    signals = axis()
    told = Told(AXIS, recorded(signals | {signal: signals[signal] + ZEROS[signal]}))
    assert told.names(CONSTANT), told
    assert not told.codes & {*DELAYED, "hysteresis", "wrong_gain"}, told
    assert not told.trusted_in_error({"m": 2.0, "c": 9.0, "k": 400.0}), told


@pytest.mark.no_finding("late_signal", "low_passed", "wrong_gain", "hysteresis", "uneven_errors")
@pytest.mark.parametrize("gain", [1.0, 1.3])
def test_a_gain_of_the_force_leaves_nothing_and_is_not_told(gain):
    signals = axis()
    told = Told(AXIS, recorded(signals | {"F": gain * signals["F"]}))
    assert told.codes <= {"not_validated"}, told
    assert not told.trusted_in_error({"m": 2.0 * gain, "c": 9.0 * gain, "k": 400.0 * gain}), told


MOTOR = rx.Equation(
    rx.Term("J", "q", derivative=2, measured=("w",), unit="kg m^2"),
    rx.Term("B", "q", derivative=1, measured=("w",), unit="N m s"),
    -rx.Term(1.0, "T"),
    name="motor",
    unit="N m",
)


@pytest.mark.parametrize("hertz", [5.0, 9.0])
def test_a_load_behind_a_spring_is_told_as_a_mode(hertz):
    motor, load, tones = 2e-3, 3e-3, broad(5, 0.5, 0.3, 12.0)
    stiffness = load * (2 * np.pi * hertz) ** 2

    def rate(state: State, torque: float) -> State:
        q, w, there, speed = state
        twist = stiffness * (q - there) + 0.004 * (w - speed)
        return w, (torque - 0.02 * w - twist) / motor, speed, twist / load

    q, w, _, _ = integrated(rate, (0.0,) * 4, summed(tones, FINE))
    told = Told(MOTOR, recorded({"q": q, "w": w, "T": summed(tones, TIMES)}))
    assert not told.codes & {*DELAYED, "hysteresis"}, told
    assert told.names(r"\bmode\b|spring"), told
    assert {"--add-mode", "--add-spring"} & {*told.advised}, told


COAST = rx.Equation(  # 1200 v' + k v^2 = 0
    rx.Term(1200.0, "v", derivative=1),
    rx.Term("k", lambda s: s["v"] ** 2, unit="kg/m"),
    name="car",
    unit="N",
)


@pytest.mark.parametrize("rolling", [60.0, 180.0])
def test_rolling_resistance_that_a_coast_lacks_is_no_hysteresis(rolling):
    # 60 s from 30 m/s, with 0.01 m/s of noise.
    def rate(state: State, _: float) -> State:
        (v,) = state
        return (-(rolling + 0.6 * v * v) / 1200.0,)

    (v,) = integrated(rate, (30.0,), np.zeros(2 * 4 * 1199 + 1), samples=1200, step=0.05)
    noisy = v + 0.01 * np.random.default_rng(0).standard_normal(v.size)
    told = Told(COAST, rx.Record.from_samples({"v": noisy}, time_step=0.05))
    assert not told.codes & {*DELAYED, "hysteresis"}, told
    assert told.names(rf"{CONSTANT}|friction|resistance|constant"), told
    assert not told.trusted_in_error({"k": 0.6}), told


SERVO = rx.Equation(  # J q'' + fv q' + fc sign(q') + offset = K u
    rx.Term("J", "q", derivative=2, measured=("w",), unit="kg m^2"),
    rx.Term("fv", "q", derivative=1, measured=("w",), unit="N m s"),
    rx.Term("fc", lambda s: jnp.sign(s["w"]), unit="N m"),
    rx.Term("offset", rx.constant, unit="N m"),
    -rx.Term(0.1, "u"),
    name="servo",
    unit="N m",
)


@functools.cache
def sticking() -> dict[str, np.ndarray]:
    """A servo that dry friction holds at every turn: J 6e-3, fv 0.04, fc 0.06."""
    q, w, rows, fine = 0.0, 0.0, [], 50
    for time in TIMES[:3000]:
        goal = 1.2 * np.sin(1.1 * time) + 0.5 * np.sin(4 * time) * np.sin(1.7 * time)
        u = float(3.0 * (goal - q))
        rows.append((q, w, u))
        for _ in range(fine):
            drive = 0.1 * u
            if w == 0 and abs(drive) <= 0.06:
                break  # until u changes
            way = np.sign(w) if w else np.sign(drive)
            after = w + STEP / fine * (drive - 0.04 * w - 0.06 * way) / 6e-3
            w = 0.0 if after * w < 0 else after
            q += STEP / fine * w
    return dict(zip("qwu", np.array(rows).T))


def coarse(signals: Mapping[str, np.ndarray]) -> rx.Record:
    """As of an encoder of 8192 counts a turn, and its differences."""
    quanta = {"q": 2 * np.pi / 8192, "w": 0.02, "u": 1e-4}
    rounded = {n: quanta[n] * np.round(v / quanta[n]) for n, v in signals.items()}
    return rx.Record.from_samples(rounded, time_step=STEP)


@pytest.mark.raises_finding("at_rest")
@pytest.mark.no_finding("stuck_sensor", "late_signal", "hysteresis")
@pytest.mark.parametrize("samples", [1100, 1550, 3000])
def test_a_servo_that_sticks_is_answered_and_none_of_its_sensors_is_stuck(samples):
    assert np.mean(sticking()["w"][:samples] == 0) > 0.05
    told = Told(SERVO, coarse({n: v[:samples] for n, v in sticking().items()}))
    assert ("w",) in [f.signals for f in told.findings if f.code == "at_rest"], told
    assert not told.trusted_in_error({"J": 6e-3, "fv": 0.04, "fc": 0.06}), told


@pytest.mark.raises_finding("held_signal")
@pytest.mark.no_finding("stuck_sensor")
def test_messages_of_ten_rows_are_told_with_the_rows_to_take():
    slow = {name: np.repeat(values[::10], 10) for name, values in axis().items()}
    told = Told(AXIS, recorded(slow, noise=0.0))
    held = [finding for finding in told.findings if finding.code == "held_signal"]
    assert {name for finding in held for name in finding.signals} == {"x", "v", "F"}, told
    assert {finding.remedy for finding in held} == {("--every", "10")}, told
    assert told.advised[:2] == ["--every", "10"], told
    assert not told.codes & DELAYED, told


@pytest.mark.raises_finding("unmodelled_mode")
@pytest.mark.no_finding("late_signal", "low_passed")
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_car_whose_engine_shakes_has_no_late_sensor(noise):
    """Wheel 30 kg, body 200 kg, engine 100 kg on a mount that rings near 14 Hz."""
    tones = broad(6, 0.25, 0.4, 20.0, 60)

    def rate(state: State, road: float) -> State:
        x1, x2, x3, x4, x5, x6, x7 = state
        damper = 1100.0 * x7 + 500.0 * x7 / (1 + (x7 / 0.15) ** 2) ** 0.5
        slope = 1100.0 + 500.0 / (1 + (x7 / 0.15) ** 2) ** 1.5
        force, mount = 20_000.0 * x2 + damper, 400_000.0 * x5 + 2500.0 * (x4 - x6)
        return (
            road - x3,
            x3 - x4,
            (180_000.0 * x1 - force) / 30.0,
            (force - mount) / 200.0,
            x4 - x6,
            mount / 100.0,
            500_000.0 / slope * (x3 - x4 - x7),
        )

    states = integrated(rate, (0.0,) * 7, summed(tones, fine_times(fine=4)))
    signals = dict(zip(("x1", "x2", "x3", "x4"), states)) | {"F_t": 180_000.0 * states[0]}
    told = Told(rx.find_model("quarter-car"), recorded(signals, noise))
    assert {"--add-mode", "x4"} <= {*told.advised}, told
    assert not {"--shift", "--unfilter"} & {*told.advised}, told

"""What looks like something else: causes that leave much the same of an equation, each told apart.

Every motion is integrated here, in fine steps, and what its model lacks is known.
"""

import functools
import math
import re
from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx

STEP, SAMPLES = 0.005, 4000
TIMES = STEP * np.arange(SAMPLES)
State = tuple[float, ...]


def tones(*each: tuple[float, float, float]) -> Callable[[np.ndarray], np.ndarray]:
    """Their sum at given times: of each tone its size, its frequency in hertz and its phase."""
    sizes, hertz, phases = np.array(each).T[..., None]
    return lambda time: np.sum(sizes * np.sin(2 * np.pi * hertz * time + phases), axis=0)


def broad(seed: int, size: float, low: float, high: float, count: int = 40):
    """Tones of random frequencies and phases; `size`: the standard deviation of their sum."""
    rng = np.random.default_rng(seed)
    each = size * np.sqrt(2 / count)
    return tones(*((each, *rng.uniform((low, 0), (high, 2 * np.pi))) for _ in range(count)))


def integrated(
    rate: Callable[[State, float], State],
    start: State,
    drive: Callable[[np.ndarray], np.ndarray],
    step: float = STEP,
    fine: int = 10,
) -> np.ndarray:
    """States by sample, by the classical Runge-Kutta method in `fine` steps from each to the next,
    of what changes at a `rate` of its state and its drive."""
    h, state, course = step / fine, start, []
    values = drive(0.5 * h * np.arange(2 * fine * SAMPLES + 1)).tolist()
    for place in range(fine * SAMPLES):
        if place % fine == 0:
            course.append(state)
        now, midway, then = values[2 * place : 2 * place + 3]
        a = rate(state, now)
        b = rate(tuple(x + 0.5 * h * dx for x, dx in zip(state, a)), midway)
        c = rate(tuple(x + 0.5 * h * dx for x, dx in zip(state, b)), midway)
        d = rate(tuple(x + h * dx for x, dx in zip(state, c)), then)
        slopes = zip(state, a, b, c, d)
        state = tuple(x + h / 6 * (p + 2 * q + 2 * r + s) for x, p, q, r, s in slopes)
    return np.array(course).T


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
        judged = [one for one in self.verdict.parameters.values() if one.name in truth]
        far = [
            one for one in judged if abs(one.value - truth[one.name]) > 2 * one.share * one.value
        ]
        return [one.name for one in far if one.level == "good"]


CONSTANT = r"constant part|constant is missing|dry friction|zero of (the )?(sensor|input)|offset"
DELAYED = {"late_signal", "low_passed"}
SPINDLE = rx.Equation(rx.Term("J", "w", derivative=1), rx.Term("B", "w"), -rx.Term(1.0, "T"))


def spindle(truth: Mapping[str, float], friction: float, start: float, torque) -> dict:
    """With dry friction, which SPINDLE lacks."""

    def rate(state: State, torque: float) -> State:
        (w,) = state
        braked = truth["B"] * w + friction * ((w > 0) - (w < 0))
        return ((torque - braked) / truth["J"],)

    (w,) = integrated(rate, (start,), torque)
    return {"w": w, "T": torque(TIMES)}


# At 90 rad/s, and what dry friction of 0.003 N m takes.
HOLDS, FIRST = (9e-5 * 90 + 0.003, 0.0, np.pi / 2), (0.008, 1.3, 0.0)
ONE_WAY = {
    "one tone": tones(HOLDS, FIRST),
    "many tones": tones(HOLDS, FIRST, (0.003, 0.41, 1.0), (0.008, 2.7, 2.0), (0.011, 6.1, 4.0)),
    "slowly about a working point": tones(HOLDS, (0.004, 0.25, 0.5)),
}


@pytest.mark.parametrize("torque", ONE_WAY)
def test_a_constant_that_one_way_motion_lacks_is_no_delay(torque):
    truth = {"J": 1.2e-4, "B": 9e-5}
    signals = spindle(truth, 0.003, 90.0, ONE_WAY[torque])
    assert signals["w"].min() > 20
    told = Told(SPINDLE, recorded(signals))
    assert told.names(CONSTANT), told
    assert "--shift" not in told.advised, told
    assert "hysteresis" not in told.codes, told
    assert not told.trusted_in_error(truth), told


BOTH_WAYS = {"one tone": tones((0.2, 1.0, 0.0)), "broadly": broad(4, 0.15, 0.3, 5.0)}
FRICTION = r"friction|sign\(|sign of|direction of"


@pytest.mark.parametrize("torque", BOTH_WAYS)
def test_dry_friction_of_a_rotor_that_turns_both_ways_does_not_make_its_speed_late(torque):
    truth = {"J": 2e-3, "B": 0.01}
    told = Told(SPINDLE, recorded(spindle(truth, 0.01, 0.0, BOTH_WAYS[torque])))
    assert not told.codes & {*DELAYED, "hysteresis"}, told
    assert told.names(FRICTION), told
    assert not told.trusted_in_error(truth), told


def body(*parameters: str) -> rx.Equation:
    """Of m x'' + c x' + k x + f sign(x') + offset = F the terms of these parameters."""
    terms = {
        "m": rx.Term("m", "x", derivative=2, measured=("v",)),
        "c": rx.Term("c", "x", derivative=1, measured=("v",)),
        "k": rx.Term("k", "x"),
        "f": rx.Term("f", lambda s: jnp.sign(s["v"])),
        "offset": rx.Term("offset", rx.constant),
    }
    return rx.Equation(*(terms[name] for name in parameters), -rx.Term(1.0, "F"))


AXIS, TRUTH = body("m", "c", "k"), {"m": 2.0, "c": 9.0, "k": 400.0}
MOVES = {
    "broadly": broad(4, 30.0, 0.3, 8.0),
    "slowly": broad(4, 30.0, 0.3, 3.0),
    "in three tones": tones((30.0, 0.7, 0.0), (20.0, 1.1, 1.0), (20.0, 1.9, 2.0)),
}


def axis(
    moves: str = "broadly", *, mass=2.0, damping=9.0, friction=0.0, delay=0.0
) -> dict[str, np.ndarray]:
    """A body on a spring of 400 N/m; the `delay` in samples is that of the force's sensor."""

    def rate(state: State, force: float) -> State:
        x, v = state
        drag = damping * v + friction * ((v > 0) - (v < 0))
        return v, (force - 400.0 * x - drag) / mass

    x, v = integrated(rate, (0.0, 0.0), MOVES[moves])
    return {"x": x, "v": v, "F": MOVES[moves](TIMES - delay * STEP)}


@pytest.mark.parametrize(
    ("moves", "friction"), [("broadly", 6.0), ("slowly", 1.5), ("slowly", 6.0)]
)
def test_dry_friction_that_is_missing_is_neither_late_nor_hysteresis(moves, friction):
    told = Told(AXIS, recorded(axis(moves, friction=friction)))
    assert not told.codes & {*DELAYED, "hysteresis"}, told
    assert told.names(FRICTION), told
    assert not told.trusted_in_error(TRUTH), told


BESIDE = {
    "nothing": ("slowly", lambda x, v: 0.0, None),
    "drag": ("broadly", lambda x, v: 30 * v * abs(v), "drag"),
    "a spring that hardens": ("broadly", lambda x, v: 2e4 * x**3, "stiffness that hardens"),
}
"""How the body moves, what else its model lacks, and what that is called."""


@pytest.mark.raises_finding("hysteresis")
@pytest.mark.parametrize("noise", [0.001, 0.05])
@pytest.mark.parametrize("lacking", BESIDE)
def test_hysteresis_is_told_with_what_else_is_missing(lacking, noise):
    moves, other, called = BESIDE[lacking]

    def rate(state: State, force: float) -> State:
        x, v, z = state
        held = 400.0 * x + 9.0 * v + 12.0 * z + other(x, v)
        return v, (force - held) / 2.0, (v - abs(v) * z) / 0.03

    x, v, _ = integrated(rate, (0.0,) * 3, MOVES[moves])
    told = Told(AXIS, recorded({"x": x, "v": v, "F": MOVES[moves](TIMES)}, noise))
    (finding,) = (finding for finding in told.findings if finding.code == "hysteresis")
    width = re.search(r"within about ([\d.]+)", finding.message)
    assert width is not None, told
    assert 0.01 < float(width[1]) < 0.1, told
    assert not told.codes & DELAYED, told
    terms = [finding.message for finding in told.findings if finding.code == "missing_term"]
    assert len(terms) == (called is not None), told
    assert all(called in term for term in terms), told
    assert not told.trusted_in_error(TRUTH), told


DASHPOTS = {
    "of 0.4 ms": ("slowly", 0.4, 0.16, 0.001),
    "of 2.5 ms": ("slowly", 0.4, 1.0, 0.01),
    "far below resonance": ("in three tones", 0.1, 1.0, 0.01),
    "at resonance": ("broadly", 0.4, 1.0, 0.01),
}
"""Motion, mass, damping, and noise: slow motion of a spring and a dashpot is that of a spring whose
force is c / k late."""


@pytest.mark.raises_finding("missing_term")
@pytest.mark.parametrize("case", DASHPOTS)
def test_a_dashpot_that_is_missing_is_no_delay(case):
    moves, mass, damping, noise = DASHPOTS[case]
    told = Told(body("m", "k"), recorded(axis(moves, mass=mass, damping=damping), noise))
    assert not {"--shift", "--unfilter"} & {*told.advised}, told
    assert told.names(r"damp|viscous|dashpot|friction"), told
    assert not told.trusted_in_error({"m": mass, "k": 400.0}), told


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
    assert not told.trusted_in_error(TRUTH), told


ZEROS = {"F": 3.0, "x": 0.0075}


@pytest.mark.parametrize("signal", ZEROS)
def test_a_zero_is_told_where_a_spring_is_and_never_as_a_gain(signal):
    signals = axis()
    told = Told(AXIS, recorded(signals | {signal: signals[signal] + ZEROS[signal]}))
    assert told.names(CONSTANT), told
    assert not told.codes & {*DELAYED, "hysteresis", "wrong_gain"}, told
    assert not told.trusted_in_error(TRUTH), told


@pytest.mark.no_finding(
    "late_signal", "low_passed", "wrong_gain", "hysteresis", "uneven_errors", "missing_term"
)
@pytest.mark.parametrize("gain", [1.0, 1.3])
def test_a_gain_of_the_force_leaves_nothing_and_is_not_told(gain):
    signals = axis()
    told = Told(AXIS, recorded(signals | {"F": gain * signals["F"]}))
    assert told.codes <= {"not_validated"}, told
    assert not told.trusted_in_error({"m": 2.0 * gain, "c": 9.0 * gain, "k": 400.0 * gain}), told


@pytest.mark.parametrize(("hertz", "highest"), [(5.0, 12.0), (5.0, 6.0), (9.0, 12.0)])
def test_a_load_behind_a_spring_is_told_as_a_mode(hertz, highest):
    """A motor's load, which swings at so many hertz while the motor is held."""
    drive, stiffness = broad(5, 0.5, 0.3, highest), 3e-3 * (2 * np.pi * hertz) ** 2

    def rate(state: State, torque: float) -> State:
        x, v, there, speed = state
        twist = stiffness * (x - there) + 0.004 * (v - speed)
        return v, (torque - 0.02 * v - twist) / 2e-3, speed, twist / 3e-3

    x, v, _, _ = integrated(rate, (0.0,) * 4, drive)
    told = Told(body("m", "c"), recorded({"x": x, "v": v, "F": drive(TIMES)}))
    assert not told.codes & {*DELAYED, "hysteresis"}, told
    assert told.names(r"\bmode\b|spring"), told
    assert "--shift" not in told.advised, told


COAST = rx.Equation(rx.Term(1200.0, "v", derivative=1), rx.Term("k", lambda s: s["v"] ** 2))


@pytest.mark.parametrize("noise", [0.001, 0.01])
@pytest.mark.parametrize("rolling", [60.0, 180.0])
def test_rolling_resistance_that_a_coast_lacks_is_no_hysteresis(rolling, noise):
    def rate(state: State, _: float) -> State:
        (v,) = state
        return (-(rolling + 0.6 * v * v) / 1200.0,)

    (v,) = integrated(rate, (30.0,), np.zeros_like, 0.015, 1)
    assert v[-1] > 10
    noisy = v + noise * np.random.default_rng(0).standard_normal(SAMPLES)
    told = Told(COAST, rx.Record.from_samples({"v": noisy}, time_step=0.015))
    assert not told.codes & {*DELAYED, "hysteresis"}, told
    assert told.names(rf"{CONSTANT}|friction|resistance|constant"), told
    assert not told.trusted_in_error({"k": 0.6}), told


@functools.cache
def sticking() -> dict[str, np.ndarray]:
    """A servo that dry friction holds at every turn, by an encoder of 8192 counts a turn."""
    q, w, rows, fine = 0.0, 0.0, [], 50
    h = STEP / fine
    for place in range(3000 * fine):
        time = h * place
        goal = 1.2 * math.sin(1.1 * time) + 0.5 * math.sin(4 * time) * math.sin(1.7 * time)
        torque = 0.3 * (goal - q)
        if place % fine == 0:
            rows.append((q, w, torque))
        if w or abs(torque) > 0.06:
            after = w + h * (torque - 0.04 * w - math.copysign(0.06, w or torque)) / 6e-3
            w = 0.0 if after * w < 0 else after
            q += h * w
    quanta = np.array([2 * np.pi / 8192, 0.02, 1e-5])
    return dict(zip("xvF", (quanta * np.round(np.array(rows) / quanta)).T))


@pytest.mark.raises_finding("at_rest")
@pytest.mark.no_finding("stuck_sensor", "late_signal", "hysteresis")
@pytest.mark.parametrize("samples", [1100, 1550, 3000])
def test_a_servo_that_sticks_is_answered_and_none_of_its_sensors_is_stuck(samples):
    signals = {name: values[:samples] for name, values in sticking().items()}
    assert np.mean(signals["v"] == 0) > 0.05
    told = Told(body("m", "c", "f", "offset"), recorded(signals, noise=0.0))
    assert ("v",) in [f.signals for f in told.findings if f.code == "at_rest"], told
    assert not told.trusted_in_error({"m": 6e-3, "c": 0.04, "f": 0.06}), told


@pytest.mark.raises_finding("held_signal")
@pytest.mark.no_finding("stuck_sensor")
def test_messages_of_ten_rows_are_told_with_the_rows_to_take():
    slow = {name: np.repeat(values[::10], 10) for name, values in axis("slowly").items()}
    told = Told(AXIS, recorded(slow, noise=0.0))
    held = [finding for finding in told.findings if finding.code == "held_signal"]
    assert {name for finding in held for name in finding.signals} == {"x", "v", "F"}, told
    assert {finding.remedy for finding in held} == {("--every", "10")}, told
    assert told.advised[:2] == ["--every", "10"], told
    assert not told.codes & DELAYED, told


WHITE = 0.6 * np.random.default_rng(6).standard_normal(SAMPLES)
ROADS = {
    "white noise": lambda time: np.interp(time, TIMES, WHITE),
    "tones": broad(6, 0.25, 0.4, 20.0, 60),
}


@pytest.mark.raises_finding("unmodelled_mode")
@pytest.mark.no_finding("late_signal", "low_passed")
@pytest.mark.parametrize("road", ROADS)
def test_a_car_whose_engine_shakes_has_no_late_sensor(road):
    """Wheel 30 kg, body 200 kg, engine 100 kg on a mount that rings near 12 Hz."""

    def rate(state: State, road: float) -> State:
        x1, x2, x3, x4, x5, x6, x7 = state
        damper = 1100.0 * x7 + 500.0 * x7 / (1 + (x7 / 0.15) ** 2) ** 0.5
        slope = 1100.0 + 500.0 / (1 + (x7 / 0.15) ** 2) ** 1.5
        force, mount = 20_000.0 * x2 + damper, 400_000.0 * x5 + 3000.0 * (x4 - x6)
        wheel, across = (180_000.0 * x1 - force) / 30.0, 500_000.0 / slope * (x3 - x4 - x7)
        return road - x3, x3 - x4, wheel, (force - mount) / 200.0, x4 - x6, mount / 100.0, across

    states = integrated(rate, (0.0,) * 7, ROADS[road], fine=4)
    signals = dict(zip(("x1", "x2", "x3", "x4"), states)) | {"F_t": 180_000.0 * states[0]}
    told = Told(rx.find_model("quarter-car"), recorded(signals))
    option, place = told.advised[:2]
    signal, hertz = place.split("=")
    assert (option, signal) == ("--add-mode", "x4"), told
    assert float(hertz) == pytest.approx(np.sqrt(400_000 / 100) / (2 * np.pi), rel=0.05), told
    assert not {"--shift", "--unfilter"} & {*told.advised}, told

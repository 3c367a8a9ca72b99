"""Signals whose sum is the derivative of another, one of them faulty: x2' = x3 - x4.

Motions are sums of sines, exact at any time, so that what each fault does to them is, too.
"""

from collections.abc import Mapping
from types import MappingProxyType

import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from riecjax.equations.procedure import relation_of
from riecjax.findings import Finding
from riecjax.records import align
from riecjax.records.consistency import check_derivatives
from riecjax.records.derived import derived
from riecjax.records.faults.relations import Relation
from riecjax.records.preparation.alignment import declared_pairs
from riecjax.records.record import Record

STEP, COUNT = 0.005, 4000
DEFLECTION = Relation("x2", (("x3", 1.0), ("x4", -1.0)))
TIME = STEP * np.arange(COUNT)


class Motion:
    """Wheel and body, each of thirty tones; x2 is the integral of x3 - x4."""

    def __init__(self, seed: int):
        rng = np.random.default_rng(seed)
        self.omega = 2 * np.pi * rng.uniform(0.3, 15, 30)
        waves = rng.normal(size=(2, 30)) * np.exp(2j * np.pi * rng.uniform(size=(2, 30)))
        wheel, body = waves[0], waves[1] / (1 + (self.omega / 15) ** 2)
        self.waves = {"x2": (wheel - body) / (1j * self.omega), "x3": wheel, "x4": body}

    def at(self, name: str, time: np.ndarray, lag: float = 0.0) -> np.ndarray:
        waves = self.waves[name] / (1 + 1j * self.omega * lag)
        return np.real(np.exp(1j * np.outer(time, self.omega)) @ waves)


def recorded(
    seed: int = 0,
    noise: float = 0.01,
    count: int = COUNT,
    faulty: Mapping[str, np.ndarray] = MappingProxyType({}),
) -> Record:
    motion, rng = Motion(seed), np.random.default_rng([seed, 1])
    clean = {name: motion.at(name, TIME) for name in motion.waves}
    columns = {
        name: faulty.get(name, values) + noise * np.std(values) * rng.standard_normal(COUNT)
        for name, values in clean.items()
    }
    columns = {name: values[:count] for name, values in columns.items()}
    return Record.from_samples(columns, time_step=STEP)


def only(**faulty: np.ndarray) -> Finding:
    (found,) = check_derivatives(recorded(faulty=faulty), [DEFLECTION])
    return found


ALL = (
    *("late_signal", "low_passed", "wrong_gain", "velocity_offset", "drifting_signal"),
    *("lost_rows", "two_clocks", "not_its_derivative"),
)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
@pytest.mark.no_finding(*ALL)
def test_what_fits_raises_no_alarm(noise):
    for seed in range(3):
        for count in (200, COUNT):
            assert check_derivatives(recorded(seed, noise, count), [DEFLECTION]) == []


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_a_hundred_sound_recordings_raise_no_alarm(noise):
    for seed in range(100):
        assert check_derivatives(recorded(seed, noise), [DEFLECTION]) == []


@pytest.mark.raises_finding("late_signal")
@pytest.mark.parametrize("name", ["x2", "x3", "x4"])
def test_the_late_one_is_named_and_brought_forward(name):
    late = Motion(0).at(name, TIME - 0.7 * STEP)
    found = only(**{name: late})
    assert (found.code, found.signals) == ("late_signal", (name,))
    assert float(found.remedy[1].partition("=")[2]) == pytest.approx(0.7 * STEP, rel=0.05)
    record = recorded(faulty={name: late})
    aligned = align(record, [DEFLECTION])
    assert [finding.signals for finding in aligned.findings] == [(name,)]
    assert check_derivatives(aligned.record, [DEFLECTION]) == []


@pytest.mark.raises_finding("low_passed")
@pytest.mark.parametrize("name", ["x3", "x4"])
def test_the_filtered_one_is_named(name):
    found = only(**{name: Motion(0).at(name, TIME, lag=6 * STEP)})
    assert (found.code, found.signals) == ("low_passed", (name,))


@pytest.mark.parametrize("name", ["x2", "x3", "x4"])
@pytest.mark.parametrize(
    ("code", "gain"),
    [
        pytest.param(code, gain, marks=pytest.mark.raises_finding(code))
        for code, gain in (
            ("wrong_gain", 1.03),
            ("not_its_derivative", -1.0),
            ("not_its_derivative", 3.6),
            ("not_its_derivative", 1000.0),
        )
    ],
)
def test_a_wrong_size_sign_or_unit_is_scaled_back(name, code, gain):
    found = only(**{name: gain * Motion(0).at(name, TIME)})
    assert (found.code, found.signals) == (code, (name,))
    assert found.remedy[0] == "--scale"
    scaled, _, factor = found.remedy[1].partition("=")
    assert scaled == name
    assert float(factor) == pytest.approx(1 / gain, rel=0.01)


@pytest.mark.raises_finding("velocity_offset", "drifting_signal")
def test_an_offset_or_a_drift_is_said_of_the_relation_and_taken_off():
    clean = Motion(0).at("x4", TIME)
    for code, more in (
        ("velocity_offset", np.full(COUNT, 0.1 * clean.std())),
        ("drifting_signal", 0.2 * clean.std() * (TIME / TIME[-1] - 0.5)),
    ):
        record = recorded(faulty={"x4": clean + more})
        (found,) = check_derivatives(record, [DEFLECTION])
        assert found.code == code
        assert {*found.signals} == {"x2", "x3", "x4"}
        name, _, formula = found.remedy[1].partition("=")
        columns = {n: np.asarray(v) for n, v in record.arrays.items()}
        mended = derived(formula, {**columns, "t": np.asarray(record.time)})
        left = check_derivatives(record.with_signals({name: jnp.asarray(mended)}), [DEFLECTION])
        assert left == []


@pytest.mark.raises_finding("lost_rows", "two_clocks")
@pytest.mark.parametrize("name", ["x3", "x4"])
def test_lost_rows_and_clocks_are_of_the_one_that_has_them(name):
    lost = np.where(TIME < 8, TIME, TIME + 3 * STEP)
    found = only(**{name: Motion(0).at(name, lost)})
    assert found.code == "lost_rows"
    assert f"{name} has lost" in found.message
    option, seconds = found.remedy
    assert option == "--to"
    assert 5 < float(seconds) <= 8
    found = only(**{name: Motion(0).at(name, TIME * (1 + 200e-6))})
    assert (found.code, found.signals[0]) == ("two_clocks", name)


def test_what_moves_between_samples_is_not_integrated():
    rng = np.random.default_rng(0)
    road, wheel = rng.standard_normal(COUNT), Motion(0).at("x3", TIME)
    held = np.concatenate([[0.0], np.cumsum(STEP * (road - wheel))[:-1]])
    record = Record.from_samples({"x1": held, "v_r": road, "x3": wheel}, time_step=STEP)
    assert check_derivatives(record, [Relation("x1", (("v_r", 1.0), ("x3", -1.0)))]) == []


def test_models_declare_relations_by_their_rates():
    pairs = declared_pairs(rx.find_model("quarter-car"))
    assert DEFLECTION in pairs
    assert Relation("x1", (("v_r", 1.0), ("x3", -1.0))) in pairs
    equation = rx.Equation(rx.Term("k", "x2"), -rx.Term(1.0, "F"))
    rates = {"x2": rx.difference("x3", "x4"), "x1": "v"}
    assert rx.staged(equation).with_rates(rates).derivatives == (
        DEFLECTION,
        Relation("x1", (("v", 1.0),)),
    )


@pytest.mark.parametrize(
    "rate",
    [
        lambda s: s["a"] * s["b"],
        lambda s: s["a"] + 1.0,
        lambda s: 1.0,
        lambda s: s["a"].missing,
        rx.equations.faster_than("a", 0.5),
    ],
)
def test_what_is_no_sum_is_no_relation(rate):
    assert relation_of("x", rate) is None

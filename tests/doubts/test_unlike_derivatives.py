"""Recorded derivatives against their signals; the truth is a sum of sines with its exact slope."""

import re
from pathlib import Path

import numpy as np
import pytest

from riecjax.doubts.kinematics import check_kinematics, compare
from riecjax.errors import MissingSignalError
from riecjax.records.record import Record
from riecjax.records.relations import Relation

STEP = 0.005
TIME = np.arange(4000) * STEP
SEEDS = range(10)


def motion(seed: int = 0, offset: float = 3.0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    frequencies, phases = rng.uniform(1, 30, 6), rng.uniform(0, 6, 6)
    waves = np.outer(frequencies, TIME) + phases[:, None]
    return {"x": offset + np.sin(waves).sum(0), "v": (frequencies[:, None] * np.cos(waves)).sum(0)}


def found(signals: dict[str, np.ndarray], step: float = STEP) -> list[str]:
    record = Record.from_samples(signals, time_step=step)
    findings = check_kinematics(record, [("x", "v")])
    # What is less than that is for tests/doubts/test_kinematics.py.
    findings = [finding for finding in findings if finding.code == "not_its_derivative"]
    assert all(finding.signals == ("x", "v") for finding in findings)
    return [finding.message for finding in findings]


def sound() -> dict[str, dict[str, np.ndarray]]:
    whole = motion()
    spiked = motion()
    spiked["x"][[500, 1700]] += 1e9
    spiked["v"][900] = -1e12
    gaps = motion()
    gaps["x"][::97] = np.nan
    gaps["v"][1000:1300] = np.nan
    resting = {"x": np.where(TIME < 15, 0, np.sin(TIME - 15)), "v": np.cos(TIME - 15) * (TIME > 15)}
    return {
        "coarse position": {**whole, "x": np.round(whole["x"], 1)},
        "spikes": spiked,
        "gaps": gaps,
        "mostly at rest": resting,
        "few samples": {"x": whole["x"][:30], "v": -whole["v"][:30]},
    }


@pytest.mark.parametrize("case", sound())
def test_derivatives_that_fit_raise_no_alarm(case):
    assert found(sound()[case]) == []


@pytest.mark.raises_finding("not_its_derivative")
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "factor"), [("x", 1e3), ("v", 57.29578), ("x", -1), ("v", 1.2)])
def test_units_and_signs(seed, name, factor):
    signals = motion(seed)
    signals[name] = factor * signals[name]
    (said,) = found(signals)
    stated = re.search(r"x changes by (\S+) times the integral of v", said)
    assert stated is not None
    assert float(stated[1]) == pytest.approx(factor if name == "x" else 1 / factor, rel=0.01)
    assert "--scale" in said


@pytest.mark.raises_finding("not_its_derivative")
@pytest.mark.parametrize(
    ("name", "factor", "unit"),
    [("v", 3.6, "km/h"), ("x", 1e3, "mm"), ("v", 1 / 0.0254, "in/s"), ("x", 1 / 0.3048, "ft"),
     ("v", 1.4, None), ("v", -1.0, None), ("x", 57.29578, None)],
)  # fmt: skip
def test_a_unit_that_loggers_write_is_named_and_no_other(name, factor, unit):
    signals = motion(1)
    signals[name] = factor * signals[name]
    units = {"x": "m", "v": "m/s"}
    record = Record.from_samples(signals, time_step=STEP, units=units)
    (finding,) = check_kinematics(record, [("x", "v")])
    assert finding.remedy == (("--unit", f"{name}={unit}") if unit else ())
    assert (f"{name} is in " in finding.message) == bool(unit)
    assert ("points the other way" in finding.message) == (factor == -1)


@pytest.mark.raises_finding("not_its_derivative")
def test_no_unit_is_named_of_signals_that_do_not_belong_together():
    strangers = {"x": motion(0)["x"], "v": motion(100)["v"]}
    pair = compare(Record.from_samples(strangers, time_step=STEP), Relation("x", (("v", 1.0),)))
    assert pair is not None
    assert pair.sizes is not None
    for unit in (1e3, 100.0):  # as of mm, of cm
        signals = {"x": strangers["x"] * unit / pair.sizes["v"].value, "v": strangers["v"]}
        units = {"x": "m", "v": "m/s"}
        record = Record.from_samples(signals, time_step=STEP, units=units)
        (finding,) = check_kinematics(record, [("x", "v")])
        assert "does not move with x" in finding.message
        assert "--unit" not in finding.remedy


@pytest.mark.parametrize("seed", SEEDS)
def test_channels_mixed_up(seed):
    signals = motion(seed)
    (said,) = found({"x": signals["x"], "v": motion(seed + 100)["v"]})
    assert "does not move with x" in said
    (swapped,) = found({"x": signals["v"], "v": signals["x"]})
    assert "v, which is read as the derivative of x" in swapped


def test_a_missing_signal():
    record = Record.from_samples({"x": TIME}, time_step=STEP)
    with pytest.raises(MissingSignalError):
        check_kinematics(record, [("x", "v")])


@pytest.mark.raises_finding("late_signal")
@pytest.mark.no_finding("not_its_derivative")
@pytest.mark.parametrize(("taps", "seconds"), [(30, 1.5), (60, 1.5), (60, 3.0)])
def test_a_mean_of_a_short_step_is_late_and_not_of_another_size(taps, seconds):
    """The velocity of a step with a time constant of 80 ms, as a mean over the last `taps` ms."""
    time = np.arange(0, seconds, 1e-3)
    v = -2.5 * (1 - np.exp(-time / 0.08))
    x = 1.0 - 2.5 * (time - 0.08 * (1 - np.exp(-time / 0.08)))
    mean = np.convolve(v, np.ones(taps) / taps)[: v.size]
    rng, every = np.random.default_rng(taps), slice(None, None, 25)
    noisy = mean[every] + 0.005 * rng.standard_normal(v[every].size)
    record = Record.from_samples({"x": x[every], "v": noisy}, time_step=0.025)
    late = [f for f in check_kinematics(record, [("x", "v")]) if f.code == "late_signal"]
    for finding in late:
        option, value = finding.remedy
        assert option == "--shift"
        delay = 0.5e-3 * (taps - 1)
        assert float(value.removeprefix("v=")) == pytest.approx(delay, abs=0.25 * 0.025)
    assert not found({"x": x[every], "v": noisy}, 0.025)


def test_the_recording_of_a_step_whose_velocity_is_a_mean():
    folder = Path(__file__).parents[3] / "shared" / "cases" / "late_velocity_step"
    if not (file := folder / "lag_step_down.csv").exists():
        pytest.skip("the recording stands beside the project, and is not there")
    rows = np.genfromtxt(file, delimiter=",", skip_header=1)
    record = Record.from_samples({"x": rows[:, 2], "v": rows[:, 3]}, time_step=0.02)
    (finding,) = check_kinematics(record, [("x", "v")])
    assert finding.code == "late_signal"
    assert float(finding.remedy[1].removeprefix("v=")) == pytest.approx(0.0195, abs=0.002)

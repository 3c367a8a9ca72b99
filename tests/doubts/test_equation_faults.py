"""Inputs that drift or say nothing, and hysteresis that a model lacks."""

import re
from functools import partial

import numpy as np
import pytest
import scipy.signal
from benchmarks.recovery.faults import recorded as recorded_machine
from benchmarks.recovery.machines import MACHINES
from benchmarks.recovery.machines import RATE as MACHINES_RATE
from test_delays import AXIS
from tests.machines import PROBLEMS, STROKE

import riecjax as rx
from nightly import by_day, nightly
from riecjax.assessment.demands import causes_found
from riecjax.doubts.check import Check
from riecjax.equations.model import as_model
from riecjax.estimation.identify import identify
from riecjax.models.catalogue import find_model
from riecjax.records.preparation.steps import undone
from riecjax.records.record import Record
from riecjax.summaries.summarise import ready
from riecjax.uncertainty.intervals import Sandwich
from riecjax.validation.equation_errors import errors_over_records
from riecjax.validation.residuals import ResidualTests
from riecjax.validation.tests import residuals_tested

RATE, COUNT = 100.0, 6000
NOTHING = Check([], [], (), rx.DOLS())
LAW = rx.Equation(rx.Term("c", "v"), rx.Term("k", "x"), -rx.Term(1.0, "u"))


def recorded(seed: int, drift: float, noise: float) -> rx.Record:
    """Of c v + k x = u with a drift of u along the record, in its standard deviations."""
    rng = np.random.default_rng(seed)
    t = np.arange(COUNT) / RATE
    omega, phase = 2 * np.pi * rng.uniform(0.1, 3, (20, 1)), rng.uniform(0, 6.3, (20, 1))
    # A motion that drifts as well takes up a part of what the force does.
    x = np.sum(np.sin(omega * t + phase), axis=0) + t / t[-1]
    v = np.sum(omega * np.cos(omega * t + phase), axis=0) + 1 / t[-1]
    u = 2.0 * v + 30.0 * x
    # It begins at zero: on the whole it is an offset as well.
    u += u.std() * (drift * t / t[-1] + noise * rng.normal(size=COUNT))
    return rx.Record.from_samples({"x": x, "v": v, "u": u}, time_step=1 / RATE)


def found(record: rx.Record, model: rx.Equation | rx.Model = LAW) -> list[rx.findings.Finding]:
    model = as_model(model)
    records = [one.record for one in ready(model, record)]
    estimate = rx.identify(model, records)
    errors = errors_over_records(model, records, estimate.values)
    return causes_found(NOTHING, model, records, errors, estimate)[0]


@pytest.mark.raises_finding("drifting_signal")
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("drift", [0.1, -1.0])
def test_a_force_that_drifts_is_named_with_what_it_drifts_by(noise, drift):
    for seed in range(5):
        record = recorded(seed, drift, noise)
        (finding,) = found(record)
        assert finding.signals == ("u",)
        mended = np.asarray(undone(record, [finding.remedy])["u"])
        expected = np.asarray(recorded(seed, 0.0, noise)["u"])
        left = np.max(np.abs(mended - expected)) / np.ptp(record["u"] - expected)
        assert left < (0.1 if noise == 0.05 and drift == 0.1 else 0.03)


@pytest.mark.raises_finding("drifting_signal")
def test_gaps_of_a_force_that_drifts_stay_gaps():
    record, even = recorded(0, 0.2, 0.01), recorded(0, 0.0, 0.01)
    u = np.array(record["u"])
    for start in range(300, COUNT, 600):
        u[start : start + 150] = np.nan
    holed = record.with_signals({"u": rx.Signal.of(u)})
    (finding,) = found(holed)
    line = undone(holed, [finding.remedy]).signal("u").with_nan - u
    drift = np.asarray(record["u"] - even["u"])
    assert np.nanmax(np.abs(line + drift)) < 0.03 * np.ptp(drift)


@pytest.mark.no_finding("drifting_signal")
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_a_force_that_does_not_drift_is_not(noise):
    for seed in range(30):
        assert found(recorded(seed, 0.0, noise)) == []


STEP, SAMPLES = 0.01, 3000


def driven(seed) -> dict[str, np.ndarray]:
    """Motion under a force of white noise that is held from sample to sample, to the last digit."""
    force = np.random.default_rng(seed).normal(size=SAMPLES)
    system = scipy.signal.StateSpace([[0, 1], [-100.0, -3.0]], [[0], [1.0]], np.eye(2), [[0], [0]])
    _, motion, _ = scipy.signal.lsim(system, force, STEP * np.arange(SAMPLES), interp=False)
    return {"x": motion[:, 0], "v": motion[:, 1], "F": force}


def codes(signals, *others) -> list[tuple[str, tuple[str, ...]]]:
    every = [Record.from_samples(one, time_step=STEP) for one in (signals, *others)]
    records = [one.record for one in ready(AXIS, every)]
    estimate = identify(AXIS, records, intervals=Sandwich())
    residuals, *_ = residuals_tested(
        AXIS, records, estimate, partial(causes_found, NOTHING), estimate
    ).tests
    assert isinstance(residuals, ResidualTests)
    return [(f.code, f.signals) for f in residuals.faults]


SILENT = {
    "constant": lambda rng: np.full(SAMPLES, 0.3),
    "noise": lambda rng: 1e-3 * rng.normal(size=SAMPLES),
    "noise about an offset": lambda rng: 0.3 + 1e-3 * rng.normal(size=SAMPLES),
    "a last digit that flickers": lambda rng: 1e-3 * rng.integers(0, 2, SAMPLES),
}


@pytest.mark.raises_finding("silent_input")
@pytest.mark.parametrize("case", SILENT)
def test_an_input_that_says_nothing_is_named(case):
    signals = driven(0) | {"F": SILENT[case](np.random.default_rng(1))}
    assert codes(signals) == [("silent_input", ("F",))]
    if case == "constant":
        assert codes(driven(1), signals) == [("silent_input", ("F",))]


@pytest.mark.no_finding("silent_input")
def test_a_force_of_white_noise_is_none_nor_is_free_motion():
    signals = driven(1)
    signals["F"][500:] = 0.0
    for moved in (driven(0), signals):
        assert "silent_input" not in {code for code, _ in codes(moved)}


HYSTERETIC = PROBLEMS["hysteresis"]


@pytest.mark.raises_finding("hysteresis")
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_a_missing_state_is_named_with_its_width(noise):
    viscous = rx.Term("c", "x", derivative=1, measured=("dx",))
    damped = as_model(HYSTERETIC.start).with_terms({"mass": [viscous]})
    (finding,) = found(HYSTERETIC.record(noise, 3, drive=1), damped)
    assert finding.code == "hysteresis"
    assert finding.message.startswith("mass: what the model leaves runs in loops over dx: ")
    width = re.search(r"within about ([\d.]+) of displacement", finding.message)
    assert width is not None
    assert STROKE / 3 < float(width[1]) < 3 * STROKE
    assert "riecjax discover" in finding.message
    # Windows of few samples see noise alone, of which a mass comes out next to zero.
    assert "--alpha" not in finding.message
    assert finding.signals == ("dx",)
    assert {*finding.parameters} == {"m", "k", "c"}


@pytest.mark.no_finding("hysteresis")
@pytest.mark.parametrize("name", by_day(("duffing", "drag", "axis", "dead_zone"), "axis"))
@pytest.mark.parametrize("noise", [*nightly([0.0]), 0.05])
def test_friction_and_springs_that_are_missing_are_no_hysteresis(name, noise):
    problem = PROBLEMS[name]
    told = found(problem.record(noise, 5, drive=2), problem.start)
    assert "hysteresis" not in [finding.code for finding in told]


@pytest.mark.no_finding("hysteresis")
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_model_with_hysteresis_lacks_none(noise):
    assert found(HYSTERETIC.record(noise, 5, drive=2), HYSTERETIC.model) == []


@pytest.mark.no_finding("hysteresis")
@pytest.mark.parametrize(
    ("name", "seed"), [("pendulum", 1228), *nightly([("axis", 1062), ("dry", 1019), ("car", 1210)])]
)
def test_sound_recordings_have_no_hysteresis(name, seed):
    machine = MACHINES[name]
    signals = recorded_machine(machine, None, "", seed, 0.01)[0][1]
    record = rx.Record.from_samples(signals, time_step=1 / MACHINES_RATE)
    assert found(record, find_model(machine.model)) == []


@pytest.mark.raises_finding("missing_term")
@pytest.mark.parametrize("scale", [1.0, 1e140])
def test_a_voltage_that_changes_dry_friction_is_named_with_what_it_changes(scale):
    """Whatever its unit is."""
    times = np.arange(6000) / 200
    x = np.sin(7 * times) + 0.4 * np.sin(11 * times + 1)
    v = 7 * np.cos(7 * times) + 4.4 * np.cos(11 * times + 1)
    volt = 1 + np.sin(0.9 * times)
    force = 3 * v + 5 * x + 4 * volt * np.sign(v)
    record = rx.Record.from_samples(
        {"x": x, "v": v, "F": force, "volt": scale * volt}, time_step=1 / 200
    )
    damper = rx.Equation(
        rx.Term("c", "x", derivative=1, measured=("v",)),
        rx.Term("k", "x"),
        -rx.Term(1.0, "F"),
        name="damper",
    )
    (finding,) = found(record, damper)
    assert {"volt", "v"} >= {*finding.signals} >= {"volt"}
    assert "dry friction that volt changes" in finding.message

"""Held-out validation: right, roughly right, wrong, drifting and diverging models told apart."""

import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.equations.model import equation_system
from riecjax.errors import DataError, ModelError
from riecjax.models.catalogue import built_in_model
from riecjax.models.oscillators import (
    pendulum_equation,
    two_mass_equation,
)
from riecjax.records.record import Record
from riecjax.records.signal import Signal
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate
from riecjax.simulation.system import AbstractSystem
from riecjax.validation.held_out import validate_held_out

VALUES = {"m": 1.0, "d": 0.5, "k1": 100.0, "k2": 0.0, "k3": 800.0}
COUNT, STEP = 1200, 0.01


def duffing(**changes: float) -> AbstractSystem:
    return built_in_model("duffing").build_system({**VALUES, **changes})


def drive(count: int = COUNT) -> np.ndarray:
    rng = np.random.default_rng(5)
    smooth = np.convolve(rng.normal(size=count + 40), np.hanning(20), "same")[20:-20]
    return 12 * smooth


@pytest.fixture(scope="module")
def truth() -> Record:
    inputs = Record({"u": Signal(drive(), unit="N")}, STEP, 2.0)
    return simulate(duffing(), inputs, initial_state={"y": 0.1, "dy": -0.4}).checked().record


def recorded(truth: Record, *names: str, lost: slice | None = None, **more) -> Record:
    samples = {name: np.array(truth[name]) for name in ("u", *names)} | more
    if lost is not None:
        samples["u"][lost] = np.nan
    return Record.from_samples(samples, time_step=STEP, units={"u": "N"})


def test_truth_predicts_its_own_record_to_rounding(truth):
    found = validate_held_out(duffing(), recorded(truth, "y", "dy"))
    assert found.ran
    assert found.predicts
    assert found.reason == ""
    assert set(found.signals) == {"y", "dy"}
    for one in found.signals.values():
        assert float(one.fit) > 100 - 1e-9
        assert float(one.vaf) > 100 - 1e-9
        assert float(one.p) < 1e-9
        assert one.samples == COUNT
    assert dict(found.started_from) == {"y": "measured", "dy": "measured"}
    np.testing.assert_allclose(found.record["y"], truth["y"], atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "predicts", "grades", "words"),
    [
        ({"k1": 101.0}, True, {"well", "roughly"}, "predicts the record"),
        ({"k1": 20.0, "k3": 0.0}, False, {"not", "worse than its mean"}, "does not predict"),
        ({"m": 1e4}, False, {"not", "worse than its mean"}, "worse than by the measured mean"),
    ],
)
def test_to_run_is_not_to_predict(truth, changes, predicts, grades, words):
    found = validate_held_out(duffing(**changes), recorded(truth, "y", "dy"))
    assert found.ran
    assert found.predicts is predicts
    assert {one.grade for one in found.signals.values()} <= grades
    assert words in found.verdict
    measured, simulated = np.asarray(truth["y"]), np.asarray(found.record["y"])
    error = measured - simulated
    expected = 100 * (1 - np.linalg.norm(error) / np.linalg.norm(measured - measured.mean()))
    np.testing.assert_allclose(found.signals["y"].fit, expected, rtol=1e-10)
    np.testing.assert_allclose(
        found.signals["y"].p, 100 * np.linalg.norm(error) / np.linalg.norm(measured), rtol=1e-10
    )
    np.testing.assert_allclose(
        found.signals["y"].vaf, 100 * (1 - error.var() / measured.var()), rtol=1e-10
    )


def test_unrecorded_velocity_starts_from_differences(truth):
    found = validate_held_out(duffing(), recorded(truth, "y"))
    assert dict(found.started_from)["dy"] == "differences"
    assert "dy is not recorded and started from differences" in found.verdict
    # Of second order: its error is y''' dt^2 / 3.
    jerk = np.max(np.abs(np.diff(np.asarray(truth["ddy"])[:5]))) / STEP
    assert abs(float(found.record["dy"][0]) + 0.4) < jerk * STEP**2
    assert found.predicts


def test_each_stretch_restarts_from_its_measured_state(truth):
    """A wrong model starts right again after a gap; nothing is compared across it."""
    wrong = duffing(k1=60.0)
    found = validate_held_out(wrong, recorded(truth, "y", "dy", lost=slice(500, 530)))
    assert found.stretches == ((0, 500), (530, COUNT))
    assert float(found.record["y"][530]) == float(truth["y"][530])
    assert found.signals["y"].samples == COUNT - 30
    assert np.array_equal(
        np.flatnonzero(np.isnan(found.record.signal("y").with_nan)), np.arange(500, 530)
    )
    for start, stop in found.stretches:
        alone = simulate(
            wrong,
            truth.select("u").part(start, stop),
            initial_state={name: truth[name][start] for name in ("y", "dy")},
        ).record
        np.testing.assert_allclose(found.record["y"][start:stop], alone["y"], atol=1e-10)
    kept = np.r_[0:500, 530:COUNT]
    y, made = np.asarray(truth["y"])[kept], np.asarray(found.record["y"])[kept]
    expected = 100 * (1 - np.linalg.norm(y - made) / np.linalg.norm(y - y.mean()))
    np.testing.assert_allclose(found.signals["y"].fit, expected, rtol=1e-9)


def test_short_stretches_are_skipped_and_none_at_all_is_an_error(truth):
    lost = np.array(truth["u"])
    for gap, stretches in ((slice(10, 1000), ((1000, COUNT),)), (slice(None, None, 15), ())):
        lost[gap] = np.nan
        record = recorded(truth, "y", "dy", u=lost)
        if stretches:
            assert validate_held_out(duffing(), record).stretches == stretches
            continue
        with pytest.raises(DataError, match="no unbroken stretch of 20 samples"):
            validate_held_out(duffing(), record)


def test_free_body_whose_velocity_predicts_and_whose_position_drifts_is_explained():
    system = equation_system(two_mass_equation(), {"M": 2.0})
    inputs = Record({"F": 10 * np.cos(5 * STEP * np.arange(4000))}, STEP)
    truth = simulate(system, inputs).record
    time = np.asarray(truth.time)
    # The sensor misses a small constant force that the body felt.
    measured = truth.with_signals(
        {"dz": truth["dz"] + 0.01 * time, "z": truth["z"] + 0.005 * time**2}
    ).select("F", "z", "dz")
    found = validate_held_out(system, measured)
    assert found.signals["dz"].grade in ("well", "roughly")
    assert found.signals["z"].grade in ("not", "worse than its mean")
    assert found.drifting == ("z",)
    assert not found.predicts
    assert "z drifts since it only adds up dz, which is predicted" in found.verdict
    velocity = validate_held_out(system, measured, signals=["dz"])
    assert velocity.predicts
    assert "z" not in velocity.signals


def test_a_free_swing_needs_no_input():
    values = {"p1": 60.0, "p2": 0.3}
    system = equation_system(pendulum_equation(), values)
    start = jnp.array([2.0, 0.0])
    states, _, _ = FixedStep().trajectory(system, jnp.zeros((500, 0)), jnp.array(0.01), start)
    theta = np.asarray(states[:, 0])
    record = Record.from_samples({"theta": theta}, time_step=0.01, units={"theta": "rad"})
    found = validate_held_out(system, record, initial_state={"dtheta": 0.0})
    assert found.predicts
    assert float(found.signals["theta"].fit) > 100 - 1e-6
    assert "" not in found.record.arrays
    assert dict(found.record.units)["theta"] == "rad"
    broken = np.array(theta)
    broken[200:210] = np.nan
    record = Record.from_samples({"theta": broken}, time_step=0.01)
    assert validate_held_out(system, record).stretches == ((0, 200), (210, 500))


def test_outputs_and_accelerations_are_compared_but_the_states_are_judged():
    system = built_in_model("quarter-car").build_system({})
    inputs = Record({"v_r": 0.05 * drive(600)}, 0.005)
    truth = simulate(system, inputs).record
    spoiled = truth.with_signals({"F_t": -truth["F_t"]}).select("v_r", "x4", "dx4", "F_t")
    found = validate_held_out(system, spoiled)
    assert set(found.signals) == {"x4", "dx4", "F_t"}
    assert found.judged == ("x4",)
    assert found.predicts
    assert found.signals["F_t"].grade == "worse than its mean"
    assert not validate_held_out(system, spoiled, signals=["x4", "F_t"]).predicts
    only = validate_held_out(system, spoiled.select("v_r", "F_t"))
    assert only.judged == ("F_t",)


def test_what_is_asked_for_and_not_there_is_named(truth):
    record = recorded(truth, "y")
    with pytest.raises(DataError, match="no signal 'u'"):
        validate_held_out(duffing(), truth.select("y"))
    with pytest.raises(ModelError, match="no signal 'F' to compare; it has: y, dy, ddy"):
        validate_held_out(duffing(), record, signals=["F"])
    with pytest.raises(DataError, match="no signal 'dy'"):
        validate_held_out(duffing(), record, signals=["dy"])
    with pytest.raises(DataError, match="nothing to compare"):
        validate_held_out(duffing(), truth.select("u"))
    with pytest.raises(ModelError, match="unknown state 'v'"):
        validate_held_out(duffing(), record, initial_state={"v": 0.0})

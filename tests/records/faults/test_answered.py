"""Pulses that acted, told from spikes of one sensor by what other signals show."""

import numpy as np
import pytest
import scipy.linalg

from riecjax.records.faults.signals import check_signals
from riecjax.records.faults.spikes import are_answered, repair_outliers
from riecjax.records.record import Record

RATE, COUNT = 200, 4000
M, R, K = 2.0, 3.0, 200.0


def hammered(blows: int, noise: float, seed: int = 0) -> dict[str, np.ndarray]:
    """An oscillator under blows of 10 ms, by SciPy's exact matrix exponential of held inputs."""
    rng = np.random.default_rng(seed)
    u = np.zeros(COUNT)
    for first in np.sort(rng.choice(np.arange(100, COUNT - 100), blows, replace=False)):
        u[first : first + 2] = rng.uniform(400, 800)
    matrix = np.zeros((3, 3))
    matrix[0, 1], matrix[1] = 1.0, (-K / M, -R / M, 1 / M)
    step = scipy.linalg.expm(matrix / RATE)
    state, states = np.zeros(2), []
    for force in u:
        states.append(state)
        state = step[:2, :2] @ state + step[:2, 2] * force
    exact = {"u": u, "x": np.array(states)[:, 0], "dx": np.array(states)[:, 1]}
    return {n: v + noise * v.std() * rng.standard_normal(COUNT) for n, v in exact.items()}


@pytest.mark.no_finding("outliers")
@pytest.mark.parametrize("motion", ["x", "dx"])
@pytest.mark.parametrize("blows", [1, 3, 30])
def test_blows_of_a_hammer_stay(motion, blows):
    for seed in range(5):
        signals = hammered(blows, 0.002, seed)
        record = Record.from_samples(
            {"u": signals["u"], motion: signals[motion]}, time_step=1 / RATE
        )
        np.testing.assert_array_equal(repair_outliers(record)["u"], signals["u"])
        assert [f.code for f in check_signals(record, ["u", motion]) if f.code == "outliers"] == []


@pytest.mark.slow
def test_spikes_of_one_sensor_are_answered_by_chance_at_most():
    answered = 0
    for seed in range(300):
        rng = np.random.default_rng(5000 + seed)
        signals = hammered(30, 0.01, seed)
        places = np.sort(rng.choice(np.arange(20, COUNT - 20), rng.integers(1, 20), replace=False))
        answered += are_answered(places, [signals["x"], signals["dx"]])
    # A thousandth of them is asked for.
    assert answered <= 1


def test_what_hits_all_sensors_at_once_is_no_answer():
    signals = hammered(0, 0.0)
    rng, t = np.random.default_rng(1), np.arange(COUNT) / RATE
    signals = {"u": np.cos(5 * t), "x": np.sin(5 * t), "dx": 5 * np.cos(5 * t)}
    places = rng.choice(np.arange(50, COUNT - 50), 12, replace=False)
    spiked = {n: v + 0.01 * rng.standard_normal(COUNT) for n, v in signals.items()}
    for values in spiked.values():
        values[places] += rng.choice([-1, 1], 12)
    repaired = repair_outliers(Record.from_samples(spiked, time_step=1 / RATE))
    for name, values in signals.items():
        np.testing.assert_allclose(repaired[name], values, atol=0.06)

"""A signal that shows one value for a few samples, again and again, while the motion goes on."""

import numpy as np
import pytest
from tests.machines import drag_signals as signals

from riecjax.records.faults.signals import check_signals
from riecjax.records.preparation.repair import leave_out
from riecjax.records.record import Record

STEP = 0.01


def dropping(how: str, name: str, length: int, seed: int, noise: float = 0.01):
    """Sensors of a moving oscillator of which one drops out at ten places; and where."""
    values = {n: v.copy() for n, v in signals(seed, noise).items()}
    rng, own = np.random.default_rng(100 + seed), values[name]
    lost = np.zeros(own.size, bool)
    for first in 50 + 190 * np.arange(10) + rng.integers(0, 150, 10):
        there = slice(first, first + length)
        own[there] = {"zero": 0.0, "none": -9.99, "last": own[first]}[how]
        lost[there] = True
    return Record.from_samples(values, time_step=STEP), lost


@pytest.mark.raises_finding("stuck_sensor")
@pytest.mark.parametrize("length", [4, 12])
@pytest.mark.parametrize("name", ["x", "dx"])
@pytest.mark.parametrize("how", ["none", "last"])
def test_what_a_signal_shows_while_it_drops_out_is_named_and_left_out(how, name, length):
    for seed in range(3):
        record, lost = dropping(how, name, length, seed)
        found = [f for f in check_signals(record, record.arrays) if f.code == "stuck_sensor"]
        assert [f.signals for f in found] == [(name,)]
        assert "in 10 places" in found[0].message
        np.testing.assert_array_equal(leave_out(record, name).missing[name], lost)


@pytest.mark.no_finding("stuck_sensor")
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_motions_drop_nothing(noise):
    for seed in range(20):
        record = Record.from_samples(dict(signals(seed, noise)), time_step=STEP)
        assert check_signals(record, record.arrays) == []


@pytest.mark.no_finding("stuck_sensor")
def test_machines_that_rest_or_run_into_stops_do_not_drop_out():
    t = np.arange(4000) * STEP
    motion = np.sin(2 * t) + 0.3 * np.sin(5.1 * t)
    for values in (
        np.clip(motion, -0.8, 0.8),
        np.maximum(motion, 0.0),
        np.where(np.abs(motion) < 0.2, 0.0, motion - 0.2 * np.sign(motion)),
        np.round(motion, 2),
        np.sign(motion),
        np.round(20 * motion) / 20,
    ):
        record = Record.from_samples({"f": values, "x": motion}, time_step=STEP)
        assert "stuck_sensor" not in [f.code for f in check_signals(record, ["f"])]

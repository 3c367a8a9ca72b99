import numpy as np
import pytest

import riecjax as rx
from riecjax.records import check_signals

RATE = 200.0


def bouncing(noise: float, seed: int = 0) -> dict[str, np.ndarray]:
    """A mass that rests on a spring on a shaken table, and lifts off: nothing pulls it down."""
    rng = np.random.default_rng(seed)
    steps, count = 20, 6000
    t = np.arange(count * steps) / (RATE * steps)
    tones = rng.uniform(0.5, 6.0, 25)
    table = 0.004 * np.sum(np.sin(2 * np.pi * np.outer(tones, t) + rng.uniform(0, 6.3, (25, 1))), 0)
    x = v = 0.0
    kept = np.empty((3, t.size))
    for n in range(t.size):
        # Towards the table the spring pushes with up to any force, away from it with none.
        force = max(400.0 * (table[n] - x) - 4.0 * v, -9.81)
        kept[:, n] = x, v, force
        v += force / (RATE * steps)
        x += v / (RATE * steps)
    x, v, force = kept[:, ::steps]
    signals = {"x": x, "v": v, "table": table[::steps]}
    signals = {n: s + noise * s.std() * rng.normal(size=count) for n, s in signals.items()}
    return {**signals, "force": force}


def clips(signals: dict[str, np.ndarray], **more) -> list[str]:
    record = rx.Record.from_samples(signals, time_step=1 / RATE)
    found = check_signals(record, signals, **more)
    return [f.signals[0] for f in found if f.code == "clipped"]


@pytest.mark.no_finding("clipped")
@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_a_mass_that_lifts_off_is_a_real_limit(noise):
    signals = bouncing(noise)
    assert np.mean(signals["force"] == -9.81) > 0.01
    assert clips(signals) == []


@pytest.mark.raises_finding("clipped")
@pytest.mark.parametrize("share", [0.9, 0.6])
def test_a_sensor_at_the_end_of_its_range_beside_it_is_none(share):
    signals = bouncing(0.001)
    limit = share * np.max(signals["force"])
    signals["force"] = np.minimum(signals["force"], limit)
    assert "force" in clips(signals)
    assert "force" not in clips(signals, computed=("force",))


@pytest.mark.parametrize("share", [0.95, 0.9, 0.8])
def test_a_few_visits_are_enough_where_no_value_comes_twice(share):
    found = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        values = np.convolve(rng.normal(size=6060), np.hanning(61), "valid")
        values = values + 0.01 * values.std() * rng.normal(size=values.size)
        limit = share * np.max(np.abs(values))
        assert clips({"u": values}) == []
        found += "u" in clips({"u": np.clip(values, -limit, limit)})
    assert found >= 19

import numpy as np
import pytest
from tests.machines import noisy, waves

import riecjax as rx
from riecjax.records import check_signals, notch
from riecjax.records.preparation.steps import prepare
from riecjax.settings import Prepare

PAIRS = [("x", "v")]


def motion(count: int = 6000, rate: float = 200.0, noise: float = 0.01, seed: int = 0):
    """Position, velocity and force of a driven spring-mass of 2 Hz."""
    t = np.arange(count) / rate
    x, v, a = waves(t, seed, 1.0, (0.3, 12.0))
    return noisy({"x": x, "v": v, "u": a + 2.5 * v + 158 * x}, noise, seed), t


def hums(signals, rate: float = 200.0, pairs=PAIRS):
    record = rx.Record.from_samples(signals, time_step=1 / rate)
    found = check_signals(record, signals, pairs=pairs)
    return [f for f in found if f.code == "hum"]


def line(values, t, hertz, share):
    return values + share * np.std(values) * np.sin(2 * np.pi * hertz * t + 0.4)


@pytest.mark.raises_finding("hum")
@pytest.mark.parametrize("grid", [50.0, 60.0])
@pytest.mark.parametrize("name", ["x", "v", "u"])
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_hum_in_one_channel_is_named(noise, name, grid):
    signals, t = motion(noise=noise)
    signals[name] = line(signals[name], t, 1.002 * grid, 0.05)
    (one,) = hums(signals)
    assert one.signals == (name,)
    assert one.remedy == ("--notch", f"{grid:g}")
    assert one.doubt == pytest.approx(0.05**2 / 2, rel=0.25)


@pytest.mark.parametrize(
    ("rate", "count", "hertz", "grid"),
    [(400, 6000, 150, 50), (70, 4000, 50, 50), (400, 800, 50, 50), (90, 4000, 60, 60)],
)
def test_harmonics_folded_lines_and_short_records(rate, count, hertz, grid):
    signals, t = motion(count, rate)
    signals["u"] = line(signals["u"], t, hertz, 0.1)
    (one,) = hums(signals, rate)
    assert one.remedy == ("--notch", f"{grid:g}")
    assert ("seen at" in one.message) == (hertz > rate / 2)


def test_hum_in_all_channels_keeps_to_no_ratio_of_motion():
    signals, t = motion()
    signals = {name: line(values, t, 50.0, 0.05) for name, values in signals.items()}
    assert {f.signals[0] for f in hums(signals)} == {"x", "v", "u"}


@pytest.mark.no_finding("hum")
@pytest.mark.parametrize("seed", range(20))
def test_no_hum_in_clean_records(seed):
    noise = (0.0, 0.01, 0.05)[seed % 3]
    for count, rate in ((6000, 200.0), (200, 200.0), (4000, 33.4), (3000, 1000.0)):
        signals, _ = motion(count, rate, noise, seed)
        assert hums(signals, rate) == []


@pytest.mark.no_finding("hum")
def test_a_machine_that_turns_at_50_hz_does_not_hum():
    signals, t = motion(noise=0.001)
    omega = 2 * np.pi * 50
    signals["x"] = signals["x"] + 0.02 * signals["v"].std() / omega * np.sin(omega * t) * 5
    signals["v"] = signals["v"] + 0.02 * signals["v"].std() * np.cos(omega * t) * 5
    signals["u"] = line(signals["u"], t, 50.0, 0.1)
    assert hums(signals) == []


@pytest.mark.no_finding("hum")
def test_overtones_of_a_drive_and_tones_of_a_multisine_are_no_hum():
    t = np.arange(6000) / 200
    noise = 0.01 * np.random.default_rng(0).normal(size=(2, t.size))
    rectified = np.abs(np.sin(2 * np.pi * 5 * t))
    multisine = sum(np.sin(2 * np.pi * f * t + f**2) for f in np.arange(0.2, 60, 0.2))
    assert hums({"u": rectified + noise[0], "y": multisine + noise[1]}, pairs=[]) == []


# Taking it off.


@pytest.mark.parametrize(
    ("count", "asked"), [(400, 50.0), (1000, 50.0), (6000, 50.0), (1000, "auto"), (6000, "auto")]
)
def test_a_notch_takes_off_the_line_and_nothing_else(count, asked):
    clean, t = motion(count, 400.0, noise=0.0)
    hum = 0.2 * np.sin(2 * np.pi * 50.07 * t) + 0.05 * np.sin(2 * np.pi * 3 * 50.07 * t)
    u = clean["u"] + clean["u"].std() * hum
    record = rx.Record.from_samples({"u": u}, time_step=1 / 400)
    left = np.asarray(notch(record, asked)["u"]) - clean["u"]
    assert np.std(left) < 0.01 * clean["u"].std()


@pytest.mark.parametrize("hum", [0.0, 0.1])
def test_only_lines_that_stand_out_are_said_to_be_taken_off(hum):
    signals, t = motion()
    signals["u"] = line(signals["u"], t, 50.0, hum)
    record = rx.Record.from_samples(signals, time_step=1 / 200)
    _, words = prepare(record, {}, Prepare(notches=("auto",)))
    assert words == ["lines of the mains taken off"] * (hum > 0)


def test_a_notch_beside_a_gap_loses_nothing():
    clean, t = motion(noise=0.0)
    u = clean["u"] + clean["u"].std() * 0.2 * np.sin(2 * np.pi * 50 * t)
    u[2000:2300] = np.nan
    record = rx.Record.from_samples({"u": u}, time_step=1 / 200)
    notched = notch(record, 50.0)
    left = np.asarray(notched["u"]) - clean["u"]
    there = ~np.isnan(u)
    assert np.array_equal(np.asarray(notched.signal("u").present), there)
    assert np.std(left[there]) < 0.01 * clean["u"].std()


@pytest.mark.parametrize("hertz", [0.0, -50.0, np.nan, 200.0, 400.0])
def test_a_frequency_that_cannot_be_notched(hertz):
    signals, _ = motion()
    with pytest.raises(rx.DataError, match="Hz"):
        notch(rx.Record.from_samples(signals, time_step=1 / 200), hertz)

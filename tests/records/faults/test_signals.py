"""Faults found in the samples alone, and what machines do, which is none."""

import functools

import numpy as np
import pytest
import scipy.io
from tests.machines import Shape, simulated

import riecjax as rx
from conftest import measured_data
from riecjax.records.faults.signals import check_signals
from riecjax.records.record import Record

RATE = 1000.0
COUNT = 5000
TIME = np.arange(COUNT) / RATE
SEEDS = range(25)


def record(unit: str = "", **signals: np.ndarray) -> Record:
    units = dict.fromkeys(signals, unit) if unit else {}
    return Record.from_samples(signals, time_step=1 / RATE, units=units)


def codes(values: np.ndarray, **others: np.ndarray) -> set[str]:
    return {finding.code for finding in check_signals(record("", x=values, **others), ["x"])}


def message(record: Record, code: str, name: str = "x") -> str:
    found = [f.message for f in check_signals(record, [name]) if f.code == code]
    assert len(found) == 1, found
    return found[0]


def white(seed: int, count: int = COUNT) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=count)


def smooth(seed: int) -> np.ndarray:
    """Noise of some 20 Hz."""
    return np.convolve(white(seed, COUNT + 40), np.hanning(41), "valid")


def walk(seed: int) -> np.ndarray:
    return white(seed + 1000).cumsum()


def sine(hertz: float, phase: float = 0.3) -> np.ndarray:
    return np.sin(2 * np.pi * hertz * TIME + phase)


def frozen(values: np.ndarray, start: int = 1000, length: int = 250) -> np.ndarray:
    values = values.copy()
    values[start : start + length] = values[start]
    return values


# What must be found.


@pytest.mark.parametrize("seed", SEEDS)
def test_a_logger_that_repeats_one_row(seed):
    signals = {"x": frozen(smooth(seed)), "y": frozen(sine(3.1, seed) + 0.01 * white(seed))}
    said = message(record("", **signals), "stuck_sensor")
    assert "for 250 samples from 1 s on while the rest of the record stands as still" in said
    # A sensor that goes on while the other one is quiet speaks for rest, not for a fault.
    quiet = sine(3.1, seed)
    quiet[1000:1250] = quiet[1000] + 1e-6 * white(seed, 250)
    assert "stuck_sensor" not in codes(frozen(smooth(seed)), other=quiet)


@pytest.mark.raises_finding("missing_samples")
def test_missing_samples():
    values = white(0)
    values[[100, 101, 3000]] = np.nan
    said = message(record(x=values, y=white(1)), "missing_samples")
    assert said.startswith("x: 0.06 % of the samples (3 of 5000) are missing in 2 gaps, first")
    assert "first at 0.1 s" in said
    assert "longest unbroken stretch lasts 2.897 s" in said
    assert check_signals(record(x=values, y=white(1)), ["y"]) == []


@pytest.mark.raises_finding("quantised")
@pytest.mark.parametrize("offset", [0.0, np.pi, -1e3])
@pytest.mark.parametrize("quantum", [0.05, 0.1, 0.3])
def test_coarse_resolution(quantum, offset):
    values = quantum * np.round((smooth(0) / smooth(0).std()) / quantum) + offset
    said = message(record("mm", x=values), "quantised")
    steps = np.sqrt(np.mean(np.diff(values) ** 2)) / quantum
    assert f"its resolution of {quantum:.4g} mm is {100 * quantum / values.std():.3g} %" in said
    assert f"changes by {steps:.2g} such steps" in said


# What must not.

CLEAN = {
    "sine": lambda seed: sine(2 + seed / 7, seed),
    "sine of a whole number of samples": lambda _: sine(100.0, 0.0),
    "white noise": white,
    "smooth noise": smooth,
    "random walk": walk,
    "square wave": lambda seed: np.sign(sine(2 + seed / 7, seed)),
    "relay at every sample": lambda seed: np.sign(white(seed)),
    "steps": lambda seed: np.repeat(white(seed, 50), 100),
    "encoder": lambda seed: np.round(200 * sine(0.5 + seed / 5, seed)) / 200,
    "encoder of noise": lambda seed: np.round(40 * smooth(seed) / smooth(seed).std()) / 40,
    "friction": lambda seed: 2 * np.sign(sine(3.0, seed)) + sine(3.0, seed) + 0.02 * white(seed),
    "bumps": lambda seed: (
        sum(
            0.1 * np.exp(-(((TIME - at) / 0.004) ** 2))
            for at in np.random.default_rng(seed).uniform(0.1, 4.9, 6)
        )
        + 5e-4 * white(seed)
    ),
    "round potholes in an even road": lambda seed: (
        -0.05 * np.maximum(np.sin(2 * np.pi * (1 + 0.003 * seed) * TIME) - 0.9, 0.0)
    ),
    "axis that rests at both ends of its stroke": lambda seed: np.round(
        2000 * np.sin(0.5 * np.pi * np.clip(1.5 * sine(1.0 + seed / 9, seed), -1, 1))
    ),
    "impacts": lambda seed: (
        np.convolve(np.arange(COUNT) % 409 == seed, np.hanning(9), "same") + 1e-3 * white(seed)
    ),
    "pulses of a command": lambda seed: 1.0 * (np.arange(COUNT) % 97 == seed),
    "corners of friction": lambda seed: sine(1.3, seed) + 0.3 * np.sign(sine(1.3, seed + 1.57)),
    "force within stops": lambda seed: np.clip(1.3 * sine(1.3, seed), -1, 1) * sine(0.4, seed),
    "dead zone": lambda seed: (
        np.sign(sine(2.1, seed)) * np.maximum(np.abs(sine(2.1, seed)) - 0.2, 0)
    ),
    "axis at rest": lambda _: np.round(
        1e3 * np.cos(np.pi * np.clip(np.abs(TIME - 2.5) - 0.5, 0, 2) / 2)
    ),
}


@pytest.mark.no_finding("outliers", "stuck_sensor", "clipped", "copied_signal")
@pytest.mark.parametrize("kind", CLEAN)
def test_sound_signals_raise_no_alarm(kind):
    for seed in SEEDS:
        found = codes(CLEAN[kind](seed), other=walk(seed))
        assert found - {"quantised"} == set(), seed


def test_crests_of_a_slow_sine_with_rounded_digits_are_no_limit():
    assert codes(1.0 + 1e-12 * np.round(1e12 * sine(0.5)) + 1e-15 * white(0)) == set()


# Measured recordings, of which the folders' notes tell what is wrong with them.


def found_in(signals: dict[str, np.ndarray], step: float) -> set[tuple[str, str]]:
    record = Record.from_samples(signals, time_step=step)
    return {(", ".join(f.signals), f.code) for f in check_signals(record, signals)}


def file_of(name: str) -> list[tuple[dict[str, np.ndarray], float]]:
    """Recordings of a measured data set, with their time steps."""
    folder = measured_data(name)
    if name == "emps":
        data = scipy.io.loadmat(folder / "DATA_EMPS.mat")
        return [({n: data[n].ravel() for n in ("qm", "qg", "vir")}, 1e-3)]
    if name == "silverbox":
        files = [scipy.io.loadmat(folder / f"{n}.mat") for n in ("SNLS80mV", "Schroeder80mV")]
        return [({k: data[k].ravel() for k in ("V1", "V2")}, 2**14 / 1e7) for data in files]
    if name == "pendulum_single":
        data = scipy.io.loadmat(folder / "SinglePendulumDataForParameterEstimation.mat")
        pieces = (*data["Y_id"].ravel(), *data["Y_vad"].ravel())
        return [({"theta": piece[0], "dtheta": piece[1]}, 1e-3) for piece in pieces]
    if name == "quarter_drone":
        files = sorted(folder.glob("sinal*_malha_fechada.csv"))
        tables = [np.genfromtxt(file, delimiter=",", skip_header=1) for file in files]
        return [(dict(zip(("reference", "y", "u"), data.T[1:])), 0.01) for data in tables]
    files = [folder / f"data_simulation_4.{number}_MRdamper.mat" for number in (1, 2, 4)]
    return [(dict(zip("xvF", scipy.io.loadmat(file)["x_F"].T)), 0.01) for file in files]


MEASURED = {
    "emps": [set()],
    "silverbox": [set()] * 2,
    # The control of the third is held at its limit of -10 %.
    "quarter_drone": [set(), set(), {("u", "clipped")}, set()],
    # Its velocity is a difference of a coarse displacement.
    "mr_damper_labcontrol": [{("v", "quantised")}] * 3,
}


@pytest.mark.parametrize("name", [*MEASURED, "pendulum_single"])
def test_measured_recordings_show_what_their_notes_tell(name):
    findings = [found_in(*recording) for recording in file_of(name)]
    if name in MEASURED:
        assert findings == MEASURED[name]
    else:
        # Single angles are one count of the encoder off, 2 pi / 40960, 13 times their noise.
        assert all(codes <= {("theta", "outliers")} for codes in findings)


SLOW = 200.0


@functools.cache
def bouncing(noise: float, seed: int = 0) -> dict[str, np.ndarray]:
    """A mass that rests on a spring on a shaken table, and lifts off: nothing pulls it down."""
    rng = np.random.default_rng(seed)
    steps, count = 20, 6000
    t = np.arange(count * steps) / (SLOW * steps)
    tones = rng.uniform(0.5, 6.0, 25)
    table = 0.004 * np.sum(np.sin(2 * np.pi * np.outer(tones, t) + rng.uniform(0, 6.3, (25, 1))), 0)
    x = v = 0.0
    kept = np.empty((3, t.size))
    for n in range(t.size):
        # Towards the table the spring pushes with up to any force, away from it with none.
        force = max(400.0 * (table[n] - x) - 4.0 * v, -9.81)
        kept[:, n] = x, v, force
        v += force / (SLOW * steps)
        x += v / (SLOW * steps)
    x, v, force = kept[:, ::steps]
    signals = {"x": x, "v": v, "table": table[::steps]}
    signals = {n: s + noise * s.std() * rng.normal(size=count) for n, s in signals.items()}
    return {**signals, "force": force}


def clips(signals: dict[str, np.ndarray], **more) -> list[str]:
    record = rx.Record.from_samples(signals, time_step=1 / SLOW)
    found = check_signals(record, signals, **more)
    return [f.signals[0] for f in found if f.code == "clipped"]


@pytest.mark.no_finding("clipped")
@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_a_mass_that_lifts_off_is_a_real_limit(noise):
    signals = bouncing(noise)
    assert np.mean(signals["force"] == -9.81) > 0.01
    assert clips(signals) == []


@pytest.mark.no_finding("clipped")
@pytest.mark.parametrize("seed", [0, 1, 5])
def test_a_wheel_that_lifts_is_a_real_limit(seed):
    """Its tyre's force stays at the car's weight, and two of the balances break there."""
    record = simulated("quarter-car-source", seed, Shape(8000, 200))
    weight = np.max(record["F_t"])
    assert np.sum(record["F_t"] == weight) > 10
    names = ["F_t", "x1", "x2", "x3", "x4"]
    codes = [one.code for one in check_signals(record, names) if "F_t" in one.signals]
    assert "clipped" not in codes


@pytest.mark.raises_finding("clipped")
@pytest.mark.parametrize("share", [0.9, 0.6])
def test_a_sensor_at_the_end_of_its_range_beside_it_is_none(share):
    signals = bouncing(0.001)
    limit = share * np.max(signals["force"])
    signals = {**signals, "force": np.minimum(signals["force"], limit)}
    assert "force" in clips(signals)
    assert "force" not in clips(signals, computed=("force",))

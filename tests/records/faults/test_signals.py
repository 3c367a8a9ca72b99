import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
import scipy.io

from conftest import measured_data
from riecjax.errors import DataError
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


def clipped(values: np.ndarray, share: float = 0.8) -> np.ndarray:
    limit = share * np.max(np.abs(values))
    return np.clip(values, -limit, limit)


def frozen(values: np.ndarray, start: int = 1000, length: int = 250) -> np.ndarray:
    values = values.copy()
    values[start : start + length] = values[start]
    return values


def spiked(values: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed + 500)
    where = np.sort(rng.choice(np.arange(10, COUNT - 10, 7), 3, replace=False))
    values = values.copy()
    values[where] += 10 * values.std() * rng.choice([-1, 1], 3)
    return values, where


# What must be found.


@pytest.mark.raises_finding("clipped")
@pytest.mark.parametrize("share", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("hertz", [1.0, 3.7, 51.0])
def test_a_clipped_sine(hertz, share):
    assert "clipped" in codes(clipped(sine(hertz), share))


def test_clipped_by_a_converter_of_16_bits():
    counts = np.round(30_000 * sine(7.3) + 5 * white(0))
    assert "clipped" in codes(np.clip(counts, -24_000, 24_000))
    assert "clipped" not in codes(counts)


def test_most_clipped_noise():
    # White noise has few samples above 0.8 of its largest, now and then fewer than show.
    assert np.mean(["clipped" in codes(clipped(white(seed))) for seed in SEEDS]) > 0.8
    assert np.mean(["clipped" in codes(clipped(smooth(seed), 0.7)) for seed in SEEDS]) > 0.8


def test_clipped_on_one_side_says_where_how_much_and_what_to_do():
    values = np.minimum(sine(2.0, 0.0), 0.8)
    said = message(record("m/s", x=values), "clipped")
    share = 100 * np.mean(values == 0.8)
    first = TIME[np.argmax(values == 0.8)]
    assert said.startswith(f"x: sits at its maximum of 0.8 m/s in 10 place(s), {share:.3g} %")
    assert f"first at {first:.4g} s" in said
    assert "larger range" in said


@pytest.mark.raises_finding("stuck_sensor")
@pytest.mark.parametrize("seed", SEEDS)
def test_a_frozen_sensor(seed):
    for values in (white(seed), smooth(seed), walk(seed), sine(3.1, seed) + 0.01 * white(seed)):
        assert "stuck_sensor" in codes(frozen(values), other=smooth(seed + 1))
        assert "stuck_sensor" in codes(frozen(values))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_logger_that_repeats_one_row(seed):
    signals = {"x": frozen(smooth(seed)), "y": frozen(sine(3.1, seed) + 0.01 * white(seed))}
    said = message(record("", **signals), "stuck_sensor")
    assert "for 250 samples from 1 s on while the rest of the record stands as still" in said
    # A sensor that goes on while the other one is quiet speaks for rest, not for a fault.
    quiet = sine(3.1, seed)
    quiet[1000:1250] = quiet[1000] + 1e-6 * white(seed, 250)
    assert "stuck_sensor" not in codes(frozen(smooth(seed)), other=quiet)


def test_a_sensor_that_drops_to_zero():
    values = 5 + smooth(0) / np.ptp(smooth(0))
    values[2000:2300] = 0.0
    said = message(record("V", x=values), "stuck_sensor")
    assert "stays at exactly 0 V for 300 samples from 2 s on" in said
    assert "(300 samples in 1 place(s), 6 %)" in said


@pytest.mark.raises_finding("outliers")
@pytest.mark.parametrize("make", [white, smooth, walk, lambda seed: sine(3.0, seed)])
def test_three_spikes_of_ten_sigma(make):
    def found(seed: int) -> bool:
        values, _ = spiked(make(seed), seed)
        return "outliers" in codes(values)

    assert np.mean([found(seed) for seed in SEEDS]) > 0.9


@pytest.mark.parametrize("height", 10.0 ** np.arange(1, 13))
@pytest.mark.parametrize("make", [white, smooth, walk, lambda seed: sine(3.0, seed)])
def test_a_spike_of_any_height(make, height):
    values = make(0)
    values[2400] += height * np.std(values)
    assert "outliers" in codes(values)


def test_outliers_say_how_many_how_far_and_where():
    values, where = spiked(sine(3.0) + 0.01 * white(0))
    said = message(record("N", x=values), "outliers")
    assert said.startswith("x: 3 samples are spikes (0.06 %), up to 7.")
    assert f"at {', '.join(f'{t:.6g}' for t in TIME[where])} s" in said
    assert "repair_outliers" in said


@pytest.mark.raises_finding("missing_samples")
def test_missing_samples():
    values = white(0)
    values[[100, 101, 3000]] = np.nan
    said = message(record(x=values, y=white(1)), "missing_samples")
    assert said.startswith("x: 0.06 % of the samples (3 of 5000) are missing in 2 gaps, first")
    assert "first at 0.1 s" in said
    assert "longest unbroken stretch lasts 2.897 s" in said
    assert check_signals(record(x=values, y=white(1)), ["y"]) == []


def test_a_signal_of_which_nothing_is_left():
    part = record(x=np.where(TIME < 2, np.nan, white(0)), y=white(1)).part(0, 1000)
    assert "100 % of the samples" in message(part, "missing_samples")
    assert "longest unbroken stretch lasts 0 s" in message(part, "missing_samples")


def test_a_pause_is_a_gap():
    time = np.concatenate([TIME, 60 + TIME])
    paused = Record.from_samples({"x": np.tile(white(0), 2)}, time=time)
    said = message(paused, "missing_samples")
    assert "(55000 of 65000) are missing in 1 gap, first at 5 s" in said


@pytest.mark.no_finding("quantised")
@pytest.mark.parametrize("scale", [1e-200, 1e-160, 1e140])
def test_what_is_fine_is_fine_at_any_scale(scale):
    values = np.random.default_rng(0).standard_normal(3000).round(3)
    assert "quantised" not in codes(scale * values)


@pytest.mark.raises_finding("quantised")
@pytest.mark.parametrize("offset", [0.0, np.pi, -1e3])
@pytest.mark.parametrize("quantum", [0.05, 0.1, 0.3])
def test_coarse_resolution(quantum, offset):
    values = quantum * np.round((smooth(0) / smooth(0).std()) / quantum) + offset
    said = message(record("mm", x=values), "quantised")
    steps = np.sqrt(np.mean(np.diff(values) ** 2)) / quantum
    assert f"its resolution of {quantum:.4g} mm is {100 * quantum / values.std():.3g} %" in said
    assert f"changes by {steps:.2g} such steps" in said


def test_coarse_resolution_in_32_bit():
    values = np.float32(0.05) * np.round(20 * smooth(0) / smooth(0).std()).astype(np.float32)
    assert codes(values.astype(float)) == {"quantised"}


def test_a_constant_signal_is_only_that():
    assert check_signals(record("N", x=np.full(COUNT, -0.0)), ["x"])[0].message.startswith(
        "x: never varies from 0 N"
    )
    assert codes(np.full(COUNT, 3.0)) == {"constant_signal"}


# What must not.

CLEAN = {
    "sine": lambda seed: sine(2 + seed / 7, seed),
    "sine of a whole number of samples": lambda _: sine(100.0, 0.0),
    "multisine of many periods": lambda seed: np.tile(smooth(seed)[:500], 10),
    "white noise": white,
    "smooth noise": smooth,
    "random walk": walk,
    "square wave": lambda seed: np.sign(sine(2 + seed / 7, seed)),
    "square wave with noise": lambda seed: np.sign(sine(3.0)) + 0.01 * white(seed),
    "relay at every sample": lambda seed: np.sign(white(seed)),
    "relay with noise": lambda seed: np.sign(smooth(seed)) + 0.01 * white(seed),
    "steps": lambda seed: np.repeat(white(seed, 50), 100),
    "trapezoids": lambda seed: np.clip(np.cumsum(np.sign(sine(2.0, seed))) / 60, -0.5, 0.5),
    "encoder": lambda seed: np.round(200 * sine(0.5 + seed / 5, seed)) / 200,
    "fine encoder": lambda seed: np.round(2e5 * sine(0.5 + seed / 5, seed)),
    "encoder of noise": lambda seed: np.round(40 * smooth(seed) / smooth(seed).std()) / 40,
    "friction": lambda seed: 2 * np.sign(sine(3.0, seed)) + sine(3.0, seed) + 0.02 * white(seed),
    "bumps": lambda seed: (
        sum(
            0.1 * np.exp(-(((TIME - at) / 0.004) ** 2))
            for at in np.random.default_rng(seed).uniform(0.1, 4.9, 6)
        )
        + 5e-4 * white(seed)
    ),
    "potholes": lambda seed: (
        -0.05 * ((TIME + 0.01 * seed) % 0.7 < 0.03).astype(float) + 1e-3 * white(seed)
    ),
    "round potholes in an even road": lambda seed: (
        -0.05 * np.maximum(np.sin(2 * np.pi * (1 + 0.003 * seed) * TIME) - 0.9, 0.0)
    ),
    "axis that rests at both ends of its stroke": lambda seed: np.round(
        2000 * np.sin(0.5 * np.pi * np.clip(1.5 * sine(1.0 + seed / 9, seed), -1, 1))
    ),
    "axis at rest": lambda _: np.round(
        1e3 * np.cos(np.pi * np.clip(np.abs(TIME - 2.5) - 0.5, 0, 2) / 2)
    ),
    "axis at rest, unquantised": lambda _: np.cos(
        np.pi * np.clip(np.abs(TIME - 2.5) - 0.5, 0, 2) / 2
    ),
}


@pytest.mark.parametrize("kind", CLEAN)
def test_sound_signals_raise_no_alarm(kind):
    for seed in SEEDS:
        found = codes(CLEAN[kind](seed), other=walk(seed))
        assert found - {"quantised"} == set(), seed


def test_crests_of_a_slow_sine_with_rounded_digits_are_no_limit():
    assert codes(1.0 + 1e-12 * np.round(1e12 * sine(0.5)) + 1e-15 * white(0)) == set()


def test_heavy_tails_seldom_do():
    alarms = [codes(np.random.default_rng(seed).laplace(size=COUNT)) for seed in range(100)]
    assert sum(alarm != set() for alarm in alarms) <= 5


@pytest.mark.parametrize("kind", ["square wave", "relay at every sample", "steps", "fine encoder"])
def test_commands_and_fine_encoders_are_not_quantised(kind):
    assert "quantised" not in codes(CLEAN[kind](1))


@hypothesis.given(st.integers(0, 10**6), st.floats(0.3, 120.0), st.floats(1e-3, 1e3))
@hypothesis.settings(deadline=None, max_examples=40)
def test_units_and_offsets_do_not_matter(seed, hertz, scale):
    values, _ = spiked(clipped(sine(hertz, seed) + 0.05 * white(seed), 0.7), seed)
    assert codes(values) == codes(scale * values)


def test_too_few_samples_to_judge():
    assert codes(white(0, 49)) == set()
    assert codes(np.full(49, 2.0)) == {"constant_signal"}


def test_unknown_signal():
    with pytest.raises(DataError, match="no signal 'y'"):
        check_signals(record(x=white(0)), ["y"])


# Measured recordings, of which the folders' notes tell what is wrong with them.


def found_in(signals: dict[str, np.ndarray], step: float) -> set[tuple[str, str]]:
    record = Record.from_samples(signals, time_step=step)
    return {(", ".join(f.signals), f.code) for f in check_signals(record, signals)}


def test_emps_rests_and_reverses_without_an_alarm():
    data = scipy.io.loadmat(measured_data("emps") / "DATA_EMPS.mat")
    assert found_in({name: data[name].ravel() for name in ("qm", "qg", "vir")}, 1e-3) == set()
    assert found_in({"qm": data["qm"].ravel()}, 1e-3) == set()


@pytest.mark.parametrize("name", ["SNLS80mV", "Schroeder80mV"])
def test_silverbox(name):
    data = scipy.io.loadmat(measured_data("silverbox") / f"{name}.mat")
    assert found_in({k: data[k].ravel() for k in ("V1", "V2")}, 2**14 / 1e7) == set()


def test_pendulum():
    folder = measured_data("pendulum_single")
    data = scipy.io.loadmat(folder / "SinglePendulumDataForParameterEstimation.mat")
    for piece in (*data["Y_id"].ravel(), *data["Y_vad"].ravel()):
        # Single angles are one count of the encoder off, 2 pi / 40960, 13 times their noise.
        assert found_in({"theta": piece[0], "dtheta": piece[1]}, 1e-3) <= {("theta", "outliers")}
    small = scipy.io.loadmat(
        folder / "SingleDataFreeSwing_1_Dt_0_0001.mat", squeeze_me=True, struct_as_record=False
    )
    theta = np.asarray(small["Theta1"].signals.values, float).ravel()
    assert found_in({"theta": theta}, 1e-4) == {("theta", "quantised")}


@pytest.mark.parametrize("number", [1, 2, 4])
def test_damper_velocity_is_a_difference_of_a_coarse_displacement(number):
    file = f"data_simulation_4.{number}_MRdamper.mat"
    data = scipy.io.loadmat(measured_data("mr_damper_labcontrol") / file)["x_F"]
    assert found_in(dict(zip("xvF", data.T)), 0.01) == {("v", "quantised")}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        # The angle jumps by up to 1.3 degrees from one sample to the next, and the control kicks:
        # that is what it put out.
        ("sinal1_semi_estatica", set()),
        ("sinal2_degraus", set()),
        # The control is held at its limit of -10 %.
        ("sinal3_swept_sine", {("u", "clipped")}),
        ("sinal4_multiseno", set()),
    ],
)
def test_quarter_drone(name, expected):
    file = measured_data("quarter_drone") / f"{name}_malha_fechada.csv"
    data = np.genfromtxt(file, delimiter=",", skip_header=1)
    assert found_in(dict(zip(("reference", "y", "u"), data.T[1:])), 0.01) == expected

"""How large the noise of signals is: judged from samples, given, and computed from others."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.signal

import riecjax as rx
from nightly import nightly
from riecjax.records import judged, stack_records
from riecjax.records.noise_judgement import blackman_harris, judged_together
from riecjax.records.relations import Relation
from riecjax.records.signal import noise_level

STEP = 0.01
TIME = np.arange(2001) * STEP
SMOOTH = np.sin(2 * np.pi * 1.3 * TIME) + 0.5 * np.sin(2 * np.pi * 2.9 * TIME + 1)


def white(level, seed=0, size=TIME.size):
    return level * np.random.default_rng(seed).normal(size=size)


def std(record, name):
    return float(record.noise.std(name))


@pytest.mark.parametrize("share", [0.001, 0.01, 0.05, 0.2])
def test_white_noise_on_a_smooth_signal(share):
    level = share * SMOOTH.std()
    found = [
        std(judged(rx.Record({"x": SMOOTH + white(level, seed)}, STEP)), "x") for seed in range(60)
    ]
    noise = judged(rx.Record({"x": SMOOTH + white(level)}, STEP)).noise
    scatter = 1 / np.sqrt(2 * float(noise.freedom["x"]))
    # The mean of 60 lies within three of its standard errors, and they scatter as is stated.
    assert np.mean(found) == pytest.approx(level, rel=3 * scatter / np.sqrt(60) + 2e-3)
    assert np.std(found) / level == pytest.approx(scatter, rel=0.35)


@pytest.mark.parametrize("count", [700, *nightly([1000, 1500])])
def test_white_noise_is_always_found(count):
    """The last tenth of a short spectrum falls by chance; one in 400 was said to have no noise."""
    motion = SMOOTH[:count]
    for seed in range(400):
        found = std(judged(rx.Record({"x": motion + white(0.05, seed, count)}, STEP)), "x")
        assert 0.038 < found < 0.062


def test_a_floor_of_the_spectrum_sees_past_motion_that_differences_take_for_noise():
    quick = 0.1 * np.sin(2 * np.pi * 22.0 * TIME)
    record = rx.Record({"x": SMOOTH + quick + white(0.01)}, STEP)
    assert noise_level(np.asarray(record["x"])) > 0.012
    assert std(judged(record), "x") == pytest.approx(0.01, rel=0.08)


FILTER = scipy.signal.butter(4, 25.0, fs=1 / STEP, output="sos")


def low_passed(level, seed):
    size = 6000
    rough = scipy.signal.sosfilt(FILTER, np.random.default_rng(seed).normal(size=size + 500))
    motion = np.sin(2 * np.pi * 1.3 * STEP * np.arange(size))
    return motion, level * np.asarray(rough)[500:]


def test_noise_that_a_logger_low_passed():
    motion, noise = low_passed(0.02, 3)
    record = judged(rx.Record({"x": motion + noise, "u": motion}, STEP), "auto", "x")
    assert noise_level(motion + noise) < 0.3 * noise.std()
    impulse = np.asarray(scipy.signal.sosfilt(FILTER, np.eye(1, 400)[0]))
    kernel = np.asarray(record.noise.kernels["x"]["x"])
    for lag in range(8):
        truth = 0.02**2 * np.sum(impulse[lag:] * impulse[: impulse.size - lag])
        found = np.sum(kernel[lag:] * kernel[: kernel.size - lag])
        assert found == pytest.approx(truth, abs=0.08 * 0.02**2 * np.sum(impulse**2))


def test_what_other_signals_show_too_is_no_noise():
    motion, drive = low_passed(0.02, 3)
    answer = scipy.signal.lfilter([0.5, 0.2], [1.0], drive)
    record = judged(rx.Record({"x": motion + drive, "u": np.asarray(answer)}, STEP), "auto", "x")
    assert std(record, "x") < 0.3 * drive.std()


def test_quick_content_of_an_input_is_no_noise():
    drive = low_passed(1.0, 5)[1]
    assert noise_level(drive) > 0.1 * drive.std()
    assert std(judged(rx.Record({"u": drive}, STEP)), "u") < 1e-3 * drive.std()
    noisy = drive + 0.01 * np.random.default_rng(1).normal(size=drive.size)
    assert std(judged(rx.Record({"u": noisy}, STEP)), "u") == pytest.approx(0.01, rel=0.35)


def test_what_no_sensor_measured_has_no_noise():
    signals = {
        "command": np.sign(SMOOTH),
        "ramps": np.interp(TIME, [0, 5, 10, 20], [0, 1, -1, 3]),
        "nothing": 0 * TIME,
        "input": white(1.0),
        "steps": np.repeat(white(1.0, size=TIME.size // 10 + 1), 10)[: TIME.size],
    }
    noise = judged(rx.Record(signals, STEP)).noise
    assert {name: float(noise.std(name)) for name in signals} == dict.fromkeys(signals, 0.0)


def test_a_converter_rounds_by_its_quantum():
    quantum = 0.01
    record = judged(rx.Record({"x": quantum * np.round(SMOOTH / quantum)}, STEP))
    assert std(record, "x") == pytest.approx(quantum / np.sqrt(12), rel=0.1)


def test_no_difference_reaches_across_a_gap():
    values = SMOOTH + white(0.01)
    values[500:] += 30.0
    values[500:520] = np.nan
    values[::50] = np.nan
    record = judged(rx.Record.from_samples({"x": values}, time_step=STEP))
    assert std(record, "x") == pytest.approx(0.01, rel=0.1)
    traced = jax.jit(judged)(rx.Record.from_samples({"x": values}, time_step=STEP))
    assert std(traced, "x") == pytest.approx(0.01, rel=0.1)


def test_under_vmap_each_record_has_its_own():
    records = [rx.Record({"x": SMOOTH + white(level)}, STEP) for level in (0.01, 0.03)]
    batch = jax.vmap(judged)(stack_records(records))
    alone = [float(noise_level(np.asarray(record["x"]))) for record in records]
    np.testing.assert_allclose(jnp.squeeze(batch.noise.kernels["x"]["x"]), alone, rtol=1e-9)


def test_what_is_given_goes_before_what_is_judged():
    record = rx.Record({"x": SMOOTH + white(0.01), "v": SMOOTH + white(0.02, 1)}, STEP)
    some = judged(judged(record), {"x": 0.5})
    assert std(some, "x") == 0.5
    assert np.isinf(some.noise.freedom["x"])
    assert std(some, "v") == pytest.approx(0.02, rel=0.1)
    assert std(judged(record, {"x": 0}), "x") == 0
    for nothing in ("none", None):
        none = judged(record, nothing)
        assert none.noise.kernels == {"x": {}, "v": {}}


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        ({"y": 0.1}, rx.DataError, "no such signal; there are: x"),
        ({"x": -0.1}, rx.DataError, "a number from 0 on"),
        ({"x": np.nan}, rx.DataError, "a number from 0 on"),
        ("much", rx.ModelError, "'auto', 'none' or a standard deviation"),
        (3.0, rx.DataError, "standard deviation by signal"),
    ],
)
def test_impossible_noise(wrong, error, message):
    with pytest.raises(error, match=message):
        judged(rx.Record({"x": SMOOTH}, STEP), wrong)


@pytest.mark.parametrize(
    ("correlation", "says"),
    [
        ({("x", "v"): 1.5}, "between -1 and 1"),
        ({("x", "y"): 0.5}, "noise of 'y'"),
        ({("x", "x"): 0.5}, "of two signals; got 0.5"),
        ({("x", "v"): np.nan}, "one number"),
        ({("x", "v"): 0.5, ("v", "x"): -0.5}, "one number"),
    ],
)
def test_impossible_correlations(correlation, says):
    with pytest.raises(rx.DataError, match=says):
        rx.Noise.given({"x": 1.0, "v": 1.0}, correlation)


@pytest.fixture
def logged(tmp_path):
    file = tmp_path / "rig.csv"
    columns = np.stack([TIME, SMOOTH + white(0.02), 2 + SMOOTH + white(0.03, 1)], axis=1)
    np.savetxt(file, columns, delimiter=",", header="t,a,b", comments="")
    return file


def test_noise_of_formulas(logged):
    formulas = {"sum": "3*a - b", "square": "b**2", "centred": "a - mean(a)", "clock": "sin(t)"}
    noise = rx.read_recording(logged, derive=formulas, noise={"a": 0.02, "b": 0.03}).record.noise
    assert float(noise.std("sum")) == pytest.approx(np.hypot(0.06, 0.03))
    assert noise.kernels["sum"]["b"][0] == pytest.approx(-0.03)
    slope = 2 * np.sqrt(np.mean((2 + SMOOTH) ** 2))
    assert float(noise.std("square")) == pytest.approx(0.03 * slope, rel=0.01)
    assert float(noise.std("centred")) == pytest.approx(0.02, rel=0.01)
    assert noise.kernels["clock"] == {}
    # A column in whose place a formula of it stands has that column's noise, judged or given.
    centred = rx.read_recording(logged, derive={"a": "2*a - 1"}).record.noise
    assert float(centred.std("a")) == pytest.approx(0.04, rel=0.05)


def test_a_file_s_noise_is_that_of_its_samples(logged):
    read = rx.read_recording(
        logged, scale={"a": 10.0}, cutoffs={"a": 20.0}, derivatives={"v": "a"}, every=2
    ).record.noise
    assert read.sensors("v") == {"a"}
    given = rx.read_recording(
        logged, scale={"a": 10.0}, cutoffs={"a": 20.0}, derivatives={"v": "a"}, every=2,
        noise={"a": 0.2},
    ).record.noise  # fmt: skip
    assert float(read.std("v")) == pytest.approx(float(given.std("v")), rel=0.1)
    with pytest.raises(rx.DataError, match=r"rig\.csv: noise is given for 'v'.*noise of the other"):
        rx.read_recording(logged, derivatives={"v": "a"}, noise={"v": 0.2})


def test_noise_of_uneven_samples_that_are_resampled(tmp_path):
    file, rng = tmp_path / "uneven.csv", np.random.default_rng(5)
    time = TIME + 0.2 * STEP * rng.uniform(-1, 1, TIME.size)
    values = np.sin(2 * np.pi * 1.3 * time) + white(0.02)
    np.savetxt(file, np.stack([time, values], 1), delimiter=",", header="t,a", comments="")
    smooth = rx.read_recording(file, resample=200.0, noise={"a": 0.02}).record.noise
    found = rx.read_recording(file, resample=200.0).record.noise
    assert float(found.std("a")) == pytest.approx(float(smooth.std("a")), rel=0.1)
    assert 0.7 * 0.02 < float(smooth.std("a")) < 0.02


RATE, FINE = 200.0, 20


def broad_motion(seed=0, size=8000):
    """Position, velocity and acceleration under a random force of up to 70 Hz, at 200 Hz."""
    rough = np.random.default_rng(seed).normal(size=size * FINE)
    band = scipy.signal.butter(3, [0.5, 70.0], "bandpass", fs=RATE * FINE, output="sos")
    motion = {"a": np.asarray(scipy.signal.sosfiltfilt(band, rough))}
    for name, of in (("v", "a"), ("x", "v")):
        total = scipy.integrate.cumulative_simpson(motion[of], dx=1 / RATE / FINE, initial=0)
        motion[name] = total - np.mean(total)
    return {name: values[::FINE] for name, values in motion.items()}


def together(signals, pairs, share, given=()):
    """Judged standard deviations over the true ones, of each signal alone and by relations; and by
    how many of its standard errors the furthest of the second kind is off."""
    sizes, rng = {n: share * np.std(v) for n, v in signals.items()}, np.random.default_rng(7)
    noisy = {n: v + sizes[n] * rng.normal(size=v.size) for n, v in signals.items()}
    alone = judged(rx.Record(noisy, 1 / RATE), {name: sizes[name] for name in given})
    told = judged_together(alone, pairs, [*signals], given)
    found = [{n: std(one, n) / sizes[n] for n in signals} for one in (alone, told)]
    freedom = {n: float(told.noise.freedom.get(n, 0)) for n in signals if n not in given}
    return *found, max(abs(found[1][n] - 1) * np.sqrt(2 * freedom[n]) for n in freedom)


@pytest.mark.parametrize("share", [0.01, 0.05, 0.2])
def test_sensors_of_one_motion_tell_each_other_s_noise(share):
    motion, pairs = broad_motion(), [("x", "v"), ("v", "a")]
    alone, told, off = together(motion, pairs, share)
    assert abs(alone["a"] - 1) > 0.25
    assert off < 3
    assert told == pytest.approx(dict.fromkeys("xva", 1.0), abs=0.2)
    _, told, off = together(motion, pairs, share, ["v"])
    assert off < 3
    assert told["v"] == pytest.approx(1.0, rel=1e-12)


def test_a_position_and_its_acceleration_do_without_the_velocity():
    motion = broad_motion()
    signals = {name: motion[name] for name in "xa"}
    alone, _, off = together(signals, [("x", "v"), ("v", "a")], 0.05)
    assert alone["a"] > 2
    assert off < 3


def test_a_gain_and_a_delay_are_no_noise():
    motion = broad_motion(1, 8001)
    late = np.interp(np.arange(8000) + 0.7, np.arange(8001), motion["v"])
    signals = {"x": motion["x"][:8000], "v": 1.04 * late}
    told = together(signals, [("x", "v")], 0.03)[1]
    assert told == pytest.approx({"x": 1, "v": 1}, abs=0.15)


def test_of_a_sum_the_signals_share_what_they_have_together():
    wheel, body = broad_motion(2), broad_motion(3)
    signals = {"x": wheel["x"] - body["x"], "v": wheel["v"], "w": body["v"]}
    relation = Relation("x", (("v", 1.0), ("w", -1.0)))
    told = together(signals, [relation], 0.05)[1]
    assert told["x"] == pytest.approx(1.0, abs=0.1)
    share = np.std([signals["v"], signals["w"]], axis=1)
    both = np.linalg.norm([told["v"], told["w"]] * share) / np.linalg.norm(share)
    assert both == pytest.approx(1.0, abs=0.1)


def test_what_is_more_than_noise_tells_nothing():
    """An accelerometer on a part that swings by itself, and a velocity made of the position."""
    motion = broad_motion(4)
    swing = scipy.signal.butter(2, [8.0, 12.0], "bandpass", fs=RATE, output="sos")
    elsewhere = motion["a"] + 0.3 * np.asarray(scipy.signal.sosfilt(swing, motion["a"]))
    alone, told, _ = together({"v": motion["v"], "a": elsewhere}, [("v", "a")], 0.02)
    assert told == alone
    position = motion["x"] + white(0.02 * np.std(motion["x"]), 1, 8000)
    record = judged(rx.Record({"x": position, "v": np.gradient(position) * RATE}, 1 / RATE))
    assert std(judged_together(record, [("x", "v")], "xv"), "x") == std(record, "x")


@pytest.mark.parametrize("size", [7, 256, 1001])
def test_the_window_of_spectra_is_scipys(size):
    reference = scipy.signal.get_window("blackmanharris", size, fftbins=False)
    np.testing.assert_allclose(blackman_harris(size), reference, rtol=0, atol=1e-14)


def test_of_a_signal_that_is_hardly_there_noise_is_none_or_what_is_left():
    values = np.full(100_000, np.nan)
    values[:8] = np.sin(np.arange(8))
    assert float(noise_level(values)) >= 0


@pytest.mark.parametrize("size", [1e-200, 1e160])
def test_numbers_whose_squares_are_none_leave_noise_as_it_was(size):
    motion = broad_motion(0, 600)
    record = judged(rx.Record({n: size * motion[n] for n in "xva"}, 1 / RATE))
    told = judged_together(record, [("x", "v"), ("v", "a")], "xva")
    assert all(np.isfinite(std(told, name)) or np.isinf(std(record, name)) for name in "xva")


def test_a_copy_and_an_integral_of_a_noisy_signal_hide_no_noise():
    """What has its noise from another sensor tells nothing of it."""
    motion = broad_motion(5)
    size = 0.05 * np.std(motion["v"])
    v = motion["v"] + white(size, 3, 8000)
    x = scipy.integrate.cumulative_trapezoid(v, dx=1 / RATE, initial=0)
    x += 0.01 * np.std(motion["x"]) * white(1.0, 4, 8000)
    record = judged(rx.Record({"x": x, "v": v, "v_raw": v.copy()}, 1 / RATE))
    assert std(judged_together(record, [("x", "v")], "xv"), "v") == pytest.approx(size, rel=0.1)

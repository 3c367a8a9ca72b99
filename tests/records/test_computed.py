"""Velocities that no sensor measured, recognised in recordings by the filter that made them."""

import numpy as np
import pytest
import scipy.signal
from tests.machines import DRAG_TRUTH as TRUTH
from tests.machines import drag_signals as signals
from tests.machines import waves

import riecjax as rx
from riecjax.records.preparation.filtering import filter_between
from riecjax.records.signal import noise_level
from riecjax.summaries.summarise import ready

STEP = 0.01
# A Butterworth low-pass of second order at 0.3 of half the rate.
B, A = np.array([0.13110644, 0.26221288, 0.13110644]), np.array([1.0, -0.74778918, 0.27221494])
MADE = {
    "central": (3, lambda x: np.gradient(x, STEP)),
    "backward": (3, lambda x: np.diff(x, prepend=x[0]) / STEP),
    "polynomials": (21, lambda x: scipy.signal.savgol_filter(x, 21, 3, deriv=1, delta=STEP)),
    "low-pass": (21, lambda x: scipy.signal.lfilter(B, A, np.gradient(x, STEP))),
    "both ways": (21, lambda x: scipy.signal.filtfilt(B, A, np.gradient(x, STEP))),
    "four digits": (3, lambda x: np.round(np.gradient(x, STEP), 4)),
}


@pytest.mark.parametrize("noise", [0.0005, 0.01, 0.05])
@pytest.mark.parametrize("how", MADE)
def test_what_is_made_of_the_position_is_recognised(how, noise):
    most, make = MADE[how]
    for seed in range(5):
        x = signals(seed, noise)["x"]
        dx = make(x)
        taps = filter_between(x, dx, float(noise_level(x)))
        assert taps is not None
        assert taps.size <= most
        # Noise through it is what noise becomes.
        white = np.random.default_rng(seed).standard_normal(x.size)
        filtered = make(x + 1e3 * white) - make(x)
        rest = (1e3 * np.convolve(white, taps, "same") - filtered)[40:-40]
        assert np.std(rest) < 0.15 * np.std(filtered)


@pytest.mark.parametrize("noise", [0.0, 0.0005, 0.01, 0.05])
def test_what_a_sensor_measured_is_not(noise):
    for seed in range(50):
        both = signals(seed, noise)
        level = float(noise_level(both["x"]))
        assert filter_between(both["x"], both["dx"], level) is None
        # Nor what has noise of its own beside the position's.
        own = 0.3 * level / STEP * np.random.default_rng(900 + seed).standard_normal(2001)
        if noise:
            made = np.gradient(both["x"], STEP) + own
            assert filter_between(both["x"], made, level) is None


def test_motions_of_a_few_waves_are_not_made_of_each_other():
    for seed in range(50):
        x, _, dx = (waves(np.arange(400) / 200, seed + i, 1.0, (0.3, 9.5))[0] for i in range(3))
        assert filter_between(x, dx, float(noise_level(x))) is None


@pytest.mark.parametrize("noise", [0.0005, 0.01, 0.05])
def test_a_copy_of_the_position_is_no_derivative_of_it(noise):
    x = signals(0, noise)["x"]
    level = float(noise_level(x))
    smoothed = scipy.signal.savgol_filter(x, 21, 3)
    for copy in (x, -x, np.float32(2.5 * x).astype(float), smoothed):
        assert filter_between(x, np.asarray(copy), level) is None


def test_gaps_and_repaired_spikes_do_not_hide_it():
    x = signals(0, 0.01)["x"]
    dx = np.gradient(x, STEP)
    dx[[300, 700, 1500]] += 0.5
    x[1000:1010] = np.nan
    taps = filter_between(x, dx, float(noise_level(signals(0, 0.01)["x"])))
    assert taps is not None
    np.testing.assert_allclose(taps * 2 * STEP, [1, 0, -1], atol=0.01)


def recording(seed: int, noise: float) -> rx.Record:
    values = dict(signals(seed, noise))
    return rx.Record.from_samples({**values, "dx": np.gradient(values["x"], STEP)}, time_step=STEP)


@pytest.mark.parametrize("size", [1e200, 1e307])
@pytest.mark.filterwarnings("error")
def test_samples_that_no_square_holds_are_made_of_nothing(size):
    x = signals(0, 0.01)["x"]
    huge = size * np.random.default_rng(0).uniform(-1, 1, x.size)
    assert filter_between(x, huge, float(noise_level(x))) is None
    assert filter_between(huge, x, 1e-4 * size) is None


def test_slopes_of_local_polynomials_take_its_place():
    model = rx.find_model("drag-oscillator")
    (found,) = ready(model, recording(0, 0.01))
    assert found.steps[0].startswith("dx: computed from x, by a filter of 3 samples; in its place")
    assert found.record.noise.is_made_of("dx", "x")
    exact = signals()["dx"][(2001 - found.record.sample_count) // 2 :][: found.record.sample_count]
    errors = np.asarray(found.record["dx"]) - exact
    assert np.std(errors) < 0.3 * np.std(np.gradient(signals(0, 0.01)["x"], STEP) - signals()["dx"])
    # What is given of its noise stays.
    (kept,) = ready(model, recording(0, 0.01), {"dx": 0.1})
    assert not kept.steps
    assert not kept.record.noise.is_made_of("dx", "x")


@pytest.mark.slow
def test_estimates_are_right():
    model, errors = rx.find_model("drag-oscillator"), []
    for seed in range(20):
        found = rx.identify(model, recording(seed, 0.01))
        assert found.criterion.describe()["test_function"] == "bump"
        values = np.array([float(found[name]) for name in TRUTH])
        errors.append((values - list(TRUTH.values())) / np.asarray(found.standard_errors))
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    # Taken for a sensor's own, m would be off by 30 standard errors.
    assert (rms < 1.6).all()

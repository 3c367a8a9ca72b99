"""What models leave, against brute force, SciPy and closed forms, and what it is named."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
import scipy.stats

from nightly import nightly
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import AllWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.estimation.identify import identify
from riecjax.models.quarter_car.identification import quarter_car_by_body
from riecjax.models.quarter_car.reconstruction import quarter_car_source
from riecjax.paper.reproduction import identification_record
from riecjax.records.record import Record
from riecjax.simulation.inputs import band_limited_noise
from riecjax.uncertainty.intervals import Naive
from riecjax.validation.equation_errors import EquationError
from riecjax.validation.residuals import (
    error_spectrum,
    peaks,
    residual_tests,
    window_errors,
)

CRITERION = RIEC(AllWindows(0.05, 0.5))
fit = partial(identify, intervals=Naive())
"""No test here asks for intervals."""
STEP = 0.005


def series(error, explained=None, present=None, step=STEP) -> EquationError:
    error = jnp.asarray(error)
    return EquationError(
        error=error,
        explained=jnp.zeros_like(error) if explained is None else jnp.asarray(explained),
        present=jnp.ones(error.shape, bool) if present is None else jnp.asarray(present),
        time_step=jnp.asarray(step),
        span=1,
        name="force",
        unit="N",
        times=(jnp.arange(error.size) + 0.5) * step,
    )


def filtered(b, a, values) -> np.ndarray:
    return np.asarray(scipy.signal.lfilter(b, a, values))


def low_pass(order, hertz) -> tuple[np.ndarray, np.ndarray]:
    return scipy.signal.butter(order, 2 * hertz * STEP)  # pyright: ignore[reportReturnType]


# Spectra.


def test_spectrum_is_welchs_and_no_segment_reaches_over_a_gap():
    rng = np.random.default_rng(0)
    error, explained = rng.normal(size=(2, 8000))
    found = error_spectrum(series(error, explained))
    for name, values in {"error": error, "explained": explained}.items():
        frequency, density = scipy.signal.welch(values, 1 / STEP, nperseg=250)
        np.testing.assert_allclose(getattr(found, name), density, rtol=1e-6)
        np.testing.assert_allclose(found.frequency, frequency)
    _, common = scipy.signal.csd(error + explained, explained, 1 / STEP, nperseg=250)
    np.testing.assert_allclose(found.common, np.real(common), atol=1e-6 * np.max(np.abs(common)))

    there = np.ones(8000, bool)
    there[4000] = False
    error[4000] = 1e6
    broken = error_spectrum(series(error, explained, there))
    parts = [scipy.signal.welch(v, 1 / STEP, nperseg=249)[1] for v in (error[:4000], error[4001:])]
    np.testing.assert_allclose(broken.error, np.mean(parts, axis=0), rtol=0.02)


def test_peaks_and_their_half_heights_are_those_of_scipy():
    rng = np.random.default_rng(0)
    for count in range(5, 300, 7):
        density = np.exp(2 * np.convolve(rng.normal(size=count), np.ones(1 + count % 6), "same"))
        tops, _ = scipy.signal.find_peaks(np.log(density), prominence=np.log(4))
        whole = density[tops], 0 * tops, 0 * tops + count - 1
        _, _, *edges = scipy.signal.peak_widths(density, tops, prominence_data=whole)
        found = np.reshape(list(peaks(density, 4.0)), (-1, 3))
        np.testing.assert_allclose(found, np.stack([tops, *edges], axis=1), rtol=1e-9)


def test_a_resonance_is_a_peak_with_its_frequency_and_width():
    noise = np.random.default_rng(1).normal(size=40_000)
    frequency, zeta = 13.0, 0.06
    analogue = [1.0], [1.0, 2 * zeta * 82, 82.0**2]
    b, a = scipy.signal.bilinear(*analogue, 200)
    mode = filtered(b, a, noise)
    motion = filtered(*low_pass(4, 40), noise[::-1])
    found = error_spectrum(series(0.2 * mode / mode.std(), motion / motion.std())).peak()
    assert found is not None
    assert found.frequency == pytest.approx(frequency, abs=0.4)
    assert found.high - found.low == pytest.approx(2 * zeta * frequency, rel=0.25)
    assert 0.4 < found.share < 0.65
    assert found.size == pytest.approx(0.2 * np.sqrt(found.share), rel=0.1)


@pytest.mark.parametrize("differences", [0, 1, 2])
def test_differentiated_noise_is_no_peak_even_if_the_motion_stops_before_it(differences):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        motion = filtered(*low_pass(4, 12), rng.normal(size=3000))
        noise = np.diff(0.05 * rng.normal(size=3000 + differences), differences)
        low_passed = filtered(*low_pass(6, 60), noise)
        assert error_spectrum(series(noise, motion - noise)).peak() is None
        assert error_spectrum(series(low_passed, motion - low_passed)).peak() is None


# Eq. (18).


def test_window_errors_are_those_of_every_window_in_every_block():
    rng = np.random.default_rng(0)
    error, target = rng.normal(size=(2, 1230)) + 0.3
    windows = AllWindows(10 * STEP, 40 * STEP)
    found = window_errors([series(error, target - error)], windows)
    assert found is not None
    lags = np.unique(np.round(np.geomspace(10, 40, 4)).astype(int))
    blocks = []
    for begin in range(0, 1230 - 79, 80):
        rows = [
            (error[t : t + lag].sum() * STEP, target[t : t + lag].sum() * STEP)
            for lag in lags
            for t in range(begin, begin + 80 - lag + 1)
        ]
        blocks.append(np.array(rows).T)
    e = np.concatenate([block[0] for block in blocks])
    y = np.concatenate([block[1] for block in blocks])
    assert found.relative_rms == pytest.approx(np.sqrt(np.sum(e**2) / np.sum(y**2)))
    squares = [np.mean(block[0] ** 2) for block in blocks]
    parts = [squares[0:5], squares[5:10], squares[10:15]]
    between = 5 * np.var(np.mean(np.log(parts), axis=1), ddof=1)
    within = np.mean(np.var(np.log(parts), axis=1, ddof=1))
    assert found.p_value == pytest.approx(scipy.stats.f.sf(between / within, 2, 12))
    np.testing.assert_allclose(found.mean_square, [np.mean(p) / np.mean(e**2) for p in parts])
    np.testing.assert_allclose(found.start, np.array([0, 400, 800]) * STEP)


# Findings.


@pytest.mark.raises_finding("unmodelled_mode")
@pytest.mark.parametrize("seed", [0, *nightly([1])])
def test_the_engine_on_its_mount_shows_in_the_quarter_car(seed):
    record = identification_record(quarter_car_source(), jax.random.key(seed)).record
    record = record.select("F_t", "x1", "x2", "x3", "x4", "v_r")
    estimate = fit(quarter_car_by_body(), record, CRITERION)
    tests = residual_tests(quarter_car_by_body(), record, estimate)
    for name in ("masses", "body"):
        peak = tests[name].peak
        assert peak is not None
        # An inertia force peaks above the natural frequency, 13.2 Hz, of a mode so damped.
        assert 12.5 < peak.frequency < 17
        assert peak.low < 13.3 < peak.high
    assert tests["tyre"].peak is None
    codes = [(f.code, f.message.partition(":")[0]) for f in tests.findings()]
    assert ("unmodelled_mode", "masses") in codes
    assert all(name != "tyre" for _, name in codes)


@pytest.mark.raises_finding("uneven_errors")
def test_uneven_errors_are_named():
    rng = np.random.default_rng(0)
    n = 8000
    motion = np.asarray(band_limited_noise(jax.random.key(0), n, STEP, bandwidth=10.0, rms=1.0))
    loud = np.where((np.arange(n) > 3200) & (np.arange(n) < 4400), 1.0, 0.1)
    spring = Equation(Term("k", "x"), -Term(1.0, "F"), name="spring")
    record = Record({"x": motion, "F": 4 * motion + loud * rng.normal(size=n)}, STEP)
    tests = residual_tests(spring, record, fit(spring, record, CRITERION))
    (finding,) = [f for f in tests.findings() if f.code == "uneven_errors"]
    assert "from 16 to 22 s as in the quietest" in finding.message, finding.message

import numpy as np
import pytest
import scipy.signal

from riecjax.models.model import Model
from riecjax.models.preparation import Preparation, prepare
from riecjax.records.record import Record

RATE = 1000.0
TIME = np.arange(4000) / RATE
AXIS = Model("axis", "", derived={"dq": "q", "ddq": "dq"})


def record(**signals: np.ndarray) -> Record:
    return Record(signals, 1 / RATE)


def butterworth(cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    coefficients = scipy.signal.butter(4, cutoff, fs=RATE)
    assert coefficients is not None
    return np.asarray(coefficients[0]), np.asarray(coefficients[1])


def test_prepare_filters_then_differentiates_then_thins_out():
    rng = np.random.default_rng(2)
    q = np.sin(9 * TIME) + 1e-3 * rng.normal(size=4000)
    prepared = prepare(record(q=q), AXIS, Preparation({"q": 100.0}, 10))
    smooth = scipy.signal.filtfilt(*butterworth(100.0), q)[50:-50]
    velocity = np.gradient(smooth, 1 / RATE, edge_order=2)
    acceleration = np.gradient(velocity, 1 / RATE, edge_order=2)
    assert float(prepared.time_step) == pytest.approx(0.01, rel=1e-12)
    np.testing.assert_allclose(prepared["q"], smooth[::10], rtol=0, atol=1e-9)
    np.testing.assert_allclose(prepared["dq"], velocity[::10], rtol=0, atol=1e-7)
    # Each difference divides the filter's rounding of 1e-11 by the step of 1e-3.
    np.testing.assert_allclose(prepared["ddq"], acceleration[::10], rtol=0, atol=1e-5)


def test_prepare_keeps_a_recorded_derivative():
    recorded = np.cos(3 * TIME)
    prepared = prepare(record(q=TIME**3, dq=recorded), AXIS, Preparation({}))
    np.testing.assert_array_equal(prepared["dq"], recorded)
    np.testing.assert_allclose(
        prepared["ddq"], np.gradient(recorded, 1 / RATE, edge_order=2), atol=1e-9
    )


def test_steps_in_words():
    steps = Preparation({"q": 100.0}, 10).describe(AXIS)
    assert steps == [
        "q: zero-phase 4th-order Butterworth low-pass at 100 Hz",
        "dq: central differences of q, if not recorded",
        "ddq: central differences of dq, if not recorded",
        "every 10th sample",
    ]
    assert Preparation({}).describe(Model("none", "")) == []

"""A measured pendulum in four pieces, against published values."""

import jax
import numpy as np
import pytest
import scipy.io

import riecjax as rx
from conftest import measured_data
from nightly import nightly
from riecjax.models.oscillators import pendulum_equation

STEP = 1e-3


@pytest.fixture(scope="module")
def angles() -> list[np.ndarray]:
    file = measured_data("pendulum_single") / "SinglePendulumDataForParameterEstimation.mat"
    pieces = [piece[0] for piece in scipy.io.loadmat(file)["Y_id"].ravel()]
    assert [piece.size for piece in pieces] == [9167] * 4
    return pieces


@pytest.fixture(scope="module")
def records(angles) -> list[rx.Record]:
    return [rx.Record.from_samples({"theta": angle}, time_step=STEP) for angle in angles]


def from_the_angle(records, windows, test_function):
    criterion = rx.RIEC(windows, test_function)
    return rx.identify(pendulum_equation(), records, criterion, key=jax.random.key(0))


@pytest.mark.parametrize("test_function", [rx.Hat(4), *nightly([rx.Bump(6)])], ids=str)
def test_the_angle_alone_identifies_all_four_records_at_once(records, test_function):
    estimate = from_the_angle(records, rx.RandomWindows(0.1, 1.0, 8000), test_function)
    # Published: 64.22 1/s^2, from simulated trajectories.
    assert float(estimate["p1"]) == pytest.approx(64.22, rel=3e-3)
    # What central differences of the angle give; the authors' denoised velocity gives 0.013.
    assert float(estimate["p2"]) == pytest.approx(0.056, abs=0.002)


@pytest.mark.slow
def test_the_damping_differs_between_the_pieces_and_its_interval_admits_it(records):
    windows = rx.RandomWindows(0.1, 1.0, 8000)
    together = from_the_angle(records, windows, rx.Hat(4))
    alone = [float(from_the_angle([record], windows, rx.Hat(4))["p2"]) for record in records]
    assert np.ptp(alone) > 0.08 * np.mean(alone)
    low, high = together.interval("p2")
    assert (high - low) / 2 > 0.05 * float(together["p2"])
    assert all(low < value < high for value in alone)
    named = [f.message for f in together.findings() if f.code == "records_disagree"]
    assert any("agree on p2" in message for message in named)

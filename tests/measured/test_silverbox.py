"""Silverbox, a measured electronic Duffing oscillator, on the official split.

T. Wigren and J. Schoukens, "Three free data sets for development and benchmarking in nonlinear
system identification", European Control Conference 2013. Scores are simulation errors in mV; the
first 50 samples of each slice do not count.
"""

import jax
import numpy as np
import pytest
import scipy.io

from conftest import measured_data
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.test_functions import Hat
from riecjax.criteria.windows import RandomWindows
from riecjax.estimation.check import check
from riecjax.estimation.identify import identify
from riecjax.models.oscillators import duffing_equation, duffing_system
from riecjax.records.preparation import upsample
from riecjax.records.record import Record
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate

STEP = 2**14 / 1e7
TRAIN = (40650, 105712)
SLICES = {
    "arrow": (100, 40575, 0.63),
    "no extrapolation": (100, 32100, 0.44),
    "multisine": (105712, 127400, 0.44),
}
FACTOR = 8
WINDOWS = RandomWindows(0.006, 0.026, 20000)


@pytest.fixture(scope="module")
def record() -> Record:
    data = scipy.io.loadmat(measured_data("silverbox") / "SNLS80mV.mat")
    u, y = data["V1"].ravel(), data["V2"].ravel()
    return Record.from_samples({"u": u - u.mean(), "y": y - y.mean()}, time_step=STEP)


@pytest.fixture(scope="module")
def fine(record) -> Record:
    return upsample(record, FACTOR)


def estimate_from(train: Record, test_function, windows=WINDOWS):
    return identify(duffing_equation(), train, RIEC(windows, test_function), key=jax.random.key(0))


def score(estimate, fine: Record, first: int, last: int) -> float:
    """Simulation error in mV on the samples of a slice, its input band-limited between them."""
    lost = round(float(fine.start_time) / STEP)
    part = fine.part((first - lost) * FACTOR, (last - 1 - lost) * FACTOR + 1)
    y = np.asarray(part["y"])
    start = {"y": y[0], "dy": (y[1] - y[0]) / float(part.time_step)}
    system = duffing_system(dict(estimate.values))
    # One step between samples of the finer record is four or more per sample of the recorded one.
    run = simulate(system, part.select("u"), method=FixedStep(1), initial_state=start).checked()
    error = (np.asarray(run.record["y"]) - y)[::FACTOR]
    return 1e3 * float(np.sqrt(np.mean(error[50:] ** 2)))


@pytest.mark.parametrize("name", SLICES)
def test_the_integral_estimate_simulates_within_the_reference_scores(record, fine, name):
    estimate = estimate_from(upsample(record.part(*TRAIN), FACTOR), Hat(4))
    first, last, reference = SLICES[name]
    found = score(estimate, fine, first, last)
    assert 0.2 < found <= reference


def test_quadrature_of_high_order_does_without_more_samples(record, fine):
    estimate = estimate_from(record.part(*TRAIN), Hat(8))
    assert float(estimate["m"]) == pytest.approx(5.375e-6, rel=2e-3)
    first, last, reference = SLICES["arrow"]
    assert score(estimate, fine, first, last) <= reference


def test_trapezoids_on_the_raw_samples_bias_the_mass_and_the_check_says_so(record):
    train = record.part(*TRAIN)
    raw = estimate_from(train, Hat())
    assert -0.11 < float(raw["m"]) / 5.375e-6 - 1 < -0.07
    for test_function, expected in ((Hat(), True), (Hat(8), False)):
        criterion = RIEC(WINDOWS, test_function)
        found = check(duffing_equation(), train, criterion, key=jax.random.key(0))
        codes = [finding.code for finding in found.findings]
        assert ("coarse_sampling" in codes) is expected
        assert found.answerable

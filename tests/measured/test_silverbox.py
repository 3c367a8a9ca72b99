"""Silverbox, a measured electronic Duffing oscillator, on the official split.

T. Wigren and J. Schoukens, "Three free data sets for development and benchmarking in nonlinear
system identification", European Control Conference 2013. Scores are simulation errors in mV; the
first 50 samples of each slice do not count.
"""

import jax
import pytest
from benchmarks.measured.silverbox import (
    FACTOR,
    SLICES,
    TRAIN,
    WINDOWS,
    estimate_from,
    load_silverbox,
    score,
)

from conftest import measured_data
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.test_functions import Hat
from riecjax.estimation.check import check
from riecjax.models.oscillators import duffing_equation
from riecjax.records.preparation import upsample
from riecjax.records.record import Record

REFERENCE = {"arrow": 0.63, "no extrapolation": 0.44, "multisine": 0.44}
"""What this integral estimate scored where it was first tried, in mV."""


@pytest.fixture(scope="module")
def record() -> Record:
    return load_silverbox(measured_data("silverbox"))


@pytest.fixture(scope="module")
def fine(record) -> Record:
    return upsample(record, FACTOR)


@pytest.mark.slow
@pytest.mark.parametrize("name", REFERENCE)
def test_the_integral_estimate_simulates_within_the_reference_scores(record, fine, name):
    estimate = estimate_from(upsample(record.part(*TRAIN), FACTOR), Hat(4))
    assert 0.2 < score(estimate, fine, *SLICES[name]) <= REFERENCE[name]


@pytest.mark.slow
def test_trapezoids_on_the_raw_samples_bias_the_mass_and_the_check_says_so(record):
    train = record.part(*TRAIN)
    raw = estimate_from(train, Hat(2))
    assert -0.11 < float(raw["m"]) / 5.375e-6 - 1 < -0.07
    for test_function, expected in ((Hat(2), True), (Hat(8), False)):
        criterion = RIEC(WINDOWS, test_function)
        found = check(duffing_equation(), train, criterion, key=jax.random.key(0))
        codes = [finding.code for finding in found.findings]
        assert ("coarse_sampling" in codes) is expected
        assert found.answerable

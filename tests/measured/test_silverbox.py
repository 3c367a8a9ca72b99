"""Silverbox, a measured electronic Duffing oscillator, on the official split.

T. Wigren and J. Schoukens, "Three free data sets for development and benchmarking in nonlinear
system identification", European Control Conference 2013. Scores are simulation errors in mV; the
first 50 samples of each slice do not count.
"""

import pytest
from benchmarks.measured.silverbox import (
    FACTOR,
    SLICES,
    TRAIN,
    estimate_from,
    load_silverbox,
    score,
)

from conftest import measured_data
from riecjax.criteria.test_functions import Hat
from riecjax.records.preparation.resampling import upsample
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

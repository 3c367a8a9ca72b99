"""Intervals of hidden modes count that their window lengths were a choice."""

import dataclasses

import numpy as np
import pytest
from tests.machines import MODE_MODEL as MODEL
from tests.machines import MODE_TRUTH as TRUTH
from tests.machines import STANDARD
from tests.machines import body_with_mode as motion

import riecjax as rx
from nightly import nightly
from riecjax.estimation.mode_windows import find_modes

SPRUNG = MODEL.with_series_springs(rx.SeriesSpring("c"))


@pytest.fixture(scope="module")
def clean() -> rx.Record:
    return rx.Record(motion(True), STANDARD.step)


@pytest.mark.parametrize("model", [MODEL, *nightly([SPRUNG])], ids=["mode", "mode and spring"])
def test_the_choice_of_window_lengths_is_part_of_the_variance(clean, model):
    """Of the two lengths that tell most, each by itself."""
    found = rx.identify(model, clean, intervals=rx.Sandwich())
    assert found.summary is not None
    modes = [find_modes(model, found.summary, {}, rank=rank) for rank in (0, 1)]
    alone = [dataclasses.replace(found.summary, band=of.bands[0]) for of in modes]
    first, second = (rx.estimate(model, one, intervals=rx.Sandwich()) for one in alone)
    assert modes[0].bands != modes[1].bands
    known_as_well = np.minimum(np.diag(first.covariance) / np.diag(second.covariance), 1.0)
    apart = np.sqrt(known_as_well) * (np.asarray(second.theta) - np.asarray(first.theta))
    added = apart[:, None] * apart[None, :]
    np.testing.assert_allclose(found.theta, first.theta, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, first.covariance + added, rtol=1e-6)


def test_without_noise_intervals_hold_the_truth(clean):
    """Scatter alone is a tenth of what the integrals are off by."""
    found = rx.identify(MODEL, clean)
    for name, true in TRUTH.items():
        low, high = found.interval(name)
        assert low <= true <= high


@pytest.mark.slow
def test_a_spring_that_is_not_there_is_not_trusted(clean):
    verdict = rx.assess(SPRUNG, clean, intervals=rx.Sandwich()).verdict
    assert verdict.parameters["K_series"].level == "do not use"
    assert verdict.parameters["M_mode"].level == "good"

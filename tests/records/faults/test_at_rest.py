"""Rest of a velocity: found in what rests, not in what passes through zero."""

import numpy as np
import pytest
from tests.machines import JOINT_SENSORS, Shape, joint, joint_record

import riecjax as rx
from riecjax.records.faults.sampled_signal import rest_of
from riecjax.records.preparation.filtering import with_local_derivative


def rest(velocity: np.ndarray, noise: float = 0.0):
    record = rx.Record.from_samples({"v": velocity}, time_step=0.002)
    return rest_of(record.with_noise(rx.Noise.given({"v": noise})), "v")


def swinging(seed: int, count: int = 20000) -> np.ndarray:
    rng, t = np.random.default_rng(seed), 0.002 * np.arange(count)
    tones = rng.uniform(0.2, 3.0, 6)
    return np.sum([np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) / f for f in tones], axis=0)


@pytest.mark.parametrize("case", JOINT_SENSORS)
def test_a_joint_that_sticks_rests_as_long_as_it_does(case):
    motion = joint(3, Shape(10_001, 500))
    record = rx.records.judged(joint_record(motion, case, 3))
    if case == "encoder":
        record, _ = with_local_derivative(record, "q", "dq")
    found = rest_of(record, "dq")
    true = np.mean(motion["dq"] == 0)
    assert found is not None
    assert 0.7 * true < found.share < 1.3 * true
    assert found.width < 0.2


@pytest.mark.parametrize("share", [0.0, 0.01, 0.05])
def test_what_passes_through_zero_does_not_rest(share):
    for seed in range(40):
        moving = swinging(seed)
        size = share * moving.std()
        noisy = moving + size * np.random.default_rng(seed).normal(size=moving.size)
        assert rest(noisy, size) is None


def test_a_velocity_of_single_counts_rests_where_it_is_zero():
    """Slow motion and rests, by counts as large as what it changes by from sample to sample."""
    motion = joint(3, Shape(10_001, 500))["dq"]
    for counts in (1.0, 4.0, 8.0):
        count = counts * np.median(np.abs(np.diff(motion[motion != 0])))
        found = rest(count * np.round(motion / count))
        assert found is not None
        assert found.share == pytest.approx(np.mean(motion == 0), rel=0.4)
        for seed in range(10):
            assert rest(count * np.round(swinging(seed) / count)) is None


@pytest.mark.parametrize("values", [np.zeros(300), np.ones(300), np.r_[np.zeros(299), 1.0]])
def test_a_signal_that_never_moves_does_not_rest(values):
    assert rest(values) is None


def test_huge_values_short_records_and_gaps():
    moving = np.where(np.arange(400) % 100 < 40, 0.0, 1.0 + swinging(0, 400))
    whole = rest(moving)
    assert whole is not None
    huge = rest(1e300 * moving)
    assert huge is not None
    assert huge.share == whole.share
    assert huge.width == pytest.approx(1e300 * whole.width)
    gaps = rest(np.where(np.arange(400) % 100 < 20, np.nan, moving))
    assert gaps is not None
    assert 0.3 * whole.share < gaps.share < 0.7 * whole.share
    assert rest(moving[:200]) is not None

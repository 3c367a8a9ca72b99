import numpy as np
import pytest
from test_clipping import RATE, bouncing, clips

COUNT = 6000
TIME = np.arange(COUNT) / RATE


def motion(seed: int) -> np.ndarray:
    rng = np.random.default_rng([seed, 3])
    tones, phases = rng.uniform(0.2, 3.0, (30, 1)), rng.uniform(0, 2 * np.pi, (30, 1))
    values = np.sum(np.sin(2 * np.pi * tones * TIME + phases), axis=0)
    return values / np.std(values)


def noisy(values: np.ndarray, noise: float, seed: int = 0) -> np.ndarray:
    return values + noise * np.std(values) * np.random.default_rng([seed, 4]).normal(size=COUNT)


@pytest.mark.raises_finding("clipped")
@pytest.mark.parametrize("noise", [0.001, 0.01, 0.05])
@pytest.mark.parametrize(("share", "least"), [(0.7, 19), (0.8, 16)])
def test_an_amplifier_at_the_end_of_its_range_under_the_converters_noise(share, least, noise):
    found = 0
    for seed in range(20):
        values = motion(seed)
        limit = share * np.max(np.abs(values))
        found += "u" in clips({"u": noisy(np.clip(values, -limit, limit), noise, seed)})
    assert found >= least


@pytest.mark.no_finding("clipped")
@pytest.mark.parametrize("noise", [0.0001, 0.01, 0.05])
def test_crests_under_noise_are_no_limit(noise):
    assert not any(clips({"u": noisy(motion(seed), noise, seed)}) for seed in range(20))
    assert not clips({"u": noisy(np.sin(2 * np.pi * 0.7 * TIME), noise)})


@pytest.mark.no_finding("clipped")
@pytest.mark.parametrize("noise", [0.001, 0.01, 0.05])
def test_commands_and_rest_under_noise_are_no_limit(noise):
    trapezoids = np.clip(4 * np.abs(((TIME / 2) % 2) - 1) - 2, -1, 1)
    square = np.sign(np.sin(2 * np.pi * 0.4 * TIME))
    lagging = square * (1 - 2 * np.exp(-((0.4 * 2 * TIME) % 1) / 0.08))
    # Comes to rest, and leaves it, at a finite deceleration.
    swing = np.sin(2 * np.pi * 0.4 * TIME)
    resting = np.cumsum(np.sign(swing) * np.maximum(np.abs(swing) - 0.3, 0)) / RATE
    for values in (trapezoids, square, lagging, resting):
        assert clips({"u": noisy(values, noise)}) == []


@pytest.mark.no_finding("clipped")
def test_a_mass_that_lifts_off_under_noise_is_a_real_limit():
    signals = bouncing(0.001)
    signals["force"] = noisy(signals["force"], 0.01)
    assert clips(signals) == []


@pytest.mark.no_finding("clipped")
def test_a_single_crest_is_no_limit():
    # A crest that is flat for a while, as one of many is by chance.
    for seed in range(12):
        values, top = motion(seed), np.sort(motion(seed))[-25]
        crest = np.where(np.arange(COUNT) == np.argmax(values), 1.0, 0.0)
        near = np.convolve(crest, np.ones(60), "same") > 0
        values[near] = np.minimum(values[near], top)
        alone = np.where(near, values, np.minimum(values, 0.9 * top))
        assert not clips({"u": noisy(alone + 1e-3 * motion(seed + 50), 0.005, seed)})

"""Excitations against closed forms: spectra, exact r.m.s., and the geometry of the pot-hole."""

import jax
import numpy as np
import pytest

from riecjax.errors import ModelError
from riecjax.simulation.inputs import band_limited_noise, pothole, robson_road

STEP = 0.005


def noise(seed: int, count: int = 4000, bandwidth: float = 30.0, rms: float = 0.55) -> np.ndarray:
    key = jax.random.key(seed)
    return np.asarray(band_limited_noise(key, count, STEP, bandwidth=bandwidth, rms=rms))


@pytest.mark.parametrize("count", [4000, 4001, 257])
@pytest.mark.parametrize("bandwidth", [5.0, 30.0, 100.0])
def test_noise_has_exact_rms_no_mean_and_nothing_beyond_its_band(count, bandwidth):
    samples = noise(1, count, bandwidth, rms=0.7)
    assert samples.shape == (count,)
    np.testing.assert_allclose(np.sqrt(np.mean(samples**2)), 0.7, rtol=1e-12)
    np.testing.assert_allclose(np.mean(samples), 0.0, atol=1e-14)
    energy = np.abs(np.fft.rfft(samples)) ** 2
    frequency = np.fft.rfftfreq(count, STEP)
    assert np.sum(energy[frequency > bandwidth]) <= 1e-25 * np.sum(energy)
    assert np.all(energy[(frequency > 0) & (frequency <= bandwidth)] > 0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: band_limited_noise(jax.random.key(0), 3, STEP, bandwidth=30.0, rms=1.0),
        lambda: robson_road(jax.random.key(0), 3, STEP),
        lambda: pothole(3, STEP, depth=0.1, length=1.0, ramp=0.1),
    ],
)
def test_too_few_samples_are_refused(make):
    with pytest.raises(ModelError, match="at least 4"):
        make()


def robson_density(frequency, speed, roughness):
    """Of the velocity, one-sided, per Hz: (2 pi f)^2 k U^1.5 f^-2.5 / (2 pi)."""
    displacement = roughness * speed**1.5 * frequency**-2.5 / (2 * np.pi)
    return (2 * np.pi * frequency) ** 2 * displacement


@pytest.mark.parametrize(
    ("count", "settings"),
    [
        (1024, {}),
        (1025, {"speed": 30.0}),
        (1024, {"roughness": 1e-5, "bandwidth": 60.0}),
    ],
    ids=["paper", "faster", "smoother and wider"],
)
def test_robson_road_has_the_published_spectrum(count, settings):
    seeds = 400
    keys = jax.random.split(jax.random.key(0), seeds)
    roads = np.asarray(jax.vmap(lambda k: robson_road(k, count, STEP, **settings))(keys))
    # One-sided periodogram; the noise is periodic over the record, so nothing leaks.
    periodogram = np.mean(np.abs(np.fft.rfft(roads, axis=1)) ** 2, axis=0) * 2 * STEP / count
    frequency = np.fft.rfftfreq(count, STEP)
    inside = (frequency > 0) & (frequency <= settings.get("bandwidth", 30.0))
    expected = robson_density(
        frequency[inside], settings.get("speed", 20.0), settings.get("roughness", 3e-5)
    )
    ratio = periodogram[inside] / expected
    assert np.max(np.abs(ratio - 1)) < 5 / np.sqrt(seeds)
    assert abs(np.mean(ratio) - 1) < 5 / np.sqrt(seeds * ratio.size)
    assert np.sum(periodogram[~inside]) < 1e-25 * np.sum(periodogram)

    spacing = 1 / (count * STEP)
    mean_square = np.sum(expected) * spacing
    # Independent exponential components: the variance of the sum is the sum of the squares.
    scatter = spacing * np.sqrt(np.sum(expected**2) / seeds)
    assert abs(np.mean(roads**2) - mean_square) < 5 * scatter


HOLE = {"depth": 0.05, "length": 1.5, "ramp": 0.4, "speed": 20.0, "start": 0.1}


def displacement(step: float, **changes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, velocity and its trapezoidal integral."""
    velocity = np.asarray(pothole(round(0.5 / step), step, **{**HOLE, **changes}))
    time = step * np.arange(velocity.size)
    depth = np.concatenate([[0.0], np.cumsum(0.5 * step * (velocity[1:] + velocity[:-1]))])
    return time, velocity, depth


@pytest.mark.parametrize("step", [0.0033, 0.0005])
def test_pothole_goes_down_to_its_depth_and_returns_exactly(step):
    _, velocity, depth = displacement(step)
    np.testing.assert_allclose(depth[-1], 0.0, atol=1e-15)
    np.testing.assert_allclose(depth.max(), HOLE["depth"], rtol=1e-12)
    moving = velocity[velocity != 0]
    assert moving[0] > 0
    assert moving[-1] < 0


@pytest.mark.parametrize("changes", [{}, {"length": 2.0}, {"speed": 10.0}, {"ramp": 0.2}])
def test_length_lies_between_the_middles_of_the_ramps(changes):
    time, velocity, _ = displacement(0.0005, **changes)
    shape = {**HOLE, **changes}

    def middle(part: np.ndarray) -> float:
        return float(np.sum(time * part) / np.sum(part))

    crossing = middle(np.minimum(velocity, 0)) - middle(np.maximum(velocity, 0))
    np.testing.assert_allclose(crossing * shape["speed"], shape["length"], rtol=1e-9)

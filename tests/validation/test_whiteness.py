"""Ljung and Box's test against its distribution, gaps and short windows included."""

import numpy as np
import pytest
import scipy.stats

from riecjax.validation.whiteness import LAGS, innovations, ljung_box


def statistics(make, repeats=400, seed=0):
    rng = np.random.default_rng(seed)
    made = (make(rng) for _ in range(repeats))
    return np.array([ljung_box(np.where(there, values, np.nan)) for values, there in made])


def whole(rng, n=1500):
    return rng.standard_normal(n), np.ones(n, bool)


def with_gaps(rng, n=1500):
    present = np.ones(n, bool)
    for start in rng.integers(0, n - 60, 6):
        present[start : start + 60] = False
    return np.where(present, rng.standard_normal(n), 0.0), present


@pytest.mark.parametrize("make", [whole, with_gaps])
def test_white_noise_has_a_chi_square_statistic(make):
    found = statistics(make)
    assert scipy.stats.kstest(found, scipy.stats.chi2(LAGS).cdf).pvalue > 0.01


def test_the_statistic_is_its_textbook_sum():
    rng = np.random.default_rng(3)
    e = rng.standard_normal(300)
    c = e - e.mean()
    r = [np.sum(c[k:] * c[:-k]) / np.sum(c * c) for k in range(1, LAGS + 1)]
    expected = 300 * 302 * sum(value**2 / (300 - k) for k, value in enumerate(r, 1))
    assert ljung_box(e) == pytest.approx(expected, rel=1e-9)


def windows(rng, count=80, samples=25):
    """White noise less its projection on what initial position and velocity do in each window."""
    t = np.arange(samples) / samples
    slopes = np.stack([np.exp(2 * t), np.sinh(2 * t), t], axis=-1)
    slopes = np.broadcast_to(slopes[None, :, None, :], (count, samples, 1, 3)).copy()
    noise = rng.standard_normal((count, samples, 1))
    basis = np.linalg.qr(slopes[0, :, 0])[0]
    left = noise - np.einsum("ij,kj,wkc->wic", basis, basis, noise)
    return left, slopes, np.ones_like(left, bool)


def test_innovations_of_short_windows_are_white_where_their_residuals_are_not():
    def of_innovations(rng):
        found, kept = innovations(*windows(rng))
        return found.reshape(-1), kept.reshape(-1)

    def of_residuals(rng):
        left, _, present = windows(rng)
        return left.reshape(-1), present.reshape(-1)

    distribution = scipy.stats.chi2(LAGS)
    assert (
        scipy.stats.kstest(statistics(of_innovations, 300, seed=1), distribution.cdf).pvalue > 0.01
    )
    assert np.mean(statistics(of_residuals, 20)) > 1.5 * LAGS


def test_innovations_are_those_of_a_regression_on_all_that_came_before():
    left, slopes, present = windows(np.random.default_rng(7), count=2, samples=9)
    found, kept = innovations(left, slopes, present)
    assert kept[0, :, 0].tolist() == [False] * 3 + [True] * 6
    for i in range(3, 9):
        x, y = slopes[0, :i, 0], left[0, :i, 0]
        coefficients = np.linalg.lstsq(x, y)[0]
        h = slopes[0, i, 0]
        spread = np.sqrt(1 + h @ np.linalg.inv(x.T @ x) @ h)
        expected = (left[0, i, 0] - h @ coefficients) / spread
        assert found[0, i, 0] == pytest.approx(expected, rel=1e-4, abs=1e-6)

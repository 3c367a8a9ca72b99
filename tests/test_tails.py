"""Tails against `scipy.stats`."""

import numpy as np
import pytest
import scipy.stats

from riecjax import tails


@pytest.mark.parametrize("tail", [0.3, 0.025, 1e-4, 1e-9])
def test_quantiles_are_those_of_scipy_stats(tail):
    np.testing.assert_allclose(tails.normal(tail), scipy.stats.norm.isf(tail), rtol=1e-12)
    freedom = np.array([1.0, 2.5, 20.0, 1e9])
    expected = scipy.stats.t.isf(tail, freedom)
    np.testing.assert_allclose(tails.student(tail, freedom), expected, rtol=1e-9)
    expected = scipy.stats.chi2.isf(tail, 3)
    np.testing.assert_allclose(tails.chi_square(tail, 3), expected, rtol=1e-10)


def test_analysis_of_variance_is_that_of_scipy_stats():
    rng = np.random.default_rng(3)
    for shift in (0.0, 0.4, 2.0):
        groups = [rng.normal(shift * i, 1.0, 5 + i) for i in range(4)]
        expected = scipy.stats.f_oneway(*groups).pvalue
        np.testing.assert_allclose(tails.equal_means(groups), expected, rtol=1e-10)
    assert tails.equal_means([np.zeros(3), np.ones(3)]) == 0.0
    assert np.isnan(tails.equal_means([np.ones(3), np.ones(3)]))

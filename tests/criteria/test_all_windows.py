import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from riecjax.criteria.all_windows import Runs, moments_in_runs
from riecjax.criteria.windows import LagBins


def brute_force(phi, present, first, stop, shortest, weights, hat):
    """Every row of every window that is whole, one by one."""
    n = phi.shape[1]
    total, count = np.zeros((phi.shape[0],) * 2), 0.0
    for t in range(first, min(stop, n)):
        for lag, weight in enumerate(weights, shortest):
            end = t + (2 * lag if hat else lag)
            if end >= n or not present[t : end + 1].all():
                continue
            row = phi[:, end] - phi[:, t]
            if hat:
                row = phi[:, end] - 2 * phi[:, t + lag] + phi[:, t]
            total += weight * np.outer(row, row)
            count += weight
    return total, count


WEIGHTS = st.just(0.0) | st.floats(1e-3, 3)
"""Of lags; XLA takes numbers below the least normal one for zero."""


@given(
    n=st.sampled_from([5, 41]),
    seed=st.integers(0, 10**6),
    gaps=st.integers(0, 4),
    first=st.integers(0, 30),
    width=st.integers(1, 60),
    shortest=st.integers(1, 8),
    steps=st.lists(st.tuples(st.integers(0, 7), WEIGHTS), min_size=1, max_size=4),
    hat=st.booleans(),
)
def test_all_windows_are_the_sum_over_every_single_one(
    n, seed, gaps, first, width, shortest, steps, hat
):
    rng = np.random.default_rng(seed)
    phi = np.cumsum(rng.normal(size=(3, n)), axis=1)
    present = np.ones(n, bool)
    present[rng.integers(0, n, gaps)] = False
    stop = min(first + width, n)
    # Bins of lags that count alike, some of them empty.
    held, weight = (np.array(values) for values in zip(*steps))
    last = shortest + np.cumsum(held) - 1
    bins = LagBins(last - held + 1, last, weight)
    every = np.repeat(weight, held)
    expected, count = brute_force(phi, present, first, stop, shortest, every, hat)
    runs = Runs.of(present[None], first, stop - first)
    (found,), (number,) = moments_in_runs(phi[None], runs, bins, 2 if hat else 1)
    np.testing.assert_allclose(number, count, rtol=1e-12)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * max(np.abs(expected).max(), 1))

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from riecjax.criteria.all_windows import Primitives, moments_in_blocks
from riecjax.criteria.windows import LagBins, StartBlocks


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
    size=st.integers(1, 60),
    number=st.integers(1, 3),
    reach=st.sampled_from([80, 130]),
    shortest=st.integers(1, 8),
    steps=st.lists(st.tuples(st.integers(0, 7), WEIGHTS), min_size=1, max_size=4),
    hat=st.booleans(),
)
def test_all_windows_are_the_sum_over_every_single_one(
    n, seed, gaps, first, size, number, reach, shortest, steps, hat
):
    rng = np.random.default_rng(seed)
    phi = np.cumsum(rng.normal(size=(3, n)), axis=1)
    present = np.ones(n, bool)
    present[rng.integers(0, n, gaps)] = False
    # Bins of lags that count alike, some of them empty.
    held, weight = (np.array(values) for values in zip(*steps))
    last = shortest + np.cumsum(held) - 1
    bins = LagBins(last - held + 1, last, weight)
    every = np.repeat(weight, held)
    phi_of = Primitives(
        phi, np.zeros(3), np.zeros((3, n - 1)), present if gaps else None, 2 if hat else 1
    )
    blocks = StartBlocks(first, size, number)
    moments, numbers = moments_in_blocks(phi_of, bins, blocks, reach=reach)
    for block, (found, counted) in enumerate(zip(moments, numbers)):
        start = first + block * size
        expected, count = brute_force(phi, present, start, start + size, shortest, every, hat)
        np.testing.assert_allclose(counted, count, rtol=1e-12)
        scale = max(np.abs(expected).max(), 1)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * scale)

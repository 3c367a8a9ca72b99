import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from riecjax.criteria.all_windows import Primitives, moments_in_blocks
from riecjax.criteria.windows import LagBins, StartBlocks


def brute_force(phi, present, first, stop, lags, hat):
    """Every row of every window that is whole, one by one."""
    n = phi.shape[1]
    total, count = np.zeros((phi.shape[0],) * 2), 0
    for t in range(first, min(stop, n)):
        for lag in lags:
            end = t + (2 * lag if hat else lag)
            if end >= n or not present[t : end + 1].all():
                continue
            row = phi[:, end] - phi[:, t]
            if hat:
                row = phi[:, end] - 2 * phi[:, t + lag] + phi[:, t]
            total += np.outer(row, row)
            count += 1
    return total, count


@given(
    n=st.sampled_from([5, 41]),
    seed=st.integers(0, 10**6),
    gaps=st.integers(0, 4),
    first=st.integers(0, 30),
    size=st.integers(1, 60),
    number=st.integers(1, 3),
    reach=st.sampled_from([80, 130]),
    shortest=st.integers(1, 8),
    held=st.lists(st.integers(0, 7), min_size=1, max_size=4),
    hat=st.booleans(),
)
def test_all_windows_are_the_sum_over_every_single_one(
    n, seed, gaps, first, size, number, reach, shortest, held, hat
):
    rng = np.random.default_rng(seed)
    phi = np.cumsum(rng.normal(size=(3, n)), axis=1)
    present = np.ones(n, bool)
    present[rng.integers(0, n, gaps)] = False
    # Bins of lags, some of them empty.
    last = shortest + np.cumsum(held) - 1
    bins = LagBins(last - held + 1, last)
    lags = range(shortest, last[-1] + 1)
    phi_of = Primitives(
        phi, np.zeros(3), np.zeros((3, n)), present if gaps else None, 2 if hat else 1
    )
    blocks = StartBlocks(first, size, number)
    moments, numbers = moments_in_blocks(phi_of, bins, blocks, reach=reach)
    for block, (found, counted) in enumerate(zip(moments, numbers)):
        start = first + block * size
        expected, count = brute_force(phi, present, start, start + size, lags, hat)
        np.testing.assert_allclose(counted, count, rtol=1e-12)
        scale = max(np.abs(expected).max(), 1)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * scale)

import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from riecjax.criteria.all_windows import Starts, boxcar_moments, hat_moments


def brute_force(phi, present, first, stop, shortest, longest, hat):
    """Every row of every window that is whole, one by one."""
    n = phi.shape[1]
    total, count = np.zeros((phi.shape[0],) * 2), 0
    for t in range(first, min(stop, n)):
        for lag in range(shortest, longest + 1):
            end = t + (2 * lag if hat else lag)
            if end >= n or not present[t : end + 1].all():
                continue
            row = phi[:, end] - phi[:, t]
            if hat:
                row = phi[:, end] - 2 * phi[:, t + lag] + phi[:, t]
            total += np.outer(row, row)
            count += 1
    return total, count


@settings(deadline=None, max_examples=60)
@given(
    n=st.sampled_from([5, 41]),
    seed=st.integers(0, 10**6),
    gaps=st.integers(0, 4),
    first=st.integers(0, 30),
    width=st.integers(1, 60),
    shortest=st.integers(1, 8),
    more=st.integers(0, 20),
    hat=st.booleans(),
)
def test_all_windows_are_the_sum_over_every_single_one(
    n, seed, gaps, first, width, shortest, more, hat
):
    rng = np.random.default_rng(seed)
    phi = np.cumsum(rng.normal(size=(3, n)), axis=1)
    present = np.ones(n, bool)
    present[rng.integers(0, n, gaps)] = False
    stop, longest = min(first + width, n), shortest + more
    expected, count = brute_force(phi, present, first, stop, shortest, longest, hat)
    starts = Starts(*(jnp.asarray(v) for v in (first, stop, shortest, longest)))
    moments = hat_moments if hat else boxcar_moments
    found, number = moments(jnp.asarray(phi), jnp.asarray(present), starts)
    assert int(number) == count
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * max(np.abs(expected).max(), 1))

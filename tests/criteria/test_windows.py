import jax
import numpy as np
import pytest
import scipy.stats

import riecjax as rx

# Draws are fixed by their keys, so these levels are not a chance of failing: a correct sampler
# would have had to be unlucky to one in a thousand with this very key.
LEVEL = 1e-3


def rejection_sampler(count, alpha, beta, t_max, seed):
    """Eqs (14)-(15) as the paper has them: draw both, keep what ends within the record."""
    rng = np.random.default_rng(seed)
    length = rng.uniform(alpha, beta, 4 * count)
    start = rng.uniform(0, t_max, 4 * count)
    kept = start + length <= t_max
    return start[kept][:count], length[kept][:count]


def two_sample_p_value(drawn, expected) -> float:
    return float(np.asarray(scipy.stats.ks_2samp(drawn, expected))[1])


def draw(windows, sample_count, time_step, seed=0):
    found = windows.draw(jax.random.key(seed), rx.Record({"x": np.zeros(sample_count)}, time_step))
    return np.asarray(found.start), np.asarray(found.stop)


@pytest.mark.parametrize("between_samples", [False, True])
@pytest.mark.parametrize(
    ("alpha", "beta", "sample_count"), [(0.05, 0.5, 8000), (0.001, 0.02, 6), (0.01, 0.025, 6)]
)
def test_every_window_lies_within_the_record(alpha, beta, sample_count, between_samples):
    windows = rx.RandomWindows(alpha, beta, 20_000, between_samples=between_samples)
    start, stop = draw(windows, sample_count, 0.005)
    assert start.shape == stop.shape == (20_000,)
    assert start.min() >= 0
    assert stop.max() <= sample_count - 1
    length = stop - start
    if between_samples:
        assert length.min() >= alpha / 0.005 * (1 - 1e-12)
        assert length.max() <= beta / 0.005 * (1 + 1e-12)
    else:
        assert np.issubdtype(start.dtype, np.integer)
        assert length.min() == max(round(alpha / 0.005), 1)
        assert length.max() == round(beta / 0.005)


def test_on_samples_all_admissible_pairs_are_equally_likely():
    sample_count, shortest, longest, count = 12, 2, 6, 200_000
    start, stop = draw(rx.RandomWindows(shortest, longest, count), sample_count, 1.0)
    pairs = [
        (t, t + k) for k in range(shortest, longest + 1) for t in range(sample_count) if t + k < 12
    ]
    drawn = {pair: 0 for pair in pairs}
    for pair, times in zip(*np.unique(np.stack([start, stop], 1), axis=0, return_counts=True)):
        drawn[tuple(pair)] += times  # a pair that is not admissible is a KeyError
    assert scipy.stats.chisquare(list(drawn.values())).pvalue > LEVEL


@pytest.mark.parametrize("t_max", [0.6, 40.0])
@pytest.mark.parametrize("of", ["start", "length", "end"])
def test_between_samples_windows_follow_the_papers_rejection_sampler(of, t_max):
    alpha, beta, count, step = 0.05, 0.5, 50_000, 0.005
    windows = rx.RandomWindows(alpha, beta, count, between_samples=True)
    start, stop = draw(windows, round(t_max / step) + 1, step)
    drawn = {"start": start * step, "length": (stop - start) * step, "end": stop * step}[of]
    t0, T = rejection_sampler(count, alpha, beta, t_max, seed=1)
    assert t0.size == count
    rejected = {"start": t0, "length": T, "end": t0 + T}[of]
    assert two_sample_p_value(drawn, rejected) > LEVEL


def test_pairs_stay_equally_likely_on_ten_minutes_at_ten_kilohertz():
    # 2.7e10 admissible pairs, more than 32-bit integers count.
    sample_count, step = 6_000_000, 1e-4
    start, stop = draw(rx.RandomWindows(0.05, 0.5, 20_000), sample_count, step)
    # beta is so short beside the record that length and start are uniform to 1e-3.
    lengths = scipy.stats.uniform(500 - 0.5, 4501)
    assert scipy.stats.kstest(stop - start, lengths.cdf).pvalue > LEVEL
    assert scipy.stats.kstest(start, scipy.stats.uniform(0, sample_count).cdf).pvalue > LEVEL

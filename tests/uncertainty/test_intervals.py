"""Intervals against Monte Carlo and against their formulas, written plainly."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from riecjax.criteria.criterion import Rows
from riecjax.estimation.stages import solve_stages
from riecjax.summaries.normal_equations import (
    NormalEquations,
    ShortBlocks,
    blocks_in_use,
)
from riecjax.uncertainty.covariances import (
    BlockStatistics,
    block_statistics,
    drawn_counts,
    effective_freedom,
    jackknife_covariance,
    naive_covariance,
    politis_white,
    sandwich_covariance,
    studentized_replicates,
    uniform_draws,
)
from riecjax.uncertainty.intervals import BlockBootstrap

# Regressors and errors are first-order autoregressions, as overlapping windows make them: least
# squares' own standard errors are far too small for such data.
ROWS, SHORT, BLOCKS = 2000, 200, 40
SECONDS = 0.1
SETTING = ShortBlocks(np.array([SHORT]), jnp.array([SECONDS]), jnp.asarray(SECONDS))


def autoregression(key, rho, shape=()):
    """Unit-variance process of ROWS samples along the last axis."""
    noise = jax.random.normal(key, (*shape, ROWS)) * jnp.sqrt(1 - rho**2)
    first = noise[..., 0] / jnp.sqrt(1 - rho**2)

    def step(x, e):
        return rho * x + e, rho * x + e

    _, rest = jax.lax.scan(step, first, jnp.moveaxis(noise[..., 1:], -1, 0))
    return jnp.concatenate([first[..., None], jnp.moveaxis(rest, 0, -1)], axis=-1)


def short_blocks(columns, names) -> NormalEquations:
    rows = Rows(columns, jnp.arange(ROWS), names)
    made = NormalEquations.of_rows(
        rows, block_of_row=jnp.arange(ROWS) * SHORT // ROWS, block_count=SHORT
    )
    return NormalEquations(made.moments[None], made.count[None], names)


def statistics_of(fine, blocks=BLOCKS, short=SETTING) -> BlockStatistics:
    _, values = solve_stages([stage.flattened() for stage in fine], {})
    found = block_statistics(fine, {}, values, short)
    length, used = jnp.asarray(SECONDS * SHORT / blocks), jnp.array([blocks])
    return found._replace(length=length, used=used)


TRUTH = jnp.array([2.0, -300.0])
UNITS = jnp.array([1.0, 1e-3])


def one_stage(key):
    keys = jax.random.split(key)
    x = autoregression(keys[0], 0.8, (2,))
    # Correlated regressors of unlike sizes.
    regressors = jnp.stack([x[0], 0.6 * x[0] + 0.8 * x[1]]) * UNITS[:, None]
    y = TRUTH @ regressors + autoregression(keys[1], 0.9)
    return [short_blocks(jnp.stack([y, *regressors]), ("a", "b"))]


def two_stages(key):
    keys = jax.random.split(key, 3)
    x, w, v = autoregression(keys[0], 0.8, (3,))
    first = 2.0 * x + autoregression(keys[1], 0.9)
    # The second stage's own errors are small: b is uncertain because a, found before, is.
    second = 2.0 * w + 5.0 * (v + 0.7 * w) + 0.1 * autoregression(keys[2], 0.9)
    return [
        short_blocks(jnp.stack([first, x]), ("a",)),
        short_blocks(jnp.stack([second, w, v + 0.7 * w]), ("a", "b")),
    ]


COVARIANCES = {"jackknife": jackknife_covariance, "sandwich": sandwich_covariance}


@pytest.mark.slow
@pytest.mark.parametrize("experiment", [one_stage, two_stages])
def test_covariances_agree_with_monte_carlo_and_the_naive_one_does_not(experiment):
    def intervals_of(key):
        statistics = statistics_of(experiment(key))
        found = {name: covariance(statistics) for name, covariance in COVARIANCES.items()}
        return statistics.estimate, found, naive_covariance(statistics)

    theta, found, naive = jax.jit(jax.vmap(intervals_of))(jax.random.split(jax.random.key(0), 1000))
    actual = np.cov(np.asarray(theta).T)
    for covariance in found.values():
        predicted = np.asarray(covariance).mean(0)
        # The actual variance is itself known to sqrt(2 / 1000) = 4.5 % (one sigma), and blocks of
        # 50 rows lose a few percent of the correlation at their borders.
        np.testing.assert_allclose(np.diag(predicted), np.diag(actual), rtol=0.15)
        correlation, expected = (c[0, 1] / np.sqrt(c[0, 0] * c[1, 1]) for c in (predicted, actual))
        assert correlation == pytest.approx(expected, abs=0.1)
        errors = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        reach = scipy.stats.t.ppf(0.975, BLOCKS - 1)
        truth = np.asarray(TRUTH) if experiment is one_stage else np.array([2.0, 5.0])
        coverage = (np.abs(np.asarray(theta) - truth) < reach * errors).mean(0)
        assert (coverage > 0.92).all()
        assert (coverage < 0.975).all()
    assert np.asarray(naive).mean(0)[-1, -1] < 0.4 * actual[-1, -1]


@pytest.mark.slow
def test_bootstrap_intervals_cover_and_lean_to_the_side_of_a_skewed_estimate():
    def experiment(key):
        # The error's size is skewed: a few rows carry most of what misleads.
        keys = jax.random.split(key)
        x = jnp.abs(autoregression(keys[0], 0.5))
        rare = jnp.maximum(autoregression(keys[1], 0.5) - 2.0, 0.0)
        return [short_blocks(jnp.stack([x * (3.0 + 10 * rare), x]), ("k",))]

    def intervals_of(key):
        statistics = statistics_of(experiment(key), blocks=20)
        uncertainty = BlockBootstrap(replicates=400).uncertainty(statistics)
        return statistics.values["k"], uncertainty

    k, uncertainty = jax.jit(jax.vmap(intervals_of))(jax.random.split(jax.random.key(1), 300))
    error = np.sqrt(uncertainty.covariance[:, 0, 0])
    off = np.asarray(k) - float(jnp.mean(k))
    below, above = (side[:, 0] for side in uncertainty.reach(0.95))
    inside = (off <= below * error) & (-off <= above * error)
    student = np.abs(off) < scipy.stats.t.isf(0.025, 19) * error
    # Rare large values: too low an estimate goes with too small an error, so it must reach up.
    assert np.mean(above > below) > 0.95
    assert 0.92 < np.mean(inside) < 0.975
    assert np.mean(inside) > np.mean(student)


def regression(seed, short, used):
    """60 rows of least squares, in so many short blocks."""
    rng = np.random.default_rng(seed)
    a, y = rng.normal(size=(60, 2)), rng.normal(size=60)
    block = np.arange(60) * short // 60
    rows = Rows(jnp.array(np.stack([y, *a.T])), jnp.arange(60), ("a", "b"))
    made = NormalEquations.of_rows(rows, block_of_row=jnp.array(block), block_count=short)
    fine = [NormalEquations(made.moments[None], made.count[None], ("a", "b"))]
    setting = ShortBlocks(np.array([short]), jnp.array([SECONDS * SHORT / short]), SECONDS)
    return a, y, block, statistics_of(fine, used, setting)


def test_the_jackknife_is_the_refit_without_each_block():
    a, y, block, statistics = regression(0, 10, 10)
    theta = np.linalg.lstsq(a, y)[0]
    left = np.stack([np.linalg.lstsq(a[block != i], y[block != i])[0] for i in range(10)])
    expected = 0.9 * (left - theta).T @ (left - theta)
    np.testing.assert_allclose(jackknife_covariance(statistics), expected, rtol=1e-9)
    residual = y - a @ theta
    naive = residual @ residual / 58 * np.linalg.inv(a.T @ a)
    np.testing.assert_allclose(naive_covariance(statistics), naive, rtol=1e-9)


def test_the_sandwich_weighs_lags_as_newey_and_west_do():
    a, y, _, statistics = regression(1, 60, 12)
    scores = a * (y - a @ np.linalg.lstsq(a, y)[0])[:, None]
    meat = scores.T @ scores
    for k in range(1, 5):
        product = scores[:-k].T @ scores[k:]
        meat += (1 - k / 5) * (product + product.T)
    bread = np.linalg.inv(a.T @ a)
    expected = 12 / 11 * bread @ meat @ bread
    np.testing.assert_allclose(sandwich_covariance(statistics), expected, rtol=1e-9)


def test_replicates_are_refits_of_drawn_blocks_divided_by_their_sandwich():
    fine = jax.jit(two_stages)(jax.random.key(5))
    statistics = statistics_of(fine, 20)
    draws = jnp.asarray(uniform_draws(7, 3, 1))
    found = studentized_replicates(statistics, draws)
    middle = np.asarray(statistics.estimate)
    for one, t in zip(draws, found):
        drawn = np.asarray(drawn_counts(one[None], statistics.used)).astype(float)[0, 0]
        assert drawn.sum() == 20
        assert not drawn[20:].any()
        first, second = (
            np.asarray(stage.merged(statistics.short, statistics.used).moments) for stage in fine
        )
        totals = [np.einsum("b,bij->ij", drawn, m) for m in (first, second)]
        a = totals[0][1, 0] / totals[0][1, 1]
        b = (totals[1][2, 0] - totals[1][2, 1] * a) / totals[1][2, 2]
        scores = np.stack(
            [first[:, 1, 0] - first[:, 1, 1] * a, second[:, 2, 0] - second[:, 2, 1:] @ [a, b]], 1
        )
        slope = np.array([[totals[0][1, 1], 0], totals[1][2, 1:]])
        moved = np.linalg.solve(slope, scores.T).T
        error = np.sqrt(drawn @ moved**2)
        np.testing.assert_allclose(t, (np.array([a, b]) - middle) / error, rtol=1e-8)


def test_blocks_are_never_of_two_records_and_hold_everything():
    counts = np.arange(2 * 50).reshape(2, 50) + 1.0
    counts[1, 30:] = 0
    moments = jnp.array(counts)[:, :, None, None] * jnp.ones((1, 1, 2, 2))
    fine = NormalEquations(moments, jnp.array(counts), ("a",))
    short = ShortBlocks(np.array([50, 30]), jnp.array([0.1, 0.1]))
    used = blocks_in_use(short, jnp.asarray(1.0))
    np.testing.assert_array_equal(used, [5, 3])
    merged = np.asarray(fine.merged(short, used).count).reshape(2, 5)
    np.testing.assert_allclose(merged[0, :5], counts[0].reshape(5, 10).sum(1))
    np.testing.assert_allclose(merged[1, :3], counts[1, :30].reshape(3, 10).sum(1))
    assert not merged[1, 3:].any()


def plain_politis_white(x):
    """The published rule, line by line, for one series (constant for separate blocks)."""
    n = x.size
    silent = max(5, int(np.ceil(np.sqrt(np.log10(n)))))
    most = int(np.ceil(np.sqrt(n))) + silent
    r = np.array([x[: n - k] @ x[k:] for k in range(most + 1)])
    loud = np.abs(r / r[0]) >= 2 * np.sqrt(np.log10(n) / n)
    m = next(
        (k for k in range(most - silent + 1) if not loud[k + 1 : k + silent + 1].any()),
        np.flatnonzero(loud).max(),
    )
    reach = 2 * max(m, 1)
    k = np.arange(1, most + 1)
    taper = np.clip(2 * (1 - k / reach), 0, 1)
    g = 2 * np.sum(taper * k * r[1:])
    g0 = r[0] + 2 * np.sum(taper * r[1:])
    return abs(g / g0) ** (2 / 3) * n ** (1 / 3)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_the_block_length_rule_is_the_published_one(rho):
    series = np.asarray(autoregression(jax.random.key(11), rho))
    short = ShortBlocks(np.array([ROWS]), jnp.array([0.01]))
    found = politis_white(jnp.array(series)[None, :, None], short)
    np.testing.assert_allclose(found, [0.01 * plain_politis_white(series)], rtol=1e-6)


def test_a_variance_that_hangs_on_few_blocks_has_few_degrees_of_freedom():
    fine = jax.jit(one_stage)(jax.random.key(2))
    statistics = statistics_of(fine, 20)

    def freedom(influence):
        # Each block's in one of its short blocks.
        spread = np.zeros((1, SHORT, influence.shape[1]))
        spread[:, :: SHORT // 20] = influence
        return effective_freedom(statistics._replace(short_influence=jnp.array(spread)))

    rng = np.random.default_rng(0)
    many = np.mean([freedom(rng.normal(size=(20, 2))) for _ in range(200)])
    assert 14 < many <= 19  # 19 less what the clip takes of the scatter
    rare = np.zeros((20, 2))
    rare[3] = [1.0, -2.0]
    np.testing.assert_allclose(freedom(rare), [2.0, 2.0])
    rare[11] = [1.0, 2.0]
    np.testing.assert_allclose(freedom(rare), [5.0, 5.0])
    np.testing.assert_allclose(freedom(np.zeros((20, 2))), [19.0, 19.0])

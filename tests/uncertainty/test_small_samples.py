"""Intervals where few blocks of time tell of a parameter, and where recordings disagree."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from nightly import nightly
from riecjax.criteria.criterion import Rows
from riecjax.summaries.normal_equations import NormalEquations, ShortBlocks
from riecjax.uncertainty.covariances import (
    OVERLAP,
    block_statistics,
    few_blocks_sandwich,
    record_inflation,
)

STEP = 0.05
SAMPLES = 512
TRUTH = {"m": 2.0, "c": 2.0, "k": 180.0}
FORCE = rx.Equation(
    rx.Term(1.0, "F"),
    -rx.Term("m", "v", derivative=1),
    -rx.Term("c", "v"),
    -rx.Term("k", "x"),
    name="force",
)
SHORT_WINDOWS = rx.RIEC(rx.AllWindows(0.2, 3.1, longest_samples=64))
# 0.1 to 2 Hz: two longest windows fill nearly half of the record's 25.6 s.
LONG_WINDOWS = rx.RIEC(rx.AllWindows(0.25, 5.0, longest_samples=128))
COUNT = 60


def motion(kind, samples=SAMPLES):
    """Position, velocity and force of an oscillator, in closed form."""
    t = np.arange(samples) * STEP
    m, c, k = TRUTH.values()
    if kind == "step":
        since = np.maximum(t - 0.5 - STEP / 2, 0)
        on = since > 0
        decay = c / (2 * m)
        rate = np.sqrt(k / m - decay**2)
        x = 1 - np.exp(-decay * since) * (
            np.cos(rate * since) + decay / rate * np.sin(rate * since)
        )
        v = np.exp(-decay * since) * k / m / rate * np.sin(rate * since)
        return {"x": x, "v": v, "F": k * on}
    waves = ((1.0, 0.9, 0.2), (0.6, 3.1, 1.0), (0.4, 7.3, 2.0))
    x = sum(a * np.sin(w * t + p) for a, w, p in waves)
    v = sum(a * w * np.cos(w * t + p) for a, w, p in waves)
    a = sum(-a * w**2 * np.sin(w * t + p) for a, w, p in waves)
    return {"x": x, "v": v, "F": m * a + c * v + k * x}


def identified_often(kind, criterion):
    """Estimates less truth, and how far intervals reach, over seeds."""
    signals = {name: jnp.asarray(column) for name, column in motion(kind).items()}
    # What rounding and the quadrature shift is no scatter.
    exact = np.asarray(rx.identify(FORCE, rx.Record(signals, STEP), criterion).theta)
    size = 0.1 * jnp.std(signals["F"])

    def one(key):
        force = signals["F"] + size * jax.random.normal(key, (SAMPLES,))
        estimate = rx.identify(FORCE, rx.Record({**signals, "F": force}, STEP), criterion)
        return estimate.theta, estimate.uncertainty, estimate.block_count

    theta, uncertainty, blocks = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), COUNT))
    below, above = uncertainty.reach(0.95)
    errors = np.sqrt(np.diagonal(uncertainty.covariance, axis1=1, axis2=2))
    return np.asarray(theta) - exact, below * errors, above * errors, int(blocks[0]), uncertainty


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "criterion", "blocks", "held", "typical", "longest"),
    [("step", SHORT_WINDOWS, 4, 0.88, 3, 8), ("waves", LONG_WINDOWS, 2, 0.85, 2, 1e3)],
)
def test_a_short_record_has_intervals_that_hold_the_truth_and_are_of_use(
    kind, criterion, blocks, held, typical, longest
):
    off, below, above, found, uncertainty = identified_often(kind, criterion)
    assert found == blocks
    assert np.asarray(uncertainty.few_blocks).all()
    inside = (off <= below) & (-off <= above)
    # The share of 60 seeds is itself known to 3 % for each parameter.
    assert (inside.mean(0) > held).all()
    assert inside.mean() > held + 0.04
    # Student's t with one degree of freedom would reach 12.7 standard errors to either side.
    reach = (below + above) / (12.7 * off.std(0))
    assert (np.median(reach, axis=0) < typical).all()
    assert (np.max(reach, axis=0) < longest).all()


def blocks_of(rows, count, names):
    """Normal equations of so many short blocks, and the rows' Gram matrices, plainly."""
    y, a = rows
    of = np.arange(y.size) * count // y.size
    made = NormalEquations.of_rows(
        Rows(jnp.array(np.stack([y, *a.T])), jnp.arange(y.size), names),
        block_of_row=jnp.array(of),
        block_count=count,
    )
    return NormalEquations(made.moments[None], made.count[None], names), [
        a[of == i].T @ a[of == i] for i in range(count)
    ]


def bursts(rng, size=60):
    """A regression whose second regressor acts in one part of the record."""
    a = np.stack([np.ones(size), np.exp(-np.arange(size) / 8)], axis=1)
    return a @ [1.0, 3.0] + 0.1 * rng.normal(size=size), a


@pytest.mark.parametrize("used", [3, *nightly([6])])
def test_expectation_and_freedom_are_those_of_the_quadratic_form_written_out(used):
    rng = np.random.default_rng(0)
    y, a = bursts(rng)
    fine, grams = blocks_of((y, a), 6, ("a", "b"))
    theta = np.linalg.lstsq(a, y)[0]
    values = {"a": jnp.asarray(theta[0]), "b": jnp.asarray(theta[1])}
    short = ShortBlocks(np.array([6]), jnp.array([1.0]), 1.0)
    statistics = block_statistics([fine], {}, values, short)
    covariance, degrees, shares = few_blocks_sandwich(statistics._replace(used=jnp.array([used])))
    beside = np.eye(6, k=1) + np.eye(6, k=-1) if used == 3 else np.zeros((6, 6))
    n, p = 6, 2
    scores_covariance = np.zeros((n, p, n, p))
    for i in range(n):
        for j in range(n):
            factor = 1.0 * (i == j) + OVERLAP * beside[i, j]
            scores_covariance[i, :, j] = factor * (grams[i] + grams[j]) / 2
    scores_covariance = scores_covariance.reshape(n * p, n * p)
    inverse = np.linalg.inv(sum(grams))
    # Residual scores from scores: what the estimate takes with it.
    leaves = np.eye(n * p) - np.kron(np.ones((1, n)), np.vstack([g @ inverse for g in grams]))
    weights = np.eye(n) + beside / 2
    block = np.arange(60) * n // 60
    scored = np.stack([a[block == i].T @ (y - a @ theta)[block == i] for i in range(n)])
    for j in range(p):
        form = leaves.T @ np.kron(weights, np.outer(inverse[j], inverse[j])) @ leaves
        product = form @ scores_covariance
        ones = np.kron(np.ones((n, 1)), inverse[j][:, None])
        should = float((ones.T @ scores_covariance @ ones)[0, 0])
        seen = np.trace(product) / should
        assert float(shares[j]) == pytest.approx(seen, rel=1e-9)
        freedom = np.trace(product) ** 2 / np.trace(product @ product)
        assert float(degrees[j]) == pytest.approx(max(freedom, 1.0), rel=1e-9)
        influence = scored @ inverse[j]
        plain = influence @ weights @ influence / seen
        # A thousandth is what other parameters tell.
        assert float(covariance[j, j]) == pytest.approx(plain, rel=0.05)
    assert float(shares[1]) < 0.5 * float(shares[0])


@pytest.mark.raises_finding("few_blocks")
def test_few_blocks_are_named_and_say_what_stands_in():
    signals = motion("step")
    error = 0.1 * signals["F"].std() * np.random.default_rng(0).normal(size=SAMPLES)
    record = rx.Record.from_samples({**signals, "F": signals["F"] + error}, time_step=STEP)
    estimate = rx.identify(FORCE, record, SHORT_WINDOWS)
    finding = next(f for f in estimate.findings() if f.code == "few_blocks")
    assert all(f"{name} (" in finding.message for name in TRUTH)
    assert estimate.uncertainty.label == "small-sample sandwich with Student's t"
    assert "small-sample sandwich with Student's t, 4 blocks" in str(estimate)


SPRING = rx.Equation(rx.Term("k", "x"), -rx.Term(1.0, "f"))


def records(stiffness, seed, noise=0.5, count=2000):
    rng = np.random.default_rng(seed)
    made = []
    for k in stiffness:
        x = rng.normal(size=count)
        f = k * x + noise * rng.normal(size=count)
        made.append(rx.Record.from_samples({"x": x, "f": f}, time_step=0.01))
    return made


@pytest.mark.slow
def test_alike_recordings_are_left_alone_but_for_one_in_a_hundred():
    factors = []
    for seed in range(150):
        estimate = rx.identify(SPRING, records([3.0] * 4, seed), rx.DOLS(), intervals=rx.Sandwich())
        factors.append(float(estimate.inflation[0]))
    assert np.mean(np.array(factors) > 1) < 0.05


@pytest.mark.slow
def test_recordings_of_different_machines_widen_the_interval_until_it_holds_their_mean():
    rng = np.random.default_rng(0)
    inside = inflated = 0
    for seed in range(60):
        measured = records(3 + 0.3 * rng.normal(size=5), seed)
        estimate = rx.identify(SPRING, measured, rx.DOLS(), intervals=rx.Sandwich())
        low, high = estimate.interval("k")
        inside += low < 3.0 < high
        inflated += float(estimate.inflation[0]) > 1
    assert inflated >= 57
    assert inside >= 0.85 * 60


@pytest.mark.raises_finding("records_disagree")
def test_disagreement_is_named_in_words():
    estimate = rx.identify(SPRING, records([2.5, 3.0, 3.5], 0), rx.DOLS())
    (finding,) = [f for f in estimate.findings() if f.code == "records_disagree"]
    assert "do not agree on k" in finding.message
    alike = rx.identify(SPRING, records([3.0] * 3, 1), rx.DOLS())
    assert "records_disagree" not in [f.code for f in alike.findings()]


def test_one_record_has_nothing_to_disagree_with():
    influence = jax.random.normal(jax.random.key(0), (1, 10, 2))
    np.testing.assert_array_equal(record_inflation(influence, jnp.array([10])), [1, 1])


def test_the_widened_error_is_the_scatter_between_records_with_students_t():
    """Two records with blocks of no scatter of their own, by hand."""
    tiny = 1e-3 * np.array([1.0, -1.0])
    influence = np.stack([1.0 + tiny, -1.0 + tiny])[:, :, None]
    factor = float(record_inflation(jnp.asarray(influence), jnp.array([2, 2]))[0])
    # Sums of +2 and -2: variance 2/1 (4 + 4) = 16; pooled over blocks 4; t of one freedom 12.706.
    assert factor == pytest.approx(12.7062 / 1.95996 * np.sqrt(16 / 4), rel=1e-5)

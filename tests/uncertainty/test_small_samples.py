"""Intervals where few blocks of time tell of a parameter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from nightly import nightly
from riecjax.criteria.criterion import RIEC, Rows
from riecjax.criteria.windows import AllWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term, constant
from riecjax.estimation.identify import identify
from riecjax.records.record import Record
from riecjax.summaries.normal_equations import NormalEquations, ShortBlocks
from riecjax.uncertainty.block_statistics import unknowns_of
from riecjax.uncertainty.covariances import OVERLAP, few_blocks_sandwich

STEP = 0.05
SAMPLES = 512
TRUTH = {"m": 2.0, "c": 2.0, "k": 180.0}
FORCE = Equation(
    Term(1.0, "F"), -Term("m", "v", derivative=1), -Term("c", "v"), -Term("k", "x"), name="force"
)
SHORT_WINDOWS = RIEC(AllWindows(0.2, 3.1, longest_samples=64))
# 0.1 to 2 Hz: two longest windows fill nearly half of the record's 25.6 s.
LONG_WINDOWS = RIEC(AllWindows(0.25, 5.0, longest_samples=128))
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


def noisy(kind, seed, noise=0.1):
    signals = motion(kind)
    error = noise * signals["F"].std() * np.random.default_rng(seed).normal(size=SAMPLES)
    return Record.from_samples({**signals, "F": signals["F"] + error}, time_step=STEP)


def identified_often(kind, criterion):
    """Estimates less truth, and how far intervals reach, over seeds."""
    signals = {name: jnp.asarray(column) for name, column in motion(kind).items()}
    # What rounding and the quadrature shift is no scatter.
    exact = np.asarray(identify(FORCE, Record(signals, STEP), criterion).theta)
    size = 0.1 * jnp.std(signals["F"])

    def one(key):
        force = signals["F"] + size * jax.random.normal(key, (SAMPLES,))
        estimate = identify(FORCE, Record({**signals, "F": force}, STEP), criterion)
        return estimate.theta, estimate.uncertainty, estimate.block_count

    theta, uncertainty, blocks = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), COUNT))
    below, above = uncertainty.reach(0.95)
    errors = np.sqrt(np.diagonal(uncertainty.covariance, axis1=1, axis2=2))
    return np.asarray(theta) - exact, below * errors, above * errors, int(blocks[0]), uncertainty


@pytest.mark.slow
def test_a_step_recorded_once_has_intervals_that_hold_the_truth_and_are_of_use():
    off, below, above, blocks, uncertainty = identified_often("step", SHORT_WINDOWS)
    assert blocks == 4
    assert np.asarray(uncertainty.few_blocks).all()
    inside = (off <= below) & (-off <= above)
    # The share of 60 seeds is itself known to 3 % for each parameter.
    assert (inside.mean(0) > 0.88).all()
    assert inside.mean() > 0.92
    # Student's t with one degree of freedom would reach 12.7 standard errors to either side.
    assert (np.median(below + above, axis=0) < 3 * 12.7 * off.std(0)).all()
    assert (np.max(below + above, axis=0) < 8 * 12.7 * off.std(0)).all()


@pytest.mark.slow
def test_two_blocks_have_intervals_that_are_neither_points_nor_everything():
    off, below, above, blocks, uncertainty = identified_often("waves", LONG_WINDOWS)
    assert blocks == 2
    assert np.asarray(uncertainty.few_blocks).all()
    inside = (off <= below) & (-off <= above)
    assert (inside.mean(0) > 0.85).all()
    assert (np.median(below + above, axis=0) < 2 * 12.7 * off.std(0)).all()


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
    flat = [fine.flattened()]
    found = few_blocks_sandwich(
        [fine],
        unknowns_of(flat, {}),
        values,
        ShortBlocks(np.array([6]), jnp.array([1.0])),
        jnp.array([used]),
    )
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
        assert float(found.seen[j]) == pytest.approx(seen, rel=1e-9)
        freedom = np.trace(product) ** 2 / np.trace(product @ product)
        assert float(found.degrees_of_freedom[j]) == pytest.approx(max(freedom, 1.0), rel=1e-9)
        influence = scored @ inverse[j]
        plain = influence @ weights @ influence / seen
        # A thousandth is what other parameters tell.
        assert float(found.covariance[j, j]) == pytest.approx(plain, rel=0.05)
    assert float(found.seen[1]) < 0.5 * float(found.seen[0])


@pytest.mark.slow
def test_the_corrected_sandwich_is_the_same_in_32_bit_and_in_any_unit():
    y, a = bursts(np.random.default_rng(1))
    fine, _ = blocks_of((y, a * [1.0, 1e-6]), 6, ("a", "b"))

    def sandwich_in(dtype):
        equations = jax.tree.map(lambda x: x.astype(dtype), fine)
        theta = np.linalg.lstsq(a * [1.0, 1e-6], y)[0].astype(dtype)
        return few_blocks_sandwich(
            [equations],
            unknowns_of([equations.flattened()], {}),
            {"a": jnp.asarray(theta[0]), "b": jnp.asarray(theta[1])},
            ShortBlocks(np.array([6]), jnp.array([1.0], dtype)),
            jnp.array([3]),
        )

    for single, double in zip(sandwich_in(np.float32), sandwich_in(np.float64)):
        np.testing.assert_allclose(single, double, rtol=0.02)


@pytest.mark.raises_finding("few_blocks")
def test_few_blocks_are_named_and_say_what_stands_in():
    estimate = identify(FORCE, noisy("step", 0), SHORT_WINDOWS)
    finding = next(f for f in estimate.findings() if f.code == "few_blocks")
    assert all(f"{name} (" in finding.message for name in TRUTH)
    assert estimate.uncertainty.label == "small-sample sandwich with Student's t"
    assert "small-sample sandwich with Student's t, 4 blocks" in str(estimate)
    # Its own finding says why: the bootstrap's would speak of replicates that were not used.
    assert not any(f.code == "rarely_excited" for f in estimate.findings())


def test_what_one_pulse_alone_tells_has_a_finite_interval_that_holds_it():
    v = np.zeros(SAMPLES)
    v[200:220] = np.sin(np.pi * np.arange(20) / 20) ** 2
    held = []
    for seed in range(8):
        error = 0.1 * np.random.default_rng(seed).normal(size=SAMPLES)
        record = Record.from_samples({"v": v, "F": 3 * v + error}, time_step=STEP)
        estimate = identify(
            Equation(Term(1.0, "F"), -Term("c", "v"), -Term("o", constant)), record, SHORT_WINDOWS
        )
        low, high = estimate.interval("c")
        assert 0 < high - low < 100
        held.append(low < 3 < high)
    assert sum(held) >= 7

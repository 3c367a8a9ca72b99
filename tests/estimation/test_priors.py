"""Priors and bounds of linear estimates: against Bayes, brute force, differences and coverage."""

import itertools
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import SHORT, tones

import riecjax as rx
from conftest import in_32_bit
from riecjax.equations.model import as_model
from riecjax.estimation.constraints import Constraints, sides_of_bounds
from riecjax.summaries.normal_equations import NormalEquations

TRUTH = np.array([2.0, 1.5, 0.7, 30.0])
NAMES = ("m", "c", "d", "k")
X = np.asarray(tones(SHORT.times, (0.5, 1.1, 1.8, 2.9), 0.05, 1))
V, A = (np.gradient(X, SHORT.step), np.gradient(np.gradient(X, SHORT.step), SHORT.step))
W = V + 0.01 * np.std(V) * np.random.default_rng(5).standard_normal(V.size)
"""Next to the first, so that c and d are told apart by a hundredth of either."""
REGRESSORS = np.stack([A, V, W, X], axis=1)
NOISE = 0.3
BODY = rx.Equation(
    *(rx.Term(name, signal) for name, signal in zip(NAMES, "avwx")), -rx.Term(1.0, "F"), name="body"
)
DOLS, RIEC = rx.DOLS(), rx.RIEC(rx.AllWindows(0.1, 0.5))
PLAIN: Any = {"noise": "none", "intervals": "sandwich"}


def record(seed: int = 0, w: np.ndarray = W) -> rx.Record:
    regressors = np.stack([A, V, w, X], axis=1)
    force = regressors @ TRUTH + NOISE * np.random.default_rng(seed).standard_normal(X.size)
    return rx.Record({**dict(zip("avwx", regressors.T)), "F": force}, SHORT.step)


@pytest.mark.parametrize("share", [0.1, 1.0, 10.0])
def test_of_white_errors_it_is_the_posterior_of_linear_regression(share):
    gram, noisy = REGRESSORS.T @ REGRESSORS / NOISE**2, record()
    moment = REGRESSORS.T @ np.asarray(noisy["F"]) / NOISE**2
    std = share * np.sqrt(np.linalg.inv(gram)[2, 2])
    information = gram + np.diag([0, 0, 1 / std**2, 0])
    mean = np.linalg.solve(information, moment + np.array([0, 0, (0.7 - std) / std**2, 0]))
    error = np.sqrt(np.diag(np.linalg.inv(information)))
    for intervals in ("bootstrap", "sandwich"):
        settings: Any = {"noise": "none", "intervals": intervals, "priors": {"d": (0.7 - std, std)}}
        found = rx.identify(BODY, noisy, DOLS, **settings)
        # A variance told by 64 blocks scatters by a sixth.
        assert np.all(np.abs(np.asarray(found.theta) - mean) < 0.2 * error)
        ends = np.array(found.interval("d")) - mean[2]
        np.testing.assert_allclose(ends, 1.96 * error[2] * np.array([-1, 1]), rtol=0.25)


@pytest.mark.parametrize("share", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("name", NAMES)
def test_of_overlapping_windows_it_is_weighed_by_the_sandwich(name, share):
    alone = rx.identify(BODY, record(), RIEC, **PLAIN)
    value, error = float(alone[name]), float(alone.standard_error(name))
    assert error > 5 * float(alone.naive[NAMES.index(name)])
    prior = (value + 2 * error, share * error)
    found = rx.identify(BODY, record(), RIEC, priors={name: prior}, **PLAIN)
    posterior = (1 / error**2 + 1 / prior[1] ** 2) ** -0.5
    expected = posterior**2 * (value / error**2 + prior[0] / prior[1] ** 2)
    # Of 16 blocks, two ways to tell a variance differ by a few percent.
    assert abs(float(found[name]) - expected) < 0.15 * posterior
    assert float(found.standard_error(name)) == pytest.approx(posterior, rel=0.05)


@pytest.mark.raises_finding("rests_on_prior")
@pytest.mark.parametrize("intervals", ["bootstrap", "sandwich"])
@pytest.mark.parametrize("factor", [0.0, 1.0])
def test_what_only_a_prior_tells_is_its_own(intervals, factor):
    """Once a column is zero, once that of another parameter."""
    untold = record(w=factor * V)
    with pytest.raises(rx.IdentifiabilityError):
        rx.identify(BODY, untold, RIEC, noise="none")
    settings: Any = {"noise": "none", "intervals": intervals, "priors": {"d": (0.8, 0.1)}}
    found = rx.identify(BODY, untold, RIEC, **settings)
    np.testing.assert_allclose(found.interval("d"), (0.604, 0.996), atol=2e-3)
    assert float(found["c"]) + factor * 0.8 == pytest.approx(1.5 + factor * 0.7, abs=0.1)
    resting = [f.parameters for f in found.findings() if f.code == "rests_on_prior"]
    assert resting == [("d",)]
    assessed = rx.assess(BODY, untold, RIEC, refine=None, sweep=False, **settings)
    np.testing.assert_allclose(assessed.answer.theta, found.theta, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.5, 2.0])
def test_intervals_cover_what_priors_are_of(share):
    """The truth is drawn from its prior, over and over."""
    alone = rx.identify(BODY, record(), RIEC, **PLAIN)
    std = share * float(alone.standard_error("d"))
    # The noise of a force that reaches from one row into the next.
    rng, draws = np.random.default_rng(3), 300
    noise = rng.standard_normal((draws, X.size + 9))
    noise = np.stack([np.convolve(each, np.ones(10), "valid") for each in noise]) * NOISE / 3
    truths = 0.7 + std * rng.standard_normal(draws)

    def found(truth, noise):
        signals = dict(zip("avwx", REGRESSORS.T)) | {"F": REGRESSORS @ TRUTH + noise}
        signals["F"] += (truth - 0.7) * W
        recorded = rx.Record(signals, SHORT.step)
        return rx.identify(BODY, recorded, RIEC, priors={"d": (0.7, std)}, **PLAIN)

    batch = jax.jit(lambda *args: jax.lax.map(lambda each: found(*each), args))(truths, noise)
    # Of some fifteen blocks they reach further than 1.96 standard errors.
    low, high = batch.interval("d")
    assert 0.92 < np.mean((low < truths) & (truths < high)) < 0.98


def test_a_prior_of_a_shared_parameter_counts_once():
    """Two equations of a stage, two recordings, and an offset of each."""
    other = rx.Equation(rx.Term("m", "a"), rx.Term("b", "v"), -rx.Term(1.0, "G"), name="other")
    body = rx.Equation(*BODY.terms, rx.Term("offset", rx.constant), name="body")
    push = 2.0 * A + 3.0 * V + NOISE * np.random.default_rng(9).standard_normal(X.size)
    records = [record(seed).with_signals({"G": push}) for seed in (1, 2)]
    model = rx.simultaneous(body, other)
    each: Any = PLAIN | {"per_record": ("offset",)}
    alone = rx.identify(model, records, RIEC, **each)
    errors = dict(zip(alone.parameters, map(float, alone.standard_errors)))
    priors = {n: (float(alone[n]) + errors[n], errors[n]) for n in ("m", "offset[2]")}
    for name, prior in priors.items():
        found = rx.identify(model, records, RIEC, priors={name: prior}, **each)
        assert float(found[name]) == pytest.approx(float(alone[name]) + errors[name] / 2, rel=0.02)
        assert float(found.standard_error(name)) == pytest.approx(errors[name] / 2**0.5, rel=0.05)
    assert alone.summary is not None
    both = rx.estimate(model, alone.summary, per_record=("offset",), priors={"offset": (0.0, 1e-6)})
    assert abs(float(both["offset[1]"])) < 1e-5 > abs(float(both["offset[2]"]))


def test_a_prior_that_says_nothing_is_none_and_one_that_says_all_a_known_value():
    alone = rx.identify(BODY, record(), RIEC, **PLAIN)
    wide = rx.identify(BODY, record(), RIEC, priors={"d": (5.0, 1e8)}, **PLAIN)
    known = rx.identify(BODY, record(), RIEC, known={"k": 29.5}, **PLAIN)
    narrow = rx.identify(BODY, record(), RIEC, priors={"k": (29.5, 1e-7)}, **PLAIN)
    np.testing.assert_allclose(wide.theta, alone.theta, rtol=1e-9)
    np.testing.assert_allclose(wide.covariance, alone.covariance, rtol=1e-9)
    np.testing.assert_allclose(narrow.theta[:3], known.theta, rtol=1e-5)
    np.testing.assert_allclose(narrow.covariance[:3, :3], known.covariance, rtol=1e-5)
    # What is far below the rounding of sums does not spoil them.
    surest = rx.identify(BODY, record(), RIEC, priors={"k": (29.5, 1e-18)}, **PLAIN)
    np.testing.assert_allclose(surest.theta[:3], known.theta, rtol=1e-6)
    np.testing.assert_allclose(surest.standard_errors[:3], known.standard_errors, rtol=1e-5)


@pytest.mark.raises_finding("prior_disagrees")
@pytest.mark.parametrize("share", [1.0, 1e-9])
def test_a_prior_that_data_contradict_is_named_however_narrow_it_is(share):
    alone = rx.identify(BODY, record(), RIEC, **PLAIN)
    value, error = float(alone["k"]), float(alone.standard_error("k"))
    prior = (value - 6 * error, share * error)
    settings: Any = {"refine": None, "sweep": False, **PLAIN}
    found = rx.assess(BODY, record(), RIEC, priors={"k": prior}, **settings)
    (finding,) = (f for f in found.findings() if f.code == "prior_disagrees")
    without = float(re.findall(r"without it, ([-.e\d]+)", finding.message)[0])
    assert without == pytest.approx(value, abs=0.5 * error)
    assert found.verdict.parameters["k"].level == "do not use"


@pytest.mark.slow
def test_a_prior_of_a_later_stage_of_random_windows_and_of_single_precision():
    other = rx.Equation(rx.Term("m", "a"), rx.Term("b", "v"), -rx.Term(1.0, "G"), name="other")
    push = 2.0 * A + 3.0 * V + NOISE * np.random.default_rng(9).standard_normal(X.size)
    both, model = record().with_signals({"G": push}), rx.staged(BODY, other)
    windows = rx.RIEC(rx.RandomWindows(0.1, 0.5, 4000))

    def found(key, **priors):
        return rx.identify(model, both, windows, key=key, priors=priors, **PLAIN)

    keys = jax.random.split(jax.random.key(0), 2)
    alone = found(keys[1])
    value, error = float(alone["b"]), float(alone.standard_error("b"))
    prior = (value + 2 * error, error)
    batch = jax.vmap(lambda key: found(key, b=prior))(keys)
    # What earlier stages find stays as it is.
    np.testing.assert_allclose(batch.theta[1, :4], alone.theta[:4], rtol=1e-9)
    assert float(batch.theta[1, 4]) == pytest.approx(value + error, abs=0.1 * error)
    assert float(batch.standard_errors[1, 4]) == pytest.approx(error / 2**0.5, rel=0.05)
    priors = {"m": (2.01, 1e-3)}

    def traced():
        # What is not traced is of double precision.
        return jax.jit(lambda of: rx.identify(BODY, of, RIEC, priors=priors, **PLAIN))(record())

    with in_32_bit():
        single = traced()
        assert single.theta.dtype == jnp.float32
    double = traced()
    place = NAMES.index("m")
    assert float(single.theta[place]) == pytest.approx(float(double["m"]), abs=1e-4)
    np.testing.assert_allclose(
        np.diag(single.covariance)[place], np.diag(double.covariance)[place], rtol=0.05
    )


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_bounds_are_held_as_of_all_active_sets_the_best(count):
    """Of collinear columns too, in any units."""
    rng, names = np.random.default_rng(count), NAMES[:2] + ("e", "f", "g")[: count - 2]
    names = names[:count]
    for number in range(25):
        rows = rng.standard_normal((8, 1 + count))
        if number % 2 and count > 1:
            rows[:, 2] = rows[:, 1] + 1e-3 * rows[:, 2]
        rows *= 10.0 ** rng.uniform(-3, 3, 1 + count)
        best = np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0]
        lower = best - np.abs(best) * rng.standard_normal(count)
        upper = lower + np.abs(best) * rng.exponential(size=count)
        lower[rng.random(count) < 0.3], upper[rng.random(count) < 0.3] = -np.inf, np.inf
        limits = Constraints(dict(zip(names, zip(lower, upper))))
        equations = NormalEquations(jnp.asarray(rows.T @ rows), jnp.asarray(8.0), names)
        side = np.asarray(sides_of_bounds(equations, limits))

        energies = {}
        for sides in itertools.product((-1, 0, 1), repeat=count):
            held = np.array(sides)
            theta, free = np.where(held < 0, lower, np.where(held > 0, upper, 0.0)), held == 0
            if not np.isfinite(theta).all():
                continue
            rest = rows[:, 0] - rows[:, 1:] @ theta
            theta[free] = np.linalg.lstsq(rows[:, 1:][:, free], rest, rcond=1e-13)[0]
            slack = 1e-9 * np.abs(theta)
            if np.all((lower - slack <= theta) & (theta <= upper + slack)):
                energies[sides] = np.sum((rows[:, 0] - rows[:, 1:] @ theta) ** 2)
        assert energies[tuple(side)] <= min(energies.values()) * (1 + 1e-9)


@pytest.mark.parametrize("intervals", ["bootstrap", "sandwich"])
def test_what_is_held_at_a_bound_is_known_to_the_others(intervals):
    settings: Any = {"noise": "none", "intervals": intervals}
    found = rx.identify(
        BODY, record(), RIEC, bounds={"k": (None, 29.5), "m": (0, None)}, **settings
    )
    known = rx.identify(BODY, record(), RIEC, known={"k": 29.5}, **settings)
    assert found.at_bound.tolist() == [False, False, False, True]
    assert float(found["k"]) == 29.5
    assert np.isnan(found.standard_error("k"))
    np.testing.assert_allclose(found.theta[:3], known.theta, rtol=1e-9)
    np.testing.assert_allclose(found.covariance[:3, :3], known.covariance, rtol=1e-6)
    np.testing.assert_allclose(found.interval("d"), known.interval("d"), rtol=1e-6)
    # The bootstrap's replicates hold it too, and are no sign of how often it is excited.
    assert [f.code for f in found.findings() if "k" in f.parameters] == ["at_bound"]
    free = rx.identify(BODY, record(), RIEC, bounds={"k": (0, 40), "m": (0, None)}, **settings)
    plain = rx.identify(BODY, record(), RIEC, **settings)
    np.testing.assert_array_equal(free.theta, plain.theta)
    np.testing.assert_array_equal(free.covariance, plain.covariance)


def test_an_estimate_follows_priors_and_bounds_as_differences_do():
    summary = rx.summarise(BODY, record(), RIEC, noise="none")

    def theta(mean, std, upper):
        limits: Any = {"priors": {"d": (mean, std)}, "bounds": {"k": (None, upper)}}
        return rx.estimate(BODY, summary, **limits, intervals="naive").theta

    at, compiled = (1.0, 0.2, 29.5), jax.jit(theta)
    slopes = jax.jacfwd(compiled, argnums=(0, 1, 2))(*map(jnp.asarray, at))
    for number, (value, slope) in enumerate(zip(at, slopes)):
        step = 1e-4 * value
        ends = ([*at[:number], value + s, *at[number + 1 :]] for s in (step, -step))
        above, below = (compiled(*map(jnp.asarray, end)) for end in ends)
        np.testing.assert_allclose(slope, (above - below) / (2 * step), rtol=1e-5, atol=1e-7)
    batch = jax.vmap(lambda mean: theta(mean, *at[1:]))(jnp.array([0.5, 1.0]))
    np.testing.assert_allclose(batch[1], theta(*at), rtol=1e-9)
    # What is refused where values can be looked at has no answer where they cannot.
    assert not np.isfinite(compiled(1.0, -0.2, 29.5)).any()


def test_bounds_that_are_traced_in_the_wrong_order_have_no_answer():
    summary = rx.summarise(BODY, record(), RIEC, noise="none")

    def found(lower):
        return rx.estimate(BODY, summary, bounds={"k": (lower, 29.5)}, intervals="naive")

    batch = jax.vmap(found)(jnp.array([0.0, 30.0, 29.5]))
    assert batch.determined.tolist() == [True, False, False]


def test_what_a_linear_estimate_cannot_take_is_refused():
    summary = rx.summarise(BODY, record(), RIEC, noise="none")
    for wrong in ("k", 5, [("k", 1.0)]):
        for what in ("priors", "bounds"):
            given: Any = {what: wrong}
            with pytest.raises(rx.ModelError, match=rf"{what} is .* Write {what}=.*by name"):
                rx.estimate(BODY, summary, **given)
    with pytest.raises(rx.ModelError, match="a prior is given for 'k'; free are: m, c, d"):
        rx.identify(BODY, record(), RIEC, known={"k": 30.0}, priors={"k": (30.0, 1.0)})
    body = rx.Equation(rx.Term("m", "v", derivative=1), -rx.Term(1.0, "F"))
    hidden = as_model(body).with_elements(rx.HiddenMode("v"))
    with pytest.raises(rx.ModelError, match="M_mode, of a hidden element: only a refinement"):
        rx.identify(hidden, record(), priors={"M_mode": (1.0, 0.1)})

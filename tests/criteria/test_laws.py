from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import MACHINES, Shape

from nightly import nightly
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.test_functions import Boxcar, Bump, Hat
from riecjax.criteria.windows import AllWindows, RandomWindows, WindowSet
from riecjax.equations.noisy_columns import sampled_columns
from riecjax.errors import ModelError
from riecjax.estimation.identify import identify
from riecjax.records.record import Record
from riecjax.uncertainty.intervals import Naive

fit = partial(identify, intervals=Naive())
"""No test here asks for intervals."""

EQUATION = MACHINES["linear"].model
STEP, ALPHA, BETA = 0.01, 0.06, 0.3


def record_of(n=400, gaps=3, offset=0.0):
    """A model that leaves an error, which every window weighs otherwise."""
    rng = np.random.default_rng(0)
    signals = MACHINES["linear"].signals(shape=Shape(n, 100))
    signals["x"] = signals["x"] + offset
    signals["u"] = signals["u"] + rng.normal(size=n)
    signals["u"][rng.integers(0, n, gaps)] = np.nan
    return Record.from_samples(signals, time_step=STEP)


@eqx.filter_jit
def integrated(weight, record, windows):
    return weight.integrals(sampled_columns(EQUATION, record, weight.smoothness), windows)


def one_by_one(record, weight, length_weights):
    """Weighted least squares over every window; `length_weights`: samples to weight."""
    columns = 1 + len(EQUATION.parameters)
    total = np.zeros((columns, columns))
    for samples, w in length_weights.items():
        # One shape for all lengths: windows past the last start are drawn again, and left out.
        every = np.arange(record.sample_count)
        start = np.minimum(every, record.sample_count - samples - 1)
        windows = WindowSet(jnp.asarray(start), jnp.asarray(start + samples))
        integrals, whole = integrated(weight, record, windows)
        rows = np.asarray(integrals)[:, np.asarray(whole) & (start == every)]
        total = total + w * rows @ rows.T
    return np.linalg.solve(total[1:, 1:], total[1:, 0])


STEPS = [1.0, 0.0, 3.0]


def length_weights(law, weight):
    """Of lengths in samples: equal parts of the band have a stepped law's weights."""
    multiple = weight.length_multiple
    lengths = multiple * np.arange(6 // multiple, 30 // multiple + 1)
    if isinstance(weight, Bump):
        lengths = np.array([6, 14, 22, 30])
    edges = np.round(np.linspace(0, 1, 4) * lengths.size).astype(int)
    steps = STEPS if law is STEPS else [1.0] * 3
    parts = zip(steps, edges[:-1], edges[1:])
    return {int(k): w for w, a, b in parts for k in lengths[a:b] if w > 0}


@pytest.mark.parametrize(
    ("law", "weight"),
    [
        (STEPS, Boxcar()),
        (None, Boxcar(4)),
        (STEPS, Bump(4, lengths=4)),
        *nightly(
            [
                (STEPS, Hat(4)),
                (None, Hat(6)),
                (None, Bump(4, lengths=4)),
            ]
        ),
    ],
    ids=lambda part: getattr(part, "__name__", str(part)),
)
def test_the_estimate_is_that_of_every_window_one_by_one(law, weight):
    record = record_of(offset=50.0 if law is None else 0.0)
    found = fit(EQUATION, record, RIEC(AllWindows(ALPHA, BETA, law=law), weight), noise="none")
    expected = one_by_one(record, weight, length_weights(law, weight))
    np.testing.assert_allclose(found.theta, expected, rtol=1e-8)


def test_a_flat_law_is_no_law_whatever_its_size():
    plain = fit(EQUATION, record_of(), RIEC(AllWindows(ALPHA, BETA)))
    law = 7.0 * np.ones(5)
    same = fit(EQUATION, record_of(), RIEC(AllWindows(ALPHA, BETA, law=law)))
    np.testing.assert_allclose(same.theta, plain.theta, rtol=1e-9)
    np.testing.assert_allclose(same.stages[0].count, plain.stages[0].count, rtol=1e-12)


@pytest.mark.slow
def test_estimates_differentiate_in_the_law():
    record, weights = record_of(), jnp.array([1.0, 2.0, 0.5])

    def mass(weights):
        windows = AllWindows(ALPHA, BETA, law=weights, longest_samples=32)
        return fit(EQUATION, record, RIEC(windows))["m"]

    slope = jax.grad(mass)(weights)
    for i in range(3):
        step = jnp.zeros(3).at[i].set(1e-4)
        difference = (mass(weights + step) - mass(weights - step)) / 2e-4
        assert float(slope[i]) == pytest.approx(float(difference), rel=1e-5)
    # Only ratios of weights matter.
    assert float(slope @ weights) == pytest.approx(0.0, abs=1e-9 * float(mass(weights)))


@pytest.mark.parametrize("law", [[], [0.0, 0.0], [1.0, -1.0], [1.0, np.nan], [[1.0]]], ids=str)
def test_weights_that_make_no_law_are_refused(law):
    with pytest.raises(ModelError, match="law of window lengths"):
        AllWindows(ALPHA, BETA, law=law)


@pytest.mark.parametrize("weight", [Boxcar(), *nightly([Hat(), Bump(4, lengths=5)])], ids=str)
@pytest.mark.parametrize("law", [[1.0, 3.0, 0.5], *nightly([None])], ids=["stepped", "uniform"])
def test_windows_that_gaps_leave_out_are_counted(weight, law):
    criterion = RIEC(AllWindows(ALPHA, BETA, law=law), weight)
    for record in (record_of(gaps=0), record_of(gaps=3)):
        estimate = fit(EQUATION, record, criterion)
        left_out = [f for f in estimate.findings() if f.code == "rows_left_out"]
        assert bool(left_out) == (record.present(record.arrays) is not None)
    (offered,) = fit(EQUATION, record_of(gaps=0), criterion).rows_offered
    held = fit(EQUATION, record_of(gaps=0), criterion).stages[0].count
    assert offered == pytest.approx(float(held), rel=1e-12)


@pytest.mark.parametrize(
    ("windows", "weight"),
    [
        (lambda alpha: RandomWindows(alpha, BETA, 20), Boxcar()),
        (lambda alpha: RandomWindows(alpha, BETA, 20), Hat()),
        (lambda alpha: AllWindows(alpha, BETA, longest_samples=64), Boxcar()),
        (lambda alpha: AllWindows(alpha, BETA, longest_samples=64), Bump(4, lengths=2)),
    ],
)
def test_windows_that_are_rounded_away_refuse_to_be_differentiated(windows, weight):
    record = record_of(gaps=0)

    def estimate(alpha):
        criterion = RIEC(windows(alpha), weight)
        return fit(EQUATION, record, criterion, key=jax.random.key(0))["k"]

    with pytest.raises(ModelError, match="no derivative by alpha or beta"):
        jax.grad(estimate)(ALPHA)


@pytest.mark.parametrize("weight", [Boxcar(), Bump(4, lengths=5)], ids=str)
def test_windows_of_a_known_record_are_counted_inside_a_jitted_function_too(weight):
    criterion, record = RIEC(AllWindows(ALPHA, BETA, law=[1.0, 3.0, 0.5]), weight), record_of()
    counted = []
    jax.jit(lambda _: counted.append(criterion.row_count(record)))(0.0)
    assert counted == [criterion.row_count(record)]


@pytest.mark.slow
@pytest.mark.parametrize("weight", [Boxcar(), Hat()], ids=str)
def test_random_windows_converge_to_it_at_the_monte_carlo_rate(weight):
    record = record_of(2000, 0)
    every = identify(EQUATION, record, RIEC(AllWindows(0.05, 0.4), weight)).theta

    def apart(count, seeds=24):
        criterion = RIEC(RandomWindows(0.05, 0.4, count), weight)
        drawn = [identify(EQUATION, record, criterion, key=jax.random.key(s)) for s in range(seeds)]
        return np.stack([estimate.theta - every for estimate in drawn])

    few, many = apart(500), apart(8000)
    ratio = few.std(0) / many.std(0)
    assert np.all((ratio > 2) & (ratio < 8))  # 4 expected for 16 times as many
    assert np.all(np.abs(many.mean(0)) < 4 * many.std(0) / np.sqrt(24))


@pytest.mark.slow
def test_intervals_are_those_of_many_random_windows():
    record = record_of(4000, 0)
    every = identify(EQUATION, record, RIEC(AllWindows(0.05, 0.3), Hat()))
    drawn = identify(
        EQUATION, record, RIEC(RandomWindows(0.05, 0.3, 100_000), Hat()), key=jax.random.key(0)
    )
    np.testing.assert_allclose(every.standard_errors, drawn.standard_errors, rtol=0.25)

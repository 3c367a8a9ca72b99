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


def one_by_one(record, weight):
    """Least squares over every window."""
    columns = 1 + len(EQUATION.parameters)
    total = np.zeros((columns, columns))
    multiple = weight.length_multiple
    lengths = [6, 14, 22, 30] if isinstance(weight, Bump) else range(6, 31, multiple)
    for samples in lengths:
        # One shape for all lengths: windows past the last start are drawn again, and left out.
        every = np.arange(record.sample_count)
        start = np.minimum(every, record.sample_count - samples - 1)
        windows = WindowSet(jnp.asarray(start), jnp.asarray(start + samples))
        integrals, whole = integrated(weight, record, windows)
        rows = np.asarray(integrals)[:, np.asarray(whole) & (start == every)]
        total = total + rows @ rows.T
    return np.linalg.solve(total[1:, 1:], total[1:, 0])


@pytest.mark.parametrize(
    "weight", [Boxcar(4), Bump(4, lengths=4), *nightly([Boxcar(), Hat(4), Hat(6)])], ids=str
)
def test_the_estimate_is_that_of_every_window_one_by_one(weight):
    record = record_of(offset=50.0)
    found = fit(EQUATION, record, RIEC(AllWindows(ALPHA, BETA), weight), noise="none")
    np.testing.assert_allclose(found.theta, one_by_one(record, weight), rtol=1e-8)


@pytest.mark.parametrize("weight", [Boxcar(), *nightly([Hat(), Bump(4, lengths=5)])], ids=str)
def test_windows_that_gaps_leave_out_are_counted(weight):
    criterion = RIEC(AllWindows(ALPHA, BETA), weight)
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
    criterion, record = RIEC(AllWindows(ALPHA, BETA), weight), record_of()
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

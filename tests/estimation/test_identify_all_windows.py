"""Identification from every window at once, against every window one by one."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from riecjax.criteria.criterion import RIEC
from riecjax.criteria.test_functions import Boxcar, Bump, Hat
from riecjax.criteria.windows import AllWindows, RandomWindows, WindowSet
from riecjax.equations.equation import Equation
from riecjax.equations.noisy_columns import sampled_columns
from riecjax.equations.term import Term
from riecjax.errors import ModelError
from riecjax.estimation.identify import identify
from riecjax.models.model import Model
from riecjax.records.record import Record

EQUATION = Equation(
    Term("m", "x", derivative=2, measured=("dx",)),
    Term("d", "x", derivative=1, measured=("dx",)),
    Term("k", "x"),
    -Term(1.0, "u"),
)
STEP = 0.01


def record_of(n, seed=0, gaps=0, offset=0.0):
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(n)
    x = offset + np.sin(3 * t) + 0.3 * np.cos(11 * t)
    dx = 3 * np.cos(3 * t) - 3.3 * np.sin(11 * t)
    ddx = -9 * np.sin(3 * t) - 36.3 * np.cos(11 * t)
    u = rng.normal(size=n) + 20 * x + dx + 0.5 * ddx
    if gaps:
        u[rng.integers(0, n, gaps)] = np.nan
    return Record.from_samples({"x": x, "dx": dx, "u": u}, time_step=STEP)


def every_window(record, weight, shortest, longest):
    """Every admissible pair of start and length on samples, one by one."""
    n, m = record.sample_count, weight.length_multiple
    pairs = [(t, t + m * lag) for lag in range(shortest, longest + 1) for t in range(n - m * lag)]
    start, stop = np.array(pairs).T
    return WindowSet(jnp.asarray(start), jnp.asarray(stop))


@eqx.filter_jit
def integrated(record, weight, windows):
    return weight.integrals(sampled_columns(EQUATION, record, weight.smoothness), windows)


MOST_PAIRS = 16_000


def least_squares(record, weight, windows):
    count = windows.start.shape[0]
    # One shape whatever their number: the first window fills up, and is left out again.
    filled = WindowSet(*(jnp.asarray(np.resize(np.asarray(ends), MOST_PAIRS)) for ends in windows))
    assert count <= MOST_PAIRS
    columns, whole = integrated(record, weight, filled)
    rows = np.asarray(columns)[:, :count]
    rows = rows if whole is None else rows[:, np.asarray(whole)[:count]]
    return np.linalg.lstsq(rows[1:].T, rows[0], rcond=None)[0], rows.shape[1]


def agrees_with_every_window_one_by_one(record, windows, weight):
    lags = windows.lags(record.sample_count, record.time_step, weight.length_multiple)
    every = every_window(record, weight, *(int(lag) for lag in lags))
    expected, count = least_squares(record, weight, every)
    estimate = identify(EQUATION, record, RIEC(windows, weight))
    assert int(estimate.stages[0].count) == count
    np.testing.assert_allclose(estimate.theta, expected, rtol=1e-8)


@pytest.mark.parametrize("weight", [Boxcar(4), Hat(6)], ids=str)
def test_the_estimate_is_that_of_every_window(weight):
    record = record_of(333, gaps=3, offset=50.0)
    agrees_with_every_window_one_by_one(record, AllWindows(0.05, 0.25), weight)


@pytest.mark.slow
@settings(deadline=None, max_examples=25)
@given(
    n=st.sampled_from([120, 333]),
    seed=st.integers(0, 10**6),
    gaps=st.integers(0, 5),
    alpha=st.floats(0.02, 0.1),
    more=st.floats(0.03, 0.3),
    weight=st.sampled_from([Boxcar(), Boxcar(4), Hat(), Hat(6)]),
    offset=st.sampled_from([0.0, 50.0]),
)
def test_the_estimate_is_that_of_every_window_one_by_one(
    n, seed, gaps, alpha, more, weight, offset
):
    record, windows = record_of(n, seed, gaps, offset), AllWindows(alpha, alpha + more)
    agrees_with_every_window_one_by_one(record, windows, weight)


def test_bumps_are_summed_at_their_lengths_and_every_start():
    record, weight = record_of(333, gaps=3), Bump(4, lengths=5)
    estimate = identify(EQUATION, record, RIEC(AllWindows(0.2, 0.6), weight))
    lengths = [20, 30, 40, 50, 60]
    pairs = np.array([(t, t + k) for k in lengths for t in range(333 - k)])
    windows = WindowSet(jnp.asarray(pairs[:, 0]), jnp.asarray(pairs[:, 1]))
    expected, count = least_squares(record, weight, windows)
    assert int(estimate.stages[0].count) == count
    np.testing.assert_allclose(estimate.theta, expected, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("weight", [Boxcar(), Hat()], ids=str)
def test_random_windows_converge_to_it_at_the_monte_carlo_rate(weight):
    record = record_of(2000)
    every = identify(EQUATION, record, RIEC(AllWindows(0.05, 0.4), weight)).theta

    def apart(count, seeds=24):
        criterion = RIEC(RandomWindows(0.05, 0.4, count), weight)
        drawn = [identify(EQUATION, record, criterion, key=jax.random.key(s)) for s in range(seeds)]
        return np.stack([estimate.theta - every for estimate in drawn])

    few, many = apart(500), apart(8000)
    ratio = few.std(0) / many.std(0)
    assert np.all((ratio > 2) & (ratio < 8))  # 4 expected for 16 times as many
    assert np.all(np.abs(many.mean(0)) < 4 * many.std(0) / np.sqrt(24))


def test_no_key_is_needed_and_the_answer_is_always_the_same():
    record = record_of(900)
    first, again = (identify(EQUATION, record, RIEC(AllWindows(0.05, 0.3))) for _ in range(2))
    np.testing.assert_array_equal(first.theta, again.theta)
    assert first.criterion.describe()["windows"] == "all"


@pytest.mark.slow
def test_intervals_are_those_of_many_random_windows():
    record = record_of(4000)
    every = identify(EQUATION, record, RIEC(AllWindows(0.05, 0.3), Hat()))
    drawn = identify(
        EQUATION, record, RIEC(RandomWindows(0.05, 0.3, 100_000), Hat()), key=jax.random.key(0)
    )
    np.testing.assert_allclose(every.standard_errors, drawn.standard_errors, rtol=0.25)


def test_by_default_windows_are_half_periods_of_the_models_band():
    record = record_of(900)
    plain = identify(EQUATION, record)
    assert plain.criterion.describe() == RIEC(AllWindows(0.05, 0.5)).describe()
    model = Model("mine", "", procedure=lambda: EQUATION, band=(2.0, 5.0))
    found = identify(model, record)
    same = identify(EQUATION, record, RIEC(AllWindows(0.1, 0.25)))
    np.testing.assert_array_equal(found.theta, same.theta)


@pytest.mark.parametrize("band", [(0.0, 5.0), (5.0, 5.0), (5.0, 1.0), (-1.0, 2.0)])
def test_a_band_that_is_none_is_refused(band):
    with pytest.raises(ModelError, match="0 < low < high"):
        RIEC.of_band(band)

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from hypothesis import given, settings
from hypothesis import strategies as st

import riecjax as rx
from nightly import nightly
from riecjax.criteria.all_windows import ORDERS, running_integral
from riecjax.criteria.windows import WindowSet
from riecjax.equations.expressions import faster_than
from riecjax.equations.noisy_columns import sampled_columns

fit = partial(rx.identify, intervals=rx.Naive())
"""No test here asks for intervals."""


def motion(t):
    return np.sin(3 * t) + 0.3 * np.cos(11 * t)


def velocity(t):
    return 3 * np.cos(3 * t) - 3.3 * np.sin(11 * t)


def acceleration(t):
    return -9 * np.sin(3 * t) - 36.3 * np.cos(11 * t)


EQUATION = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("dx", "ddx")),
    rx.Term("d", "x", derivative=1, measured=("dx",)),
    rx.Term("k", "x"),
    -rx.Term(1.0, "u"),
)
TRUTH = {"m": 2.0, "d": 0.7, "k": 30.0}
DURATION = 4.0


def record_of(count, offset=0.0):
    t = np.linspace(0.0, DURATION, count)
    x, dx, ddx = motion(t) + offset, velocity(t), acceleration(t)
    force = TRUTH["m"] * ddx + TRUTH["d"] * dx + TRUTH["k"] * x
    return rx.Record({"x": x, "dx": dx, "ddx": ddx, "u": force}, t[1] - t[0])


def hat(tau, length):
    return np.minimum(tau, length - tau)


def bump(p):
    return lambda tau, length: (1 - (2 * tau / length - 1) ** 2) ** p


# Six lengths from 60 to 360 samples hold the 60, 120 and 360 of the windows below.
WEIGHTS = {
    "hat": (rx.Hat(8), hat),
    "bump 6": (rx.Bump(6, lengths=6), bump(6)),
    "bump 9": (rx.Bump(9, lengths=6), bump(9)),
}


def integrals(weight, record, windows, equation=EQUATION):
    return weight.integrals(sampled_columns(equation, record, weight.smoothness), windows)


@pytest.mark.parametrize("name", WEIGHTS)
def test_every_column_is_the_weighted_integral_of_its_own_derivative(name):
    """Against adaptive quadrature of weight times derivative, which was never differenced here."""
    test_function, weight = WEIGHTS[name]
    record = record_of(1601)
    start, stop = np.array([0, 13, 700, 1240]), np.array([60, 133, 820, 1600])
    columns, whole = integrals(
        test_function, record, WindowSet(jnp.asarray(start), jnp.asarray(stop))
    )
    assert whole is None
    step = float(record.time_step)
    for j, (a, b) in enumerate(zip(start, stop)):
        length = (b - a) * step
        for row, function in ((1, acceleration), (2, velocity), (3, motion)):
            exact, _ = scipy.integrate.quad(
                lambda tau, f=function, a=a, length=length: weight(tau, length) * f(a * step + tau),
                0.0,
                length,
                points=[length / 2],
                limit=200,
                epsabs=1e-12,
            )
            assert columns[row, j] == pytest.approx(exact, rel=2e-6, abs=1e-8)


@pytest.mark.parametrize(
    ("test_function", "order"),
    [
        (rx.Hat(4), 4),
        *nightly(
            [
                (rx.Hat(2), 2),
                (rx.Hat(6), 6),
                (rx.Boxcar(4), 4),
                (rx.Boxcar(6), 6),
                (rx.Bump(4), 4),
                (rx.Bump(6), 6),
            ]
        ),
    ],
    ids=str,
)
def test_estimates_converge_with_the_order_of_the_quadrature(test_function, order):
    def error(count):
        criterion = rx.RIEC(rx.RandomWindows(0.3, 0.9, 3000), test_function)
        estimate = fit(EQUATION, record_of(count), criterion, key=jax.random.key(0))
        return abs(float(estimate["m"]) / TRUTH["m"] - 1)

    coarse, fine = error(101), error(201)
    assert coarse < 0.1
    assert np.log2(coarse / fine) > order - 0.6


@pytest.mark.parametrize("offset", [0.0, 1e4])
@pytest.mark.parametrize("test_function", [rx.Hat(), rx.Bump()], ids=str)
def test_a_large_offset_costs_no_more_than_its_own_rounding(test_function, offset):
    record = record_of(801, offset)
    windows = WindowSet(jnp.arange(0, 600), jnp.arange(0, 600) + 80)
    with_offset, _ = integrals(test_function, record, windows)
    without, _ = integrals(test_function, record_of(801), windows)
    scale = np.abs(np.asarray(without)).max(1)
    for row in (1, 2):
        error = np.abs(np.asarray(with_offset - without)[row]).max() / scale[row]
        assert error < 1e-13 + 3e-14 * offset


GAPS = st.lists(st.integers(0, 200), max_size=6, unique=True)


@settings(deadline=None, max_examples=40)
@given(
    gaps=GAPS,
    seed=st.integers(0, 1000),
    kind=st.sampled_from([rx.Boxcar(4), rx.Hat(), rx.Bump(lengths=64)]),
)
def test_windows_that_touch_a_missing_sample_are_left_out_and_no_others(gaps, seed, kind):
    t = np.linspace(0.0, 2.0, 201)
    spoilt = motion(t)
    spoilt[gaps] = np.nan
    signals = {"x": spoilt, "dx": velocity(t), "u": 30 * motion(t)}
    if len(gaps) == 201:
        return
    record = rx.Record.from_samples(signals, time_step=0.01)
    equation = rx.Equation(rx.Term("d", "x", derivative=1), rx.Term("k", "x"), -rx.Term(1.0, "u"))
    windows = rx.RandomWindows(0.05, 0.25, 200).draw(
        jax.random.key(seed), record, kind.length_multiple
    )
    if isinstance(kind, rx.Bump):
        windows, _ = kind.rounded(windows, 201)
    _, whole = integrals(kind, record, windows, equation)
    touched = np.array(
        [
            any(a <= g <= b for g in gaps)
            for a, b in zip(np.asarray(windows.start), np.asarray(windows.stop))
        ]
    )
    if not gaps:
        assert whole is None
    else:
        np.testing.assert_array_equal(np.asarray(whole), ~touched)


@pytest.mark.raises_finding("rows_left_out")
@pytest.mark.parametrize(
    "criterion", [rx.DOLS(), rx.RIEC(rx.RandomWindows(0.1, 0.4, 4000), rx.Hat(4))], ids=str
)
def test_a_gap_filled_with_nonsense_does_not_move_the_estimate(criterion):
    record = record_of(1601)
    t = np.asarray(record.time)
    bad = (t > 1.0) & (t < 1.3)
    signals = {name: np.where(bad, np.nan, record[name]) for name in ("x", "dx", "ddx", "u")}
    gappy = rx.Record.from_samples(signals, time=t)
    # What stands in the gap is held; made worse, it must not matter.
    worse = gappy.with_signals({"u": rx.Signal(jnp.where(bad, 1e9, gappy["u"]), ~bad)})
    estimate = fit(EQUATION, worse, criterion, key=jax.random.key(0))
    for name, value in TRUTH.items():
        assert float(estimate[name]) == pytest.approx(value, rel=1e-5)
    assert [finding.code for finding in estimate.findings()].count("rows_left_out") == 1


def test_a_mask_leaves_out_the_windows_that_touch_it():
    masked = rx.Equation(*EQUATION.terms, where=faster_than("dx", 0.5))
    record = record_of(801)
    windows = WindowSet(jnp.arange(0, 780), jnp.arange(0, 780) + 20)
    _, whole = rx.Boxcar().integrals(sampled_columns(masked, record, 1), windows)
    slow = np.abs(np.asarray(record["dx"])) <= 0.5
    expected = [not slow[a : a + 21].any() for a in range(780)]
    np.testing.assert_array_equal(np.asarray(whole), expected)
    assert 0 < np.sum(expected) < 780


def samples_of(function, count, last=2.0):
    t = np.linspace(0.0, last, count)
    return t, jnp.asarray(function(t))[None, :]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("count", [2, 3, 5, 8, 20])
def test_polynomials_below_the_order_are_integrated_exactly(order, count):
    possible = min(order, 2 * (count // 2))
    for power in range(possible):
        t, samples = samples_of(lambda t, power=power: t**power, count)
        integral = running_integral(samples, order)[0] * (t[1] - t[0])
        np.testing.assert_allclose(integral, t ** (power + 1) / (power + 1), atol=1e-12)


def test_no_interval_reads_a_missing_sample_but_its_own_ends():
    _, samples = samples_of(np.cos, 41)
    present = np.ones(41, bool)
    present[20] = False
    spoilt = samples.at[0, 20].set(1e6)
    increments = np.diff(running_integral(spoilt, 6, jnp.asarray(present))[0])
    clean = np.diff(running_integral(samples, 6, None)[0])
    trapezoid = np.diff(running_integral(samples, 2, None)[0])
    far = np.r_[0:17, 23:40]
    np.testing.assert_allclose(increments[far], clean[far], atol=1e-9)
    near = [17, 18, 21, 22]
    np.testing.assert_allclose(increments[near], trapezoid[near], atol=1e-9)

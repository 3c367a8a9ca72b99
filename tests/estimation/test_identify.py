from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.interpolate
from tests.machines import MACHINES, Shape

import riecjax as rx
from compiling import functions_compiled
from nightly import nightly
from riecjax.models.quarter_car.identification import quarter_car_by_body, quarter_car_by_wheel
from riecjax.models.quarter_car.reconstruction import quarter_car_source
from riecjax.paper.reproduction import identification_record

fit = partial(rx.identify, intervals=rx.Naive())
"""For tests that ask for no intervals."""

KEY = jax.random.key(7)

# An oscillator along exact sinusoids: no model error whatever.
MACHINE = MACHINES["linear"]
TRUTH = MACHINE.truth
FASTEST = 2 * np.pi * 3.0
"""Of the sinusoids' angular frequencies."""


def oscillator(known=None):
    return rx.Equation(
        rx.Term(1.0, "u"),
        -rx.Term("m", "x", derivative=2, measured=("dx", "ddx"), unit="kg", known=known),
        -rx.Term("c", "x", derivative=1, measured=("dx",), unit="N s/m"),
        -rx.Term("k", "x", unit="N/m"),
        name="oscillator",
    )


def record_of(duration=5.0, noise=0.0, seed=0, rate=100, **more):
    """With white noise on the force."""
    signals = MACHINE.signals(shape=Shape(round(duration * rate) + 1, rate))
    error = noise * np.random.default_rng(seed).normal(size=signals["u"].size)
    return rx.Record.from_samples(
        {**signals, "u": signals["u"] + error, **more}, time_step=1 / rate
    )


noisy = partial(record_of, noise=3.0)


def windows(count=400, between_samples=False):
    windows = rx.RandomWindows(0.1, 1.0, count, between_samples=between_samples)
    return rx.RIEC(windows, rx.Boxcar(2))


def assert_relative(found, expected, tolerance):
    found, expected = np.asarray(found), np.asarray(expected)
    assert np.max(np.abs(found - expected) / np.abs(expected)) < tolerance


# The paper's staged model in plain NumPy.


def numpy_quarter_car(windows, record, by_wheel):
    s = {name: np.asarray(values) for name, values in record.arrays.items()}
    step = float(record.time_step)
    drawn = windows.draw(KEY, record)
    start, stop = np.asarray(drawn.start), np.asarray(drawn.stop)

    def integral(samples):
        return np.array([step * np.trapezoid(samples[a : b + 1]) for a, b in zip(start, stop)])

    # Roof functions continue their end segments, as a spline does.
    points = (-0.8, -0.3, 0.3, 0.8)
    roofs = scipy.interpolate.make_interp_spline(points, np.eye(4), k=1)(s["x3"] - s["x4"]).T
    force, x1, x2 = (integral(s[name]) for name in ("F_t", "x1", "x2"))
    dx3, dx4 = (s[name][stop] - s[name][start] for name in ("x3", "x4"))
    (tyre,) = np.linalg.lstsq(x1[:, None], force)[0]
    wheel, body = np.linalg.lstsq(np.stack([dx3, dx4], 1), force)[0]
    suspension = np.stack([x2, *(integral(roof) for roof in roofs)], 1)
    target = force - wheel * dx3 if by_wheel else body * dx4
    return np.array([tyre, wheel, body, *np.linalg.lstsq(suspension, target)[0]])


@pytest.fixture(scope="module")
def drive():
    source = quarter_car_source()
    return identification_record(source, jax.random.key(0)).record


@pytest.mark.parametrize("by", ["body", *nightly(["wheel"])])
def test_the_staged_quarter_car_agrees_with_plain_numpy(drive, by):
    model = {"body": quarter_car_by_body, "wheel": quarter_car_by_wheel}[by]()
    drawn = rx.RandomWindows(0.05, 0.5, 1000)
    found = fit(model, drive, rx.RIEC(drawn, rx.Boxcar(2)), key=KEY, noise="none")
    assert found.parameters == ("K_t", "M_us", "M_s", "K_s", "F_1", "F_2", "F_3", "F_4")
    assert_relative(found.theta, numpy_quarter_car(drawn, drive, by == "wheel"), 1e-9)
    assert found.stage_names == ("tyre", "masses", by)


# Data without model error: every criterion finds the truth.


def test_dols_finds_the_truth_to_rounding_where_the_model_is_exact():
    found = fit(oscillator(), record_of(), rx.DOLS())
    assert_relative(found.theta, list(TRUTH.values()), 1e-12)


@pytest.mark.parametrize("rate", [50, 200])
def test_riec_between_samples_finds_it_with_a_tenth_of_the_trapezoidal_rules_error(rate):
    # Interpolation damps a wave by the same share in every term, so that most of the error cancels.
    criterion = windows(2000, between_samples=True)
    found = fit(oscillator(), record_of(rate=rate), criterion, key=KEY, noise="none")
    error = np.abs(np.asarray(found.theta) / list(TRUTH.values()) - 1)
    assert (error < 0.1 * (FASTEST / rate) ** 2 / 12).all()


# Several records, known values, stages together.


def test_several_records_of_unequal_length_are_one_regression():
    records = [noisy(3.0, seed=0), noisy(5.0, seed=1)]
    found = fit(oscillator(), records, rx.DOLS())
    A = np.concatenate([np.stack([r["ddx"], r["dx"], r["x"]], axis=1) for r in records])
    y = np.concatenate([np.asarray(r["u"]) for r in records])
    assert_relative(found.theta, np.linalg.lstsq(A, y)[0], 1e-11)
    assert float(found.stages[0].count) == 301 + 501


def test_each_record_draws_windows_with_a_key_of_its_own():
    records, criterion = [noisy(3.0, seed=0), noisy(5.0, seed=1)], windows()
    found = fit(oscillator(), records, criterion, key=KEY)
    parts = [
        eqx.filter_jit(criterion.rows)(oscillator(), r, k)
        for r, k in zip(records, jax.random.split(KEY, 2))
    ]
    A = np.concatenate([p.regressors for p in parts])
    y = np.concatenate([p.target for p in parts])
    assert_relative(found.theta, np.linalg.lstsq(A, y)[0], 1e-10)


def test_a_known_parameter_is_held_and_the_others_are_fitted_around_it():
    record = noisy(5.0, seed=0)
    found = fit(oscillator(), record, rx.DOLS(), known={"m": 2.5})
    regressors = np.stack([record["dx"], record["x"]], 1)
    expected = np.linalg.lstsq(regressors, np.asarray(record["u"] - 2.5 * record["ddx"]))[0]
    assert found.parameters == ("c", "k")
    assert_relative(found.theta, expected, 1e-11)
    assert float(found["m"]) == 2.5
    assert list(found) == ["c", "k", "m"]
    assert found.covariance.shape == (2, 2)
    assert "known" in str(found)
    # A value that a term knows counts as one given to identify, which overrides it.
    by_term = fit(oscillator(2.5), record, rx.DOLS())
    overridden = fit(oscillator(9.0), record, rx.DOLS(), known={"m": 2.5})
    for same in (by_term, overridden):
        np.testing.assert_array_equal(same.theta, found.theta)


def stiffness():
    return rx.Equation(rx.Term(1.0, "f"), -rx.Term("k", "x", unit="N/m"), name="spring")


def spring_record():
    x = np.asarray(record_of()["x"])
    return noisy(f=TRUTH["k"] * x + 2.0 * np.random.default_rng(9).normal(size=x.size))


def test_simultaneous_equations_are_one_stacked_regression():
    record = spring_record()
    found = fit(rx.simultaneous(stiffness(), oscillator()), record, rx.DOLS())
    s = {name: np.asarray(record[name]) for name in record.signals}
    zero = np.zeros_like(s["x"])
    top, low = np.stack([s["x"], zero, zero], 1), np.stack([s["x"], s["ddx"], s["dx"]], 1)
    expected = np.linalg.lstsq(np.concatenate([top, low]), np.concatenate([s["f"], s["u"]]))[0]
    assert found.parameters == ("k", "m", "c")
    assert_relative(found.theta, expected, 1e-11)
    assert len(found.stages) == 1


@pytest.mark.slow
def test_staged_equations_take_what_came_before_as_known():
    record = spring_record()
    found = rx.identify(rx.staged(stiffness(), oscillator()), record, rx.DOLS())
    first = rx.identify(stiffness(), record, rx.DOLS())
    second = rx.identify(oscillator(), record, rx.DOLS(), known={"k": first["k"]})
    np.testing.assert_allclose(found["k"], first["k"], rtol=1e-14)
    assert_relative(found.theta[1:], second.theta, 1e-12)
    known = fit(rx.staged(stiffness(), oscillator()), record, rx.DOLS(), known={"k": 40.0})
    assert (known.parameters, known.stage_names) == (("m", "c"), ("oscillator",))
    # The uncertainty of k reaches what is found with it.
    assert (np.asarray(found.standard_errors[1:]) != np.asarray(second.standard_errors)).all()


# Transformations.


@pytest.mark.slow
def test_derivatives_with_respect_to_the_signals_agree_with_finite_differences():
    record = noisy(5.0)

    @jax.jit
    def theta(scale):
        return fit(
            oscillator(), record.with_signals({"x": scale * record["x"]}), windows(), key=KEY
        ).theta

    at, step = jnp.asarray(1.2), 1e-5
    difference = (theta(at + step) - theta(at - step)) / (2 * step)
    np.testing.assert_allclose(jax.jacfwd(theta)(at), difference, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(jax.jacrev(theta)(at), difference, rtol=1e-7, atol=1e-9)


def displacement(signals):
    return signals["x"]


def fresh_problem(seed, alpha, beta, coefficient, known):
    """New objects and new numbers throughout; the same shapes and signals."""
    equation = rx.Equation(
        rx.Term(coefficient, "u"),
        -rx.Term("m", "dx", derivative=1, known=known),
        -rx.Term("c", "dx"),
        -rx.Term("k", displacement),
    )
    criterion = rx.RIEC(rx.RandomWindows(alpha, beta, 50))
    return equation, noisy(3.0, seed=seed), criterion, jax.random.key(seed)


def test_nothing_compiles_anew_for_new_numbers_in_problems_of_one_shape():
    jitted = eqx.filter_jit(fit)

    def run(seed, alpha, beta, coefficient, known):
        equation, record, criterion, key = fresh_problem(seed, alpha, beta, coefficient, known)
        again = fit(equation, record, criterion, key=key).theta
        traced = jitted(equation, record, criterion, key=key).theta
        np.testing.assert_allclose(traced, again, rtol=1e-9)

    assert functions_compiled(lambda: run(0, 0.1, 0.5, 1.0, 2.0))
    assert not functions_compiled(lambda: run(1, 0.2, 0.45, 1.5, 2.1))
    # 0-dimensional arrays in place of numbers.
    arrays = map(np.array, (0.15, 0.48, 1.2, 1.9))
    assert not functions_compiled(lambda: run(2, *arrays))


# Errors.


FREE = rx.Equation(rx.Term("m", "a"), rx.Term("k", "x"), name="free")
ERRORS = {
    "all unknown": (
        lambda: fit(FREE, record_of(), rx.DOLS()),
        "free: every coefficient is unknown.*Fix one of m, k.*--set NAME=VALUE",
    ),
    "no key": (lambda: fit(oscillator(), record_of(), windows()), r"key=jax.random.key\(seed\)"),
    "all known": (
        lambda: fit(oscillator(), record_of(), rx.DOLS(), known=TRUTH),
        "every parameter is known",
    ),
    "no record": (lambda: fit(oscillator(), [], rx.DOLS()), "at least one record"),
    "one of two records too short": (
        lambda: fit(oscillator(), [record_of(), record_of(duration=0.5)], windows(), key=KEY),
        "longer than the record, 0.5 s",
    ),
    "missing derivative": (
        lambda: fit(oscillator(), record_of().select("u", "x", "dx"), rx.DOLS()),
        "second time derivative of x, as signal 'ddx'.*--test-function hat",
    ),
    "fewer windows than parameters": (
        lambda: fit(oscillator(), record_of(), windows(2), key=KEY),
        "oscillator: the record cannot tell these apart.*--set NAME=VALUE",
    ),
}


@pytest.mark.parametrize("case", ERRORS)
def test_what_cannot_be_identified_is_refused_in_one_line_with_a_remedy(case):
    attempt, words = ERRORS[case]
    with pytest.raises(rx.RiecjaxError, match=words):
        attempt()


def test_an_equation_that_nothing_anchors_is_refused_among_others():
    cart = rx.Equation(rx.Term("m", "a"), -rx.Term(1.0, "f"), name="cart")
    loose = rx.Equation(rx.Term("p", "a"), rx.Term("q", "f"), name="loose")
    linked = rx.Equation(rx.Term("m", "f"), rx.Term("q", "a"), name="linked")
    with pytest.raises(rx.ModelError, match="loose"):
        rx.simultaneous(cart, loose).plan(set())
    assert rx.simultaneous(cart, linked).plan(set()) == [("cart + linked", ("m", "q"))]

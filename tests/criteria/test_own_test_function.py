"""A test function is one class: those of the package, and one that it does not know."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import riecjax as rx
from compiling import functions_compiled
from nightly import nightly
from riecjax.criteria.suited import criterion_for
from riecjax.criteria.test_functions import TEST_FUNCTIONS
from riecjax.settings import Fit
from riecjax.settings.kinds import TEST_FUNCTION

KEY = jax.random.key(0)
MODEL = rx.Model("any", "Any model.")


class Cosine(rx.criteria.AbstractSmoothTestFunction):
    """The weight (T / 2) cos^4(pi tau / 2) in seconds, tau from -1 to 1 over a window of length T.

    Three derivatives of it vanish at both ends, so that sums over samples are of order 4.
    """

    name = "cosine"
    row_seconds = 2  # the weight's second and the integral's

    def weight(self, tau, length):
        return 0.5 * length * jnp.cos(0.5 * jnp.pi * tau) ** 4


FREQUENCY = np.array([0.0, 0.3, 1.0, 3.7, 10.0, 42.0])
WEIGHTS = {
    "boxcar": (rx.Boxcar(), lambda t, length: 1.0),
    "hat": (rx.Hat(), lambda t, length: length / 2 - abs(t)),
    "bump": (rx.Bump(5), lambda t, length: (1 - (2 * t / length) ** 2) ** 5),
    "cosine": (Cosine(), lambda t, length: 0.5 * length * np.cos(np.pi * t / length) ** 4),
}


@pytest.mark.parametrize("name", WEIGHTS)
def test_gain_is_the_size_of_the_weights_fourier_integral(name):
    test_function, weight = WEIGHTS[name]
    lengths = np.array([0.07, 0.4])
    found = test_function.gain(FREQUENCY, lengths)
    for i, f in enumerate(FREQUENCY):
        for j, length in enumerate(lengths):
            integral, _ = scipy.integrate.quad(
                lambda t, f=f, length=length: weight(t, length) * np.cos(2 * np.pi * f * t),
                -length / 2,
                length / 2,
                limit=400,
            )
            assert found[i, j] == pytest.approx(abs(integral), rel=1e-6, abs=1e-9)


def test_a_boxcar_is_blind_at_multiples_of_its_frequency_and_the_average_is_not():
    length = np.array([0.1])
    np.testing.assert_allclose(rx.Boxcar().gain(np.array([10.0, 20, 30]), length), 0, atol=1e-9)
    frequency = np.linspace(0.5, 40, 400)
    averaged = rx.Boxcar().mean_gain(frequency, 0.1, 1.0)
    omega = 2 * np.pi * frequency
    # Half of the envelope 2 / w or more: no drop-out (Fig. 3).
    assert np.all(averaged[frequency > 2] * omega[frequency > 2] / 2 > 0.5)


@pytest.mark.parametrize("power", [1, *nightly([2])])
@pytest.mark.parametrize("name", WEIGHTS)
@pytest.mark.parametrize(("alpha", "beta"), [(0.05, 0.5), *nightly([(0.2, 0.21)])])
def test_expected_gains_are_averages_over_many_lengths(alpha, beta, name, power):
    test_function, _ = WEIGHTS[name]
    frequency = np.concatenate([[0.0], np.linspace(0.1, 60, 97)])
    length = alpha + (beta - alpha) * (np.arange(4000) + 0.5) / 4000
    brute = np.mean(test_function.gain(frequency, length) ** power, axis=1)
    found = test_function.mean_gain(frequency, alpha, beta, power)
    np.testing.assert_allclose(found, brute, rtol=1e-4, atol=1e-6 * brute[0])


def oscillator() -> tuple[rx.Equation, rx.Record]:
    """m x'' + d x' + k x = u with m = 2, d = 0.7, k = 30, of which only x and u are recorded."""
    t = np.linspace(0.0, 8.0, 3201)
    x = np.sin(3 * t) + 0.3 * np.cos(11 * t)
    dx = 3 * np.cos(3 * t) - 3.3 * np.sin(11 * t)
    ddx = -9 * np.sin(3 * t) - 36.3 * np.cos(11 * t)
    force = 2 * ddx + 0.7 * dx + 30 * x
    equation = rx.Equation(
        rx.Term("m", "x", derivative=2),
        rx.Term("d", "x", derivative=1),
        rx.Term("k", "x"),
        -rx.Term(1.0, "u", unit="N"),
        unit="N",
        name="oscillator",
    )
    return equation, rx.Record({"x": x, "u": force}, t[1] - t[0])


@pytest.mark.parametrize("windows", [rx.AllWindows(0.2, 0.8), rx.RandomWindows(0.2, 0.8, 300)])
def test_it_identifies_from_positions(windows):
    equation, record = oscillator()
    criterion = rx.RIEC(windows, Cosine())
    estimate = rx.identify(equation, record, criterion, key=KEY, intervals=rx.Naive())
    assert [float(estimate[name]) for name in "mdk"] == pytest.approx([2.0, 0.7, 30.0], rel=1e-4)
    assert estimate.criterion.describe()["test_function"] == "cosine"


def test_a_weight_is_compiled_for_few_lengths():
    equation, record = oscillator()
    criterion = rx.RIEC(rx.AllWindows(0.2, 0.8), Cosine())
    jax.clear_caches()
    compiled = functions_compiled(
        lambda: rx.identify(equation, record, criterion, intervals=rx.Naive())
    )
    # Of 32 lengths: once for each power of two of samples, and each operation.
    assert 0 < len(compiled) < 3 * 32


def test_the_command_line_offers_the_test_functions_that_are_there():
    assert {*TEST_FUNCTION.choices} == {"auto", *TEST_FUNCTIONS}
    model = rx.staged(rx.Equation(rx.Term("m", "x", derivative=2), -rx.Term(1.0, "F")))
    for name in TEST_FUNCTIONS:
        criterion = criterion_for(Fit(test_function=name), model, ())
        assert criterion is not None
        assert criterion.describe()["test_function"] == name
    finer = criterion_for(Fit(test_function="hat", quadrature="6"), model, ())
    assert finer == rx.RIEC.of_band((1.0, 10.0), rx.Hat(6))

import numpy as np
import pytest
import scipy.integrate

from riecjax.criteria.test_functions import Boxcar, Bump, Hat, expected_gain

FREQUENCY = np.array([0.0, 0.3, 1.0, 3.7, 10.0, 42.0])
WEIGHTS = {
    "boxcar": (Boxcar(), lambda t, length: 1.0),
    "hat": (Hat(), lambda t, length: length / 2 - abs(t)),
    "bump": (Bump(5), lambda t, length: (1 - (2 * t / length) ** 2) ** 5),
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
    np.testing.assert_allclose(Boxcar().gain(np.array([10.0, 20, 30]), length), 0, atol=1e-9)
    frequency = np.linspace(0.5, 40, 400)
    averaged = expected_gain(frequency, 0.1, 1.0, Boxcar())
    omega = 2 * np.pi * frequency
    # Half of the envelope 2 / w or more: no drop-out (Fig. 3).
    assert np.all(averaged[frequency > 2] * omega[frequency > 2] / 2 > 0.5)


@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize("name", WEIGHTS)
@pytest.mark.parametrize(("alpha", "beta"), [(0.05, 0.5), (0.2, 0.21)])
def test_expected_gains_are_averages_over_many_lengths(alpha, beta, name, power):
    test_function, _ = WEIGHTS[name]
    frequency = np.concatenate([[0.0], np.linspace(0.1, 60, 97)])
    length = alpha + (beta - alpha) * (np.arange(20_000) + 0.5) / 20_000
    brute = np.mean(test_function.gain(frequency, length) ** power, axis=1)
    found = expected_gain(frequency, alpha, beta, test_function, power=power)
    np.testing.assert_allclose(found, brute, rtol=1e-4, atol=1e-6 * brute[0])

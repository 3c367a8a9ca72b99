import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from riecjax.criteria.quadrature import ORDERS, interval_weights, running_integral


def samples_of(function, count, last=2.0):
    t = np.linspace(0.0, last, count)
    return t, jnp.asarray(function(t))[None, :]


@pytest.mark.parametrize("order", ORDERS)
def test_the_running_integral_converges_with_its_stated_order(order):
    def largest_error(count):
        t, samples = samples_of(lambda t: np.exp(np.sin(3 * t)), count)
        fine = np.linspace(0.0, 2.0, 200 * (count - 1) + 1)
        exact = scipy.integrate.cumulative_simpson(np.exp(np.sin(3 * fine)), x=fine, initial=0)
        integral = running_integral(samples, order)[0] * (t[1] - t[0])
        return np.max(np.abs(integral - exact[::200]))

    coarse, fine = largest_error(33), largest_error(65)
    assert np.log2(coarse / fine) > order - 0.6
    assert largest_error(65) < 2e-3 * 10.0 ** (2 - order)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("count", [2, 3, 5, 8, 20])
def test_polynomials_below_the_order_are_integrated_exactly(order, count):
    possible = min(order, 2 * (count // 2))
    for power in range(possible):
        t, samples = samples_of(lambda t, power=power: t**power, count)
        integral = running_integral(samples, order)[0] * (t[1] - t[0])
        np.testing.assert_allclose(integral, t ** (power + 1) / (power + 1), atol=1e-12)


def test_two_points_make_the_trapezoid_and_four_the_known_weights():
    np.testing.assert_allclose(interval_weights(2, 0), [0.5, 0.5])
    np.testing.assert_allclose(interval_weights(4, 1), np.array([-1, 13, 13, -1]) / 24)
    np.testing.assert_allclose(interval_weights(4, 0), np.array([9, 19, -5, 1]) / 24)


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

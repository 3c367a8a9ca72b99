import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.equations.bases import Polynomial, roof
from riecjax.errors import ModelError

POINTS = [[-1.0, 2.0], [-0.8, -0.3, 0.3, 0.8], [0.0, 0.1, 1.0, 5.0, 5.5]]


def inside_and_outside(points):
    return np.linspace(points[0] - 2, points[-1] + 2, 401)


@pytest.mark.parametrize("points", POINTS)
def test_roof_functions_sum_to_one_everywhere(points):
    values = roof(points)(inside_and_outside(points))
    np.testing.assert_allclose(values.sum(0), 1.0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("points", POINTS)
def test_roof_functions_equal_numpy_interpolation_of_unit_vectors_inside(points):
    x = np.linspace(points[0], points[-1], 333)
    expected = [np.interp(x, points, unit) for unit in np.eye(len(points))]
    np.testing.assert_allclose(roof(points)(x), expected, rtol=0, atol=1e-14)


def test_the_end_segments_continue_outside():
    points, forces = [-1.0, 0.0, 2.0], np.array([-3.0, 1.0, 2.0])
    x = np.array([-5.0, -1.5, 2.5, 10.0])
    expected = np.where(x < 0, 1 + 4 * x, 1 + 0.5 * x)
    np.testing.assert_allclose(forces @ roof(points)(jnp.array(x)), expected, rtol=1e-14)


@pytest.mark.parametrize("points", POINTS)
def test_interpolate_equals_the_sum_of_roof_functions(points):
    values = jnp.array(np.random.default_rng(0).normal(size=len(points)))
    x = inside_and_outside(points)
    summed = np.asarray(values) @ np.asarray(roof(points)(x))
    np.testing.assert_allclose(roof(points).interpolate(values, x), summed, rtol=0, atol=1e-12)


def test_break_points_may_be_traced_and_differentiated():
    def force(points):
        return jnp.sum(roof(points).interpolate(jnp.array([0.0, 1.0]), jnp.array(0.25)))

    # x / b at b = 1 and x = 1/4 has the derivative -x / b^2 over b.
    gradient = jax.grad(force)(jnp.array([0.0, 1.0]))
    assert float(gradient[1]) == pytest.approx(-0.25)


@pytest.mark.parametrize(
    "points", [[0.0], [], [0.0, 0.0], [0.0, 2.0, 1.0], [[0.0, 1.0]], [0.0, float("nan"), 1.0]]
)
def test_bad_break_points_are_refused(points):
    with pytest.raises(ModelError, match="break points"):
        roof(points)


def test_polynomials_are_powers():
    x = np.linspace(-2, 2, 9)
    basis = Polynomial((0, 1, 3))
    np.testing.assert_allclose(basis(jnp.array(x)), np.stack([x**0, x, x**3]))
    assert basis.labels == ("0", "1", "3")

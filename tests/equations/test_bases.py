"""Bases and expressions, held against their formulas."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.equations.bases import DeadZone, Polynomial, Saturation, Stribeck, friction, roof
from riecjax.equations.expressions import constant, difference, even, faster_than, odd, product
from riecjax.equations.term import Term
from riecjax.errors import ModelError
from riecjax.records.record import Record, Signals

POINTS = [[-1.0, 2.0], [-0.8, -0.3, 0.3, 0.8], [0.0, 0.1, 1.0, 5.0, 5.5]]


def inside_and_outside(points):
    return np.linspace(points[0] - 2, points[-1] + 2, 401)


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


X = jnp.array([-3.0, -0.5, -0.1, 0.0, 0.1, 0.5, 3.0])


def test_a_dead_zone_is_what_saturation_leaves():
    assert np.allclose(DeadZone(0.4)(X), [[-2.6, -0.1, 0, 0, 0, 0.1, 2.6]])
    assert np.allclose(DeadZone(0.4)(X) + Saturation(0.4)(X), X[None])


@pytest.mark.parametrize("law", [DeadZone, Saturation, Stribeck])
def test_widths_are_positive_and_compile_nothing_anew(law):
    with pytest.raises(ModelError, match="a width must be positive; got -1"):
        law(-1.0)
    calls = []

    @jax.jit
    def sampled(shape):
        calls.append(shape)
        return shape(X)

    assert not np.allclose(sampled(law(0.2)), sampled(law(0.3)))
    assert len(calls) == 1


@pytest.mark.parametrize(
    ("power", "of_odd", "of_even"),
    [
        (0, lambda x: np.sign(x), lambda x: np.ones_like(x)),
        (1, lambda x: x, lambda x: np.abs(x)),
        (2, lambda x: x * np.abs(x), lambda x: x**2),
        (3, lambda x: x**3, lambda x: np.abs(x) ** 3),
        (5, lambda x: x**5, lambda x: np.abs(x) ** 5),
    ],
)
def test_odd_and_even_powers(power, of_odd, of_even):
    signals, x = Signals({"v": X}), np.asarray(X)
    assert np.allclose(odd("v", power)(signals), of_odd(x))
    assert np.allclose(even("v", power)(signals), of_even(x))
    assert odd("v", power) == odd("v", power) != even("v", power)


VELOCITY = jnp.array([-2.0, -0.5, 0.0, 0.5, 2.0])


def test_asymmetric_friction_splits_by_direction_and_sums_to_the_symmetric_one():
    basis = friction(asymmetric=True)
    assert basis.labels == ("viscous_pos", "coulomb_pos", "viscous_neg", "coulomb_neg")
    values = basis(VELOCITY)
    np.testing.assert_array_equal(values[0] + values[2], VELOCITY)
    np.testing.assert_array_equal(values[1] + values[3], np.sign(VELOCITY))
    assert not np.any(values[:2, :3])
    assert not np.any(values[2:, 2:])


def test_stribeck_friction_falls_by_e_at_its_speed():
    basis = friction(stribeck=0.5)
    assert basis.labels[-1] == "stribeck"
    np.testing.assert_allclose(basis(VELOCITY)[-1, 3], np.exp(-1))
    np.testing.assert_allclose(basis(VELOCITY)[-1, 1], -np.exp(-1))


def test_expressions_compute_what_they_say_and_compare_by_it():
    record = Record.from_samples({"a": [1.0, -2, 3], "b": [4.0, 5, 6]}, time_step=1.0)
    signals = record.signals
    np.testing.assert_array_equal(product("a", "b")(signals), [4, -10, 18])
    np.testing.assert_array_equal(difference("a", "b")(signals), [-3, -7, -3])
    np.testing.assert_array_equal(faster_than("a", 1.5)(signals), [False, True, True])
    np.testing.assert_array_equal(constant(signals), [1, 1, 1])
    assert product("a", "b") == product("a", "b")
    assert hash(faster_than("a", 1.5)) == hash(faster_than("a", 1.5))


def test_a_number_made_of_a_signal_is_a_slip():
    record = Record.from_samples({"a": [1.0, 2.0, 3.0]}, time_step=1.0)
    with pytest.raises(ModelError, match="one number for each of the 3 samples"):
        Term("c", lambda s: jnp.sum(s["a"])).samples(record, 0)

"""Equation errors of samples, against quadrature of motions in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.criteria.test_functions import Boxcar, Hat
from riecjax.criteria.windows import WindowSet
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import constant
from riecjax.equations.noisy_columns import sampled_columns
from riecjax.equations.term import Term
from riecjax.errors import DataError, ModelError
from riecjax.records.record import Record
from riecjax.records.signal import Signal
from riecjax.validation.equation_errors import equation_error, errors_over_records, joined
from riecjax.validation.residuals import residual_tests

STEP, W = 0.01, 2 * np.pi * 3
TIME = STEP * np.arange(400)


def velocity_equation() -> Equation:
    """m v' + c v = F."""
    return Equation(
        Term("m", "v", derivative=1, unit="kg"),
        Term("c", "v", unit="N s/m"),
        -Term(1.0, "F", unit="N"),
        name="mass",
        unit="N",
    )


def position_equation() -> Equation:
    """m x'' + k x = F."""
    return Equation(
        Term("m", "x", derivative=2, measured=("dx", "ddx"), unit="kg"),
        Term("k", "x", unit="N/m"),
        -Term(1.0, "F", unit="N"),
        unit="N",
    )


def oscillation(**extra) -> Record:
    """x = sin(W t), with the force that m = 2, c = 3 needs, and a part left out."""
    x, v = np.sin(W * TIME), W * np.cos(W * TIME)
    force = 2 * (-(W**2) * x) + 3 * v + 5 * np.cos(7 * TIME)
    return Record({"x": x, "v": v, "F": force, **extra}, STEP)


def mean_over(weight, function):
    """Mean of a function under a weight on (0, 1) from each sample on, by Gauss's quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    place = 0.5 * (nodes + 1)
    span = 1 if weight is None else 2
    at = TIME[:-span, None] + span * STEP * place[None, :]
    under = weights / 2 if weight is None else weights / 2 * weight(place)
    return function(at) @ under


def test_error_and_explained_part_are_means_over_each_sample_interval():
    (found,) = equation_error(velocity_equation(), oscillation(), {"m": 2.0, "c": 3.0})
    left_out = mean_over(None, lambda t: 5 * np.cos(7 * t))
    motion = mean_over(None, lambda t: -2 * W**2 * np.sin(W * t) + 3 * W * np.cos(W * t))
    np.testing.assert_allclose(found.error, left_out, atol=1e-5)
    np.testing.assert_allclose(found.explained, motion, atol=1e-5)
    np.testing.assert_allclose(found.target, left_out + motion, atol=1e-5)
    assert (found.span, found.name, found.unit) == (1, "mass", "N")
    assert bool(jnp.all(found.present))
    expected = np.sqrt(np.sum(left_out**2) / np.sum((left_out + motion) ** 2))
    assert float(found.relative_rms) == pytest.approx(expected, rel=1e-6)


def test_a_second_derivative_is_moved_onto_a_triangle_of_two_samples():
    record = oscillation().select("x", "F")
    (found,) = equation_error(position_equation(), record, {"m": 2.0, "k": 10.0})

    def triangle(place):
        return 2 * (1 - np.abs(2 * place - 1))

    def force(t):
        return -2 * W**2 * np.sin(W * t) + 3 * W * np.cos(W * t) + 5 * np.cos(7 * t)

    target = mean_over(triangle, force)
    explained = mean_over(triangle, lambda t: (10 - 2 * W**2) * np.sin(W * t))
    assert found.span == 2
    # The triangle has a corner inside the interval, which Gauss's nodes see.
    np.testing.assert_allclose(found.target, target, atol=2e-3 * np.max(np.abs(target)))
    np.testing.assert_allclose(found.explained, explained, atol=2e-3 * np.max(np.abs(target)))


@pytest.mark.parametrize("weight", [Boxcar(8), Hat(8)])
def test_rises_of_the_impulse_are_the_errors_of_windows(weight):
    equation = velocity_equation() if isinstance(weight, Boxcar) else position_equation()
    record = oscillation() if isinstance(weight, Boxcar) else oscillation().select("x", "F")
    values = {"m": 1.7, "c": 2.0, "k": 11.0}
    (found,) = equation_error(equation, record, values)
    start, stop = jnp.array([0, 10, 200]), jnp.array([40, 16, 390])
    columns, _ = weight.integrals(
        sampled_columns(equation, record, weight.smoothness), WindowSet(start, stop)
    )
    theta = jnp.array([values[name] for name in equation.parameters])
    whole = columns[0] - theta @ columns[1:]
    impulse = np.concatenate([[0.0], found.impulse])
    if found.span == 1:
        rises = impulse[stop] - impulse[start]
    else:
        twice = np.concatenate([[0.0], np.cumsum(impulse[1:] * STEP)])
        # A hat over 2 L is made of hats over two samples, as a second running sum.
        middle = (start + stop) // 2
        rises = twice[stop - 1] - 2 * twice[middle - 1] + np.where(start > 0, twice[start - 1], 0)
    np.testing.assert_allclose(rises, whole, rtol=1e-6, atol=1e-8)


def test_missing_samples_are_not_present_and_touch_no_other():
    gap = np.zeros(400, bool)
    gap[100:103] = True
    whole = oscillation()
    record = whole.with_signals({"F": Signal(whole["F"], ~gap)})
    values = {"m": 2.0, "c": 3.0}
    (found,) = equation_error(velocity_equation(), record, values)
    (intact,) = equation_error(velocity_equation(), whole, values)
    there = ~(gap[1:] | gap[:-1])
    np.testing.assert_array_equal(found.present, there)
    np.testing.assert_array_equal(found.error[~there], 0)
    # Quadrature falls back to the trapezoid beside a gap, which is 0.3 % off here.
    most = float(jnp.max(jnp.abs(intact.target)))
    np.testing.assert_allclose(found.error[there], intact.error[there], atol=0.004 * most)
    np.testing.assert_allclose(found.error[110:], intact.error[110:], atol=1e-8)


def test_records_are_joined_with_a_gap_and_take_their_own_parameters():
    model = Equation(*velocity_equation().terms, Term("offset", constant), name="mass")
    records = [oscillation(), oscillation()]
    records[1] = records[1].with_signals({"F": records[1]["F"] + 6.0})
    values = {"m": 2.0, "c": 3.0, "offset[1]": 0.0, "offset[2]": 6.0}
    (parts,) = errors_over_records(model, records, values)
    np.testing.assert_allclose(parts[0].error, parts[1].error, atol=1e-9)
    whole = joined(parts)
    assert whole.error.shape == (2 * 399 + 1,)
    assert int(jnp.sum(~whole.present)) == 1
    np.testing.assert_array_equal(whole.error[399 + 1 :], parts[1].error)


def test_what_cannot_be_computed_says_so():
    with pytest.raises(ModelError, match="needs a value of 'c'"):
        equation_error(velocity_equation(), oscillation(), {"m": 2.0})
    with pytest.raises(DataError, match="2 samples has no equation error"):
        equation_error(velocity_equation(), oscillation().part(0, 2), {"m": 2.0, "c": 1.0})
    slow = Record(oscillation().arrays, 0.02)
    with pytest.raises(DataError, match="one time step"):
        residual_tests(velocity_equation(), [oscillation(), slow], {"m": 2.0, "c": 1.0})

"""Eq. (28) by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.records.record import Record
from riecjax.validation.goodness_of_fit import Validation, percentage_error, validate


def test_error_of_three_four_five_is_as_by_hand():
    # Difference (3, 4), measured (6, 8): 100 * 5 / 10.
    found = percentage_error(jnp.array([9.0, 12.0]), jnp.array([6.0, 8.0]))
    np.testing.assert_allclose(found, 50.0, rtol=1e-15)


@pytest.mark.parametrize(("factor", "percent"), [(1.0, 0.0), (0.0, 100.0), (-1.0, 200.0)])
def test_scaling_a_signal_by_a_factor_costs_its_distance_from_one(factor, percent):
    measured = jnp.asarray(np.random.default_rng(0).normal(size=50))
    np.testing.assert_allclose(percentage_error(factor * measured, measured), percent, rtol=1e-14)


def test_error_does_not_depend_on_units_and_is_relative_to_the_measured_signal():
    rng = np.random.default_rng(1)
    predicted, measured = jnp.asarray(rng.normal(size=(2, 50)))
    found = percentage_error(predicted, measured)
    np.testing.assert_allclose(percentage_error(1e3 * predicted, 1e3 * measured), found)
    swapped = percentage_error(measured, predicted)
    norms = np.linalg.norm(predicted) / np.linalg.norm(measured)
    np.testing.assert_allclose(swapped * norms, found)
    assert abs(norms - 1) > 0.01


def test_batches_are_taken_over_the_last_axis():
    rng = np.random.default_rng(2)
    predicted, measured = rng.normal(size=(2, 3, 4, 20))
    found = percentage_error(jnp.asarray(predicted), jnp.asarray(measured))
    expected = 100 * np.linalg.norm(predicted - measured, axis=-1)
    np.testing.assert_allclose(found, expected / np.linalg.norm(measured, axis=-1))
    assert found.shape == (3, 4)


def test_gradient_points_along_the_error():
    measured = jnp.array([6.0, 8.0])
    gradient = jax.grad(percentage_error)(jnp.array([9.0, 12.0]), measured)
    np.testing.assert_allclose(gradient, 100 * np.array([3.0, 4.0]) / 5 / 10)


def records() -> tuple[Record, Record]:
    rng = np.random.default_rng(3)
    names = ("x1", "x2", "x3")
    made = [Record({name: rng.normal(size=30) for name in names}, 0.1) for _ in range(2)]
    return made[0], made[1]


def test_validate_gives_each_asked_signal_and_total_is_their_sum():
    predicted, measured = records()
    found = validate(predicted, measured, ["x3", "x1"])
    assert list(found) == ["x3", "x1"]
    expected = {
        s: 100 * np.linalg.norm(predicted[s] - measured[s]) / np.linalg.norm(measured[s])
        for s in found
    }
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value)
    np.testing.assert_allclose(found.total, sum(expected.values()))


def test_total_of_nothing_is_zero():
    assert float(Validation().total) == 0.0


@pytest.mark.parametrize("side", [0, 1])
def test_a_signal_missing_on_either_side_is_a_data_error(side):
    pair = list(records())
    pair[side] = pair[side].select("x1")
    with pytest.raises(DataError, match="no signal 'x2'"):
        validate(pair[0], pair[1], ["x1", "x2"])

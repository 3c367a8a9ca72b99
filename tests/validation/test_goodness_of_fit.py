"""Eq. (28), fit and variance accounted for, by hand and against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.records.record import Record
from riecjax.validation.held_out import (
    nrmse_fit,
    percentage_error,
    validate,
    variance_accounted_for,
)

MEASURES = (nrmse_fit, variance_accounted_for, percentage_error)


def pair(seed: int = 0, shape: tuple[int, ...] = (60,)) -> tuple[jax.Array, jax.Array]:
    rng = np.random.default_rng(seed)
    measured = 5 + rng.normal(size=shape)
    return jnp.asarray(measured + 0.3 * rng.normal(size=shape) + 0.2), jnp.asarray(measured)


@pytest.mark.parametrize(
    ("measure", "predicted", "measured", "expected"),
    [
        # About the mean 3: (-2, 0, 2), of length sqrt 8; the error (1, 0, 1) of length sqrt 2.
        (nrmse_fit, [2.0, 3.0, 6.0], [1.0, 3.0, 5.0], 50.0),
        # Error (1, 0, 1): variance 2/9; measured 8/3.
        (variance_accounted_for, [2.0, 3.0, 6.0], [1.0, 3.0, 5.0], 100 * (1 - (2 / 9) / (8 / 3))),
        # Difference (3, 4), measured (6, 8): 100 * 5 / 10.
        (percentage_error, [9.0, 12.0], [6.0, 8.0], 50.0),
    ],
)
def test_measures_are_as_by_hand(measure, predicted, measured, expected):
    found = measure(jnp.array(predicted), jnp.array(measured))
    np.testing.assert_allclose(found, expected, rtol=1e-14)


@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize("shape", [(60,), (2, 60)])
def test_missing_samples_are_as_if_they_were_not_there(measure, shape):
    predicted, measured = pair(2, shape)
    present = np.random.default_rng(3).uniform(size=60) > 0.3
    spoiled = jnp.where(jnp.broadcast_to(jnp.asarray(present), shape), measured, 1e6)
    found = measure(predicted, spoiled, jnp.asarray(present))
    expected = measure(predicted[..., present], measured[..., present])
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("measure", [nrmse_fit, variance_accounted_for])
def test_of_a_signal_that_does_not_vary_it_is_not_a_number(measure):
    assert np.isnan(measure(jnp.arange(5.0), jnp.full(5, 2.0)))


def test_derivative_of_the_fit_is_finite_at_perfection_and_right_elsewhere():
    predicted, measured = pair(4)
    assert np.all(np.isfinite(jax.grad(nrmse_fit)(measured, measured)))
    h = 1e-6
    ends = [nrmse_fit(predicted + s * h, measured) for s in (1, -1)]
    slope = jnp.sum(jax.grad(nrmse_fit)(predicted, measured))
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * h), rtol=1e-6)


def test_validate_gives_each_signal_and_leaves_out_what_either_record_lacks():
    predicted, measured = (np.asarray(x).copy() for x in pair(5))
    holes = measured.copy()
    holes[[4, 5, 30]] = np.nan
    made, held = ({"x": x, "y": 2 * x} for x in (predicted, measured))
    one = Record.from_samples(made, time_step=0.1)
    other = Record.from_samples(held | {"x": holes}, time_step=0.1)
    keep = ~np.isnan(holes)
    error = 100 * np.linalg.norm((predicted - measured)[keep])
    whole = 100 * np.linalg.norm(predicted - measured) / np.linalg.norm(measured)
    found = validate(one, other, ["y", "x"])
    assert list(found) == ["y", "x"]
    np.testing.assert_allclose(found["x"], error / np.linalg.norm(measured[keep]), rtol=1e-13)
    np.testing.assert_allclose(found["y"], whole, rtol=1e-13)
    np.testing.assert_allclose(found.total, found["x"] + found["y"])
    swapped = validate(other, one, ["x"])["x"]
    np.testing.assert_allclose(swapped, error / np.linalg.norm(predicted[keep]), rtol=1e-13)


@pytest.mark.parametrize("side", [0, 1])
def test_a_signal_missing_on_either_side_is_a_data_error(side):
    pair = [Record({"x": np.ones(9), "y": np.ones(9)}, 0.1)] * 2
    pair[side] = pair[side].select("x")
    with pytest.raises(DataError, match="no signal 'y'"):
        validate(pair[0], pair[1], ["x", "y"])

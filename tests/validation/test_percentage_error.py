"""Eq. (28) by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.records.record import Record
from riecjax.validation.goodness_of_fit import percentage_error, validate


def test_error_of_three_four_five_is_as_by_hand():
    # Difference (3, 4), measured (6, 8): 100 * 5 / 10.
    found = percentage_error(jnp.array([9.0, 12.0]), jnp.array([6.0, 8.0]))
    np.testing.assert_allclose(found, 50.0, rtol=1e-15)


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


@pytest.mark.parametrize("side", [0, 1])
def test_a_signal_missing_on_either_side_is_a_data_error(side):
    pair = list(records())
    pair[side] = pair[side].select("x1")
    with pytest.raises(DataError, match="no signal 'x2'"):
        validate(pair[0], pair[1], ["x1", "x2"])

import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.criteria.criterion import DOLS
from riecjax.equations.bases import friction
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import constant, difference, faster_than, product
from riecjax.equations.term import Term, Terms
from riecjax.errors import ModelError
from riecjax.estimation.identify import identify
from riecjax.records.record import Record

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


@pytest.mark.parametrize("settings", [dict(stribeck=0.0), dict(smooth=-1.0)])
def test_speeds_must_be_positive(settings):
    with pytest.raises(ModelError, match="must be positive"):
        friction(**settings)


def test_friction_of_a_known_machine_is_found_again():
    t = 0.001 * np.arange(6000)
    v, a = 0.3 * np.cos(2 * t), -0.6 * np.sin(2 * t)
    force = 4.0 * a + 9.0 * v + 2.0 * np.sign(v) + 1.5 * np.sign(v) * np.exp(-((v / 0.05) ** 2))
    record = Record.from_samples({"v": v, "a": a, "F": force}, time_step=0.001)
    equation = Equation(
        Term("M", "v", derivative=1, measured=("a",), unit="kg"),
        Terms("f", friction(stribeck=0.05), "v", unit=("N s/m", "N", "N")),
        -Term(1.0, "F"),
    )
    estimate = identify(equation, record, DOLS())
    np.testing.assert_allclose(estimate.theta, [4.0, 9.0, 2.0, 1.5], rtol=1e-9)
    assert equation.units == {"M": "kg", "f_viscous": "N s/m", "f_coulomb": "N", "f_stribeck": "N"}


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

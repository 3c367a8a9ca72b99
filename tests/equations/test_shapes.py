"""Laws with a width, held against their formulas."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.equations.bases import DeadZone, Saturation, Stribeck
from riecjax.equations.expressions import even, odd
from riecjax.errors import ModelError
from riecjax.records.signals import Signals

X = jnp.array([-3.0, -0.5, -0.1, 0.0, 0.1, 0.5, 3.0])


def test_a_dead_zone_is_what_saturation_leaves():
    assert np.allclose(DeadZone(0.4)(X), [[-2.6, -0.1, 0, 0, 0, 0.1, 2.6]])
    assert np.allclose(DeadZone(0.4)(X) + Saturation(0.4)(X), X[None])


def test_stribecks_friction_falls_off_with_speed():
    found = np.asarray(Stribeck(0.5)(X))[0]
    assert np.allclose(found, np.sign(X) * np.exp(-((X / 0.5) ** 2)))


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


def test_powers_are_called_as_one_writes_them():
    assert [odd("v", p).__name__ for p in range(5)] == [
        "sign(v)",
        "v",
        "v |v|",
        "v^3",
        "v |v|^3",
    ]
    assert [even("v", p).__name__ for p in (1, 2, 3)] == ["|v|", "v^2", "|v|^3"]
    assert odd("v", 2).source == 'odd("v", 2)'

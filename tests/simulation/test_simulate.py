"""What simulate() promises: its stated accuracy, its signals, its status and its derivatives."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from nightly import nightly
from riecjax.errors import SimulationError
from riecjax.models.quarter_car.reconstruction import quarter_car_source
from riecjax.records.record import Record
from riecjax.simulation.inputs import band_limited_noise
from riecjax.simulation.method import Adaptive, FixedStep
from riecjax.simulation.simulate import simulate
from riecjax.simulation.system import AbstractSystem

STEP = 0.005
STATES = ("x1", "x2", "x3", "x4", "x5", "x6", "x7")
STATED_ACCURACY = 2e-4
"""Of the default method on the source model, from the docstring of simulate()."""


def source():
    return quarter_car_source()


def road(seed: int, count: int = 8000, step: float = STEP) -> Record:
    key = jax.random.key(seed)
    return Record({"v_r": band_limited_noise(key, count, step, bandwidth=30.0, rms=0.55)}, step)


@pytest.mark.slow
def test_default_accuracy_is_as_stated_against_the_adaptive_method():
    """Of which tests of methods show that it is SciPy's solution."""
    found = simulate(source(), road(0)).checked().record
    truth = simulate(source(), road(0), method=Adaptive(1e-10, 1e-13)).checked().record
    for state in STATES:
        off = np.max(np.abs(np.asarray(found[state]) - truth[state])[:800])
        assert off < STATED_ACCURACY * np.max(np.abs(truth[state])), state


def test_record_holds_inputs_states_derivatives_and_outputs_at_the_samples():
    system, inputs = source(), road(1, 400)
    record = simulate(system, inputs).record
    names = [f"x{i}" for i in range(1, 8)]
    assert set(record.arrays) == {"v_r", "F_t", *names, *(f"d{n}" for n in names)}
    np.testing.assert_array_equal(record["v_r"], inputs["v_r"])
    right_hand_side = jax.jit(lambda x, u: (system.derivative(x, u), system.output(x, u)["F_t"]))
    signals = {name: np.asarray(samples) for name, samples in record.arrays.items()}
    for sample in range(0, 400, 37):
        state = np.array([signals[name][sample] for name in names])
        derivative, tyre_force = right_hand_side(state, signals["v_r"][sample : sample + 1])
        rates = [signals[f"d{name}"][sample] for name in names]
        np.testing.assert_allclose(rates, derivative, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(signals["F_t"][sample], tyre_force, rtol=1e-12)


class Cubic(AbstractSystem):
    """x' = gain x^3; from 1 it is infinite after 1 / (2 gain) s."""

    gain: Float[Array, ""]

    states: ClassVar = (("x", ""),)
    inputs: ClassVar = (("u", ""),)

    def derivative(self, state, inputs):
        return self.gain * state**3 + inputs


def cubic(gain, method=None):
    inputs = Record({"u": np.zeros(30)}, 0.1)
    return simulate(Cubic(gain), inputs, initial_state={"x": 1.0}, method=method)


@pytest.mark.parametrize(
    "method", [None, Adaptive(1e-6, 1e-9, max_steps=2000)], ids=["fixed", "adaptive"]
)
def test_checked_raises_one_line_that_says_when_and_what_to_do(method):
    lost = cubic(jnp.array(1 / 1.1), method)
    assert not bool(lost.successful)
    with pytest.raises(SimulationError, match=r"^[^\n]*after 0\.5 s[^\n]*steps[^\n]*\.$"):
        lost.checked()


class Counting(AbstractSystem):
    """A decay that counts how often Python runs its right-hand side: how often it is traced."""

    rate: Float[Array, ""]

    states: ClassVar = (("x", ""),)
    inputs: ClassVar = (("u", ""),)
    calls: ClassVar[list[int]] = []

    def derivative(self, state, inputs):
        self.calls.append(1)
        return inputs - self.rate * state


@pytest.mark.parametrize(
    "make_method",
    [
        lambda: None,
        lambda: FixedStep(3),
        *nightly([lambda: Adaptive(1e-5, 1e-7)]),
    ],
    ids=["default", "fixed", "adaptive"],
)
def test_new_values_of_the_same_shape_do_not_compile_anew(make_method):
    def once(rate, seed, step, start):
        u = np.random.default_rng(seed).normal(size=40)
        return simulate(
            Counting(jnp.asarray(rate)),
            Record({"u": u}, step),
            method=make_method(),
            initial_state={"x": start},
        )

    once(1.0, 0, 0.1, 0.0)
    traced = len(Counting.calls)
    assert traced > 0
    once(2.0, 1, 0.1, 0.0)
    once(3.0, 2, 0.05, 0.5)
    assert len(Counting.calls) == traced

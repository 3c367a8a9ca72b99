"""A mass that is pushed by a slow tone, and by a fast one at which it seems half as heavy again.

Windows as long as the fast tone's period do not see it, so that the best law is known.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from riecjax.criteria.criterion import RIEC
from riecjax.criteria.laws import RatioLaw
from riecjax.criteria.test_functions import Boxcar
from riecjax.criteria.windows import AllWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.errors import DataError, ModelError
from riecjax.estimation.identify import identify
from riecjax.records.record import Record, stack_records
from riecjax.simulation.system import AbstractSystem, Quantities
from riecjax.studies.law_learning import (
    as_prediction,
    learn_law,
    mean_error,
    validation_errors,
)

COUNT, STEP = 600, 0.01
SLOW, FAST, MASS = 0.5, 2.5, 2.0
ALPHA, BETA = 0.1, 0.7
EQUATION = Equation(Term("m", "v", derivative=1, measured=("a",)), -Term(1.0, "f"), name="push")


class Mass(AbstractSystem):
    """m v' = f."""

    m: Float[Array, ""]
    states: ClassVar[Quantities] = (("v", "m/s"),)
    inputs: ClassVar[Quantities] = (("f", "N"),)

    def derivative(self, state, inputs):
        return inputs / self.m


def build(values) -> Mass:
    return Mass(values["m"])


def tone(frequency: float, phase: float) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and acceleration."""
    w, t = 2 * np.pi * frequency, STEP * np.arange(COUNT)
    return np.sin(w * t + phase), w * np.cos(w * t + phase)


def recording(phase: float, fast: float) -> Record:
    (v_slow, a_slow), (v_fast, a_fast) = tone(SLOW, phase), tone(FAST, 2 * phase)
    force = MASS * a_slow + fast * 1.5 * MASS * a_fast
    return Record({"v": v_slow + fast * v_fast, "f": force}, STEP)


def training(count: int = 2) -> list[Record]:
    return [recording(0.3 + i, 0.4) for i in range(count)]


def validation(count: int = 2) -> list[Record]:
    return [recording(1.1 + i, 0.0) for i in range(count)]


def prediction():
    return as_prediction(EQUATION, build, ("v",))


@pytest.mark.slow
def test_a_law_in_equal_ratios_is_that_density_of_lengths():
    weights = np.array([0.5, 3.0, 1.0, 0.2])
    edges = np.round(10 * (71 / 10) ** (np.arange(5) / 4))

    def density(length):
        part = jnp.searchsorted(jnp.asarray(edges), length / STEP + 1e-6, side="right") - 1
        return jnp.asarray(weights)[jnp.clip(part, 0, 3)]

    record = training(1)[0]
    ours, exact = (
        identify(EQUATION, record, RIEC(AllWindows(ALPHA, BETA, law=law))).theta
        for law in (RatioLaw(weights), density)
    )
    np.testing.assert_allclose(ours, exact, rtol=1e-10)
    plain = identify(EQUATION, record, RIEC(AllWindows(ALPHA, BETA))).theta
    assert abs(float(ours[0] / plain[0]) - 1) > 1e-3  # the law makes a difference


def test_parts_meet_weigh_one_on_average_and_may_be_empty():
    law = RatioLaw(np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0]))
    bins = law.bins(jnp.array(2), jnp.array(9), jnp.asarray(0.01), 9)
    held = np.maximum(np.asarray(bins.last - bins.first + 1), 0)
    assert int(bins.first[0]) == 2
    assert int(bins.last[-1]) == 9
    assert held.sum() == 8
    assert 0 in held
    np.testing.assert_array_equal(bins.first[1:], bins.last[:-1] + 1)
    np.testing.assert_allclose(np.sum(held * bins.weight) / 8, 1.0, rtol=1e-12)


def test_errors_are_those_of_an_identified_mass_integrated_by_hand():
    windows = AllWindows(ALPHA, BETA)
    found = validation_errors(prediction(), training(), validation(), windows)
    for one, other, error in zip(training(), validation(), found):
        criterion = RIEC(windows, Boxcar(2))
        mass = float(identify(EQUATION, one, criterion, noise="none")["m"])
        f, v = np.asarray(other["f"]), np.asarray(other["v"])
        moved = np.concatenate([[0.0], np.cumsum((f[1:] + f[:-1]) / 2)]) * STEP / mass
        miss = np.linalg.norm(v[0] + moved - v) / np.linalg.norm(v)
        np.testing.assert_allclose(error, [100 * miss], rtol=1e-8)
        assert miss > 0.02


@pytest.mark.slow
def test_the_gradient_of_the_error_is_that_of_finite_differences():
    rng = np.random.default_rng(0)
    at, along = (jnp.asarray(rng.standard_normal(5)) for _ in range(2))
    fixed = (prediction(), stack_records(training()), stack_records(validation()))
    windows = AllWindows(ALPHA, BETA, longest_samples=80)
    error = eqx.filter_jit(lambda logits: mean_error(logits, *fixed, windows))
    differences = (error(at + 1e-5 * along) - error(at - 1e-5 * along)) / 2e-5
    np.testing.assert_allclose(jax.grad(error)(at) @ along, differences, rtol=1e-6)
    assert abs(float(differences)) > 0.01


@pytest.mark.slow
def test_the_learned_law_looks_through_windows_that_do_not_see_the_fast_tone():
    learned = learn_law(
        EQUATION,
        training(),
        validation(),
        build,
        alpha=ALPHA,
        beta=BETA,
        parts=8,
        signals=("v",),
        key=jax.random.key(0),
        starts=2,
    )
    edges = np.geomspace(0.1, 0.71, 9)
    best = int(np.argmax(learned.weights))
    assert edges[best] < 1 / FAST < edges[best + 1]
    assert float(learned.error) < 0.3 * float(learned.error_of_equal)
    assert float(learned.error) == float(jnp.min(learned.errors))
    again = validation_errors(
        prediction(), training(), validation(), AllWindows(ALPHA, BETA, law=learned.law)
    )
    np.testing.assert_allclose(jnp.mean(again), learned.error, rtol=1e-9)
    fresh = [recording(2.7 + i, 0.3) for i in range(2)]
    for record in fresh:  # of other phases, and less of the fast tone
        of_learned, of_equal = (
            abs(
                float(identify(EQUATION, record, RIEC(AllWindows(ALPHA, BETA, law=law)))["m"])
                - MASS
            )
            for law in (learned.law, None)
        )
        assert of_learned < 0.4 * of_equal


@pytest.mark.parametrize(
    ("partners", "parts", "beta", "error", "message"),
    [
        (2, 1, BETA, ModelError, "at least two parts"),
        (1, 2, BETA, DataError, "each of 2 training records"),
        (2, 2, 9.0, DataError, "longer than the record"),
    ],
)
def test_what_cannot_be_learned_from_says_why(partners, parts, beta, error, message):
    with pytest.raises(error, match=message):
        learn_law(
            EQUATION,
            training(),
            validation(partners),
            build,
            alpha=ALPHA,
            beta=beta,
            parts=parts,
            signals=("v",),
            key=jax.random.key(0),
        )

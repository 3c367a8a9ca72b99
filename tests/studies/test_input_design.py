from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from riecjax.errors import ModelError
from riecjax.models.catalogue import built_in_model
from riecjax.records.record import Record
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.refine import refine
from riecjax.simulation.inputs import band_limited_noise, harmonics, multisine
from riecjax.simulation.method import Adaptive, FixedStep
from riecjax.simulation.simulate import simulate
from riecjax.simulation.system import AbstractSystem, Quantities
from riecjax.studies.input_design import (
    DesignStatus,
    design_input,
    predicted_standard_errors,
)

COUNT, STEP, NOISE = 200, 0.05, 0.01
DRAG = {"r2": 0.5, "m": 1.5, "k": 20.0, "r": 0.8}
"""Not in the order of the alphabet, nor in that of the fields."""


class Integrator(AbstractSystem):
    """x' = gain u + drift."""

    gain: Float[Array, ""]
    drift: Float[Array, ""]
    states: ClassVar[Quantities] = (("x", "m"),)
    inputs: ClassVar[Quantities] = (("u", "m/s"),)

    def derivative(self, state, inputs):
        return self.gain * inputs[0] * jnp.ones(1) + self.drift


def integrator() -> Integrator:
    return Integrator(jnp.asarray(2.0), jnp.asarray(0.3))


def oscillator() -> AbstractSystem:
    return built_in_model("drag-oscillator").build_system(DRAG)


def noise(seed: int, rms: float = 6.0, bandwidth: float = 3.0) -> Record:
    key = jax.random.key(seed)
    return Record({"u": band_limited_noise(key, COUNT, STEP, bandwidth=bandwidth, rms=rms)}, STEP)


def best_drag_input(**changed):
    settings = {
        "frequencies": harmonics(COUNT, STEP, lowest=0.1, highest=3.0, count=12),
        "sample_count": COUNT,
        "time_step": STEP,
        "rms": 6.0,
        "channels": ("x",),
        "sigma": {"x": NOISE},
        "key": jax.random.key(0),
        "method": FixedStep(3),
        "starts": 2,
        "max_steps": 40,
    }
    values = changed.pop("values", DRAG)
    return design_input(oscillator(), values, "r2", **{**settings, **changed})


def test_a_multisine_is_the_sum_of_its_harmonics():
    rng = np.random.default_rng(0)
    frequencies = harmonics(COUNT, STEP, lowest=0.1, highest=4.0)
    np.testing.assert_allclose(frequencies, np.arange(1, 41) / 10, rtol=1e-14)
    a, phi = rng.uniform(0, 3, 40), rng.uniform(0, 7, 40)
    wave = multisine(jnp.asarray(a), jnp.asarray(phi), frequencies, COUNT, STEP)
    t = STEP * np.arange(COUNT)
    plain = sum(a[i] * np.cos(2 * np.pi * frequencies[i] * t + phi[i]) for i in range(40))
    np.testing.assert_allclose(wave, plain, atol=1e-11)
    np.testing.assert_allclose(jnp.mean(wave**2), np.sum(a**2) / 2, rtol=1e-12)


def test_information_of_a_linear_problem_is_that_of_its_regressors():
    record = noise(0)
    u = np.asarray(record["u"])
    integral = STEP * np.concatenate([[0.0], np.cumsum((u[1:] + u[:-1]) / 2)])
    regressors = np.stack([STEP * np.arange(COUNT), integral, np.ones(COUNT)], axis=1)
    bound = NOISE * np.sqrt(np.diag(np.linalg.inv(regressors.T @ regressors)))
    found = predicted_standard_errors(
        integrator(), {"gain": 2.0, "drift": 0.0}, record, channels=("x",), sigma={"x": NOISE}
    )
    np.testing.assert_allclose([found["drift"], found["gain"]], bound[:2], rtol=1e-9)
    # What is known widens nothing.
    found = predicted_standard_errors(
        integrator(), {"gain": 2.0}, record, channels=("x",), sigma={"x": NOISE}
    )
    bound = NOISE / np.sqrt(np.sum((integral - integral.mean()) ** 2))
    np.testing.assert_allclose(found["gain"], bound, rtol=1e-9)


@pytest.mark.slow
def test_output_error_has_the_errors_that_were_predicted():
    quiet = simulate(oscillator(), noise(3)).record
    predicted = predicted_standard_errors(
        oscillator(), DRAG, quiet, channels=("x",), sigma={"x": NOISE}
    )

    def estimated(key):
        x = quiet["x"] + NOISE * jax.random.normal(key, (COUNT,))
        by = OutputError(channels=("x",), sigma={"x": NOISE}, method=FixedStep(3))
        start = {name: 1.1 * value for name, value in DRAG.items()}
        fit = refine(oscillator(), Record({"u": quiet["u"], "x": x}, STEP), start, by)
        return {name: fit[name] for name in DRAG}

    found = jax.jit(jax.vmap(estimated))(jax.random.split(jax.random.key(0), 100))
    for name, error in predicted.items():
        # A standard deviation from 100 is itself known to 7 %.
        np.testing.assert_allclose(np.std(found[name], ddof=1), error, rtol=0.25)


def best_integrator_input(travel):
    return design_input(
        integrator(),
        {"gain": 2.0},
        "gain",
        known={"drift": 0.0},
        frequencies=harmonics(COUNT, STEP, lowest=0.1, highest=1.0),
        sample_count=COUNT,
        time_step=STEP,
        rms=0.5,
        travel=travel,
        channels=("x",),
        sigma={"x": NOISE},
        key=jax.random.key(1),
        method=FixedStep(1),
    )


def test_the_best_input_of_an_integrator_is_its_slowest_harmonic():
    design = best_integrator_input({})
    np.testing.assert_allclose(design.amplitudes[0], 0.5 * np.sqrt(2), rtol=1e-3)
    assert np.all(np.asarray(design.amplitudes[1:]) < 0.02)
    # Trapezoids of a sine: the integral's amplitude is a (dt / 2) / tan(w dt / 2).
    integral = 0.5 * STEP / 2 / np.tan(np.pi * 0.1 * STEP)
    np.testing.assert_allclose(design.standard_error, NOISE / integral / COUNT**0.5, rtol=1e-3)
    assert design.status == DesignStatus.converged


@pytest.mark.slow
def test_a_travel_that_cannot_be_kept_is_told():
    design = best_integrator_input({"x": 1e-3})
    assert design.status == DesignStatus.travel_exceeded
    assert float(design.peaks["x"]) > 1e-3
    assert "Lower the r.m.s." in design.reason


@pytest.mark.slow
def test_a_design_keeps_its_travel_and_rms_and_beats_noise():
    limit = 0.7
    design = best_drag_input(travel={"x": limit})
    np.testing.assert_allclose(np.sqrt(np.mean(np.asarray(design.record["u"]) ** 2)), 6.0)
    wave = multisine(design.amplitudes, design.phases, design.frequencies, COUNT, STEP)
    np.testing.assert_allclose(wave, design.record["u"], atol=1e-9)
    exact = simulate(oscillator(), design.record, method=Adaptive(1e-9, 1e-9)).record
    peak = float(jnp.max(jnp.abs(exact["x"])))
    np.testing.assert_allclose(design.peaks["x"], peak, rtol=1e-3)
    assert 0.9 * limit < peak <= limit  # the limit is what holds it back
    assert design.status in (DesignStatus.converged, DesignStatus.out_of_steps)
    of_noise = [
        predicted_standard_errors(
            oscillator(), DRAG, noise(s), channels=("x",), sigma={"x": NOISE}, method=FixedStep(3)
        )["r2"]
        for s in range(20)
    ]
    assert float(design.standard_error) < 0.5 * np.mean(of_noise)
    assert float(design.standard_error) == pytest.approx(float(design.standard_errors["r2"]))
    again = predicted_standard_errors(
        oscillator(), DRAG, design.record, channels=("x",), sigma={"x": NOISE}, method=FixedStep(3)
    )
    for name, error in design.standard_errors.items():
        np.testing.assert_allclose(error, again[name], rtol=1e-9)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"sigma": {}}, "no noise"),
        ({"travel": {"y": 1.0}}, "unknown state 'y'"),
        ({"known": {"c": 1.0}}, "unknown parameter 'c'"),
        ({"channels": ()}, "a channel to measure"),
        ({"frequencies": [20.0]}, "between 0 and 10 Hz"),
        ({"values": {"r": 0.8}}, "'r2' is not estimated"),
    ],
)
def test_what_cannot_be_designed_says_why(changed, message):
    with pytest.raises(ModelError, match=message):
        best_drag_input(**changed)

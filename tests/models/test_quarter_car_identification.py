"""The identification model against eq. (21) written out, and round trips through it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import RandomWindows
from riecjax.estimation.identify import identify
from riecjax.models.quarter_car.identification import (
    BREAK_POINTS,
    QuarterCar,
    quarter_car_at_once,
    quarter_car_by_body,
    quarter_car_by_wheel,
)
from riecjax.records.record import Record
from riecjax.simulation.inputs import band_limited_noise
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate

PARAMETERS = {
    "K_t": 175e3,
    "M_us": 28.0,
    "M_s": 290.0,
    "K_s": 22e3,
    "F_1": -1300.0,
    "F_2": -700.0,
    "F_3": 500.0,
    "F_4": 900.0,
}
PROCEDURES = {
    "body": quarter_car_by_body,
    "wheel": quarter_car_by_wheel,
    "at once": quarter_car_at_once,
}


def model(parameters=PARAMETERS) -> QuarterCar:
    return QuarterCar.from_parameters({k: jnp.asarray(v) for k, v in parameters.items()})


def damper_force(velocity: float) -> float:
    """Piecewise linear through the break points, end segments continued."""
    v, f = np.array(BREAK_POINTS), np.array([PARAMETERS[f"F_{i}"] for i in range(1, 5)])
    i = int(np.clip(np.searchsorted(v, velocity) - 1, 0, 2))
    return float(f[i] + (f[i + 1] - f[i]) / (v[i + 1] - v[i]) * (velocity - v[i]))


@pytest.mark.parametrize("velocity", [-2.0, -0.8, -0.5, -0.3, 0.0, 0.1, 0.3, 0.6, 0.8, 3.0])
def test_derivative_is_equation_21(velocity):
    x1, x2, x4, v_r = 0.004, -0.02, 0.35, 0.6
    x3 = x4 + velocity
    suspension = 22e3 * x2 + damper_force(velocity)
    expected = [v_r - x3, velocity, (175e3 * x1 - suspension) / 28.0, suspension / 290.0]
    found = model().derivative(jnp.array([x1, x2, x3, x4]), jnp.array([v_r]))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def recording(refinement: int, parameters=PARAMETERS) -> Record:
    """One motion, its input piecewise linear at 200 Hz, sampled at 200 Hz times `refinement`."""
    coarse = np.asarray(
        band_limited_noise(jax.random.key(7), 2001, 0.005, bandwidth=20.0, rms=0.55)
    )
    fine = np.interp(np.arange(2000 * refinement + 1) / refinement, np.arange(2001), coarse)
    record = Record({"v_r": fine}, 0.005 / refinement)
    return simulate(model(parameters), record, method=FixedStep(16 // refinement)).checked().record


def riec_errors(procedure: str, refinement: int, parameters=PARAMETERS) -> np.ndarray:
    criterion = RIEC(RandomWindows(0.05, 0.5, 1000, between_samples=True))
    record = recording(refinement, parameters)
    estimate = identify(PROCEDURES[procedure](), record, criterion, key=jax.random.key(1))
    return np.array([float(estimate[name]) / value - 1 for name, value in parameters.items()])


@pytest.mark.slow
def test_riec_converges_to_the_parameters_in_second_order_of_the_time_step():
    # Forces on one line: without kinks between samples only the quadrature is left. The motion and
    # its windows stay the same. What the average over windows leaves of its error changes sign from
    # grid to grid, so the order shows over a wide range of steps only.
    straight = {**PARAMETERS, **{f"F_{i}": 1800.0 * v for i, v in enumerate(BREAK_POINTS, 1)}}
    coarse, fine = (np.linalg.norm(riec_errors("wheel", r, straight)) for r in (1, 16))
    np.testing.assert_allclose(np.log2(coarse / fine) / 4, 2.0, atol=0.3)

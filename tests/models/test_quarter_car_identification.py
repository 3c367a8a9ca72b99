"""The identification model against eq. (21) written out; break points found by refinement."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from nightly import nightly
from riecjax.models.quarter_car.identification import (
    BREAK_POINTS,
    body_equation,
    quarter_car_system,
    wheel_equation,
)
from riecjax.refinement.objective import ByFunction
from riecjax.simulation.inputs import band_limited_noise

FORCES = ("F_1", "F_2", "F_3", "F_4")
MASSES = {"K_t": 175e3, "M_us": 28.0, "M_s": 290.0, "K_s": 22e3}
PARAMETERS = MASSES | dict(zip(FORCES, (-1300.0, -700.0, 500.0, 900.0)))


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
    car = quarter_car_system(PARAMETERS)
    found = car.derivative(jnp.array([x1, x2, x3, x4]), jnp.array([v_r]))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("equation", "mass"), [(body_equation, "M_s"), *nightly([(wheel_equation, "M_us")])]
)
def test_integral_refinement_finds_the_break_points_of_a_map_that_has_them(equation, mass):
    truth = MASSES | dict(zip(FORCES, (-1200.0, -800.0, 700.0, 1130.0)))
    truth |= {"v_2": -0.2, "v_3": 0.15}
    noise = band_limited_noise(jax.random.key(6), 4000, 0.005, bandwidth=30.0, rms=0.55)
    names = (mass, "K_s", *FORCES, "v_2", "v_3")
    balance = ByFunction(lambda p: equation(jnp.stack([-0.8, p["v_2"], p["v_3"], 0.8])), names)
    system = quarter_car_system(truth, (-0.8, truth["v_2"], truth["v_3"], 0.8))
    record = (
        rx.simulate(system, rx.Record({"v_r": noise}, 0.005), method=rx.FixedStep(4))
        .checked()
        .record
    )
    start = {"K_s": 15e3, "v_2": -0.3, "v_3": 0.3} | {name: 0.8 * truth[name] for name in FORCES}
    by = rx.IntegralError(rx.RIEC(rx.AllWindows(0.05, 0.5)))
    # Samples that cross a break point are kinks, at which no gradient vanishes to rounding.
    refined = rx.refine(balance, record, start, by, known={mass: truth[mass]})
    assert bool(refined.search.converged)
    for name in ("K_s", "v_2", "v_3"):
        np.testing.assert_allclose(refined[name], truth[name], rtol=0.02)

"""The source model against eq. (19) written out, and its curves against quadrature and slopes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.models.catalogue import built_in_model
from riecjax.models.quarter_car.source import (
    BumpStopSpring,
    DigressiveDamper,
    HardeningMount,
    QuarterCarSource,
)


def built_in(**settings: float) -> QuarterCarSource:
    source = built_in_model("quarter-car-source").build_system(settings)
    assert isinstance(source, QuarterCarSource)
    return source


def digressive_damper() -> DigressiveDamper:
    return DigressiveDamper(jnp.asarray(4000.0), jnp.array([900.0, 600.0]), jnp.array([0.1, 0.2]))


DAMPERS = {
    "digressive": digressive_damper,
    "built in": lambda: built_in().damper,
}
SPEEDS = [1e-9, 1e-4, 0.02, 0.05, 0.1, 0.15, 0.3, 0.4, 0.7, 1.0, 2.5]
VELOCITIES = [*(-v for v in reversed(SPEEDS)), 0.0, *SPEEDS]

CURVES = {
    **DAMPERS,
    "spring": lambda: BumpStopSpring(
        jnp.asarray(20e3), jnp.array([0.02, 0.05]), jnp.array([3e3, 7e3])
    ),
    "mount": lambda: HardeningMount(jnp.asarray(4e5), jnp.asarray(1e9)),
    "built-in spring": lambda: built_in().spring,
    "built-in mount": lambda: built_in().mount,
}


@pytest.mark.parametrize("name", CURVES)
def test_curves_are_zero_at_rest_and_increase(name):
    curve = CURVES[name]()
    assert float(curve(jnp.zeros(()))) == 0.0
    forces = np.asarray(curve(jnp.linspace(-3.0, 3.0, 2001)))
    assert np.all(np.diff(forces) > 0)


@pytest.mark.parametrize("name", DAMPERS)
def test_slope_of_the_damper_force_in_closed_form_also_at_rest_and_at_knees(name):
    damper, v = DAMPERS[name](), np.array(VELOCITIES)
    side = (v > 0).astype(int)
    rate, knee = np.asarray(damper.high_speed_rates)[side], np.asarray(damper.knees)[side]
    slope = rate + (float(damper.low_speed_rate) - rate) / (1 + (v / knee) ** 2) ** 1.5
    np.testing.assert_allclose(jax.vmap(jax.grad(damper))(jnp.array(v)), slope, rtol=1e-10)


STATES_TRIED = np.random.default_rng(0).normal(size=(8, 7)) * [
    *(0.03, 0.05, 1.0, 0.5, 0.004, 0.5, 0.6)
]


@pytest.mark.parametrize("state", STATES_TRIED, ids=range(8))
def test_derivative_is_equation_19(state):
    source = built_in(M_w=31, M_b=190, M_e=110, K_t=170e3, K_c=450e3, K_m=390e3, B_m=3800)
    x1, x2, x3, x4, x5, x6, x7 = state
    static_load = (31 + 190 + 110) * 9.81
    tyre = 170e3 * x1 if x1 <= static_load / 170e3 else static_load
    spring, damper = float(source.spring(jnp.asarray(x2))), float(source.damper(jnp.asarray(x7)))
    mount = float(source.mount(jnp.asarray(x5)))
    h = 1e-6
    slope = float(source.damper(jnp.asarray(x7 + h)) - source.damper(jnp.asarray(x7 - h))) / (2 * h)
    expected = [
        0.7 - x3,
        x3 - x4,
        (tyre - spring - damper) / 31,
        (spring + damper - mount - 3800 * (x4 - x6)) / 190,
        x4 - x6,
        (mount + 3800 * (x4 - x6)) / 110,
        450e3 / slope * (x3 - x4 - x7),
    ]
    found = source.derivative(jnp.asarray(state), jnp.array([0.7]))
    # The slope is by differences here.
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(
        source.output(jnp.asarray(state), jnp.array([0.7]))["F_t"], tyre, rtol=1e-13
    )

"""Built-in systems against their printed equations."""

import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.equation_systems import right_hand_side

from riecjax.models.catalogue import built_in_model
from riecjax.simulation.system import AbstractSystem

PARAMETERS = {
    "duffing": {"m": 2.0, "d": 0.7, "k1": 30.0, "k2": -40.0, "k3": 900.0},
    "drag-oscillator": {"m": 1.5, "r": 0.8, "r2": 0.5, "k": 20.0},
    "pendulum": {"p1": 60.0, "p2": 0.1},
    "emps": {"M": 95.0, "Fv": 200.0, "Fc": 20.0, "offset": -3.0},
    "emps-asymmetric": {
        "M": 95.0,
        "Fv_pos": 160.0,
        "Fc_pos": 20.0,
        "Fv_neg": 240.0,
        "Fc_neg": 21.0,
    },
}


@pytest.mark.parametrize("model", PARAMETERS)
@pytest.mark.parametrize("state", [(0.3, 0.8), (-0.2, -1.5), (0.1, 0.0), (0.0, -0.01)])
def test_derivative_is_the_printed_equation(model, state):
    system = built_in_model(model).build_system(PARAMETERS[model])
    found = system.derivative(jnp.array(state), jnp.array([13.0]))
    expected = right_hand_side(model, PARAMETERS[model], state, [13.0])
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


M1, M2, OMEGA, ZETA = 10.0, 1.0, 100.0, 0.5


def system() -> AbstractSystem:
    values = {"m1": M1, "m2": M2, "omega_n": OMEGA, "zeta": ZETA}
    return built_in_model("two-mass").build_system(values)


@pytest.mark.parametrize("state", np.random.default_rng(0).normal(size=(4, 4)), ids=range(4))
def test_derivative_obeys_newtons_laws_for_both_masses(state):
    force = 37.0
    _, _, d, dd = state
    rates = np.asarray(system().derivative(jnp.asarray(state), jnp.array([force])))
    np.testing.assert_allclose(rates[[0, 2]], state[[1, 3]])
    first, relative = rates[1], rates[3]
    # d counts the second mass from the first, so its own acceleration is the sum.
    coupling = force - M1 * first
    np.testing.assert_allclose(M2 * (first + relative), coupling, rtol=1e-12)
    # Free relative motion: d'' + 2 zeta omega d' + omega^2 d = -F / m1.
    expected = -force / M1 - 2 * ZETA * OMEGA * dd - OMEGA**2 * d
    np.testing.assert_allclose(relative, expected, rtol=1e-12)
    # What the model of one mass leaves of F = (m1 + m2) z''.
    error = system().output(jnp.asarray(state), jnp.array([force]))["error"]
    np.testing.assert_allclose(error, (M1 + M2) * first - force, rtol=1e-9)

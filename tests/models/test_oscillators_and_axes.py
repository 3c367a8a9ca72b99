"""Small systems against formulas, conservation laws and closed-form motion."""

import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.models.catalogue import built_in_model

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
    x, v = state
    found = system.derivative(jnp.array([x, v]), jnp.array([13.0]))
    expected = [v, acceleration(model, x, v, 13.0)]
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


def test_symmetric_axis_is_the_asymmetric_one_with_equal_sides():
    shared = {"M": 95.0, "Fv_pos": 200.0, "Fc_pos": 20.0, "Fv_neg": 200.0, "Fc_neg": 20.0}
    asymmetric = built_in_model("emps-asymmetric").build_system(shared)
    symmetric = built_in_model("emps").build_system({**PARAMETERS["emps"], "offset": 0.0})
    for v in (-0.3, 0.0, 0.3):
        state, force = jnp.array([0.1, v]), jnp.array([50.0])
        np.testing.assert_allclose(
            symmetric.derivative(state, force), asymmetric.derivative(state, force)
        )

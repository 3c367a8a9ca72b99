"""Friction that changes near rest: the sampled loop's exact parts against fine integration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from riecjax.models.emps import stribeck_axis, stribeck_balance, without_rise

FRICTION = {"M": 95.0, "Fv_pos": 160.0, "Fc_pos": 20.0, "Fv_neg": 230.0, "Fc_neg": 21.0}
SHAPE = {"excess": -0.2, "vs": 0.02}


def axis(**changes):
    values = {**FRICTION, **SHAPE, **changes}
    return stribeck_axis({name: jnp.asarray(value) for name, value in values.items()})


def test_motion_is_that_of_scipy_between_stops():
    def slope(t, s):
        level = 20.0 * (1 - 0.2 * np.exp(-((s[1] / 0.02) ** 2)))
        return [s[1], (40.0 - 160.0 * s[1] - level) / 95.0]

    run = scipy.integrate.solve_ivp(slope, (0, 0.2), [0.0, 0.005], rtol=1e-10, atol=1e-14)

    @jax.jit
    def in_steps(q, v):
        own = axis()
        return jax.lax.fori_loop(
            0,
            200,
            lambda _, s: own.advance(s[0], s[1], jnp.asarray(40.0), jnp.asarray(1e-3))[:2],
            (q, v),
        )

    q, v = in_steps(jnp.zeros(()), jnp.asarray(0.005))
    assert float(v) == pytest.approx(run.y[1, -1], rel=1e-3)
    assert float(q) == pytest.approx(run.y[0, -1], rel=1e-3)


def test_the_balance_is_the_axis_equation_of_motion():
    start = without_rise({**FRICTION, "excess": 0.0})
    made = stribeck_balance({**start, **SHAPE})
    v = jnp.array([-0.3, -0.01, 0.01, 0.3])
    left = made.force({"dq": v, "force": jnp.zeros(4)})  # pyright: ignore[reportArgumentType]
    level = np.where(v > 0, 20.0, 21.0) * (1 - 0.2 * np.exp(-((v / 0.02) ** 2)))
    viscous = np.where(v > 0, 160.0, 230.0) * v
    np.testing.assert_allclose(left, viscous + level * np.sign(v), rtol=1e-9)
    slope = jax.grad(lambda e: made.force({"dq": v + e, "force": v})[0])(0.0)  # pyright: ignore[reportArgumentType]
    assert np.isfinite(slope)

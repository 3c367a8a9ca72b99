"""The axis under its controller, and with friction that rises: its own law, SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from benchmarks.measured.emps_axis import RISE, sampled_control, stribeck_axis, stribeck_balance

import riecjax as rx
from riecjax.records.record import Record

RISING = {"M": 95.0, "Fv_pos": 160.0, "Fc_pos": 20.0, "Fv_neg": 230.0, "Fc_neg": 21.0}
VALUES = RISING | {"Fv_pos": 170.0, "Fv_neg": 240.0, "offset": -3.0}


def axis() -> rx.simulation.AbstractSystem:
    offset = rx.Term("offset", rx.constant, unit="N")
    model = rx.find_model("emps-asymmetric").with_terms({"emps-asymmetric": [offset]})
    return model.build_system(VALUES)


def ramp_and_hold(count: int = 1500) -> Record:
    """A reference that moves at 0.1 m/s for half the time and then stands."""
    time = np.arange(count) * 1e-3
    return Record({"qg": 0.1 * np.minimum(time, time[count // 2])}, 1e-3)


GAIN = jnp.asarray(35.15065188)


def test_follows_a_ramp_as_its_gains_say():
    """In steady motion q' = 0.1, so the force is the friction and qg - q = (0.1 + u / kv) / kp."""
    goal = ramp_and_hold()
    record = sampled_control(axis(), goal, gain=GAIN, start=jnp.asarray(0.0))
    at = 700
    friction = 170.0 * 0.1 + 20.0 - 3.0
    np.testing.assert_allclose(record["dq"][at], 0.1, rtol=1e-3)
    np.testing.assert_allclose(record["force"][at], friction, rtol=2e-2)
    lag = (0.1 + friction / (35.15065188 * 243.45)) / 160.18
    # Held between samples, the controller sees the velocity one sample late: none when steady.
    np.testing.assert_allclose(goal["qg"][at] - record["q"][at], lag, rtol=1e-3)


def test_sampled_record_obeys_the_controller_and_the_equation_of_motion():
    goal = ramp_and_hold()
    record = sampled_control(axis(), goal, gain=GAIN, start=jnp.asarray(-0.001))
    q, dq, force = (np.asarray(record[name]) for name in ("q", "dq", "force"))
    assert q[0] == -0.001
    law = 160.18 * (np.asarray(goal["qg"]) - q)[2:] - (q[2:] - q[:-2]) / 2e-3
    np.testing.assert_allclose(force[2:], 35.15065188 * 243.45 * law, rtol=1e-12)
    moving = slice(20, 700)
    friction = 170.0 * dq + 20.0 - 3.0
    np.testing.assert_allclose(
        95.0 * np.asarray(record["ddq"])[moving], (force - friction)[moving], atol=1e-9
    )


SHAPE = {"excess": -0.2, "vs": 0.02}


def stribeck(**changes):
    values = {**RISING, **SHAPE, **changes}
    return stribeck_axis({name: jnp.asarray(value) for name, value in values.items()})


def test_motion_is_that_of_scipy_between_stops():
    def slope(t, s):
        level = 20.0 * (1 - 0.2 * np.exp(-((s[1] / 0.02) ** 2)))
        return [s[1], (40.0 - 160.0 * s[1] - level) / 95.0]

    run = scipy.integrate.solve_ivp(slope, (0, 0.2), [0.0, 0.005], rtol=1e-10, atol=1e-14)

    drive = Record({"force": jnp.full(201, 40.0)}, 1e-3)
    found = rx.simulate(stribeck(), drive, initial_state={"dq": 0.005}).record
    assert float(found["dq"][-1]) == pytest.approx(run.y[1, -1], rel=1e-6)
    assert float(found["q"][-1]) == pytest.approx(run.y[0, -1], rel=1e-6)


def test_the_balance_is_the_axis_equation_of_motion():
    made = stribeck_balance({**RISING, **RISE, **SHAPE})
    v = jnp.array([-0.3, -0.01, 0.01, 0.3])
    left = made.force({"dq": v, "force": jnp.zeros(4)})  # pyright: ignore[reportArgumentType]
    level = np.where(v > 0, 20.0, 21.0) * (1 - 0.2 * np.exp(-((v / 0.02) ** 2)))
    viscous = np.where(v > 0, 160.0, 230.0) * v
    np.testing.assert_allclose(left, viscous + level * np.sign(v), rtol=1e-9)
    slope = jax.grad(lambda e: made.force({"dq": v + e, "force": v})[0])(0.0)  # pyright: ignore[reportArgumentType]
    assert np.isfinite(slope)

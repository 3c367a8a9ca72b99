"""The axis under its controller, and with friction that rises: closed forms, SciPy, fine steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from benchmarks.measured.emps_axis import (
    SlidingAxis,
    sampled_control,
    stribeck_axis,
    stribeck_balance,
    without_rise,
)
from scipy.integrate import solve_ivp

from riecjax.records.record import Record

VALUES = {
    "M": 95.0,
    "Fv_pos": 170.0,
    "Fc_pos": 20.0,
    "Fv_neg": 240.0,
    "Fc_neg": 21.0,
    "offset": -3.0,
}


def axis(**changes: float) -> SlidingAxis:
    return SlidingAxis(
        **{name: jnp.asarray(value) for name, value in {**VALUES, **changes}.items()}
    )


class Standstill:
    """SciPy's event: stop where the velocity passes zero in a direction."""

    terminal = True

    def __init__(self, direction: float):
        self.direction = direction

    def __call__(self, t, x):
        return x[1]


def advance(moved: SlidingAxis, position: float, velocity: float, force: float, seconds: float):
    state = [jnp.asarray(x) for x in (position, velocity, force, seconds)]
    return moved.advance(state[0], state[1], state[2], state[3])


def scipy_advance(q: float, v: float, force: float, seconds: float) -> tuple[float, float]:
    """Slide by DOP853 until standstill, then stick or slide on the other way."""
    p, time = VALUES, 0.0
    drive = force - p["offset"]
    for _ in range(2):
        pulled = 1 if drive > p["Fc_pos"] else -1 if drive < -p["Fc_neg"] else 0
        direction = np.sign(v) if v != 0 else pulled
        if direction == 0:
            return q, 0.0
        viscous, coulomb = (
            (p["Fv_pos"], p["Fc_pos"]) if direction > 0 else (p["Fv_neg"], -p["Fc_neg"])
        )

        def rate(t, x, viscous=viscous, coulomb=coulomb):
            return [x[1], (drive - coulomb - viscous * x[1]) / p["M"]]

        found = solve_ivp(
            rate,
            (time, seconds),
            [q, v],
            method="DOP853",
            rtol=1e-12,
            atol=1e-15,
            events=Standstill(-direction),
        )
        q, v, time = found.y[0, -1], found.y[1, -1], found.t[-1]
        if not found.t_events[0].size:
            return q, v
        v = 0.0
    raise AssertionError("it cannot stop twice under a constant force")


@pytest.mark.parametrize("velocity", [0.0, 0.05, -0.05, 2e-4, -2e-4])
@pytest.mark.parametrize("force", [0.0, 15.0, -22.0, 60.0, -60.0, 4000.0])
@pytest.mark.parametrize("seconds", [1e-3, 0.8])
def test_motion_under_a_constant_force_is_exact_through_stops(velocity, force, seconds):
    expected = scipy_advance(0.1, velocity, force, seconds)
    found = advance(axis(), 0.1, velocity, force, seconds)
    np.testing.assert_allclose(found[:2], expected, rtol=1e-9, atol=1e-13)
    # Its acceleration is where the motion starts to.
    soon = 1e-6
    ahead = scipy_advance(0.1, velocity, force, soon)[1]
    np.testing.assert_allclose(found[2], (ahead - velocity) / soon, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("velocity", [0.05, 2e-4])
def test_derivatives_through_a_stop_equal_finite_differences(velocity):
    def reached(Fc, Fv, force):
        moved = axis(Fc_pos=Fc, Fv_pos=Fv).advance(
            jnp.asarray(0.0), jnp.asarray(velocity), force, jnp.asarray(0.3)
        )
        return moved[0]

    at, h = (20.0, 170.0, -40.0), 1e-4
    found = jax.grad(reached, argnums=(0, 1, 2))(*at)
    for i, slope in enumerate(found):
        ends = [reached(*(x + s * h * (i == j) for j, x in enumerate(at))) for s in (1, -1)]
        np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * h), rtol=1e-5, atol=1e-12)


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


RISING = {"M": 95.0, "Fv_pos": 160.0, "Fc_pos": 20.0, "Fv_neg": 230.0, "Fc_neg": 21.0}
SHAPE = {"excess": -0.2, "vs": 0.02}


def stribeck(**changes):
    values = {**RISING, **SHAPE, **changes}
    return stribeck_axis({name: jnp.asarray(value) for name, value in values.items()})


def test_motion_is_that_of_scipy_between_stops():
    def slope(t, s):
        level = 20.0 * (1 - 0.2 * np.exp(-((s[1] / 0.02) ** 2)))
        return [s[1], (40.0 - 160.0 * s[1] - level) / 95.0]

    run = scipy.integrate.solve_ivp(slope, (0, 0.2), [0.0, 0.005], rtol=1e-10, atol=1e-14)

    @jax.jit
    def in_steps(q, v):
        own = stribeck()
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
    start = without_rise({**RISING, "excess": 0.0})
    made = stribeck_balance({**start, **SHAPE})
    v = jnp.array([-0.3, -0.01, 0.01, 0.3])
    left = made.force({"dq": v, "force": jnp.zeros(4)})  # pyright: ignore[reportArgumentType]
    level = np.where(v > 0, 20.0, 21.0) * (1 - 0.2 * np.exp(-((v / 0.02) ** 2)))
    viscous = np.where(v > 0, 160.0, 230.0) * v
    np.testing.assert_allclose(left, viscous + level * np.sign(v), rtol=1e-9)
    slope = jax.grad(lambda e: made.force({"dq": v + e, "force": v})[0])(0.0)  # pyright: ignore[reportArgumentType]
    assert np.isfinite(slope)

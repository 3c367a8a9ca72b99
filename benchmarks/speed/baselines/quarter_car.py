"""The paper's seven-state source model, eqs (19)-(20), for SciPy."""

from collections import namedtuple

import numpy as np
import scipy.integrate
from jaxtyping import Float

from riecjax.models.quarter_car.source import (
    BumpStopSpring,
    DigressiveDamper,
    HardeningMount,
    QuarterCarSource,
)

Car = namedtuple(
    "Car",
    "wheel_mass body_mass engine_mass tyre_stiffness lift_off_force damper_compliance "
    "slope_at_rest compression_slope rebound_slope compression_knee rebound_knee spring_rate "
    "compression_gap rebound_gap compression_stop rebound_stop mount_rate mount_cubic "
    "mount_damping",
)
"""The source model's numbers, in SI units."""


def car_of(source: QuarterCarSource) -> Car:
    """The numbers of a source model with the curves of the reconstruction."""
    damper, spring, mount = source.damper, source.spring, source.mount
    assert isinstance(damper, DigressiveDamper)
    assert isinstance(spring, BumpStopSpring)
    assert isinstance(mount, HardeningMount)
    values = (
        source.wheel_mass,
        source.body_mass,
        source.engine_mass,
        source.tyre_stiffness,
        source.lift_off_force,
        source.damper_compliance,
        damper.low_speed_rate,
        *damper.high_speed_rates,
        *damper.knees,
        spring.rate,
        *spring.gaps,
        *spring.stop_rates,
        mount.rate,
        mount.cubic,
        source.mount_damping,
    )
    return Car(*(float(value) for value in values))


def numpy_solution(
    car: Car, velocity: Float[np.ndarray, " n"], rate: float, rtol: float
) -> Float[np.ndarray, "n 7"]:
    """States at the samples of a road velocity, from rest, with arrays and `np.interp`."""
    c, time = car, np.arange(velocity.size) / rate

    def derivative(t: float, x: np.ndarray) -> np.ndarray:
        x1, x2, x3, x4, x5, x6, x7 = x
        rebound = x7 > 0
        high = c.rebound_slope if rebound else c.compression_slope
        bend = 1 + (x7 / (c.rebound_knee if rebound else c.compression_knee)) ** 2
        damping = x7 * (high + (c.slope_at_rest - high) / bend**0.5)
        slope = high + (c.slope_at_rest - high) * bend**-1.5
        stops = c.rebound_stop * max(x2 - c.rebound_gap, 0.0)
        stops -= c.compression_stop * max(-x2 - c.compression_gap, 0.0)
        suspension = c.spring_rate * x2 + stops + damping
        mount = c.mount_rate * x5 + c.mount_cubic * x5**3 + c.mount_damping * (x4 - x6)
        tyre = min(c.tyre_stiffness * x1, c.lift_off_force)
        return np.array(
            [
                np.interp(t, time, velocity) - x3,
                x3 - x4,
                (tyre - suspension) / c.wheel_mass,
                (suspension - mount) / c.body_mass,
                x4 - x6,
                mount / c.engine_mass,
                c.damper_compliance / slope * (x3 - x4 - x7),
            ]
        )

    run = scipy.integrate.solve_ivp(
        derivative,
        (0.0, time[-1]),
        np.zeros(7),
        method="RK45",
        t_eval=time,
        rtol=rtol,
        atol=rtol * 1e-3,
        max_step=1 / rate,
    )
    return run.y.T

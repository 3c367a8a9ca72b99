"""The source model by the classical Runge-Kutta method with fixed steps, compiled by numba."""

import math

import numpy as np
from jaxtyping import Float
from numba import njit  # pyright: ignore[reportMissingImports]  (of the bench extra)

from benchmarks.speed.baselines.quarter_car import Car


@njit(error_model="numpy")
def _derivative(car: Car, x: np.ndarray, road: float, slopes: np.ndarray) -> None:
    if x[6] > 0:
        slope, ratio = car.rebound_slope, x[6] / car.rebound_knee
    else:
        slope, ratio = car.compression_slope, x[6] / car.compression_knee
    excess, bend = car.slope_at_rest - slope, 1 / math.sqrt(1 + ratio * ratio)
    suspension = (
        car.spring_rate * x[1]
        - car.compression_stop * max(-x[1] - car.compression_gap, 0.0)
        + car.rebound_stop * max(x[1] - car.rebound_gap, 0.0)
        + x[6] * (slope + excess * bend)
    )
    mount = x[4] * (car.mount_rate + car.mount_cubic * x[4] * x[4])
    mount += car.mount_damping * (x[3] - x[5])
    tyre = min(car.tyre_stiffness * x[0], car.lift_off_force)
    slopes[0] = road - x[2]
    slopes[1] = x[2] - x[3]
    slopes[2] = (tyre - suspension) / car.wheel_mass
    slopes[3] = (suspension - mount) / car.body_mass
    slopes[4] = x[3] - x[5]
    slopes[5] = mount / car.engine_mass
    slopes[6] = car.damper_compliance * (x[2] - x[3] - x[6]) / (slope + excess * bend**3)


@njit(error_model="numpy")
def numba_solution(
    car: Car, velocity: Float[np.ndarray, " n"], rate: float, steps_per_sample: int
) -> Float[np.ndarray, "n 7"]:
    """States at the samples of a road velocity, from rest; straight lines between samples."""
    step = 1 / (rate * steps_per_sample)
    states = np.zeros((velocity.size, 7))
    x, moved = np.zeros(7), np.empty(7)
    a, b, c, d = np.empty(7), np.empty(7), np.empty(7), np.empty(7)
    for sample in range(velocity.size - 1):
        rise = (velocity[sample + 1] - velocity[sample]) / steps_per_sample
        for k in range(steps_per_sample):
            road = velocity[sample] + k * rise
            _derivative(car, x, road, a)
            for i in range(7):
                moved[i] = x[i] + 0.5 * step * a[i]
            _derivative(car, moved, road + 0.5 * rise, b)
            for i in range(7):
                moved[i] = x[i] + 0.5 * step * b[i]
            _derivative(car, moved, road + 0.5 * rise, c)
            for i in range(7):
                moved[i] = x[i] + step * c[i]
            _derivative(car, moved, road + rise, d)
            for i in range(7):
                x[i] += step / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i])
        states[sample + 1] = x
    return states

"""The paper's study of one road, Tables 3 to 5, in NumPy and SciPy.

The source model on white noise, four variants of the reduced model identified by RIEC and by DOLS,
and all eight of them, and the source, on the two inputs of the validation.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from benchmarks.speed.baselines.numpy_stages import (
    Table,
    masses,
    sample_table,
    suspension_by_body,
    suspension_by_wheel,
    tyre_stiffness,
    window_table_between_samples,
)
from benchmarks.speed.baselines.numpy_windows import BREAK_POINTS, random_windows_between_samples
from benchmarks.speed.baselines.quarter_car import Car, integrated, right_hand_side, scipy_solution
from benchmarks.speed.baselines.sampled_input import first_order_hold

WINDOWS, SHORTEST, LONGEST = 8000, 0.05, 0.5
"""Table 2; lengths in seconds."""


class RoadInputs(NamedTuple):
    """Road velocities in m/s: of the identification, and of both validations."""

    training: Float[np.ndarray, " n"]
    road: Float[np.ndarray, " n"]
    pothole: Float[np.ndarray, " m"]


class Study(NamedTuple):
    """Criteria are RIEC and DOLS; variants W_true, B_true, W_id and B_id.

    **Fields:** `parameters` K_t, M_us, M_s, K_s and F_1 to F_4; `road` and `pothole`, errors p_i of
    x1 to x4 in percent.
    """

    parameters: Float[np.ndarray, "criteria variants 8"]
    road: Float[np.ndarray, "criteria variants 4"]
    pothole: Float[np.ndarray, "criteria variants 4"]


def study(
    car: Car,
    inputs: RoadInputs,
    rate: float,
    *,
    rtol: float,
    seed: int = 0,
    seconds: float = np.inf,
) -> Study:
    """Simulate, identify and validate on one road, or on the first `seconds` of every input."""
    training, road, pothole = (values[: int(min(seconds * rate, values.size))] for values in inputs)
    signals = identification_signals(car, training, rate, rtol)
    drawn = random_windows_between_samples(
        np.random.default_rng(seed), training.size, WINDOWS, SHORTEST * rate, LONGEST * rate
    )
    windows = window_table_between_samples(signals, 1 / rate, *drawn)
    tables = [windows, sample_table(signals)]
    parameters = np.array([identify_variants(car, table) for table in tables])
    models = parameters.reshape(-1, 8)
    return Study(
        parameters,
        *(
            prediction_errors(car, models, velocity, rate, rtol).reshape(2, 4, 4)
            for velocity in (road, pothole)
        ),
    )


def identification_signals(
    car: Car, velocity: Float[np.ndarray, " n"], rate: float, rtol: float
) -> dict[str, Float[np.ndarray, " n"]]:
    """What is measured on the source model: x1 to x4, accelerations and tyre force."""
    states = scipy_solution(car, velocity, rate, rtol)
    derivative = right_hand_side(car, velocity, rate)
    slopes = np.array([derivative(i / rate, state) for i, state in enumerate(states)])
    signals = {f"x{i + 1}": states[:, i] for i in range(4)}
    signals |= {"dx3": slopes[:, 2], "dx4": slopes[:, 3]}
    signals["F_t"] = np.minimum(car.tyre_stiffness * states[:, 0], car.lift_off_force)
    return signals


def identify_variants(car: Car, table: Table) -> list[Float[np.ndarray, " 8"]]:
    """W_true, B_true, W_id and B_id."""
    stiffness = tyre_stiffness(table)
    true = np.array([car.wheel_mass, car.body_mass + car.engine_mass])
    return [
        np.array([stiffness, unsprung, sprung, *suspension])
        for unsprung, sprung in (true, masses(table))
        for suspension in (
            suspension_by_wheel(table, unsprung),
            suspension_by_body(table, sprung),
        )
    ]


def prediction_errors(
    car: Car,
    models: Float[np.ndarray, "models 8"],
    velocity: Float[np.ndarray, " n"],
    rate: float,
    rtol: float,
) -> Float[np.ndarray, "models 4"]:
    """p_i of eq. (28) in percent: 100 ||predicted - true|| / ||true||."""
    truth = scipy_solution(car, velocity, rate, rtol)[:, :4]
    predicted = reduced_solutions(models, velocity, rate, rtol)
    return 100 * np.linalg.norm(predicted - truth, axis=1) / np.linalg.norm(truth, axis=0)


def reduced_solutions(
    models: Float[np.ndarray, "models 8"],
    velocity: Float[np.ndarray, " n"],
    rate: float,
    rtol: float,
) -> Float[np.ndarray, "models n 4"]:
    """States x1 to x4 of all models, together in one run of the solver."""
    derivative = reduced_right_hand_side(models, velocity, rate)
    states = integrated(derivative, 4 * len(models), velocity.size, rate, rtol)
    return states.reshape(-1, 4, len(models)).transpose(2, 0, 1)


def reduced_right_hand_side(
    models: Float[np.ndarray, "models 8"], velocity: Float[np.ndarray, " n"], rate: float
) -> Callable[[float, np.ndarray], np.ndarray]:
    """Eq. (21) of all models; the state holds x1 of each, then x2 of each, and so on."""
    road = first_order_hold(velocity, rate)
    tyre, unsprung, sprung, spring = models[:, :4].T
    forces = models[:, 4:].T
    # The damper map as a straight line that bends at the inner break points.
    slopes = np.diff(forces, axis=0) / np.diff(BREAK_POINTS)[:, None]
    slope, (first_bend, second_bend) = slopes[0], np.diff(slopes, axis=0)
    at_rest = forces[0] - slope * BREAK_POINTS[0]
    first_knee, second_knee = BREAK_POINTS[1:-1].tolist()

    def derivative(time: float, state: np.ndarray) -> np.ndarray:
        x1, x2, x3, x4 = state.reshape(4, -1)
        across = x3 - x4
        suspension = spring * x2 + at_rest + slope * across
        suspension += first_bend * np.maximum(across - first_knee, 0.0)
        suspension += second_bend * np.maximum(across - second_knee, 0.0)
        rates = (road(time) - x3, across, (tyre * x1 - suspension) / unsprung, suspension / sprung)
        return np.concatenate(rates)

    return derivative

"""All windows at once against one random draw, and many draws against a plain NumPy loop."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from benchmarks.timing import Comparison, compare, median_seconds
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import AllWindows, RandomWindows
from riecjax.estimation.least_squares import solve
from riecjax.estimation.normal_equations import normal_equations
from riecjax.models.quarter_car.equations import BREAK_POINTS, body_equation
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.paper.reproduction import identification_record
from riecjax.records.record import Record

SEEDS, NUMPY_SEEDS, WINDOWS, SPRUNG_MASS = 1000, 50, 8000, 300.0


def numpy_seeds(record: Record, count: int) -> np.ndarray:
    """Gather and lstsq, vectorised over windows, one seed after the other."""
    step = float(record.time_step)
    x2, x3, x4 = (np.asarray(record[name]) for name in ("x2", "x3", "x4"))
    points, velocity = np.array(BREAK_POINTS), x3 - x4
    below = np.clip(np.searchsorted(points, velocity) - 1, 0, 2)
    share = (velocity - points[below]) / (points[below + 1] - points[below])
    columns = np.zeros((x2.size, 5))
    columns[:, 0] = x2
    columns[np.arange(x2.size), 1 + below] = 1 - share
    columns[np.arange(x2.size), 2 + below] = share
    areas = 0.5 * step * (columns[1:] + columns[:-1])
    running = np.vstack([np.zeros(5), np.cumsum(areas, axis=0)])
    found = []
    for seed in range(count):
        random = np.random.default_rng(seed)
        lag = random.integers(10, 101, WINDOWS)
        start = (random.random(WINDOWS) * (x2.size - lag)).astype(int)
        matrix = running[start + lag] - running[start]
        target = SPRUNG_MASS * (x4[start + lag] - x4[start])
        found.append(np.linalg.lstsq(matrix, target, rcond=None)[0])
    return np.array(found)


@eqx.filter_jit
def all_seeds(record: Record, keys: Array) -> Array:
    criterion = RIEC(RandomWindows(0.05, 0.5, WINDOWS))
    equation = body_equation()

    def one(key: Array) -> Array:
        equations = normal_equations(criterion.rows(equation, record, key)).total()
        return solve(equations.fix({"M_s": SPRUNG_MASS})).theta

    return jax.lax.map(one, keys, batch_size=8)


@eqx.filter_jit
def body_moments(record: Record, criterion: RIEC, key: Array) -> Array:
    """Normal equations of the body's equation, all windows or one draw of them."""
    if criterion.needs_key:
        return normal_equations(criterion.rows(body_equation(), record, key)).total().moments
    return jnp.sum(criterion.moments(body_equation(), record)[0], axis=0)


def all_windows(record: Record) -> Comparison:
    """`all-windows-draw`: every window of 8000 samples, against one random draw of 8000."""
    every = RIEC(AllWindows(0.05, 0.5)).fitted([record])
    drawn = RIEC(RandomWindows(0.05, 0.5, WINDOWS))
    keys = jax.random.split(jax.random.key(2), 200)
    ours = median_seconds(lambda: body_moments(record, every, keys[0]), 50)
    theirs = median_seconds(lambda: body_moments(record, drawn, keys[0]), 50)
    exact = np.asarray(body_moments(record, every, keys[0]))
    exact = exact / exact[1, 1]
    mean = np.mean([np.asarray(body_moments(record, drawn, k)) for k in keys], axis=0)
    accuracy = {
        "largest_difference_from_mean_of_200_draws": float(
            np.abs(mean / mean[1, 1] - exact).max() / np.abs(exact).max()
        )
    }
    baseline = "one random draw of 8000 windows, this library"
    return compare("all-windows-draw", ours, baseline, theirs, 1, accuracy)


def run() -> list[Comparison]:
    """`all-windows-draw`, and `seeds`: 1000 sampling seeds of 8000 windows and 5 parameters."""
    record = identification_record(quarter_car_source(reconstructed()), jax.random.key(0)).record
    first = all_windows(record)
    keys = jax.random.split(jax.random.key(1), SEEDS)
    ours = median_seconds(lambda: all_seeds(record, keys), 3)
    theirs = SEEDS / NUMPY_SEEDS * median_seconds(lambda: numpy_seeds(record, NUMPY_SEEDS), 3)
    here, there = all_seeds(record, keys), numpy_seeds(record, NUMPY_SEEDS)
    # Scatter of the mean over the seeds is what the two may differ by.
    difference = np.asarray(jnp.mean(here, axis=0)) / there.mean(0) - 1
    accuracy = {"largest_relative_difference_of_means": float(np.abs(difference).max())}
    baseline = f"NumPy gather and lstsq, {NUMPY_SEEDS} seeds scaled up"
    return [first, compare("seeds", ours, baseline, theirs, 6, accuracy)]

"""All windows at once: a long record, the paper's record, and many draws of random ones."""

from collections.abc import Iterator

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

import riecjax as rx
from benchmarks.speed.baselines.numpy_windows import (
    columns_of,
    random_windows_fit,
    running_integrals,
)
from benchmarks.speed.timing import Comparison, Size, compare
from riecjax.equations.model import as_model
from riecjax.estimation.stages import solve
from riecjax.models.quarter_car.identification import body_equation
from riecjax.models.quarter_car.reconstruction import quarter_car_source
from riecjax.paper.reproduction import identification_record
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.one_pass import stage_normal_equations

WINDOWS, SPRUNG_MASS = 8000, 300.0
SIGNALS = ("x2", "x3", "x4")


def summed(equation: rx.Equation, record: rx.Record, criterion: rx.RIEC) -> NormalEquations:
    """Over all windows."""
    (equations,) = stage_normal_equations(as_model(equation), record, criterion, None)
    return equations.total()


@eqx.filter_jit
def moments(
    equation: rx.Equation, record: rx.Record, criterion: rx.RIEC
) -> Float[Array, "columns columns"]:
    return summed(equation, record, criterion).moments


def long_record(size: Size) -> Comparison:
    """`all-windows-long`: six signals, windows of 50 to 500 samples, against one product A^T A."""
    columns = np.random.default_rng(0).normal(size=(size.long_samples, 6))
    names = [f"s{i}" for i in range(6)]
    record = rx.Record({name: columns[:, i].copy() for i, name in enumerate(names)}, 1e-3)
    record = jax.device_put(record)
    equation = rx.Equation(*(rx.Term(f"p{i}", f"s{i}") for i in range(5)), -rx.Term(1.0, "s5"))
    criterion = rx.RIEC(rx.AllWindows(0.05, 0.5)).fitted([record])
    part = rx.Record({name: record[name][:3000] for name in names}, 1e-3)
    found = np.asarray(moments(equation, part, criterion))
    expected = every_window(columns[:3000], 50, 500)
    accuracy = {"largest_error_of_3000_samples": float(np.abs(found / expected - 1).max())}
    return compare(
        "all-windows-long",
        lambda: moments(equation, record, criterion),
        "one NumPy A.T @ A of the same array",
        lambda: columns.T @ columns,
        0.4,
        accuracy,
        repeats=size.repeats,
    )


def every_window(columns: np.ndarray, shortest: int, longest: int) -> np.ndarray:
    """Moments of all windows one length after the other, the target first."""
    running = running_integrals(columns, 1e-3)[:, [5, 0, 1, 2, 3, 4]]
    total = np.zeros((6, 6))
    for lag in range(shortest, longest + 1):
        rows = running[lag:] - running[:-lag]
        total += rows.T @ rows
    return total


@eqx.filter_jit
def identified(
    equation: rx.Equation, record: rx.Record, criterion: rx.RIEC, known: dict[str, float]
) -> Float[Array, " p"]:
    """From signals to parameters."""
    return solve(summed(equation, record, criterion).fix(known)).theta


@eqx.filter_jit
def over_seeds(record: rx.Record, keys: Array) -> Float[Array, "seeds 5"]:
    criterion = rx.RIEC(rx.RandomWindows(0.05, 0.5, WINDOWS))
    equation = body_equation()

    def one(key: Array) -> Array:
        equations = NormalEquations.of_rows(criterion.rows(equation, record, key)).total()
        return solve(equations.fix({"M_s": SPRUNG_MASS})).theta

    return jax.lax.map(one, keys, batch_size=8)


def run(size: Size) -> Iterator[Comparison]:
    yield long_record(size)
    full = identification_record(quarter_car_source(), jax.random.key(0)).record
    record = jax.device_put(full.select(*SIGNALS))
    signals = {name: np.asarray(record[name]) for name in SIGNALS}
    step = float(record.time_step)
    every = rx.RIEC(rx.AllWindows(0.05, 0.5)).fitted([record])

    def drawn(seeds: int) -> np.ndarray:
        momentum, columns = columns_of(signals, SPRUNG_MASS)
        running = running_integrals(columns, step)
        rngs = [np.random.default_rng(seed) for seed in range(seeds)]
        return np.array([random_windows_fit(running, momentum, rng) for rng in rngs])

    several = drawn(200)
    spread = several.std(0)
    body, known = body_equation(), {"M_s": SPRUNG_MASS}
    off = np.abs(np.asarray(identified(body, record, every, known)) - several.mean(0)) / spread
    yield compare(
        "all-windows-paper",
        lambda: identified(body, record, every, known),
        "NumPy, columns and one random draw of 8000 windows + lstsq",
        lambda: drawn(1),
        10,
        {
            "ours_off_the_mean_of_200_draws_in_their_spread": float(off.max()),
            "one_draw_s_spread_percent": float(100 * (spread / np.abs(several.mean(0))).max()),
        },
        repeats=10 * size.repeats,
    )
    keys = jax.random.split(jax.random.key(1), size.seeds)
    here = np.asarray(over_seeds(record, keys))
    difference = np.abs(here.mean(0) / several.mean(0) - 1).max()
    yield compare(
        "seeds",
        lambda: over_seeds(record, keys),
        f"NumPy gather and lstsq, {size.numpy_seeds} seeds scaled up",
        lambda: drawn(size.numpy_seeds),
        6,
        {
            "largest_relative_difference_of_means": float(difference),
            "largest_ratio_of_spreads": float((here.std(0) / spread).max()),
        },
        repeats=size.repeats,
        scale=size.seeds / size.numpy_seeds,
    )

"""The block bootstrap of the staged fit, refinement, and the weak form of a peer."""

from collections.abc import Iterator

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array
from tests.machines import DRAG_START as START
from tests.machines import DRAG_TRUTH as TRUTH
from tests.machines import drag_oscillator as oscillator
from tests.machines import drag_record as record

import riecjax as rx
from benchmarks.speed.all_windows import identified
from benchmarks.speed.baselines import pysindy_weak, scipy_drag
from benchmarks.speed.baselines.numpy_bootstrap import replicates
from benchmarks.speed.timing import Comparison, Size, compare
from riecjax.models.quarter_car.identification import quarter_car_by_body
from riecjax.models.quarter_car.reconstruction import quarter_car_source
from riecjax.paper.reproduction import identification_record
from riecjax.records.record import Signals
from riecjax.uncertainty.intervals import Uncertainty

REPLICATES = 2000
SEEDS = 20
"""Of noise, over which errors are medians."""


@eqx.filter_jit
def judged(own: rx.Record, criterion: rx.RIEC) -> Uncertainty:
    return rx.identify(quarter_car_by_body(), own, criterion).uncertainty


def bootstrap(size: Size) -> Comparison:
    source = quarter_car_source()
    full = identification_record(source, jax.random.key(0)).record
    own = jax.device_put(full.select("x1", "x2", "x3", "x4", "F_t"))
    signals = {name: np.asarray(own[name]) for name in own.arrays}
    step = float(own.time_step)
    criterion = rx.RIEC(rx.AllWindows(0.05, 0.5)).fitted([own])
    ours = np.asarray(rx.identify(quarter_car_by_body(), own, criterion).standard_errors)
    theirs = replicates(signals, step, 500).std(axis=0)
    return compare(
        "bootstrap",
        lambda: judged(own, criterion),
        f"refitting from rows in NumPy, {size.replicates} replicates scaled up; no standard "
        f"error of each replicate, which ours has",
        lambda: replicates(signals, step, size.replicates),
        200,
        {
            "median_ratio_of_standard_errors": float(np.median(ours / theirs)),
            "largest": float((ours / theirs).max()),
        },
        repeats=size.repeats,
        their_repeats=2,
        scale=REPLICATES / size.replicates,
    )


def errors(fits: list[dict[str, float]]) -> dict[str, float]:
    """Median error of each parameter in percent."""
    return {
        name: float(np.median([abs(fit[name] / truth - 1) for fit in fits]) * 100)
        for name, truth in TRUTH.items()
    }


def both(ours: dict[str, float], theirs: dict[str, float]) -> dict[str, float]:
    return {
        **{f"ours_{name}_percent": value for name, value in ours.items()},
        **{f"baseline_{name}_percent": value for name, value in theirs.items()},
    }


def arrays(seed: int) -> tuple[np.ndarray, ...]:
    own = record(seed)
    return tuple(np.asarray(v) for v in (own.time, own["x"], own["dx"], own["u"]))


@eqx.filter_jit
def refined(own: rx.Record) -> Array:
    return rx.refine(oscillator(), own, START).theta


def refinement(size: Size) -> Comparison:
    own, plain = jax.device_put(record(1)), arrays(1)
    found = rx.refine(oscillator(), own, START)
    ours = errors([{name: float(found[name]) for name in TRUTH}])
    return compare(
        "refine",
        lambda: refined(own),
        "SciPy least_squares over RK45 with a fair step",
        lambda: scipy_drag.fit(*plain),
        300,
        both(ours, errors([scipy_drag.fit(*plain)])),
        repeats=size.repeats,
        their_repeats=1,
    )


def drag_equation() -> rx.Equation:
    """m v' + r v + r2 v|v| + k x = u.

    Unlike the built-in `drag-oscillator`, which needs no velocity, from that velocity which the
    baseline is given too.
    """
    return rx.Equation(
        rx.Term("m", "dx", derivative=1),
        rx.Term("r", "dx"),
        rx.Term("r2", drag),
        rx.Term("k", "x"),
        -rx.Term(1.0, "u"),
    )


def drag(signals: Signals) -> Array:
    return signals["dx"] * abs(signals["dx"])


def weak_peer(size: Size) -> Comparison:
    equation = drag_equation()
    criterion = rx.RIEC(rx.AllWindows(0.5, 0.8), rx.Bump(4, lengths=1)).fitted([record(0)])
    ours = [
        dict(zip(TRUTH, np.asarray(identified(equation, record(s), criterion, {}))))
        for s in range(SEEDS)
    ]
    np.random.seed(0)  # noqa: NPY002  (PySINDy draws from the global generator)
    theirs = [pysindy_weak.fit(*arrays(s)) for s in range(SEEDS)]
    own, plain = record(1), arrays(1)
    return compare(
        "weak-peer",
        lambda: identified(equation, own, criterion, {}),
        "PySINDy weak form, K = 200, half-width 0.3 s",
        lambda: pysindy_weak.fit(*plain),
        50,
        both(errors(ours), errors(theirs)),
        repeats=5 * size.repeats,
        their_repeats=3,
    )


def run(size: Size) -> Iterator[Comparison]:
    yield bootstrap(size)
    yield refinement(size)
    yield weak_peer(size)

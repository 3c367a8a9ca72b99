"""A body whose damper pulls through a spring that its model may not know, solved by SciPy."""

import numpy as np
import scipy.signal

import riecjax as rx

STEP, FINER = 0.005, 8
TRUTH = {"m": 20.0, "c": 200.0, "k": 4000.0, "K_series": 10000.0}
"""Of body, damper, spring, and the spring in series with the damper: a lag of 20 ms."""
BODY = rx.Equation(
    rx.Term("m", "v", derivative=1, unit="kg"),
    rx.Term("c", "v", unit="N s/m"),
    rx.Term("k", "x", unit="N/m"),
    -rx.Term(1.0, "F"),
    name="body",
    unit="N",
)
MODEL = rx.staged(BODY).with_series_springs(rx.SeriesSpring("c"))


def state_matrix(
    mode: tuple[float, float, float] | None = None, series: float = TRUTH["K_series"]
) -> np.ndarray:
    """Of x, v and the damper's force, and of a mode's x, v where there is one."""
    m, c, k = TRUTH["m"], TRUTH["c"], TRUTH["k"]
    size = 3 if mode is None else 5
    a = np.zeros((size, size))
    a[:3, :3] = [[0, 1, 0], [-k / m, 0, -1 / m], [0, series, -series / c]]
    if mode is not None:
        heavy, stiff, loss = mode
        a[1, [0, 1, 3, 4]] += np.array([-stiff, -loss, stiff, loss]) / m
        a[3, 4] = 1.0
        a[4, [0, 1, 3, 4]] = np.array([stiff, loss, -stiff, -loss]) / heavy
    return a


def motion(
    count: int = 6000,
    seed: int = 3,
    mode: tuple[float, float, float] | None = None,
    series: float = TRUTH["K_series"],
) -> dict[str, np.ndarray]:
    """Position, velocity and force of the body, whose force is band-limited noise."""
    a = state_matrix(mode, series)
    size = a.shape[0]
    b = np.zeros((size, 1))
    b[1] = 1 / TRUTH["m"]
    rng = np.random.default_rng(seed)
    sharp = scipy.signal.butter(6, 40.0, fs=FINER / STEP, output="sos")
    force = 300 * np.asarray(scipy.signal.sosfilt(sharp, rng.standard_normal(count * FINER)))
    times = np.arange(force.size) * STEP / FINER
    _, states, _ = scipy.signal.lsim((a, b, np.eye(size), np.zeros((size, 1))), force, times)
    return {"x": states[::FINER, 0], "v": states[::FINER, 1], "F": force[::FINER]}


def noisy(signals: dict[str, np.ndarray], level: float, seed: int) -> rx.Record:
    """With white noise of this share of each signal's standard deviation."""
    rng = np.random.default_rng(seed)
    return rx.Record(
        {n: x + level * np.std(x) * rng.standard_normal(x.shape) for n, x in signals.items()}, STEP
    )

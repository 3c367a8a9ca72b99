"""A body whose damper pulls through a spring that its model may not know, solved by SciPy."""

import numpy as np

import riecjax as rx
from hidden_body import BODY, STEP, driven

TRUTH = {"m": 20.0, "c": 200.0, "k": 4000.0, "K_series": 10000.0}
"""Of body, damper, spring, and the spring in series with the damper: a lag of 20 ms."""
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
    return driven(state_matrix(mode, series), count, seed)


def noisy(signals: dict[str, np.ndarray], level: float, seed: int) -> rx.Record:
    """With white noise of this share of each signal's standard deviation."""
    rng = np.random.default_rng(seed)
    return rx.Record(
        {n: x + level * np.std(x) * rng.standard_normal(x.shape) for n, x in signals.items()}, STEP
    )

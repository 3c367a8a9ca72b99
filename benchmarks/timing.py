"""Fair timing: both sides in one process, warmed up, blocked on, medians over repeats."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np


class Comparison(NamedTuple):
    """One benchmark; ratio = baseline_s / ours_s, with the accuracy of both sides beside it."""

    name: str
    ours_s: float
    baseline: str
    baseline_s: float
    ratio: float
    target: float
    met: bool
    accuracy: dict[str, float]


def median_seconds(work: Callable[[], Any], repeats: int) -> float:
    """Median time of `work` after one warm-up, until its result is there."""
    jax.block_until_ready(work())
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(work())
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def compare(
    name: str,
    ours: float,
    baseline: str,
    baseline_s: float,
    target: float,
    accuracy: dict[str, float],
) -> Comparison:
    """Put both times side by side."""
    ratio = baseline_s / ours
    return Comparison(name, ours, baseline, baseline_s, ratio, target, ratio >= target, accuracy)

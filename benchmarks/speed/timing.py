"""Fair timing: both sides in one process, warmed up, blocked on, in turn, medians over repeats."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np


class Size(NamedTuple):
    """How much work is measured.

    **Fields:** `long_samples` of the long record; `seeds` of windows, of which NumPy does
    `numpy_seeds`; `batch` of roads; `replicates` that NumPy refits; `repeats` of each side.
    """

    long_samples: int
    seeds: int
    numpy_seeds: int
    batch: int
    replicates: int
    repeats: int


FULL = Size(4_000_000, 1000, 50, 64, 2000, 9)
SMALL = Size(400_000, 100, 20, 16, 200, 5)


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


def seconds(work: Callable[[], Any]) -> float:
    """Time of `work` until its result is there."""
    began = time.perf_counter()
    jax.block_until_ready(work())
    return time.perf_counter() - began


def compare(
    name: str,
    ours: Callable[[], Any],
    baseline: str,
    theirs: Callable[[], Any],
    target: float,
    accuracy: dict[str, float],
    *,
    repeats: int,
    their_repeats: int | None = None,
    scale: float = 1.0,
) -> Comparison:
    """Time both sides in turn, after one call of each.

    **Arguments:** `their_repeats`, fewer where the baseline takes long, whose first call was to
    compare answers; `scale`, by which the baseline's time is multiplied where it does only a part
    of the work.
    """
    seconds(ours)
    if their_repeats is None:
        seconds(theirs)
    here, there = [], []
    for turn in range(repeats):
        here.append(seconds(ours))
        if turn < (repeats if their_repeats is None else their_repeats):
            there.append(scale * seconds(theirs))
    ours_s, baseline_s = float(np.median(here)), float(np.median(there))
    ratio = baseline_s / ours_s
    return Comparison(name, ours_s, baseline, baseline_s, ratio, target, ratio >= target, accuracy)

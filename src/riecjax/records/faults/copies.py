"""A signal that another one was copied from, perhaps in another unit."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from riecjax.findings import Finding
from riecjax.records.faults.sampled_signal import SampledSignal

ROUNDED = 1e-3
"""Share of a standard deviation by which rounding may part a signal from its copy."""
DIGITS = 1e-9
"""The same of the last digits of computed values."""
SMOOTH = 0.9
"""Correlation of successive differences past which they are physical, and not of rounding."""
LOOKED_AT = 20_000
"""Samples that tell most pairs apart."""


def copied_signals(signals: Sequence[SampledSignal]) -> Iterator[Finding]:
    """Pairs of which one is the other times a factor, perhaps with an offset.

    Two sensors have two noises. What parts them here is no more than rounding, which is white,
    where the little that parts a slow force from its spring is smooth.
    """
    for one, other in combinations(signals, 2):
        stride = max(one.values.size // LOOKED_AT, 1)
        if _line(one.values[::stride], other.values[::stride], 1.0) is None:
            continue
        line = _line(one.values, other.values, SMOOTH)
        if line is None:
            continue
        factor, offset = line
        same = abs(factor - 1) < ROUNDED and abs(offset) < ROUNDED * np.nanstd(other.values)
        said = (
            f"{other.name} holds the samples of {one.name}"
            if same
            else f"{other.name} is {factor:.4g} times {one.name}"
            + (f" plus {offset:.4g}" if abs(offset) > ROUNDED * np.nanstd(other.values) else "")
        )
        yield Finding(
            "copied_signal",
            f"{said}, to the last digit or rounding, so that both are one measurement, and nothing "
            f"tells their terms apart. Check which column is which (on the command line: --map), "
            f"and leave the copy out.",
            (one.name, other.name),
            doubt=1.0,
        )


def _line(first: np.ndarray, second: np.ndarray, smooth: float) -> tuple[float, float] | None:
    """Factor and offset that make the second of the first, `None` where none do."""
    both = ~(np.isnan(first) | np.isnan(second))
    if both.sum() < 3:
        return None
    size = [float(np.max(np.abs(v[both]))) or 1.0 for v in (first, second)]
    x, y = first[both] / size[0], second[both] / size[1]
    mean_x, mean_y = np.mean(x), np.mean(y)
    x, y = x - mean_x, y - mean_y
    energy = float(x @ x)
    if not energy or not y.any():
        return None
    slope = float(x @ y) / energy
    left = (y - slope * x) / np.std(y)
    worst = float(np.max(np.abs(left)))
    if worst > ROUNDED or (worst > DIGITS and left[1:] @ left[:-1] > smooth * (left @ left)):
        return None
    factor = slope * (size[1] / size[0])
    return factor, float(mean_y * size[1] - factor * mean_x * size[0])

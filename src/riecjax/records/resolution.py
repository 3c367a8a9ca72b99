"""Which values a signal takes: its levels, and the quantum between them."""

import numpy as np

MOST_OUTLIERS = 0.01
"""Share of samples; more of them are how the signal is."""
ROUNDING = 1e-9
"""Share of a signal's range within which values are one: computed ones differ in last digits."""
FEW_LEVELS = 20
"""Distinct values up to which a signal counts as a command or a relay, not as a sensor's."""
LAST_DIGITS = 1e-13
"""Share of a signal's range that is rounding for certain."""


def rounding_of(samples: np.ndarray) -> float:
    """How far computed values may differ that are one: a share of the range without spikes."""
    if not samples.size:
        return 0.0
    whole = float(np.ptp(samples))
    usual = float(np.ptp(np.quantile(samples, [MOST_OUTLIERS, 1 - MOST_OUTLIERS])))
    # What is at rest but for its last digits has no range without its few moves.
    return ROUNDING * (usual if usual > LAST_DIGITS * whole else whole)


def levels_of(samples: np.ndarray, rounding: float) -> tuple[np.ndarray, np.ndarray]:
    """Distinct values, ascending, and how often each occurs."""
    distinct, counts = np.unique(samples, return_counts=True)
    if not distinct.size:
        return distinct, counts
    new = np.concatenate([[True], np.diff(distinct) > rounding])
    return distinct[new], np.add.reduceat(counts, np.flatnonzero(new))


def resolution_of(levels: np.ndarray) -> float:
    """The quantum whose multiples lie between neighbouring levels, 0 if there is none."""
    if levels.size < 3:
        return 0.0
    steps = np.diff(levels)
    smallest = float(np.min(steps))
    # The smallest step carries rounding; the mean of all steps of about its size less of it.
    quantum = float(np.mean(steps[steps < 1.5 * smallest]))
    multiples = steps / quantum
    near = np.abs(multiples - np.round(multiples)) < 0.02 + 1e-3 * multiples
    return quantum if np.mean(near[multiples < 100]) > 0.99 else 0.0


def is_piecewise_linear(values: np.ndarray, levels: np.ndarray, rounding: float) -> bool:
    """Whether more than half of the samples lie on straight lines, as only commands do."""
    bend = np.diff(values, 2)
    extreme = np.isin(values[1:-1], levels[[0, -1]])
    inner = np.abs(bend[~extreme & ~np.isnan(bend)])
    return not inner.size or bool(np.mean(inner <= rounding) > 0.5)

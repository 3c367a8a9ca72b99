"""A signal that sits at the end of its range, as of a converter."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from riecjax.findings import Finding
from riecjax.records.faults.sampled_signal import (
    FEW_LEVELS,
    LONGEST_REST,
    SampledSignal,
    is_piecewise_linear,
    percent,
)

PILE_UP = 5.0
"""Times more often than at the next four levels that a clipped signal sits at its extreme. The
crest of a quantised signal, a parabola, sits there at most 3.2 times as often."""
REPEATS = 2.5
"""The same for a signal that is not quantised, in which no value comes twice but by a period."""
FEWEST_VISITS = 3
"""Times that a signal must have run into its limits, both together, to count as clipped."""
STEEP = 10.0
"""Quanta by which a steep approach lies off the extreme two samples before, so that rounding does
not hide it. A crest that stays within its last quantum for 3 samples comes from less than 9."""


class _Visits(NamedTuple):
    """Times that a signal sits at an extreme where it does not just turn round."""

    which: str
    extreme: float
    starts: np.ndarray
    samples: int
    steep: int
    """Visits that came from far off, and left for far off."""


def clipped(signal: SampledSignal) -> Iterator[Finding]:
    """Runs into an extreme from far off, which a crest never does, and sits there."""
    if signal.levels.size <= FEW_LEVELS or is_piecewise_linear(signal):
        return
    sides = [_visits(signal, "maximum", 1.0), _visits(signal, "minimum", -1.0)]
    sides = [side for side in sides if side is not None and side.steep]
    if sum(side.steep for side in sides) < FEWEST_VISITS:
        return
    for side in sides:
        yield signal.finding(
            "clipped",
            f"sits at its {side.which} of {signal.with_unit(side.extreme)} in {side.starts.size} "
            f"place(s), {percent(side.samples, signal.sample_count)} of the samples, first at "
            f"{signal.time[side.starts[0]]:.4g} s, as a converter at the end of its range does. "
            f"Record with a larger range or leave those stretches out, unless the limit is real, "
            f"as of a command or of a wheel that lifts.",
            doubt=side.samples / signal.sample_count,
        )


def _visits(signal: SampledSignal, which: str, sign: float) -> _Visits | None:
    """Visits to one extreme; `None` where it is a crest, or where the signal rests."""
    order = np.argsort(-sign * signal.levels)[:5]
    extreme, samples = signal.levels[order[0]], int(signal.counts[order[0]])
    ratio = PILE_UP if signal.resolution else REPEATS
    piles_up = samples > ratio * np.mean(signal.counts[order[1:]])
    if not piles_up or samples > LONGEST_REST * signal.sample_count:
        return None
    visits = np.abs(signal.run_values - extreme) <= signal.rounding
    starts, lengths = signal.run_starts[visits], signal.run_lengths[visits]
    quantum = max(signal.resolution, signal.rounding)
    steep = np.ones(starts.size, bool)
    inside = np.pad(sign * (extreme - signal.values), 4, constant_values=np.nan)
    for edges, outward in ((starts, -1), (starts + lengths - 1, 1)):
        near, far = (inside[4 + edges + k * outward] for k in (2, 4))
        steep &= (near > STEEP * quantum) & ~_comes_to_rest(near, far, quantum)
    return _Visits(which, float(extreme), starts, samples, int(steep.sum()))


def _comes_to_rest(near: np.ndarray, far: np.ndarray, quantum: float) -> np.ndarray:
    """Whether an approach to an extreme, 2 and 4 samples before it, may end there as a parabola.

    At a deceleration a, k samples before the extreme seems reached, the distance is
    a (k + s)^2 / 2, where the last quantum q = a s^2 / 2 hides the end for s samples. Hence
    sqrt(far / near) = (4 + s) / (2 + s) = 2 - sqrt(q / near), and more where the deceleration
    falls. On a straight approach far / near is 2 to 3.
    """
    hidden = np.sqrt(np.minimum(quantum / np.maximum(near, quantum), 1.0))
    return near * (2 - hidden) ** 2 <= far

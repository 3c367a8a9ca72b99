"""A signal that sits at the end of its range, as of a converter."""

import shlex
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from riecjax.findings import Finding
from riecjax.records.faults.sampled_signal import (
    ENOUGH,
    LONGEST_REST,
    SampledSignal,
    percent,
)

PILE_UP = 5.0
"""Times more often than at the next four levels that a clipped signal sits at its extreme. The
crest of a quantised signal, a parabola, sits there at most 3.2 times as often."""
REPEATS = 2.5
"""The same for a signal that is not quantised, in which no value comes twice but by a period."""
FEWEST_VISITS = 3
"""Times that a signal must have run into its limits, both together, to count as clipped; once where
no other value of it comes twice."""
FOLLOWED = 0.98
"""Share of a signal that others must explain to tell what it does at its limit."""
LAGS = range(-2, 3)
BEYOND = 0.1
"""Standard deviations beyond a limit where others must surely not say that a signal goes on."""
MANY_VISITS = 10
"""Visits to a limit that are enough to tell."""
STEEP = 10.0
"""Quanta by which a steep approach lies off the extreme two samples before, so that rounding does
not hide it. A crest that stays within its last quantum for 3 samples comes from less than 9."""
AWAY = 4
"""Samples in which noise, and no motion, leaves an extreme and returns to it."""


class Visits(NamedTuple):
    """Times that a signal sits at an extreme where it does not just turn round."""

    which: str
    extreme: float
    starts: np.ndarray
    samples: int
    steep: int
    """Visits that came from far off, and left for far off."""


def clipped(signal: SampledSignal, others: Sequence[SampledSignal] = ()) -> Iterator[Finding]:
    """Runs into an extreme from far off, which a crest never does, and sits there.

    Unless other signals say that the limit is real, as the motion of a wheel that lifts does of the
    force on its tyre.
    """
    for side in (one for one in limits(signal) if not is_real(signal, one, others)):
        remedy = ("--leave-out", signal.name)
        yield signal.finding(
            "clipped",
            f"sits at its {side.which} of {signal.with_unit(side.extreme)} in {side.starts.size} "
            f"place(s), {percent(side.samples, signal.sample_count)} of the samples, first at "
            f"{signal.time[side.starts[0]]:.4g} s, as a converter at the end of its range does. "
            f"Record with a larger range, or leave them out (on the command line: "
            f"{shlex.join(remedy)}), unless the limit is real, as of a command or of a wheel that "
            f"lifts.",
            doubt=side.samples / signal.sample_count,
            remedy=remedy,
            step=f"Leave out what {signal.name} shows at the end of its range",
        )


def limits(signal: SampledSignal) -> list[Visits]:
    """Extremes into which a signal ran, real ones too."""
    if signal.is_command:
        return []
    sides = [_visits(signal, "maximum", 1.0), _visits(signal, "minimum", -1.0)]
    found = [side for side in sides if side is not None and side.steep]
    unique = not signal.resolution and np.mean(signal.counts == 1) > 0.999
    enough = sum(side.steep for side in found) >= (1 if unique else FEWEST_VISITS)
    return found if enough else []


def _visits(signal: SampledSignal, which: str, sign: float) -> Visits | None:
    """Visits to one extreme; `None` where it is a crest, or where the signal rests."""
    outermost = slice(None, -6, -1) if sign > 0 else slice(5)
    extreme, (samples, *others) = signal.levels[outermost][0], signal.counts[outermost].tolist()
    ratio = PILE_UP if signal.resolution else REPEATS
    piles_up = samples > ratio * np.mean(others)
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
    # Noise takes it far off and back at once, which no motion does.
    gaps = np.stack([starts[:-1] + lengths[:-1], starts[1:]], axis=1)
    if len(gaps):
        depth = np.fmax.reduceat(inside[4:-4], gaps.ravel())[::2]
        away = (np.diff(gaps)[:, 0] <= AWAY) & (depth > STEEP * quantum)
        steep |= np.pad(away, (0, 1)) | np.pad(away, (1, 0))
    return Visits(which, float(extreme), starts, samples, int(steep.sum()))


def _comes_to_rest(near: np.ndarray, far: np.ndarray, quantum: float) -> np.ndarray:
    """Whether an approach to an extreme, 2 and 4 samples before it, may end there as a parabola.

    At a deceleration a, k samples before the extreme seems reached, the distance is
    a (k + s)^2 / 2, where the last quantum q = a s^2 / 2 hides the end for s samples. Hence
    sqrt(far / near) = (4 + s) / (2 + s) = 2 - sqrt(q / near), and more where the deceleration
    falls. On a straight approach far / near is 2 to 3.
    """
    hidden = np.sqrt(np.minimum(quantum / np.maximum(near, quantum), 1.0))
    return near * (2 - hidden) ** 2 <= far


def is_real(signal: SampledSignal, side: Visits, others: Sequence[SampledSignal]) -> bool:
    """Whether other signals, at lags of two samples, stay at the limit with the signal.

    Of a sensor at the end of its range all that follows the signal goes on beyond. Of a real limit
    one balance may break there, such as that of a spring that parts, so that one signal and two are
    left out in turn; the others, such as the masses that it moves, keep to it.
    """
    rows = [np.stack([np.roll(s.values, lag) for lag in LAGS]) for s in others if s.levels.size > 1]
    if len(rows) < 2 or side.starts.size < MANY_VISITS:
        return False
    target, inside = signal.values, np.zeros(signal.values.size, bool)
    inside[2:-2] = True
    known = inside & ~np.isnan(np.concatenate([target[None], *rows])).any(axis=0)
    held = known & (np.abs(target - side.extreme) <= signal.rounding)
    free = np.flatnonzero(known & ~held)
    free = free[:: max(free.size // ENOUGH, 1)]
    if not held.any() or free.size < 100:
        return False
    size = float(np.std(target[free]))
    sign = 1.0 if side.which == "maximum" else -1.0
    for left_out in (*combinations(range(len(rows)), 1), *combinations(range(len(rows)), 2)):
        kept = [row for i, row in enumerate(rows) if i not in left_out]
        columns = np.concatenate([*kept, np.ones((1, target.size))])[:, known]
        columns /= np.maximum(np.max(np.abs(columns), axis=1, keepdims=True), np.finfo(float).tiny)
        outside, there = np.searchsorted(np.flatnonzero(known), free), held[known]
        weights = np.linalg.lstsq(columns[:, outside].T, target[free] / size, rcond=1e-10)[0]
        error = float(np.std(target[free] / size - weights @ columns[:, outside]))
        beyond = sign * (weights @ columns[:, there] - side.extreme / size)
        surely = np.mean(beyond) + 2 * np.std(beyond) / np.sqrt(side.starts.size)
        if error**2 < 1 - FOLLOWED and surely < BEYOND:
            return True
    return False

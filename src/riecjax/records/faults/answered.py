"""Whether the motion answers to what looks like spikes: blows of a hammer, impacts, short pulses.

A force that acts for a few samples changes a velocity by its impulse over the mass, and the slope
of a position. What goes wrong in one sensor changes nothing in another. So lines are put through
the samples before and behind each spike of every other signal, straight ones and parabolas: where
their levels or slopes part further than they do elsewhere, the spike acted.
"""

import math
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float, Int

from riecjax.records.faults.local_fits import LONGEST

LEVEL = 1e-3
"""Probability by chance, over all signals, below which an answer is told."""
SIDE = 8
"""Samples of each line."""
GAP = LONGEST // 2 + 1
"""Samples to each side of the middle of a spike that no line goes through."""
NEAR = 2 * (GAP + SIDE)
"""Samples around a spike that are not elsewhere."""
BEYOND = 4.0
"""Times the largest parting elsewhere that is no chance."""
COEFFICIENTS = (2, 3)
"""Of lines and parabolas."""
TESTS = 2 * len(COEFFICIENTS)
"""Of each signal: the level and the slope of both."""
MOST = 64
"""Spikes that are looked at."""


def are_answered(places: Int[np.ndarray, " k"], others: Iterable[Float[np.ndarray, " n"]]) -> bool:
    """Whether some other signal shows that spikes at these samples acted.

    **Arguments:** `places`, ascending; `others` at the same times, without spikes of their own, NaN
    where samples are missing.
    """
    others, middles = list(others), _middles(places)[:MOST]
    # One after the other: of long records all together would fill the memory.
    tests = (parting for other in others for parting in _partings(other))
    level = LEVEL / max(TESTS * len(others), 1)
    return any(_by_chance(middles, places, test) < level for test in tests)


def _middles(places: Int[np.ndarray, " k"]) -> Int[np.ndarray, " groups"]:
    """The middle sample of each group of neighbours."""
    groups = np.split(places, np.flatnonzero(np.diff(places) > LONGEST) + 1)
    return np.array([group[group.size // 2] for group in groups if group.size], int)


def _partings(values: Float[np.ndarray, " n"]) -> list[Float[np.ndarray, " n"]]:
    """By how much level and slope of lines, and of parabolas, to both sides of each sample part;
    NaN at ends."""
    if values.size < NEAR:
        return []
    offsets = np.arange(GAP + 1, GAP + SIDE + 1)
    found = []
    for coefficients in COEFFICIENTS:
        fit = np.linalg.pinv(np.vander(offsets, coefficients, increasing=True))
        for taps, sign in zip(fit[:2], (-1, 1)):
            # Before the sample time runs the other way: there levels are alike, slopes opposite.
            around = np.concatenate([sign * taps[::-1], np.zeros(2 * GAP + 1), taps])
            inside = np.convolve(values, around[::-1], "valid")
            found.append(np.abs(np.pad(inside, GAP + SIDE, constant_values=np.nan)))
    return found


def _by_chance(
    middles: Int[np.ndarray, " groups"],
    places: Int[np.ndarray, " k"],
    parting: Float[np.ndarray, " n"],
) -> float:
    """Probability that lines part so far at samples that are none in particular.

    The share of all samples where they part further is a p-value, and of n of them the sum of
    -log p has a gamma distribution. Few blows are too few for that; they are told by their size, if
    nothing elsewhere comes near it.
    """
    there = ~np.isnan(parting)
    found = parting[middles]
    found = found[~np.isnan(found)]
    if not found.size:
        return 1.0
    elsewhere = there.copy()
    for place in places:
        elsewhere[max(place - NEAR, 0) : place + NEAR + 1] = False
    if np.median(found) > BEYOND * np.max(parting, where=elsewhere, initial=0.0):
        return 0.0
    usual = np.sort(parting[there])
    beyond = usual.size - np.searchsorted(usual, found)
    total = -float(np.sum(np.log((1 + beyond) / (1 + usual.size))))
    terms = [k * math.log(max(total, 1e-300)) - math.lgamma(k + 1) for k in range(found.size)]
    return sum(math.exp(term - total) for term in terms)

"""Whether a recorded derivative is no sensor's, but computed from the position: differences, slopes
of polynomials, or any other filter of some dozens of samples.

Such a signal has the position's noise, many times as large and of one source with it. Taken for a
sensor's own, white and independent, it biases every estimate.
"""

from collections.abc import Collection

import numpy as np
from jaxtyping import Float

from riecjax.errors import DataError
from riecjax.leaves import is_concrete
from riecjax.records.faults.derivative_pairs import Pairs, Relation
from riecjax.records.faults.sampled_signal import ENOUGH
from riecjax.records.noise import Noise
from riecjax.records.preparation import with_local_derivative
from riecjax.records.record import Record, runs
from riecjax.records.remembered import remembered

HALVES = (1, 2, 5, 10, 30)
"""Samples to each side of filters that are tried, the longest first as the test of all."""
LEFT = 0.1
"""What such a filter leaves at most, in terms of the position's noise through it. A sensor's own
noise is left whole: a filter of the position cannot tell it."""
MOST_NOISE = 2.0
"""Noise through a filter, in terms of all that there is of it and of motion, past which the filter
is none."""
LEAST = 1e-5
"""Noise of differences, as a share of these, below which it matters to nothing: what looks like it
may be motion that no difference is of the order to take off."""
CONSTANT = 0.3
"""Share of its taps that a filter's sum may reach: a derivative of what is constant is zero. What
copies the position, or smooths it, is no derivative, and to take it for one would hide that."""
ROUNDS, FAR = 3, 10.0
"""Fits, each without rows that the one before left so many times its median."""
SHARPENED = 2
"""Order of the differences that are looked at, in which motion hides noise less."""


def without_computed(
    record: Record, pairs: Pairs, known: Collection[str] = ()
) -> tuple[Record, list[str]]:
    """Slopes of local polynomials in place of derivatives that are filters of their signals.

    A signal's own sensor is all that such a derivative knows of; the polynomials are as wide as its
    motion allows. Not under jit, where the record stays as it is.

    **Arguments:** `pairs` of a signal and its derivative; `known`, signals whose noise was given:
    a sensor's, then.

    **Returns:** the record, and what was done, in words.
    """
    if not is_concrete(record):
        return record, []
    computed, words, judging = [], [], record
    for signal, derivative in (p for p in pairs if not isinstance(p, Relation)):
        noise = judging.noise
        judged = noise.kernels.get(signal) and {signal, derivative} <= {*record.arrays}
        # Some are made of their signals by a step of preparation.
        if derivative in known or not judged or noise.is_made_of(derivative, signal):
            continue
        position, rate = (record.signal(name).with_nan for name in (signal, derivative))
        taps = filter_between(position, rate, float(noise.std(signal)))
        if taps is not None:
            judging = _with_noise_of(judging, signal, derivative, taps)
            computed.append((signal, derivative, taps))
    for signal, derivative, taps in computed:
        said = f"{derivative}: computed from {signal}, by a filter of {taps.size} samples"
        try:
            record, width = with_local_derivative(record, signal, derivative)
            said = f"{said}; in its place slopes of local polynomials, {width:.3g} s to each side"
        except DataError:  # too short for them
            record = _with_noise_of(record, signal, derivative, taps)
        words.append(said)
    return record, words


def _with_noise_of(record: Record, signal: str, derivative: str, taps: np.ndarray) -> Record:
    """The record, of whose derivative the noise is the signal's through these taps."""
    return record.with_noise(Noise.of({derivative: record.noise[signal].convolved(taps)}))


@remembered(lambda signal, other, noise: (signal, other, noise))
@np.errstate(over="ignore", invalid="ignore")
def filter_between(
    signal: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"], noise: float
) -> Float[np.ndarray, " taps"] | None:
    """Taps of the shortest filter that makes one signal of another, whose noise has this standard
    deviation; `None` if none does."""
    stretches = runs(~(np.isnan(signal) | np.isnan(other))).T.tolist()
    first, stop = max(stretches, key=lambda ends: ends[1] - ends[0], default=(0, 0))
    # Differences are one-sided at the ends.
    position, rate = (each[first + 1 : stop - 1][:ENOUGH] for each in (signal, other))
    x, y = (np.diff(each, SHARPENED) for each in (position, rate))
    if position.size < 8 * HALVES[-1] or not noise / np.sqrt(2) > LEAST * np.std(np.diff(position)):
        return None
    scale = np.std(x)
    # What is not finite squared, no sensor shows.
    if not (noise > 0 and np.isfinite(scale + np.std(y))):
        return None
    columns = np.lib.stride_tricks.sliding_window_view(x / scale, 2 * HALVES[-1] + 1)
    target = y[HALVES[-1] : y.size - HALVES[-1]]
    found = None
    for half in reversed(HALVES):
        inner = slice(HALVES[-1] - half, HALVES[-1] + half + 1)
        # Least squares, and what is left where no spike was repaired in one of the two.
        kept, left, taps = np.ones(target.size, bool), target, np.zeros(0)
        for _ in range(ROUNDS):
            some = columns[kept, inner]
            taps = np.linalg.lstsq(some.T @ some, some.T @ target[kept], rcond=1e-14)[0]
            left = target - columns[:, inner] @ taps
            kept = np.abs(left) <= FAR * np.median(np.abs(left[kept]))
        through = noise / scale * np.linalg.norm(np.convolve(taps, [1, -2, 1]))
        # Taps that make more noise than there is fit motion alone, which few waves are.
        there = np.sqrt(np.mean(target**2))
        if not (
            np.sqrt(np.mean(left[kept] ** 2)) < LEFT * through and through < MOST_NOISE * there
        ):
            break
        found = taps[::-1] / scale
    if found is not None and abs(found.sum()) > CONSTANT * np.abs(found).sum():
        return None
    return found

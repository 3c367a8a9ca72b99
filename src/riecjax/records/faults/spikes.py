"""Spikes of one to three samples, found against the noise around them, and what belongs there.

A spike of height h adds h times 1, -6, 15, -20, 15, -6, 1 to seven differences of sixth order, in
which smooth motion is next to nothing and white noise of standard deviation sigma has sqrt(924)
sigma. Samples near a large one are suspects. Each is judged by a polynomial through the samples
around it, itself left out and others weighed by Tukey's biweight, which no neighbouring spike
moves. Motion that no such polynomial follows hides spikes that are no larger than it is off them.

What machines do stays: after a step or a corner the polynomial follows one side, and the other side
is off it for longer than a spike lasts; a pulse among steps of its own size, as of a relay, is one
of them; and of a command that follows straight lines, or takes few values, only what is far beyond
all others is a spike.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from riecjax.records.faults.local_fits import LONGEST, NORMAL, SUSPECT, Around, Local, fits, medians
from riecjax.records.noise import DIFFERENCE_ORDER
from riecjax.records.remembered import remembered
from riecjax.records.resolution import (
    FEW_LEVELS,
    ROUNDING,
    is_piecewise_linear,
    levels_of,
    resolution_of,
)

SPIKE = 6.0
"""Standard deviations that a spike is off the polynomial at the least."""
MOST_SUSPECTS = 0.8
"""Share of samples past which suspects are how the signal is; 13 are around each spike."""
SHAPES = ((3, 8), (5, 8), (7, 8))
"""Degree of the polynomials, and samples to each side that they go through. Of each signal, those
that lie nearest to samples left out: a cubic has 0.37 of the noise in its middle, and bends least.
Motion quicker than the last shows in sixth differences too."""
FEWEST = 20
"""Samples below which nothing is looked for."""
BLOCK = 128
"""Samples over which noise is taken to be alike."""
STEADIEST = 0.1
"""Share of the noise of all of a signal that its noise is anywhere, at the least."""
BEYOND = 1e3
"""Times the largest other value past which a sample of a command is none that was meant."""
IMPOSSIBLE = 1e30
"""What no command takes in any unit, though all of its other values are zero."""
TAIL = 2.0
"""Samples at two thirds to all of a threshold, for each one beyond it, past which the noise has
long tails, of which no line separates spikes."""
BY_CHANCE = 3
"""More of them that may be by chance."""
FEW, TAIL_BLOCK, USUAL_TAIL = 0.03, 1024, 3.0
"""A spike adds two thirds of its size to a difference; that is to be twice what three in a hundred
of them reach nearby once spikes are taken out. In white noise this asks for 6.5 of its standard
deviations, and among corners, kicks or steps for more than is usual there."""
PASSES = 12
"""Times that suspects are found anew, once spikes do not hide others."""
LARGEST = 1e60
"""Robust scales at which values are cut off, so that their squares are numbers."""
GAIN = float(np.sqrt(np.sum(np.poly([1.0] * DIFFERENCE_ORDER) ** 2)))
GAIN_OF_TWO = float(np.linalg.norm(np.convolve(np.poly([1.0] * DIFFERENCE_ORDER), [1, 1])))
LARGE = 6.5
"""Standard deviations of the sum of two neighbouring differences that make suspects, too: two equal
spikes side by side add 10 times their height to it, in which noise has 16 of its own, and 9 to each
difference, in which it has 30. They are looked at where polynomials mostly miss samples by no more
than `FOLLOWED` times the noise: beside motion that none follows, its corners would count."""
FOLLOWED = 2.0
_LOCAL = [Local.of(degree, beside) for degree, beside in SHAPES]


class Spikes(NamedTuple):
    """Samples that are spikes.

    **Fields:** `places`, ascending; `repaired`, the local polynomial's values there; `sizes`, how
    far off it they are; `noise`, the standard deviation of what is around them; shapes `(k,)`.
    """

    places: Int[np.ndarray, " k"]
    repaired: Float[np.ndarray, " k"]
    sizes: Float[np.ndarray, " k"]
    noise: Float[np.ndarray, " k"]


# Values up to the largest number overflow when scaled; they are cut off.
@remembered(64, lambda values: (np.asarray(values, float),))
@np.errstate(all="ignore")
def find_spikes(values: Float[np.ndarray, " n"]) -> Spikes:
    """The spikes of a signal, NaN where samples are missing."""
    values = np.asarray(values, float)
    known = values[~np.isnan(values)]
    none = Spikes(np.zeros(0, int), *(np.zeros(0) for _ in range(3)))
    if known.size < FEWEST:
        return none
    centre, scale = np.median(known), _spread(known)
    scaled = np.clip((values - centre) / scale, -LARGEST, LARGEST)
    levels = levels_of(scaled[np.abs(scaled) < BEYOND], ROUNDING)[0]
    if levels.size <= FEW_LEVELS or is_piecewise_linear(scaled, levels, ROUNDING):
        return _beyond_all(values) or none
    local = min(_LOCAL, key=lambda each: each.error(scaled))
    found, noise = _judged(scaled, resolution_of(levels), local)
    places = np.flatnonzero(found)
    if not places.size:
        return none
    stretch = np.cumsum(np.isnan(scaled))
    repaired = fits(np.where(found, np.nan, scaled), places, noise, stretch, local).value
    repaired = centre + scale * repaired
    return Spikes(places, repaired, np.abs(values[places] - repaired), scale * noise[places])


def _spread(known: np.ndarray) -> float:
    """How widely values spread that are not spikes."""
    for share in (0.1, 0.01, 0.0):
        low, high = np.quantile(known, [share, 1 - share])
        if high > low:
            return float(min(high - low, np.finfo(float).max))
    return 1.0


def _beyond_all(values: np.ndarray) -> Spikes | None:
    """Of a command, what is far beyond all other values; the value before takes its place."""
    sizes = np.abs(values)
    ranked = np.sort(sizes[~np.isnan(sizes)])[::-1]
    ranked = ranked[: ranked.size // 10 + 2]
    apart = ranked[:-1] > np.where(ranked[1:] > 0, BEYOND * ranked[1:], IMPOSSIBLE)
    if not apart.any():
        return None
    far = sizes >= ranked[np.flatnonzero(apart)[-1]]
    far &= ~_in_runs_beyond(far, LONGEST)
    places = np.flatnonzero(far)
    if not places.size:
        return None
    there = np.flatnonzero(~far & ~np.isnan(values))
    held = values[there[np.maximum(np.searchsorted(there, places) - 1, 0)]]
    return Spikes(places, held, np.abs(values[places] - held), np.zeros(places.size))


def _judged(
    scaled: Float[np.ndarray, " n"], quantum: float, local: Local
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Which samples are spikes, and the noise around each."""
    cleaned, sizes = scaled.copy(), np.zeros(scaled.size)
    noise, stretch = sizes, np.cumsum(np.isnan(scaled))
    around, half = Around(stretch, local), DIFFERENCE_ORDER // 2
    # Up to two samples from an end or a gap the differences hold a fifth of a spike at the most.
    ends = np.convolve(~np.isnan(scaled), np.ones(5), "same") < 5
    for _ in range(PASSES):
        differences = np.diff(cleaned, DIFFERENCE_ORDER)
        sixth = np.abs(differences) / GAIN
        of_two = np.abs(differences[1:] + differences[:-1]) / GAIN_OF_TWO
        noise = _local_noise(sixth, scaled.size, quantum)
        large = np.zeros(scaled.size, bool)
        large[half:-half] = sixth > SUSPECT * noise[half:-half]
        pairs = of_two > LARGE * noise[half : -half - 1]
        if pairs.any() and np.median(noise) > local.error(cleaned) / FOLLOWED:
            large[half : -half - 1] |= pairs
        # The first and last three samples stand in the middle of no difference.
        near = np.convolve(large, np.ones(DIFFERENCE_ORDER + 1), "same") > 0
        suspects = np.flatnonzero((near | ends) & ~np.isnan(cleaned) & (sizes == 0))
        if not 0 < suspects.size <= MOST_SUSPECTS * scaled.size:
            break
        held = np.where(sizes > 0, np.nan, scaled)
        fit, scale, *_ = around.at(held, suspects, noise)
        off = np.abs(scaled[suspects] - fit)
        # A spike spoils the polynomials of its neighbours: the largest first.
        largest = np.zeros(scaled.size)
        largest[suspects] = np.where(off > SPIKE * scale, off, 0.0)
        new = (off > SPIKE * scale) & (off >= _running_maximum(largest, local.beside)[suspects])
        if not new.any():
            break
        sizes[suspects[new]], cleaned[suspects[new]] = (off / scale)[new], fit[new]
        around.forget(suspects[new])
    found = (sizes > 0) & ~_in_runs_beyond(sizes > 0, LONGEST)
    off = sizes
    for _ in range(2):  # what is dropped tells more of those beside it
        places, cleaned = np.flatnonzero(found), np.where(found, np.nan, scaled)
        fit, scale, clear, _ = fits(cleaned, places, noise, stretch, local)
        cleaned[places] = fit
        off = np.abs(scaled - cleaned)
        found[places] &= off[places] > np.maximum(clear, SPIKE / 2 * scale)
    sixth = np.abs(np.diff(cleaned, DIFFERENCE_ORDER))
    rest = local.off(cleaned)
    found &= off > USUAL_TAIL * _tail(sixth / GAIN, off.size)
    found &= off > USUAL_TAIL * local.gain * _tail(rest, off.size)
    # Where noise changes within a block, the block's own is too small for a part of it.
    edged = np.pad(noise, BLOCK, mode="edge")
    most = np.maximum(noise, np.maximum(edged[: -2 * BLOCK], edged[2 * BLOCK :]))
    found &= sizes >= _threshold(rest, sizes[found], most)
    return found & ~_among_others(rest[rest > SUSPECT * most], off, found), noise


def _local_noise(sixth: np.ndarray, count: int, quantum: float) -> np.ndarray:
    """The noise around each of so many samples, by medians over blocks."""
    local = _local(sixth, count)
    some = local[local > 0]
    usual = np.median(some) if some.size else 0.0
    local = np.maximum(np.where(np.isnan(local), usual, local), STEADIEST * usual)
    return np.maximum(local, quantum)


def _local(sizes: Float[np.ndarray, " m"], count: int) -> Float[np.ndarray, " count"]:
    """Standard deviation of what has these sizes, around each of so many samples."""
    rows = _rows(sizes, BLOCK)
    return _spread_out(medians(rows) / NORMAL, rows.shape[1], count)


def _tail(sixth: Float[np.ndarray, " m"], count: int) -> Float[np.ndarray, " count"]:
    """What a few of these sizes reach, around each of so many samples."""
    rows = _rows(sixth, TAIL_BLOCK)
    ordered = np.sort(np.nan_to_num(rows), axis=1)
    return _spread_out(ordered[:, -1 - int(FEW * rows.shape[1])], rows.shape[1], count)


def _rows(sizes: Float[np.ndarray, " m"], length: int) -> Float[np.ndarray, "blocks about_length"]:
    """In blocks of about one length, the last filled up with NaN."""
    blocks = max(sizes.size // length, 1)
    size = -(-sizes.size // blocks)
    padded = np.pad(sizes, (0, blocks * size - sizes.size), constant_values=np.nan)
    return padded.reshape(blocks, size)


def _spread_out(values: Float[np.ndarray, " blocks"], length: int, count: int) -> np.ndarray:
    """Of each of so many samples what its block of a length has."""
    local = np.repeat(values, length)
    return np.pad(local, (0, max(count - local.size, 0)), mode="edge")[:count]


def _running_maximum(values: Float[np.ndarray, " n"], beside: int) -> Float[np.ndarray, " n"]:
    """The largest of as many values to each side, and its own."""
    padded = np.pad(values, beside)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * beside + 1).max(axis=1)


def _in_runs_beyond(mask: Bool[np.ndarray, " n"], longest: int) -> Bool[np.ndarray, " n"]:
    """Where a mask is true for more than so many samples in succession."""
    edges = np.flatnonzero(np.diff(np.pad(mask.astype(np.int8), 1)))
    starts, stops = edges[::2], edges[1::2]
    inside = np.zeros(mask.size + 1, int)
    long = stops - starts > longest
    np.add.at(inside, starts[long], 1)
    np.add.at(inside, stops[long], -1)
    return np.cumsum(inside)[:-1] > 0


def _threshold(
    rest: Float[np.ndarray, " n"], sizes: Float[np.ndarray, " k"], noise: Float[np.ndarray, " n"]
) -> float:
    """Standard deviations past which spikes stand apart from the noise's own tail."""
    rest = rest / np.maximum(noise, _local(rest, rest.size))
    threshold = SPIKE
    while sizes.size and threshold <= np.max(sizes):
        low = threshold / 1.5
        near = sum(int(np.sum((each > low) & (each <= threshold))) for each in (rest, sizes))
        normal = rest.size * math.erfc(low / math.sqrt(2))
        if near <= BY_CHANCE + 1.2 * normal + TAIL * np.sum(sizes > threshold):
            return threshold
        threshold *= 1.5
    return np.inf


def _among_others(
    rest: Float[np.ndarray, " k"], off: Float[np.ndarray, " n"], found: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Spikes that are no more often than steps, or whatever else is left, of about that size."""

    def alike(some: np.ndarray) -> np.ndarray:
        ordered = np.sort(some)
        return np.searchsorted(ordered, 3 * off) - np.searchsorted(ordered, off / 3)

    return found & (alike(rest) >= alike(off[found]))

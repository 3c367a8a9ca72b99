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

from riecjax.records.noise import DIFFERENCE_ORDER
from riecjax.records.resolution import (
    FEW_LEVELS,
    LAST_DIGITS,
    ROUNDING,
    is_piecewise_linear,
    levels_of,
    resolution_of,
)

SUSPECT = 4.5
"""Standard deviations past which a sixth difference makes suspects of the samples around it."""
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
LONGEST = 3
"""Neighbouring samples past which it is no spike."""
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
CLEAR = 5.0
"""Times that a spike is further off the polynomial than all samples around it are (rms)."""
NEIGHBOUR = 4.0
"""The same of the nearest sample on each side, which at a step is off one that spans it."""
FEW, TAIL_BLOCK, USUAL_TAIL = 0.03, 1024, 3.0
"""A spike adds two thirds of its size to a difference; that is to be twice what three in a hundred
of them reach nearby once spikes are taken out. In white noise this asks for 6.5 of its standard
deviations, and among corners, kicks or steps for more than is usual there."""
TUKEY = 4.685
"""Scales past which a sample has no weight."""
AT_ONCE = 2**16
"""Polynomials that are fitted side by side, for what memory they take."""
ROUNDS, FIRST, PASSES = 8, 3, 12
"""Times that weights are found anew, the first of them for the least sum of absolute values; and
that suspects are, once spikes do not hide others."""
LARGEST = 1e60
"""Robust scales at which values are cut off, so that their squares are numbers."""
RIDGE = 1e-9
"""What keeps a fit through fewer samples than coefficients from a division by zero."""
GAIN = float(np.sqrt(np.sum(np.poly([1.0] * DIFFERENCE_ORDER) ** 2)))
NORMAL = 0.6745
"""Median size of a standard normal variable."""


class _Local(NamedTuple):
    """Polynomials of one degree over the samples of a window.

    **Fields:** `offsets` of its samples; orthonormal `columns`, shape `(samples, degree + 1)`;
    `products` of each two, a row for each sample.
    """

    offsets: Int[np.ndarray, " samples"]
    columns: Float[np.ndarray, "samples coefficients"]
    products: Float[np.ndarray, "samples pairs"]

    @classmethod
    def of(cls, degree: int, beside: int) -> "_Local":
        offsets = np.arange(-beside, beside + 1)
        columns = np.linalg.qr((offsets[:, None] / beside) ** np.arange(degree + 1))[0]
        products = columns[:, :, None] * columns[:, None, :]
        return cls(offsets, columns, products.reshape(offsets.size, -1))

    @property
    def beside(self) -> int:
        """Samples to each side."""
        return self.offsets.size // 2

    def off(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """How far each sample is off the one through all, over its gain for white noise.

        0 where its window has gaps or ends.
        """
        taps = self.columns @ self.columns[self.beside]
        taps[self.beside] -= 1
        off = np.abs(np.convolve(values, taps[::-1], "valid")) / np.linalg.norm(taps)
        return np.pad(np.nan_to_num(off), self.beside)

    @property
    def gain(self) -> float:
        """Times `off` that a sample is off the one through the others."""
        return float(1 / np.sqrt(1 - np.sum(self.columns[self.beside] ** 2)))

    def error(self, values: Float[np.ndarray, " n"]) -> float:
        """How far samples mostly are off the one through the others."""
        return float(self.gain * np.median(self.off(values)))


_LOCAL = [_Local.of(degree, beside) for degree, beside in SHAPES]


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
    repaired = _fits(np.where(found, np.nan, scaled), places, noise, stretch, local)[0]
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
    scaled: Float[np.ndarray, " n"], quantum: float, local: _Local
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Which samples are spikes, and the noise around each."""
    cleaned, sizes = scaled.copy(), np.zeros(scaled.size)
    noise, stretch = sizes, np.cumsum(np.isnan(scaled))
    for _ in range(PASSES):
        sixth = np.abs(np.diff(cleaned, DIFFERENCE_ORDER)) / GAIN
        noise = _local_noise(sixth, scaled.size, quantum)
        half = DIFFERENCE_ORDER // 2
        large = np.zeros(scaled.size, bool)
        large[half:-half] = sixth > SUSPECT * noise[half:-half]
        # The first and last three samples stand in the middle of no difference.
        near = np.convolve(large, np.ones(DIFFERENCE_ORDER + 1), "same") > 0
        suspects = np.flatnonzero(near & ~np.isnan(cleaned) & (sizes == 0))
        if not 0 < suspects.size <= MOST_SUSPECTS * scaled.size:
            break
        held = np.where(sizes > 0, np.nan, scaled)
        fit, scale, _ = _fits(held, suspects, noise, stretch, local)
        off = np.abs(scaled[suspects] - fit)
        # A spike spoils the polynomials of its neighbours: the largest first.
        largest = np.zeros(scaled.size)
        largest[suspects] = np.where(off > SPIKE * scale, off, 0.0)
        new = (off > SPIKE * scale) & (off >= _running_maximum(largest, local.beside)[suspects])
        if not new.any():
            break
        sizes[suspects[new]], cleaned[suspects[new]] = (off / scale)[new], fit[new]
    found = (sizes > 0) & ~_in_runs_beyond(sizes > 0, LONGEST)
    off = sizes
    for _ in range(2):  # what is dropped tells more of those beside it
        places, cleaned = np.flatnonzero(found), np.where(found, np.nan, scaled)
        fit, scale, clear = _fits(cleaned, places, noise, stretch, local)
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
    return _spread_out(_medians(rows) / NORMAL, rows.shape[1], count)


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


def _medians(rows: Float[np.ndarray, "rows n"]) -> Float[np.ndarray, " rows"]:
    """Of each row what is no NaN; NaN where nothing is."""
    ordered = np.sort(rows, axis=1)
    count = np.sum(~np.isnan(rows), axis=1)
    at = np.arange(len(rows))
    return (
        ordered[at, np.maximum(count - 1, 0) // 2] + ordered[at, count // 2 % rows.shape[1]]
    ) / 2


def _fits(
    values: Float[np.ndarray, " n"],
    places: Int[np.ndarray, " k"],
    noise: Float[np.ndarray, " n"],
    stretch: Int[np.ndarray, " n"],
    local: _Local,
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """At each place the polynomial through the other samples of its unbroken stretch.

    **Returns:** its value, the standard deviation off it, and by how much a spike stands clear of
    all others.
    """
    parts = np.split(places, np.arange(AT_ONCE, places.size, AT_ONCE))
    value, scale, clear = zip(
        *(_fits_at_once(values, part, noise, stretch, local) for part in parts)
    )
    return np.concatenate(value), np.concatenate(scale), np.concatenate(clear)


def _fits_at_once(
    values: np.ndarray, places: np.ndarray, noise: np.ndarray, stretch: np.ndarray, local: _Local
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    near = places[:, None] + local.offsets
    inside = np.clip(near, 0, values.size - 1)
    there = (near == inside) & (stretch[inside] == stretch[places][:, None])
    there &= (local.offsets != 0) & ~np.isnan(values[inside])
    window = np.where(there, values[inside], np.nan)
    least = noise[places] + LAST_DIGITS * (1 + np.abs(_medians(window)))
    window = np.where(there, window, 0.0)
    off = np.where(there, np.abs(window - _running_median(values, inside)), np.nan)
    start = there * (off <= SUSPECT * np.fmax(least, _medians(off) / NORMAL)[:, None])
    weight, gram, found, scale = start, *(np.zeros(0) for _ in range(3))
    count, middle = local.columns.shape[1], local.columns[local.beside]
    for i in range(ROUNDS):
        gram = (weight @ local.products).reshape(-1, count, count) + RIDGE * np.eye(count)
        found = np.linalg.solve(gram, ((weight * window) @ local.columns)[:, :, None])[:, :, 0]
        off = np.where(there, np.abs(window - found @ local.columns.T), np.nan)
        scale = np.fmax(least, _medians(off) / NORMAL)
        share = np.nan_to_num(off) / scale[:, None]
        # Absolute values first, whose least sum is one, so that weights do not settle elsewhere.
        weight = (
            start / np.maximum(share, 1.0)
            if i < FIRST
            else there * np.maximum(1 - (share / TUKEY) ** 2, 0.0) ** 2
        )
    enough = np.sum(weight > 0, axis=1) > count
    reach = np.linalg.solve(gram, np.broadcast_to(middle[:, None], (len(gram), count, 1)))
    reach = reach[:, :, 0] @ middle
    clear = CLEAR * np.sqrt(np.nansum(off**2, axis=1) / np.sum(there, axis=1))
    before, after = off[:, : local.beside], off[:, local.beside + 1 :]
    for side in (before[:, : -LONGEST - 1 : -1], after[:, :LONGEST]):
        nearest = side[np.arange(len(side)), np.argmax(~np.isnan(side), axis=1)]
        clear = np.fmax(clear, NEIGHBOUR * nearest)
    return found @ middle, np.where(enough, scale, np.inf) * np.sqrt(1 + reach), clear


def _running_median(
    values: Float[np.ndarray, " n"], near: Int[np.ndarray, "k n"]
) -> Float[np.ndarray, "k n"]:
    """Of the seven samples around each of these, which no spike of up to three samples moves."""
    used, where = np.unique(near, return_inverse=True)
    padded = np.pad(values, LONGEST, constant_values=np.nan)
    rows = np.lib.stride_tricks.sliding_window_view(padded, 2 * LONGEST + 1)[used]
    return _medians(rows)[where].reshape(near.shape)


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

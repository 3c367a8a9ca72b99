"""What samples say of one among them: robust polynomials through all but itself.

They are weighed by Tukey's biweight, which no neighbouring spike moves.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from riecjax.records.resolution import LAST_DIGITS

SUSPECT = 4.5
"""Standard deviations past which a sixth difference makes suspects of the samples around it."""
LONGEST = 3
"""Neighbouring samples past which it is no spike."""
CLEAR = 5.0
"""Times that a spike is further off the polynomial than all samples around it are (rms)."""
NEIGHBOUR = 4.0
"""The same of the nearest sample on each side, which at a step is off one that spans it."""
TUKEY = 4.685
"""Scales past which a sample has no weight."""
AT_ONCE = 256
"""Polynomials that are fitted side by side: more leave the processor's cache, and their products
are large enough that NumPy starts threads, which costs more than it gains."""
ROUNDS, FIRST = 8, 3
"""Times that weights are found anew, the first of them for the least sum of absolute values."""
RIDGE = 1e-9
"""What keeps a fit through fewer samples than coefficients from a division by zero."""
NORMAL = 0.6745
"""Median size of a standard normal variable."""


class Local(NamedTuple):
    """Polynomials of one degree over the samples of a window.

    **Fields:** `offsets` of its samples; orthonormal `columns`, shape `(samples, degree + 1)`;
    `products` of each two, a row for each sample.
    """

    offsets: Int[np.ndarray, " samples"]
    columns: Float[np.ndarray, "samples coefficients"]
    products: Float[np.ndarray, "samples pairs"]

    @classmethod
    def of(cls, degree: int, beside: int) -> "Local":
        """Of a degree, over so many samples to each side."""
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


class Fits(NamedTuple):
    """At each place the polynomial through the other samples of its unbroken stretch.

    **Fields:** its `value`; `scale`, the standard deviation off it; `clear`, by how much a spike
    stands clear of all others; `spread`, what noise must be below so as not to matter to it.
    """

    value: Float[np.ndarray, " k"]
    scale: Float[np.ndarray, " k"]
    clear: Float[np.ndarray, " k"]
    spread: Float[np.ndarray, " k"]


class Around:
    """Fits at all places of a signal, made anew where something changed that they depend on."""

    def __init__(self, stretch: Int[np.ndarray, " n"], local: Local) -> None:
        self.stretch, self.local = stretch, local
        self.kept = np.full((4, stretch.size), np.nan)
        self.noise = np.zeros(stretch.size)

    def at(
        self,
        values: Float[np.ndarray, " n"],
        places: Int[np.ndarray, " k"],
        noise: Float[np.ndarray, " n"],
    ) -> Fits:
        """Of some places, given the noise around each."""
        before, now = self.noise[places], noise[places]
        matters = (now != before) & (np.maximum(now, before) > self.kept[3, places])
        again = places[matters | np.isnan(self.kept[0, places])]
        if again.size:
            self.kept[:, again] = fits(values, again, noise, self.stretch, self.local)
        self.noise[again] = noise[again]
        return Fits(*self.kept[:, places])

    def forget(self, places: Int[np.ndarray, " k"]) -> None:
        """Samples there have other values from now on."""
        reach = self.local.beside + LONGEST
        near = places[:, None] + np.arange(-reach, reach + 1)
        self.kept[0, np.clip(near, 0, self.stretch.size - 1)] = np.nan


def fits(
    values: Float[np.ndarray, " n"],
    places: Int[np.ndarray, " k"],
    noise: Float[np.ndarray, " n"],
    stretch: Int[np.ndarray, " n"],
    local: Local,
) -> Fits:
    """The polynomials at some places, of which `stretch` numbers the unbroken stretch."""
    median = _running_median(values, places, local.beside)
    parts = np.split(places, np.arange(AT_ONCE, places.size, AT_ONCE))
    found = zip(*(_at_once(values, median, part, noise, stretch, local) for part in parts))
    return Fits(*(np.concatenate(each) for each in found))


def medians(rows: Float[np.ndarray, "rows n"]) -> Float[np.ndarray, " rows"]:
    """Of each row what is no NaN; NaN where nothing is."""
    ordered = np.sort(rows, axis=1)
    count = np.sum(~np.isnan(rows), axis=1)
    at = np.arange(len(rows))
    return (
        ordered[at, np.maximum(count - 1, 0) // 2] + ordered[at, count // 2 % rows.shape[1]]
    ) / 2


def _at_once(
    values: np.ndarray,
    median: np.ndarray,
    places: np.ndarray,
    noise: np.ndarray,
    stretch: np.ndarray,
    local: Local,
) -> Fits:
    near = places[:, None] + local.offsets
    inside = np.clip(near, 0, values.size - 1)
    there = (near == inside) & (stretch[inside] == stretch[places][:, None])
    there &= (local.offsets != 0) & ~np.isnan(values[inside])
    window = np.where(there, values[inside], np.nan)
    digits = LAST_DIGITS * (1 + np.abs(medians(window)))
    least = noise[places] + digits
    window = np.where(there, window, 0.0)
    off = np.where(there, np.abs(window - median[inside]), np.nan)
    spread = medians(off) / NORMAL
    start = there * (off <= SUSPECT * np.fmax(least, spread)[:, None])
    weight, factor, found, scale = start, *(np.zeros(0) for _ in range(3))
    count, middle = local.columns.shape[1], local.columns[local.beside]
    for i in range(ROUNDS):
        factor = _factored((local.products.T @ weight.T).reshape(count, count, -1))
        found = _solved(factor, local.columns.T @ (weight * window).T)
        off = np.where(there, np.abs(window - (local.columns @ found).T), np.nan)
        own = medians(off) / NORMAL
        scale, spread = np.fmax(least, own), np.fmin(spread, own)
        share = np.nan_to_num(off) / scale[:, None]
        # Absolute values first, whose least sum is one, so that weights do not settle elsewhere.
        weight = (
            start / np.maximum(share, 1.0)
            if i < FIRST
            else there * np.maximum(1 - (share / TUKEY) ** 2, 0.0) ** 2
        )
    enough = np.sum(weight > 0, axis=1) > count
    reach = middle @ _solved(factor, np.repeat(middle[:, None], len(places), axis=1))
    clear = CLEAR * np.sqrt(np.nansum(off**2, axis=1) / np.sum(there, axis=1))
    before, after = off[:, : local.beside], off[:, local.beside + 1 :]
    for side in (before[:, : -LONGEST - 1 : -1], after[:, :LONGEST]):
        nearest = side[np.arange(len(side)), np.argmax(~np.isnan(side), axis=1)]
        clear = np.fmax(clear, NEIGHBOUR * nearest)
    scale = np.where(enough, scale, np.inf) * np.sqrt(1 + reach)
    return Fits(middle @ found, scale, clear, np.nan_to_num(spread - digits))


def _factored(grams: Float[np.ndarray, "c c k"]) -> Float[np.ndarray, "c c k"]:
    """Below the diagonal L, and on it D, of L D L' for each symmetric matrix, which it replaces.

    All side by side take a third of the time of LAPACK, which takes one after the other.
    """
    count = len(grams)
    grams[range(count), range(count)] += RIDGE
    for i in range(count - 1):
        below = grams[i + 1 :, i]
        scaled = below / grams[i, i]
        grams[i + 1 :, i + 1 :] -= scaled[:, None] * below
        grams[i + 1 :, i] = scaled
    return grams


def _solved(factor: Float[np.ndarray, "c c k"], right: Float[np.ndarray, "c k"]) -> np.ndarray:
    """The solutions of factored systems; the right sides are replaced."""
    count = len(right)
    for i in range(count - 1):
        right[i + 1 :] -= factor[i + 1 :, i] * right[i]
    right /= factor[range(count), range(count)]
    for i in range(count - 1, 0, -1):
        right[:i] -= factor[i, :i] * right[i]
    return right


def _running_median(
    values: Float[np.ndarray, " n"], places: Int[np.ndarray, " k"], beside: int
) -> Float[np.ndarray, " n"]:
    """Of the seven samples around each that is near these places, which no spike of up to three
    samples moves; NaN elsewhere."""
    near = np.zeros(values.size + 1, int)
    np.add.at(near, np.maximum(places - beside, 0), 1)
    np.add.at(near, np.minimum(places + beside + 1, values.size), -1)
    used = np.flatnonzero(np.cumsum(near[:-1]))
    padded = np.pad(values, LONGEST, constant_values=np.nan)
    rows = np.lib.stride_tricks.sliding_window_view(padded, 2 * LONGEST + 1)[used]
    found = np.full(values.size, np.nan)
    found[used] = medians(rows)
    return found

"""What the samples of a record tell of its signals' noise.

White noise shows in differences of sixth order, in which a smooth motion is next to nothing. Where
values can be looked at, that is, not under `jax.jit`, a flat floor of the power spectrum tells the
same from three times as many data, and without the motion's quicker part. Values also tell what no
sensor measured: a command, which moves in steps or along straight lines, has no noise, and a
converter rounds by q / sqrt(12) at the least, for its quantum q.

White noise is a floor up to half the rate. Noise that a logger's filter let through is a shelf,
between the motion and the filter's edge; a band-limited excitation makes a shelf of motion as well,
which other signals then have in common, while noise of sensors is coherent with nothing.
"""

import contextlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Literal, NamedTuple, TypeAlias

import jax
import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import ArrayLike

from riecjax import arrays as xp
from riecjax.errors import DataError, ModelError
from riecjax.leaves import Leaf
from riecjax.records.faults.sampled_signal import levels_of, resolution_of, rounding_of
from riecjax.records.kinematic_noise import Variance, variances
from riecjax.records.record import Record, deviation, runs
from riecjax.records.relations import Pairs, relations
from riecjax.records.signal import (
    DIFFERENCE_ORDER,
    NEGLIGIBLE,
    REPEATS,
    STRETCH,
    STRETCHES,
    Noise,
    Signal,
    SignalNoise,
    noise_level,
    shortened,
    stretches_of,
)

ABOVE_NOISE = 3.0
"""Times what the sensors' noise makes of it, from which what is left is the model's."""
SEGMENT = 256
"""Samples of a piece whose spectrum is taken."""
FEWEST_SEGMENTS = 8
"""Overlapping ones, by three quarters."""
CLOSE = 9
"""Frequencies over which a spectrum is averaged to see where it leaves its floor."""
LEAVES = 1.5
"""Times the floor past which such a mean is of motion."""
CLEARANCE = 1.5
"""Times the last frequency at which motion is seen, past which what is left of it is far below the
floor: it falls with the fourth power of frequency or faster."""
LOWEST = 8
"""Frequencies at the bottom that are left out: a constant's main lobe, and what rounding leaves."""
NARROWEST = 0.12
"""Share of the band that a floor must take up."""
FLAT = 1.3
"""Times that one half of a floor may lie above the other."""
TOP = 0.1
"""Share of the band, up to its end, from which the floor is looked for downwards."""
TAPERED = 1.5
"""Segments that the windows of a piece lose at its two ends together."""
EMPTY = 0.1
"""Share of a shelf's density that is left at half the rate."""
OCTAVE = 2.0
"""Times its lowest frequency that the highest of a shelf is, at the least."""
LEVELLED = 2.0
"""Times the least mean of neighbours that the largest one of a shelf is, at the most."""
ESTIMATED = 1e-4
"""Share of the energy of an estimated kernel that may be cut off with its ends."""
SCATTER = 3.0
"""Standard deviations by which two levels may differ by chance."""
INCOHERENT = 0.3
"""Coherence with another signal past which a shelf is of motion. That of noise is one over the
number of independent segments, 0.06 of 2000 samples."""


class Spectra(NamedTuple):
    """Spectra of a signal's segments.

    **Fields:** `transforms`, of which the mean square is the power `density`, that of white noise
    being its variance, up to half the rate; `freedom` of all of the band together.
    """

    transforms: Complex[np.ndarray, "segments frequencies"]
    density: Float[np.ndarray, " frequencies"]
    freedom: float


class Floor(NamedTuple):
    """Noise where a spectrum is flat.

    **Fields:** `taps` of its kernel, one of white noise; `freedom`, degrees of freedom of its
    variance; `flat`, or else white noise can be no larger than this.
    """

    taps: Float[np.ndarray, " taps"]
    freedom: Float[np.ndarray, ""]
    flat: bool = True

    @property
    def level(self) -> float:
        """Standard deviation."""
        return float(np.sqrt(np.sum(self.taps**2)))


def spectra(values: Float[np.ndarray, "stretches samples"]) -> Spectra | None:
    """Spectra of overlapping segments between NaN; `None` of too few samples.

    Of second differences, divided by their gain: a motion 1000 times the noise then stays below
    the side lobes of a Blackman-Harris window.
    """
    window, hop = blackman_harris(SEGMENT + 1)[:-1], SEGMENT // 4
    ended = np.pad(values, [(0, 0), (0, 1)], constant_values=np.nan).ravel()
    ends = [(a, b) for a, b in runs(~np.isnan(ended)).T.tolist() if b - a >= SEGMENT + 2]
    rows = [
        np.lib.stride_tricks.sliding_window_view(np.diff(ended[first:stop], 2), SEGMENT)[::hop]
        for first, stop in ends
    ]
    if sum(len(row) for row in rows) < FEWEST_SEGMENTS:
        return None
    gain = (2 * np.sin(np.pi * np.arange(SEGMENT // 2 + 1) / SEGMENT)) ** 2
    differences = np.fft.rfft(np.concatenate(rows) * window, axis=1)[:, 1:]
    independent = sum(stop - first - TAPERED * SEGMENT for first, stop in ends)
    transforms = differences / gain[1:] / np.sqrt(np.sum(window**2))
    return Spectra(transforms, np.mean(np.abs(transforms) ** 2, axis=0), independent)


def blackman_harris(size: int) -> Float[np.ndarray, " samples"]:
    """Four-term window whose side lobes are 92 dB down, symmetric (Harris 1978, Proc. IEEE 66).

    SciPy has it as well, in a module that takes a third of a second to import.
    """
    angle = 2 * np.pi * np.arange(size) / (size - 1)
    terms = enumerate((0.35875, -0.48829, 0.14128, -0.01168))
    return sum((weight * np.cos(k * angle) for k, weight in terms), np.zeros(size))


def _near(density: np.ndarray) -> np.ndarray:
    return np.convolve(density, np.ones(CLOSE) / CLOSE, "valid")


def floor(of: Spectra) -> Floor:
    """The floor up to half the rate of a signal, else the lowest tenth of its band if any."""
    # At half the rate itself there is one degree of freedom, not two.
    near, size, density = _near(of.density), of.density.size, of.density[:-1]
    edge = top = int((1 - TOP) * size)
    for _ in range(3):
        beyond = np.flatnonzero(near > LEAVES * np.mean(density[edge:]))
        edge = int(CLEARANCE * (beyond[-1] + CLOSE)) if beyond.size else LOWEST
        edge = min(edge, top)
    share = (size - edge) / size
    if share > NARROWEST and _level(density[edge:]):
        return Floor(
            np.sqrt(np.mean(density[edge:], keepdims=True)), np.asarray(share * of.freedom)
        )
    # What still falls at the end, as a position does that a random force moves, has none.
    sooner, later = (np.mean(half) for half in np.array_split(density[top:], 2))
    # The logarithm of a mean square of n degrees of freedom scatters by sqrt(2 / n).
    by_chance = np.exp(SCATTER * np.sqrt(4 / max(TOP / 2 * of.freedom, 1.0)))
    if sooner > max(LEVELLED, by_chance) * later:
        return Floor(np.zeros(1), np.asarray(np.inf))
    return Floor(np.full(1, np.sqrt(lowest(density))), np.asarray(TOP * of.freedom), flat=False)


def lowest(density: Float[np.ndarray, " frequencies"]) -> float:
    """The mean over that tenth of a band in which it is least."""
    return float(min(np.mean(tenth) for tenth in np.array_split(density, round(1 / TOP))))


def unexplained(of: Spectra, others: Sequence[Spectra]) -> Float[np.ndarray, " frequencies"]:
    """The density of what no linear filter makes of other signals.

    White noise is no larger, as noise of sensors has nothing in common. Its share is one over the
    signal's place in the inverse of the coherency. Of n independent segments each of p others
    explains one by chance. The window is two frequencies wide, so that of each two there are as
    many as degrees of freedom.
    """
    # Of few segments many signals would explain all.
    independent = of.freedom / of.density.size
    every = (of, *others[: int(independent / 2)])
    segments = np.stack([one.transforms.T for one in every], axis=1)
    size = np.sqrt(np.mean(np.abs(segments) ** 2, axis=2, keepdims=True))
    segments = np.divide(segments, size, out=np.zeros_like(segments), where=size > 0)
    coherency = np.nan_to_num(segments @ segments.conj().transpose(0, 2, 1) / segments.shape[2])
    inverse = np.linalg.inv(coherency + NEGLIGIBLE**2 * np.eye(len(every)))
    by_chance = independent / (independent - len(every) + 1)
    return by_chance * of.density / np.real(inverse[:, 0, 0])


def shelf(of: Spectra, others: Iterable[Spectra | None]) -> Floor | None:
    """The noise of a signal that was low-passed, if it shows between motion and filter.

    Its density is taken to be flat below, where motion hides it. Only where it is clear: other
    signals must be there, the same pieces of them, and none may be coherent with the shelf.
    """
    near, size = _near(of.density), of.density.size
    at_end = np.mean(of.density[int((1 - TOP) * size) : -1])
    # The widest stretch in which means of neighbours are about the same: from each lower end on, in
    # a row of its own; behind the band there is nothing to be alike.
    behind = np.pad(near, (0, near.size), constant_values=np.nan)
    rows = np.lib.stride_tricks.sliding_window_view(behind, near.size)[: near.size // 2]
    alike = np.maximum.accumulate(rows, 1) < LEVELLED * np.minimum.accumulate(rows, 1)
    lengths = np.argmin(np.pad(alike, [(0, 0), (0, 1)]), axis=1)
    lower = int(np.argmax(lengths))
    band = slice(lower + CLOSE - 1, lower + int(np.max(lengths)))
    if band.stop < max(OCTAVE * band.start, band.start + NARROWEST * size):
        return None
    density = float(np.mean(of.density[band]))
    if at_end > EMPTY * density:
        return None
    coherence = []
    for other in (spectra for spectra in others if spectra is not None):
        here, there = of.transforms[:, band], other.transforms[:, band]
        cross = np.abs(np.mean(here * there.conj(), axis=0)) ** 2
        power = np.mean(np.abs(here) ** 2, axis=0) * np.mean(np.abs(there) ** 2, axis=0)
        shares = np.divide(cross, power, out=np.zeros_like(cross), where=power > 0)
        coherence.append(np.mean(shares))
    if not coherence or max(coherence) > INCOHERENT:
        return None
    beyond = np.convolve(of.density, np.ones(CLOSE) / CLOSE, "same")[band.stop :]
    shape = np.concatenate([np.full(band.stop + 1, density), np.minimum(beyond, density)])
    taps = np.fft.fftshift(np.fft.irfft(np.sqrt(shape), SEGMENT))[1:]
    share = (band.stop - band.start) / size
    return Floor(shortened(taps, ESTIMATED), np.asarray(share * of.freedom))


def _level(density: np.ndarray) -> bool:
    less, more = sorted(np.mean(half) for half in np.array_split(density, 2))
    return bool(more < FLAT * less)


GivenNoise: TypeAlias = Literal["auto", "none"] | Noise | Mapping[str, ArrayLike | jax.Array] | None
"""How large the noise is: to be judged from the samples, none at all, or given for some signals,
as a standard deviation in the signal's unit or as a [`Noise`][riecjax.Noise]; the others are
judged."""
MOST_NOISE = 0.5
"""Share of a signal's standard deviation past which what looks like noise is taken for motion that
is sampled too slowly, or for an input that is noise itself."""
HELD = 0.5
"""Share of samples that are held, or on straight lines, past which a signal is a command."""


def judged(record: Record, given: GivenNoise = "auto", *names: str) -> Record:
    """A record of whose signals' noise something is known, of each of them.

    What is known already stays. Under `jax.jit` all noise is taken for white.

    **Arguments:**

    - `given`: how large it is, see [`GivenNoise`][riecjax.records.GivenNoise]. It goes before what
      is known already.
    - `names`: the signals to judge; all of them if none is named.

    **Raises:** `DataError` for a signal that the record lacks, or an impossible noise.
    """
    known, estimates = record.with_noise(given_noise(given, record.arrays)), {}
    for name in names or record.arrays:
        if name in record.arrays and known.by_name[name].noise is None:
            signal = record.by_name[name]
            others = [values for other, values in record.arrays.items() if other != name]
            with np.errstate(all="ignore"):
                estimates[name] = noise_of_level(name, noise_level(signal.with_nan), signal, others)
    return known.with_noise(Noise.of(estimates))


def judged_surely(record: Record) -> Record:
    """The same where noise that is only limited is none: it may be motion between samples."""
    noise = judged(record).noise
    limited = {name: {} for name in record.arrays if noise.freedom.get(name, np.inf) <= 2}
    return record.with_noise(Noise({**noise.kernels, **limited}, noise.freedom))


@np.errstate(all="ignore")
def judged_together(
    record: Record, pairs: Pairs, read: Iterable[str], given: Collection[str] = ()
) -> Record:
    """A record whose sensors told each other's noise.

    Relations between sensors of one motion tell white noise from motion, however broad that is; a
    spectrum alone does not. Where there are none, noise is no larger than what other signals leave
    unexplained. Not under jit, where the record stays as it is.

    **Arguments:** `record`, whose signals are [`judged`][riecjax.records.judged] each by itself;
    `pairs` of a signal and its derivative, or relations; `read`, signals that a model reads, as
    others may be copies; `given`, signals whose noise stays.
    """
    noise = record.noise
    # What other signals are made of stays as it was when these were.
    made_of = {source for n, kernels in noise.kernels.items() for source in {*kernels} - {n}}
    white = {n for n in {*noise.kernels} - made_of if noise[n].is_white_of(n)} & {*record.arrays}
    if not (white and xp.is_concrete(record)) or record.arrays[min(white)].ndim > 1:
        return record
    own = {}
    for name in white:
        variance = float(noise.std(name)) ** 2
        freedom = np.inf if name in given else float(noise.freedom.get(name, np.inf))
        own[name] = Variance(variance, variance * np.sqrt(2 / freedom))
    own |= _limited(record, pairs, {name: own[name] for name in read if name in own})
    known, told = [name for name in given if name in own], {}
    # Numbers whose squares overflow are for others to refuse.
    with contextlib.suppress(np.linalg.LinAlgError):
        told = variances(record.select(*sorted(white)), pairs, own, known)
    better = {}
    for name, (variance, error) in (own | told).items():
        if error > 0 and name not in known:
            freedom = np.asarray(2 * (variance / error) ** 2)
            better[name] = SignalNoise({name: np.sqrt([variance])}, {name: freedom})
    return record.with_noise(Noise.of(better))


def _limited(record: Record, pairs: Pairs, own: Mapping[str, Variance]) -> dict[str, Variance]:
    """Of noise that is unsure to within its own size, what others leave unexplained if it is less.

    **Arguments:** `own`, of the signals that are looked at.
    """
    unsure = [name for name, one in own.items() if one.error >= one.variance > 0]
    if not unsure:
        return {}
    count, limits = record.sample_count, {}
    present = record.present(own)
    there = np.full(count, True) if present is None else np.asarray(present)
    values = (np.where(there, record.arrays[name], np.nan)[stretches_of(count)] for name in own)
    found = {name: one for name, one in zip(own, map(spectra, values)) if one is not None}
    for name in (name for name in unsure if name in found):
        # A filter of a signal has its noise, as a derivative that was computed has.
        related = {name}.union(*(one.names for one in relations(pairs) if name in one.names))
        others = [one for other, one in found.items() if other not in related]
        most = lowest(unexplained(found[name], others)[:-1])
        if others and most < own[name].variance:
            limits[name] = Variance(most, most)
    return limits


def noise_entries(records: Sequence[Record], names: Iterable[str]) -> dict[str, dict[str, object]]:
    """Of each signal that there is, its noise's standard deviation (r.m.s. over records), its unit,
    and which share of its own standard deviation that is."""
    entries: dict[str, dict[str, object]] = {}
    for name in names:
        if having := [record.select(name) for record in records if name in record.by_name]:
            noise = np.sqrt(np.mean([np.mean(judged(r).noise.std(name) ** 2) for r in having]))
            size = deviation(having, name)
            share = noise / size if size > 0 else None
            entries[name] = {"std": noise, "unit": having[0].signal(name).unit, "share": share}
    return entries


def given_noise(given: GivenNoise, signals: Collection[str]) -> Noise:
    """What is said of the noise of these signals.

    **Raises:** `DataError` for another signal, or an impossible noise; `ModelError` for what says
    nothing of noise.
    """
    if given is None or isinstance(given, str):
        if given not in ("auto", "none", None):
            raise ModelError(
                f"noise must be 'auto', 'none' or a standard deviation by signal, as in "
                f"{{'x': 0.01}}; got {given!r}."
            )
        return Noise() if given == "auto" else Noise({name: {} for name in signals})
    noise = given if isinstance(given, Noise) else Noise.given(given)
    if unknown := [name for name in noise.kernels if name not in signals]:
        raise DataError(
            f"noise is given for '{unknown[0]}', and there is no such signal; there are: "
            f"{', '.join(signals)}. Of a signal that is computed from another one, give the noise "
            f"of the other."
        )
    return noise


def noise_of_level(
    name: str, level: Leaf, signal: Signal, others: Sequence[Leaf] = ()
) -> SignalNoise:
    """The noise on a signal, by its differences' level and by which values it takes.

    **Arguments:** `others`, the record's other signals.
    """
    samples = xp.asarray(signal.values)
    level = xp.asarray(xp.where(level > MOST_NOISE * xp.std(samples, axis=-1), 0.0, level))
    seen = min(samples.shape[-1], STRETCHES * STRETCH)
    freedom = np.asarray(max(seen - DIFFERENCE_ORDER, 1) / REPEATS)
    if xp.are_traced(level, samples) or samples.ndim > 1:
        return SignalNoise({name: level[..., None]}, {name: freedom})
    known = _by_values(signal, np.asarray(level), freedom, others)
    return (
        SignalNoise() if known is None else SignalNoise({name: known.taps}, {name: known.freedom})
    )


def _by_values(
    signal: Signal, level: np.ndarray, freedom: np.ndarray, others: Sequence[Leaf]
) -> Floor | None:
    """The noise by what values a signal takes; `None` of a command."""
    samples = signal.with_nan
    rows = stretches_of(samples.size)
    values = samples[rows]
    there = ~np.isnan(values)
    known = values[there]
    if known.size <= DIFFERENCE_ORDER or not np.isfinite(known).all():
        return None
    rounding = rounding_of(known)
    bends = np.abs(np.diff(values, 2))
    bends = bends[~np.isnan(bends)]
    if not bends.size or np.mean(bends <= rounding) > HELD:
        return None
    found, own = Floor(level[None], freedom), spectra(values)
    if own is not None:
        elsewhere = (np.where(there, np.asarray(other)[rows], np.nan) for other in others)
        filtered = shelf(own, map(spectra, elsewhere))
        if filtered is not None and level < filtered.level < MOST_NOISE * np.std(known):
            return filtered
        flat = floor(own)
        # Spikes and steps raise a spectrum, and not the differences that are usual.
        # The least of ten densities scatters too, and is taken if it is lower for certain.
        scatter = SCATTER / np.sqrt(2 * (freedom if flat.flat else flat.freedom))
        room = 1 + scatter if flat.flat else 1 - scatter
        found = flat if flat.level < level * room else found
        if not flat.flat:
            # It is no larger, and by how much smaller nobody knows: sure to within its own size.
            found = found._replace(freedom=np.asarray(2.0))
    # A converter's rounding, where it is larger.
    quantised = resolution_of(levels_of(known, rounding)[0]) / np.sqrt(12)
    if quantised > found.level:
        return Floor(np.full(1, quantised), np.asarray(np.inf))
    return found if found.level > 0 else None

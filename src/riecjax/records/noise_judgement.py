"""What the samples of a record tell of its signals' noise.

White noise shows in differences of sixth order, in which a smooth motion is next to nothing. Where
values can be looked at, that is, not under `jax.jit`, a flat floor of the power spectrum tells the
same from three times as many data, and without the motion's quicker part. Values also tell what no
sensor measured: a command, which moves in steps or along straight lines, has no noise, and a
converter rounds by q / sqrt(12) at the least, for its quantum q.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal, TypeAlias

import jax
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from riecjax.errors import DataError, ModelError
from riecjax.leaves import Leaf, namespace
from riecjax.records.noise import (
    DIFFERENCE_ORDER,
    REPEATS,
    STRETCH,
    STRETCHES,
    Noise,
    noise_level,
)
from riecjax.records.noise_spectrum import Floor, beside_motion, floor, shelf, spectra
from riecjax.records.record import Record
from riecjax.records.resolution import levels_of, resolution_of, rounding_of

GivenNoise: TypeAlias = Literal["auto", "none"] | Noise | Mapping[str, ArrayLike | jax.Array] | None
"""How large the noise is: to be judged from the samples, none at all, or given for some signals,
as a standard deviation in the signal's unit or as a [`Noise`][riecjax.Noise]; the others are
judged."""
MOST_NOISE = 0.5
"""Share of a signal's standard deviation past which what looks like noise is taken for motion that
is sampled too slowly, or for an input that is noise itself."""
HELD = 0.5
"""Share of samples that are held, or on straight lines, past which a signal is a command."""
SCATTER = 3.0
"""Standard deviations by which two levels may differ by chance."""
MOVES = 0.5
"""Quanta from sample to sample (rms) past which a converter's rounding is white."""


def judged(record: Record, given: GivenNoise = "auto", *names: str) -> Record:
    """A record of whose signals' noise something is known, of each of them.

    What is known already stays. Under `jax.jit` all noise is taken for white.

    **Arguments:**

    - `given`: how large it is, see [`GivenNoise`][riecjax.records.GivenNoise]. It goes before what
      is known already.
    - `names`: the signals to judge; all of them if none is named.

    **Raises:** `DataError` for a signal that the record lacks, or an impossible noise.
    """
    known = record.noise.joined(given_noise(given, record.arrays))
    unknown = [n for n in names or record.arrays if n not in known.kernels and n in record.arrays]
    kernels, freedom = {}, {}
    for name in unknown:
        found = _noise_of(record, name)
        kernels |= found.kernels
        freedom |= found.freedom
    return record.with_noise(known.joined(Noise(kernels, freedom)))


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


def _noise_of(record: Record, name: str) -> Noise:
    samples: Any = record[name]
    missing = record.missing.get(name)
    xp = namespace(samples, missing)
    if xp is np:
        samples = np.asarray(samples)
    present = None if missing is None else ~xp.asarray(missing)
    with np.errstate(all="ignore"):
        level = noise_level(samples, present)
        rest = [v for k, v in record.arrays.items() if k != name]
        return noise_of_level(name, level, samples, present, rest)


def noise_of_level(
    name: str,
    level: Leaf,
    samples: Float[Leaf, "*batch n"],
    present: Bool[Leaf, "*batch n"] | None = None,
    others: Sequence[Leaf] = (),
) -> Noise:
    """The noise on a signal, by its differences' level and by which values it takes.

    **Arguments:** `others`, the record's other signals.
    """
    xp = namespace(level, samples, present)
    level = xp.where(level > MOST_NOISE * xp.std(samples, axis=-1), 0.0, level)
    seen = min(samples.shape[-1], STRETCHES * STRETCH)
    freedom = np.asarray(max(seen - DIFFERENCE_ORDER, 1) / REPEATS)
    if xp is np and samples.ndim == 1:
        there = None if present is None else np.asarray(present)
        known = _by_values(np.asarray(samples), there, np.asarray(level), freedom, others)
        if known is None:
            return Noise({name: {}})
        return Noise({name: {name: known.taps}}, {name: known.freedom})
    return Noise({name: {name: xp.asarray(level)[..., None]}}, {name: freedom})


def _by_values(
    samples: np.ndarray,
    present: np.ndarray | None,
    level: np.ndarray,
    freedom: np.ndarray,
    others: Sequence[Leaf],
) -> Floor | None:
    """The noise by what values a signal takes; `None` of a command."""
    rows = np.arange(samples.size)[None]
    if samples.size > STRETCHES * STRETCH:
        starts = np.linspace(0, samples.size - STRETCH, STRETCHES).astype(int)
        rows = starts[:, None] + np.arange(STRETCH)
    there = np.ones(rows.shape, bool) if present is None else present[rows]
    values = np.where(there, samples[rows], np.nan)
    known = values[there]
    if known.size <= DIFFERENCE_ORDER or not np.isfinite(known).all():
        return None
    rounding = rounding_of(known)
    bends = np.abs(np.diff(values, 2))
    bends = bends[~np.isnan(bends)]
    if not bends.size or np.mean(bends <= rounding) > HELD:
        return None
    found, own = Floor(level[None], freedom), spectra(_unbroken(values))
    if own is not None:
        elsewhere = (_unbroken(np.where(there, np.asarray(o)[rows], np.nan)) for o in others)
        filtered = shelf(own, (spectra(pieces) for pieces in elsewhere))
        if filtered is not None and level < filtered.level < MOST_NOISE / 2 * np.std(known):
            return filtered
        flat = beside_motion(own) or floor(own)
        # Spikes and steps raise a spectrum, and not the differences that are usual.
        # The least of ten densities scatters too, and is taken if it is lower for certain.
        scatter = SCATTER / np.sqrt(2 * (freedom if flat.flat else flat.freedom))
        room = 1 + scatter if flat.flat else 1 - scatter
        found = flat if flat.level < level * room else found
    rounded = _rounded(values, known, rounding, found.level)
    if rounded > found.level:
        return Floor(np.full(1, rounded), np.asarray(np.inf))
    return found if found.level > 0 else None


def _rounded(values: np.ndarray, known: np.ndarray, rounding: float, level: float) -> float:
    """A converter's rounding where it is white and larger than a level; 0 elsewhere."""
    moves = np.abs(np.diff(values))
    least = np.min(moves, where=moves > rounding, initial=np.inf)
    # The quantum is at most 1.5 times the smallest step: mostly there is no need to sort.
    if 1.5 * least / np.sqrt(12) <= level:
        return 0.0
    quantum = resolution_of(levels_of(known, rounding)[0])
    return quantum / np.sqrt(12) if np.sqrt(np.nanmean(moves**2)) > MOVES * quantum else 0.0


def _unbroken(rows: np.ndarray) -> list[np.ndarray]:
    """The stretches of each row between its NaN."""
    ended = np.pad(rows, [(0, 0), (0, 1)], constant_values=np.nan).ravel()
    places = np.flatnonzero(np.isnan(ended))
    return [piece for piece in (p[~np.isnan(p)] for p in np.split(ended, places)) if piece.size]

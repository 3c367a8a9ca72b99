"""Recordings that were given twice: whole, in part, rounded, or with other time stamps."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from riecjax.errors import DuplicateRecordingError
from riecjax.findings import Finding
from riecjax.records.recording import Recording

ROUNDED = 1e-3
"""Share of a signal's standard deviation by which rounding may part two samples."""
PIECE = 32
"""Samples of one recording that are looked for in another."""
PIECES = 3
ALIKE = 0.99
"""Share of samples that agree in what two recordings have in common."""
LEAST = 0.1
"""Share of the shorter recording that they must have in common."""
PLACES = 50
"""Places where a piece may fit, past which it says nothing."""


class Duplicate(NamedTuple):
    """What two recordings have in common: which they are, where it begins, how long it is."""

    first: int
    second: int
    starts: tuple[int, int]
    samples: int


def duplicates(recordings: Sequence[Recording]) -> list[Finding]:
    """Pairs of recordings that hold the same samples of all signals that both have.

    Not under jit.
    """
    columns = [{k: np.asarray(v) for k, v in one.record.arrays.items()} for one in recordings]
    return [
        _finding(recordings, found)
        for i, j in combinations(range(len(recordings)), 2)
        for found in _shared(i, j, columns[i], columns[j])
    ]


def refuse_duplicates(recordings: Sequence[Recording]) -> None:
    """Refuse recordings that were given twice.

    **Raises:** `DuplicateRecordingError` that names them.
    """
    for found in duplicates(recordings):
        said = f"{found.message} Leave it out, or allow it: --allow-duplicates."
        raise DuplicateRecordingError(said)


def _finding(recordings: Sequence[Recording], found: Duplicate) -> Finding:
    one, other = recordings[found.first], recordings[found.second]
    step = float(one.record.time_step)
    whole = found.samples >= min(one.record.sample_count, other.record.sample_count)
    shorter = other if other.record.sample_count <= one.record.sample_count else one
    what = (
        f"all of {shorter.name} lies in {(one if shorter is other else other).name}"
        if whole
        else f"{found.samples * step:.4g} s of {other.name}, from {found.starts[1] * step:.4g} s "
        f"on, are those of {one.name} from {found.starts[0] * step:.4g} s on"
    )
    return Finding(
        "duplicate_recording",
        f"{what}, sample by sample: a copy tells nothing new, and makes intervals up to 1.4 times "
        f"too narrow.",
    )


def _shared(
    first: int, second: int, one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]
) -> Iterator[Duplicate]:
    swapped = next(iter(one.values())).size < next(iter(other.values())).size
    long, short = (other, one) if swapped else (one, other)
    names = [name for name in short if name in long and np.ptp(short[name]) > 0]
    if not names:
        return
    near = {name: ROUNDED * _spread(short[name]) for name in names}
    # What changes most often is told apart soonest.
    sought = max(names, key=lambda name: np.mean(np.abs(np.diff(short[name])) > near[name]))
    for piece in _pieces(short[sought], near[sought]):
        for place in _places(long[sought], short[sought][piece : piece + PIECE], near[sought]):
            starts = (max(place - piece, 0), max(piece - place, 0))
            samples = min(
                long[sought].size - starts[0],
                short[sought].size - starts[1],
            )
            if samples < max(LEAST * short[sought].size, PIECE):
                continue
            a, b = slice(starts[0], starts[0] + samples), slice(starts[1], starts[1] + samples)
            if all(np.mean(np.abs(long[n][a] - short[n][b]) <= near[n]) >= ALIKE for n in names):
                yield Duplicate(first, second, starts[::-1] if swapped else starts, samples)
                return


def _spread(values: np.ndarray) -> float:
    size = float(np.max(np.abs(values)))
    return size * float(np.std(values / size))


def _pieces(values: np.ndarray, near: float) -> list[int]:
    """Where the signal moves most, in each of so many parts of it."""
    count = values.size - PIECE
    if count < 1:
        return []
    starts = np.unique(np.linspace(0, count, 8 * PIECES).astype(int))
    moves = np.array([np.sum(np.abs(np.diff(values[s : s + PIECE])) > near) for s in starts])
    parts = np.array_split(np.arange(starts.size), PIECES)
    best = [int(part[np.argmax(moves[part])]) for part in parts if part.size]
    return [int(starts[i]) for i in best if moves[i]]


def _places(values: np.ndarray, piece: np.ndarray, near: float) -> np.ndarray:
    """Where in a signal a piece of another fits."""
    found = np.arange(values.size - PIECE + 1)
    for i, sample in enumerate(piece):
        found = found[np.abs(values[found + i] - sample) <= near]
    return found if found.size <= PLACES else found[:0]

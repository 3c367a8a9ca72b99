"""Rows that stand twice, in a recording or in two, signals that are copies, and rows that are gone.

Noise sees to it that no two measurements are alike to the last digit. So of rows that a logger
wrote again, of a recording that was given twice and of a column that was copied one question tells:
which samples are others again? Each row has a key, a combination of its columns that differs where
any of them does, and rows with one key are held against each other; all keys are sorted together,
so that the time that takes grows with the number of samples alone.

Rows that all signals lost at once, their time renumbered, leave a jump that no velocity explains.
Between two samples x changes by the integral of v. What is left of x after that integral, w, moves
slowly whatever is off between x and v, in time, size or zero; where rows are gone it jumps by what
x moved in them. A straight line through the samples on either side of each instant, from its ends,

    jump = ahead(0) - behind(0),

is held against what such jumps are all along the record.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from riecjax.arrays import is_concrete
from riecjax.errors import DuplicateRecordingError
from riecjax.findings import Finding
from riecjax.records.faults.sampled_signal import (
    Found,
    SampledSignal,
    Signals,
    fault,
    size_of,
    spread_of,
)
from riecjax.records.linear_op import LinearOp
from riecjax.records.record import HasRecord, Record
from riecjax.records.signal import NORMAL, Samples

ROUNDED = 1e-3
"""Share of a standard deviation by which rounding may part a sample from its copy."""
SMOOTH = 0.9
"""Correlation of successive differences past which they are physical, and not of rounding."""
FEWEST = 20
"""Rows in succession that are the same again; noise repeats not one of them by chance."""
ALIKE = 0.99
"""Share of samples that agree in what two recordings have in common."""
LEAST = 0.1
"""Share of the shorter recording that they must have in common."""
SIDES = (8, 24)
"""Samples of each line; a jump shows in the longer one as in the shorter, and a spike does not."""
SURE = 9.0
"""Standard deviations of all jumps, estimated from their median, past which one is none of them."""
AGREE = 0.3
"""Share by which a jump may differ between the two lengths."""
HARMLESS = 0.003
"""Share of the signal's deviation up to which a jump does no harm."""
NONE = np.zeros(0)
"""The samples of a recording that lacks a signal."""


class Repetition(NamedTuple):
    """Rows that are others again: the first of both, and how many there are."""

    first: int
    again: int
    rows: int


def row_keys(columns: Sequence[Samples], block: int = 1) -> Float[np.ndarray, " blocks"]:
    """A number for each block of successive rows, which differs where one of their samples does.

    Of sums with random weights two that should differ are the same once in 1e16.
    """
    weights = np.random.default_rng(0).uniform(1, 2, len(columns) + block)
    rows = sum((w * column for column, w in zip(columns, weights)), np.zeros(len(columns[0])))
    count = max(rows.size - block + 1, 0)
    shifted = (weight * rows[k : k + count] for k, weight in enumerate(weights[len(columns) :]))
    return sum(shifted, np.zeros(count))


def repetitions(columns: Sequence[Samples]) -> list[Repetition]:
    """Stretches of rows that stand elsewhere before, to the bit.

    **Arguments:** `columns`, NaN where a sample is missing; such rows are no others'.
    """
    keys = row_keys([column / size_of(column) for column in columns])
    _, where, counts = np.unique(keys, return_inverse=True, return_counts=True)
    twice = ~np.isnan(keys) & (counts[where] == 2)
    # More of them are how the motion is, simulated without noise, or at rest.
    if not twice.any() or np.mean(counts[where] > 1) > 0.5:
        return []
    places = np.flatnonzero(twice)
    places = places[np.argsort(where[places], kind="stable")].reshape(-1, 2)
    lags = np.zeros(len(keys), int)
    lags[places[:, 1]] = places[:, 1] - places[:, 0]
    edges = np.flatnonzero(np.diff(lags, prepend=0, append=0))
    return [
        Repetition(int(start - lags[start]), int(start), int(stop - start))
        for start, stop in itertools.pairwise(edges)
        if lags[start] and stop - start >= FEWEST
    ]


def without_repetitions(record: Record) -> tuple[Record, list[Finding]]:
    """The record with rows that stand in it again as missing, and what is said of them."""
    columns = {name: signal.with_nan for name, signal in record.by_name.items()}
    repeated = repetitions([*columns.values()])
    if not repeated:
        return record, []
    time, step = np.asarray(record.elapsed), float(record.time_step)
    for values, stretch in itertools.product(columns.values(), repeated):
        values[stretch.again : stretch.again + stretch.rows] = np.nan
    first, *others = repeated
    more = f", and {len(others)} more such stretches" if others else ""
    said = Finding(
        "repeated_rows",
        f"all signals show from {time[first.again]:.6g} s on, for {first.rows * step:.4g} s, what "
        f"they showed from {time[first.first]:.6g} s on, to the last digit{more}: the logger wrote "
        f"those rows again. What stood there is lost; they count as missing. Check the logger.",
    )
    ops = {n: LinearOp.of_values("{}: repeated rows", v) for n, v in columns.items()}
    return record.through(ops), [said]


class NamedRecord(HasRecord, Protocol):
    """A record with a name, as a [`Recording`][riecjax.Recording]."""

    @property
    def name(self) -> str:
        """Of its file."""
        ...


def duplicates(recordings: Sequence[NamedRecord]) -> list[Finding]:
    """Recordings that hold samples of another one, in all signals that both have.

    Whole, in part, rounded, or with other time stamps. Of several copies each is named beside the
    one before it. Nothing is said under jit.
    """
    if not is_concrete([one.record.arrays for one in recordings]):
        return []
    columns = [{k: np.asarray(v) for k, v in one.record.arrays.items()} for one in recordings]
    found: dict[tuple[int, int], Finding] = {}
    for name in sorted({name for each in columns for name in each}):
        candidates = _candidates([each.get(name, NONE) for each in columns])
        for pair, shift in candidates.items():
            common = columns[pair[0]].keys() & columns[pair[1]].keys()
            both = [{n: columns[k][n] for n in common} for k in pair]
            starts = max(shift, 0), max(-shift, 0)
            if pair in found or not (rows := _rows_in_common(both, starts)):
                continue
            one, other = (recordings[k] for k in pair)
            step = one.record.time_step
            found[pair] = Finding(
                "duplicate_recording",
                f"{rows * step:.4g} s of {other.name}, from {starts[1] * step:.4g} s on, are those "
                f"of {one.name} from {starts[0] * step:.4g} s on, sample by sample: a copy tells "
                f"nothing new, and makes intervals up to 1.4 times too narrow.",
            )
    return [found[pair] for pair in sorted(found)]


def refuse_duplicates(recordings: Sequence[NamedRecord]) -> None:
    """Refuse recordings that were given twice.

    **Raises:** `DuplicateRecordingError` that names them.
    """
    for found in duplicates(recordings):
        raise DuplicateRecordingError(
            f"{found.message} Leave it out, or allow it: --allow-duplicates."
        )


def _candidates(columns: Sequence[Samples]) -> dict[tuple[int, int], int]:
    """Pairs of columns with blocks in common, and by how many rows later the first has them.

    Samples are rounded to 16 times what rounding may have parted them by, so that most blocks of
    16 rows are still the same. Of each pair the offset comes that most blocks have.
    """
    block = 16
    # Of values that are too small or too large to be held against each other.
    with np.errstate(all="ignore"):
        spreads = [spread for each in columns if each.size and (spread := spread_of(each)) > 0]
        quantum = block * ROUNDED * float(np.median(spreads)) if spreads else 1.0
        keys = [np.unique(row_keys([np.round(c / quantum)], block), True) for c in columns]
    key, place = (np.concatenate(parts) for parts in zip(*keys))
    owner = np.repeat(np.arange(len(keys)), [each.size for each, _ in keys])
    order = np.lexsort((owner, key))
    key, place, owner = key[order], place[order], owner[order]
    same = np.flatnonzero(np.isfinite(key[1:]) & (key[1:] == key[:-1]))
    offsets = np.stack([owner[same], owner[same + 1], place[same] - place[same + 1]])
    pairs, votes = np.unique(offsets, axis=1, return_counts=True)
    rising = pairs[:, np.argsort(-votes, kind="stable")[::-1]].T.tolist()
    return {(first, second): shift for first, second, shift in rising}


def _rows_in_common(both: Sequence[Mapping[str, np.ndarray]], starts: tuple[int, int]) -> int:
    """How many rows two recordings have in common from these rows on; 0 if they do not agree."""
    sizes = [next(iter(columns.values())).size for columns in both]
    rows = min(size - start for size, start in zip(sizes, starts))
    short = both[int(sizes[1] <= sizes[0])]
    near = {name: ROUNDED * spread_of(v) for name, v in short.items() if np.ptp(v) > 0}
    off = {n: np.subtract(*(c[n][a : a + rows] for c, a in zip(both, starts))) for n in near}
    alike = all(np.mean(np.abs(off[name]) <= near[name]) >= ALIKE for name in near)
    return rows if near and alike and rows >= max(LEAST * min(sizes), FEWEST) else 0


@fault(
    "copied_signal",
    "Check which column is which (on the command line: --map), and leave the copy out.",
)
def copied(other: SampledSignal, signals: Signals) -> Iterator[Found]:
    """Signals before this one of which it is one times a factor, perhaps with an offset.

    Two sensors have two noises. What parts them here is no more than rounding, which is white,
    where the little that parts a slow force from its spring is smooth.
    """
    for name in itertools.takewhile(lambda name: name != other.name, signals.names):
        if name not in signals.recorded:
            continue
        line = _line(signals.by_name[name].values, other.values)
        if line is None:
            continue
        factor, offset = line
        least = ROUNDED * np.nanstd(other.values)
        more = f" plus {offset:.4g}" if abs(offset) > least else ""
        said = f"{other.name} is {factor:.4g} times {name}{more}"
        if abs(factor - 1) < ROUNDED and abs(offset) < least:
            said = f"{other.name} holds the samples of {name}"
        yield Found(
            f"{said}, to the last digit or rounding, so that both are one measurement, and nothing "
            f"tells their terms apart.",
            doubt=1.0,
            signals=(name, other.name),
        )


def _line(first: np.ndarray, second: np.ndarray) -> tuple[float, float] | None:
    """Factor and offset that make the second of the first, `None` where none do."""
    both = ~(np.isnan(first) | np.isnan(second))
    if both.sum() < 3:
        return None
    size = [size_of(values[both]) for values in (first, second)]
    x, y = first[both] / size[0], second[both] / size[1]
    mean_x, mean_y = np.mean(x), np.mean(y)
    x, y = x - mean_x, y - mean_y
    energy = float(x @ x)
    if not energy or not y.any():
        return None
    slope = float(x @ y) / energy
    left = (y - slope * x) / np.std(y)
    worst = float(np.max(np.abs(left)))
    if worst > ROUNDED or left[1:] @ left[:-1] > SMOOTH * (left @ left):
        return None
    factor = slope * (size[1] / size[0])
    return factor, float(mean_y * size[1] - factor * mean_x * size[0])


@np.errstate(all="ignore")
def cut_rows(record: Record, signal: str, derivative: str) -> Finding | None:
    """Whether rows are missing between two samples that follow each other in time. Not under jit.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    x, v = record.signal(signal).with_nan, record.signal(derivative).with_nan
    step, size = float(record.time_step), float(np.nanstd(x))
    if x.size < 4 * SIDES[1] or not (np.isfinite(size) and size > 0):
        return None
    moved = np.nan_to_num(0.5 * step * (v[1:] + v[:-1]))
    integral = np.append(0.0, np.cumsum(moved))
    left = np.where(np.isnan(v), np.nan, (x - integral) / size)
    short, long = (_jumps(left, side) for side in SIDES)
    if np.isnan(short).all() or np.isnan(long).all():  # nowhere so many samples without a gap
        return None
    sure = np.abs(short) > max(SURE * np.nanmedian(np.abs(short)) / NORMAL, HARMLESS)
    sure &= np.abs(long - short) < AGREE * np.abs(short)
    # A spike of the derivative moves its integral alone.
    sure &= np.abs(_jumps(x / size, SIDES[0]) - short) < np.abs(short) / 2
    if not sure.any():
        return None
    place = int(np.argmax(np.where(sure, np.abs(short), 0.0)))
    jump, time = float(short[place]), np.asarray(record.elapsed)
    option, kept, off, gone = (
        ("--from", "from there on", 2, "before")
        if place < x.size / 2
        else ("--to", "up to there", -2, "behind")
    )
    return Finding(
        "lost_rows",
        f"{signal} jumps by {jump * size:.3g} at {time[place]:.7g} s, which the integral of "
        f"{derivative} does not follow, and goes on as before: rows of all signals are gone there, "
        f"and time was numbered anew. Use the record {kept}, or mark the gap in its time.",
        (signal, derivative),
        doubt=min(abs(jump), 1.0),
        remedy=(option, f"{time[place + off]:.7g}"),
        step=f"Leave out what is {gone} the jump",
    )


def _jumps(values: np.ndarray, side: int) -> np.ndarray:
    """At each sample, the line through those from it on less that through those before, midway."""
    # Weights whose sum with values on a straight line is that line's value at 0.
    weights = np.linalg.pinv(np.vander(np.arange(side) + 0.5, 2))[1]
    inner = np.convolve(values, np.concatenate([weights[::-1], -weights]), "valid")
    return np.pad(inner, (side, side - 1), constant_values=np.nan)

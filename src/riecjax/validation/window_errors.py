"""Eq. (18) on recorded data: whether errors of random windows are of one size and unrelated.

The paper argues by symmetry. Windows drawn at random have one expected mean square error
sigma^2, and any two of them one cross-correlation epsilon, small if windows are much shorter than
the record; ordinary least squares is then the right solve. The symmetry holds before anything
is known of the record. On a given one the errors of some stretches can outweigh all others, or all
errors can share a constant part, and neither averages out.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax import tails
from riecjax.criteria.windows import AbstractWindows
from riecjax.validation.equation_errors import EquationError, joined
from riecjax.validation.time_series import unbroken

LENGTHS = 4
"""Window lengths from alpha to beta at which errors are looked at, each at every start."""
BLOCK_LENGTH = 2
"""Longest windows to a block of time; no window reaches over its end, so blocks share no data."""
BLOCKS_TO_STRETCH = 5
"""Blocks to a stretch at least, whose scatter tells chance from change."""
MOST_STRETCHES = 8
FEWEST_STRETCHES = 3
SILENT = 1e-6
"""Mean square against the loudest block's below which a block is just silent."""


class WindowErrors(NamedTuple):
    """Errors of windows along the record.

    **Fields:**

    - `relative_rms`: root mean square of the windows' errors against the targets'.
    - `start`, `stop`: first and last time of each stretch in seconds from the first recording's
      first sample, records one after the other; shape `(stretches,)`.
    - `mean_square`: mean square error of the windows of each stretch against that of all.
    - `target_mean_square`: the same of the target.
    - `p_value`: probability that stretches alike differ as much: analysis of variance of the
      logarithms of the mean squares of blocks of time, which single loud blocks hardly reach; NaN
      where the record is too short for three stretches.
    - `correlation`: epsilon, the mean product of the errors of two windows drawn at random from
      one record, over the mean square.
    - `window_share`: mean T / t_max; white noise has an epsilon of about this.
    """

    relative_rms: float
    start: Float[np.ndarray, " stretches"]
    stop: Float[np.ndarray, " stretches"]
    mean_square: Float[np.ndarray, " stretches"]
    target_mean_square: Float[np.ndarray, " stretches"]
    p_value: float
    correlation: float
    window_share: float

    @property
    def ratio(self) -> float:
        """Mean square error of the loudest stretch over the quietest's; 1 if all are silent."""
        return _ratio(self.mean_square)

    @property
    def target_ratio(self) -> float:
        """The same of the target: how uneven the motion itself is."""
        return _ratio(self.target_mean_square)


class _Block(NamedTuple):
    """Sums over the windows that lie in one block of time."""

    start: int
    stop: int
    windows: int
    error: float
    error_square: float
    target_square: float


def window_errors(errors: list[EquationError], windows: AbstractWindows) -> WindowErrors | None:
    """Errors of boxcar windows over the records of one equation (not under jit).

    Windows are the impulse's rise over them, at every start and four lengths. `None` where no
    record is long enough for two blocks of time of twice the longest window.
    """
    step = float(errors[0].time_step)
    alpha, beta = float(windows.alpha), float(windows.beta)
    longest = max(round(beta / step), 1)
    lags = np.unique(np.round(np.geomspace(max(alpha / step, 1), longest, LENGTHS)).astype(int))
    records = [list(_blocks(error, lags, BLOCK_LENGTH * longest)) for error in errors]
    middle = np.asarray(joined(errors, 0).middle)
    before = np.cumsum([0, *(error.error.size for error in errors)])
    blocks = [block for of_record in records for block in of_record]
    if len(blocks) < 2:
        return None
    stretches = [
        (int(offset), part)
        for offset, of_record in zip(before, records)
        for part in _stretches(of_record, len(blocks))
    ]
    total = _total(blocks)
    half = 0.5 * errors[0].span * step
    sizes = [error.error.size for error in errors]
    return WindowErrors(
        relative_rms=float(np.sqrt(_share(total.error_square, total.target_square))),
        start=np.array([middle[offset + part[0].start] for offset, part in stretches]) - half,
        stop=np.array([middle[offset + part[-1].stop - 1] for offset, part in stretches]) + half,
        mean_square=_against_all([part for _, part in stretches], total, "error_square"),
        target_mean_square=_against_all([part for _, part in stretches], total, "target_square"),
        p_value=_p_value([part for _, part in stretches]),
        correlation=_correlation(records),
        window_share=float(np.mean(lags) * len(sizes) / np.sum(sizes)),
    )


def _blocks(error: EquationError, lags: np.ndarray, length: int) -> Iterator[_Block]:
    """Blocks of `length` windows' ends of each unbroken stretch, the rest of it left out."""
    series = np.asarray(error.error), np.asarray(error.target)
    step = float(error.time_step)
    for run in unbroken(np.asarray(error.present)):
        for start in range(run.start, run.stop - length + 1, length):
            rises = [_rises(values[start : start + length] * step, lags) for values in series]
            yield _Block(
                start,
                start + length,
                rises[0].size,
                float(np.sum(rises[0])),
                float(np.sum(rises[0] ** 2)),
                float(np.sum(rises[1] ** 2)),
            )


def _rises(values: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Sums over every window of these lengths."""
    running = np.concatenate([[0.0], np.cumsum(values)])
    return np.concatenate([running[lag:] - running[:-lag] for lag in lags])


def _stretches(blocks: list[_Block], of_all: int) -> list[list[_Block]]:
    """A record's blocks in stretches of at least five, as even as can be."""
    size = max(BLOCKS_TO_STRETCH, -(-of_all // MOST_STRETCHES))
    count = len(blocks) // size
    if not count:
        return []
    edges = np.linspace(0, len(blocks), count + 1).astype(int)
    return [blocks[a:b] for a, b in itertools.pairwise(edges)]


def _total(blocks: list[_Block]) -> _Block:
    sums = [sum(getattr(b, name) for b in blocks) for name in _Block._fields[2:]]
    return _Block(0, 0, *sums)


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0 else 0.0


def _against_all(stretches: list[list[_Block]], total: _Block, field: str) -> np.ndarray:
    means = [_total(part) for part in stretches]
    overall = _share(getattr(total, field), total.windows)
    return np.array([_share(_share(getattr(m, field), m.windows), overall) for m in means])


def _p_value(stretches: list[list[_Block]]) -> float:
    squares = [[_share(b.error_square, b.windows) for b in part] for part in stretches]
    flat = [value for part in squares for value in part]
    if len(squares) < FEWEST_STRETCHES or min(flat) == max(flat):
        return float("nan")
    floor = SILENT * max(flat)
    return tails.equal_means([np.log(np.maximum(s, floor)) for s in squares])


def _correlation(records: list[list[_Block]]) -> float:
    totals = [_total(blocks) for blocks in records if blocks]
    shared = sum(t.windows * (t.error / t.windows) ** 2 for t in totals)
    return _share(shared, sum(t.error_square for t in totals))


def _ratio(mean_square: np.ndarray) -> float:
    if not mean_square.size or not np.max(mean_square) > 0:
        return 1.0
    return float(np.max(mean_square) / max(np.min(mean_square), np.finfo(float).tiny))

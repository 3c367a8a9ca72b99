"""Eq. (18) on recorded data: whether errors of random windows have one variance and no correlation.

The paper argues by symmetry. Windows drawn at random have one expected mean square error sigma^2,
and any two of them one cross-correlation epsilon, small if windows are much shorter than the
record. The symmetry holds before anything is known of the record. On a given one the errors of
some stretches can outweigh all others, or all errors can share a constant part.
"""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax import tails
from riecjax.criteria.windows import AbstractWindows
from riecjax.validation.equation_errors import EquationError, joined
from riecjax.validation.time_series import unbroken

# Why eq. (18) allows ordinary least squares. With n windows the errors' covariance is
#
#     S = sigma^2 ((1 - epsilon) I + epsilon 1 1'),
#     S^-1 = (I - c 1 1') / (sigma^2 (1 - epsilon)),   c = epsilon / (1 - epsilon + n epsilon),
#
# so that generalised least squares solves (A'A - c A'1 1'A) theta = A'y - c A'1 1'y. Regressors of
# zero mean have A'1 = 0, and this is ordinary least squares whatever epsilon is. What a constant
# part does harm to is the average: the mean of n errors has the variance
# sigma^2 ((1 - epsilon) / n + epsilon), which does not fall below epsilon sigma^2.
#
# How large epsilon is by chance. White noise of density N has E e_1 e_2 = N E(overlap) for two
# windows and E e^2 = N E(T). A window covers an instant with probability about E(T) / t_max, two
# windows both with its square, so E(overlap) = E(T)^2 / t_max and epsilon = E(T) / t_max. The mean
# error being normal, the estimate below is epsilon times chi-square with one degree of freedom,
# which exceeds 10 with a probability of 0.2 %.

LENGTHS = 4
"""Window lengths from alpha to beta, each at every start."""
BLOCK_LENGTH = 2
"""Longest windows to a block of time; no window reaches over its end, so blocks share no data."""
BLOCKS_TO_STRETCH = 5
"""Blocks to a stretch at least, whose scatter separates chance from change."""
MOST_STRETCHES = 8
FEWEST_STRETCHES = 3
BATCH = 2**20
"""Samples of blocks that are looked at together."""
SILENT = 1e-6
"""Mean square relative to the loudest block's below which a block is just silent."""


class WindowErrors(NamedTuple):
    """Errors of windows along the record.

    **Fields:**

    - `relative_rms`: root mean square of the windows' errors relative to the targets'.
    - `start`, `stop`: first and last time of each stretch in seconds from the first recording's
      first sample, records one after the other; shape `(stretches,)`.
    - `mean_square`: mean square error of the windows of each stretch relative to that of all.
    - `target_mean_square`: the same of the target.
    - `p_value`: probability that equal stretches differ as much; NaN where the record is too short
      for three stretches.
    - `correlation`: epsilon, the mean product of the errors of two windows drawn at random from
      one record, over the mean square.
    - `window_share`: mean T / t_max, the epsilon of white noise.
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


class _Blocks(NamedTuple):
    """Means over the windows in each block of time, shape `(blocks,)`; `start` in samples."""

    start: np.ndarray
    error: np.ndarray
    error_square: np.ndarray
    target_square: np.ndarray


def window_errors(errors: list[EquationError], windows: AbstractWindows) -> WindowErrors | None:
    """Errors of boxcar windows over the records of one equation (not under jit).

    `None` where no record is long enough for two blocks of time of twice the longest window.
    """
    step = float(errors[0].time_step)
    alpha, beta = float(windows.alpha), float(windows.beta)
    longest = max(round(beta / step), 1)
    lags = np.unique(np.round(np.geomspace(max(alpha / step, 1), longest, LENGTHS)).astype(int))
    length = BLOCK_LENGTH * longest
    sizes = [error.error.size for error in errors]
    records = [
        _blocks(error, lags, length, before)
        for error, before in zip(errors, np.cumsum([0, *sizes[:-1]]))
    ]
    count = sum(blocks.start.size for blocks in records)
    if count < 2:
        return None
    size = max(BLOCKS_TO_STRETCH, -(-count // MOST_STRETCHES))
    stretches = [stretch for blocks in records for stretch in _stretches(blocks, size)]
    error, target = (
        np.concatenate([getattr(blocks, field) for blocks in records]).mean()
        for field in ("error_square", "target_square")
    )
    # Every block holds as many windows, so that means of blocks are means of windows.
    shared = sum(
        blocks.start.size * blocks.error.mean() ** 2 for blocks in records if len(blocks.start)
    )
    middle, half = np.asarray(joined(errors, 0).times), 0.5 * errors[0].span * step
    return WindowErrors(
        relative_rms=float(np.sqrt(_share(error, target))),
        start=np.array([middle[part.start[0]] for part in stretches]) - half,
        stop=np.array([middle[part.start[-1] + length - 1] for part in stretches]) + half,
        mean_square=np.array([_share(part.error_square.mean(), error) for part in stretches]),
        target_mean_square=np.array(
            [_share(part.target_square.mean(), target) for part in stretches]
        ),
        p_value=_p_value([part.error_square for part in stretches]),
        correlation=_share(shared / count, error),
        window_share=float(np.mean(lags) * len(sizes) / np.sum(sizes)),
    )


def _blocks(error: EquationError, lags: np.ndarray, length: int, before: int) -> _Blocks:
    """Blocks of `length` samples of each unbroken stretch, the rest of it left out.

    **Arguments:** `before`, samples of the records before this one, from which starts count.
    """
    step = float(error.time_step)
    starts = [
        start
        for run in unbroken(np.asarray(error.present))
        for start in range(run.start, run.stop - length + 1, length)
    ]
    rises, targets = (
        _rises(np.asarray(values) * step, np.array(starts, int), lags, length)
        for values in (error.error, error.target)
    )
    return _Blocks(np.array(starts, int) + before, rises.mean, rises.square, targets.square)


class _Rises(NamedTuple):
    """Mean and mean square over all windows in each block, shape `(blocks,)`."""

    mean: np.ndarray
    square: np.ndarray


def _rises(values: np.ndarray, starts: np.ndarray, lags: np.ndarray, length: int) -> _Rises:
    """Of sums over every window of these lengths in blocks that begin at `starts`.

    A window's sum is the rise of the block's own running sum, one lag for all blocks at a time.
    """
    mean, square = np.zeros(starts.size), np.zeros(starts.size)
    windows = int(np.sum(length + 1 - lags))
    for some in np.array_split(np.arange(starts.size), max(starts.size * length // BATCH, 1)):
        blocks = values[starts[some, None] + np.arange(length)]
        running = np.pad(np.cumsum(blocks, axis=1), [(0, 0), (1, 0)])
        for lag in lags:
            rises = running[:, lag:] - running[:, :-lag]
            mean[some] += rises.sum(1) / windows
            square[some] += np.einsum("ij,ij->i", rises, rises) / windows
    return _Rises(mean, square)


def _stretches(blocks: _Blocks, size: int) -> list[_Blocks]:
    """A record's blocks in stretches of at least `size`, as equal as possible."""
    count = blocks.start.size // size
    edges = np.linspace(0, blocks.start.size, count + 1).astype(int)
    return [_Blocks(*(v[a:b] for v in blocks)) for a, b in itertools.pairwise(edges) if count]


def _p_value(stretches: list[np.ndarray]) -> float:
    """Analysis of variance of the logarithms of the blocks' mean squares.

    A mean square of nu degrees of freedom scatters in proportion to its size, its logarithm by
    about sqrt(2 / nu) whatever the size, as the analysis presumes; nor does one loud block decide.
    """
    if len(stretches) < FEWEST_STRETCHES:
        return float("nan")
    largest = max(square.max() for square in stretches)
    if largest == min(square.min() for square in stretches):
        return float("nan")
    return tails.equal_means([np.log(np.maximum(s, SILENT * largest)) for s in stretches])


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole > 0 else 0.0


def _ratio(mean_square: np.ndarray) -> float:
    if not mean_square.size or not np.max(mean_square) > 0:
        return 1.0
    return float(np.max(mean_square) / max(np.min(mean_square), np.finfo(float).tiny))

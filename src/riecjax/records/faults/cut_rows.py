"""Rows lost from all signals at once, their time renumbered: the motion jumps with no velocity.

Between two samples x changes by the integral of v. What is left of x after that integral, w, moves
slowly whatever is off between x and v, in time, size or zero; where rows are gone it jumps by what
x moved in them. A straight line through the samples on either side of each instant, from its ends,

    jump = ahead(0) - behind(0),

is held against what such jumps are all along the record.
"""

import numpy as np

from riecjax.findings import Finding
from riecjax.records.record import Record, samples_with_nan

SIDES = (8, 24)
"""Samples of each line; a jump shows in the longer one as in the shorter, and a spike does not."""
SURE = 9.0
"""Standard deviations of all jumps, estimated from their median, past which one is none of them."""
AGREE = 0.3
"""Share by which a jump may differ between the two lengths."""
LEAST = 0.003
"""Share of the signal's deviation below which a jump does no harm."""


@np.errstate(all="ignore")
def cut_rows(record: Record, signal: str, derivative: str) -> Finding | None:
    """Whether rows are missing between two samples that follow each other in time. Not under jit.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    x, v = samples_with_nan(record, signal), samples_with_nan(record, derivative)
    step, size = float(record.time_step), float(np.nanstd(x))
    if x.size < 4 * SIDES[1] or not (np.isfinite(size) and size > 0):
        return None
    moved = np.nan_to_num(0.5 * step * (v[1:] + v[:-1]))
    left = (x - np.concatenate([[0.0], np.cumsum(moved)])) / size
    left[np.isnan(v)] = np.nan
    short, long = (_jumps(left, side) for side in SIDES)
    if np.isnan(short).all() or np.isnan(long).all():  # nowhere so many samples without a gap
        return None
    deviation = 1.4826 * float(np.nanmedian(np.abs(short)))
    least = max(SURE * deviation, LEAST)
    if not np.isfinite(least):
        return None
    sure = (np.abs(short) > least) & (np.abs(long - short) < AGREE * np.abs(short))
    sure &= np.abs(long) > SURE * 1.4826 * float(np.nanmedian(np.abs(long)))
    # A spike of the derivative moves its integral alone.
    sure &= np.abs(_jumps(x / size, SIDES[0]) - short) < np.abs(short) / 2
    if not sure.any():
        return None
    place = int(np.argmax(np.where(sure, np.abs(short), 0.0)))
    jump, side, time = float(short[place]), SIDES[0], np.asarray(record.elapsed)
    middles = np.median(left[place : place + side]) - np.median(left[place - side : place])
    if abs(middles - jump) > AGREE * abs(jump):
        return None
    lasts = place < x.size / 2
    return Finding(
        "lost_rows",
        f"{signal} jumps by {jump * size:.3g} at {time[place]:.7g} s, which the integral of "
        f"{derivative} does not follow, and goes on as before: rows of all signals are gone there, "
        f"and time was numbered anew. Use the record {'from there on' if lasts else 'up to there'},"
        f" or mark the gap in its time.",
        (signal, derivative),
        doubt=min(abs(jump), 1.0),
        remedy=("--from", f"{time[place + 2]:.7g}")
        if lasts
        else ("--to", f"{time[place - 2]:.7g}"),
        step=f"Leave out what is {'before' if lasts else 'behind'} the jump",
    )


def _jumps(values: np.ndarray, side: int) -> np.ndarray:
    """At each sample, the line through those from it on less that through those before, midway."""
    at = np.arange(side) + 0.5
    # Weights whose sum with values on a straight line is that line's value at 0.
    weights = 1 / side - np.mean(at) * (at - np.mean(at)) / np.sum((at - np.mean(at)) ** 2)
    found = np.full(values.size, np.nan)
    kernel = np.concatenate([-weights[::-1], weights])
    found[side : values.size - side + 1] = np.convolve(values, kernel[::-1], "valid")
    return found

"""Rest in a signal: stretches about zero in which it scatters no more than its noise.

A motion that passes through zero, or turns there, is within three standard deviations of the noise
for a while too. But over that stretch it moves, and its mean square is 2.5 to 4 times that of the
noise alone.
"""

from typing import NamedTuple

import numpy as np

from riecjax.records.record import Record, runs

NOISES, MOVES = 3.0, 1.0
"""What is about zero: so many standard deviations of noise, or usual changes over a sample."""
FEWEST = 6
"""Samples of a rest at the least."""
STILL = 1.5
"""Mean square of a rest at the most, in that of the noise."""
RISE = 3.0
"""Slope along a rest at the most, in standard errors by the noise."""
LEAST = 0.005
"""Share of a record that counts as rest at the least."""
OF_SLOW = 0.3
"""The same of all that is about zero: of what passes through slowly, a fifth looks still."""
REACH = (6.0, 4.0)
"""Widths of what is to be left out of it, in noise and in changes over a sample."""


class Rest(NamedTuple):
    """Rest in a signal.

    **Fields:** `share` of the samples; `width`, in the signal's unit, about zero within which rest,
    noise and what a sample holds cannot be told apart.
    """

    share: float
    width: float


def rest_of(record: Record, name: str) -> Rest | None:
    """Rest in a signal, `None` where there is none, or nothing else (not under jit)."""
    values = record.signal(name).with_nan
    with np.errstate(all="ignore"):
        change = np.abs(np.diff(values))
        if not (change > 0).any():
            return None
        noise, usual = float(record.noise.std(name)), float(np.median(change[change > 0]))
        near = max(NOISES * noise, MOVES * usual)
        about = np.where(np.abs(values) <= near, values / near, np.nan)
    if not np.isfinite(near) or np.isnan(about).mean() > 1 - LEAST:
        return None
    starts, stops = runs(~np.isnan(about))
    lengths = stops - starts
    # Of these stretches those that hold noise at the most, and neither move nor turn.
    scaled, place = np.nan_to_num(NOISES * about), np.arange(values.size) / values.size

    def total(column: np.ndarray) -> np.ndarray:
        running = np.concatenate([[0.0], np.cumsum(column)])
        return running[stops] - running[starts]

    middle = place[starts] + 0.5 * (lengths - 1) / values.size
    rise = np.abs(total(scaled * place) - middle * total(scaled)) * values.size
    still = (lengths >= FEWEST) & (rise <= RISE * np.sqrt(lengths**3 / 12))
    still &= total(scaled**2) <= STILL * lengths
    share = lengths[still].sum() / values.size
    if not max(LEAST, OF_SLOW * lengths.sum() / values.size) < share < 1:
        return None
    return Rest(float(share), max(REACH[0] * noise, REACH[1] * usual))

"""Counts that begin anew: angles with each turn, registers of signed numbers below zero."""

from collections.abc import Iterable

import numpy as np

from riecjax.records.signal import Samples

TURNS = (2 * np.pi, 360.0)
"""A turn in radians and in degrees."""
QUICKEST = 0.25
"""Turns from sample to sample past which nothing tells which way it went."""
MOST_TURNS = 0.05
"""Share of samples that begin a turn at most."""
REGISTERS = (2.0**16, 2.0**32)
"""Numbers that registers count."""


def unwrapped(values: Samples, turns: Iterable[float] = TURNS) -> tuple[Samples, str]:
    """Values that go on where they began anew, and in words what was done; empty if they never did.

    They jump from one end of a turn to the other, and nowhere else. Those of an angle fill a turn.
    Those of a register of signed numbers that was read as unsigned are whole, and count down below
    zero from 2^bits.
    """
    known = np.flatnonzero(~np.isnan(values))
    there = values[known]
    sizes = np.abs(np.diff(there))
    for turn in turns:
        jumps = sizes > turn / 2
        usual = np.max(sizes[~jumps], initial=0.0)
        if not jumps.any() or usual >= QUICKEST * turn:
            continue
        if turn in REGISTERS:
            is_one = np.all((there >= 0) & (there < turn) & (there == np.floor(there)))
            whole = np.where(values >= turn / 2, values - turn, values)
            said = f"signed numbers of {np.log2(turn):g} bits, read as unsigned, put right"
        else:
            fills = turn - 2 * usual <= np.ptp(there) <= turn + usual
            is_one, whole = fills and np.mean(jumps) <= MOST_TURNS, values.copy()
            whole[known] = np.unwrap(there, period=turn)
            said = f"unwrapped, {jumps.sum()} times"
        if is_one and np.max(np.abs(np.diff(whole[known]))) <= 2 * usual:
            return whole, said
    return values, ""

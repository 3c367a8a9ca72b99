"""Angles that begin anew with each turn, and signed registers that were read as unsigned."""

import numpy as np
from jaxtyping import Float

TURNS = (2 * np.pi, 360.0)
"""A turn in radians and in degrees."""
QUICKEST = 0.25
"""Turns from sample to sample past which nothing tells which way it went."""
MOST = 0.05
"""Share of samples that begin a turn at most."""
REGISTERS = (16, 32)
"""Bits of registers of signed numbers."""


def unwrapped(values: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], int]:
    """An angle that goes on from turn to turn, and how often it began anew; 0 if it never did.

    It is one whose values fill a turn, and jump from one end of it to the other, and nowhere else.
    """
    known = np.flatnonzero(~np.isnan(values))
    steps = np.diff(values[known])
    sizes = np.abs(steps)
    for turn in TURNS:
        jumps = sizes > turn / 2
        if not jumps.any() or np.mean(jumps) > MOST:
            continue
        usual = float(np.max(sizes[~jumps], initial=0.0))
        reach = float(np.ptp(values[known]))
        around = np.abs(sizes[jumps] - turn) <= 2 * usual
        if usual < QUICKEST * turn and turn - 2 * usual <= reach <= turn + usual and around.all():
            whole = values.copy()
            whole[known] -= turn * np.cumsum(np.append(0, np.where(jumps, np.sign(steps), 0)))
            return whole, int(jumps.sum())
    return values, 0


def signed(values: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], int]:
    """A register of signed numbers that was read as unsigned put right, and its bits; 0 if none.

    Below zero it counts down from 2^bits: it holds whole numbers, and leaps from one end of that
    range to the other where the signed number passes zero by no more than it steps elsewhere.
    """
    known = values[~np.isnan(values)]
    for bits in REGISTERS:
        count = 2.0**bits
        if known.size < 2 or not (known.max() > count / 2 and (known >= 0).all()):
            continue
        if known.max() >= count or (known != np.floor(known)).any():
            continue
        below = values >= count / 2
        whole = np.where(below, values - count, values)
        leaps = np.abs(np.diff(known)) > count / 2
        steps = np.abs(np.diff(whole[~np.isnan(values)]))
        usual = np.max(steps[~leaps], initial=0.0)
        if leaps.any() and usual < count / 4 and np.max(steps[leaps]) <= 2 * usual:
            return whole, bits
    return values, 0

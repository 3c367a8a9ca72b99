"""Angles that begin anew with each turn, as encoders and resolvers show them."""

import numpy as np
from jaxtyping import Float

TURNS = (2 * np.pi, 360.0)
"""A turn in radians and in degrees."""
QUICKEST = 0.25
"""Turns from sample to sample past which nothing tells which way it went."""
MOST = 0.05
"""Share of samples that begin a turn at most."""


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

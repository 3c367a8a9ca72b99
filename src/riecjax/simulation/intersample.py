"""Inputs between their samples: straight lines, or smooth where the samples are.

**Straight lines** err by h^2 u'' / 8 of a smooth input, and by h^2 u'' / 12 on the mean of an
interval: whatever is driven by a tone of n samples per period lacks pi^2 / (3 n^2) of its force, in
every interval, and a mass or a stiffness grows smaller by as much.

**Smooth.** On an interval u is the cubic with the values u_0, u_1 and the curvatures d_0, d_1 at
its ends, in units of the time step and with s = 0 to 1 along it,

    u(s) = u_0 + s (u_1 - u_0) - s (1 - s) / 6 ((2 - s) d_0 + (1 + s) d_1).

With second differences d_i = u_{i+1} - 2 u_i + u_{i-1} that is Lagrange's cubic through the four
nearest samples, which errs by 9 h^4 u'''' / 384 at most.

Second differences are also large where a signal jumps or turns a corner, and the cubic would then
swing to either side. A jump is a pair of them, a corner one, among zeros; of a smooth signal they
change little from sample to sample, mostly in one direction. Hence d_i is the *median* of the five
around sample i: it is the middle one where these rise or fall, and where they turn, a share of
O(h^2) less at most, so that the fourth order stays; of one or two among zeros it is zero. So steps
that are held for three samples or more, ramps and their corners remain straight lines. Of white
noise as little is left between samples as by lines, 0.71 of its deviation (0.80 by Lagrange's
cubic), and a curvature below the noise is not lost: medians of symmetric noise do not lean.

Beside an end or a missing sample those of the five count that are there, and the outermost
curvature holds on to the end: there, for an interval or two, the error is of third order.
"""

from typing import Literal, TypeAlias

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from riecjax.errors import ModelError

Intersample: TypeAlias = Literal["lines", "smooth"]
"""What inputs are between their samples."""
REACH = 2
"""Samples to either side whose second differences are looked at."""
FEWEST = 3
"""Second differences that tell a curvature from a corner."""


def require_intersample(given: object) -> None:
    """Raise `ModelError` for what says nothing of inputs between samples."""
    if given not in ("lines", "smooth"):
        raise ModelError(f"inputs between samples are 'lines' or 'smooth'; got {given!r}.")


def bends_of(
    levels: Float[Array, "n inputs"], present: Bool[Array, " n"] | None = None
) -> Float[Array, "n inputs"]:
    """Curvature of smooth inputs at each sample, in their unit per time step squared.

    Zero where a signal jumps or turns a corner, and of unbroken stretches of fewer than 5 samples.
    """
    n = levels.shape[0]
    if n < FEWEST + 2:
        return jnp.zeros_like(levels)
    there = jnp.ones(n, bool) if present is None else present
    own = jnp.pad(there[2:] & there[1:-1] & there[:-2], (1, 1))
    second = jnp.pad(levels[2:] - 2 * levels[1:-1] + levels[:-2], ((1, 1), (0, 0)))
    around, held = _around(second), _around(own)[:, :, None]
    count = jnp.sum(held, axis=0, keepdims=True)
    ordered = jnp.sort(jnp.where(held, around, jnp.inf), axis=0)
    middle = [
        jnp.take_along_axis(ordered, jnp.broadcast_to(index, (1, *levels.shape)), axis=0)[0]
        for index in (jnp.maximum(count - 1, 0) // 2, count // 2)
    ]
    told = own[:, None] & (count[0] >= FEWEST)
    bends = jnp.where(told, 0.5 * (middle[0] + middle[1]), 0.0)
    # An end has no second difference: it takes the curvature beside it.
    before, after = jnp.pad(bends[:-1], ((1, 0), (0, 0))), jnp.pad(bends[1:], ((0, 1), (0, 0)))
    beside = jnp.where(jnp.pad(own[:-1], (1, 0))[:, None], before, after)
    return jnp.where((there & ~own)[:, None], beside, bends)


def _around(values: Array) -> Array:
    """Values of the samples around each, one after the other on a new leading axis."""
    n, rest = values.shape[0], [(0, 0)] * (values.ndim - 1)
    padded = jnp.pad(values, [(REACH, REACH), *rest])
    return jnp.stack([padded[i : i + n] for i in range(2 * REACH + 1)])


def curves_of(
    bends: Float[Array, "n inputs"],
) -> tuple[Float[Array, "n-1 inputs"], Float[Array, "n-1 inputs"]]:
    """Coefficients a, b by which u(s) differs from a line on each interval: s (1 - s) (a + b s)."""
    first, last = bends[:-1], bends[1:]
    return -(2 * first + last) / 6, (first - last) / 6

"""Inputs between their samples: straight lines, or smooth where the samples are.

**Straight lines** err by h^2 u'' / 8 of a smooth input, and by h^2 u'' / 12 on the mean of an
interval: whatever is driven by a tone of n samples per period lacks pi^2 / (3 n^2) of its force, in
every interval, and a mass or a stiffness grows smaller by as much.

**Smooth.** On an interval u is the cubic with the values u_0, u_1 and the curvatures d_0, d_1 at
its ends, in units of the time step and with s = 0 to 1 along it,

    u(s) = u_0 + s (u_1 - u_0) - s (1 - s) / 6 ((2 - s) d_0 + (1 + s) d_1).

What moves a body is its mean, (u_0 + u_1) / 2 - (d_0 + d_1) / 24. Of a tone of w radians per sample
the samples' mean is cos(w/2) and the tone's is sin(w/2) / (w/2), in units of its middle: curvatures
that give the mean of every tone are -12 (tan(w/2) / (w/2) - 1) times the tone. In powers of the
second difference D, which is -4 sin^2(w/2) of it,

    d = D u - 11/60 D^2 u + 191/5040 D^3 u - 2497/302400 D^4 u + ...

The first term is Lagrange's cubic through the four nearest samples: its mean errs by 3.6 % at 5
samples per period. These four err by 0.1 % there, and by 1.4e-6 at 10.

**Where it is not smooth.** Differences are also large where a signal jumps or turns a corner, and
the cubic would then swing to either side. Frequency tells them apart: the sum of squares of third
differences is that of second ones times the mean square of 2 sin(w/2), weighed by what curves. Of a
corner that is 2, of a jump 3, of white noise 10/3, and of what is sampled more than five times per
period at most 1.4. Where it is above `BROADEST` around a sample, d_i is the *median* of the five
second differences around it. A jump is a pair of them, a corner one, among zeros; of a smooth
signal below its noise they change little, mostly in one direction: the median is the middle one
where these rise or fall, and where they turn, a share of O(h^2) less at most. So steps that are
held for three samples or more, ramps and their corners remain straight lines. Of white noise as
little is left between samples as by lines, 0.71 of its deviation (0.80 by Lagrange's cubic), and a
curvature below the noise is not lost: medians of symmetric noise do not lean.

Beside an end or a missing sample those of the five count that are there, and the outermost
curvature holds on to the end: there, for an interval or two, the error is of third order.
"""

import functools
from collections.abc import Mapping, Sequence
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax import arrays as xp
from riecjax.errors import ModelError

Course: TypeAlias = Literal["lines", "smooth"]
Intersample: TypeAlias = Course | Mapping[str, Course]
"""What inputs are between their samples: all of them, or by name, and smooth those not named."""
REACH = 2
"""Samples to either side of which second differences have a median."""
OF_MEAN = (1.0, -11 / 60, 191 / 5040, -2497 / 302400)
"""Coefficients of powers of the second difference that give the mean of an interval."""
SIGHT = 5
"""Samples to either side whose differences tell what is smooth."""
BROADEST = 1.8
"""Mean square of 2 sin(w/2), up to which what curves is a motion: at 4.3 samples per period."""
FEWEST = 3
"""Second differences that tell a curvature from a corner."""


def require_intersample(given: object) -> None:
    """Raise `ModelError` for what says nothing of inputs between samples."""
    for word in given.values() if isinstance(given, Mapping) else (given,):
        if word not in ("lines", "smooth"):
            raise ModelError(f"inputs between samples are 'lines' or 'smooth'; got {word!r}.")


def smooth_inputs(given: Intersample, names: Sequence[str]) -> tuple[bool, ...]:
    """Which of the inputs, in order, are smooth.

    **Raises:** `ModelError` for the name of no input.
    """
    if not isinstance(given, Mapping):
        return tuple(given == "smooth" for _ in names)
    if unknown := [name for name in given if name not in names]:
        raise ModelError(f"'{unknown[0]}' is no input of the system; it has: {', '.join(names)}.")
    return tuple(given.get(name, "smooth") == "smooth" for name in names)


def bends_of(
    levels: Float[Array, "n inputs"],
    present: Bool[Array, " n"] | None = None,
    smooth: tuple[bool, ...] | None = None,
) -> Float[Array, "n inputs"]:
    """Curvature of smooth inputs at each sample, in their unit per time step squared.

    Zero where a signal jumps or turns a corner, of unbroken stretches of fewer than 5 samples, and
    of those inputs that are not `smooth`, where given.
    """
    if smooth is not None and not all(smooth):
        return xp.where(np.array(smooth), bends_of(levels, present), 0.0)
    n = levels.shape[0]
    if n < FEWEST + 2:
        return xp.zeros_like(levels)
    there = xp.ones(n, bool) if present is None else present
    own = xp.pad(there[2:] & there[1:-1] & there[:-2], (1, 1))
    second = xp.pad(levels[2:] - 2 * levels[1:-1] + levels[:-2], ((1, 1), (0, 0)))
    # What curves around each sample is a motion where it is sampled finely enough. A missing
    # neighbour counts as zero: a jump beside an end is one as well.
    still = xp.stop_gradient(xp.where(own[:, None], second, 0.0))
    third = xp.diff(still, append=xp.zeros_like(still[:1]), axis=0)
    every, between = np.ones(2 * SIGHT + 1, int), np.append(np.ones(2 * SIGHT, int), 0)
    size, rough = _weighted(still**2, every), _weighted(third**2, between)
    of_second = _weighted(own.astype(int), every)[:, None]
    of_third = _weighted((own | xp.pad(own[1:], (0, 1))).astype(int), between)[:, None]
    resolved = own[:, None] & (of_second > SIGHT)
    resolved = resolved & (rough * of_second <= BROADEST * size * of_third)
    # Curvatures that give every interval its mean, of as many differences as are there.
    smooth_ones = second
    kernel = np.zeros(1)
    power = np.ones(1)
    for reach, coefficient in enumerate(OF_MEAN):
        kernel = np.pad(kernel, min(reach, 1)) + coefficient * power
        power = np.convolve(power, [1, -2, 1])
        whole = _weighted(own.astype(int), np.ones(2 * reach + 1, int)) == 2 * reach + 1
        smooth_ones = xp.where(whole[:, None], _weighted(second, kernel), smooth_ones)
    # Elsewhere medians of the differences around each sample, of those that are there.
    places = range(2 * REACH + 1)
    differences = xp.pad(second, ((REACH, REACH), (0, 0)))
    known = xp.pad(own, REACH)
    around = xp.stack([differences[i : i + n] for i in places])
    there_too = xp.stack([known[i : i + n] for i in places])[:, :, None]
    told = own[:, None] & (xp.sum(there_too, axis=0) >= FEWEST)
    # Where nothing is told, of zeros: no derivative passes through a median of nothing.
    medians = xp.nanmedian(xp.where(told, xp.where(there_too, around, xp.nan), 0.0), axis=0)
    bends = xp.where(resolved, smooth_ones, medians)

    def beside(values: Array, by: int) -> tuple[Array, Array]:
        rest = [(0, 0)] * (values.ndim - 1)
        return xp.pad(values, [(by, 0), *rest])[:-by], xp.pad(values, [(0, by), *rest])[by:]

    # At samples without a curvature: on a line through the two beside it, or that beside it.
    near, far = beside(bends, 1), beside(bends, 2)
    lines = [
        xp.where((two & own_two[:, None]) & one, 2 * d - dd, d)
        for d, dd, one, two, own_two in zip(
            near, far, beside(resolved, 1), beside(resolved, 2), beside(own, 2)
        )
    ]
    known_before = beside(own, 1)[0][:, None]
    return xp.where((there & ~own)[:, None], xp.where(known_before, *lines), bends)


def _weighted(values: Array, weights: np.ndarray) -> Array:
    """Weighted sums of the samples around each, of which none is written down."""
    n, rest = values.shape[0], [(0, 0)] * (values.ndim - 1)
    padded = xp.pad(values, [(weights.size // 2, weights.size // 2), *rest])
    parts = [weight * padded[i : i + n] for i, weight in enumerate(weights.tolist()) if weight]
    return functools.reduce(xp.add, parts)


def curves_of(bends: Float[Array, "n inputs"] | None) -> tuple[Float[Array, "n-1 inputs"], ...]:
    """Coefficients a, b by which u(s) differs from a line on each interval: s (1 - s) (a + b s).

    None of straight lines.
    """
    if bends is None:
        return ()
    first, last = bends[:-1], bends[1:]
    return -(2 * first + last) / 6, (first - last) / 6

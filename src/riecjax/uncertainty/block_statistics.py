"""How long a block of time must be: stretches of a record whose errors may count as independent.

Windows overlap and equation errors are autocorrelated, so single rows are far from independent.
Normal equations are made for many short blocks of start times, which cost nothing, and added up to
blocks that are long enough once that length is known from the data.
"""

# Two lengths compete. The variance of a mean of n values, estimated from blocks of b, misses the
# covariances beyond b, a bias of -G / b with G = sum |k| R(k), and of n / b blocks it has a
# variance of about 2 g0^2 b / n, g0 = sum R(k) the spectral density at zero. The sum of squared
# bias and variance is least at `b = (G^2 / g0^2)^(1/3) n^(1/3)` (Politis and White, 2004; for
# blocks that overlap it is (3/2)^(1/3) times as long). The series is each block's influence on a
# parameter, so every parameter has its length and the longest is taken: too long a block costs
# degrees of freedom, which Student's t pays for, too short a one costs coverage that nothing shows.

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from riecjax.linear_algebra import solve_scaled
from riecjax.summaries.normal_equations import (
    FEWEST_WINDOWS,
    NormalEquations,
    ShortBlocks,
    blocks_in_use,
    sum_blocks,
)

ENOUGH_BLOCKS = 20
"""Blocks of all records that long blocks should leave."""
LONGEST_WINDOWS = 4
"""Longest windows to a block, where there is room: a quarter of it overlaps the next block."""
SILENT = 5
"""Insignificant autocovariances in a row that end the search: the root of log10 n, and 5 at least,
which is more for any n."""


def block_length(
    short: ShortBlocks, longest_window: Float[Array, ""], correlated: Float[Array, " p"]
) -> Float[Array, ""]:
    """Seconds to a block: the rule that intervals rest on.

    The longest that Politis and White's rule finds for any parameter (`correlated`, see
    [`politis_white`][]), and no less than four times the longest window, so that little of a
    block's windows reaches into the next. Where the records would be fewer than twenty such blocks
    it is shortened to that, but never below twice the longest window.
    """
    wanted = jnp.maximum(LONGEST_WINDOWS * longest_window, jnp.max(correlated))
    room = jnp.sum(short.durations) / ENOUGH_BLOCKS
    shortest = jnp.maximum(FEWEST_WINDOWS * longest_window, jnp.min(short.seconds))
    return jnp.maximum(jnp.minimum(wanted, room), shortest)


def politis_white(
    influence: Float[Array, "records blocks p"], short: ShortBlocks
) -> Float[Array, " p"]:
    """Length of blocks in seconds that gives the least error of a variance, for each parameter.

    Politis and White (2004), with the constant for blocks that do not overlap:
    `(G^2 / g0^2)^(1/3) N^(1/3)`, where g0 is the spectral density of the series at frequency zero
    and G = sum |k| R(k); autocovariances R count up to twice the lag from which on they are
    insignificant, with a flat-top taper (1 up to half of it, then falling to 0), whose bias is
    smaller than any power of that lag where Bartlett's is of its first.

    **Arguments:** `influence` of each short block on each estimate, zero where there is none.
    """
    records, room = influence.shape[:2]
    count = jnp.sum(short.number)
    # Arrays may be longer than what they hold, so that the number of lags is traced.
    room = min(int(np.ceil(np.sqrt(records * room))) + SILENT, room - 1)
    if room < SILENT + 1:
        return jnp.zeros(influence.shape[-1], influence.dtype)
    lags = jnp.ceil(jnp.sqrt(count)) + SILENT
    lags = jnp.minimum(lags, jnp.max(short.number) - 1).astype(int)
    # Sums of products at lags 0 to `room`, of all records. Lag by lag: few enough, and XLA's
    # Fourier transforms may lock up where several run at once.
    n = influence.shape[1]
    padded = jnp.pad(influence, ((0, 0), (0, room), (0, 0)))

    def at_lag(lag: Array) -> Float[Array, " p"]:
        later = jax.lax.dynamic_slice_in_dim(padded, lag, n, axis=1)
        return jnp.sum(influence * later, axis=(0, 1))

    covariances = jax.lax.map(at_lag, jnp.arange(room + 1))
    positive = (covariances[0] > 0) & (lags > SILENT)
    scale = jnp.where(positive, covariances[0], 1.0)
    lag = jnp.arange(1, room + 1)[:, None]
    ratios = jnp.where(lag <= lags, covariances[1:] / scale[None, :], 0.0)
    significant = jnp.abs(ratios) >= 2 * jnp.sqrt(jnp.log10(count) / count)
    significant = significant & (lag <= lags)
    # The lag, 1 at least, after which `SILENT` in a row are insignificant; else the last one.
    loud = jnp.pad(jnp.cumsum(significant, axis=0), ((1, 0), (0, 0)))
    starts = room - SILENT + 1
    quiet = loud[SILENT : SILENT + starts] == loud[:starts]
    quiet = quiet & (jnp.arange(starts)[:, None] <= lags - SILENT)
    last = jnp.max(jnp.where(significant, lag, 0), axis=0)
    insignificant = jnp.where(jnp.any(quiet, axis=0), jnp.argmax(quiet, axis=0), last)
    reach = 2 * jnp.maximum(insignificant, 1)
    taper = jnp.clip(2 * (1 - lag / reach[None, :]), 0.0, 1.0)
    slope = 2 * jnp.sum(taper * lag * ratios, axis=0)
    density = 1 + 2 * jnp.sum(taper * ratios, axis=0)
    blocks = jnp.abs(slope / jnp.maximum(density, 0.1)) ** (2 / 3) * count ** (1 / 3)
    return jnp.where(positive, blocks, 0.0) * jnp.mean(short.seconds)


# Block statistics: scores of blocks of time, the slope of their sum, each block's influence.
#
# Stage s has the rows `[y A]` and finds the parameters theta_s, with those of earlier stages held
# at what these found. With A_s the columns of theta_s, block b contributes the score
#
#     psi_bs(theta) = A_bs^T (y_b - A_b theta),
#
# theta all parameters of all stages. The scores of all stages, psi_b = (psi_b1, psi_b2, ...), make
# one system of estimating equations, `sum_b psi_b(theta) = 0`, whose solution is the staged fit: in
# a two-step M-estimator each step's first-order condition is one equation of the stack (Newey and
# McFadden, 1994, section 6). It is linear in theta, so that its slope
#
#     J = -d/dtheta sum_b psi_b,   rows of stage s: A_s^T A,
#
# is exact and constant. J is block triangular: a stage's score depends on what earlier stages
# found, and not the other way round. The blocks below the diagonal carry what is uncertain in the
# masses into the stiffness that is found with them; least squares' covariance of one stage leaves
# them out.
#
# If block b counts with weight w_b, then `d theta / d w_b = J^-1 psi_b` at w = 1: the block's
# influence u_b. Where blocks are independent, `cov(theta) = J^-1 (sum psi_b psi_b^T) J^-T = sum u_b
# u_b^T`, the sandwich A^-1 B A^-T; all that follows differs in how it estimates the middle. No
# model of the errors enters: they may be autocorrelated within a block and of any size in each.

Unknowns = list[tuple[int, tuple[str, ...]]]
"""Place of each stage that finds something, and the parameters it finds."""


class BlockStatistics(NamedTuple):
    """All that covariances and intervals are computed from.

    **Fields:**

    - `unknowns`, `known`, `values`: what each stage finds, what is given, everything by name.
    - `length`: seconds to a block; `used`, how many blocks each record is cut into.
    - `blocks`: normal equations of each stage, `MOST_BLOCKS` blocks of each record along the
      leading axis, of which those beyond `used` are empty; `influence` of each.
    - `short`: the short blocks of time that these are made of; `short_blocks`, their normal
      equations, leading axes `(records, short blocks)`, and `short_influence`.
    """

    unknowns: Unknowns
    known: dict[str, Array]
    values: dict[str, Array]
    length: Float[Array, ""]
    used: Int[Array, " records"]
    blocks: list[NormalEquations]
    influence: Float[Array, "blocks p"]
    short: ShortBlocks
    short_blocks: list[NormalEquations]
    short_influence: Float[Array, "records short p"]

    @property
    def estimate(self) -> Float[Array, " p"]:
        """The values of what is found, in order."""
        return as_vector(self.unknowns, self.values)


def block_statistics(
    stages: Sequence[NormalEquations],
    known: Mapping[str, Array],
    values: Mapping[str, Array],
    short: ShortBlocks,
    longest_window: Float[Array, ""],
) -> BlockStatistics:
    """Statistics of blocks whose length is chosen from the short blocks' influence.

    **Arguments:** `stages`, normal equations with leading axes `(records, short blocks)`;
    `values`, their solution, by name.
    """
    flat = block_influence([stage.flattened() for stage in stages], known, values)
    influence = flat.reshape(short.number.shape[0], -1, flat.shape[-1])
    length = block_length(short, longest_window, politis_white(influence, short))
    used = blocks_in_use(short, length)
    blocks = [stage.merged(short, used) for stage in stages]
    return BlockStatistics(
        unknowns_of(blocks, known),
        dict(known),
        dict(values),
        length,
        used,
        blocks,
        # Scores add up over short blocks, and so does their influence.
        sum_blocks(influence, short, used),
        short,
        list(stages),
        influence,
    )


def unknowns_of(stages: Sequence[NormalEquations], known: Mapping[str, Array]) -> Unknowns:
    """What each stage finds, given what is known beforehand."""
    found = set(known)
    unknowns = []
    for i, equations in enumerate(stages):
        names = tuple(name for name in equations.parameters if name not in found)
        if names:
            unknowns.append((i, names))
            found |= set(names)
    return unknowns


def staged_values(
    totals: list[NormalEquations], unknowns: Unknowns, known: Mapping[str, Array]
) -> dict[str, Array]:
    """Every parameter by name, from the stages' normal equations (without an axis of blocks)."""
    found = dict(known)
    for i, names in unknowns:
        stage = totals[i].fix(found)
        found |= dict(zip(names, solve_scaled(stage.gram, stage.moment[:, None])[:, 0]))
    return found


def as_vector(unknowns: Unknowns, values: Mapping[str, Array]) -> Float[Array, " p"]:
    """The values of all unknowns, in the order in which they are found."""
    return jnp.stack([values[name] for _, names in unknowns for name in names])


def scores(
    stages: list[NormalEquations], unknowns: Unknowns, values: Mapping[str, Array]
) -> Float[Array, "blocks p"]:
    """For each block of the leading axis, the sum of regressors times residuals."""
    parts = []
    for i, names in unknowns:
        blocks = stages[i]
        own = jnp.array([blocks.parameters.index(name) for name in names])
        at = jnp.stack([jnp.asarray(values[name]) for name in blocks.parameters])
        parts.append(blocks.moment[..., own] - blocks.gram[..., own, :] @ at)
    return jnp.concatenate(parts, axis=-1)


def slope(totals: list[NormalEquations], unknowns: Unknowns) -> Float[Array, "p p"]:
    """Derivative of the scores' sum with respect to all unknowns, negated."""
    names = [name for _, found in unknowns for name in found]
    rows = []
    for i, found in unknowns:
        equations = totals[i]
        own = jnp.array([equations.parameters.index(name) for name in found])
        held = [name for name in equations.parameters if name in names]
        place = jnp.array([names.index(name) for name in held])
        source = jnp.array([equations.parameters.index(name) for name in held])
        empty = jnp.zeros((len(found), len(names)), equations.moments.dtype)
        rows.append(empty.at[:, place].set(equations.gram[own][:, source]))
    return jnp.concatenate(rows)


def block_influence(
    stages: list[NormalEquations], known: Mapping[str, Array], values: Mapping[str, Array]
) -> Float[Array, "blocks p"]:
    """How far each block of time moves each parameter of all stages, slope^-1 times its score."""
    unknowns = unknowns_of(stages, known)
    totals = [stage.total() for stage in stages]
    return solve_scaled(slope(totals, unknowns), scores(stages, unknowns, values).T).T

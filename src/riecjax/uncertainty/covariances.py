"""Covariances of estimates, from blocks of time whose errors may count as independent.

Windows overlap and equation errors are autocorrelated, so single rows are far from independent.
Normal equations are made for many short blocks of start times, which cost nothing, and added up to
blocks that are long enough once that length is known from the data.
"""

import functools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from riecjax import arrays as xp
from riecjax import tails
from riecjax.arrays import Array
from riecjax.linear_algebra import (
    eliminate,
    eliminate_with_pivots,
    solve_scaled,
    unit_diagonal,
    unit_scale,
)
from riecjax.summaries.normal_equations import (
    FEWEST_WINDOWS,
    MOST_BLOCKS,
    NormalEquations,
    ShortBlocks,
    blocks_in_use,
    most_used,
    sum_blocks,
)

# How long a block of time must be.
#
# Two lengths compete. The variance of a mean of n values, estimated from blocks of b, misses the
# covariances beyond b, a bias of -G / b with G = sum |k| R(k), and of n / b blocks it has a
# variance of about 2 g0^2 b / n, g0 = sum R(k) the spectral density at zero. The sum of squared
# bias and variance is least at `b = (G^2 / g0^2)^(1/3) n^(1/3)` (Politis and White, 2004; for
# blocks that overlap it is (3/2)^(1/3) times as long). The series is each block's influence on a
# parameter, so every parameter has its length and the longest is taken: too long a block costs
# degrees of freedom, which Student's t pays for, too short a one costs coverage that nothing shows.

ENOUGH_BLOCKS = 20
"""Blocks of all records that long blocks should leave."""
LONGEST_WINDOWS = 4
"""Longest windows to a block, where there is room: a quarter of it overlaps the next block."""
SILENT = 5
"""Insignificant autocovariances in a row that end the search: the root of log10 n, and 5 at least,
which is more for any n."""


def block_length(short: ShortBlocks, correlated: Float[Array, " p"]) -> Float[Array, ""]:
    """Seconds to a block: the rule that intervals rest on.

    The longest that Politis and White's rule finds for any parameter (`correlated`, see
    [`politis_white`][]), and no less than four times the longest window, so that little of a
    block's windows reaches into the next. Where the records would be fewer than twenty such blocks
    it is shortened to that, but never below twice the longest window.
    """
    wanted = xp.maximum(LONGEST_WINDOWS * short.longest_window, xp.max(correlated))
    room = xp.sum(short.durations) / ENOUGH_BLOCKS
    shortest = xp.maximum(FEWEST_WINDOWS * short.longest_window, xp.min(short.seconds))
    return xp.maximum(xp.minimum(wanted, room), shortest)


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
    count = xp.sum(short.number)
    # Arrays may be longer than what they hold, so that the number of lags is traced.
    room = min(int(np.ceil(np.sqrt(records * room))) + SILENT, room - 1)
    if room < SILENT + 1:
        return np.zeros(influence.shape[-1], influence.dtype)
    lags = xp.ceil(xp.sqrt(count)) + SILENT
    lags = xp.minimum(lags, xp.max(short.number) - 1).astype(int)
    # Sums of products at lags 0 to `room`, of all records. Lag by lag: few enough, and XLA's
    # Fourier transforms may lock up where several run at once.
    n = influence.shape[1]
    padded = xp.moveaxis(xp.pad(influence, ((0, 0), (0, room), (0, 0))), 1, -1)
    series = xp.moveaxis(influence, 1, -1)

    def at_lag(lag: Array) -> Float[Array, " p"]:
        return (series * xp.cut(padded, lag, n)).sum(axis=(0, -1))

    covariances = xp.each(at_lag, np.arange(room + 1), beside=(series, padded))
    positive = (covariances[0] > 0) & (lags > SILENT)
    scale = xp.where(positive, covariances[0], 1.0)
    lag = np.arange(1, room + 1)[:, None]
    ratios = xp.where(lag <= lags, covariances[1:] / scale[None, :], 0.0)
    significant = xp.abs(ratios) >= 2 * xp.sqrt(xp.log10(count) / count)
    significant = significant & (lag <= lags)
    # The lag, 1 at least, after which `SILENT` in a row are insignificant; else the last one.
    loud = xp.pad(xp.cumsum(significant, axis=0), ((1, 0), (0, 0)))
    starts = room - SILENT + 1
    quiet = loud[SILENT : SILENT + starts] == loud[:starts]
    quiet = quiet & (np.arange(starts)[:, None] <= lags - SILENT)
    last = xp.max(xp.where(significant, lag, 0), axis=0)
    insignificant = xp.where(xp.any(quiet, axis=0), xp.argmax(quiet, axis=0), last)
    reach = 2 * xp.maximum(insignificant, 1)
    taper = xp.clip(2 * (1 - lag / reach[None, :]), 0.0, 1.0)
    slope = 2 * xp.sum(taper * lag * ratios, axis=0)
    density = 1 + 2 * xp.sum(taper * ratios, axis=0)
    blocks = xp.abs(slope / xp.maximum(density, 0.1)) ** (2 / 3) * count ** (1 / 3)
    return xp.where(positive, blocks, 0.0) * xp.mean(short.seconds)


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

    - `unknowns`, `values`: what each stage finds, and everything by name.
    - `length`: seconds to a block; `used`, how many blocks each record is cut into.
    - `short`: the short blocks of time that these are made of; `short_stages`, their normal
      equations, with leading axes `(records, short blocks)`, as have their `short_scores`,
      `short_slopes` and `short_influence`.
    """

    unknowns: Unknowns
    values: dict[str, Array]
    length: Float[Array, ""]
    used: Int[Array, " records"]
    short: ShortBlocks
    short_stages: list[NormalEquations]
    short_scores: Float[Array, "records short p"]
    short_slopes: Float[Array, "records short p p"]
    short_influence: Float[Array, "records short p"]

    @property
    def names(self) -> tuple[str, ...]:
        """Of what is found, in order."""
        return tuple(name for _, found in self.unknowns for name in found)

    @property
    def estimate(self) -> Float[Array, " p"]:
        """The values of what is found."""
        return xp.stack([self.values[name] for name in self.names])

    @property
    def slope(self) -> Float[Array, "p p"]:
        """That of the scores' sum."""
        return self.short_slopes.sum((0, 1))

    def in_blocks(
        self, used: Int[Array, " records"] | None = None, most: int = MOST_BLOCKS
    ) -> tuple[Float[Array, "blocks p"], Float[Array, "blocks p p"]]:
        """Scores and slopes of longer blocks, as many of each record along the leading axis, of
        which those beyond `used` are empty: they add up over short ones."""
        used = self.used if used is None else used
        both = self.short_scores, self.short_slopes
        scored, slopes = (sum_blocks(of_short, self.short, used, most) for of_short in both)
        return scored, slopes

    @property
    def influence(self) -> Float[Array, "blocks p"]:
        """Of such blocks, on the estimate."""
        return sum_blocks(self.short_influence, self.short, self.used)

    @property
    def rows(self) -> tuple[Float[Array, "p p"], list[Float[Array, " p"]]]:
        """Which parameters are found by one stage, ones among zeros; and of the stage of each what
        is left of its rows at the estimate, as energy, the target's energy, and how many it has."""
        place = np.repeat(np.arange(len(self.unknowns)), [len(n) for _, n in self.unknowns])
        told = []
        for i, _ in self.unknowns:
            total = self.short_stages[i].flattened().total()
            at = xp.stack([self.values[name] for name in total.parameters])
            told.append((total.residual_energy(at), total.energy, total.count))
        together = (place[:, None] == place).astype(float)
        return together, [xp.stack(each)[place] for each in zip(*told)]


def block_statistics(
    stages: Sequence[NormalEquations],
    known: Mapping[str, Array],
    values: Mapping[str, Array],
    short: ShortBlocks,
    ridge: float = 0.0,
) -> BlockStatistics:
    """Statistics of blocks whose length is chosen from the short blocks' influence.

    **Arguments:** `stages`, normal equations with leading axes `(records, short blocks)`;
    `values`, their solution, by name; `ridge` of the slope, with its diagonal scaled to ones.
    """
    unknowns = unknowns_of(stages, known)
    scored, slopes = scores(stages, unknowns, values), slope(stages, unknowns)
    influence = influence_of(scored, slopes.sum((0, 1)), ridge)
    length = block_length(short, politis_white(influence, short))
    sums = short, list(stages), scored, slopes, influence
    return BlockStatistics(unknowns, dict(values), length, blocks_in_use(short, length), *sums)


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


def scores(
    stages: Sequence[NormalEquations], unknowns: Unknowns, values: Mapping[str, Array]
) -> Float[Array, "*blocks p"]:
    """For each block, the sum of regressors times residuals."""
    parts = []
    for i, names in unknowns:
        blocks = stages[i]
        own = np.array([blocks.parameters.index(name) for name in names])
        at = xp.stack([values[name] for name in blocks.parameters])
        clean = blocks.clean[..., 1 + own, :]
        parts.append(clean[..., 0] - clean[..., 1:] @ at)
    return xp.concatenate(parts, axis=-1)


def slope(stages: Sequence[NormalEquations], unknowns: Unknowns) -> Float[Array, "*blocks p p"]:
    """Derivative of each block's scores with respect to all unknowns, negated."""
    names = [name for _, found in unknowns for name in found]
    rows = []
    for i, found in unknowns:
        equations = stages[i]
        own = np.array([equations.parameters.index(name) for name in found])
        # Behind the columns stands one of zeros, for what does not occur in this stage.
        place = {name: j for j, name in enumerate(equations.parameters)}
        source = np.array([place.get(name, len(place)) for name in names])
        gram = equations.gram[..., own, :]
        gram = xp.pad(gram, [(0, 0)] * (gram.ndim - 1) + [(0, 1)])
        rows.append(gram[..., source])
    return xp.concatenate(rows, axis=-2)


def influence_of(
    scored: Float[Array, "*blocks p"], whole: Float[Array, "p p"], ridge: float = 0.0
) -> Float[Array, "*blocks p"]:
    """How far each block of time moves each parameter of all stages, slope^-1 times its score."""
    flat = scored.reshape(-1, scored.shape[-1])
    return solve_scaled(whole, flat.T, ridge).T.reshape(scored.shape)


def block_influence(
    stages: Sequence[NormalEquations], known: Mapping[str, Array], values: Mapping[str, Array]
) -> Float[Array, "blocks p"]:
    """The influence of blocks along the leading axis of stages' normal equations."""
    unknowns = unknowns_of(stages, known)
    whole = slope(stages, unknowns).sum(0)
    return influence_of(scores(stages, unknowns, values), whole)


# Covariances: the jackknife, a HAC sandwich, and least squares' own.
#
# With u_b the influence of block b on the estimates (see above), all estimate the
# variance of `sum_b u_b`.
#
# - The jackknife leaves each block out in turn. To first order theta moves by -u_b; to all orders
#   by `-(J - J_b)^-1 psi_b`, which is larger where b holds much of what tells of a parameter (its
#   leverage J^-1 J_b is not small). So it errs on the wide side where few blocks tell (Efron and
#   Stein, 1981), which the plain sum of u_b u_b^T does not.
# - The HAC sandwich, `J^-1 S J^-T` with `S = sum_k (1 - |k| / L) sum_t psi_t psi_(t+k)^T` over
#   short blocks t (Newey and West, 1987), needs no cut between blocks of L short ones each: it
#   averages over all places of the cut, and is positive semidefinite as a mean of squares is.
# - Least squares' own, sigma^2 (A^T A)^-1, takes rows for independent. Windows that overlap share
#   their errors, and a record holds about duration / beta independent ones, however many are
#   summed: this is too small by orders of magnitude. Beside the others it counts those.

LEVEL = 0.01
"""Level of the test of whether recordings disagree."""
TAIL = 0.025
"""Probability beyond either end of an interval, by which tails are compared."""


def jackknife_covariance(statistics: BlockStatistics) -> Float[Array, "p p"]:
    """Covariance from the estimates without each block in turn, all stages solved again.

    `sum_r (n_r - 1) / n_r sum_b d_b d_b^T` over the n_r blocks of record r, d_b the change of the
    estimate without block b.
    """
    used, whole = statistics.used, statistics.slope
    scale = unit_scale(xp.diagonal(whole))
    least = xp.finfo(scale.dtype).eps ** 0.5

    # Solved for the change itself: without the block, the scores at the estimate sum to minus its
    # own, and nothing is lost by subtracting two estimates that agree in most of their digits.
    block_scores, slopes = statistics.in_blocks()
    left = whole[None] - slopes
    matrices = left * (scale[:, None] * scale[None, :])[None]
    change, pivots = eliminate_with_pivots(matrices, -(block_scores * scale[None])[..., None])
    # Where only this block tells of a parameter, nothing is known without it.
    known = pivots.min(axis=-1, keepdims=True) > least
    moved = xp.where(known, change[..., 0] * scale[None], -statistics.estimate[None])
    most = most_used(used)
    factor = xp.repeat((used - 1) / used, most)
    place = np.tile(np.arange(most), used.shape[0])
    moved = xp.where((place < xp.repeat(used, most))[:, None], moved, 0.0)
    return (factor[:, None] * moved).T @ moved


def sandwich_covariance(statistics: BlockStatistics) -> Float[Array, "p p"]:
    """Slope^-1 S slope^-T, with S from scores whose autocorrelation counts.

    Newey and West's (1987) estimate with Bartlett's weights, which are the mean over all blocks of
    one length, overlapping ones included. That length is the blocks'.
    """
    lags = xp.round(statistics.length / statistics.short.seconds)
    total, n = 0, statistics.short_influence.shape[1]
    # sum_k (1 - |k| / lag) sum_t u[t] u[t + k]^T of each record. A sum over `lag` terms that ends
    # at t is c[t] - c[t - lag], c the running sum. Of its square, summed over all ends t (also
    # those where it reaches beyond the series), a product of two terms |k| apart is in lag - |k|
    # sums. So the weights come from one running sum, for any traced lag.
    for series, lag in zip(statistics.short_influence, xp.maximum(lags, 1).astype(np.int32)):
        running = xp.pad(xp.cumsum(series, axis=0), ((1, 0), (0, 0)))
        end = np.arange(1, 2 * n)
        begin = xp.clip(end - lag, 0, n)
        block = running[np.minimum(end, n)] - xp.take(running, begin, axis=0)
        block = xp.where((end < n + lag)[:, None], block, 0.0)
        total = total + block.T @ block / lag
    # Residuals sum to zero: as with any variance about a fitted mean, one of n squares is lost.
    blocks = xp.sum(statistics.used)
    return total * blocks / xp.maximum(blocks - 1, 1)


def naive_covariance(statistics: BlockStatistics) -> Float[Array, "p p"]:
    """sigma^2 (A^T A)^-1 of each stage, as if all rows were independent."""
    together, (left, _, count) = statistics.rows
    variance = left / xp.maximum(count - together.sum(0), 1)
    identity = np.eye(len(left), dtype=left.dtype)
    return variance[:, None] * solve_scaled(together * statistics.slope, identity)


def effective_freedom(statistics: BlockStatistics) -> Float[Array, " p"]:
    """Degrees of freedom of each parameter's variance, by Satterthwaite's rule.

    A variance that many blocks share has one for each block but one; a variance that a few rare
    blocks decide has few. With block variances s^2 estimated by squares u^2 of influence, of which
    u^4 / 3 estimates s^4, (sum s^2)^2 / sum s^4 is 3 (sum u^2)^2 / sum u^4; 1 at the least.
    """
    largest = xp.max(xp.abs(statistics.influence), axis=0)
    # Of unit size first: fourth powers of small influences would vanish.
    influence = statistics.influence / xp.where(largest > 0, largest, 1.0)[None, :]
    squares = xp.sum(influence**2, axis=0)
    fourths = xp.sum(influence**4, axis=0)
    most = xp.maximum(xp.sum(statistics.used) - 1, 1).astype(squares.dtype)
    ratio = 3 * squares**2 / xp.where(fourths > 0, fourths, 1.0) - 1
    return xp.where(fourths > 0, xp.clip(ratio, 1, most), most)


def record_inflation(
    influence: Float[Array, "records blocks p"], blocks_used: Float[Array, " records"]
) -> Float[Array, " p"]:
    """By how much standard errors must grow, for each parameter, because recordings disagree.

    If recordings differ only by chance, the sum of a record's influence has the variance of its
    blocks about their own mean, and the squares of the ratios follow chi-square (Cochran's test).
    Where that is refuted at the 1 % level, recordings and not blocks are the independent draws: the
    standard error then comes from the scatter between them, enlarged by Student's t for their small
    number. 1 otherwise, and for one record.

    **Arguments:** `influence` of each block of time on each estimate, zero in blocks that are not
    used; `blocks_used` of each record, 2 or more.
    """
    count = influence.shape[0]
    if count < 2:
        return xp.ones(influence.shape[-1], influence.dtype)
    used = blocks_used[:, None].astype(influence.dtype)
    moved = xp.sum(influence, axis=1)
    within = (xp.sum(influence**2, axis=1) - moved**2 / used) * used / (used - 1)
    some = within > 0
    ratio = xp.where(some, moved**2 / xp.where(some, within, 1.0), 0.0)
    disagree = xp.sum(ratio, axis=0) > tails.chi_square(LEVEL, count - 1)
    between = count / (count - 1) * xp.sum(moved**2, axis=0)
    pooled = xp.sum(influence**2, axis=(0, 1))
    known = pooled > 0
    student = float(tails.student(TAIL, count - 1)) / tails.normal(TAIL)
    factor = student * xp.sqrt(between / xp.where(known, pooled, 1.0))
    return xp.where(disagree & known, xp.maximum(factor, 1.0), 1.0)


# Bell and McCaffrey's sandwich for few blocks of time, with its degrees of freedom.
#
# Residuals are small where few stretches decide an estimate, since it follows their errors: blocks
# then scatter too little, whatever their number. The blocks' Gram matrices tell by how much, and
# how many degrees of freedom are left.
#
# Let s_b be the scores of block b at the truth, G_b its Gram matrix (in the slope's coordinates,
# see above), H = (sum G)^-1, and h^T the row of H that belongs to one parameter.
# Residuals at the estimate, which is H sum_c s_c away from the truth, give the block the influence
#
#     u_b = h^T (s_b - G_b H sum_c s_c).
#
# The variance is estimated by the quadratic form u^T B u, B = 1 on the diagonal and 1/2 between
# half blocks that follow one another: Newey and West's weights for a lag of two. Half blocks are
# taken since one cut between long blocks is as arbitrary as the next; half blocks with weight 1/2
# are the mean over the two cuts, and tell twice as many differences of so few blocks.
#
# Working model: errors alike all along, so that s_b has the covariance W_bb = sigma^2 G_b, and
# `OVERLAP` / 2 of the sum of both between neighbours. With r_b = W_b h and W_b, W the sums of W_bc
# over c, and over all, the influences then have the covariance
#
#     M_bc = h^T W_bc h - r_b^T q_c - q_b^T r_c + q_b^T W q_c,    q_b = H G_b h.
#
# So the form expects trace(B M), where it should expect h^T W h; the ratio, `seen`, is what it sees
# of the variance and is divided out. Its own variance, for Gaussian scores, is 2 trace(B M B M),
# that of a chi-square with `trace(B M)^2 / trace(B M B M)` degrees of freedom (Satterthwaite); they
# go to Student's t. Both are functions of the design alone. Errors that are not alike change what u
# is, and the form follows them; only the correction rests on the working model (Bell and McCaffrey,
# 2002; Imbens and Kolesar, 2016).

MOST_HALVES = 128
"""Half blocks of all records together: more, and nothing is few."""
OVERLAP = 0.15
"""Correlation of neighbouring half blocks' scores, as windows reach from one into the next: 0.19
for white errors, windows of any length up to half a block and a constant regressor, less for one
that moves."""
TOLD_BY_OTHERS = 1e-3
"""Weight of what all parameters' blocks say together, for one of which its own say nothing."""
TOLD_BY_NONE = 1e-6
"""Weight of the worst case, for where no parameter's blocks say anything."""


def few_blocks_sandwich(
    statistics: BlockStatistics,
) -> tuple[Float[Array, "p p"], Float[Array, " p"], Float[Array, " p"]]:
    """Covariance by Bell and McCaffrey's (2002) rule, degrees of freedom behind each variance, and
    the share of it that the scatter between blocks shows before it is corrected.

    A parameter that one stretch alone tells of has no scatter between blocks: its variance is the
    other parameters' ratio to the working model, and without any the case that a half block's rows
    all err alike.

    Long blocks are halved where short blocks are short enough.
    """
    short, used = statistics.short, statistics.used
    records = short.number.shape[0]
    most = max(MOST_HALVES // records, 2)
    halves = xp.minimum(2 * used, xp.minimum(short.number, most))
    scored, each = statistics.in_blocks(halves, most)
    most = most_used(halves, most)
    whole, scale = unit_diagonal(statistics.slope)
    inverse = eliminate(whole, np.eye(scale.shape[0], dtype=whole.dtype))
    each = each * (scale[:, None] * scale[None, :])[None]
    # Of one row's error, between parameters of one stage; zero between stages. Exact data leave no
    # more than rounding.
    together, (left, energy, count) = statistics.rows
    left = xp.maximum(left, xp.finfo(left.dtype).eps * energy)
    variance = together * (left / xp.maximum(count, 1))[:, None]
    largest = xp.max(variance)
    largest = xp.where(largest > 0, largest, 1.0)
    working = each * (variance / largest)[None]
    # 1 for two half blocks that follow one another in a record; 0 where they are long blocks.
    record, place = np.divmod(np.arange(most * records), most)
    follow = (record[:, None] == record) & (np.abs(place[:, None] - place) == 1)
    inside = (place < halves[record]) & (halves > used)[record]
    beside = xp.where(follow & inside[:, None] & inside[None, :], 1.0, 0.0)

    # Sums of the working covariance over one block's neighbours, and over both.
    near = OVERLAP / 2 * (xp.sum(beside, axis=1)[:, None, None] * working)
    near = working + near + OVERLAP / 2 * xp.tensordot(beside, working, axes=1)
    everywhere = xp.sum(near, axis=0)
    should = xp.einsum("ji,ik,jk->j", inverse, everywhere, inverse)
    # Of unit variance, or fourth powers would be lost in 32-bit.
    rows = inverse / xp.sqrt(should)[:, None]

    def expected(row: Float[Array, " p"]) -> tuple[Array, Array]:
        own = (working @ row) @ row
        both = near @ row
        follows = xp.einsum("i,bij->bj", row, each) @ inverse
        covariance = xp.diag(own) + OVERLAP / 2 * beside * (own[:, None] + own[None, :])
        shared = both @ follows.T
        covariance = covariance - shared - shared.T + follows @ everywhere @ follows.T
        form = covariance + beside @ covariance / 2
        return xp.trace(form), (form * form.T).sum()

    seen, scatter = xp.each(expected, rows, beside=(working, near))
    moved = (scored * scale[None, :]) @ rows.T
    shown = moved.T @ (moved + beside @ moved / 2)
    alike = largest * xp.max(count) / xp.sum(halves)
    together = xp.trace(shown) + TOLD_BY_NONE * alike
    together = together / (xp.sum(seen) + TOLD_BY_NONE)
    share = xp.sqrt(seen + TOLD_BY_OTHERS)
    covariance = (shown + TOLD_BY_OTHERS * together * np.eye(scale.shape[0])) / (
        share[:, None] * share[None, :]
    )
    size = scale * xp.sqrt(should)
    some = scatter > 0
    freedom = xp.where(some, seen**2 / xp.where(some, scatter, 1.0), 1.0)
    return covariance * size[:, None] * size[None, :], xp.maximum(freedom, 1.0), seen


# Bootstrap over blocks of time: whole procedures solved again from resampled normal equations.
#
# A replicate draws blocks with replacement: block b counts w_b times, and the staged fit is solved
# from `sum w_b M_b`, M_b a block's moments. Its estimate theta* is divided by its own standard
# error, `t* = (theta* - theta) / s*`, and the quantiles of t* make the interval `theta - t*_hi s,
# theta - t*_lo s`. To divide is worth it: t has about the same law whatever the errors' size is (a
# pivot), so that ends are right to O(1/n) of n blocks rather than O(n^-1/2) (Hall, 1988, of
# one-sided ones), and lean where estimates are skewed. Blocks rather than rows are drawn since
# errors are correlated within a block (Kunsch, 1989). A replicate costs a weighted sum of a few
# dozen small matrices and an elimination; no row is seen again.

AT_ONCE = 250
"""Replicates worked on together: they share vector instructions, and memory stays small."""


def studentized_replicates(
    statistics: BlockStatistics, draws: Float[Array, "replicates records blocks_of_record"]
) -> Float[Array, "replicates p"]:
    """(estimate - value) / standard error of each replicate, for all parameters of all stages.

    A replicate draws as many blocks as a record has, with replacement, from each record. Its
    standard error is the sandwich of its own blocks, about the mean of each record: records are
    not drawn, so what differs between them does not move a replicate. NaN where a replicate leaves
    a parameter undetermined.

    **Arguments:** `draws`, see [`uniform_draws`][].
    """
    used, found = statistics.used, statistics.estimate
    block_scores, slopes = statistics.in_blocks()
    identity = np.eye(len(found), dtype=found.dtype)

    def replicates(
        drawn: Float[Array, "some records blocks_of_record"],
    ) -> Float[Array, "some p"]:
        count = drawn_counts(drawn, used).astype(found.dtype)
        weights = count.reshape(count.shape[0], -1)
        # Elimination with every block's score on the right would take half as long again.
        inverse = solve_scaled(xp.tensordot(weights, slopes, 1), identity)
        # Scores are linear in theta: by how much it moves, and what they are from there.
        moved = (inverse @ (weights @ block_scores)[..., None])[..., 0]
        score = block_scores[None] - xp.tensordot(moved, slopes, axes=(1, 2))
        score = (score @ xp.swapaxes(inverse, -1, -2)).reshape(*count.shape, -1)
        total = xp.einsum("krb,krbp->krp", count, score)
        squares = xp.einsum("krb,krbp->krp", count, score**2)
        mean = total**2 / count.sum(axis=-1)[..., None]
        error = xp.sqrt(xp.maximum(squares - mean, 0.0).sum(axis=1))
        usable = (error > 0) & xp.isfinite(error) & xp.isfinite(moved)
        return xp.where(usable, moved / xp.where(usable, error, 1.0), np.nan)

    # So many of them as divide all.
    some = next(size for size in range(AT_ONCE, 0, -1) if len(draws) % size == 0)
    grouped = draws.reshape(-1, some, *draws.shape[1:])
    found_each = xp.each(replicates, grouped, beside=(found, block_scores))
    return found_each.reshape(len(draws), -1)


@functools.lru_cache(maxsize=4)
def uniform_draws(seed: int, replicates: int, records: int) -> np.ndarray:
    """Numbers from 0 to 1, one for each block that each replicate draws of each record.

    NumPy's: the same for every fit, so nothing is gained by compiling how they are made.
    """
    shape = (replicates, records, MOST_BLOCKS)
    return np.random.default_rng(seed).random(shape, np.float32)


def drawn_counts(
    drawn: Float[Array, "some records blocks_of_record"], used: Int[Array, " records"]
) -> Int[Array, "some records blocks_of_record"]:
    """How often each block is drawn, with as many draws from each record as it has blocks."""
    # In double precision one product may round to another block than in single.
    number, most = used[None, :, None], most_used(used)
    drawn, place = drawn[..., :most], np.arange(most)[None, None]
    block = xp.minimum((drawn * number.astype(drawn.dtype)).astype(np.int32), number - 1)
    row = np.arange(block[..., 0].size).reshape(*block.shape[:-1], 1)
    # Draws that no block is left for count nowhere.
    every = xp.where(place < number, row * most + block, block.size).ravel()
    return xp.sum_by_block(np.ones(every.size, np.int32), every, block.size).reshape(block.shape)

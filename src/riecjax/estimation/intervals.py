"""How uncertain estimates are: a block bootstrap, a sandwich, or least squares' own covariance.

All speak of scatter about the value that the criterion converges to on an ever longer record, not
of that value's distance from the truth.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from riecjax import tails
from riecjax.errors import ModelError
from riecjax.estimation.blocks import MOST_BLOCKS, ShortBlocks
from riecjax.estimation.bootstrap import studentized_replicates, uniform_draws
from riecjax.estimation.elimination import eliminate_with_pivots, solve_scaled, unit_scale
from riecjax.estimation.few_blocks import few_blocks_sandwich
from riecjax.estimation.influence import Unknowns, in_order, scores, slope
from riecjax.estimation.normal_equations import NormalEquations

FEW = 12
"""Blocks of all records up to which the bootstrap's tails do not serve."""
ENOUGH_FREEDOM = 10.0
"""Degrees of freedom of a variance from which they do."""
FARTHEST = 10.0
"""How many times as far as the small-sample sandwich the bootstrap may reach: rare large errors
lean an interval several times as far to one side, and hardly more."""
NEAREST = 1 / 3
"""The same where it reaches less far."""
SMALL_SAMPLE = "small-sample sandwich with Student's t"


class Evidence(NamedTuple):
    """What uncertainty is judged from.

    **Fields:**

    - `stages`: normal equations of each stage in blocks, `MOST_BLOCKS` of each record.
    - `plan`, `known`, `values`: what each stage finds, what is given, and everything by name.
    - `used`: how many of each record's blocks hold rows.
    - `influence`: of each of these blocks on each estimate, shape `(records * MOST_BLOCKS, p)`.
    - `fine_influence`: the same for the short blocks, shape `(records, short blocks, p)`.
    - `short`, `length`: the short blocks, and the seconds that a long one lasts.
    - `fine`: normal equations of each stage in short blocks, leading axes
      `(records, short blocks)`.
    """

    stages: list[NormalEquations]
    plan: Unknowns
    known: dict[str, Array]
    values: dict[str, Array]
    used: Int[Array, " records"]
    influence: Float[Array, "blocks p"]
    fine_influence: Float[Array, "records short p"]
    short: ShortBlocks
    length: Float[Array, ""]
    fine: list[NormalEquations]


class Uncertainty(eqx.Module):
    """Uncertainty of all parameters of all stages.

    **Fields:**

    - `covariance`: shape `(p, p)`.
    - `studentized`: replicates of (estimate - value) / standard error, whose quantiles make
      intervals; `None` where Student's t does. NaN in replicates that leave a parameter
      undetermined.
    - `degrees_of_freedom` behind each variance, see [`effective_freedom`][].
    - `few_blocks`: parameters that so few blocks tell of that the small-sample sandwich and
      Student's t stand in, see [`with_few_blocks`][].
    - `times_sandwich`: how many times as far as that sandwich replicates reach, 1 without any.
    - `method`: how it was judged otherwise, in words.
    """

    covariance: Float[Array, "p p"]
    studentized: Float[Array, "replicates p"] | None
    degrees_of_freedom: Float[Array, " p"]
    few_blocks: Bool[Array, " p"]
    times_sandwich: Float[Array, " p"]
    method: str = eqx.field(static=True)

    @property
    def label(self) -> str:
        """How it was judged, in words (not under jit)."""
        few = np.asarray(self.few_blocks)
        if few.all():
            return SMALL_SAMPLE
        return f"{self.method}; {SMALL_SAMPLE} of few blocks" if few.any() else self.method

    def grown(self, inflation: Float[Array, " p"]) -> "Uncertainty":
        """With standard errors multiplied."""
        covariance = self.covariance * inflation[:, None] * inflation[None, :]
        return eqx.tree_at(lambda u: u.covariance, self, covariance)

    def reach(self, level: float) -> tuple[np.ndarray, np.ndarray]:
        """How many standard errors intervals reach below and above estimates (not under jit).

        Quantiles of the studentized replicates, widened as Student's t is wider than the normal
        law for so few degrees of freedom: replicates of few blocks know too little of the tails.

        **Returns:** two arrays of shape `(..., p)`, with the leading axes of a batch.
        """
        tail = (1 - level) / 2
        dof = np.maximum(np.asarray(self.degrees_of_freedom), 1)
        student = tails.student(tail, dof)
        if self.studentized is None:
            return student, student
        replicates = np.asarray(self.studentized)
        # Data that fit to the last digit scatter by nothing that a replicate could be divided by.
        plain = np.asarray(~np.isfinite(replicates).any(axis=-2)) | np.asarray(self.few_blocks)
        replicates = np.where(plain[..., None, :], 0.0, replicates)
        low, high = np.nanquantile(replicates, [tail, 1 - tail], axis=-2)
        wider = student / tails.normal(tail)
        return np.where(plain, student, high * wider), np.where(plain, student, -low * wider)


class AbstractIntervals(eqx.Module):
    """A way to judge uncertainty."""

    def uncertainty(self, evidence: Evidence) -> Uncertainty:
        """The uncertainty of the estimates behind this evidence."""
        raise NotImplementedError


class BlockBootstrap(AbstractIntervals):
    """Studentized bootstrap over blocks of time (the default).

    Blocks are drawn with replacement within each record, and the whole procedure is solved again:
    only p x p matrices are added up. Each replicate is divided by its own standard error, which
    lets the intervals lean to the side that a skewed estimate calls for. Standard errors are the
    jackknife's: each block is left out once, and everything solved again.

    **Arguments:** `replicates`; `seed` of the draw, which moves the ends of an interval by a
    percent or two of its width.

    **Raises:** `ModelError` for fewer than 100 replicates.

    References: Efron and Tibshirani (1993), An Introduction to the Bootstrap, ch. 12; Kunsch
    (1989), The jackknife and the bootstrap for general stationary observations.
    """

    replicates: int = eqx.field(static=True, default=2000)
    seed: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        if self.replicates < 100:
            raise ModelError(
                f"an interval needs at least 100 bootstrap replicates; got {self.replicates}."
            )

    def uncertainty(self, evidence: Evidence) -> Uncertainty:
        """Jackknife covariance, and studentized replicates."""
        return with_few_blocks(
            evidence,
            jackknife_covariance(evidence),
            self.studentized(evidence),
            f"studentized block bootstrap, {self.replicates} replicates",
        )

    def studentized(self, evidence: Evidence) -> Float[Array, "replicates p"]:
        """The replicates, see [`studentized_replicates`][]."""
        records = evidence.used.shape[0]
        return studentized_replicates(
            evidence.stages,
            evidence.plan,
            evidence.known,
            evidence.values,
            evidence.used,
            draws=jnp.asarray(uniform_draws(self.seed, self.replicates, records)),
        )


class Sandwich(AbstractIntervals):
    """Sandwich covariance with autocorrelated scores (HAC), and Student's t: without resampling."""

    def uncertainty(self, evidence: Evidence) -> Uncertainty:
        """The sandwich."""
        return with_few_blocks(evidence, sandwich_covariance(evidence), None, "HAC sandwich")


class Naive(AbstractIntervals):
    """Least squares' own covariance, as if every window were independent of all others.

    Far too narrow, since windows overlap: for comparison only.
    """

    def uncertainty(self, evidence: Evidence) -> Uncertainty:
        """sigma^2 (A^T A)^-1 of each stage, earlier stages taken as exact."""
        count = len(in_order(evidence.plan, evidence.values))
        return Uncertainty(
            naive_covariance(evidence),
            None,
            jnp.full(count, 1e9),
            jnp.zeros(count, bool),
            jnp.ones(count),
            "least squares as if all windows were independent (far too narrow)",
        )


def with_few_blocks(
    evidence: Evidence,
    covariance: Float[Array, "p p"],
    studentized: Float[Array, "replicates p"] | None,
    method: str,
) -> Uncertainty:
    """What a method says, with the small-sample sandwich in its place where blocks are few.

    They are few if there are no more than `FEW`; for a parameter whose variance has fewer than
    `ENOUGH_FREEDOM` degrees of freedom, told in few places; and where replicates' tails reach
    more than `FARTHEST` times as far as the sandwich or less than `NEAREST`: then some were divided
    by a standard error of next to nothing, or hardly any moved.
    """
    small = few_blocks_sandwich(
        evidence.fine, evidence.plan, evidence.values, evidence.short, evidence.used
    )
    few = ~(small.degrees_of_freedom >= ENOUGH_FREEDOM) | (jnp.sum(evidence.used) <= FEW)
    variance, other = jnp.diagonal(covariance), jnp.diagonal(small.covariance)
    times = jnp.ones_like(variance)
    if studentized is not None:
        reach = jnp.nanquantile(jnp.abs(studentized), 0.95, axis=0) / tails.normal(0.025)
        times = reach * jnp.sqrt(variance / jnp.where(other > 0, other, 1.0))
        few = few | (times > FARTHEST) | (times < NEAREST)
    error = jnp.sqrt(jnp.where(few, other, variance))
    scale = jnp.where(other > 0, error / jnp.sqrt(jnp.where(other > 0, other, 1.0)), 0.0)
    mixed = small.covariance * scale[:, None] * scale[None, :]
    return Uncertainty(
        jnp.where(jnp.any(few), mixed, covariance),
        studentized,
        jnp.where(few, small.degrees_of_freedom, effective_freedom(evidence)),
        few,
        times,
        method,
    )


def jackknife_covariance(evidence: Evidence) -> Float[Array, "p p"]:
    """Covariance from the estimates without each block in turn, all stages solved again.

    Solved for the change itself: without the block, the scores at the estimate sum to minus its
    own, and nothing is lost by subtracting two estimates that agree in most of their digits.
    """
    totals = [stage.total() for stage in evidence.stages]
    found = in_order(evidence.plan, evidence.values)
    scale = unit_scale(jnp.diagonal(slope(totals, evidence.plan)))
    least = 1e4 * jnp.finfo(scale.dtype).eps

    def without(blocks: list[NormalEquations], score: Float[Array, " p"]) -> Float[Array, " p"]:
        left = [
            NormalEquations(t.moments - b.moments, t.count - b.count, t.parameters)
            for t, b in zip(totals, blocks)
        ]
        matrix = slope(left, evidence.plan) * scale[:, None] * scale[None, :]
        change, pivots = eliminate_with_pivots(matrix, (-score * scale)[:, None])
        # Where only this block tells of a parameter, nothing is known without it.
        return jnp.where(jnp.min(pivots) > least, change[:, 0] * scale, -found)

    block_scores = scores(evidence.stages, evidence.plan, evidence.values)
    moved = jax.vmap(without)(evidence.stages, block_scores)
    factor = jnp.repeat((evidence.used - 1) / evidence.used, MOST_BLOCKS)
    held = jnp.tile(jnp.arange(MOST_BLOCKS), evidence.used.shape[0])
    inside = held < jnp.repeat(evidence.used, MOST_BLOCKS)
    moved = jnp.where(inside[:, None], moved, 0.0)
    return (factor[:, None] * moved).T @ moved


def sandwich_covariance(evidence: Evidence) -> Float[Array, "p p"]:
    """Slope^-1 S slope^-T, with S from scores whose autocorrelation counts.

    Newey and West's (1987) estimate with Bartlett's weights, which are the mean over all blocks of
    one length, overlapping ones included. That length is the blocks'.
    """
    series = evidence.fine_influence
    lag = jnp.maximum(jnp.round(evidence.length / evidence.short.seconds), 1).astype(jnp.int32)
    total = jnp.sum(jax.vmap(_overlapping_blocks)(series, lag), axis=0)
    blocks = jnp.sum(evidence.used)
    return total * blocks / jnp.maximum(blocks - 1, 1)


def _overlapping_blocks(
    series: Float[Array, "short p"], lag: Int[Array, ""]
) -> Float[Array, "p p"]:
    """Sum over k of (1 - |k| / lag) sum_t series[t] series[t + k]^T."""
    n = series.shape[0]
    running = jnp.pad(jnp.cumsum(series, axis=0), ((1, 0), (0, 0)))
    end = jnp.arange(1, 2 * n)
    block = running[jnp.minimum(end, n)] - running[jnp.clip(end - lag, 0, n)]
    block = jnp.where((end < n + lag)[:, None], block, 0.0)
    return block.T @ block / lag


def naive_covariance(evidence: Evidence) -> Float[Array, "p p"]:
    """sigma^2 (A^T A)^-1 of each stage, as if all rows were independent."""
    parts = []
    for i, names in evidence.plan:
        total = evidence.stages[i].total()
        others = {n: evidence.values[n] for n in total.parameters if n not in names}
        equations = total.fix(others)
        theta = jnp.stack([evidence.values[name] for name in names])
        freedom = jnp.maximum(equations.count - len(names), 1)
        variance = equations.residual_energy(theta) / freedom
        identity = jnp.eye(len(names), dtype=variance.dtype)
        parts.append(variance * solve_scaled(equations.gram, identity))
    return jax.scipy.linalg.block_diag(*parts)


def effective_freedom(evidence: Evidence) -> Float[Array, " p"]:
    """Degrees of freedom of each parameter's variance, by Satterthwaite's rule.

    A variance that many blocks share has one for each block but one; a variance that hangs on a
    few rare ones has few. With block variances s^2 estimated by squares u^2 of influence, of which
    u^4 / 3 estimates s^4, (sum s^2)^2 / sum s^4 is 3 (sum u^2)^2 / sum u^4; 1 at the least.
    """
    largest = jnp.max(jnp.abs(evidence.influence), axis=0)
    # Of unit size first: fourth powers of small influences would vanish.
    influence = evidence.influence / jnp.where(largest > 0, largest, 1.0)[None, :]
    squares = jnp.sum(influence**2, axis=0)
    fourths = jnp.sum(influence**4, axis=0)
    most = jnp.maximum(jnp.sum(evidence.used) - 1, 1).astype(squares.dtype)
    ratio = 3 * squares**2 / jnp.where(fourths > 0, fourths, 1.0) - 1
    return jnp.where(fourths > 0, jnp.clip(ratio, 1, most), most)

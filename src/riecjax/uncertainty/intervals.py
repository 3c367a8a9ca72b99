"""How uncertain estimates are: a block bootstrap, a sandwich, or least squares' own covariance.

All speak of scatter about the value that the criterion converges to on an ever longer record, not
of that value's distance from the truth.
"""

import dataclasses
from abc import abstractmethod
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from riecjax import arrays as xp
from riecjax import tails
from riecjax.arrays import Array
from riecjax.errors import ModelError, require
from riecjax.leaves import is_number
from riecjax.summaries.normal_equations import NormalEquations, ShortBlocks
from riecjax.uncertainty.covariances import (
    TAIL,
    BlockStatistics,
    block_statistics,
    effective_freedom,
    few_blocks_sandwich,
    jackknife_covariance,
    naive_covariance,
    record_inflation,
    sandwich_covariance,
    studentized_replicates,
    uniform_draws,
)

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


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of all parameters of all stages.

    **Fields:**

    - `covariance`: shape `(p, p)`.
    - `studentized`: replicates of (estimate - value) / standard error, whose quantiles make
      intervals; `None` where Student's t does. NaN in replicates that leave a parameter
      undetermined.
    - `degrees_of_freedom` behind each variance, see [`effective_freedom`][].
    - `few_blocks`: parameters that so few blocks tell of that the small-sample sandwich and
      Student's t stand in, see [`with_few_blocks`][].
    - `method` of all other parameters, in words.
    - `prior_share`: share of what is known of each that its prior tells; `None` without any.
    """

    covariance: Float[Array, "p p"]
    studentized: Float[Array, "replicates p"] | None
    degrees_of_freedom: Float[Array, " p"]
    few_blocks: Bool[Array, " p"]
    method: str = dataclasses.field(metadata={"static": True})
    prior_share: Float[Array, " p"] | None = None

    @property
    def label(self) -> str:
        """The method, in words (not under jit)."""
        few = np.asarray(self.few_blocks)
        if few.all():
            return SMALL_SAMPLE
        return f"{self.method}; {SMALL_SAMPLE} of few blocks" if few.any() else self.method

    def widened(self, further: Float[Array, "p p"]) -> "Uncertainty":
        """With the covariance of something else that scatters besides."""
        return dataclasses.replace(self, covariance=self.covariance + further)

    def with_priors(
        self, scatter: Float[Array, "p p"], prior_share: Float[Array, " p"]
    ) -> "Uncertainty":
        """With the covariance of what the means of priors scatter by, which is normal.

        So is a replicate's share of it. Degrees of freedom are Satterthwaite's, of a sum of
        variances of which one is known.
        """
        every = self.widened(scatter)
        total, known = xp.diagonal(every.covariance), xp.diagonal(scatter)
        share = xp.where(total > 0, known / xp.where(total > 0, total, 1.0), 0.0)
        # Less than this is rounding: data tell nothing, and no replicate moves.
        least = float(xp.finfo(total.dtype).eps) ** 0.5
        of_data = xp.maximum(1 - share, least)
        studentized = self.studentized
        if studentized is not None:
            count = studentized.shape[0]
            normal = -tails.normal((np.arange(count) + 0.5) / count)[:, None]
            moved = xp.where((of_data > least)[None, :], studentized, 0.0)
            studentized = xp.sqrt(1 - share)[None, :] * moved + normal * xp.sqrt(share)[None, :]
        return dataclasses.replace(
            every,
            studentized=studentized,
            degrees_of_freedom=self.degrees_of_freedom / of_data**2,
            prior_share=prior_share,
        )

    def reach(self, level: float) -> tuple[np.ndarray, np.ndarray]:
        """How many standard errors intervals reach below and above estimates (not under jit).

        Quantiles of the studentized replicates, widened as Student's t is wider than the normal
        law for so few degrees of freedom: replicates of few blocks know too little of the tails.

        **Returns:** two arrays of shape `(..., p)`, with the leading axes of a batch.

        **Raises:** `ModelError` for a level that is not between 0 and 1.
        """
        if not (is_number(level) and 0 < level < 1):
            raise ModelError(f"a confidence level is a share between 0 and 1, 0.95; got {level!r}.")
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
    """How covariance and intervals are made of block statistics."""

    @abstractmethod
    def uncertainty(self, statistics: BlockStatistics) -> Uncertainty:
        """Covariance of the estimates, and what intervals need besides."""


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

    def uncertainty(self, statistics: BlockStatistics) -> Uncertainty:
        """Jackknife covariance, and studentized replicates."""
        draws = uniform_draws(self.seed, self.replicates, statistics.used.shape[0])
        return with_few_blocks(
            statistics,
            jackknife_covariance(statistics),
            studentized_replicates(statistics, draws),
            f"studentized block bootstrap, {self.replicates} replicates",
        )


class Sandwich(AbstractIntervals):
    """Sandwich covariance with autocorrelated scores (HAC), and Student's t: without resampling."""

    def uncertainty(self, statistics: BlockStatistics) -> Uncertainty:
        """The sandwich."""
        return with_few_blocks(statistics, sandwich_covariance(statistics), None, "HAC sandwich")


class Naive(AbstractIntervals):
    """Least squares' own covariance, as if every window were independent of all others.

    Far too narrow, since windows overlap: for comparison only.
    """

    def uncertainty(self, statistics: BlockStatistics) -> Uncertainty:
        """sigma^2 (A^T A)^-1 of each stage, earlier stages taken as exact."""
        count = len(statistics.estimate)
        return Uncertainty(
            naive_covariance(statistics),
            None,
            np.full(count, np.inf),
            np.zeros(count, bool),
            "least squares as if all windows were independent (far too narrow)",
        )


def intervals_of(said: AbstractIntervals | str | None, seed: int = 0) -> AbstractIntervals:
    """The intervals that settings ask for; by default a [`BlockBootstrap`][riecjax.BlockBootstrap].

    **Raises:** `ModelError` for what is none.
    """
    if isinstance(said, str | None):
        others = {"sandwich": Sandwich, "naive": Naive}
        return BlockBootstrap(seed=seed) if said in (None, "bootstrap") else others[said]()
    require("intervals", said, AbstractIntervals, "intervals=rx.BlockBootstrap()")
    return said


def with_few_blocks(
    statistics: BlockStatistics,
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
    # The bootstrap's tails come from t* of n blocks, its standard error among them. Of a dozen
    # blocks a replicate draws on average eight different ones, and now and then so few that its own
    # standard error is next to nothing: t* then has tails that no number of replicates mends.
    # Bell and McCaffrey's variance and degrees of freedom hold for few blocks, under a working
    # model; so it stands in where blocks are few, and beside it shows where the bootstrap went off.
    small, freedom, _ = few_blocks_sandwich(statistics)
    few = ~(freedom >= ENOUGH_FREEDOM) | (xp.sum(statistics.used) <= FEW)
    variance, other = xp.diagonal(covariance), xp.diagonal(small)
    if studentized is not None:
        sizes = xp.abs(studentized)
        some = xp.any(xp.isfinite(sizes), axis=0)
        reach = xp.nanquantile(xp.where(some[None, :], sizes, 0.0), 1 - 2 * TAIL, axis=0)
        reach = xp.where(some, reach, np.nan) / tails.normal(TAIL)
        times = reach * xp.sqrt(variance / xp.where(other > 0, other, 1.0))
        few = few | (times > FARTHEST) | (times < NEAREST)
    # Of what only a bound or a prior tells, no block moves anything.
    few = few & (variance > xp.finfo(variance.dtype).eps * other)
    # Correlations are taken from one of the two, lest a mixture be no covariance at all.
    error = xp.sqrt(xp.where(few, other, variance))
    scale = xp.where(other > 0, error / xp.sqrt(xp.where(other > 0, other, 1.0)), 0.0)
    mixed = small * scale[:, None] * scale[None, :]
    return Uncertainty(
        xp.where(xp.any(few), mixed, covariance),
        studentized,
        xp.where(few, freedom, effective_freedom(statistics)),
        few,
        method,
    )


def estimate_uncertainty(
    stages: Sequence[NormalEquations],
    known: Mapping[str, Array],
    values: Mapping[str, Array],
    short: ShortBlocks,
    shared: Bool[np.ndarray, " p"],
    intervals: AbstractIntervals,
) -> tuple[Uncertainty, Float[Array, " p"], BlockStatistics]:
    """Uncertainty of the solution `values` of all stages.

    **Arguments:** `stages`, normal equations with leading axes `(records, short blocks)`;
    `shared`, which of the parameters found hold for all records: others cannot disagree.

    **Returns:** the uncertainty, inflated where records disagree; by which factor on standard
    errors; and the block statistics that it rests on.
    """
    statistics = block_statistics(stages, known, values, short)
    per_record = statistics.influence.reshape(short.number.shape[0], -1, len(statistics.estimate))
    inflation = xp.where(shared, record_inflation(per_record, statistics.used), 1.0)
    uncertainty = intervals.uncertainty(statistics)
    covariance = uncertainty.covariance * inflation[:, None] * inflation[None, :]
    return dataclasses.replace(uncertainty, covariance=covariance), inflation, statistics

"""How uncertain estimates are: a block bootstrap, a sandwich, or least squares' own covariance.

All speak of scatter about the value that the criterion converges to on an ever longer record, not
of that value's distance from the truth.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax import tails
from riecjax.errors import ModelError
from riecjax.summaries.blocks import (
    MOST_BLOCKS,
    ShortBlocks,
    blocks_in_use,
    merge_blocks,
    sum_blocks,
)
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.uncertainty.block_length import block_length, politis_white
from riecjax.uncertainty.block_statistics import Evidence, record_inflation
from riecjax.uncertainty.bootstrap import studentized_replicates, uniform_draws
from riecjax.uncertainty.covariances import (
    effective_freedom,
    jackknife_covariance,
    naive_covariance,
    sandwich_covariance,
)
from riecjax.uncertainty.few_blocks import few_blocks_sandwich
from riecjax.uncertainty.scores import block_influence, in_order, unknowns

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


class Judged(NamedTuple):
    """Uncertainty, grown by `inflation` where records disagree, and the evidence behind it."""

    uncertainty: Uncertainty
    inflation: Float[Array, " p"]
    evidence: Evidence


def judge(
    stages: Sequence[NormalEquations],
    known: Mapping[str, Array],
    values: Mapping[str, Array],
    short: ShortBlocks,
    longest_window: Float[Array, ""],
    shared: Bool[np.ndarray, " p"],
    intervals: AbstractIntervals,
) -> Judged:
    """Uncertainty of the solution `values` of all stages.

    **Arguments:** `stages`, normal equations with leading axes `(records, short blocks)`;
    `shared`, which of the parameters found hold for all records: others cannot disagree.
    """
    flat = [stage.flattened() for stage in stages]
    fine = block_influence(flat, known, values)
    fine = fine.reshape(short.number.shape[0], -1, fine.shape[-1])
    length = block_length(short, longest_window, politis_white(fine, short))
    used = blocks_in_use(short, length)
    blocks = [merge_blocks(stage, short, used) for stage in stages]
    influence = sum_blocks(fine, short, used)
    evidence = Evidence(
        blocks,
        unknowns(blocks, known),
        dict(known),
        dict(values),
        used,
        influence,
        fine,
        short,
        length,
        list(stages),
    )
    per_record = influence.reshape(short.number.shape[0], MOST_BLOCKS, -1)
    inflation = jnp.where(shared, record_inflation(per_record, used), 1.0)
    return Judged(intervals.uncertainty(evidence).grown(inflation), inflation, evidence)

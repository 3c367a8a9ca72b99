"""What an identification found, and how far it can be trusted."""

from collections.abc import Iterator, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.hidden_elements import is_stiffness_name
from riecjax.estimation.estimated_parameters import AbstractEstimate
from riecjax.estimation.stages import EquationFit, StageSolution
from riecjax.findings import Finding
from riecjax.leaves import Leaf, namespace
from riecjax.linear_algebra import gram_condition_limit
from riecjax.summaries.summary import Summary
from riecjax.uncertainty.intervals import Uncertainty

TOLD_LAG = 8
"""Standard errors from which on a lag is told from none, and its inverse has an interval.

Of c / (1 + tau s) v = c v - c tau v' + c tau^2 v'' - ... a mass beside the damper takes up the
second term, so that tau^2 is what is told of. Its error is 2 tau times tau's: 8 of these are 4 of
its own.
"""
FEWEST_BLOCKS = 7
"""Blocks of time below which intervals are rough; ten stretches of twice the longest window may
come out as no more."""
FEWEST_WINDOWS = 10
"""Independent windows below which an interval is rough."""
ROUNDING = {np.dtype(np.float64): 1e-9, np.dtype(np.float32): 1e-6}
"""Share of rows that may be missing only because their number was rounded, by precision."""
MATTERING_SHARE = 0.02
"""Share of the target that an uncertain term must reach to be worth a warning."""
LARGE_RESIDUAL = 0.5
"""Share of the target past which a model is called wrong."""
NOTABLE_SHRINKAGE = 0.01
"""Share by which an equation without a known term may shrink its coefficients; less is notable too
if it is more than a standard error."""
LEAST_SHRINKAGE = 0.001
"""Share of shrinkage that is never notable."""


class Estimate(AbstractEstimate):
    """Parameters with units and uncertainty, and how they were obtained.

    A pytree: `theta` and `covariance` differentiate and vmap. Reading values one by one works as
    with a mapping: `estimate["M_s"]`. Under `jax.vmap` it becomes a batch, whose axes come first:
    `estimate["M_s"]` then has the batch's shape, printing shows the distribution over the batch,
    and `estimate.member(3)` is one of its estimates.

    **Fields:**

    - `theta`: estimated values, in the order of `parameters`.
    - `uncertainty`: covariance of theta and what makes intervals, valid under overlapping windows
      and autocorrelated equation errors (see [`BlockBootstrap`][]). It speaks of scatter about the
      value that the criterion converges to, not of that value's distance from the truth.
    - `naive`: least squares' own standard errors, as if all windows were independent: far too
      small, and kept to tell the effective number of windows.
    - `inflation`: factor on each standard error because recordings disagree, 1 where they agree.
    - `stages`: solution, conditioning and residual of each stage.
    - `known`: parameters that were not estimated, with their values.
    - `criterion`: what was made small.
    - `block_count`, `block_length`: independent blocks of time behind the covariance, and their
      length in seconds (rule: `block_length` in `uncertainty.block_length`).
    - `stage_names`, `equation_names`: of each stage, and of each equation in it.
    - `rows_offered`: for each stage, how many rows there would be without gaps and masks; NaN
      where that is not known.
    - `doubts`: findings of the recordings that it was identified from, such as a wrong unit.
    - `summary`: the sums behind it, from which others can be estimated; `None` under `jax.jit` and
      `jax.vmap`, where each member of a batch would carry its own.
    """

    theta: Float[Array, "*batch p"]
    uncertainty: Uncertainty
    naive: Float[Array, "*batch p"]
    inflation: Float[Array, "*batch p"]
    stages: tuple[StageSolution, ...]
    known: dict[str, Array]
    criterion: AbstractCriterion
    block_count: Int[Array, "*batch"]
    block_length: Float[Array, "*batch"]
    rows_offered: Float[Leaf, "*batch stages"]
    summary: Summary | None
    parameters: tuple[str, ...] = eqx.field(static=True)
    units: tuple[tuple[str, str], ...] = eqx.field(static=True)
    stage_names: tuple[str, ...] = eqx.field(static=True)
    equation_names: tuple[tuple[str, ...], ...] = eqx.field(static=True)
    doubts: tuple[Finding, ...] = eqx.field(static=True, default=())

    @property
    def equations(self) -> dict[str, EquationFit]:
        """What is left of each equation, by name: a stage of several may hide that one fails."""
        return {
            name: fit
            for names, stage in zip(self.equation_names, self.stages)
            for name, fit in zip(names, stage.equations)
        }

    @property
    def effective_windows(self) -> Float[Array, "*batch p"]:
        """How many independent windows would tell each parameter as well as all of them do.

        Least squares' own variance holds if all n rows are independent, and goes with 1 / n: of m
        independent ones it would be n / m times as large. Setting that equal to the actual variance
        gives m = n naive^2 / error^2.
        """
        xp = namespace(self.naive)
        counts = [stage.count[..., None] for stage in self.stages for _ in stage.parameters]
        rows = xp.concatenate(counts, axis=-1)
        variance = self.standard_errors**2
        ratio = xp.square(self.naive) / xp.where(variance > 0, variance, 1.0)
        return xp.where(variance > 0, rows * ratio, rows)

    @property
    def condition_number(self) -> Float[Array, "*batch"]:
        """The largest among the stages, of the regressors with columns scaled to unit length."""
        xp = namespace(self.theta)
        return xp.max(xp.stack([stage.solution.condition_number for stage in self.stages]), axis=0)

    @property
    def rank(self) -> Int[Array, "*batch"]:
        """Sum of the stages' ranks; the number of parameters when all can be told apart."""
        xp = namespace(self.theta)
        return xp.sum(xp.stack([stage.solution.rank for stage in self.stages]), axis=0)

    @property
    def determined(self) -> Bool[Array, "*batch"]:
        """Whether theta is finite and every stage tells its parameters apart: an answer at all."""
        finite = namespace(self.theta).isfinite(self.theta).all(axis=-1)
        return finite & (self.rank == len(self.parameters))

    def _findings(self) -> list[Finding]:
        if lost := list(self._without_answer()):
            return [*self.doubts, *lost, *self._coverage(), *self._precision()]
        return [
            *self.doubts,
            *self._conditioning(),
            *self.few_blocks(),
            *self.leaning(),
            *self._wide_intervals(),
            *self._lags(),
            *self.negative_values(),
            *self._residuals(),
            *self._shrinking(),
            *self.disagreement(),
            *self._coverage(),
            *self._few_windows(),
            *self._snapped(),
            *self.rarely_excited(),
            *self._precision(),
        ]

    def _without_answer(self) -> Iterator[Finding]:
        """What `identify` refuses where it can look at values; of a batch it is found here."""
        for label, stage in zip(self.stage_names, self.stages):
            solution = stage.solution
            if not stage.parameters:
                continue
            if not np.all(np.isfinite(solution.theta)):
                which = "its terms or known values are not finite numbers"
            elif float(stage.count) == 0:
                which = "no rows: every window touches a missing or masked sample"
            elif int(solution.rank) < len(stage.parameters):
                weakest = combination(stage.parameters, np.asarray(solution.weakest_direction))
                which = f"the record cannot tell these apart: {weakest}"
            else:
                continue
            yield Finding(
                "unidentifiable",
                f"{label}: {which}. There is no answer: what stands for "
                f"{', '.join(stage.parameters)} means nothing.",
                parameters=stage.parameters,
            )

    def _conditioning(self) -> Iterator[Finding]:
        if float(self.condition_number) > gram_condition_limit(self.theta.dtype):
            yield Finding(
                "ill_conditioned",
                f"the regressors are nearly collinear (condition number "
                f"{float(self.condition_number):.2g}); the least certain combination is "
                f"{self.weakest_combination()}.",
            )

    def _wide_intervals(self) -> Iterator[Finding]:
        sizes = np.concatenate([np.asarray(stage.relative_size) for stage in self.stages])
        ends = self.interval_by_name()
        for name, size in zip(self.parameters, sizes):
            low, high = ends[name]
            # A parameter near zero is well determined if its term could not matter.
            matters = (high - low) / 2 * float(size) > MATTERING_SHARE
            if high - low > 2 * abs(float(self[name])) and matters:
                yield Finding(
                    "interval_wider_than_estimate",
                    f"the interval of {name} reaches from {low:.4g} to {high:.4g}: these data "
                    f"hardly determine it.",
                    parameters=(name,),
                )

    def _lags(self) -> Iterator[Finding]:
        """Springs in series whose lag c / K is not told from none, and with it K from infinity."""
        for name, error in zip(self.parameters, self.standard_errors):
            value = float(self[name])
            if is_stiffness_name(name) and abs(value) < TOLD_LAG * float(error):
                yield Finding(
                    "series_spring_not_carried",
                    f"the lag behind {name} is {abs(value) / float(error):.2g} standard errors "
                    f"away from none: any stiffer spring would do, whatever the interval says. "
                    f"Leave it out.",
                    parameters=(name,),
                )

    def _residuals(self) -> Iterator[Finding]:
        for name, equation in self.equations.items():
            if (share := float(equation.relative_rms)) > LARGE_RESIDUAL:
                yield Finding(
                    "large_residual",
                    f"{name}: the model leaves {100 * share:.0f} % of the signal unexplained, so "
                    f"it is wrong in some important way.",
                    parameters=equation.parameters,
                )

    def _shrinking(self) -> Iterator[Finding]:
        """Equations without a known term that move their coefficients by more than chance."""
        errors, values = dict(zip(self.parameters, self.standard_errors)), self.values
        for name, equation in self.equations.items():
            share = float(equation.shrinkage)
            chance = [float(errors[n] / abs(values[n])) for n in equation.parameters if values[n]]
            if share > np.clip(min(chance, default=0.0), LEAST_SHRINKAGE, NOTABLE_SHRINKAGE):
                yield Finding(
                    "no_known_term",
                    f"{name}: no term of it is known, so that its residual pulls "
                    f"{', '.join(equation.parameters)} towards zero, by about {100 * share:.2g} %. "
                    f"Solve it after the equations that set their scale (riecjax.staged); where "
                    f"those do not determine them, hold one at a known value (on the command "
                    f"line: --set NAME=VALUE).",
                    parameters=equation.parameters,
                )

    def _coverage(self) -> Iterator[Finding]:
        for label, stage, offered in zip(self.stage_names, self.stages, self.rows_offered):
            lost = 1 - float(stage.count) / float(offered)
            if lost > ROUNDING[stage.count.dtype]:
                yield Finding(
                    "rows_left_out",
                    f"{label}: {100 * lost:.2g} % of the windows (or samples) touch a missing or "
                    f"masked sample and are left out.",
                )
        if int(self.block_count) < FEWEST_BLOCKS:
            yield Finding(
                "short_record",
                f"the records hold only {int(self.block_count)} blocks of "
                f"{float(self.block_length):.3g} s that may be taken as independent; intervals are "
                f"rough. Record for longer or choose a smaller beta.",
            )

    def _few_windows(self) -> Iterator[Finding]:
        # What moments leave of data that fit to their rounding says nothing of errors.
        rounding = 10 * float(jnp.finfo(self.theta.dtype).eps) ** 0.5
        told = [bool(s.relative_rms > rounding) for s in self.stages for _ in s.parameters]
        few = np.asarray(self.effective_windows) < FEWEST_WINDOWS
        names, listed = self._where(few & told, self.effective_windows)
        if names:
            yield Finding(
                "few_effective_windows",
                f"errors of overlapping windows are correlated: all of them tell as much as so "
                f"many independent ones of {listed}. With fewer than {FEWEST_WINDOWS} an interval "
                f"is rough. Record for longer.",
                parameters=names,
            )

    def _snapped(self) -> Iterator[Finding]:
        if self.summary is not None and self.summary.asked is not None:
            alpha, beta = self.summary.asked
            low, high = self.summary.lengths_of(self.summary.band)
            yield Finding(
                "band_snapped",
                f"windows of {alpha:.4g} to {beta:.4g} s were asked for; sums are kept by bins of "
                f"length, and those from {low:.4g} to {high:.4g} s were taken. Summarise anew with "
                f"these as alpha and beta for exactly that band.",
            )

    def _precision(self) -> Iterator[Finding]:
        if self.theta.dtype == jnp.float32:
            # The normal equations' rounding moves theta by a share of eps cond^2.
            eps = float(jnp.finfo(self.theta.dtype).eps)
            rounding = eps * max(float(self.condition_number), 10.0) ** 2
            yield Finding(
                "single_precision",
                f"computed in 32-bit: rounding in the solve alone moves the parameters by a "
                f"share of about {rounding:.0e}, and signals with an offset by more. "
                f"Enable 64-bit by jax.config.update('jax_enable_x64', True).",
            )

    def weakest_combination(self) -> str:
        """The combination of parameters that the data tells least about, in words."""
        worst = max(self.single().stages, key=lambda stage: float(stage.solution.condition_number))
        return combination(worst.parameters, np.asarray(worst.solution.weakest_direction))


def weighing(names: Sequence[str], direction: Float[np.ndarray, " p"]) -> tuple[str, ...]:
    """Parameters that weigh more than a tenth of the largest part of a direction."""
    largest = np.max(np.abs(direction))
    return tuple(n for c, n in zip(direction, names) if abs(c) > 0.1 * largest)


def combination(names: tuple[str, ...], direction: Float[np.ndarray, " p"]) -> str:
    """A direction over parameters as `0.71 F_1 - 0.71 F_2`, small parts left out."""
    large = weighing(names, direction)
    parts = [(c, n) for c, n in zip(direction, names) if n in large]
    if parts and parts[0][0] < 0:
        parts = [(-c, n) for c, n in parts]
    words = [f"{'-' if c < 0 else '+'} {abs(c):.2f} {n}" for c, n in parts]
    return " ".join(words).removeprefix("+ ")

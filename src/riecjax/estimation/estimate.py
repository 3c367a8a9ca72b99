"""Parameters with units and uncertainty, however they were estimated."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import ArrayLike

from riecjax import arrays as xp
from riecjax.arrays import hosted
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.errors import ModelError
from riecjax.estimation.parameters import (
    ParameterTable,
    combination,
    excite_or_hold,
    not_excited,
    weighing,
)
from riecjax.estimation.stages import EquationFit, StageSolution
from riecjax.findings import Finding, in_percent, joined
from riecjax.leaves import Leaf, PlainMethods
from riecjax.linear_algebra import gram_condition_limit
from riecjax.shows import Tabled, save
from riecjax.summaries.summary import Summary
from riecjax.uncertainty.intervals import Uncertainty

NOTABLE_INFLATION = 1.1
"""Factor on a standard error from which recordings are said to disagree."""
FEWEST_BLOCKS = 7
"""Blocks of time below which intervals are rough; ten stretches of twice the longest window may
come out as no more."""
FEWEST_WINDOWS = 10
"""Independent windows below which an interval is rough."""
LEVEL = 0.95
"""Of intervals, by default."""
MOSTLY = 0.5
"""Share of what is known of a parameter from which it rests on its prior."""
MATTERING_SHARE = 0.02
"""Share of the target that an uncertain term must reach to be worth a warning."""
LARGE_RESIDUAL = 0.5
"""Share of the target past which a model is called wrong."""
NOTABLE_SHRINKAGE = 0.01
"""Share by which an equation without a known term may shrink its coefficients; less is notable too
if it is more than a standard error."""
LEAST_SHRINKAGE = 0.001
"""Share of shrinkage that is never notable."""


class RefinementStatus(eqx.Enumeration):
    """How a refinement ended."""

    converged = "converged"
    out_of_steps = (
        "it used up its steps before it converged. Allow more (max_steps), start nearer, or use "
        "shorter windows first."
    )
    not_finite = (
        "the model has no finite residual at the start. Check the start's signs and sizes, or "
        "simulate over shorter windows. If the model is stiff, the steps may be too long for it: "
        "take more (OutputError(method=FixedStep(n))) or an implicit solver "
        "(method=Adaptive(1e-7, 1e-9, diffrax.Kvaerno5()))."
    )
    failed = (
        "no step took it further, and it is not at an optimum. Start nearer, or use shorter "
        "windows first."
    )


class Search(eqx.Module):
    """How a refinement went.

    **Fields:**

    - `status`: how the search ended; `steps` that it took.
    - `rms_before`, `rms`: root mean square of what is left of each of `quantities` (channels, or
      equations), with the start's parameters and now, in `quantity_units`. Both over the same
      windows, in the same steps, and from initial states that were estimated for each.
    - `cost_before`, `cost`: sums of squared residuals, likewise.
    - `initial_states` that were estimated, one row for each window, columns `initial_state_names`.
    - `step_change`: change of `theta`, to first order, if the steps of the simulation are halved;
      `coarse`, where that matters beside the standard error; `steps_label`, the method.
    - `by`: what was made small, in plain data.
    - `residuals` of the last search, in whose units and steps what is left can be asked for;
      `None` under `jax.jit` and `jax.vmap`, and of a file.
    """

    status: RefinementStatus
    steps: Int[Array, "*batch"]
    rms_before: Float[Array, "*batch quantities"]
    rms: Float[Array, "*batch quantities"]
    cost_before: Float[Array, "*batch"]
    cost: Float[Array, "*batch"]
    initial_states: Float[Array, "*batch windows s"]
    step_change: Float[Leaf, "*batch p"]
    coarse: Bool[Leaf, "*batch p"]
    steps_label: str = eqx.field(static=True)
    quantities: tuple[str, ...] = eqx.field(static=True)
    quantity_units: tuple[str, ...] = eqx.field(static=True)
    initial_state_names: tuple[str, ...] = eqx.field(static=True)
    by: tuple[tuple[str, Any], ...] = eqx.field(static=True)
    residuals: Any = None

    @property
    def converged(self) -> Bool[Array, "*batch"]:
        """Whether the search ended at an optimum."""
        return self.status == RefinementStatus.converged

    @property
    def basis(self) -> str:
        """What `rms_before` and `rms` are of, in words: windows, initial states, steps."""
        by = dict(self.by)
        if "starts" not in by:
            return "impulses over the same windows"
        windows = "the whole record" if by.get("windows") == "whole record" else "the same windows"
        starts = {
            "estimated": "initial states estimated for each",
            "measured": "initial states as recorded",
        }
        return f"{windows}, {starts.get(by['starts'], 'known initial states')}, {self.steps_label}"

    @property
    def reason(self) -> str:
        """How the search ended, in words, of a batch with numbers of members (not under jit)."""

        def words_at(*place: int) -> str:
            return RefinementStatus[jax.tree.map(lambda leaf: np.asarray(leaf[place]), self.status)]

        if not np.ndim(self.steps):
            return words_at()
        ended = Counter(words_at(*place) for place in np.ndindex(np.shape(self.steps)))
        return ", ".join(f"{number} x {words}" for words, number in ended.items())


class Estimate(PlainMethods, Tabled, eqx.Module):
    """Parameters with units and uncertainty, and how they were obtained.

    Read one by one as from a mapping: `estimate["M_s"]`. A pytree: `theta` and the covariance
    differentiate and vmap. Of `jax.vmap` it is a batch: every array has the batch's axes first,
    whatever is read by name has the batch's shape, printing shows the distribution over the batch,
    and `estimate.member(3)` is one of its estimates.

    **Fields:**

    - `theta`: estimated values, in the order of `parameters`, shape `(..., p)`.
    - `uncertainty`: covariance of theta and what makes intervals, valid under overlapping windows
      and autocorrelated equation errors (see [`BlockBootstrap`][]). It speaks of scatter about the
      value that the criterion converges to, not of that value's distance from the truth.
    - `table`: what each parameter is, and the values of those that were not estimated.
    - `inflation`: factor on each standard error because recordings disagree, 1 where they agree.
    - `at_bound`: which parameters sit on a bound; nothing is said of their uncertainty.
    - `block_count`, `block_length`: independent blocks of time behind the covariance, and their
      length in seconds (rule: `block_length` in `uncertainty.covariances`).
    - `doubts`: findings of the recordings that it was identified from, such as a wrong unit.
    - `search`: how a refinement went, `None` where windows were fitted.

    Of windows, empty or `None` of a refinement:

    - `naive`: least squares' own standard errors, as if all windows were independent: far too
      small, and kept to tell the effective number of windows.
    - `stages`: solution, conditioning and residual of each stage.
    - `criterion`: what was made small.
    - `stage_names`, `equation_names`: of each stage, and of each equation in it.
    - `rows_offered`: for each stage, how many rows there would be without gaps and masks; NaN
      where that is not known.
    - `summary`: the sums behind it, from which others can be estimated; `None` under `jax.jit` and
      `jax.vmap`, where each member of a batch would carry its own.
    """

    theta: Float[Array, "*batch p"]
    uncertainty: Uncertainty
    table: ParameterTable
    inflation: Float[Array, "*batch p"]
    at_bound: Bool[Leaf, "*batch p"]
    block_count: Int[Array, "*batch"]
    block_length: Float[Array, "*batch"]
    # What only one way of estimating has is typed as if it were there, for those who know the way.
    search: Search = None  # pyright: ignore[reportAssignmentType]
    naive: Float[Array, "*batch p"] = None  # pyright: ignore[reportAssignmentType]
    stages: tuple[StageSolution, ...] = ()
    criterion: AbstractCriterion = None  # pyright: ignore[reportAssignmentType]
    rows_offered: Float[Leaf, "*batch stages"] = None  # pyright: ignore[reportAssignmentType]
    summary: Summary | None = None
    stage_names: tuple[str, ...] = eqx.field(static=True, default=())
    equation_names: tuple[tuple[str, ...], ...] = eqx.field(static=True, default=())
    doubts: tuple[Finding, ...] = eqx.field(static=True, default=())

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of those that were estimated."""
        return self.table.free

    @property
    def _by_data(self) -> Bool[np.ndarray, " p"]:
        """Which parameters neither a bound nor a prior tells (not under jit)."""
        share, held = self.uncertainty.prior_share, np.asarray(self.at_bound)
        return ~held if share is None else ~(held | (np.asarray(share) > MOSTLY))

    @property
    def told_by_data(self) -> ParameterTable:
        """The table in which what sits on a bound, or rests on priors, is known (not under jit)."""
        each = zip(self.parameters, self.theta, self._by_data)
        return self.table.settled({n: jnp.asarray(value) for n, value, told in each if not told})

    @property
    def known(self) -> dict[str, Any]:
        """Parameters that were not estimated, with their values."""
        return self.table.known

    @property
    def units(self) -> tuple[tuple[str, str], ...]:
        """Pairs of name and unit, of known parameters too."""
        return self.table.units

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to a file of exactly this name, whole or not at all; see [`load`][].

        It holds everything, the Summary too: values, intervals of any level, and findings.

        **Raises:** `DataError` if the file cannot be written; `ModelError` for a batch, for what
        is being traced, or a criterion with a law that is a function.
        """
        save(self, path)

    def __getitem__(self, name: str) -> Float[Array, "*batch"]:
        if not isinstance(name, str) or name not in self.known:
            return self._of(self.theta, name)
        # What is known may be one value for all of a batch.
        value = xp.broadcast_to(self.known[name], self.batch_shape)
        return value if self.batch_shape else _single(value)

    def __iter__(self) -> Iterator[str]:
        return iter((*self.parameters, *self.known))

    @property
    def values(self) -> Mapping[str, Array]:
        """Every parameter, estimated or known, by name."""
        return {name: self[name] for name in self}

    @property
    def determined(self) -> Bool[Array, "*batch"]:
        """Whether theta is an answer at all, as far as ranks tell.

        Of windows, it is finite and every stage tells its parameters apart.
        """
        if not self.stages:
            return xp.ones(self.batch_shape, bool)
        finite = xp.isfinite(self.theta).all(axis=-1)
        return finite & (self.rank == len(self.parameters))

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Axes that `jax.vmap` added: `()` of one estimate."""
        return self.theta.shape[:-1]

    def member(self, *index: int) -> Self:
        """One estimate of a batch: `batch.member(3)`, or `batch.member(3, 0)` of a nested one.

        **Raises:** `ModelError` if there is none at this place.
        """
        shape = self.batch_shape
        if len(index) > len(shape) or any(not -n <= i < n for i, n in zip(index, shape)):
            raise ModelError(f"no member {index} in a batch of shape {shape}.")

        def taken(leaf: Any) -> Any:
            return leaf[index] if eqx.is_array(leaf) and leaf.shape[: len(shape)] == shape else leaf

        return jax.tree.map(taken, self)

    def single(self) -> Self:
        """This estimate.

        **Raises:** `ModelError` if it is a batch.
        """
        if self.batch_shape:
            raise ModelError(
                f"one estimate is wanted, not a batch of shape {self.batch_shape}: take one out "
                f"by member(0), or go over all of them by jax.vmap."
            )
        return self

    @property
    def equations(self) -> dict[str, EquationFit]:
        """What is left of each equation, by name: a stage of several may hide that one fails."""
        return {
            name: fit
            for names, stage in zip(self.equation_names, self.stages)
            for name, fit in zip(names, stage.equations)
        }

    @property
    def _fitted(self) -> tuple[StageSolution, ...]:
        """Fits of the stages, where there are some."""
        if not self.stages:
            raise ModelError("a refined estimate fits no windows: ask the estimate it began from.")
        return self.stages

    @property
    def effective_windows(self) -> Float[Array, "*batch p"]:
        """How many independent windows would tell each parameter as well as all of them do.

        Least squares' own variance holds if all n rows are independent, and goes with 1 / n: of m
        independent ones it would be n / m times as large. Setting that equal to the actual variance
        gives m = n naive^2 / error^2.
        """
        stages = self._fitted
        counts = [stage.count[..., None] for stage in stages for _ in stage.parameters]
        rows = xp.concatenate(counts, axis=-1)
        variance = self.standard_errors**2
        ratio = xp.square(self.naive) / xp.where(variance > 0, variance, 1.0)
        return xp.where(variance > 0, rows * ratio, rows)

    @property
    def condition_number(self) -> Float[Array, "*batch"]:
        """The largest among the stages, of the regressors with columns scaled to unit length."""
        return xp.max(xp.stack([stage.solution.condition_number for stage in self._fitted]), axis=0)

    @property
    def rank(self) -> Int[Array, "*batch"]:
        """Sum of the stages' ranks; the number of parameters when all can be told apart."""
        return xp.sum(xp.stack([stage.solution.rank for stage in self._fitted]), axis=0)

    @property
    def covariance(self) -> Float[Array, "*batch p p"]:
        """Covariance of theta."""
        return self.uncertainty.covariance

    @property
    def standard_errors(self) -> Float[Array, "*batch p"]:
        """Square roots of the covariance's diagonal."""
        return xp.sqrt(xp.diagonal(self.covariance, axis1=-2, axis2=-1))

    def standard_error(self, name: str) -> Float[Array, "*batch"]:
        """Standard error of one estimated parameter."""
        return self._of(self.standard_errors, name)

    def interval(self, name: str, level: float = LEVEL) -> tuple[Any, Any]:
        """Ends of the confidence interval (not under jit); see [`Uncertainty.reach`][].

        Floats, or of a batch arrays of its shape.
        """
        self._index(name)
        return self.interval_by_name(level)[name]

    def intervals(
        self, level: float = LEVEL
    ) -> tuple[Float[np.ndarray, "*batch p"], Float[np.ndarray, "*batch p"]]:
        """Lower and upper ends of the confidence intervals of all `parameters` (not under jit)."""
        below, above = self.uncertainty.reach(level)
        theta, errors = np.asarray(self.theta), np.asarray(self.standard_errors)
        return theta - below * errors, theta + above * errors

    def interval_by_name(self, level: float = LEVEL) -> dict[str, tuple[Any, Any]]:
        """As `interval`, of every parameter: quantiles of replicates are formed once."""
        ends = zip(*(np.moveaxis(end, -1, 0) for end in self.intervals(level)))
        if self.batch_shape:
            return dict(zip(self.parameters, ends))
        return {name: (float(low), float(high)) for name, (low, high) in zip(self.parameters, ends)}

    @property
    def correlation(self) -> Float[Array, "*batch p p"]:
        """Correlation matrix of theta; 0 for one without an error, NaN where it is not finite."""
        errors = self.standard_errors
        # Divided by one after the other: the inverse of a tiny error overflows, and so a product.
        known, scale = xp.isfinite(errors), xp.where(errors > 0, errors, xp.inf)
        both = known[..., :, None] & known[..., None, :]
        covariance = xp.where(both, self.covariance, xp.nan)
        return covariance / scale[..., :, None] / scale[..., None, :]

    # What has no error, or an infinite one, is passed over.
    @np.errstate(divide="ignore", invalid="ignore")
    def findings(self) -> list[Finding]:
        """What a user should know before trusting this (not under jit).

        Of a batch, each code once: how many members it concerns, and what it says of the first.
        """
        host = hosted(self)
        if not self.batch_shape:
            return list(host._findings())
        first: dict[str, Finding] = {}
        concerned = Counter[str]()
        for place in np.ndindex(self.batch_shape):
            at, said = ", ".join(map(str, place)), dict[str, Finding]()
            for finding in host.member(*place)._findings():
                message = f"first in member {at}: {finding.message}"
                said.setdefault(finding.code, finding._replace(message=message))
            concerned.update(said.keys())
            first |= {code: said[code] for code in said if code not in first}
        size = int(np.prod(self.batch_shape))
        return [
            finding._replace(message=f"in {concerned[code]} of {size} members, {finding.message}")
            for code, finding in first.items()
        ]

    def _findings(self) -> Iterator[Finding]:
        """Of one estimate: of its recordings, and of windows or of a search."""
        yield from self.doubts
        yield from self._of_windows() if self.search is None else self._of_search()

    def _of_windows(self) -> Iterator[Finding]:
        if lost := list(self.refusals()):
            yield from (*lost, *self._coverage(), *self._precision())
            return
        if float(self.condition_number) > gram_condition_limit(self.theta.dtype):
            worst = max(self.stages, key=lambda stage: float(stage.solution.condition_number))
            weakest = combination(worst.parameters, np.asarray(worst.solution.weakest_direction))
            yield Finding(
                "ill_conditioned",
                f"the regressors are nearly collinear (condition number "
                f"{float(self.condition_number):.2g}); the least certain combination is "
                f"{weakest}.",
            )
        yield from (*self._constrained(), *self._few_blocks())
        # A parameter near zero is well determined if its term could not matter.
        sizes = np.concatenate([np.asarray(stage.relative_size) for stage in self.stages])
        low, high = self.intervals()
        yield from self._wide((high - low) / 2 * sizes > MATTERING_SHARE, "interval")
        errors_away = np.abs(self.theta) / self.standard_errors
        for name, away in zip(self.parameters, map(float, errors_away)):
            part = self.table[name].element
            if part is not None and part.absence is not None and away < part.absence.least:
                message = part.absence.message.format(name=name, away=away)
                yield Finding(part.absence.code, message, parameters=(name,))
        yield from self._negative_values()
        for name, equation in self.equations.items():
            if (share := float(equation.relative_rms)) > LARGE_RESIDUAL:
                yield Finding(
                    "large_residual",
                    f"{name}: the model leaves {in_percent(share, '.0f')} of the signal "
                    f"unexplained, so it is wrong in some important way.",
                    parameters=equation.parameters,
                )
        # Equations without a known term that move their coefficients by more than chance.
        errors, values = dict(zip(self.parameters, self.standard_errors)), self.values
        for name, equation in self.equations.items():
            share = float(equation.shrinkage)
            chance = [float(errors[n] / abs(values[n])) for n in equation.parameters if values[n]]
            if share > np.clip(min(chance, default=0.0), LEAST_SHRINKAGE, NOTABLE_SHRINKAGE):
                yield Finding(
                    "no_known_term",
                    f"{name}: no term of it is known, so that its residual pulls "
                    f"{', '.join(equation.parameters)} towards zero, by about {in_percent(share)}. "
                    f"Solve it after the equations that set their scale (riecjax.staged); where "
                    f"those do not determine them, hold one at a known value (on the command "
                    f"line: --set NAME=VALUE).",
                    parameters=equation.parameters,
                )
        yield from (*self._disagreement(), *self._coverage())
        # What moments leave of data that fit to their rounding says nothing of errors.
        rounding = 10 * float(jnp.finfo(self.theta.dtype).eps) ** 0.5
        told = [bool(s.relative_rms > rounding) for s in self.stages for _ in s.parameters]
        few = np.asarray(self.effective_windows) < FEWEST_WINDOWS
        yield from finding(
            "few_effective_windows",
            self.parameters,
            few & told & self._by_data,
            self.effective_windows,
            f"errors of overlapping windows are correlated: all of them tell as much as so many "
            f"independent ones of {{}}. With fewer than {FEWEST_WINDOWS} an interval is rough. "
            f"Record for longer.",
        )
        if self.summary is not None and self.summary.asked is not None:
            alpha, beta = self.summary.asked
            low, high = self.summary.lengths_of(self.summary.band)
            yield Finding(
                "band_snapped",
                f"windows of {alpha:.4g} to {beta:.4g} s were asked for; sums are kept by bins of "
                f"length, and those from {low:.4g} to {high:.4g} s were taken. Summarise anew with "
                f"these as alpha and beta for exactly that band.",
            )
        yield from self._precision()

    def refusals(self) -> Iterator[Finding]:
        """What leaves no answer: raised where values can be looked at, and of a batch found here.

        Of windows: rows that are missing or not finite, and parameters that they do not tell apart.
        """
        for label, stage in zip(self.stage_names, self.stages):
            solution, names = stage.solution, stage.parameters
            silent = np.flatnonzero(np.asarray(stage.relative_size) == 0)
            if not np.all(np.isfinite(solution.theta)):
                why = "its terms or known values are not finite numbers."
            elif float(stage.count) == 0:
                why = "no rows: every window touches a missing or masked sample."
            elif int(solution.rank) == len(names):
                continue
            elif silent.size:
                yield not_excited(label, self.table[names[silent[0]]])
                continue
            else:
                direction = np.asarray(solution.weakest_direction)
                rows = [self.table[name] for name in weighing(names, direction)]
                why = (
                    f"the record cannot tell these apart: {combination(names, direction)}, in "
                    f"units of each regressor's size. {excite_or_hold(rows)}"
                )
            yield Finding("unidentifiable", f"{label}: {why}", parameters=names)

    def _coverage(self) -> Iterator[Finding]:
        for label, stage, offered in zip(self.stage_names, self.stages, self.rows_offered):
            lost = 1 - float(stage.count) / float(offered)
            # Less may be missing only because the number of rows was rounded.
            if lost > np.finfo(stage.count.dtype).eps ** 0.5:
                yield Finding(
                    "rows_left_out",
                    f"{label}: {in_percent(lost)} of the windows (or samples) touch a missing or "
                    f"masked sample and are left out.",
                )
        if int(self.block_count) < FEWEST_BLOCKS:
            yield Finding(
                "short_record",
                f"the records hold only {int(self.block_count)} blocks of "
                f"{float(self.block_length):.3g} s that may be taken as independent; intervals are "
                f"rough. Record for longer or choose a smaller beta.",
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

    def _of_search(self) -> Iterator[Finding]:
        if not bool(self.search.converged):
            yield Finding(
                "refinement_not_converged", f"the refinement did not converge: {self.search.reason}"
            )
        shares = self.search.step_change / self.standard_errors
        changes = {
            name: f"{name} by {float(change):.3g} ({abs(float(share)):.2g} standard errors)"
            for name, change, share, coarse in zip(
                self.parameters, self.search.step_change, shares, self.search.coarse
            )
            if bool(coarse)
        }
        if changes:
            yield Finding(
                "coarse_steps",
                f"the steps of the simulation, {self.search.steps_label}, are part of the answer: "
                f"halving them changes {', '.join(changes.values())}. Take shorter ones "
                f"(OutputError(method=FixedStep(n))) or record faster; a stiff model needs "
                f"Adaptive with an implicit solver, a force that jumps as sign(v) a width.",
                parameters=tuple(changes),
            )
        yield from self._constrained()
        # What the data hardly determine, or not at all.
        some = ~np.asarray(self.at_bound)
        finite = np.all(np.isfinite(self.intervals()), axis=0)
        yield from self._wide(some & finite, "refined interval")
        silent = [name for name, lost in zip(self.parameters, some & ~finite) if lost]
        if len(silent) == 1:
            message = f"these data say nothing about {silent[0]}."
            yield Finding("undetermined", message, parameters=(silent[0],))
        elif silent:
            yield Finding(
                "undetermined",
                f"what is compared stays as it is when {', '.join(silent)} change together, so it "
                f"tells none of them alone, as motion without a force does not tell how heavy a "
                f"machine is. Hold one at a known value (on the command line: --set "
                f"{silent[0]}=VALUE), or compare another signal.",
                parameters=tuple(silent),
            )
        yield from (*self._negative_values(), *self._few_blocks())
        yield from self._disagreement()

    def _constrained(self) -> Iterator[Finding]:
        """Parameters that bounds or priors tell, and not data."""
        if names := [n for n, reached in zip(self.parameters, self.at_bound) if bool(reached)]:
            yield Finding(
                "at_bound",
                f"{', '.join(names)} sit(s) on a bound: the data would go further. The intervals "
                f"of the others take it for known.",
                parameters=tuple(names),
            )
        told = zip(self.parameters, self._by_data | np.asarray(self.at_bound))
        rest = [name for name, by_data in told if not by_data]
        if rest:
            yield Finding(
                "rests_on_prior",
                f"the recordings tell less of {', '.join(rest)} than the prior does: value and "
                f"interval are the prior's rather than a measurement. Excite the system more "
                f"richly, or make sure of the prior.",
                parameters=tuple(rest),
            )

    def _wide(self, which: Bool[np.ndarray, " p"], interval: str) -> list[Finding]:
        """Some parameters whose interval is wider than they are large."""
        low, high = self.intervals()
        return each_finding(
            "interval_wider_than_estimate",
            self.parameters,
            which & (high - low > 2 * np.abs(self.theta)),
            f"the {interval} of {{name}} reaches from {{low:.4g}} to {{high:.4g}}: these data "
            f"hardly determine it.",
            low=low,
            high=high,
        )

    @property
    def below_zero(self) -> Bool[np.ndarray, " p"]:
        """Masses and dampers whose whole interval lies below zero (not under jit)."""
        _, high = self.intervals()
        signed = [self.table[name].sign != "" for name in self.parameters]
        return (high < 0) & np.array(signed)

    def _negative_values(self) -> list[Finding]:
        """Masses and dampers that come out below zero."""
        low, high = self.intervals()
        rows = [self.table[name] for name in self.parameters]
        return each_finding(
            "negative_value",
            self.parameters,
            self.below_zero,
            "{name} is below zero, from {low:.4g} to {high:.4g} {row.unit}: {row.sign}. Check the "
            "signs of the signals against the equation's, and the direction of time.",
            low=low,
            high=high,
            row=rows,
        )

    def _few_blocks(self) -> Iterator[Finding]:
        """Intervals by a small-sample sandwich."""
        yield from finding(
            "few_blocks",
            self.parameters,
            self.uncertainty.few_blocks & self._by_data,
            self.uncertainty.degrees_of_freedom,
            "few independent stretches of the record tell of {} (degrees of freedom of the "
            "variance): these intervals come from a small-sample sandwich with Student's t and are "
            "the wider the fewer there are. Record for longer, or excite them all along.",
        )

    def _disagreement(self) -> list[Finding]:
        """Parameters on which recordings disagree by more than chance."""
        found = each_finding(
            "records_disagree",
            self.parameters,
            np.asarray(self.inflation) > NOTABLE_INFLATION,
            "the recordings do not agree on {name}: they differ by more than the scatter within "
            "each explains, so its interval is {factor:.2g} times as wide. The model leaves out "
            "something that differs between them; a parameter that may differ, such as an offset, "
            "can have a value in each (per_record=, --per-record).",
            factor=self.inflation,
        )
        return [
            one._replace(
                remedy=("--per-record", *one.parameters),
                step=f"Let {joined(one.parameters)} differ between recordings",
            )
            for one in found
        ]

    def moves_to(self, other: "Estimate") -> dict[str, float]:
        """Share of its value by which another estimate's differs, of each parameter of both."""
        return {
            name: abs(float(other[name]) / float(self[name]) - 1)
            for name in self.parameters
            if name in other.parameters and float(self[name])
        }

    def _of(self, values: Float[Array, "*batch p"], name: str) -> Float[Array, "*batch"]:
        index = self._index(name)
        return values[..., index] if self.batch_shape else _single(values, index)

    def _index(self, name: str) -> int:
        try:
            return self.parameters.index(name)
        except ValueError:
            raise ModelError(
                f"no estimated parameter '{name}'; there are: {', '.join(self.parameters)}."
            ) from None


def _single(values: Any, *index: int) -> Any:
    """One of the numbers, as a NumPy scalar unless it is traced: that formats as a float does."""
    return np.asarray(values)[index] if xp.is_concrete(values) else values[index]


def finding(
    code: str,
    names: Sequence[str],
    which: ArrayLike,
    numbers: ArrayLike,
    message: str,
) -> list[Finding]:
    """One on some parameters, if there are any, that lists each with its number."""
    chosen = np.flatnonzero(which).tolist()
    values = np.asarray(numbers)[chosen]
    listed = ", ".join(f"{names[i]} ({value:.2g})" for i, value in zip(chosen, values))
    message = message.format(listed)
    return [Finding(code, message, parameters=tuple(names[i] for i in chosen))] if chosen else []


def each_finding(
    code: str, names: Sequence[str], which: ArrayLike, message: str, **said: Sequence[Any] | Leaf
) -> list[Finding]:
    """One on each of some parameters, with what its `message` says of each by name."""
    return [
        Finding(
            code,
            message.format(name=names[i], **{key: values[i] for key, values in said.items()}),
            parameters=(names[i],),
        )
        for i in np.flatnonzero(which).tolist()
    ]


def span(values: ArrayLike, form: str = ".3g") -> str:
    """A number in words, or of a batch its least and largest."""
    numbers = np.ravel(np.asarray(values))
    finite = numbers[np.isfinite(numbers)]
    ends = (finite.min(), finite.max()) if finite.size else (numbers[0], numbers[0])
    low, high = (f"{end:{form}}" for end in ends)
    return low if low == high else f"{low} .. {high}"


def intervals_entry(estimate: Estimate) -> dict[str, Any]:
    """Where the intervals of one estimate come from."""
    return {
        "method": estimate.uncertainty.label,
        "blocks": int(estimate.block_count),
        "block_seconds": float(estimate.block_length),
    }


def parameter_entries(estimate: Estimate) -> dict[str, dict[str, Any]]:
    """Value, unit, standard error and interval of each estimated parameter, and of a linear
    estimate what its windows say of it."""
    entries = {
        name: {
            "value": estimate[name],
            "unit": estimate.table[name].unit,
            "std_error": estimate.standard_error(name),
            "interval95": ends,
        }
        for name, ends in estimate.interval_by_name().items()
    }
    if estimate.search is None:
        windows = zip(entries.values(), estimate.naive, estimate.effective_windows)
        for entry, naive, count in windows:
            entry |= {"naive_std_error": naive, "effective_windows": count}
    return entries

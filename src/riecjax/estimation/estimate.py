"""Parameters with units and uncertainty, however they were estimated."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import ArrayLike

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.hidden_elements import SpringParameters
from riecjax.errors import ModelError
from riecjax.estimation.parameters import ParameterTable
from riecjax.estimation.stages import EquationFit, StageSolution
from riecjax.findings import Finding
from riecjax.leaves import Leaf, is_concrete, namespace, on_host
from riecjax.linear_algebra import gram_condition_limit
from riecjax.shows import Saved
from riecjax.summaries.summary import Summary
from riecjax.uncertainty.intervals import Uncertainty

LOST_SHARE = 0.05
"""Share of the bootstrap's replicates that may leave a parameter undetermined."""
NOTABLE_INFLATION = 1.1
"""Factor on a standard error from which recordings are said to disagree."""
NOTABLE_LEAN = 3.0
"""How many times as far as the small-sample sandwich an interval reaches before it is said why."""


class AbstractEstimate(Saved, eqx.Module):
    """Estimated and known parameters, read one by one as from a mapping: `estimate["M_s"]`.

    Of `jax.vmap` it is a batch: every array has the batch's axes first, whatever is read by name
    has the batch's shape, and `member` takes one estimate out.

    **Fields:**

    - `theta`: estimated values, in the order of `parameters`, shape `(..., p)`.
    - `uncertainty`: covariance of theta and what makes intervals.
    - `table`: what each parameter is, and the values of those that were not estimated.
    - `inflation`: factor on each standard error because recordings disagree, 1 where they agree.
    - `block_count`, `block_length`: independent blocks of time behind the covariance, and the
      seconds that each lasts.
    """

    theta: Float[Array, "*batch p"]
    uncertainty: Uncertainty
    table: ParameterTable
    inflation: Float[Array, "*batch p"]
    block_count: Int[Array, "*batch"]
    block_length: Float[Array, "*batch"]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of those that were estimated."""
        return self.table.free

    @property
    def known(self) -> dict[str, Any]:
        """Parameters that were not estimated, with their values."""
        return self.table.known

    @property
    def units(self) -> tuple[tuple[str, str], ...]:
        """Pairs of name and unit, of known parameters too."""
        return self.table.units

    def __getitem__(self, name: str) -> Float[Array, "*batch"]:
        if not isinstance(name, str) or name not in self.known:
            return self._of(self.theta, name)
        # What is known may be one value for all of a batch.
        value = namespace(self.known[name]).broadcast_to(self.known[name], self.batch_shape)
        return value if self.batch_shape else _single(value)

    def __iter__(self) -> Iterator[str]:
        return iter((*self.parameters, *self.known))

    @property
    def values(self) -> Mapping[str, Array]:
        """Every parameter, estimated or known, by name."""
        return {name: self[name] for name in self}

    @property
    def determined(self) -> Bool[Array, "*batch"]:
        """Whether theta is an answer at all, as far as ranks tell."""
        return namespace(self.theta).ones(self.batch_shape, bool)

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
    def covariance(self) -> Float[Array, "*batch p p"]:
        """Covariance of theta."""
        return self.uncertainty.covariance

    @property
    def standard_errors(self) -> Float[Array, "*batch p"]:
        """Square roots of the covariance's diagonal."""
        xp = namespace(self.covariance)
        return xp.sqrt(xp.diagonal(self.covariance, axis1=-2, axis2=-1))

    def standard_error(self, name: str) -> Float[Array, "*batch"]:
        """Standard error of one estimated parameter."""
        return self._of(self.standard_errors, name)

    def interval(self, name: str, level: float = 0.95) -> tuple[Any, Any]:
        """Ends of the confidence interval (not under jit); see [`Uncertainty.reach`][].

        Floats, or of a batch arrays of its shape.
        """
        self._index(name)
        return self.interval_by_name(level)[name]

    def intervals(
        self, level: float = 0.95
    ) -> tuple[Float[np.ndarray, "*batch p"], Float[np.ndarray, "*batch p"]]:
        """Lower and upper ends of the confidence intervals of all `parameters` (not under jit)."""
        below, above = self.uncertainty.reach(level)
        theta, errors = np.asarray(self.theta), np.asarray(self.standard_errors)
        return theta - below * errors, theta + above * errors

    def interval_by_name(self, level: float = 0.95) -> dict[str, tuple[Any, Any]]:
        """As `interval`, of every parameter: quantiles of replicates are formed once."""
        ends = zip(*(np.moveaxis(end, -1, 0) for end in self.intervals(level)))
        if self.batch_shape:
            return dict(zip(self.parameters, ends))
        return {name: (float(low), float(high)) for name, (low, high) in zip(self.parameters, ends)}

    @property
    def correlation(self) -> Float[Array, "*batch p p"]:
        """Correlation matrix of theta; 0 for one without an error, NaN where it is not finite."""
        errors = self.standard_errors
        xp = namespace(errors)
        # Divided by one after the other: the inverse of a tiny error overflows, and so a product.
        known, scale = xp.isfinite(errors), xp.where(errors > 0, errors, xp.inf)
        both = known[..., :, None] & known[..., None, :]
        covariance = xp.where(both, self.covariance, xp.nan)
        return covariance / scale[..., :, None] / scale[..., None, :]

    def findings(self) -> list[Finding]:
        """What a user should know before trusting this (not under jit).

        Of a batch, each code once: how many members it concerns, and what it says of the first.
        """
        host = on_host(self)
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
        """Of one estimate."""
        raise NotImplementedError

    def negative_values(self) -> Iterator[Finding]:
        """Masses and dampers whose whole interval lies below zero (not under jit)."""
        ends = self.interval_by_name()
        for name, (low, high) in ends.items():
            row = self.table[name]
            if row.sign and high < 0:
                yield Finding(
                    "negative_value",
                    f"{name} is below zero, from {low:.4g} to {high:.4g} {row.unit}: {row.sign}. "
                    f"Check the signs of the signals against the equation's, and the direction of "
                    f"time.",
                    parameters=(name,),
                )

    def few_blocks(self) -> Iterator[Finding]:
        """Intervals by a small-sample sandwich, and those that lean (not under jit)."""
        freedom = self.uncertainty.degrees_of_freedom
        names, listed = self._where(self.uncertainty.few_blocks, freedom)
        if names:
            yield Finding(
                "few_blocks",
                f"few independent stretches of the record tell of {listed} (degrees of "
                f"freedom of the variance): these intervals come from a small-sample sandwich with "
                f"Student's t and are the wider the fewer there are. Record for longer, or excite "
                f"them all along.",
                parameters=names,
            )
        # Intervals that reach much farther than errors alike all along call for.
        times = np.where(self.uncertainty.few_blocks, 1.0, self.uncertainty.times_sandwich)
        names, listed = self._where(times > NOTABLE_LEAN, times)
        if names:
            yield Finding(
                "uneven_errors",
                f"a few stretches of the record err so much more than the rest that the intervals "
                f"of {listed} reach so many times as far as they otherwise would. Look at "
                f"those stretches, or record for longer.",
                parameters=names,
            )

    def rarely_excited(self) -> Iterator[Finding]:
        """Parameters that many of the bootstrap's replicates leave undetermined (not under jit)."""
        replicates = self.uncertainty.studentized
        if replicates is None:
            return
        lost = np.mean(~np.isfinite(np.asarray(replicates)), axis=0)
        lost = np.where(self.uncertainty.few_blocks, 0.0, lost)
        names, listed = self._where(lost > LOST_SHARE, 100 * lost, " %")
        if names:
            yield Finding(
                "rarely_excited",
                f"so few stretches of the record tell of {listed} that so large a share "
                f"of the bootstrap's replicates held none of them: their intervals are rough. "
                f"Record for longer, or excite them more often.",
                parameters=names,
            )

    def disagreement(self) -> Iterator[Finding]:
        """Parameters on which recordings disagree by more than chance (not under jit)."""
        for name, factor in zip(self.parameters, self.inflation):
            if float(factor) > NOTABLE_INFLATION:
                yield Finding(
                    "records_disagree",
                    f"the recordings do not agree on {name}: they differ by more than the "
                    f"scatter within each explains, so its interval is {float(factor):.2g} times "
                    f"as wide. The model leaves out something that differs between them; a "
                    f"parameter that may differ, such as an offset, can have a value in each "
                    f"(per_record=, --per-record).",
                    parameters=(name,),
                )

    def _where(
        self, which: ArrayLike, numbers: ArrayLike, unit: str = ""
    ) -> tuple[tuple[str, ...], str]:
        """Names of some parameters, and a list of them with a number beside each."""
        chosen = np.flatnonzero(which)
        names, values = [self.parameters[i] for i in chosen], np.asarray(numbers)[chosen]
        listed = ", ".join(f"{n} ({x:.2g}{unit})" for n, x in zip(names, values))
        return tuple(names), listed

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
    return np.asarray(values)[index] if is_concrete(values) else values[index]


def span(values: ArrayLike, form: str = ".3g") -> str:
    """A number in words, or of a batch its least and largest."""
    numbers = np.ravel(np.asarray(values))
    finite = numbers[np.isfinite(numbers)]
    ends = (finite.min(), finite.max()) if finite.size else (numbers[0], numbers[0])
    low, high = (f"{end:{form}}" for end in ends)
    return low if low == high else f"{low} .. {high}"


# What an identification found, and how far it can be trusted.

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
    - `table`: what each parameter is, and the values of those that were not estimated.
    - `criterion`: what was made small.
    - `block_count`, `block_length`: independent blocks of time behind the covariance, and their
      length in seconds (rule: `block_length` in `uncertainty.covariances`).
    - `stage_names`, `equation_names`: of each stage, and of each equation in it.
    - `rows_offered`: for each stage, how many rows there would be without gaps and masks; NaN
      where that is not known.
    - `doubts`: findings of the recordings that it was identified from, such as a wrong unit.
    - `summary`: the sums behind it, from which others can be estimated; `None` under `jax.jit` and
      `jax.vmap`, where each member of a batch would carry its own.
    """

    naive: Float[Array, "*batch p"]
    stages: tuple[StageSolution, ...]
    criterion: AbstractCriterion
    rows_offered: Float[Leaf, "*batch stages"]
    summary: Summary | None
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

    def _findings(self) -> Iterator[Finding]:
        yield from self.doubts
        if lost := list(self._without_answer()):
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
        yield from self.few_blocks()
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
        # Springs in series whose lag c / K is not told from none, and with it K from infinity.
        for name, error in zip(self.parameters, self.standard_errors):
            value = float(self[name])
            of_spring = isinstance(self.table[name].element, SpringParameters)
            if of_spring and abs(value) < TOLD_LAG * float(error):
                yield Finding(
                    "series_spring_not_carried",
                    f"the lag behind {name} is {abs(value) / float(error):.2g} standard errors "
                    f"away from none: any stiffer spring would do, whatever the interval says. "
                    f"Leave it out.",
                    parameters=(name,),
                )
        yield from self.negative_values()
        for name, equation in self.equations.items():
            if (share := float(equation.relative_rms)) > LARGE_RESIDUAL:
                yield Finding(
                    "large_residual",
                    f"{name}: the model leaves {100 * share:.0f} % of the signal unexplained, so "
                    f"it is wrong in some important way.",
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
                    f"{', '.join(equation.parameters)} towards zero, by about {100 * share:.2g} %. "
                    f"Solve it after the equations that set their scale (riecjax.staged); where "
                    f"those do not determine them, hold one at a known value (on the command "
                    f"line: --set NAME=VALUE).",
                    parameters=equation.parameters,
                )
        yield from (*self.disagreement(), *self._coverage())
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
        if self.summary is not None and self.summary.asked is not None:
            alpha, beta = self.summary.asked
            low, high = self.summary.lengths_of(self.summary.band)
            yield Finding(
                "band_snapped",
                f"windows of {alpha:.4g} to {beta:.4g} s were asked for; sums are kept by bins of "
                f"length, and those from {low:.4g} to {high:.4g} s were taken. Summarise anew with "
                f"these as alpha and beta for exactly that band.",
            )
        yield from (*self.rarely_excited(), *self._precision())

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

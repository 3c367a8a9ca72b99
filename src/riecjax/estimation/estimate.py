"""What an identification found, and how far it can be trusted."""

from collections.abc import Iterator, Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Array, Float, Int

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.errors import ModelError
from riecjax.estimation.least_squares import gram_condition_limit
from riecjax.estimation.procedure import StageSolution
from riecjax.findings import Finding

FEWEST_BLOCKS = 10
MATTERING_SHARE = 0.02
"""Share of the target that an uncertain term must reach to be worth a warning."""
NOTABLE_INFLATION = 1.1
LARGE_RESIDUAL = 0.5
"""Share of the target past which a model is called wrong."""
_NO_MASS = "no mass is"
_NO_DAMPING = "damping that feeds energy into the motion"
NEVER_NEGATIVE = {
    **dict.fromkeys(("kg", "kgm2", "kgm2/rad", "Nms2/rad"), _NO_MASS),
    **dict.fromkeys(("Ns/m", "Nms/rad", "Nms"), _NO_DAMPING),
}
"""What it means that a parameter in this unit (without its blanks and signs) is below zero."""


class Estimate(eqx.Module):
    """Parameters with units and uncertainty, and how they were obtained.

    A pytree: `theta` and `covariance` differentiate and vmap. Reading values one by one works as
    with a mapping: `estimate["M_s"]`.

    **Fields:**

    - `theta`: estimated values, in the order of `parameters`.
    - `covariance`: block sandwich covariance of theta (see `block_sandwich`): valid under
      overlapping windows and autocorrelated equation errors. It speaks of scatter about the
      value that the criterion converges to, not of that value's distance from the truth.
    - `inflation`: factor on each standard error because recordings disagree, 1 where they agree.
    - `stages`: solution, conditioning and residual of each stage.
    - `known`: parameters that were not estimated, with their values.
    - `criterion`: what was made small.
    - `block_count`: independent blocks of time behind the covariance, scalar.
    - `rows_offered`: for each stage, how many rows there would be without gaps and masks, if
      that is known.
    """

    theta: Float[Array, " p"]
    covariance: Float[Array, "p p"]
    inflation: Float[Array, " p"]
    stages: tuple[StageSolution, ...]
    known: dict[str, Array]
    criterion: AbstractCriterion
    block_count: Int[Array, ""]
    parameters: tuple[str, ...] = eqx.field(static=True)
    units: tuple[tuple[str, str], ...] = eqx.field(static=True)
    stage_names: tuple[str, ...] = eqx.field(static=True)
    rows_offered: tuple[int | None, ...] = eqx.field(static=True)

    def __getitem__(self, name: str) -> Float[Array, ""]:
        if name in self.known:
            return self.known[name]
        return self.theta[self._index(name)]

    def __iter__(self) -> Iterator[str]:
        return iter((*self.parameters, *self.known))

    @property
    def values(self) -> Mapping[str, Array]:
        """Every parameter, estimated or known, by name."""
        return {name: self[name] for name in self}

    @property
    def standard_errors(self) -> Float[Array, " p"]:
        """Square roots of the covariance's diagonal."""
        return jnp.sqrt(jnp.diagonal(self.covariance))

    def standard_error(self, name: str) -> Float[Array, ""]:
        """Standard error of one estimated parameter."""
        return self.standard_errors[self._index(name)]

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval: Student's t with one degree of freedom less than blocks."""
        reach = self._quantile(level) * float(self.standard_error(name))
        value = float(self[name])
        return value - reach, value + reach

    @property
    def correlation(self) -> Float[Array, "p p"]:
        """Correlation matrix of theta."""
        errors = self.standard_errors
        return self.covariance / (errors[:, None] * errors[None, :])

    @property
    def condition_number(self) -> Float[Array, ""]:
        """The largest among the stages, of the regressors with columns scaled to unit length."""
        return jnp.max(jnp.stack([stage.solution.condition_number for stage in self.stages]))

    @property
    def rank(self) -> Array:
        """Sum of the stages' ranks; the number of parameters when all can be told apart."""
        return sum((stage.solution.rank for stage in self.stages), start=jnp.array(0))

    def findings(self) -> list[Finding]:
        """What a user should know before trusting this estimate (not under jit)."""
        return [
            *self._conditioning(),
            *self._wide_intervals(),
            *self._signs(),
            *self._residuals(),
            *self._disagreement(),
            *self._coverage(),
            *self._precision(),
        ]

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
        for name, size in zip(self.parameters, sizes):
            low, high = self.interval(name)
            # A parameter near zero is well determined if its term could not matter.
            matters = (high - low) / 2 * float(size) > MATTERING_SHARE
            if high - low > 2 * abs(float(self[name])) and matters:
                yield Finding(
                    "interval_wider_than_estimate",
                    f"the interval of {name} reaches from {low:.4g} to {high:.4g}: these data "
                    f"hardly determine it.",
                )

    def _signs(self) -> Iterator[Finding]:
        for name, unit in self.units:
            what = NEVER_NEGATIVE.get(
                "".join(c for c in unit if c not in " ·*^()").replace("²", "2")
            )
            if what is None or name not in self.parameters:
                continue
            low, high = self.interval(name)
            if high < 0:
                yield Finding(
                    "negative_value",
                    f"{name} is below zero, from {low:.4g} to {high:.4g} {unit}: {what}. Check the "
                    f"signs of the signals against the equation's, and the direction of time.",
                )

    def _residuals(self) -> Iterator[Finding]:
        for label, stage in zip(self.stage_names, self.stages):
            if float(stage.relative_rms) > LARGE_RESIDUAL:
                yield Finding(
                    "large_residual",
                    f"{label}: the model leaves {100 * float(stage.relative_rms):.0f} % of the "
                    f"signal unexplained, so it is wrong in some important way.",
                )

    def _disagreement(self) -> Iterator[Finding]:
        for name, factor in zip(self.parameters, self.inflation):
            if float(factor) > NOTABLE_INFLATION:
                yield Finding(
                    "records_disagree",
                    f"the recordings do not agree on {name}: they scatter more than the time "
                    f"within each of them explains, so its interval is {float(factor):.2g} times "
                    f"as wide. The model leaves out something that differs between them.",
                )

    def _coverage(self) -> Iterator[Finding]:
        for label, stage, offered in zip(self.stage_names, self.stages, self.rows_offered):
            lost = 0.0 if offered is None else 1 - float(stage.count) / offered
            if lost > 0:
                yield Finding(
                    "rows_left_out",
                    f"{label}: {100 * lost:.2g} % of the windows (or samples) touch a missing or "
                    f"masked sample and are left out.",
                )
        if int(self.block_count) < FEWEST_BLOCKS:
            yield Finding(
                "short_record",
                f"the record holds only {int(self.block_count)} independent stretches of twice "
                f"the longest window; intervals are rough. Record for longer or choose a "
                f"smaller beta.",
            )

    def _precision(self) -> Iterator[Finding]:
        if self.theta.dtype == jnp.float32:
            yield Finding(
                "single_precision",
                f"computed in 32-bit: rounding in the solve alone moves the parameters by a "
                f"share of about {self._rounding():.0e}, and signals with an offset by more. "
                f"Enable 64-bit by jax.config.update('jax_enable_x64', True).",
            )

    def weakest_combination(self) -> str:
        """The combination of parameters that the data tells least about, in words."""
        worst = max(self.stages, key=lambda stage: float(stage.solution.condition_number))
        return combination(worst.parameters, np.asarray(worst.solution.weakest_direction))

    def _index(self, name: str) -> int:
        try:
            return self.parameters.index(name)
        except ValueError:
            raise ModelError(
                f"no estimated parameter '{name}'; there are: {', '.join(self.parameters)}."
            ) from None

    def _rounding(self) -> float:
        """Relative error that the normal equations' rounding may cause: eps cond^2."""
        eps = float(jnp.finfo(self.theta.dtype).eps)
        return eps * max(float(self.condition_number), 10.0) ** 2

    def _quantile(self, level: float) -> float:
        return float(scipy.stats.t.ppf(0.5 + level / 2, max(int(self.block_count) - 1, 1)))

    def __str__(self) -> str:
        width = max(len(name) for name in self)
        units = dict(self.units)
        lines = [f"{'parameter':<{max(width, 9)}}  {'value':>12}  95 % interval"]
        for name in self.parameters:
            low, high = self.interval(name)
            unit = units.get(name, "")
            value = f"{float(self[name]):>12.6g}"
            lines.append(f"{name:<{max(width, 9)}}  {value}  [{low:.6g}, {high:.6g}] {unit}")
        for name, value in self.known.items():
            unit = units.get(name, "")
            lines.append(f"{name:<{max(width, 9)}}  {float(value):>12.6g}  known {unit}")
        lines.append(f"condition number {float(self.condition_number):.3g}")
        lines.extend(
            f"{label}: relative residual {100 * float(stage.relative_rms):.3g} %"
            for label, stage in zip(self.stage_names, self.stages)
        )
        lines.extend(f"warning [{code}] {message}" for code, message in self.findings())
        return "\n".join(lines)


def combination(names: tuple[str, ...], direction: Float[np.ndarray, " p"]) -> str:
    """A direction over parameters as `0.71 F_1 - 0.71 F_2`, small parts left out."""
    largest = np.max(np.abs(direction))
    parts = [(c, n) for c, n in zip(direction, names) if abs(c) > 0.1 * largest]
    if parts and parts[0][0] < 0:
        parts = [(-c, n) for c, n in parts]
    words = [f"{'-' if c < 0 else '+'} {abs(c):.2f} {n}" for c, n in parts]
    return " ".join(words).removeprefix("+ ")

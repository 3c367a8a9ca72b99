"""Parameters with units and uncertainty, however they were estimated."""

from collections.abc import Iterator, Mapping

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from riecjax.errors import ModelError
from riecjax.estimation.intervals import Uncertainty
from riecjax.findings import Finding
from riecjax.leaves import namespace

LOST_SHARE = 0.05
"""Share of the bootstrap's replicates that may leave a parameter undetermined."""
NOTABLE_INFLATION = 1.1
"""Factor on a standard error from which recordings are said to disagree."""
_NO_MASS = "no mass is"
_NO_DAMPING = "damping that feeds energy into the motion"
NEVER_NEGATIVE = {
    **dict.fromkeys(("kg", "kgm2", "kgm2/rad", "Nms2/rad"), _NO_MASS),
    **dict.fromkeys(("Ns/m", "Nms/rad", "Nms"), _NO_DAMPING),
}
"""What it means that a parameter in this unit (without its blanks and signs) is below zero."""


class AbstractEstimate(eqx.Module):
    """Estimated and known parameters, read one by one as from a mapping: `estimate["M_s"]`.

    **Fields:**

    - `theta`: estimated values, in the order of `parameters`, shape `(p,)`.
    - `uncertainty`: covariance of theta and what makes intervals.
    - `known`: parameters that were not estimated, with their values.
    - `parameters`: names of those that were estimated.
    - `units`: pairs of name and unit, of known parameters too.
    """

    theta: eqx.AbstractVar[Float[Array, " p"]]
    uncertainty: eqx.AbstractVar[Uncertainty]
    known: eqx.AbstractVar[dict[str, Array]]
    parameters: eqx.AbstractVar[tuple[str, ...]]
    units: eqx.AbstractVar[tuple[tuple[str, str], ...]]

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
    def covariance(self) -> Float[Array, "p p"]:
        """Covariance of theta."""
        return self.uncertainty.covariance

    @property
    def standard_errors(self) -> Float[Array, " p"]:
        """Square roots of the covariance's diagonal."""
        xp = namespace(self.covariance)
        return xp.sqrt(xp.diagonal(self.covariance))

    def standard_error(self, name: str) -> Float[Array, ""]:
        """Standard error of one estimated parameter."""
        return self.standard_errors[self._index(name)]

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval (not under jit); see [`Uncertainty.reach`][]."""
        index = self._index(name)
        below, above = self.uncertainty.reach(level)
        value, error = float(self[name]), float(self.standard_error(name))
        return value - float(below[index]) * error, value + float(above[index]) * error

    @property
    def correlation(self) -> Float[Array, "p p"]:
        """Correlation matrix of theta."""
        errors = self.standard_errors
        xp = namespace(errors)
        scale = xp.where(errors > 0, 1 / xp.where(errors > 0, errors, 1.0), 0.0)
        return self.covariance * scale[:, None] * scale[None, :]

    def negative_values(self) -> Iterator[Finding]:
        """Masses and dampers whose whole interval lies below zero (not under jit)."""
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

    def rarely_excited(self) -> Iterator[Finding]:
        """Parameters that many of the bootstrap's replicates leave undetermined (not under jit)."""
        replicates = self.uncertainty.studentized
        if replicates is None:
            return
        lost = np.mean(~np.isfinite(np.asarray(replicates)), axis=0)
        rare = [f"{n} ({100 * s:.2g} %)" for n, s in zip(self.parameters, lost) if s > LOST_SHARE]
        if rare:
            yield Finding(
                "rarely_excited",
                f"so few stretches of the record tell of {', '.join(rare)} that so large a share "
                f"of the bootstrap's replicates held none of them: their intervals are rough. "
                f"Record for longer, or excite them more often.",
            )

    def parameter_lines(self) -> Iterator[str]:
        """A table with value, interval and unit of each parameter (not under jit)."""
        width = max(9, *(len(name) for name in self))
        units = dict(self.units)
        yield f"{'parameter':<{width}}  {'value':>12}  95 % interval"
        for name in self:
            if name in self.known:
                reach = "known"
            else:
                low, high = self.interval(name)
                reach = f"[{low:.6g}, {high:.6g}]"
            line = f"{name:<{width}}  {float(self[name]):>12.6g}  {reach} {units.get(name, '')}"
            yield line.rstrip()

    def _index(self, name: str) -> int:
        try:
            return self.parameters.index(name)
        except ValueError:
            raise ModelError(
                f"no estimated parameter '{name}'; there are: {', '.join(self.parameters)}."
            ) from None

"""Parameters with units and uncertainty, however they were estimated."""

from collections.abc import Iterator, Mapping
from typing import Any, Self

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import ArrayLike

from riecjax.errors import ModelError
from riecjax.findings import Finding
from riecjax.leaves import is_concrete, namespace, on_host
from riecjax.shows import Saved
from riecjax.uncertainty.intervals import Uncertainty

LOST_SHARE = 0.05
"""Share of the bootstrap's replicates that may leave a parameter undetermined."""
NOTABLE_INFLATION = 1.1
"""Factor on a standard error from which recordings are said to disagree."""
NOTABLE_LEAN = 3.0
"""How many times as far as the small-sample sandwich an interval reaches before it is said why."""
_NO_MASS = "no mass is"
_NO_DAMPING = "damping that feeds energy into the motion"
NEVER_NEGATIVE = {
    **dict.fromkeys(("kg", "kgm2", "kgm2/rad", "Nms2/rad"), _NO_MASS),
    **dict.fromkeys(("Ns/m", "Nms/rad", "Nms"), _NO_DAMPING),
}
"""What it means that a parameter in this unit (without its blanks and signs) is below zero."""


class AbstractEstimate(Saved, eqx.Module):
    """Estimated and known parameters, read one by one as from a mapping: `estimate["M_s"]`.

    Of `jax.vmap` it is a batch: every array has the batch's axes first, whatever is read by name
    has the batch's shape, and `member` takes one estimate out.

    **Fields:**

    - `theta`: estimated values, in the order of `parameters`, shape `(..., p)`.
    - `uncertainty`: covariance of theta and what makes intervals.
    - `known`: parameters that were not estimated, with their values.
    - `parameters`: names of those that were estimated.
    - `units`: pairs of name and unit, of known parameters too.
    - `inflation`: factor on each standard error because recordings disagree, 1 where they agree.
    - `block_count`, `block_length`: independent blocks of time behind the covariance, and the
      seconds that each lasts.
    """

    theta: eqx.AbstractVar[Float[Array, "*batch p"]]
    uncertainty: eqx.AbstractVar[Uncertainty]
    known: eqx.AbstractVar[dict[str, Array]]
    inflation: eqx.AbstractVar[Float[Array, "*batch p"]]
    block_count: eqx.AbstractVar[Int[Array, "*batch"]]
    block_length: eqx.AbstractVar[Float[Array, "*batch"]]
    parameters: eqx.AbstractVar[tuple[str, ...]]
    units: eqx.AbstractVar[tuple[tuple[str, str], ...]]

    def __getitem__(self, name: str) -> Float[Array, "*batch"]:
        if name not in self.known:
            return self._of(self.theta, name)
        if not self.batch_shape:
            return _single(self.known[name])
        value, shape = self.known[name], self.batch_shape
        # What is known may be one value for all of a batch.
        return value if value.shape == shape else namespace(value).broadcast_to(value, shape)

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
        index = self._index(name)
        low, high = (ends[..., index] for ends in self.intervals(level))
        return (low, high) if self.batch_shape else (float(low), float(high))

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
            return host._findings()
        first: dict[str, Finding] = {}
        concerned: dict[str, int] = {}
        for place in np.ndindex(self.batch_shape):
            at = ", ".join(map(str, place))
            said = host.member(*place)._findings()
            for finding in said:
                message = f"first in member {at}: {finding.message}"
                first.setdefault(finding.code, finding._replace(message=message))
            for code in {finding.code for finding in said}:
                concerned[code] = concerned.get(code, 0) + 1
        size = int(np.prod(self.batch_shape))
        return [
            finding._replace(message=f"in {concerned[code]} of {size} members, {finding.message}")
            for code, finding in first.items()
        ]

    def _findings(self) -> list[Finding]:
        """Of one estimate."""
        raise NotImplementedError

    def negative_values(self) -> Iterator[Finding]:
        """Masses and dampers whose whole interval lies below zero (not under jit)."""
        ends = self.interval_by_name()
        for name, unit in self.units:
            what = NEVER_NEGATIVE.get(
                "".join(c for c in unit if c not in " ·*^()").replace("²", "2")
            )
            if what is None or name not in self.parameters:
                continue
            low, high = ends[name]
            if high < 0:
                yield Finding(
                    "negative_value",
                    f"{name} is below zero, from {low:.4g} to {high:.4g} {unit}: {what}. Check the "
                    f"signs of the signals against the equation's, and the direction of time.",
                    parameters=(name,),
                )

    def few_blocks(self) -> Iterator[Finding]:
        """Parameters whose intervals fell back to a small-sample sandwich (not under jit)."""
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

    def leaning(self) -> Iterator[Finding]:
        """Intervals that reach much farther than errors alike all along call for."""
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
        some = [
            (n, x)
            for n, x, of in zip(self.parameters, np.asarray(numbers), np.asarray(which))
            if of
        ]
        return tuple(n for n, _ in some), ", ".join(f"{n} ({x:.2g}{unit})" for n, x in some)

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

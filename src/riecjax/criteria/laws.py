"""The law of window lengths, w(T): how much each length counts when all windows are summed.

The paper draws T uniformly (eq. 14). Any other law is a weight for each length; running sums
handle a stretch of equally weighted lengths, a bin, at once, so a law is a list of bins. Only
ratios of weights matter to an estimate; they are scaled to 1 on average over all lags, so that sums
count windows whatever the law.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import ArrayLike

from riecjax.errors import ModelError, require
from riecjax.leaves import Leaf, as_leaf, is_concrete, namespace

Sums = TypeVar("Sums")


class LagBins(NamedTuple):
    """Stretches of window lengths that count alike.

    **Fields:** `first` and `last` lag of each bin, in multiples of samples, both included; empty
    where `last < first`; `weight` of each lag in it, 1 on average over all lags.
    """

    first: Int[Leaf, " bins"]
    last: Int[Leaf, " bins"]
    weight: Float[Leaf, " bins"]


class AbstractLaw(eqx.Module):
    """A weight for every window length from alpha to beta; only ratios of weights matter."""

    def bins(
        self,
        shortest: Float[Array, ""],
        longest: Float[Array, ""],
        unit: Float[Array, ""],
        most: int,
    ) -> LagBins:
        """The law in bins.

        **Arguments:** `shortest` and `longest` window in lags, to be rounded; `unit`, seconds to a
        lag; `most`, no lag is longer.
        """
        raise NotImplementedError

    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""
        raise NotImplementedError


class UniformLaw(AbstractLaw):
    """Every length alike: eq. (14)."""

    def bins(
        self,
        shortest: Float[Array, ""],
        longest: Float[Array, ""],
        unit: Float[Array, ""],
        most: int,
    ) -> LagBins:
        """One bin."""
        xp = namespace(shortest, longest, unit)
        first, last = rounded(shortest), rounded(longest)
        return LagBins(first[None], last[None], xp.ones(1, unit.dtype))

    def describe(self) -> dict[str, object]:
        """Nothing: it is what one expects."""
        return {}


class SteppedLaw(AbstractLaw):
    """Weights that are constant over equal parts of the band from alpha to beta.

    Differentiable in `weights`. The cost grows with their number, not with the number of lengths.

    **Arguments:** `weights`, shape `(bins,)`, from the shortest windows to the longest.

    **Raises:** `ModelError` for weights below zero, not finite, or all zero.
    """

    weights: Leaf

    def __init__(self, weights: ArrayLike | Array):
        self.weights = _weights(weights)

    def bins(
        self,
        shortest: Float[Array, ""],
        longest: Float[Array, ""],
        unit: Float[Array, ""],
        most: int,
    ) -> LagBins:
        """One bin for each weight."""
        low, high = rounded(shortest), rounded(longest)
        share = jnp.linspace(0.0, 1.0, self.weights.shape[0] + 1)
        # Real numbers: lags times bins may pass 32-bit integers.
        first = low + rounded(share * (high - low + 1))
        return _normalised(first[:-1], first[1:] - 1, jnp.asarray(self.weights, unit.dtype))

    def describe(self) -> dict[str, object]:
        """The weights."""
        return {"law": np.asarray(self.weights).tolist()}


class DensityLaw(AbstractLaw):
    """A weight from any function of the length.

    Exact: every length on samples has its own weight, and the cost grows with their number.

    **Arguments:** `density`, from lengths in seconds, shape `(lengths,)`, to weights of the same
    shape; an `eqx.Module` if its parameters are to be differentiated.
    """

    density: Callable[[Float[Array, " lengths"]], Float[Array, " lengths"]]

    def bins(
        self,
        shortest: Float[Array, ""],
        longest: Float[Array, ""],
        unit: Float[Array, ""],
        most: int,
    ) -> LagBins:
        """One bin for each lag.

        **Raises:** `ModelError` for weights below zero, not finite, or all zero (not under jit).
        """
        high = rounded(longest)
        lag = rounded(shortest) + jnp.arange(most)
        weight = self._at(jnp.minimum(lag, high) * unit)
        _require_weights(weight)
        return _normalised(lag, jnp.where(lag <= high, lag, lag - 1), weight)

    def _at(self, lengths: Float[Array, " lengths"]) -> Float[Array, " lengths"]:
        return jnp.broadcast_to(jnp.asarray(self.density(lengths), lengths.dtype), lengths.shape)

    def describe(self) -> dict[str, object]:
        """The function's name."""
        name = getattr(self.density, "__name__", type(self.density).__name__)
        return {"law": name}


def as_law(law: "AbstractLaw | ArrayLike | Callable[[Array], Array] | None") -> AbstractLaw:
    """A law from what a user may give: weights, a function of the length, or nothing."""
    if law is None:
        return UniformLaw()
    if isinstance(law, AbstractLaw):
        return law
    if isinstance(law, str | type):
        write = "law=[1, 2, 1], weights from the shortest windows to the longest, or leave it out"
        require("the law", law, (), f"{write} for lengths that count alike")
    return DensityLaw(law) if callable(law) else SteppedLaw(law)


def rounded(lags: Float[Array, "*shape"]) -> Int[Array, "*shape"]:
    """The nearest whole numbers."""
    return namespace(lags).round(lags).astype(np.int32)


def _normalised(first: Array, last: Array, weight: Array) -> LagBins:
    held = (last - first + 1).astype(weight.dtype)
    return LagBins(first, last, weight * (jnp.sum(held) / jnp.sum(weight * held)))


def _weights(weights: ArrayLike | Array) -> Leaf:
    found = as_leaf(weights)
    if found.ndim != 1 or not found.shape[0]:
        raise ModelError("a law of window lengths in parts needs a list of weights.")
    _require_weights(found)
    return found


def _require_weights(weights: Leaf) -> None:
    if not is_concrete(weights):
        return
    values = np.asarray(weights)
    if not (np.isfinite(values).all() and (values >= 0).all() and values.any()):
        raise ModelError(
            "a law of window lengths needs weights of zero or more, not all zero, and finite."
        )


def sum_over_bins(bins: LagBins, of_bin: Callable[[LagBins], Sums]) -> Sums:
    """What all bins of a law add up to.

    Of a single bin without a loop, which would be run for each equation: what several equations
    have in common is then computed once.
    """

    def add(total: Sums, bin_: LagBins) -> tuple[Sums, None]:
        return jax.tree.map(jnp.add, total, of_bin(bin_)), None

    total = of_bin(jax.tree.map(lambda values: values[0], bins))
    if bins.first.shape[0] == 1:
        return total
    # In reverse mode each bin is computed again: storing all would take bins x columns x samples.
    rest = jax.tree.map(lambda values: values[1:], bins)
    return jax.lax.scan(jax.checkpoint(add), total, rest)[0]


def sum_over_lengths(
    of_length: Callable[[Leaf, Leaf], Any], lengths: tuple[Leaf, Leaf], nothing: Any
) -> Any:
    """Sum of arrays that are made of each length and its weight, one after the other.

    **Arguments:** `nothing`, the sum of none; a length of weight zero adds that, and takes no time.
    """

    def add(total: Any, which: tuple[Array, Array]) -> tuple[Any, None]:
        added = jax.lax.cond(which[1] != 0, of_length, lambda *_: nothing, *which)
        return jax.tree.map(jnp.add, total, added), None

    length, weight = lengths
    return jax.lax.scan(add, nothing, (jnp.asarray(length), jnp.asarray(weight)))[0]

"""The law of window lengths, w(T): how much each length counts when all windows are summed.

The paper draws T uniformly (eq. 14). Any other law is a weight for each length; running sums
handle a stretch of equally weighted lengths, a bin, at once, so a law is a list of bins.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import ArrayLike

from riecjax.errors import ModelError
from riecjax.leaves import Leaf, as_leaf, is_concrete, namespace


class LagBins(NamedTuple):
    """Stretches of window lengths that count alike.

    **Fields:** `first` and `last` lag of each bin, in multiples of samples, both included; empty
    where `last < first`; `weight` of each lag in it, 1 on average over all lags.
    """

    first: Int[Array, " bins"]
    last: Int[Array, " bins"]
    weight: Float[Array, " bins"]


class AbstractLaw(eqx.Module):
    """A weight for every window length from alpha to beta; only ratios of weights matter."""

    def bins(
        self, shortest: Int[Array, ""], longest: Int[Array, ""], unit: Float[Array, ""], most: int
    ) -> LagBins:
        """The law in bins.

        **Arguments:** `shortest` and `longest` lag; `unit`, seconds to a lag; `most`, no lag is
        longer.
        """
        raise NotImplementedError

    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""
        raise NotImplementedError


class UniformLaw(AbstractLaw):
    """Every length alike: eq. (14)."""

    def bins(
        self, shortest: Int[Array, ""], longest: Int[Array, ""], unit: Float[Array, ""], most: int
    ) -> LagBins:
        """One bin."""
        return LagBins(shortest[None], longest[None], namespace(unit).ones(1, unit.dtype))

    def describe(self) -> dict[str, object]:
        """Nothing: it is what one expects."""
        return {}


class SteppedLaw(AbstractLaw):
    """Weights that are constant over equal parts of the band from alpha to beta.

    Differentiable in `weights`, so that a law can be learned. The cost grows with their number,
    not with the number of lengths.

    **Arguments:** `weights`, shape `(bins,)`, from the shortest windows to the longest.

    **Raises:** `ModelError` for weights below zero, not finite, or all zero.
    """

    weights: Leaf

    def __init__(self, weights: ArrayLike | Array):
        self.weights = _weights(weights)

    def bins(
        self, shortest: Int[Array, ""], longest: Int[Array, ""], unit: Float[Array, ""], most: int
    ) -> LagBins:
        """One bin for each weight."""
        count = self.weights.shape[0]
        # Real numbers: lags times bins may pass 32-bit integers.
        edges = jnp.round(jnp.linspace(0.0, 1.0, count + 1) * (longest - shortest + 1))
        first = shortest + edges[:-1].astype(shortest.dtype)
        last = shortest + edges[1:].astype(shortest.dtype) - 1
        return _normalised(first, last, jnp.asarray(self.weights, unit.dtype))

    def describe(self) -> dict[str, object]:
        """The weights."""
        return {"law": np.asarray(self.weights).tolist()}


class RatioLaw(AbstractLaw):
    """Weights that are constant over parts of the band in equal ratios of length.

    An octave of lengths is an octave of frequencies (T = 1 / (2 f), eq. 26), so that a wide band
    needs few parts. Differentiable in `weights`.

    **Arguments:** `weights` of each length in a part, shape `(parts,)`, from the shortest windows
    to the longest.

    **Raises:** `ModelError` for weights below zero, not finite, or all zero.
    """

    weights: Leaf

    def __init__(self, weights: ArrayLike | Array):
        self.weights = _weights(weights)

    def bins(
        self, shortest: Int[Array, ""], longest: Int[Array, ""], unit: Float[Array, ""], most: int
    ) -> LagBins:
        """One bin for each part; empty where it holds no length on samples."""
        count = self.weights.shape[0]
        low = shortest.astype(unit.dtype)
        ratio = (longest.astype(unit.dtype) + 1) / low
        edges = jnp.round(low * ratio ** (jnp.arange(count + 1) / count)).astype(shortest.dtype)
        return _normalised(edges[:-1], edges[1:] - 1, jnp.asarray(self.weights, unit.dtype))

    def describe(self) -> dict[str, object]:
        """The weights."""
        return {"law": np.asarray(self.weights).tolist(), "parts": "equal ratios"}


class DensityLaw(AbstractLaw):
    """A weight from any function of the length.

    Exact: every length on samples has a weight of its own, and the cost grows with their number.

    **Arguments:** `density`, from lengths in seconds, shape `(lengths,)`, to weights of the same
    shape; an `eqx.Module` if its parameters are to be differentiated.
    """

    density: Callable[[Float[Array, " lengths"]], Float[Array, " lengths"]]

    def bins(
        self, shortest: Int[Array, ""], longest: Int[Array, ""], unit: Float[Array, ""], most: int
    ) -> LagBins:
        """One bin for each lag.

        **Raises:** `ModelError` for weights below zero, not finite, or all zero (not under jit).
        """
        lag = shortest + jnp.arange(most)
        inside = lag <= longest
        length = jnp.minimum(lag, longest) * unit
        weight = jnp.broadcast_to(jnp.asarray(self.density(length), unit.dtype), (most,))
        _require_weights(weight)
        return _normalised(lag, jnp.where(inside, lag, lag - 1), weight)

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
    return DensityLaw(law) if callable(law) else SteppedLaw(law)


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

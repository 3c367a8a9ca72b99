"""The law of window lengths, w(T): how much each length counts when all windows are summed.

The paper draws T uniformly (eq. 14). Any other law is a weight for each length; running sums
handle a stretch of equally weighted lengths, a bin, at once, so a law is a list of bins. Only
ratios of weights matter to an estimate; they are scaled to 1 on average over all lags, so that sums
count windows whatever the law.

**Derivatives by alpha and beta.** Lengths are rounded to samples, so that a sum over lags,
S = sum_k w[k] M[k] with M[k] the moments of lag k, is a staircase in alpha and beta: its derivative
is zero nearly everywhere and useless to an optimiser. Let instead M(k) be linear between lags and
the law reach from half a lag below the shortest to half a lag above the longest, so that each lag
stands for an interval of length 1. The integral I = integral w(k) M(k) dk then has at an edge e,
where w jumps from w_below to w_above, the derivative

    dI / de = (w_below - w_above) M(e) = jump ((1 - f) M[i] + f M[i + 1]),    e = i + f

An edge between samples, alpha and beta being on them, has f = 1 / 2: the mean of the two lags
beside it, which is the central difference of S over one sample to either side. So the two lags get
weights that are zero and have the derivatives jump (1 - f) and jump f. The second derivative of the
linear M(k) comes out as well where these weights are written as integrals of 1 - f and f:
`LagBins.with_edges_as_bins`.
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


class Edges(NamedTuple):
    """Where the weight of a law jumps: all that alpha and beta move.

    **Fields:** `position` in lags, a real number; `jump`, the weight of lags below it less that of
    lags above it.
    """

    position: Float[Array, " edges"]
    jump: Float[Array, " edges"]


class LagBins(NamedTuple):
    """Stretches of window lengths that count alike.

    **Fields:** `first` and `last` lag of each bin, in multiples of samples, both included; empty
    where `last < first`; `weight` of each lag in it, 1 on average over all lags; `edges` of the law
    before it is rounded to lags, for derivatives by alpha and beta only.
    """

    first: Int[Leaf, " bins"]
    last: Int[Leaf, " bins"]
    weight: Float[Leaf, " bins"]
    edges: Edges | None = None

    def with_edges_as_bins(self, most: int) -> "LagBins":
        """The same law, whose weights hold what its edges move.

        A sum over lags S = sum_k w[k] M[k] is a staircase in the position e of an edge. Let M(k) be
        linear between lags; the integral of w(k) M(k) then has the derivative jump M(e), which on
        samples is the central difference of S over one sample to either side. So the lags next to
        an edge get weights that are zero, with the derivatives of

            jump (d - d'),  jump d',    d = e - e0,  d' = (f^2 - f0^2) / 2,  f = e - floor(e0)

        where e0 is the edge's position, not differentiated, and f0 the share f there.

        **Arguments:** `most`, no lag is longer.
        """
        assert self.edges is not None
        position, jump = self.edges
        below = jnp.floor(jax.lax.stop_gradient(position))
        share = position - below
        moved = _change(share)
        above = _change(0.5 * share**2)
        lag = jnp.concatenate([below, below + 1]).astype(self.first.dtype)
        lag = jnp.clip(lag, 1, most)
        weight = jnp.concatenate([jump * (moved - above), jump * above])
        return LagBins(
            jnp.concatenate([self.first, lag]),
            jnp.concatenate([self.last, lag]),
            jnp.concatenate([self.weight, weight.astype(self.weight.dtype)]),
        )


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
        edges = Edges(xp.stack([shortest - 0.5, longest + 0.5]), xp.asarray([-1.0, 1.0]))
        return LagBins(first[None], last[None], xp.ones(1, unit.dtype), edges)

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
        position = shortest - 0.5 + share * (longest - shortest + 1)
        weight = jnp.asarray(self.weights, unit.dtype)
        return _normalised(first[:-1], first[1:] - 1, weight, Edges(position, _jumps(weight)))

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
        self,
        shortest: Float[Array, ""],
        longest: Float[Array, ""],
        unit: Float[Array, ""],
        most: int,
    ) -> LagBins:
        """One bin for each part; empty where it holds no length on samples."""
        count = self.weights.shape[0]
        share = jnp.arange(count + 1) / count

        def edges(low: Array, high: Array) -> Float[Array, " edges"]:
            low, high = low.astype(unit.dtype), high.astype(unit.dtype)
            return low * ((high + 1) / low) ** share

        first = rounded(edges(rounded(shortest), rounded(longest)))
        position = edges(jnp.asarray(shortest), jnp.asarray(longest)) - 0.5
        weight = jnp.asarray(self.weights, unit.dtype)
        return _normalised(first[:-1], first[1:] - 1, weight, Edges(position, _jumps(weight)))

    def describe(self) -> dict[str, object]:
        """The weights."""
        return {"law": np.asarray(self.weights).tolist(), "parts": "equal ratios"}


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
        position = jnp.stack([shortest - 0.5, longest + 0.5])
        edges = Edges(position, self._at(position * unit) * np.array([-1.0, 1.0]))
        return _normalised(lag, jnp.where(lag <= high, lag, lag - 1), weight, edges)

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


def _normalised(first: Array, last: Array, weight: Array, edges: Edges) -> LagBins:
    held = (last - first + 1).astype(weight.dtype)
    moved = _change(edges.position)
    number = jnp.sum(held) + moved[-1] - moved[0]
    scale = number / (jnp.sum(weight * held) + jnp.sum(edges.jump * moved))
    return LagBins(first, last, weight * scale, Edges(edges.position, edges.jump * scale))


def _jumps(weight: Float[Array, " bins"]) -> Float[Array, " edges"]:
    """At the edges of bins that follow one another."""
    return -jnp.diff(jnp.pad(weight, 1))


def _change(value: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Zero, with the derivatives of the value."""
    return value - jax.lax.stop_gradient(value)


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

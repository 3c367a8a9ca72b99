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
Scalar = Float[Array, ""]


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

    def bins(self, shortest: Scalar, longest: Scalar, unit: Scalar, most: int) -> LagBins:
        """The law in bins.

        **Arguments:** `shortest` and `longest` window in lags, to be rounded; `unit`, seconds to a
        lag; `most`, no lag is longer.
        """
        raise NotImplementedError

    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON: nothing of what one expects."""
        return {}


class UniformLaw(AbstractLaw):
    """Every length alike: eq. (14)."""

    def bins(self, shortest: Scalar, longest: Scalar, unit: Scalar, most: int) -> LagBins:
        """One bin."""
        xp = namespace(shortest, longest, unit)
        first, last = rounded(shortest), rounded(longest)
        return LagBins(first[None], last[None], xp.ones(1, unit.dtype))


class SteppedLaw(AbstractLaw):
    """Weights that are constant over equal parts of the band from alpha to beta.

    Differentiable in `weights`. The cost grows with their number, not with the number of lengths.

    **Arguments:** `weights`, shape `(bins,)`, from the shortest windows to the longest.

    **Raises:** `ModelError` for weights below zero, not finite, or all zero.
    """

    weights: Leaf

    def __init__(self, weights: ArrayLike | Array):
        self.weights = as_leaf(weights)
        if self.weights.ndim != 1 or not self.weights.shape[0]:
            raise ModelError("a law of window lengths in parts needs a list of weights.")
        values = np.asarray(self.weights) if is_concrete(self.weights) else np.ones(1)
        if not (np.isfinite(values).all() and (values >= 0).all() and values.any()):
            raise ModelError(
                "a law of window lengths needs weights of zero or more, not all zero, and finite."
            )

    def bins(self, shortest: Scalar, longest: Scalar, unit: Scalar, most: int) -> LagBins:
        """One bin for each weight."""
        low, high = rounded(shortest), rounded(longest)
        share = jnp.linspace(0.0, 1.0, self.weights.shape[0] + 1)
        # Real numbers: lags times bins may pass 32-bit integers.
        first = low + rounded(share * (high - low + 1))
        first, last, weight = first[:-1], first[1:] - 1, jnp.asarray(self.weights, unit.dtype)
        held = (last - first + 1).astype(weight.dtype)
        return LagBins(first, last, weight * (jnp.sum(held) / jnp.sum(weight * held)))

    def describe(self) -> dict[str, object]:
        """The weights."""
        return {"law": np.asarray(self.weights).tolist()}


def as_law(law: "AbstractLaw | ArrayLike | None") -> AbstractLaw:
    """A law from what a user may give: weights, or nothing."""
    if law is None:
        return UniformLaw()
    if isinstance(law, AbstractLaw):
        return law
    if isinstance(law, str | type) or callable(law):
        write = "law=[1, 2, 1], weights from the shortest windows to the longest, or leave it out"
        require("the law", law, (), f"{write} for lengths that count alike")
    return SteppedLaw(law)


def rounded(lags: Float[Array, "*shape"]) -> Int[Array, "*shape"]:
    """The nearest whole numbers."""
    return namespace(lags).round(lags).astype(np.int32)


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


# Bins of window lengths whose sums are kept apart, so that a band can be chosen afterwards.


MOST_BINS = 2**10
"""Bins of window lengths: memory grows with each, and neighbours hardly differ."""


class LengthBins(NamedTuple):
    """Stretches of window lengths in seconds, among whose edges are alpha and beta.

    **Fields:** `edges`, ascending, shape `(bins + 1,)`; `band`, first bin from alpha on and first
    one beyond beta.
    """

    edges: Float[np.ndarray, " bins+1"]
    band: tuple[int, int]

    @classmethod
    def of(cls, alpha: float, beta: float, bins: int | ArrayLike) -> "LengthBins":
        """So many bins from alpha to beta, in equal ratios; or with these edges, in seconds, and
        with alpha and beta.

        **Raises:** `ModelError` for fewer than one, for too many, and unless edges are positive
        and finite.
        """
        edges = None
        if isinstance(bins, int | np.integer):
            number = int(bins)
            if number < 1:
                raise ModelError(f"there must be one bin of window lengths at least; got {number}.")
        else:
            edges = np.asarray(bins, float).ravel()
            number = edges.size - 1
            if not (np.isfinite(edges).all() and (edges > 0).all()):
                raise ModelError("edges of bins of window lengths are positive numbers of seconds.")
        if number > MOST_BINS:
            raise ModelError(
                f"sums of {number} bins of window lengths would take too much memory: give at most "
                f"{MOST_BINS}, bins=12 as a rule."
            )
        edges = np.geomspace(alpha, beta, number + 1) if edges is None else edges
        # Edges that are alpha or beta but for rounding would make bins of nothing.
        near = np.isclose(edges, alpha, rtol=1e-9) | np.isclose(edges, beta, rtol=1e-9)
        every = np.unique([*edges[~near], alpha, beta])
        first, last = np.searchsorted(every, [alpha, beta])
        return cls(every, (int(first), int(last)))

    def lags(
        self, unit: float, most: int
    ) -> tuple[Int[np.ndarray, " bins"], Int[np.ndarray, " bins"]]:
        """First and last lag of each bin, in multiples of samples of `unit` seconds.

        The band's ends both belong to it, so that bins below it hold their lower edge and those
        above their upper one. None is longer than `most`; empty where `last < first`.
        """
        edges = np.maximum(np.round(self.edges / unit), 1).astype(int)
        bins = np.arange(edges.size - 1)
        start, _ = self.band
        first = edges[:-1] + (bins > start)
        last = edges[1:] - (bins < start)
        return first, np.minimum(last, most)

    def nearest(self, alpha: float, beta: float) -> tuple[int, int]:
        """The bins, first and one beyond the last, whose edges are nearest in ratio to a band's.

        **Raises:** `ModelError` unless 0 < alpha < beta.
        """
        if not 0 < alpha < beta:
            raise ModelError(f"a band needs 0 < alpha < beta; got {alpha:g} to {beta:g} s.")
        first, last = (
            int(np.argmin(np.abs(np.log(self.edges / length)))) for length in (alpha, beta)
        )
        if first == last:
            # Of one bin at least: the one that holds the middle of the band.
            middle = np.searchsorted(self.edges, np.sqrt(alpha * beta)) - 1
            first = int(np.clip(middle, 0, self.edges.size - 2))
            last = first + 1
        return first, last


def law_in_bins(law: LagBins, bins: LengthBins, unit: float, most: int) -> LagBins:
    """A law of lags, cut into bins: two axes, bins and what each holds of the law.

    Inside the band lengths count by the law; beyond it all alike.
    """
    low, high = (ends[:, None] for ends in bins.lags(unit, most))
    at, law = np.arange(low.size)[:, None], LagBins(*map(np.asarray, law))
    inside = (bins.band[0] <= at) & (at < bins.band[1])
    begin = np.where(inside, np.maximum(law.first, low), low)
    end = np.where(inside, np.minimum(law.last, high), high)
    weight = np.where(inside, law.weight, 1.0)
    # Beyond the band the first entry has all of a bin.
    held = (begin <= end) & (inside | (np.arange(law.first.size) == 0))
    parts = (np.where(held, *of) for of in ((begin, 1), (end, 0), (weight, 0.0)))
    return LagBins(*(part.astype(leaf.dtype) for part, leaf in zip(parts, law)))


def each_bin(of_lags: Callable[[LagBins], Any], lags: LagBins) -> Any:
    """What is made of a law; of one in bins, of each bin, along a leading axis."""
    if lags.first.ndim == 1:
        return of_lags(lags)
    if lags.first.shape[0] == 1:
        one = of_lags(jax.tree.map(lambda leaf: leaf[0], lags))
        return jax.tree.map(lambda leaf: leaf[None], one)
    return jax.lax.map(of_lags, lags)

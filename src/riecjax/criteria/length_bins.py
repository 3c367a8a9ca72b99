"""Bins of window lengths whose sums are kept apart, so that a band can be chosen afterwards."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from riecjax.criteria.laws import LagBins
from riecjax.errors import ModelError


class LengthBins(NamedTuple):
    """Stretches of window lengths in seconds, among whose edges are alpha and beta.

    **Fields:** `edges`, ascending, shape `(bins + 1,)`; `band`, first bin from alpha on and first
    one beyond beta.
    """

    edges: Float[np.ndarray, " bins+1"]
    band: tuple[int, int]

    @classmethod
    def around(cls, alpha: float, beta: float, edges: ArrayLike) -> "LengthBins":
        """Bins with these edges, in seconds, and with alpha and beta.

        **Raises:** `ModelError` unless edges are positive and finite.
        """
        given = np.asarray(edges, float).ravel()
        if not (np.isfinite(given).all() and (given > 0).all()):
            raise ModelError("edges of bins of window lengths are positive numbers of seconds.")
        # Edges that are alpha or beta but for rounding would make bins of nothing.
        near = np.isclose(given, alpha, rtol=1e-9) | np.isclose(given, beta, rtol=1e-9)
        every = np.unique([*given[~near], alpha, beta])
        first, last = np.searchsorted(every, [alpha, beta])
        return cls(every, (int(first), int(last)))

    @classmethod
    def of_number(cls, alpha: float, beta: float, number: int) -> "LengthBins":
        """So many bins from alpha to beta, in equal ratios.

        **Raises:** `ModelError` for fewer than one.
        """
        if number < 1:
            raise ModelError(f"there must be one bin of window lengths at least; got {number}.")
        return cls.around(alpha, beta, np.geomspace(alpha, beta, number + 1))

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
    first, last = bins.lags(unit, most)
    parts = [np.asarray(leaf) for leaf in (law.first, law.last, law.weight)]
    cut = []
    for i, (low, high) in enumerate(zip(first, last)):
        if bins.band[0] <= i < bins.band[1]:
            begin, end = np.maximum(parts[0], low), np.minimum(parts[1], high)
            held = begin <= end
            cut.append((begin[held], end[held], parts[2][held]))
        else:
            cut.append((np.array([low]), np.array([high]), np.ones(1, parts[2].dtype)))
    # As many entries for recordings of any length, or each would be compiled for.
    room = 1 if parts[0].size == 1 else 2 ** int(np.ceil(np.log2(parts[0].size)))

    def filled(place: int, nothing: float) -> np.ndarray:
        rows = [np.pad(c[place], (0, room - c[place].size), constant_values=nothing) for c in cut]
        return np.stack(rows).astype(parts[place].dtype)

    return LagBins(filled(0, 1), filled(1, 0), filled(2, 0.0))


def each_bin(of_lags: Callable[[LagBins], Any], lags: LagBins) -> Any:
    """What is made of a law; of one in bins, of each bin, along a leading axis."""
    if lags.first.ndim == 1:
        return of_lags(lags)
    if lags.first.shape[0] == 1:
        one = of_lags(jax.tree.map(lambda leaf: leaf[0], lags))
        return jax.tree.map(lambda leaf: leaf[None], one)
    return jax.lax.map(of_lags, lags)

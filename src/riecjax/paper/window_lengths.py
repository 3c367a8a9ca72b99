"""Sensitivity of the variant B_id to alpha and beta (Section 4, on Table 2's choice), as a map.

All windows of each pair of lengths at once, so that no sampling noise blurs the map.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import AllWindows
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.published import TABLE_2
from riecjax.paper.reproduction import identification_record, road_keys
from riecjax.paper.variations import by_body
from riecjax.records.record import Record
from riecjax.studies.monte_carlo import over_keys

LENGTHS = (0.01, 0.02, 0.035, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0)
"""Of windows in seconds, for alpha and for beta; in whole samples of 5 ms."""


class LengthMap(eqx.Module):
    """Parameters over pairs of window lengths in seconds, on several roads."""

    alpha: Float[Array, " pairs"]
    beta: Float[Array, " pairs"]
    theta: Float[Array, "roads pairs parameters"]

    @property
    def of_table_2(self) -> int:
        """Place of the pair that Table 2 has."""
        alpha, beta = np.asarray(self.alpha), np.asarray(self.beta)
        return int(np.argmin(np.abs(alpha - TABLE_2.alpha) + np.abs(beta - TABLE_2.beta)))


def length_map(key: Key[Array, ""], source: QuarterCarSource, roads: int) -> LengthMap:
    """All pairs of `LENGTHS`, and each length almost alone: with one a sample longer."""
    step = 1 / TABLE_2.rate
    pairs = [(a, b) for a in LENGTHS for b in LENGTHS if a < b] + [(a, a + step) for a in LENGTHS]
    alpha, beta = (jnp.array(side) for side in zip(*pairs))
    theta = over_keys(estimates_over_lengths, key, roads, source, alpha, beta)
    return LengthMap(alpha, beta, theta)


def estimates_over_lengths(
    key: Key[Array, ""],
    source: QuarterCarSource,
    alpha: Float[Array, " pairs"],
    beta: Float[Array, " pairs"],
) -> Float[Array, "pairs parameters"]:
    """Parameters in the order of `PARAMETERS` on one random road; vmap over keys for many."""
    record = identification_record(source, road_keys(key).training).record
    return jax.lax.map(lambda pair: _estimate(record, pair[0], pair[1]), (alpha, beta))


def _estimate(
    record: Record, alpha: Float[Array, ""], beta: Float[Array, ""]
) -> Float[Array, " parameters"]:
    longest = round(max(LENGTHS) * TABLE_2.rate) + 1
    windows = AllWindows(alpha, beta, longest_samples=longest)
    return by_body(record, RIEC(windows))

"""What a statement of the paper rests on: numbers with intervals, and the limits they must keep."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

RESAMPLES = 500
SEED = 1999


class Evidence(NamedTuple):
    """A number that supports a statement or refutes it.

    **Fields:** `what` it is; `value`; `interval`, 95 % over resampled roads (`None`: the number is
    not random); `at_least` and `at_most`, between which it must lie.
    """

    what: str
    value: float
    interval: tuple[float, float] | None = None
    at_least: float | None = None
    at_most: float | None = None

    @property
    def holds(self) -> bool:
        """Whether the value keeps its limits; not a number keeps none."""
        above = self.at_least is None or self.value >= self.at_least
        below = self.at_most is None or self.value <= self.at_most
        return bool(np.isfinite(self.value) and above and below)


class Claim(NamedTuple):
    """A statement of the paper, and the numbers that decide it.

    **Fields:** `id` in the list of 17; `statement`; `evidence`; `note`, how it is read here, and
    what explains it where it does not hold.
    """

    id: int
    statement: str
    evidence: tuple[Evidence, ...]
    note: str = ""

    @property
    def holds(self) -> bool:
        """Whether all evidence keeps its limits."""
        return all(each.holds for each in self.evidence)


def over_roads(
    what: str,
    statistic: Callable[..., float],
    *arrays: object,
    at_least: float | None = None,
    at_most: float | None = None,
) -> Evidence:
    """A statistic of arrays whose first axis is the roads, and its interval.

    The interval holds 95 % of the statistic over roads drawn anew, with replacement.
    """
    columns = [np.asarray(array) for array in arrays]
    count = columns[0].shape[0]
    draws = np.random.default_rng(SEED).integers(0, count, (RESAMPLES, count))
    values = [statistic(*(column[draw] for column in columns)) for draw in draws]
    low, high = np.nanquantile(values, [0.025, 0.975])
    value = float(statistic(*columns))
    return Evidence(what, value, (float(low), float(high)), at_least, at_most)


def ratio_of_means(above: np.ndarray, below: np.ndarray) -> float:
    """Of two arrays over roads."""
    return float(np.mean(above) / np.mean(below))

"""Tails of the distributions that tests and intervals need, from SciPy's special functions.

`scipy.stats` has them all, and takes most of a second to import.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.special
from numpy.typing import ArrayLike


def normal(tail: ArrayLike) -> Any:
    """The value that a standard normal number exceeds with this probability."""
    return -scipy.special.ndtri(tail)


def student(tail: float, freedom: ArrayLike) -> np.ndarray:
    """The value that Student's t with these degrees of freedom exceeds with this probability."""
    return -scipy.special.stdtrit(np.asarray(freedom, float), tail)


def chi_square(tail: float, freedom: float) -> float:
    """The value that chi-square with these degrees of freedom exceeds with this probability."""
    return float(scipy.special.chdtri(freedom, tail))


def equal_means(groups: Sequence[np.ndarray]) -> float:
    """p-value of one-way analysis of variance: whether groups have one mean; NaN if all agree."""
    count = sum(group.size for group in groups)
    overall = sum(float(np.sum(group)) for group in groups) / count
    between = sum(group.size * (float(np.mean(group)) - overall) ** 2 for group in groups)
    within = sum(float(np.sum((group - np.mean(group)) ** 2)) for group in groups)
    above, below = len(groups) - 1, count - len(groups)
    if below < 1 or within == 0:
        return 0.0 if between > 0 else float("nan")
    return float(scipy.special.fdtrc(above, below, between / above / (within / below)))

"""An input known at samples, as a function of time for SciPy."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float


def first_order_hold(values: Float[np.ndarray, " n"], rate: float) -> Callable[[float], float]:
    """Straight lines between samples; the interval is found by its number, not by a search."""
    # Lists of Python's own numbers are read faster than single elements of arrays.
    levels = values.tolist()
    rises = np.diff(values, append=values[-1]).tolist()

    def value(time: float) -> float:
        position = time * rate
        below = int(position)
        return levels[below] + (position - below) * rises[below]

    return value

"""Missing samples of columns of numbers: masks of them, and what stands in their place."""

from collections.abc import Mapping

import numpy as np


def gaps(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Masks, shape `(n,)`, True where a column is NaN; only of columns that hold a NaN."""
    masks = {name: np.isnan(values) for name, values in columns.items()}
    return {name: mask for name, mask in masks.items() if mask.any()}


def hold(values: np.ndarray) -> np.ndarray:
    """NaN replaced by the last value before it, at the start by the first after, else by 0.

    Shapes `(n,)`.
    """
    present = ~np.isnan(values)
    if present.all():
        return values
    if not present.any():
        return np.zeros(values.size)
    last = np.maximum.accumulate(np.where(present, np.arange(values.size), -1))
    return values[np.where(last < 0, np.argmax(present), last)]

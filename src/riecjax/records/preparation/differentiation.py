"""Derivatives of recorded signals."""

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from riecjax.errors import DataError
from riecjax.records.preparation.stretches import longest_stretch, on_stretches, with_gaps
from riecjax.records.record import Record


def differentiate(record: Record, signal: str, name: str) -> Record:
    """Add the time derivative of a signal, by central differences of second order.

    Differentiation raises noise in proportion to frequency; prefer an integral criterion, which
    needs one derivative less, and filter first where it cannot be avoided.

    At the ends and beside gaps the differences are one-sided, of second order too, so that nothing
    is lost there. A single sample between gaps becomes missing.

    **Raises:** `DataError` for a missing signal, or one without two samples in succession.
    """
    if longest_stretch(record, signal) < 2:
        raise DataError(
            f"'{signal}' has no derivative: nowhere are two of its samples next to each other. "
            f"Repair the gaps, or resample to a lower rate."
        )
    unit = dict(record.units).get(signal)
    units = {} if unit is None else {name: f"{unit}/s"}
    derivative = on_stretches(record, signal, lambda x: central_difference(x, record.time_step))
    return with_gaps(record, {name: derivative}, units)


def central_difference(samples: ArrayLike, time_step: ArrayLike) -> Float[np.ndarray, " n"]:
    """Second-order differences, one-sided at both ends.

    Two samples have one slope; one sample has none, and gives NaN.
    """
    values = np.asarray(samples)
    if values.size < 2:
        return np.full(values.shape, np.nan)
    return np.gradient(
        values, np.asarray(time_step).item(), edge_order=1 if values.size == 2 else 2
    )

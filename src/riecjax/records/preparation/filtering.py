"""Filters without phase, and the removal of offset and drift."""

import jax.numpy as jnp
import numpy as np
import scipy.signal

from riecjax.errors import DataError
from riecjax.records.record import Record

FILTER_ORDER = 4
FILTER_PADDING = 16
"""Samples by which SciPy extends each end of a record for a filter of this order."""
SETTLING_PERIODS = 5
"""Periods of the cut-off frequency after which a zero-phase filter has forgotten the ends."""


def low_pass(record: Record, cutoffs: dict[str, float]) -> Record:
    """Filter signals by a zero-phase Butterworth low-pass of 4th order (run both ways).

    Five periods of the lowest cut-off are cut from both ends, where the filter still feels the
    record's ends.

    **Arguments:** `cutoffs`: signal name to cut-off in Hz.

    **Raises:** `DataError` for a cut-off beyond half the sampling rate, a missing signal, or a
    record too short for the filter.
    """
    nyquist = 0.5 / float(record.time_step)
    for name, cutoff in cutoffs.items():
        if not 0 < cutoff < nyquist:
            raise DataError(
                f"cannot filter '{name}' at {cutoff:g} Hz: the cut-off must lie between 0 and half "
                f"the sampling rate, {nyquist:g} Hz."
            )
    lowest = min(cutoffs.values())
    cut = int(np.ceil(SETTLING_PERIODS / lowest / float(record.time_step)))
    if record.sample_count <= max(2 * cut + 2, FILTER_PADDING):
        raise DataError(
            f"the record is too short to be filtered at {lowest:g} Hz: {cut} samples are lost at "
            f"each end."
        )
    filtered = {}
    for name, cutoff in cutoffs.items():
        sections = scipy.signal.butter(FILTER_ORDER, cutoff / nyquist, output="sos")
        filtered[name] = jnp.asarray(scipy.signal.sosfiltfilt(sections, np.asarray(record[name])))
    return record.with_signals(filtered).part(cut, record.sample_count - cut)

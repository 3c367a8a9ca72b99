"""Samples at which a sensor showed what it could, and not what was: stuck, or at its limit."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from riecjax.records.faults.clipping import limits
from riecjax.records.faults.sampled_signal import SampledSignal
from riecjax.records.faults.saturation import limits_under_noise
from riecjax.records.faults.stuck_sensor import stuck_runs


def held(signal: SampledSignal, others: Sequence[SampledSignal]) -> Bool[np.ndarray, " n"]:
    """Samples of which `stuck_sensor` and `clipped` speak, limits that may be real among them."""
    found = np.zeros(signal.values.size, bool)
    for run in stuck_runs(signal, others):
        start = signal.run_starts[run]
        found[start : start + signal.run_lengths[run]] = True
    for side in limits(signal) or limits_under_noise(signal):
        sign = 1.0 if side.which == "maximum" else -1.0
        found |= sign * (signal.values - side.extreme) >= -side.within
    return found

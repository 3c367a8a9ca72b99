"""The steps of a converter, where they matter."""

from collections.abc import Iterator

import numpy as np

from riecjax.findings import Finding
from riecjax.records.faults.sampled_signal import (
    FEW_LEVELS,
    SampledSignal,
    percent,
)

COARSE = 0.01
"""Share of a signal's rms past which its resolution matters."""


def quantised(signal: SampledSignal) -> Iterator[Finding]:
    """A resolution that is coarse against the signal's rms."""
    # Of the largest value's size, or squares of small numbers would be none.
    most = float(np.nanmax(np.abs(signal.values), initial=1e-300))
    rms = most * float(np.nanstd(signal.values / most))
    steps = np.abs(np.diff(signal.values))
    steps = steps[~np.isnan(steps)]
    # Few levels that are held for long are a command's.
    held = signal.levels.size <= FEW_LEVELS and np.mean(steps == 0) > 0.95
    if signal.levels.size < 5 or held or signal.resolution <= COARSE * rms:
        return
    change = float(np.sqrt(np.mean((steps / signal.resolution) ** 2)))
    yield signal.finding(
        "quantised",
        f"its resolution of {signal.with_unit(signal.resolution)} is "
        f"{percent(signal.resolution, rms)} of its rms, and it changes by {change:.2g} such steps "
        f"from sample to sample (rms). Do not differentiate it without a low-pass, and prefer "
        f"longer windows or a finer range.",
    )

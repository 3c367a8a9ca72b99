"""A signal of a record with what several checks of it ask."""

from typing import NamedTuple

import numpy as np

from riecjax.findings import Finding
from riecjax.records.record import Record, samples_with_nan
from riecjax.records.resolution import (
    FEW_LEVELS,
    is_piecewise_linear,
    levels_of,
    resolution_of,
    rounding_of,
)

LONGEST_REST = 0.5
"""Share of samples at one value past which that is where the signal rests."""


class SampledSignal(NamedTuple):
    """A signal of n samples with what several checks ask of it."""

    name: str
    unit: str
    values: np.ndarray
    """Shape (n,), NaN where missing."""
    time: np.ndarray
    """Seconds from the recording's first sample, shape (n,)."""
    time_step: float
    """Seconds between samples."""
    levels: np.ndarray
    """Distinct values, ascending."""
    counts: np.ndarray
    """How often each level occurs."""
    rounding: float
    """Distance within which values are one."""
    resolution: float
    """Distance of values where they are multiples of one, else 0."""
    run_starts: np.ndarray
    """First sample of each run, a stretch of one exact value."""
    run_lengths: np.ndarray
    """Samples in each run."""
    is_command: bool
    """Whether it takes few values, or lies on straight lines, as no sensor's signal does."""

    @property
    def sample_count(self) -> int:
        """Samples that are not missing."""
        return int(self.counts.sum())

    @property
    def run_values(self) -> np.ndarray:
        """The value of each run."""
        return self.values[self.run_starts]

    def with_unit(self, value: float) -> str:
        """A value of the signal in words."""
        return f"{value + 0.0:.4g} {self.unit}".rstrip()

    def finding(
        self,
        code: str,
        message: str,
        doubt: float = 0.0,
        remedy: tuple[str, ...] = (),
        step: str = "",
    ) -> Finding:
        """A finding about this signal."""
        said = f"{self.name}: {message}"
        return Finding(code, said, (self.name,), doubt=doubt, remedy=remedy, step=step)


def sampled_signal(record: Record, name: str) -> SampledSignal:
    """A signal of a record.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    values = samples_with_nan(record, name)
    known = values[~np.isnan(values)]
    rounding = rounding_of(known)
    levels, counts = levels_of(known, rounding)
    starts = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    return SampledSignal(
        name,
        dict(record.units).get(name, ""),
        values,
        np.asarray(record.elapsed),
        float(record.time_step),
        levels,
        counts,
        rounding,
        resolution_of(levels),
        starts,
        np.diff(starts, append=values.size),
        levels.size <= FEW_LEVELS or is_piecewise_linear(values, levels, rounding),
    )


def percent(part: float, whole: float) -> str:
    """A share in words."""
    if not abs(whole) > 0:
        return "all"
    return f"{100 * part / whole:.3g} %"

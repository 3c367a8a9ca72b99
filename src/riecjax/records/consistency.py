"""Whether a recorded derivative belongs to its signal: units, signs and channels mixed up."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from riecjax.findings import Finding
from riecjax.records.record import Record

SHORTEST, LONGEST_SHARE = 4, 8
"""Lags: from this many samples to this part of the record, each four times the one before."""
FEWEST_LAGS = 50
"""Pairs of samples below which nothing is said."""
EXTREME = 0.99
"""Share of the increments past which they are cut off, so that single spikes do not decide."""
ALIKE = 0.95
"""Correlation of increments, of either sign, past which they are those of one motion."""
UNRELATED = 0.5
"""Correlation below which two signals do not belong to each other."""
GAIN = 0.1
"""Share by which sensors of one motion may differ in gain: more than any calibration leaves."""


# Values too large to be squared are for the fit to refuse.
@np.errstate(over="ignore", invalid="ignore")
def check_derivatives(record: Record, pairs: Iterable[tuple[str, str]]) -> list[Finding]:
    """Compare the increments of signals with the integrals of their derivatives.

    Each pair names a signal and the signal that holds its derivative. The comparison is made over
    the lag at which they agree best: noise hides short increments of a position, and an offset
    that drifts spoils long integrals of a velocity. Constant offsets do not matter. The code is
    `not_its_derivative`. Not under jit.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    found = []
    for signal, derivative in dict.fromkeys(pairs):
        values, rates = _values(record, signal), _values(record, derivative)
        best = _best_lag(values, rates, float(record.time_step))
        if best is None:
            continue
        if abs(best.correlation) < ALIKE and best.correlation < UNRELATED:
            what = (
                f"does not move with {signal} (the increments of {signal} and the integral of "
                f"{derivative} correlate by {best.correlation:.2f} at best)"
            )
        elif best.is_off:
            what = (
                f"does not fit the size, sign or time of {signal}: {signal} changes by "
                f"{best.gain:.4g} times the integral of {derivative}"
            )
        else:
            continue
        found.append(
            Finding(
                "not_its_derivative",
                f"{derivative}, which is read as the derivative of {signal}, {what}; check which "
                f"columns they are, their units and signs, and that time is in seconds (on the "
                f"command line: --map and --scale).",
                (signal, derivative),
            )
        )
    return found


class _Lag(NamedTuple):
    correlation: float
    gain: float
    """Size of the signal's increments against that of the integrals, with their common sign."""

    @property
    def is_off(self) -> bool:
        """Whether no share of noise in either signal explains a gain that is not 1.

        The regressions of one on the other, and the other way round, enclose the true gain.
        """
        if self.gain < 0:
            return True
        return self.gain * self.correlation > 1 + GAIN or self.gain / self.correlation < 1 - GAIN


def _values(record: Record, name: str) -> np.ndarray:
    values = np.array(record[name], float)
    if name in record.missing:
        values[np.asarray(record.missing[name])] = np.nan
    return values


def _best_lag(values: np.ndarray, rates: np.ndarray, step: float) -> _Lag | None:
    unknown = np.isnan(values) | np.isnan(rates)
    gone = np.concatenate([[0], np.cumsum(unknown)])
    rates = np.where(unknown, 0.0, rates)
    area = np.concatenate([[0.0], np.cumsum(0.5 * step * (rates[1:] + rates[:-1]))])
    lags = []
    lag = SHORTEST
    while lag <= values.size // LONGEST_SHARE:
        whole = gone[lag + 1 :] == gone[: values.size - lag]
        if whole.sum() >= FEWEST_LAGS:
            change = _cut_off((values[lag:] - values[:-lag])[whole])
            integral = _cut_off((area[lag:] - area[:-lag])[whole])
            size, other = np.std(change), np.std(integral)
            if size > 0 and other > 0 and np.isfinite(size) and np.isfinite(other):
                correlation = float(np.mean(change / size * integral / other))
                lags.append(_Lag(correlation, float(np.sign(correlation) * size / other)))
        lag *= 4
    return max(lags, key=lambda each: abs(each.correlation), default=None)


def _cut_off(increments: np.ndarray) -> np.ndarray:
    """Increments about their mean, none larger than all but the most extreme."""
    centred = increments - np.median(increments)
    limit = np.quantile(np.abs(centred), EXTREME)
    cut = np.clip(centred, -limit, limit)
    return cut - np.mean(cut)

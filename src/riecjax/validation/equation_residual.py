"""What one equation of an identified model leaves unexplained, and what is to be said of it."""

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from riecjax.findings import Finding
from riecjax.validation.equation_errors import EquationError
from riecjax.validation.loops import Loop
from riecjax.validation.time_series import Autocorrelation, CrossCorrelation, ErrorSpectrum, Peak
from riecjax.validation.window_errors import WindowErrors

NOTABLE_SIZE = 0.02
"""Share of the target below which an error does not matter."""
NOTABLE_CORRELATION = 0.3
"""Correlation below which less than a tenth of the error's power follows a signal."""
NOTABLE_RATIO = 10.0
"""Mean square errors of the loudest and the quietest stretch that are uneven: 3.2 in rms."""
RARE = 0.01
"""Probability by chance below which stretches are called uneven."""
NOTABLE_SHARED = 0.1
"""Epsilon that is no longer much smaller than one; chance seldom makes ten times T / t_max."""


class EquationResidual(NamedTuple):
    """What one equation leaves unexplained.

    **Fields:**

    - `name` and `unit` of the equation; `relative_rms`: its error, sample by sample, relative to
      its target.
    - `error`: over all records, see `joined`.
    - `autocorrelation` of the error.
    - `follows`: correlation with each signal that all records hold, strongest first. Error and
      signals are averaged over half a period of the fastest motion in the model's band, or half
      the shortest window if that is longer, so that differentiated sensor noise does not hide what
      is left of the motion.
    - `averaged`: seconds of that average.
    - `averaged_size`: root mean square of the averaged error relative to the averaged target.
    - `spectrum`, and its `peak` if there is a genuine one.
    - `windows`: eq. (18) on these records; `None` for a criterion without windows, or records too
      short for four of the longest.
    - `bodies`: signals on which the equation could hide a mode: those that it accelerates; and
      those of `carrying` that carry one in the model.
    - `dampers`: coefficients with which a spring that the model lacks could be in series, and
      the first ones of `maps` of which that may be said.
    - `parameters` of the equation, and the signals that its model `names`.
    - `explained`: whether a fault of a sensor explains what is left, which is then no model's.
    - `loop`: hysteresis, or a signal that changes a force, where that explains most of the rest.
    """

    name: str
    unit: str
    relative_rms: float
    error: EquationError
    autocorrelation: Autocorrelation
    follows: tuple[CrossCorrelation, ...]
    averaged: float
    averaged_size: float
    spectrum: ErrorSpectrum
    peak: Peak | None
    windows: WindowErrors | None
    bodies: tuple[str, ...] = ()
    carrying: tuple[str, ...] = ()
    dampers: tuple[str, ...] = ()
    maps: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    explained: bool = False
    loop: Loop | None = None

    def findings(self) -> list[Finding]:
        """`unmodelled_mode`, `hysteresis`, `residual_follows_signal`, `uneven_errors`."""
        of_model = (self._mode(), self._looping(), self._following())
        made = () if self.explained else itertools.chain(*of_model)
        found = [*made, *self._uneven()]
        return [finding._replace(parameters=self.parameters) for finding in found]

    def _mode(self) -> Iterator[Finding]:
        peak = self.peak
        if peak is not None and peak.size >= NOTABLE_SIZE:
            yield Finding(
                "unmodelled_mode",
                f"{self.name}: the equation error peaks near {peak.frequency:.3g} Hz, and "
                f"{100 * peak.share:.0f} % of its power up to {self.spectrum.band:.3g} Hz lies "
                f"from {peak.low:.3g} to {peak.high:.3g} Hz: the model leaves out a mode there, "
                f"or gets one wrong. {self._add()}, or use windows longer than "
                f"{1 / peak.frequency:.2g} s, over which it averages out.",
            )

    def _add(self) -> str:
        if self.carrying:
            return f"Beside the mode on {' and '.join(self.carrying)} {self._add_spring()}"
        if not self.bodies:
            return "Add the mode"
        return (
            f"Find the mode on {' or '.join(self.bodies)} (on the command line: --add-mode "
            f"{self.bodies[-1]}; rx.HiddenMode('{self.bodies[-1]}'))"
        )

    def _add_spring(self) -> str:
        if not self.dampers and not self.maps:
            return "something else is missing: add it"
        late = "a force may follow late: add a spring in series with it"
        if not self.dampers:
            return f"{late} (in Python: rx.SeriesSpring('{self.maps[0]}'), and rx.refine)"
        return (
            f"{late} (on the command line: --add-spring {self.dampers[0]}; "
            f"rx.SeriesSpring('{self.dampers[0]}'))"
        )

    def _looping(self) -> Iterator[Finding]:
        if self.loop is not None and self.loop.size >= NOTABLE_SIZE:
            found = self.loop.finding(float(self.error.time_step))
            yield found._replace(message=f"{self.name}: {found.message}")

    def _following(self) -> Iterator[Finding]:
        if not self.follows or (self.loop is not None and self.loop.by):
            return
        first = self.follows[0]
        size = abs(first.largest)
        notable = size > max(first.bound, NOTABLE_CORRELATION)
        if notable and size * self.averaged_size >= NOTABLE_SIZE:
            cause = (
                "a term in it is missing or has another form, or a sensor is late. Add a term, or "
                "shift the signal."
                if self.peak is None
                else f"as the ringing of a mode near {self.peak.frequency:.3g} Hz does, or of a "
                f"sensor that is late. {self._add()}, or shift the signal."
            )
            if self.names and first.signal not in self.names:
                cause = "the model does not use it. Add a term in it."
            yield Finding(
                "residual_follows_signal",
                f"{self.name}: what the model leaves follows {first.signal}"
                f"{_later(first.largest_lag)} (correlation {first.largest:.2f}), by "
                f"{100 * size * self.averaged_size:.3g} % of the target: {cause}",
                (first.signal,),
            )

    def _uneven(self) -> Iterator[Finding]:
        errors = self.windows
        if errors is None or errors.relative_rms < NOTABLE_SIZE:
            return
        if errors.p_value < RARE and errors.ratio >= NOTABLE_RATIO:
            loud = int(np.argmax(errors.mean_square))
            yield Finding(
                "uneven_errors",
                f"{self.name}: errors of windows are {np.sqrt(errors.ratio):.2g} times as large "
                f"from {errors.start[loud]:.4g} to {errors.stop[loud]:.4g} s as in the quietest "
                f"stretch (the signal {_times(errors)}), so the estimate depends on it. See "
                f"what differs there; leave it out, or identify the stretches one by one.",
            )
        if self.has_constant_part:
            yield Finding(
                "uneven_errors",
                f"{self.name}: errors of windows share a constant part (correlation "
                f"{errors.correlation:.2g} between windows drawn at random), which more windows "
                f"do not average out. Remove the sensors' offsets, estimate that of the input "
                f"(--unknown-offset SIGNAL), or add a term rx.Term('offset', rx.constant); where "
                f"it may differ between recordings, give each its own: per_record=('offset',) "
                f"(--per-record offset).",
            )

    @property
    def has_constant_part(self) -> bool:
        """Whether the errors of all windows have a part in common, as the offset of a sensor."""
        errors = self.windows
        return (
            errors is not None
            and errors.relative_rms >= NOTABLE_SIZE
            and errors.correlation > max(NOTABLE_SHARED, 10 * errors.window_share)
        )

    def describe(self) -> dict[str, Any]:
        """Numbers of the tests, without the series, as plain data for JSON."""
        windows = self.windows
        return {
            "relative_rms": self.relative_rms,
            "correlation_time_s": self.autocorrelation.correlation_time,
            "integrated_autocorrelation_s": self.autocorrelation.integrated,
            "follows": [
                {
                    "signal": one.signal,
                    "correlation": one.largest,
                    "lag_s": one.largest_lag,
                    "bound": one.bound,
                }
                for one in self.follows
            ],
            "band_hz": self.spectrum.band,
            "peak": None if self.peak is None else self.peak._asdict(),
            "loop": None if self.loop is None else self.loop.describe(),
            "windows": None
            if windows is None
            else {
                "relative_rms": windows.relative_rms,
                "mean_square_ratio": windows.ratio,
                "target_mean_square_ratio": windows.target_ratio,
                "p_value": None if np.isnan(windows.p_value) else windows.p_value,
                "correlation": windows.correlation,
                "mean_length_over_record": windows.window_share,
            },
        }


def _later(lag: float) -> str:
    if lag == 0:
        return ""
    return f", {abs(lag):.3g} s {'later' if lag > 0 else 'earlier'}"


def _times(errors: WindowErrors) -> str:
    times = np.sqrt(errors.target_ratio)
    return f"{times:.2g} times" if times < 100 else "more than 100 times"

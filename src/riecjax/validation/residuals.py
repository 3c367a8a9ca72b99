"""What one equation of an identified model leaves unexplained, and what is to be said of it.

What an identified model leaves unexplained, and what that says of the model.

Of a complete model white noise is left, or what sensors make of it. A mode that was left out
shows as a peak of the error's spectrum, a force as an error that follows a signal, and stretches
of the record that do not belong together as errors of unequal size. Each is reported only where
chance does not explain it and it is large enough to matter.
"""

import itertools
from collections.abc import Container, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.criteria.windows import AbstractWindows
from riecjax.equations.equation import Equation
from riecjax.equations.hidden_elements import accelerated, force_elements
from riecjax.equations.memories import with_memories
from riecjax.equations.motions import motions_and_unread
from riecjax.equations.procedure import HasProcedure, Procedure, as_procedure, told_apart
from riecjax.equations.term import Term
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding
from riecjax.records.record import Record, Records, as_records
from riecjax.shows import Drawn
from riecjax.validation.equation_errors import EquationError, errors_over_records, joined, with_pads
from riecjax.validation.loops import Loop, loop_of
from riecjax.validation.time_series import (
    Autocorrelation,
    CrossCorrelation,
    ErrorSpectrum,
    Peak,
    autocorrelation,
    cross_correlation,
    error_spectrum,
    moving_average,
)
from riecjax.validation.window_errors import WindowErrors, window_errors

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


LAGS = 50
"""Samples of the longest lag, where no windows say how long."""
MOST_LAGS = 400
LARGEST_LAG_SHARE = 10
"""The longest lag is at most this part of the records."""


class ResidualTests(Drawn, eqx.Module):
    """What every equation of a model leaves unexplained; see [`residual_tests`][].

    **Fields:** `equations`, in the order of the procedure's stages; `faults` of sensors that
    explain what some of them leave.
    """

    equations: tuple[EquationResidual, ...]
    faults: tuple[Finding, ...] = ()

    def __getitem__(self, name: str) -> EquationResidual:
        return {equation.name: equation for equation in self.equations}[name]

    def findings(self) -> list[Finding]:
        """Faults of sensors, and findings of all equations."""
        return [*self.faults, *(finding for one in self.equations for finding in one.findings())]

    def describe(self) -> dict[str, Any]:
        """Numbers of the tests by equation, as plain data for JSON."""
        return {equation.name: equation.describe() for equation in self.equations}


def residual_tests(
    model: Equation | Procedure | HasProcedure,
    records: Records,
    estimate: Estimate | Mapping[str, float | Array],
    *,
    windows: AbstractWindows | None = None,
    lags: int | None = None,
    errors: list[list[EquationError]] | None = None,
    faults: Sequence[Finding] = (),
) -> ResidualTests:
    """Test what an identified model leaves unexplained (not under jit).

    **Arguments:**

    - `estimate`: of these records or of others; or parameter name to value.
    - `windows`: whose errors eq. (18) is tested on; by default those of the estimate.
    - `lags`: longest lag of correlations in samples; by default the longest window or else 50
      samples, no more than 400 and a tenth of the records.
    - `errors` of each equation on each record, from [`errors_over_records`][], if they are known.
    - `faults` of sensors that explain what is left where their signals are read.

    **Raises:** `ModelError` for a parameter without a value; `DataError` for a missing signal,
    records of unequal time steps or too short ones.
    """
    procedure = as_procedure(model)
    recordings = [with_memories(record, procedure.memories) for record in as_records(records)]
    values = estimate.single().values if isinstance(estimate, Estimate) else estimate
    if windows is None and isinstance(estimate, Estimate):
        windows = estimate.criterion.windows
    if errors is None:
        errors = errors_over_records(model, recordings, values)
    if lags is None:
        samples = sum(record.sample_count for record in recordings)
        step = float(recordings[0].time_step)
        wanted = LAGS if windows is None else round(float(windows.beta) / step)
        lags = max(min(wanted, MOST_LAGS, samples // LARGEST_LAG_SHARE), 1)
    names = told_apart([of_equation[0].name for of_equation in errors])
    first = recordings[0]
    reads = [e.signals_read(first, of[0].span) for e, of in zip(procedure.equations, errors)]
    pairs = (pair for equation in procedure.equations for pair in equation.derivatives)
    named = {name for pair in pairs for name in pair}.union(*reads)
    faulty = {name for fault in faults for name in fault.signals}
    found, parts = [], zip(names, errors, procedure.equations, reads, strict=True)
    for name, of_equation, equation, read in parts:
        residual = _residual(name, of_equation, recordings, windows, lags)
        is_notable = residual.averaged_size >= NOTABLE_SIZE
        count = round(residual.averaged / float(recordings[0].time_step))
        residual = residual._replace(
            **_lacking(procedure, equation),
            loop=_loop(equation, of_equation, recordings, named, count) if is_notable else None,
            parameters=equation.parameters,
            names=tuple(sorted(named)),
            explained=not faulty.isdisjoint(read),
        )
        found.append(residual)
    return ResidualTests(tuple(found), tuple(faults))


def _loop(
    equation: Equation,
    errors: list[EquationError],
    records: list[Record],
    named: Container[str],
    count: int,
) -> Loop | None:
    """Of an error that is worth it: hysteresis, or a signal of no name that changes a force."""
    units = {name: unit for record in records for name, unit in record.units}
    common = [name for name in records[0].arrays if all(name in one.arrays for one in records)]
    unread = [name for name in common if name not in named]
    motions, unread = motions_and_unread(equation, records[0], {*common}, units, unread)
    return loop_of(errors, records, motions, unread, count)


def _lacking(procedure: Procedure, equation: Equation) -> dict[str, tuple[str, ...]]:
    """Where an equation could hide something, by field of `EquationResidual`."""
    sprung = {spring.of for spring in procedure.springs}
    free = {
        name: term
        for name, term in force_elements(procedure.equations, [equation]).items()
        if not sprung & {*term.parameters}
    }
    carrying = (mode.on for mode in procedure.modes if mode.inertia(equation) is not None)
    return {
        "bodies": accelerated(equation),
        "carrying": tuple(carrying),
        "dampers": tuple(name for name, term in free.items() if isinstance(term, Term)),
        "maps": tuple(name for name, term in free.items() if not isinstance(term, Term)),
    }


def _residual(
    name: str,
    errors: list[EquationError],
    records: list[Record],
    windows: AbstractWindows | None,
    lags: int,
) -> EquationResidual:
    error = joined(errors, lags)
    step = float(error.time_step)
    present, values = np.asarray(error.present), np.asarray(error.error)
    spectrum = error_spectrum(error)
    shortest = 0.0 if windows is None else float(windows.alpha)
    period = 1 / spectrum.band if spectrum.band > 0 else 0.0
    count = min(max(round(max(period, shortest) / (2 * step)), 1), lags)
    averaged = moving_average(values, present, count)
    target, _ = moving_average(np.asarray(error.target), present, count)
    energy = np.sum(target**2)
    return EquationResidual(
        name,
        error.unit,
        float(error.relative_rms),
        error,
        autocorrelation(values, present, lags, step),
        _follows(averaged, errors, records, count, lags),
        count * step,
        float(np.sqrt(np.sum(averaged[0] ** 2) / energy)) if energy > 0 else 0.0,
        spectrum,
        spectrum.peak(),
        None if windows is None else window_errors(errors, windows),
    )


def _follows(
    averaged: tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]],
    errors: list[EquationError],
    records: list[Record],
    count: int,
    lags: int,
) -> tuple[CrossCorrelation, ...]:
    """Correlations of the averaged error with the averaged signals, strongest first."""
    error, present = averaged
    common = [
        name for name in records[0].arrays if all(name in record.arrays for record in records)
    ]
    found = []
    for name in common:
        signal, valid = _signal(errors, records, name, lags)
        signal, valid = moving_average(signal, valid, count)
        both = present & valid
        if both.any() and np.ptp(signal[both]) > 0:
            step = float(errors[0].time_step)
            found.append(
                cross_correlation(error, signal, both, lags, step, name=name, signals=len(common))
            )
    return tuple(sorted(found, key=lambda one: -abs(one.largest)))


def _signal(
    errors: list[EquationError], records: list[Record], name: str, pad: int
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """A signal at the times of the joined errors, and a mask of its samples that are present."""
    values, valid = [], []
    for error, record in zip(errors, records):
        missing = record.missing.get(name)
        values.append(np.asarray(error.centred(record[name])))
        gone = np.zeros(values[-1].size) if missing is None else error.centred(missing * 1.0)
        valid.append(np.asarray(gone) == 0)
    return with_pads(values, pad), with_pads(valid, pad)

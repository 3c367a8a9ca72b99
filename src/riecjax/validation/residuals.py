"""What an identified model leaves unexplained, and what that says of the model.

Of a complete model white noise is left, or what sensors make of it. A mode that was left out
shows as a peak of the error's spectrum, a force as an error that follows a signal, and stretches
of the record that do not belong together as errors of unequal size. Each is reported only where
chance does not explain it and it is large enough to matter.
"""

from collections.abc import Container, Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.criteria.windows import AbstractWindows
from riecjax.equations.equation import Equation
from riecjax.equations.hidden_modes import accelerated
from riecjax.equations.memories import with_memories
from riecjax.equations.motions import motions_and_unread
from riecjax.equations.procedure import HasProcedure, Procedure, as_procedure, told_apart
from riecjax.equations.series_springs import force_elements
from riecjax.equations.term import Term
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding
from riecjax.records.record import Record, Records, as_records
from riecjax.shows import Drawn
from riecjax.validation.equation_errors import EquationError, errors_over_records, joined, with_pads
from riecjax.validation.equation_residual import NOTABLE_SIZE, EquationResidual
from riecjax.validation.loops import Loop, loop_of
from riecjax.validation.time_series import (
    CrossCorrelation,
    autocorrelation,
    cross_correlation,
    error_spectrum,
    moving_average,
)
from riecjax.validation.window_errors import window_errors

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

"""Figures of an identification: fit, window sweep, validation."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from riecjax.criteria.criterion import RIEC, AbstractCriterion, Rows
from riecjax.criteria.test_functions import Hat
from riecjax.estimation.assembly import all_rows
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.identify import record_keys
from riecjax.estimation.sharing import Sharing, values_of_record
from riecjax.records.record import Record
from riecjax.reporting.curve_figures import curves_figure, identified_curves
from riecjax.reporting.identification import Identification, ValidationRun
from riecjax.reporting.residual_figures import residual_figures
from riecjax.reporting.style import BLUE, GREY, PALE, RUST, labelled, panels
from riecjax.reporting.window_choice_figures import window_choice_figures
from riecjax.studies.window_sweep import WindowSweep

MOST_POINTS = 3000


def identification_figures(result: Identification) -> dict[str, Any]:
    """`fit`; `curves` if the model has some; `window_sweep`; `correlation` of the parameters;
    `residual_1`, ... of each equation; `window_choice`; `validation_1`, ... for each."""
    figures = {"fit": _fit_figure(result)}
    if curves := identified_curves(result):
        figures["curves"] = curves_figure(curves)
    if result.sweep is not None:
        figures["window_sweep"] = sweep_figure(result.sweep, result.estimate)
    figures["correlation"] = correlation_figure(result.estimate)
    if result.residuals is not None:
        figures |= residual_figures(result.residuals)
    if result.choice is not None:
        figures |= window_choice_figures(result.choice)
    for i, run in enumerate(result.validations):
        if run.held.signals:
            figures[f"validation_{i + 1}"] = validation_figure(run)
    return figures


def sweep_figure(sweep: WindowSweep, estimate: Estimate) -> Any:
    """Each parameter over window length, with its interval, and the estimate of the fit."""
    count = len(sweep.parameters)
    columns = min(count, 4)
    rows = -(-count // columns)
    figure, axes = panels(rows, columns, (3.2 * columns + 0.6, 2.6 * rows + 0.4))
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    length = np.sqrt(np.asarray(sweep.alpha) * np.asarray(sweep.beta))
    units = dict(sweep.units)
    errors = np.asarray(sweep.standard_errors)
    for j, (name, panel) in enumerate(zip(sweep.parameters, axes.flat)):
        values = np.asarray(sweep.theta[:, j])
        low, high = estimate.interval(name)
        panel.axhspan(low, high, color=PALE, label="the fit's interval")
        panel.errorbar(
            length,
            values,
            1.96 * errors[:, j],
            fmt="o-",
            color=BLUE,
            markersize=3,
            linewidth=1,
            capsize=2,
            label="window length alone",
        )
        panel.set_xscale("log")
        # Between decades there is room for 2 and 5 only.
        panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.xaxis.set_minor_locator(NullLocator())
        panel.set_xlabel("window length / s")
        panel.set_ylabel(labelled(name, units.get(name)))
    for panel in axes.flat[count:]:
        panel.set_visible(False)
    axes.flat[0].legend(fontsize="small", framealpha=0.9)
    return figure


def correlation_figure(estimate: Estimate) -> Any:
    """Correlation matrix of the estimates."""
    names, values = estimate.parameters, np.asarray(estimate.correlation)
    side = 0.55 * len(names) + 1.2
    figure, ((axes,),) = panels(1, 1, (side + 1.6, side))
    image = axes.imshow(values, cmap="RdBu_r", vmin=-1, vmax=1)
    axes.set_xticks(range(len(names)), names, rotation=45, ha="right")
    axes.set_yticks(range(len(names)), names)
    for (row, column), value in np.ndenumerate(values):
        shade = "white" if abs(value) > 0.6 else "black"
        axes.text(
            column, row, f"{value:.2f}", ha="center", va="center", fontsize="x-small", color=shade
        )
    figure.colorbar(image, label="correlation of the estimates", shrink=0.8)
    return figure


def validation_figure(run: ValidationRun) -> Any:
    """Measured and simulated signals over time."""
    names = list(run.held.signals)
    figure, axes = panels(len(names), 1, (8, 2.1 * len(names) + 0.6), sharex=True)
    units = dict(run.measured.units)
    time = np.asarray(run.measured.time)
    for panel, name in zip(axes[:, 0], names):
        panel.plot(time, _shown(run.measured, name), color=GREY, linewidth=1.6, label="measured")
        panel.plot(
            time, _shown(run.held.record, name), color=RUST, linewidth=0.9, label="simulated"
        )
        panel.set_ylabel(labelled(name, units.get(name)))
    axes[0, 0].legend(fontsize="small", framealpha=0.9, loc="upper right", ncols=2)
    axes[0, 0].set_title(run.on, fontsize="medium")
    axes[-1, 0].set_xlabel("time / s")
    return figure


def _shown(record: Record, name: str) -> np.ndarray:
    """Samples of a signal, with NaN where it is missing, which leaves a gap in a line."""
    samples = np.asarray(record[name])
    return np.where(record.missing[name], np.nan, samples) if name in record.missing else samples


class _Fit(NamedTuple):
    """What was measured and what is explained in each row, and when its window starts."""

    measured: np.ndarray
    explained: np.ndarray
    start: np.ndarray


def _fit_figure(result: Identification) -> Any:
    """Each stage's rows, measured against explained, and what is left of them."""
    estimate, procedure = result.estimate, result.procedure
    count = len(estimate.stages)
    figure, axes = panels(2, count, (3.6 * count + 0.8, 6.4))
    fits = list(_fits(result))
    for column, (stage, name) in enumerate(zip(estimate.stages, estimate.stage_names)):
        unit = _row_unit(procedure.stages[stage.stage][0].unit, estimate.criterion)
        parts = [fit for place, fit in fits if place == stage.stage]
        measured, explained, start = (np.concatenate(arrays) for arrays in zip(*parts))
        chosen = np.linspace(0, measured.size - 1, min(measured.size, MOST_POINTS)).astype(int)
        _draw_fit(axes[0, column], explained[chosen], measured[chosen], name, unit)
        _draw_residual(axes[1, column], start[chosen], (measured - explained)[chosen], unit)
    return figure


def _fits(result: Identification) -> Iterator[tuple[int, _Fit]]:
    """Each equation's rows on each record, with the place of its stage."""
    estimate, procedure, records = result.estimate, result.procedure, result.records
    single = Sharing(procedure.parameters, (), 1)
    given = {name: float(value) for name, value in estimate.known.items()}
    found = {name: float(estimate[name]) for name in estimate.parameters}
    for i, (record, key) in enumerate(zip(records, record_keys(result.key, len(records)))):
        known, estimated = values_of_record(given, i), values_of_record(found, i)
        # The check of this record has compiled the same function.
        for place, rows in enumerate(
            all_rows(procedure, single, [record], estimate.criterion, [key])
        ):
            equations = procedure.stages[place]
            # On one record every equation has as many rows as the others.
            parts = np.split(np.arange(rows.columns.shape[1]), len(equations))
            for equation, part in zip(equations, parts):
                yield place, _fit(rows, part, equation.parameters, record, known, estimated)


def _fit(
    rows: Rows,
    part: np.ndarray,
    names: tuple[str, ...],
    record: Record,
    known: Mapping[str, float],
    estimated: Mapping[str, float],
) -> _Fit:
    """What the known terms and parameters give, and what the estimated ones explain of it."""
    if rows.kept is not None:
        part = part[np.asarray(rows.kept)[part]]
    columns = np.asarray(rows.columns)[:, part]
    held = {name: columns[1 + rows.parameters.index(name)] for name in names}
    target = columns[0] - sum(known[name] * held.pop(name) for name in names if name in known)
    # Where no term is known beforehand, an earlier stage found the coefficient that sets the scale.
    if held and not target.any():
        first = next(iter(held))
        target = -estimated[first] * held.pop(first)
    explained = sum((estimated[n] * column for n, column in held.items()), np.zeros(part.size))
    first_sample = np.floor(np.asarray(rows.position)[part]).astype(int)
    return _Fit(target, explained, np.asarray(record.time)[first_sample])


def _draw_fit(axes: Any, explained: np.ndarray, measured: np.ndarray, name: str, unit: str) -> None:
    reach = 1.05 * max(np.abs(measured).max(), np.abs(explained).max(), 1e-300)
    axes.plot([-reach, reach], [-reach, reach], color=GREY, linewidth=0.8)
    axes.plot(explained, measured, ".", color=BLUE, markersize=2, alpha=0.5)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), title=name)
    axes.set_xlabel(f"explained by the model{unit}")
    axes.set_ylabel(f"measured{unit}")


def _draw_residual(axes: Any, time: np.ndarray, residual: np.ndarray, unit: str) -> None:
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.plot(time, residual, ".", color=RUST, markersize=2, alpha=0.5)
    axes.set_xlabel("time / s")
    axes.set_ylabel(f"residual{unit}")


def _row_unit(unit: str, criterion: AbstractCriterion) -> str:
    """Axis label's unit: the equation's, times seconds for each integration."""
    if not unit:
        return ""
    if not isinstance(criterion, RIEC):
        return f" / ({unit})"
    return f" / ({unit} s^2)" if isinstance(criterion.test_function, Hat) else f" / ({unit} s)"

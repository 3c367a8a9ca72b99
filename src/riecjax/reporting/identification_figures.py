"""Figures of an identification: fit, window sweep, validation."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from riecjax.assessment.assessment import Assessment, ValidationRun
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.mode_windows import linearised
from riecjax.estimation.parameters import values_of_record
from riecjax.records.record import samples_with_nan
from riecjax.reporting.charts.chart import (
    BLUE,
    GREY,
    RUST,
    Axis,
    Chart,
    Dots,
    HeatMap,
    Level,
    Line,
    Panel,
    Span,
    in_rows,
    labelled,
    single,
)
from riecjax.reporting.curve_figures import curves_figure, identified_curves
from riecjax.reporting.hidden_modes import mode_map_figure
from riecjax.reporting.residual_figures import residual_figures, window_choice_figures
from riecjax.studies.sweep import WindowSweep
from riecjax.summaries.sums import Survey
from riecjax.validation.held_out import HeldOut

MOST_POINTS = 2000
MOST_COLUMNS = 3


def identification_figures(result: Assessment) -> dict[str, Chart]:
    """`fit`; `curves` and `mode_map` if the model has some; `window_sweep`; `correlation` of the
    parameters; `residual_1`, ... of each equation; `window_choice`; `validation_1`, ... for each.
    """
    figures = {"fit": _fit_figure(result)}
    if curves := identified_curves(result):
        figures["curves"] = curves_figure(curves)
    if result.modes:
        figures["mode_map"] = mode_map_figure(result.modes)
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


def sweep_figure(sweep: WindowSweep, estimate: Estimate | None = None) -> Chart:
    """Each parameter over window length, with its interval, and the estimate of a fit."""
    length = np.sqrt(np.asarray(sweep.alpha) * np.asarray(sweep.beta))
    units, errors = dict(sweep.units), np.asarray(sweep.standard_errors)
    ends = {} if estimate is None else estimate.interval_by_name()
    panels: list[Panel] = []
    for j, name in enumerate(sweep.parameters):
        alone = Line(
            length,
            np.asarray(sweep.theta[:, j]),
            "window length alone, 95 %",
            BLUE,
            width=1,
            markers=True,
            error=1.96 * errors[:, j],
        )
        fit = []
        if estimate is not None:
            interval = Span(*ends[name], "y", "interval of the fit, 95 %")
            fit = [interval, Level(float(estimate[name]), dashes="dashed")]
        panels.append(
            Panel(
                [*fit, alone],
                Axis("window length / s", log=True),
                Axis(labelled(name, units.get(name))),
            )
        )
    rows = in_rows(panels, MOST_COLUMNS)
    return Chart(
        rows,
        "Estimates from windows of one length after another. An exact model finds the same at "
        "every length; a drift says that the model leaves something out, or that short windows "
        "show the sensors' noise.",
        (3.2 * len(rows[0]) + 0.6, 2.5 * len(rows) + 0.6),
        legend=True,
    )


def correlation_figure(estimate: Estimate) -> Chart:
    """Correlation matrix of the estimates."""
    names = estimate.parameters
    side = 0.55 * len(names) + 1.2
    return single(
        [
            HeatMap(
                range(len(names)),
                range(len(names)),
                np.asarray(estimate.correlation),
                "correlation of the estimates",
                low=-1,
                high=1,
                diverging=True,
                numbers=2,
            )
        ],
        Axis(categories=names),
        Axis(categories=names, reverse=True),
        "Correlation of the estimates: parameters near 1 or -1 are known better in combination "
        "than each by itself.",
        size=(side + 1.6, side),
    )


def validation_figure(run: ValidationRun) -> Chart:
    """Measured and simulated signals over time."""
    return held_out_figure(run.held, f"{run.recording.name}: ")


def held_out_figure(held: HeldOut, about: str = "") -> Chart:
    """The same, its caption after a few words about the recording."""
    assert held.measured is not None
    measured, names = held.measured, list(held.signals)
    units, time = dict(measured.units), np.asarray(measured.elapsed)
    rows = []
    for name in names:
        lines = [
            Line(time, samples_with_nan(measured, name), "measured", GREY, width=1.8),
            Line(time, samples_with_nan(held.record, name), "simulated", RUST, width=0.9),
        ]
        fit = float(held.signals[name].fit)
        last = name == names[-1]
        panel = Panel(
            lines,
            Axis("time / s" if last else ""),
            Axis(labelled(name, units.get(name))),
            title=name if np.isnan(fit) else f"{name}: fit {max(fit, -999.0):.1f} %",
        )
        rows.append([panel])
    return Chart(
        rows,
        f"{about}measured, and simulated by the identified model from the inputs alone. A fit of "
        "100 % is perfect, at 0 % the measured mean would do as well.",
        (8, 1.8 * len(names) + 0.8),
        share_x=True,
        legend=True,
    )


class _Fit(NamedTuple):
    """What was measured and what is explained in each row, and when its window starts."""

    measured: np.ndarray
    explained: np.ndarray
    start: np.ndarray


def _fit_figure(result: Assessment) -> Chart:
    """Each stage's rows, measured against explained, and what is left of them."""
    estimate, procedure = result.estimate, result.procedure
    count = len(estimate.stages)
    fits = list(_fits(result))
    above, beneath = [], []
    for stage, name in zip(estimate.stages, estimate.stage_names):
        held = estimate.criterion.row_unit(procedure.stages[stage.stage][0].unit)
        unit = f" / ({held})" if held else ""
        parts = [fit for place, fit in fits if place == stage.stage]
        measured, explained, start = (np.concatenate(arrays) for arrays in zip(*parts))
        chosen = np.linspace(0, measured.size - 1, min(measured.size, MOST_POINTS)).astype(int)
        above.append(_fit_panel(explained[chosen], measured[chosen], name, unit))
        beneath.append(_residual_panel(start[chosen], (measured - explained)[chosen], unit))
    return Chart(
        (above, beneath),
        "Each equation's rows: measured against explained, which an exact model puts on the line, "
        "and what is left over time.",
        (3.6 * count + 0.8, 6.6),
    )


def _fits(result: Assessment) -> Iterator[tuple[int, _Fit]]:
    """Some rows of each equation on each record, with the place of its stage."""
    estimate = result.estimate
    assert estimate.summary is not None
    summary = linearised(result.procedure, estimate.summary, estimate.known)
    given = {name: float(value) for name, value in estimate.known.items()}
    found = {name: float(estimate[name]) for name in estimate.parameters}
    for i, recording in enumerate(summary.recordings):
        known = {n: v for n, v in values_of_record(given, i).items() if n not in found}
        estimated = {n: v for n, v in values_of_record(found, i).items() if n not in given}
        for place, stage in enumerate(recording.stages):
            for equation in stage:
                assert equation.survey is not None
                yield place, _fit(equation.survey, equation.parameters, known, estimated)


def _fit(
    survey: Survey,
    names: tuple[str, ...],
    known: Mapping[str, float],
    estimated: Mapping[str, float],
) -> _Fit:
    """What the known terms and parameters give, and what the estimated ones explain of it."""
    columns = np.asarray(survey.rows).T
    held = dict(zip(names, columns[1:]))
    target = columns[0] - sum(known[name] * held.pop(name) for name in names if name in known)
    # Where no term is known beforehand, an earlier stage found the coefficient that sets the scale.
    if held and not target.any():
        first = next(iter(held))
        target = -estimated[first] * held.pop(first)
    explained = sum((estimated[n] * column for n, column in held.items()), np.zeros(target.size))
    return _Fit(target, explained, np.asarray(survey.start))


def _fit_panel(explained: np.ndarray, measured: np.ndarray, name: str, unit: str) -> Panel:
    reach = 1.05 * max(np.abs(measured).max(), np.abs(explained).max(), 1e-300)
    return Panel(
        [Level(axis="diagonal"), Dots(explained, measured, color=BLUE, size=1.5, opacity=0.5)],
        Axis(f"explained by the model{unit}", low=-reach, high=reach),
        Axis(f"measured{unit}", low=-reach, high=reach),
        title=name,
    )


def _residual_panel(time: np.ndarray, residual: np.ndarray, unit: str) -> Panel:
    return Panel(
        [Level(0), Dots(time, residual, color=RUST, size=1.5, opacity=0.5)],
        Axis("time / s"),
        Axis(f"residual{unit}"),
    )

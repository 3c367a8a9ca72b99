"""Figures of an identification: fit, window sweep, validation."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.assessment.assessment import Assessment, ValidationRun
from riecjax.criteria.criterion import DOLS
from riecjax.criteria.rows import Rows
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import evaluate
from riecjax.equations.term import Terms
from riecjax.errors import DataError
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.linearised import linearised
from riecjax.estimation.parameters import values_of_record
from riecjax.records.record import Record, samples_with_nan
from riecjax.reporting.charts.chart import (
    BLACK,
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
    Stems,
    in_rows,
    labelled,
    single,
)
from riecjax.reporting.identification import mode_map_figure
from riecjax.studies.choice import EquationWindows, WindowChoice
from riecjax.studies.drift import WindowSweep
from riecjax.summaries.sums import Survey
from riecjax.validation.held_out import HeldOut
from riecjax.validation.residuals import EquationResidual, ResidualTests
from riecjax.validation.time_series import CrossCorrelation, ErrorSpectrum, unbroken

MOST_POINTS = 4000
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


GRID = 400


class IdentifiedCurve(NamedTuple):
    """A curve, its standard error, and the samples that it was drawn through.

    **Fields:** `name`, `unit` of its values and `of`, its variable; `x`, `y` and `error` of the
    curve; `samples`: the variable, and what the rest of the equation leaves for the curve there,
    `None` where a derivative is not recorded.
    """

    name: str
    unit: str
    of: str
    x: Float[np.ndarray, " grid"]
    y: Float[np.ndarray, " grid"]
    error: Float[np.ndarray, " grid"]
    samples: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]] | None


def identified_curves(result: Assessment) -> list[IdentifiedCurve]:
    """The curves of a model that has terms in a basis, from the first record."""
    found: dict[str, IdentifiedCurve] = {}
    record = result.recordings[0].record
    for stage in result.estimate.stages:
        for equation in result.procedure.stages[stage.stage]:
            for term in equation.terms:
                shared = all(name in result.estimate for name in term.parameters)
                if isinstance(term, Terms) and shared and term.prefix not in found:
                    found[term.prefix] = _curve(result.estimate, equation, term, record)
    return list(found.values())


def curves_figure(curves: list[IdentifiedCurve]) -> Chart:
    """Each curve with its interval over the samples, and beneath it what it leaves of them."""
    sampled = any(curve.samples is not None for curve in curves)
    rows: list[list[Panel | None]] = [[_over_samples(curve) for curve in curves]]
    if sampled:
        rows.append([_left_of_samples(curve) for curve in curves])
    return Chart(
        rows,
        "Curves with their 95 % interval, over what the equation leaves for them sample by sample"
        f"{', and beneath them what they leave of that' if sampled else ''}. A curve that samples "
        "go round in loops depends on more than its variable.",
        (4.2 * len(curves) + 0.6, 6.2 if sampled else 4.0),
        heights=(3, 2) if sampled else (),
        share_x=True,
    )


def _over_samples(curve: IdentifiedCurve) -> Panel:
    low, high = curve.y - 1.96 * curve.error, curve.y + 1.96 * curve.error
    marks = [Line(curve.x, curve.y, "identified, 95 %", BLUE, width=1.8, low=low, high=high)]
    if curve.samples is not None:
        marks.insert(0, Line(*curve.samples, "what the equation leaves for it", GREY, width=0.5))
    return Panel(marks, Axis(curve.of), Axis(labelled(curve.name, curve.unit)))


def _left_of_samples(curve: IdentifiedCurve) -> Panel | None:
    if curve.samples is None:
        return None
    x, y = curve.samples
    left = Line(x, y - np.interp(x, curve.x, curve.y), color=RUST, width=0.5)
    return Panel([Level(0), left], Axis(curve.of), Axis(labelled("residual", curve.unit)))


def _curve(estimate: Estimate, equation: Equation, term: Terms, record: Record) -> IdentifiedCurve:
    variable, present = evaluate(term.of, record)
    x = np.asarray(variable) if present is None else np.asarray(variable)[np.asarray(present)]
    grid = np.linspace(x.min(), x.max(), GRID)
    functions = np.asarray(eqx.filter_jit(term.basis)(jnp.asarray(grid)))
    values = np.array([float(estimate[name]) for name in term.parameters])
    label = term.of if isinstance(term.of, str) else getattr(term.of, "__name__", "variable")
    name = label.strip("_").replace("_", " ")
    return IdentifiedCurve(
        name=term.prefix,
        # Coefficients of a roof or a step are values of the curve, whose unit is the equation's.
        unit=equation.unit,
        of=labelled(name, dict(record.units).get(name)),
        x=grid,
        y=values @ functions,
        error=_error(estimate, term, functions),
        samples=_samples(estimate, equation, term, record, np.asarray(variable)),
    )


def _error(estimate: Estimate, term: Terms, functions: np.ndarray) -> np.ndarray:
    """sqrt(b(x)^T C b(x)): the covariance of the coefficients, those held at a value left out."""
    free = [i for i, name in enumerate(term.parameters) if name in estimate.parameters]
    at = [estimate.parameters.index(term.parameters[i]) for i in free]
    covariance = np.asarray(estimate.covariance)[np.ix_(at, at)]
    variance = np.einsum("ig,ij,jg->g", functions[free], covariance, functions[free])
    return np.sqrt(np.maximum(variance, 0))


def _samples(
    estimate: Estimate, equation: Equation, term: Terms, record: Record, variable: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The curve's value by the rest of the equation, at every sample.

    With all other coefficients known, sign sum_i c_i b_i = target is what a pointwise row says.
    """
    others = [name for name in equation.parameters if name not in term.parameters]
    try:
        rows = _rows_left(equation, record, {name: estimate[name] for name in others})
    except DataError:
        return None  # a derivative that is not recorded
    valid = slice(None) if rows.valid is None else np.asarray(rows.valid)
    x, y = variable[valid], np.asarray(rows.target)[valid] / float(term.sign)
    return x[:MOST_POINTS], y[:MOST_POINTS]


@eqx.filter_jit
def _rows_left(equation: Equation, record: Record, values: Mapping[str, Array]) -> Rows:
    return DOLS().rows(equation, record).fix(values)


EXCERPT = 400
"""Values of an error that are drawn one by one."""
LEAST_SHOWN = 1e-8
"""Share of the largest density below which an axis ends: nothing but rounding is there."""


def residual_figures(tests: ResidualTests) -> dict[str, Chart]:
    """`residual_1`, ... for each equation."""
    return {f"residual_{i + 1}": _figure(each) for i, each in enumerate(tests.equations)}


def spectra_figure(tests: ResidualTests) -> Chart:
    """The error's spectrum of each equation beneath the target's."""
    rows = [
        (replace(_spectra(each), title=f"{each.name}: {_share_in_words(each)}", columns=1),)
        for each in tests.equations
    ]
    return Chart(rows, "What the equations leave over frequency.", (8, 2.2 * len(rows) + 0.6))


def _share_in_words(residual: EquationResidual) -> str:
    return f"error {100 * residual.relative_rms:.3g} % of the target"


def _figure(residual: EquationResidual) -> Chart:
    share = f"{100 * residual.relative_rms:.3g} % of the target"
    return Chart(
        (
            (_excerpt(residual, f"{residual.name}: error {share}"), _impulse(residual)),
            (_autocorrelation(residual), _following(residual.follows)),
            (_spectra(residual),),
        ),
        f"What {residual.name} leaves, sample by sample: root mean square error {share}. Above, "
        "its beginning and its impulse; then its correlation with itself and with the signal that "
        "it follows most; and its spectrum, in which a mode that the model leaves out is a peak.",
        (9, 8.6),
        heights=(1, 1, 1.3),
    )


def _excerpt(residual: EquationResidual, title: str) -> Panel:
    """The error and its target over the longest stretch's beginning."""
    error = residual.error
    runs = unbroken(np.asarray(error.present)) or [slice(0, 1)]
    run = max(runs, key=lambda each: each.stop - each.start)
    shown = slice(run.start, min(run.start + EXCERPT, run.stop))
    time = np.asarray(error.times)[shown]
    marks = [
        Line(time, np.asarray(error.target)[shown], "target", GREY, width=1.6),
        Line(time, np.asarray(error.error)[shown], "error", RUST, width=0.9),
    ]
    label = labelled("target and error", residual.unit)
    return Panel(marks, Axis("time / s"), Axis(label), title=title)


def _impulse(residual: EquationResidual) -> Panel:
    error, unit = residual.error, f"{residual.unit} s" if residual.unit else ""
    impulse = np.where(np.asarray(error.present), np.asarray(error.impulse), np.nan)
    return Panel(
        [Level(0), Line(np.asarray(error.times), impulse, color=RUST, width=0.8)],
        Axis("time / s"),
        Axis(labelled("impulse of the error", unit)),
    )


def _autocorrelation(residual: EquationResidual) -> Panel:
    found = residual.autocorrelation
    noise = Span(-found.bound, found.bound, "y", "white noise, 95 %")
    return Panel(
        [noise, Level(0), Stems(found.lag, found.values, color=BLUE)],
        Axis("lag / s"),
        Axis("autocorrelation of the error", low=-1.05, high=1.05),
    )


def _following(follows: tuple[CrossCorrelation, ...]) -> Panel | None:
    """Correlation with the signal that the error follows most."""
    if not follows:
        return None
    found = follows[0]
    bound = min(found.bound, 1.0)
    largest = f"{found.largest:.2f} at {found.largest_lag:.3g} s"
    marks = [
        Span(-bound, bound, "y", "unrelated, 95 %"),
        Level(0),
        Line(found.lag, found.values, color=BLUE, width=1.2),
        Dots([found.largest_lag], [found.largest], largest, RUST, size=6),
    ]
    label = f"correlation with {found.signal}"
    return Panel(marks, Axis("error later by / s"), Axis(label, low=-1.05, high=1.05))


def _spectra(residual: EquationResidual) -> Panel:
    spectrum, peak = residual.spectrum, residual.peak
    target, error = _target_and_error(spectrum)
    explained = Line(target.x, _positive(spectrum.explained), "explained", BLUE, "dashed")
    ends = Level(spectrum.band, "x", "the signals' power ends", BLACK, "dotted")
    marks: list[Line | Span | Level] = [ends, target, explained, error]
    if peak is not None:
        share = f"peak near {peak.frequency:.3g} Hz: {100 * peak.share:.0f} % of the power in it"
        marks.insert(0, Span(peak.low, peak.high, label=share, color=RUST, opacity=0.15))
    return Panel(marks, *_spectrum_axes(spectrum, residual.unit), columns=2)


def _target_and_error(spectrum: ErrorSpectrum) -> tuple[Line, Line]:
    frequency = spectrum.frequency[1:]
    target = Line(frequency, _positive(spectrum.target), "target", GREY, width=1.8)
    return target, Line(frequency, _positive(spectrum.error), "error", RUST)


def _spectrum_axes(spectrum: ErrorSpectrum, unit: str) -> tuple[Axis, Axis]:
    """Axes of frequency and of power density, of a quantity in this unit."""
    largest = max(np.max(spectrum.target[1:]), np.max(spectrum.error[1:]))
    least = max(np.min(spectrum.error[1:]), LEAST_SHOWN * largest)
    low = 0.5 * float(least) if least > 0 else None
    frequency = spectrum.frequency
    across = Axis("frequency / Hz", log=True, low=frequency[1], high=frequency[-1])
    return across, Axis(density_label(unit), log=True, low=low)


def density_label(unit: str) -> str:
    """Label of an axis of power densities, of a quantity in this unit."""
    square = f"{unit}²" if unit.isalnum() else f"({unit})²" if unit else "1"
    return f"power density / ({square}/Hz)"


def _positive(density: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n-1"]:
    """Densities for a logarithmic axis: without the mean, and with gaps where there is none."""
    return np.where(density[1:] > 0, density[1:], np.nan)


def window_choice_figures(choice: WindowChoice) -> dict[str, Chart]:
    """`window_choice`: a row of panels for each equation."""
    rows = [
        (_gain(equation, legend=i == 0), _share(choice, equation, legend=i == 0))
        for i, equation in enumerate(choice.equations)
    ]
    caption = (
        "Left: spectra of each equation's target and error, and what the windows in use let in of "
        "them. Right: the error against the signal in windows of every length, with the lengths in "
        "use and those under which no equation is far above its least."
    )
    return {"window_choice": Chart(rows, caption, (10.5, 2.9 * len(rows) + 0.6))}


def _gain(equation: EquationWindows, *, legend: bool) -> Panel:
    """Spectra, and over them what the current windows let into an integral."""
    spectrum, mean_gain = equation.spectrum, equation.mean_gain
    gain = mean_gain[1:] / np.max(mean_gain)
    let_in = Line(spectrum.frequency[1:], gain, "expected gain (right)", BLUE, "dashed", right=True)
    return Panel(
        [*_target_and_error(spectrum), let_in],
        *_spectrum_axes(spectrum, equation.unit),
        Axis("gain against its largest", low=0, high=1.05, color=BLUE),
        title=equation.name,
        legend=legend,
    )


def _share(choice: WindowChoice, equation: EquationWindows, *, legend: bool) -> Panel:
    """The error's share at every window length, with the lengths in use and the better ones."""
    low, high = choice.recommended
    share = equation.error_share
    marks = [
        Span(low, high, label=f"recommended, {low:.2g} to {high:.2g} s", color=BLUE, opacity=0.15),
        Span(
            choice.alpha,
            choice.beta,
            label=f"in use, {choice.alpha:.3g} to {choice.beta:.3g} s",
            hatched=True,
        ),
        Line(choice.length, np.where(share > 0, 100 * share, np.nan), color=RUST, width=1.6),
    ]
    lengths = Axis("window length / s", log=True, low=choice.length[0], high=choice.length[-1])
    down = Axis("error / % of the signal", log=True)
    return Panel(marks, lengths, down, title=equation.name, legend=legend)

"""Figures of an identification: fit, window sweep, validation."""

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from riecjax.assessment.assess import Assessment
from riecjax.assessment.refining import Validations
from riecjax.charts import (
    BLACK,
    BLUE,
    BOLD,
    GREY,
    RUST,
    SMALL,
    THIN,
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
from riecjax.criteria.criterion import DOLS
from riecjax.elements.evidence import ElementTests, chart_of_all
from riecjax.equations.term import AbstractTerm, evaluate
from riecjax.errors import DataError
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.projection import linearised
from riecjax.findings import in_percent
from riecjax.leaves import TINY
from riecjax.shows import chart_of
from riecjax.validation import HeldOut, ResidualTests, WindowSweep
from riecjax.validation.residuals import EquationResidual

if TYPE_CHECKING:
    from riecjax.equations.equation import Equation
    from riecjax.records.record import Record

MOST_POINTS = 4000
"""Samples or windows of a panel that are drawn."""
NORMAL_95 = 1.96
"""Standard deviations of a normal law to either side that hold 95 % of it."""
BEYOND, FAINT = 1.05, 0.15
"""Times the data's reach, to which an axis goes that is alike on both sides; and how
opaque a stretch is that curves cross."""


def identification_figures(result: Assessment) -> dict[str, Chart]:
    """`fit`; `curves` if the model has some; `correlation` of the parameters; and of each test
    what [`figures_of`][riecjax.reporting.result_figures.figures_of] it shows.
    """
    curves = identified_curves(result)
    figures = {"fit": _fit_figure(result), **({"curves": curves_figure(curves)} if curves else {})}
    for test in result.tests:
        figures |= figures_of(test, result.estimate)
    return {**figures, "correlation": correlation_figure(result.estimate)}


def figures_of(test: Any, estimate: Estimate) -> dict[str, Chart]:
    """Figures of a test of an estimate by their names: one by the test's, if it has a chart."""
    match test:
        case ElementTests():
            return {test.evidence[0].figure or test.name: chart_of_all(test.evidence)}
        case WindowSweep():
            return {test.name: sweep_figure(test, estimate)}
        case ResidualTests():
            figures = map(residual_figure, test.equations)
            return {f"residual_{i}": figure for i, figure in enumerate(figures, 1)}
        case Validations():
            return {
                f"validation_{i}": held_out_figure(run.held, f"{run.recording.name}: ")
                for i, run in enumerate(test.runs, 1)
                if run.held.signals
            }
    is_registered = chart_of.dispatch(type(test)) is not chart_of.dispatch(object)
    return {test.name: chart_of(test)} if is_registered or hasattr(test, "chart") else {}


@chart_of.register
def sweep_figure(sweep: WindowSweep, estimate: Estimate | None = None) -> Chart:
    """Each parameter over window length, with its interval, and the estimate of a fit."""
    length = np.sqrt(np.asarray(sweep.alpha) * np.asarray(sweep.beta))
    errors = np.asarray(sweep.standard_errors)
    ends = {} if estimate is None else estimate.interval_by_name()
    panels: list[Panel] = []
    for j, name in enumerate(sweep.parameters):
        values, error = np.asarray(sweep.theta[:, j]), NORMAL_95 * errors[:, j]
        look = {"width": 1, "markers": True, "error": error}
        marks = [Line(length, values, "window length alone, 95 %", BLUE, **look)]
        if estimate is not None:
            interval = Span(*ends[name], "y", "interval of the fit, 95 %")
            marks = [interval, Level(float(estimate[name]), dashes="dashed"), *marks]
        y = Axis(labelled(name, sweep.table[name].unit))
        panels.append(Panel(marks, Axis("window length / s", log=True), y))
    return Chart(
        in_rows(panels),
        "Estimates from windows of one length after another. An exact model finds the same at "
        "every length; a drift says that the model leaves something out, or that short windows "
        "show the sensors' noise.",
        legend=True,
    )


def correlation_figure(estimate: Estimate) -> Chart:
    """Correlation matrix of the estimates."""
    names, label = estimate.parameters, "correlation of the estimates"
    places, values = range(len(names)), np.asarray(estimate.correlation)
    return single(
        [HeatMap(places, places, values, label, -1, 1, numbers=2)],
        Axis(categories=names),
        Axis(categories=names, reverse=True),
        "Correlation of the estimates: parameters near 1 or -1 are known better in combination "
        "than each by itself.",
    )


@chart_of.register
def held_out_figure(held: HeldOut, about: str = "") -> Chart:
    """Measured and simulated signals over time; the caption after words about the recording."""
    assert held.measured is not None
    time, panels = np.asarray(held.measured.elapsed), []
    for name, compared in held.signals.items():
        measured, fit = held.measured.signal(name), float(compared.fit)
        lines = [
            Line(time, measured.with_nan, "measured", GREY, width=BOLD),
            Line(time, held.record.signal(name).with_nan, "simulated", RUST, width=THIN),
        ]
        title = name if np.isnan(fit) else f"{name}: fit {max(fit, -999.0):.1f} %"
        panels.append(Panel(lines, y=Axis(labelled(name, measured.unit)), title=title))
    caption = (
        f"{about}measured, and simulated by the identified model from the inputs alone. A fit of "
        "100 % is perfect, at 0 % the measured mean would do as well."
    )
    return over_time(panels, caption, legend=True)


def over_time(panels: Sequence[Panel], caption: str, legend: bool = False) -> Chart:
    """Panels above one another, over one axis of time."""
    rows = [[panel] for panel in panels]
    rows[-1] = [replace(panels[-1], x=Axis("time / s"))]
    return Chart(rows, caption, share_x=True, legend=legend)


def _fit_figure(result: Assessment) -> Chart:
    """Each stage's rows, measured against explained, and what is left of them."""
    estimate, model = result.estimate, result.model
    assert estimate.summary is not None
    summary = linearised(model, estimate.summary, estimate.known)
    # Of each stage, from some rows of each equation on each record: what was measured (less what
    # known terms give), what is explained of it, and when the rows' windows start.
    rows: dict[int, list[tuple[np.ndarray, ...]]] = {}
    for i, recording in enumerate(summary.recordings):
        values = estimate.table.values_of(estimate.values, i)
        known = {row.local for row in estimate.table.of_recording(i) if row.name in estimate.known}
        for place, equation in ((k, e) for k, stage in enumerate(recording.stages) for e in stage):
            assert equation.survey is not None
            target, *columns = np.asarray(equation.survey.rows).T
            held = dict(zip(equation.parameters, columns))
            target = target - sum(values[n] * held.pop(n) for n in (*held,) if n in known)
            # Where no term is known beforehand, an earlier stage found the coefficient that sets
            # the scale.
            if held and not target.any():
                first = next(iter(held))
                target = -values[first] * held.pop(first)
            explained = sum((values[n] * x for n, x in held.items()), np.zeros(target.size))
            of_stage = rows.setdefault(place, [])
            of_stage.append((target, explained, np.asarray(equation.survey.start)))
    above, beneath = [], []
    cloud: dict[str, Any] = {"size": SMALL, "opacity": 0.5}
    for stage, name in zip(estimate.stages, estimate.stage_names):
        held = estimate.criterion.row_unit(model.stages[stage.stage][0].unit)
        unit = f" / ({held})" if held else ""
        measured, explained, start = map(np.concatenate, zip(*rows[stage.stage]))
        chosen = np.linspace(0, measured.size - 1, min(measured.size, MOST_POINTS)).astype(int)
        measured, explained, start = measured[chosen], explained[chosen], start[chosen]
        reach = BEYOND * max(np.abs(measured).max(), np.abs(explained).max(), TINY)
        ends = [-reach, reach]
        marks = [Line(ends, ends, color=GREY), Dots(explained, measured, color=BLUE, **cloud)]
        x = Axis(f"explained by the model{unit}", low=-reach, high=reach)
        above.append(Panel(marks, x, Axis(f"measured{unit}", low=-reach, high=reach), title=name))
        left = Dots(start, measured - explained, color=RUST, **cloud)
        beneath.append(Panel([Level(0), left], Axis("time / s"), Axis(f"residual{unit}")))
    return Chart(
        (above, beneath),
        "Each equation's rows: measured against explained, which an exact model puts on the line, "
        "and what is left over time.",
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
    curves: dict[str, IdentifiedCurve] = {}
    estimate, record = result.estimate, result.recordings[0].record
    stages = (result.model.stages[stage.stage] for stage in estimate.stages)
    for equation, term in ((e, term) for stage in stages for e in stage for term in e.terms):
        shared = all(name in estimate for name in term.parameters)
        if term.basis is not None and shared and term.name not in curves:
            curves[str(term.name)] = _curve(estimate, equation, term, record)
    return list(curves.values())


def curves_figure(curves: list[IdentifiedCurve]) -> Chart:
    """Each curve with its interval over the samples, and beneath it what it leaves of them."""
    above: list[Panel | None] = []
    beneath: list[Panel | None] = []
    for curve in curves:
        low, high = curve.y - NORMAL_95 * curve.error, curve.y + NORMAL_95 * curve.error
        marks = [Line(curve.x, curve.y, "identified, 95 %", BLUE, width=BOLD, low=low, high=high)]
        left = None
        if curve.samples is not None:
            x, y = curve.samples
            marks.insert(0, Line(x, y, "what the equation leaves for it", GREY, width=THIN))
            residual = Line(x, y - np.interp(x, curve.x, curve.y), color=RUST, width=THIN)
            label = labelled("residual", curve.unit)
            left = Panel([Level(0), residual], Axis(curve.of), Axis(label))
        above.append(Panel(marks, Axis(curve.of), Axis(labelled(curve.name, curve.unit))))
        beneath.append(left)
    sampled = any(panel is not None for panel in beneath)
    return Chart(
        [above, beneath] if sampled else [above],
        "Curves with their 95 % interval, over what the equation leaves for them sample by sample"
        f"{', and beneath them what they leave of that' if sampled else ''}. A curve that samples "
        "go round in loops depends on more than its variable.",
        share_x=True,
    )


def _curve(
    estimate: Estimate, equation: "Equation", term: AbstractTerm, record: "Record"
) -> IdentifiedCurve:
    sampled = evaluate(term.of, record)
    variable = np.asarray(sampled.values)
    # The curve's value by the rest of the equation, at every sample: with all other coefficients
    # known, sign sum_i c_i b_i = target is what a pointwise row says.
    found = estimate.table.values_of(estimate.values, 0)
    others = {n: found[n] for n in equation.parameters if n not in term.parameters}
    samples = None
    with contextlib.suppress(DataError):  # a derivative that is not recorded
        rows = eqx.filter_jit(DOLS().rows)(equation, record).fix(others)
        valid = slice(None) if rows.valid is None else np.asarray(rows.valid)
        left = np.asarray(rows.target)[valid] / float(term.factor)
        samples = variable[valid][:MOST_POINTS], left[:MOST_POINTS]
    x = variable if sampled.present is None else variable[np.asarray(sampled.present)]
    grid = np.linspace(x.min(), x.max(), GRID)
    functions = np.asarray(eqx.filter_jit(type(term).functions)(term, jnp.asarray(grid)))
    values = np.array([float(estimate[name]) for name in term.parameters])
    # sqrt(b(x)^T C b(x)): the covariance of the coefficients, those held at a value left out.
    free = [i for i, name in enumerate(term.parameters) if name in estimate.parameters]
    at = [estimate.parameters.index(term.parameters[i]) for i in free]
    covariance = np.asarray(estimate.covariance)[np.ix_(at, at)]
    variance = np.einsum("ig,ij,jg->g", functions[free], covariance, functions[free])
    label = term.of if isinstance(term.of, str) else getattr(term.of, "__name__", "variable")
    name = label.strip("_").replace("_", " ")
    return IdentifiedCurve(
        name=str(term.name),
        # Coefficients of a roof or a step are values of the curve, whose unit is the equation's.
        unit=equation.unit,
        of=labelled(name, dict(record.units).get(name)),
        x=grid,
        y=values @ functions,
        error=np.sqrt(np.maximum(variance, 0)),
        samples=samples,
    )


EXCERPT = 400
"""Values of an error that are drawn one by one."""
LEAST_SHOWN = 1e-8
"""Share of the largest density below which an axis ends: nothing but rounding is there."""


@chart_of.register
def spectra_figure(tests: ResidualTests) -> Chart:
    """The error's spectrum of each equation beneath the target's."""
    rows = [
        (replace(_spectra(each), title=f"{each.name}: error {_share(each)}", columns=1),)
        for each in tests.equations
    ]
    return Chart(rows, "What the equations leave over frequency.")


def _share(residual: EquationResidual) -> str:
    return f"{in_percent(residual.error.relative_rms, '.3g')} of the target"


def residual_figure(residual: EquationResidual) -> Chart:
    """What one equation leaves over time and frequency."""
    error = residual.error
    # The error and its target over the longest stretch's beginning.
    runs = error.runs() or [slice(0, 1)]
    run = max(runs, key=lambda each: each.stop - each.start)
    shown = slice(run.start, min(run.start + EXCERPT, run.stop))
    times = np.asarray(error.times)
    excerpt = Panel(
        [
            Line(times[shown], np.asarray(error.target)[shown], "target", GREY, width=BOLD),
            Line(times[shown], np.asarray(error.error)[shown], "error", RUST, width=THIN),
        ],
        Axis("time / s"),
        Axis(labelled("target and error", residual.error.unit)),
        title=f"{residual.name}: error {_share(residual)}",
    )
    whole = np.where(np.asarray(error.present), np.asarray(error.impulse), np.nan)
    unit = f"{residual.error.unit} s" if residual.error.unit else ""
    impulse = Panel(
        [Level(0), Line(times, whole, color=RUST, width=THIN)],
        Axis("time / s"),
        Axis(labelled("impulse of the error", unit)),
    )
    return Chart(
        (
            (excerpt, impulse),
            (_spectra(residual),),
        ),
        f"What {residual.name} leaves, sample by sample: root mean square error "
        f"{_share(residual)}. Above, its beginning and its impulse; below, its spectrum, in which "
        "a mode that the model leaves out is a peak.",
    )


def _spectra(residual: EquationResidual) -> Panel:
    spectrum, peak = residual.spectrum, residual.peak
    frequency, unit = spectrum.frequency[1:], residual.error.unit
    marks: list[Line | Span | Level] = [
        Level(spectrum.band, "x", "the signals' power ends", BLACK, "dotted"),
        Line(frequency, _positive(spectrum.target), "target", GREY, width=BOLD),
        Line(frequency, _positive(spectrum.explained), "explained", BLUE, "dashed"),
        Line(frequency, _positive(spectrum.error), "error", RUST),
    ]
    if peak is not None:
        share = in_percent(peak.share, ".0f")
        label = f"peak near {peak.frequency:.3g} Hz: {share} of the power in it"
        marks.insert(0, Span(peak.low, peak.high, label=label, color=RUST, opacity=FAINT))
    largest = max(np.max(spectrum.target[1:]), np.max(spectrum.error[1:]))
    least = max(np.min(spectrum.error[1:]), LEAST_SHOWN * largest)
    across = Axis("frequency / Hz", log=True, low=frequency[0], high=frequency[-1])
    low = 0.5 * float(least) if least > 0 else None
    square = f"{unit}²" if unit.isalnum() else f"({unit})²" if unit else "1"
    density = Axis(f"power density / ({square}/Hz)", log=True, low=low)
    return Panel(marks, across, density, columns=2)


def _positive(density: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n-1"]:
    """Densities for a logarithmic axis: without the mean, and with gaps where there is none."""
    return np.where(density[1:] > 0, density[1:], np.nan)

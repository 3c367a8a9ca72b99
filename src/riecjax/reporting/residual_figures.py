"""Figures of what an identified model leaves: over time, correlated, and over frequency."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from riecjax.reporting.charts.chart import (
    BLACK,
    BLUE,
    GREY,
    RUST,
    Axis,
    Chart,
    Dots,
    Level,
    Line,
    Panel,
    Span,
    Stems,
    labelled,
)
from riecjax.studies.choice import EquationWindows, WindowChoice
from riecjax.validation.residuals import EquationResidual, ResidualTests
from riecjax.validation.time_series import CrossCorrelation, ErrorSpectrum, unbroken

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

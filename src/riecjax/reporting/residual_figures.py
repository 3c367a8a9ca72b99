"""Figures of what an identified model leaves: over time, correlated, and over frequency."""

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
from riecjax.validation.equation_errors import EquationError
from riecjax.validation.residuals import EquationResidual, ResidualTests
from riecjax.validation.time_series import CrossCorrelation, ErrorSpectrum, unbroken

EXCERPT = 400
"""Values of an error that are drawn one by one."""
LEAST_SHOWN = 1e-8
"""Density against the largest one below which nothing is drawn."""


def residual_figures(tests: ResidualTests) -> dict[str, Chart]:
    """`residual_1`, ... for each equation."""
    return {f"residual_{i + 1}": _figure(each) for i, each in enumerate(tests.equations)}


def _figure(residual: EquationResidual) -> Chart:
    unit = residual.unit
    excerpt = _excerpt(
        residual.error,
        unit,
        f"{residual.name}: error {100 * residual.relative_rms:.3g} % of the target",
    )
    return Chart(
        (
            (excerpt, _impulse(residual.error, unit)),
            (_autocorrelation(residual), _following(residual.follows)),
            (_spectra(residual),),
        ),
        f"What {residual.name} leaves, sample by sample: root mean square error "
        f"{100 * residual.relative_rms:.3g} % of the target. Above, its beginning and its impulse; "
        "then its correlation with itself and with the signal that it follows most; and its "
        "spectrum, in which a mode that the model leaves out is a peak.",
        (9, 8.6),
        heights=(1, 1, 1.3),
    )


def _excerpt(error: EquationError, unit: str, title: str) -> Panel:
    """The error and its target over the longest stretch's beginning."""
    runs = unbroken(np.asarray(error.present)) or [slice(0, 1)]
    run = max(runs, key=lambda each: each.stop - each.start)
    shown = slice(run.start, min(run.start + EXCERPT, run.stop))
    time = np.asarray(error.times)[shown]
    return Panel(
        [
            Line(time, np.asarray(error.target)[shown], "target", GREY, width=1.6),
            Line(time, np.asarray(error.error)[shown], "error", RUST, width=0.9),
        ],
        Axis("time / s"),
        Axis(labelled("target and error", unit)),
        title=title,
    )


def _impulse(error: EquationError, unit: str) -> Panel:
    impulse = np.where(np.asarray(error.present), np.asarray(error.impulse), np.nan)
    return Panel(
        [Level(0), Line(np.asarray(error.times), impulse, color=RUST, width=0.8)],
        Axis("time / s"),
        Axis(labelled("impulse of the error", f"{unit} s" if unit else "")),
    )


def _autocorrelation(residual: EquationResidual) -> Panel:
    found = residual.autocorrelation
    return Panel(
        [
            Span(-found.bound, found.bound, "y", "white noise, 95 %"),
            Level(0),
            Stems(found.lag, found.values, color=BLUE),
        ],
        Axis("lag / s"),
        Axis("autocorrelation of the error", low=-1.05, high=1.05),
    )


def _following(follows: tuple[CrossCorrelation, ...]) -> Panel | None:
    """Correlation with the signal that the error follows most."""
    if not follows:
        return None
    strongest = follows[0]
    bound = min(strongest.bound, 1.0)
    largest = Dots(
        [strongest.largest_lag],
        [strongest.largest],
        f"{strongest.largest:.2f} at {strongest.largest_lag:.3g} s",
        RUST,
        size=6,
    )
    return Panel(
        [
            Span(-bound, bound, "y", "unrelated, 95 %"),
            Level(0),
            Line(strongest.lag, strongest.values, color=BLUE, width=1.2),
            largest,
        ],
        Axis("error later by / s"),
        Axis(f"correlation with {strongest.signal}", low=-1.05, high=1.05),
    )


def _spectra(residual: EquationResidual) -> Panel:
    spectrum, peak = residual.spectrum, residual.peak
    # The mean is no oscillation, and a logarithmic axis has no zero.
    frequency = spectrum.frequency[1:]
    marks: list[Line | Span | Level] = []
    if peak is not None:
        share = f"peak near {peak.frequency:.3g} Hz: {100 * peak.share:.0f} % of the power in it"
        marks.append(Span(peak.low, peak.high, label=share, color=RUST, opacity=0.15))
    marks += [
        Level(spectrum.band, "x", "the signals' power ends", BLACK, "dotted"),
        Line(frequency, positive(spectrum.target[1:]), "target", GREY, width=1.8),
        Line(frequency, positive(spectrum.explained[1:]), "explained", BLUE, "dashed"),
        Line(frequency, positive(spectrum.error[1:]), "error", RUST),
    ]
    return Panel(
        marks,
        Axis("frequency / Hz", log=True, low=frequency[0], high=frequency[-1]),
        density_axis(spectrum, residual.unit),
        columns=2,
    )


def density_axis(spectrum: ErrorSpectrum, unit: str) -> Axis:
    """An axis of power densities, of a quantity in this unit."""
    return Axis(density_label(unit), log=True, low=density_floor(spectrum))


def density_label(unit: str) -> str:
    """Label of an axis of power densities, of a quantity in this unit."""
    square = f"{unit}²" if unit.isalnum() else f"({unit})²" if unit else "1"
    return f"power density / ({square}/Hz)"


def density_floor(spectrum: ErrorSpectrum) -> float | None:
    """Where an axis of densities may end: rounding far below them is of no interest."""
    largest = max(np.max(spectrum.target[1:]), np.max(spectrum.error[1:]))
    least = max(np.min(spectrum.error[1:]), LEAST_SHOWN * largest)
    return 0.5 * float(least) if least > 0 else None


def positive(density: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Densities with gaps where there is none, which a logarithmic axis cannot show."""
    return np.where(density > 0, density, np.nan)


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
    spectrum = equation.spectrum
    frequency = spectrum.frequency[1:]
    gain = equation.mean_gain[1:] / np.max(equation.mean_gain)
    return Panel(
        [
            Line(frequency, positive(spectrum.target[1:]), "target", GREY, width=1.8),
            Line(frequency, positive(spectrum.error[1:]), "error", RUST),
            Line(frequency, gain, "expected gain (right)", BLUE, "dashed", right=True),
        ],
        Axis("frequency / Hz", log=True, low=frequency[0], high=frequency[-1]),
        density_axis(spectrum, equation.unit),
        Axis("gain against its largest", low=0, high=1.05, color=BLUE),
        title=equation.name,
        legend=legend,
    )


def _share(choice: WindowChoice, equation: EquationWindows, *, legend: bool) -> Panel:
    """The error's share at every window length, with the lengths in use and the better ones."""
    low, high = choice.recommended
    better = f"recommended, {low:.2g} to {high:.2g} s"
    used = f"in use, {choice.alpha:.3g} to {choice.beta:.3g} s"
    share = 100 * positive(equation.error_share)
    return Panel(
        [
            Span(low, high, label=better, color=BLUE, opacity=0.15),
            Span(choice.alpha, choice.beta, label=used, hatched=True),
            Line(choice.length, share, color=RUST, width=1.6),
        ],
        Axis("window length / s", log=True, low=choice.length[0], high=choice.length[-1]),
        Axis("error / % of the signal", log=True),
        title=equation.name,
        legend=legend,
    )

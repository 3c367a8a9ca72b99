"""Figures of a choice of windows: what they let in, and the error's share at every length."""

import numpy as np

from riecjax.reporting.charts.chart import (
    BLUE,
    GREY,
    RUST,
    Axis,
    Chart,
    Line,
    Panel,
    Span,
)
from riecjax.reporting.residual_figures import density_axis, positive
from riecjax.studies.window_choice import EquationWindows, WindowChoice


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

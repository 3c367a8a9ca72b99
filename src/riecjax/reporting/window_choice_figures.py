"""Figures of a choice of windows: what they let in, and the error's share at every length."""

from typing import Any

import numpy as np

from riecjax.reporting.residual_figures import density_axis, plain_numbers, positive
from riecjax.reporting.style import BLUE, GREY, RUST, panels
from riecjax.studies.window_choice import EquationWindows, WindowChoice


def window_choice_figures(choice: WindowChoice) -> dict[str, Any]:
    """`window_choice`: a row of panels for each equation."""
    rows = len(choice.equations)
    figure, axes = panels(rows, 2, (10.5, 3.2 * rows + 0.7))
    lines, spans = [], []
    for (left, right), equation in zip(axes, choice.equations):
        lines = _draw_gain(left, equation)
        spans = _draw_share(right, choice, equation)
    # Inside the panels they would cover lines.
    figure.legend(handles=lines, fontsize="small", loc="outside upper left", ncols=len(lines))
    figure.legend(handles=spans, fontsize="small", loc="outside upper right", ncols=len(spans))
    return {"window_choice": figure}


def _draw_gain(axes: Any, equation: EquationWindows) -> list[Any]:
    """Spectra, and over them what the current windows let into an integral; returns the lines."""
    spectrum = equation.spectrum
    frequency = spectrum.frequency[1:]
    lines = [
        *axes.loglog(frequency, positive(spectrum.target[1:]), color=GREY, label="target"),
        *axes.loglog(frequency, positive(spectrum.error[1:]), color=RUST, label="error"),
    ]
    gain = axes.twinx()
    largest = np.max(equation.mean_gain)
    lines += gain.semilogx(
        frequency, equation.mean_gain[1:] / largest, color=BLUE, label="expected gain"
    )
    gain.set_ylim(0, 1.05)
    gain.set_ylabel("gain against its largest", color=BLUE)
    gain.tick_params(axis="y", colors=BLUE)
    axes.set_xlim(frequency[0], frequency[-1])
    plain_numbers(axes.xaxis)
    axes.set_title(equation.name, fontsize="medium")
    axes.set_xlabel("frequency / Hz")
    density_axis(axes, spectrum, equation.unit)
    return lines


def _draw_share(axes: Any, choice: WindowChoice, equation: EquationWindows) -> list[Any]:
    """The error's share at every window length, with the lengths in use and the better ones.

    **Returns:** the two stretches.
    """
    low, high = choice.recommended
    recommended = axes.axvspan(
        low, high, color=BLUE, alpha=0.15, label=f"recommended, {low:.2g} to {high:.2g} s"
    )
    in_use = axes.axvspan(
        choice.alpha,
        choice.beta,
        facecolor="none",
        edgecolor="0.4",
        hatch="///",
        linewidth=0,
        label=f"in use, {choice.alpha:.3g} to {choice.beta:.3g} s",
    )
    axes.loglog(choice.length, 100 * positive(equation.error_share), color=RUST, linewidth=1.6)
    axes.set_xlim(choice.length[0], choice.length[-1])
    plain_numbers(axes.xaxis)
    plain_numbers(axes.yaxis)
    axes.set_title(equation.name, fontsize="medium")
    axes.set_xlabel("window length / s")
    axes.set_ylabel("error / % of the signal")
    return [recommended, in_use]

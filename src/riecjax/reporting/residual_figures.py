"""Figures of what an identified model leaves: over time, correlated, and over frequency."""

from typing import Any

import numpy as np
from jaxtyping import Float

from riecjax.reporting.output import require_plots
from riecjax.reporting.style import BLUE, GREY, PALE, RUST, labelled
from riecjax.validation.equation_error import EquationError
from riecjax.validation.error_correlation import CrossCorrelation
from riecjax.validation.error_spectrum import ErrorSpectrum, unbroken
from riecjax.validation.residual_tests import EquationResidual, ResidualTests

EXCERPT = 400
"""Values of an error that are drawn one by one."""
LEAST_SHOWN = 1e-8
"""Density against the largest one below which nothing is drawn."""
DECADE = 12
"""Ratio of an axis' ends up to which 1, 2, 5 would be too few numbers on it."""


def residual_figures(tests: ResidualTests) -> dict[str, Any]:
    """`residual_1`, ... for each equation."""
    return {f"residual_{i + 1}": _figure(each) for i, each in enumerate(tests.equations)}


def _figure(residual: EquationResidual) -> Any:
    plt = require_plots()
    figure, axes = plt.subplot_mosaic(
        [["excerpt", "impulse"], ["itself", "signal"], ["spectrum", "spectrum"]],
        figsize=(9, 8.2),
        height_ratios=(1, 1, 1.3),
        layout="constrained",
    )
    figure.suptitle(
        f"{residual.name}: equation error {residual.relative_rms:.3g} of the target, "
        f"root mean square over samples",
        fontsize="medium",
    )
    unit = residual.unit
    _draw_excerpt(axes["excerpt"], residual.error, unit)
    _draw_impulse(axes["impulse"], residual.error, unit)
    _draw_autocorrelation(axes["itself"], residual)
    _draw_following(axes["signal"], residual.follows)
    _draw_spectra(axes["spectrum"], residual)
    return figure


def _draw_excerpt(axes: Any, error: EquationError, unit: str) -> None:
    """The error and its target over the longest stretch's beginning."""
    runs = unbroken(np.asarray(error.present)) or [slice(0, 1)]
    run = max(runs, key=lambda each: each.stop - each.start)
    shown = slice(run.start, min(run.start + EXCERPT, run.stop))
    time = _time(error)[shown]
    axes.plot(time, np.asarray(error.target)[shown], color=GREY, linewidth=1.4, label="target")
    axes.plot(time, np.asarray(error.error)[shown], color=RUST, linewidth=0.9, label="error")
    axes.margins(y=0.2)  # room for the legend
    axes.set_xlabel("time / s")
    axes.set_ylabel(labelled("target and error", unit))
    axes.legend(fontsize="small", framealpha=0.9, loc="upper right", ncols=2)


def _draw_impulse(axes: Any, error: EquationError, unit: str) -> None:
    impulse = np.where(np.asarray(error.present), np.asarray(error.impulse), np.nan)
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.plot(_time(error), impulse, color=RUST, linewidth=0.8)
    axes.set_xlabel("time / s")
    axes.set_ylabel(labelled("impulse of the error", f"{unit} s" if unit else ""))


def _draw_autocorrelation(axes: Any, residual: EquationResidual) -> None:
    found = residual.autocorrelation
    axes.axhspan(-found.bound, found.bound, color=PALE, label="white noise, 95 %")
    axes.vlines(found.lag, 0, found.values, color=BLUE, linewidth=1)
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.set_ylim(-1.05, 1.05)
    axes.set_xlabel("lag / s")
    axes.set_ylabel("autocorrelation of the error")
    axes.legend(fontsize="small", framealpha=0.9, loc="upper right")


def _draw_following(axes: Any, follows: tuple[CrossCorrelation, ...]) -> None:
    """Correlation with the signal that the error follows most."""
    if not follows:
        axes.set_visible(False)
        return
    from matplotlib.ticker import MaxNLocator

    strongest = follows[0]
    bound = min(strongest.bound, 1.0)
    axes.axhspan(-bound, bound, color=PALE, label="unrelated, 95 %")
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.plot(strongest.lag, strongest.values, color=BLUE, linewidth=1.2)
    axes.plot(
        [strongest.largest_lag],
        [strongest.largest],
        "o",
        color=RUST,
        label=f"{strongest.largest:.2f} at {strongest.largest_lag:.3g} s",
    )
    axes.set_ylim(-1.05, 1.05)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel("error later by / s")
    axes.set_ylabel(f"correlation with {strongest.signal}")
    axes.legend(fontsize="small", framealpha=0.9, loc="upper right")


def _draw_spectra(axes: Any, residual: EquationResidual) -> None:
    spectrum, peak = residual.spectrum, residual.peak
    # The mean is no oscillation, and a logarithmic axis has no zero.
    frequency = spectrum.frequency[1:]
    axes.loglog(frequency, positive(spectrum.target[1:]), color=GREY, linewidth=1.6, label="target")
    axes.loglog(frequency, positive(spectrum.explained[1:]), color=BLUE, label="explained")
    axes.loglog(frequency, positive(spectrum.error[1:]), color=RUST, label="error")
    if peak is not None:
        axes.axvspan(
            peak.low,
            peak.high,
            color=RUST,
            alpha=0.15,
            label=f"peak near {peak.frequency:.3g} Hz: {100 * peak.share:.0f} % of the power in it",
        )
    axes.axvline(spectrum.band, color="0.3", linestyle=":", label="band of the model")
    axes.set_xlim(frequency[0], frequency[-1])
    plain_numbers(axes.xaxis)
    axes.set_xlabel("frequency / Hz")
    density_axis(axes, spectrum, residual.unit)
    axes.legend(fontsize="small", framealpha=0.9)


def density_axis(axes: Any, spectrum: ErrorSpectrum, unit: str) -> None:
    """Floor, ticks and label of an axis of power densities, of a quantity in this unit."""
    from matplotlib.ticker import NullLocator

    axes.set_ylim(bottom=density_floor(spectrum))
    axes.yaxis.set_minor_locator(NullLocator())  # eight to a decade take a second to draw
    axes.set_ylabel(density_label(unit))


def density_label(unit: str) -> str:
    """Label of an axis of power densities, of a quantity in this unit."""
    square = f"{unit}²" if unit.isalnum() else f"({unit})²" if unit else "1"
    return f"power density / ({square}/Hz)"


def density_floor(spectrum: ErrorSpectrum) -> float | None:
    """Where an axis of densities may end: rounding far below them is of no interest."""
    largest = max(np.max(spectrum.target[1:]), np.max(spectrum.error[1:]))
    least = max(np.min(spectrum.error[1:]), LEAST_SHOWN * largest)
    return 0.5 * float(least) if least > 0 else None


def plain_numbers(axis: Any) -> None:
    """Frequencies as 1, 2, 5, 10, not as powers of ten; more of them where they span little."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = axis.get_view_interval()
    few = high < DECADE * low
    axis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 4, 5, 6, 8) if few else (1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def positive(density: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Densities with gaps where there is none, which a logarithmic axis cannot show."""
    return np.where(density > 0, density, np.nan)


def _time(error: EquationError) -> Float[np.ndarray, " values"]:
    """Seconds from the first record's start to the middle of each shortest window."""
    step = float(error.time_step)
    return step * (np.arange(error.error.shape[0]) + 0.5 * error.span)

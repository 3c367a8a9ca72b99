"""What an identified model leaves unexplained, and what that says of the model.

Of a complete model white noise is left, or what sensors make of it. A mode that was left out
shows as a peak of the error's spectrum, and stretches of the record that do not belong together
as errors of unequal size. Each is reported only where chance does not explain it and it is large
enough to matter.

Eq. (18) says that windows drawn at random have one expected mean square error. That holds before
anything is known of the record: on a given one the errors of some stretches can outweigh all
others.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from riecjax import tails
from riecjax.criteria.windows import AbstractWindows
from riecjax.elements.catalogue import lacked, with_states
from riecjax.equations.element import Element
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model, as_model, told_apart
from riecjax.errors import DataError
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding, in_percent
from riecjax.records.record import Records, as_records
from riecjax.shows import Drawn
from riecjax.validation.equation_errors import (
    EquationError,
    errors_over_records,
    joined,
    share_of,
)

# When a peak is no chance. One periodogram scatters by its own size. The mean over K segments under
# Hann windows that overlap by half scatters by sqrt((1 + 2 c^2) / K), where neighbouring segments
# correlate by c = 1/6, so c^2 = 1/36 between their powers. The three-point smoothing
# (1, 2, 1) / 4 leaves 0.78 of that, since Hann's neighbouring frequencies correlate by 4/9. So
# the 8 segments that are asked for scatter by 0.28, and a factor of 4, log 4 = 1.4, is five
# standard deviations.
#
# How wide a mode is. Under white excitation the power of a lightly damped mode is
# 1 / (1 + ((f - f_0) / h)^2) with h = zeta f_0. It is half at f_0 - h and f_0 + h, a width of
# 2 zeta f_0, and half of it lies between: (2 / pi) arctan(1).

SEGMENTS = 32
"""A segment of the spectrum is this part of the record; segments overlap by half."""
FEWEST_SEGMENTS = 8
"""Segments below which a spectrum is too rough to look for a peak."""
SHORTEST_SEGMENT = 64
"""Samples of a segment, unless the unbroken stretches are shorter."""
BAND_SHARE = 0.99
"""Share of the power common to target and explained part that the model's band holds."""
PROMINENCE = 4.0
"""How many times the spectrum of its surroundings, on either side, a peak is: 6 dB."""
PEAK_BAND = 0.9
"""Part of the model's band in which a peak is a mode's, and not the end of the excitation."""
PEAK_SHARE = 0.3
"""Share of the error's power in the model's band that a peak holds between its half-power points.
"""


@dataclass(frozen=True)
class Peak:
    """A peak of an error's spectrum.

    **Fields:** `frequency`, half-power points `low` and `high` in hertz; `share` of the error's
    power in the model's band that lies between them; `size`, root mean square of that part
    of the error relative to the target's.
    """

    frequency: float
    low: float
    high: float
    share: float
    size: float


class ErrorSpectrum(NamedTuple):
    """One-sided power spectral densities, in (unit of the equation)^2/Hz.

    **Fields:** `frequency` in hertz; densities of `error`, `explained` part and `target`; `common`,
    real part of the density between target and explained part, to which noise in only one of them
    adds nothing; all of shape `(frequencies,)`. `segments` averaged over.
    """

    frequency: Float[np.ndarray, " frequencies"]
    error: Float[np.ndarray, " frequencies"]
    explained: Float[np.ndarray, " frequencies"]
    target: Float[np.ndarray, " frequencies"]
    common: Float[np.ndarray, " frequencies"]
    segments: int

    @property
    def band(self) -> float:
        """Hertz up to which 99 % of the power common to target and explained part lies.

        Sensor noise that differentiation raises towards half the sampling rate is in one of them
        only, so this is the band of the motion, whatever the noise above it.
        """
        running = np.cumsum(np.maximum(self.common, 0.0))
        if not running[-1] > 0:
            return float(self.frequency[-1])
        return float(self.frequency[np.searchsorted(running, BAND_SHARE * running[-1])])

    def peak(self) -> Peak | None:
        """The peak of the error that holds most power, if there is a genuine one.

        It stands out fourfold on both sides, is no wider than its frequency (a mode of half the
        critical damping), has both half-power points below nine tenths of the model's band, and
        holds 30 % of the error's power there. A rise towards half the sampling rate, as of
        differentiated noise, is no peak, nor one that only ends where the excitation does.
        """
        if self.segments < FEWEST_SEGMENTS or not np.any(self.error > 0):
            return None
        smooth = np.convolve(np.pad(self.error, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
        # The mean is no oscillation, so it does not count.
        total = np.sum(self.error, where=(self.frequency > 0) & (self.frequency <= self.band))
        whole, genuine = np.sum(self.target), []
        for top, *ends in peaks(np.maximum(smooth, np.finfo(float).tiny), PROMINENCE):
            low, high = (end * float(self.frequency[1]) for end in ends)
            inside = (self.frequency >= low) & (self.frequency <= high)
            power = np.sum(self.error, where=inside)
            of_band, size = float(share_of(power, total)), float(np.sqrt(share_of(power, whole)))
            peak = Peak(float(self.frequency[top]), low, high, of_band, size)
            narrow = high - low <= peak.frequency and high < PEAK_BAND * self.band
            if narrow and peak.share >= PEAK_SHARE:
                genuine.append(peak)
        return max(genuine, key=lambda peak: peak.share, default=None)


def peaks(density: Float[np.ndarray, " n"], factor: float) -> Iterator[tuple[int, float, float]]:
    """Highest places that are so many times what lies around them, and where half of each is
    reached to its left and right, in places.

    What lies around a peak is the higher one of the lowest values to either side, as far as it is
    the highest itself.
    """
    left, inner, right = density[:-2], density[1:-1], density[2:]
    for top in (1 + np.flatnonzero((inner > left) & (inner >= right))).tolist():
        height, sides = density[top], (density[top::-1], density[top:])
        lowest, ends = [], []
        for side in sides:
            higher = np.flatnonzero(side > height)
            lowest.append(np.min(side[: higher[0] if higher.size else side.size]))
            below = np.flatnonzero(side < height / 2)
            end = float(side.size - 1)
            if below.size:
                inside, outside = side[below[0] - 1], side[below[0]]
                end = below[0] - (height / 2 - outside) / (inside - outside)
            ends.append(end)
        if height >= factor * max(lowest):
            yield top, top - ends[0], top + ends[1]


def error_spectrum(error: EquationError) -> ErrorSpectrum:
    """Welch's spectra of an equation error and of what the model explains.

    Hann windows on segments that overlap by half, each about its mean; none reaches over a gap. A
    segment is a 32nd of the record, 64 samples at least; shorter where unbroken stretches are. Not
    under jit.
    """
    runs, length = error.runs(), SHORTEST_SEGMENT
    if runs:
        # As wanted, unless half of all samples lie in shorter stretches.
        longest_first = np.sort([run.stop - run.start for run in runs])[::-1]
        running = np.cumsum(longest_first)
        typical = int(longest_first[np.searchsorted(running, running[-1] / 2)])
        length = max(min(max(int(running[-1]) // SEGMENTS, SHORTEST_SEGMENT), typical), 2)
    series = np.stack([error.error, error.explained, error.target])
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    sums, count = np.zeros((len(ErrorSpectrum._fields) - 2, length // 2 + 1)), 0
    for run in runs:
        if run.stop - run.start < length:
            continue
        segments = np.lib.stride_tricks.sliding_window_view(series[:, run], length, axis=1)
        segments = segments[:, :: length - length // 2]
        segments = segments - np.mean(segments, axis=2, keepdims=True)
        count += segments.shape[1]
        left, explained, target = np.fft.rfft(segments * window, axis=2)
        # Of each with itself, and of the target with what is explained.
        pairs = (left, left), (explained, explained), (target, target), (target, explained)
        sums += [np.sum(a.real * b.real + a.imag * b.imag, axis=0) for a, b in pairs]
    step = float(error.time_step)
    # One-sided: all but the mean, and half the rate itself, stand for two frequencies.
    sums[:, 1 : (length + 1) // 2] *= 2
    densities = sums * step / np.sum(window**2) / max(count, 1)
    return ErrorSpectrum(np.fft.rfftfreq(length, step), *densities, segments=count)


LENGTHS = 4
"""Window lengths from alpha to beta, each at every start."""
BLOCK_LENGTH = 2
"""Longest windows to a block of time; no window reaches over its end, so blocks share no data."""
BLOCKS_TO_STRETCH = 5
"""Blocks to a stretch at least, whose scatter separates chance from change."""
MOST_STRETCHES = 8
FEWEST_STRETCHES = 3
SILENT = 1e-6
"""Mean square relative to the loudest block's below which a block is just silent."""


class WindowErrors(NamedTuple):
    """Errors of windows along the record.

    **Fields:**

    - `relative_rms`: root mean square of the windows' errors relative to the targets'.
    - `start`, `stop`: first and last time of each stretch in seconds from the first recording's
      first sample, records one after the other; shape `(stretches,)`.
    - `mean_square`: mean square error of the windows of each stretch relative to that of all.
    - `target_mean_square`: the same of the target.
    - `p_value`: probability that equal stretches differ as much; NaN where the record is too short
      for three stretches.
    """

    relative_rms: float
    start: Float[np.ndarray, " stretches"]
    stop: Float[np.ndarray, " stretches"]
    mean_square: Float[np.ndarray, " stretches"]
    target_mean_square: Float[np.ndarray, " stretches"]
    p_value: float

    @property
    def ratio(self) -> float:
        """Mean square error of the loudest stretch over the quietest's; 1 if all are silent."""
        return _ratio(self.mean_square)

    @property
    def target_ratio(self) -> float:
        """The same of the target: how uneven the motion itself is."""
        return _ratio(self.target_mean_square)


def window_errors(errors: list[EquationError], windows: AbstractWindows) -> WindowErrors | None:
    """Errors of boxcar windows over the records of one equation (not under jit).

    `None` where no record is long enough for two blocks of time of twice the longest window.
    """
    step = float(errors[0].time_step)
    alpha, beta = float(windows.alpha), float(windows.beta)
    longest = max(round(beta / step), 1)
    lags = np.unique(np.round(np.geomspace(max(alpha / step, 1), longest, LENGTHS)).astype(int))
    length = BLOCK_LENGTH * longest
    # Blocks of time of each unbroken stretch, the rest of it left out.
    every = joined(errors)
    runs = [range(run.start, run.stop - length + 1, length) for run in every.runs()]
    starts = np.array([start for run in runs for start in run], int)
    if starts.size < 2:
        return None
    # The first sample of each, and over the windows in it the mean squares of error and target.
    squares = (
        _squares(np.asarray(each) * step, starts, lags, length)
        for each in (every.error, every.target)
    )
    blocks = np.array([starts, *squares])
    size = max(BLOCKS_TO_STRETCH, -(-starts.size // MOST_STRETCHES))
    stretches: list[np.ndarray] = []
    # One value stands between records.
    ends = np.cumsum([error.error.size + 1 for error in errors])
    for of_record in np.split(blocks, np.searchsorted(starts, ends[:-1]), axis=1):
        if parts := of_record.shape[1] // size:  # as equal as possible
            edges = np.linspace(0, of_record.shape[1], parts + 1).astype(int)
            stretches += np.split(of_record, edges[1:-1], axis=1)
    # Analysis of variance of the logarithms of the blocks' mean squares. A mean square of nu
    # degrees of freedom scatters in proportion to its size, its logarithm by about sqrt(2 / nu)
    # whatever the size, as the analysis presumes; nor does one loud block decide.
    loud = [square for _, square, _ in stretches]
    p_value = float("nan")
    largest = max((square.max() for square in loud), default=0.0)
    if len(loud) >= FEWEST_STRETCHES and largest > min(square.min() for square in loud):
        logarithms = [np.log(np.maximum(square, SILENT * largest)) for square in loud]
        p_value = tails.equal_means(logarithms)
    # Every block holds as many windows, so that means of blocks are means of windows.
    _, error, target = blocks.mean(axis=1)
    middle, half = np.asarray(every.times), 0.5 * every.span * step
    first = np.array([start[0] for start, *_ in stretches], int)
    last = np.array([start[-1] + length - 1 for start, *_ in stretches], int)
    return WindowErrors(
        relative_rms=float(np.sqrt(share_of(error, target))),
        start=middle[first] - half,
        stop=middle[last] + half,
        mean_square=share_of(np.array([square.mean() for square in loud]), error),
        target_mean_square=share_of(np.array([part[2].mean() for part in stretches]), target),
        p_value=p_value,
    )


def _squares(
    values: np.ndarray, starts: np.ndarray, lags: np.ndarray, length: int
) -> Float[np.ndarray, " blocks"]:
    """Mean square of sums over every window of these lengths in blocks from `starts` on.

    A window's sum is the rise of the block's own running sum, one lag for all blocks at a time.
    """
    square = np.zeros(starts.size)
    windows = int(np.sum(length + 1 - lags))
    blocks = values[starts[:, None] + np.arange(length)]
    running = np.pad(np.cumsum(blocks, axis=1), [(0, 0), (1, 0)])
    for lag in lags:
        rises = running[:, lag:] - running[:, :-lag]
        square += np.einsum("ij,ij->i", rises, rises) / windows
    return square


def _ratio(mean_square: np.ndarray) -> float:
    largest = np.max(mean_square, initial=0.0)
    return float(largest / max(np.min(mean_square), np.finfo(float).tiny)) if largest > 0 else 1.0


NOTABLE_SIZE = 0.02
"""Share of the target below which an error does not matter."""
NOTABLE_RATIO = 10.0
"""Mean square errors of the loudest and the quietest stretch that are uneven: 3.2 in rms."""
RARE = 0.01
"""Probability by chance below which stretches are called uneven."""


class EquationResidual(NamedTuple):
    """What one equation leaves unexplained.

    **Fields:**

    - `name` of the equation, unlike that of others; its `error` over all records, see `joined`.
    - `spectrum`, and its `peak` if there is a genuine one.
    - `windows`: eq. (18) on these records; `None` for a criterion without windows, or records too
      short for four of the longest.
    - `lacking`: an element that the equation may leave out, and whether sums would tell of it.
    - `parameters` of the equation that no earlier stage has found.
    - `explained`: whether causes of what is left were weighed, and found, a fault of a sensor
      explains it, or windows let nothing of it through: then a peak of its spectrum says no more.
    """

    name: str
    error: EquationError
    spectrum: ErrorSpectrum
    peak: Peak | None
    windows: WindowErrors | None
    lacking: tuple[Element, bool] | None = None
    parameters: tuple[str, ...] = ()
    explained: bool = False

    def findings(self) -> list[Finding]:
        """`unmodelled_mode`, `uneven_errors`."""
        made: list[Finding] = []
        peak = None if self.explained else self.peak
        if peak is not None and peak.size >= NOTABLE_SIZE:
            # What the model may lack, in words, as options of `riecjax identify`, and in Python.
            words, remedy, python = "", (), ""
            if self.lacking is not None:
                element, by_sums = self.lacking
                words, python = element.to_find, element.source.replace('"', "'")
                if by_sums:
                    remedy = element.asked
                else:
                    python = f"model.with_elements({python}), then rx.refine"
            ways = "; ".join(filter(None, (" ".join(remedy), f"in Python: {python}")))
            said = (
                f"{self.name}: the equation error peaks near {peak.frequency:.3g} Hz, and "
                f"{in_percent(peak.share, '.0f')} of its power up to "
                f"{self.spectrum.band:.3g} Hz lies from {peak.low:.3g} to {peak.high:.3g} Hz: "
                f"the model leaves out a mode there, or gets one wrong. "
                f"{f'{words} ({ways}), or use' if words else 'Use'} windows longer than "
                f"{1 / peak.frequency:.2g} s, over which it averages out."
            )
            # What rings is that share of what windows leave of the target.
            left = 0.0 if self.windows is None else self.windows.relative_rms
            doubt = min(left * float(np.sqrt(peak.share)), 1.0)
            step = words if remedy or not python else f"{words}, in Python: {python}"
            made.append(Finding("unmodelled_mode", said, doubt=doubt, remedy=remedy, step=step))
        errors = self.windows
        if (
            errors is not None
            and errors.relative_rms >= NOTABLE_SIZE
            and errors.p_value < RARE
            and errors.ratio >= NOTABLE_RATIO
        ):
            loud, times = int(np.argmax(errors.mean_square)), np.sqrt(errors.target_ratio)
            louder = f"{times:.2g} times" if times < 100 else "more than 100 times"
            said = (
                f"{self.name}: errors of windows are {np.sqrt(errors.ratio):.2g} times as large "
                f"from {errors.start[loud]:.4g} to {errors.stop[loud]:.4g} s as in the quietest "
                f"stretch (the signal {louder}), so the estimate depends on it. See "
                f"what differs there; leave it out, or identify the stretches one by one."
            )
            made.append(Finding("uneven_errors", said))
        return [finding._replace(parameters=self.parameters) for finding in made]

    def entry(self) -> dict[str, Any]:
        """Numbers of the tests, without the series, as plain data for JSON."""
        windows = self.windows
        return {
            "relative_rms": float(self.error.relative_rms),
            "band_hz": self.spectrum.band,
            "peak": self.peak,
            "windows": None
            if windows is None
            else {
                "relative_rms": windows.relative_rms,
                "mean_square_ratio": windows.ratio,
                "target_mean_square_ratio": windows.target_ratio,
                "p_value": None if np.isnan(windows.p_value) else windows.p_value,
            },
        }


class ResidualTests(Drawn, eqx.Module):
    """What every equation of a model leaves unexplained; see [`residual_tests`][].

    **Fields:** `equations`, in the order of the model's stages; `faults` of sensors that
    explain what some of them leave.
    """

    name = "residual_tests"
    equations: tuple[EquationResidual, ...]
    faults: tuple[Finding, ...] = ()

    def __getitem__(self, name: str) -> EquationResidual:
        return {equation.name: equation for equation in self.equations}[name]

    def findings(self) -> list[Finding]:
        """Faults of sensors, and findings of all equations."""
        return [*self.faults, *(finding for one in self.equations for finding in one.findings())]

    def entry(self) -> dict[str, Any]:
        """Numbers of the tests by equation, as plain data for JSON."""
        return {equation.name: equation.entry() for equation in self.equations}


def residual_tests(
    model: Equation | Model,
    records: Records,
    estimate: Estimate | Mapping[str, float | Array],
    *,
    windows: AbstractWindows | None = None,
    errors: list[list[EquationError]] | None = None,
    faults: Sequence[Finding] = (),
    weighed: bool = False,
) -> ResidualTests:
    """Test what an identified model leaves unexplained (not under jit).

    **Arguments:**

    - `estimate`: of these records or of others; or parameter name to value.
    - `windows`: whose errors eq. (18) is tested on; by default those of the estimate.
    - `errors` of each equation on each record, from [`errors_over_records`][], if they are known.
    - `faults` of sensors that explain what is left where their signals are read; whether all
      causes were `weighed`, of which they are what the recordings demand.

    **Raises:** `ModelError` for a parameter without a value; `DataError` for a missing signal,
    records of unequal time steps or too short ones.
    """
    model = as_model(model)
    recordings = [with_states(model, record) for record in as_records(records)]
    steps = [float(record.time_step) for record in recordings]
    if not np.allclose(steps, steps[0], rtol=1e-6):
        listed = ", ".join(f"{step:.4g}" for step in dict.fromkeys(steps))
        raise DataError(
            f"residuals over several records need one time step; there are {listed} s. Bring the "
            f"records to one rate first (riecjax.resample)."
        )
    values = estimate.single().values if isinstance(estimate, Estimate) else estimate
    if windows is None and isinstance(estimate, Estimate) and estimate.criterion is not None:
        windows = estimate.criterion.windows
    if errors is None:
        errors = errors_over_records(model, recordings, values)
    names = told_apart([of_equation[0].name for of_equation in errors])
    first = recordings[0]
    reads = [e.signals_read(first, of[0].span) for e, of in zip(model.equations, errors)]
    faulty = {name for fault in faults for name in fault.signals}
    concerned = {name for fault in faults for name in fault.doubts}
    fastest = np.inf if windows is None else 2 / float(windows.alpha)
    earlier = set[str]()
    found, parts = [], zip(names, errors, model.equations, reads, strict=True)
    for name, of_equation, equation, read in parts:
        error = joined(of_equation)
        spectrum = error_spectrum(error)
        peak, own = spectrum.peak(), {*equation.parameters} - earlier
        earlier |= own
        lacking = lacked(model, equation)
        term = None if lacking is None else lacking.term_in(equation)
        residual = EquationResidual(
            name,
            error,
            spectrum,
            peak,
            None if windows is None else window_errors(of_equation, windows),
            lacking=None if lacking is None or term is None else (lacking, term.is_linear),
            parameters=tuple(name for name in equation.parameters if name in own),
            explained=(weighed and not own.isdisjoint(concerned))
            or not faulty.isdisjoint(read)
            or (peak is not None and peak.frequency > fastest),
        )
        found.append(residual)
    return ResidualTests(tuple(found), tuple(faults))

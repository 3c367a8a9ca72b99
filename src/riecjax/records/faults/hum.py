"""Lines of the mains: found in a signal's spectrum, told from motion, and taken off."""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
import scipy

from riecjax.errors import DataError
from riecjax.records.faults.sampled_signal import (
    Found,
    SampledSignal,
    Signals,
    fault,
    percent,
    size_of,
)
from riecjax.records.linear_op import LinearOp, Operations, step
from riecjax.records.record import Record

MAINS = (50.0, 60.0, 50 / 3)
"""Hz of grids of countries and of railways."""
HARMONICS = 5
DRIFT = 0.004
"""Share of its frequency by which a grid is off at most."""
LONGEST = 20.0
"""Seconds in which a grid's frequency is steady, and to a spectrum."""
BY_CHANCE = 1e-4
"""Probability of a false alarm on noise, per signal and grid."""
AROUND = 20
"""Bins to each side whose median is what surrounds a bin."""
ALONE = 6.0
"""Hz to each side in which no other line may be: drives and friction have them in rows."""
OUTSHONE = 2.0
"""Times that a line's power is that of any other bin there."""
LOBE = 3
"""Bins to each side over which Hann's window spreads a line."""
SMALLEST = 3e-3
"""Amplitude of a line, as a share of the signal's rms, below which it does nothing."""
MOTION = 2.0
"""Factor within which amplitudes of a signal and of its derivative are those of one motion."""
OVERTONES = 20
"""Multiples of a signal's strongest line that may be its own."""
STEADY = 10.0
"""Seconds over which a line's amplitude and phase are averaged."""


class Line(NamedTuple):
    """A line of a grid.

    **Fields:** Hz of the harmonic, `nominal` and as `seen`, folded where sampling does so; its
    `amplitude`.
    """

    nominal: float
    seen: float
    amplitude: float


class Spectrum(NamedTuple):
    """Power of a signal through Hann's window, the mean over its stretches.

    **Fields:** `power`, the squared amplitude of a line at each bin, over the squared `rms`;
    `chance`, the probability that noise stands out of what surrounds a bin as far as it does;
    `resolution`, Hz between bins.
    """

    power: np.ndarray
    chance: np.ndarray
    resolution: float
    rms: float

    def folded(self, frequency: float) -> float:
        """Where a frequency is seen at this sampling rate."""
        rate = 2 * self.resolution * (self.power.size - 1)
        return abs(frequency - rate * round(frequency / rate))

    def line(self, frequency: float, chance: float) -> Line | None:
        """The line about a frequency, `None` where none stands out alone."""
        seen, tolerance = self.folded(frequency), DRIFT * frequency
        low = int(np.floor((seen - tolerance) / self.resolution))
        high = int(np.ceil((seen + tolerance) / self.resolution))
        if low < LOBE + 2 or high > self.power.size - 2 - LOBE:
            return None
        peak = low + int(np.argmax(self.power[low : high + 1]))
        is_chance = self.chance[peak] * (high - low + 1) > chance
        if is_chance or self.power[peak] < max(self.power[[peak - 1, peak + 1]]):
            return None
        # No other line is around, but harmonics that sampling folds beside this one.
        own = LOBE + int(HARMONICS * tolerance / self.resolution)
        half = int(ALONE / self.resolution) + own
        near = np.arange(max(peak - half, LOBE), min(peak + half, self.power.size - LOBE))
        others = near[np.abs(near - peak) > own]
        if self.power[peak] <= OUTSHONE * np.max(self.power[others], initial=0.0):
            return None
        at = self.interpolated(peak)
        off = at / self.resolution - peak
        loss = np.sinc(off) / (1 - off**2)
        return Line(frequency, at, self.rms * float(np.sqrt(self.power[peak]) / loss))

    def interpolated(self, peak: int) -> float:
        """Hz of a line, by what Hann's window makes of its two highest bins."""
        side = 1 if self.power[peak + 1] > self.power[peak - 1] else -1
        ratio = np.sqrt(self.power[peak + side] / self.power[peak])
        return float(self.resolution * (peak + side * (2 * ratio - 1) / (ratio + 1)))


def spectrum_of(values: np.ndarray, time_step: float) -> Spectrum | None:
    """The spectrum of samples, straight across gaps; `None` where there is none to speak of."""
    known = np.flatnonzero(~np.isnan(values))
    if not known.size or values.size < 4 * AROUND:
        return None
    values = np.interp(np.arange(values.size), known, values[known])
    size = size_of(values)
    values = values / size
    rms = float(np.std(values))
    if not rms:
        return None
    length = min(values.size, max(int(LONGEST / time_step), 8 * AROUND))
    length -= length % 2
    stretches = values.size // length
    rows = (values[: stretches * length].reshape(stretches, length) - np.mean(values)) / rms
    rows = rows - np.mean(rows, axis=1, keepdims=True)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    power = np.mean(np.abs(np.fft.rfft(rows * window, axis=1)) ** 2, axis=0) * (4 / length) ** 2
    around = np.pad(power, AROUND, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(around, 2 * AROUND + 1)
    usual = np.partition(around, AROUND, axis=1)[:, AROUND]
    ratio = power / np.maximum(
        usual * stretches / scipy.special.gammaincinv(stretches, 0.5), np.finfo(float).tiny
    )
    # Of so many bins through Hann's window, the median tells as much as the mean of a quarter.
    freedom = 2 * stretches, 2 * stretches * (2 * AROUND + 1) / 4
    chance = scipy.special.fdtrc(*freedom, ratio)
    return Spectrum(power, chance, 1 / (length * time_step), rms * size)


def lines_of(spectrum: Spectrum, grid: float) -> list[Line]:
    """The lines of a grid that stand out."""
    lines = (spectrum.line(grid * k, BY_CHANCE / HARMONICS) for k in range(1, HARMONICS + 1))
    return [line for line in lines if line]


@fault(
    "hum",
    "Take it out (on the command line: {option}), and look at the cable's screen and earth.",
    "--notch",
)
def hum(signal: SampledSignal, signals: Signals) -> Iterator[Found]:
    """Grids whose lines stand in a signal and are not what the machine does.

    A machine that turns at 50 Hz moves all channels, a velocity 2 pi 50 times as far as its
    position. The mains keep to no such ratio; where no pair tells, they are taken for a fault of a
    channel that is alone with them.
    """
    if (spectrum := _sensor_spectrum(signal)) is None or not _foreign(spectrum):
        return
    found = ((name, _sensor_spectrum(other)) for name, other in signals.recorded.items())
    spectra = {name: spectrum for name, spectrum in found if spectrum is not None}
    by_grid = {name: _foreign(spectrum) for name, spectrum in spectra.items()}
    for grid in (grid for grid in MAINS if grid in by_grid.get(signal.name, {})):
        lines = {name: of[grid] for name, of in by_grid.items() if grid in of}
        largest = {name: max(of, key=lambda line: line.amplitude) for name, of in lines.items()}
        verdicts = {n: _is_motion(n, line, spectra, signals.pairs) for n, line in largest.items()}
        own = verdicts.pop(signal.name)
        others = {*verdicts.values()}
        if own or (own is None and others and (True in others or False not in others)):
            continue
        amplitude, rms = largest[signal.name].amplitude, spectra[signal.name].rms
        share = sum((line.amplitude / rms) ** 2 for line in lines[signal.name]) / 2
        at = ", ".join(
            f"{line.nominal:.4g} Hz"
            if abs(line.seen - line.nominal) <= 0.1 * grid
            else f"{line.nominal:.4g} Hz (seen at {line.seen:.4g} Hz)"
            for line in lines[signal.name]
        )
        yield Found(
            f"a line at {at} stands out, of amplitude {signal.with_unit(amplitude)}, "
            f"{percent(amplitude, rms)} of the signal's rms, as the mains put there. It acts as "
            f"noise with {percent(share, 1.0)} of the signal's power.",
            doubt=min(share, 1.0),
            value=f"{grid:.4g}",
        )


def _sensor_spectrum(signal: SampledSignal) -> Spectrum | None:
    """The spectrum of what a sensor recorded: steps of a command have lines of their own."""
    return None if signal.is_command else spectrum_of(signal.values, signal.time_step)


def _foreign(spectrum: Spectrum) -> dict[float, list[Line]]:
    """By grid its lines that matter, but overtones of the strongest; each of one grid.

    Sampling may fold harmonics onto each other: lower ones come first.
    """
    strongest = LOBE + 2 + int(np.argmax(spectrum.power[LOBE + 2 : -LOBE - 2]))
    drive = spectrum.interpolated(strongest)
    orders = OVERTONES * (spectrum.chance[strongest] <= BY_CHANCE)
    overtones = drive * np.arange(2, orders + 1)
    lines = [(grid, line) for grid in MAINS for line in lines_of(spectrum, grid)]
    claimed: dict[float, list[Line]] = {}
    for grid, line in sorted(lines, key=lambda pair: round(pair[1].nominal / pair[0])):
        lower = itertools.chain.from_iterable(claimed.values())
        alone = all(abs(line.seen - other.seen) > LOBE * spectrum.resolution for other in lower)
        near = 0.1 * spectrum.resolution * line.seen / drive
        is_overtone = np.any(np.abs(line.seen - overtones) < near)
        if alone and not is_overtone and line.amplitude > SMALLEST * spectrum.rms:
            claimed.setdefault(grid, []).append(line)
    return claimed


def _is_motion(
    name: str, line: Line, spectra: Mapping[str, Spectrum], pairs: Sequence[tuple[str, str]]
) -> bool | None:
    """Whether a line is motion, by a signal's derivative; `None` if that is hidden."""
    omega, verdict = 2 * np.pi * line.seen, None
    for signal, derivative in pairs:
        partner = derivative if name == signal else signal
        if name not in (signal, derivative) or partner not in spectra:
            continue
        # The largest amplitude within a bin, of a line or not.
        spectrum = spectra[partner]
        at = round(line.seen / spectrum.resolution)
        near = slice(max(at - 1, 0), at + 2)
        there = spectrum.rms * float(np.sqrt(np.max(spectrum.power[near])))
        expected = line.amplitude * (omega if name == signal else 1 / omega)
        # A larger line there, or noise, says nothing against this one.
        if there < expected / MOTION:
            verdict = False
        elif there < MOTION * expected and np.min(spectrum.chance[near]) < BY_CHANCE:
            return True
    return verdict


@step
def notch(record: Record, frequency: float | Literal["auto"]) -> Operations:
    """Take a frequency in Hz and those of its harmonics that stand out off all signals.

    Each is a sinusoid whose frequency is found from the samples, and whose amplitude and phase, by
    least squares through Hann's window, are steady over 10 s; nothing is lost at ends and gaps.
    `"auto"` takes off the lines of 50, 60 and 16.7 Hz that stand out, and where none does,
    nothing.

    **Raises:** `DataError` for a frequency that is no positive number, or is seen as none.
    """
    if frequency != "auto" and not 0 < frequency < np.inf:
        raise DataError(f"the frequency to notch is a positive number of Hz; got {frequency}.")
    time_step = float(record.time_step)
    at = "" if frequency == "auto" else f" at {frequency:g} Hz"
    for name in record.arrays:
        values = record.signal(name).with_nan
        if (spectrum := spectrum_of(values, time_step)) is None:
            continue
        if frequency == "auto":
            lines = [line for grid in MAINS for line in lines_of(spectrum, grid)]
        else:
            seen = spectrum.folded(frequency)
            if not spectrum.resolution < seen < spectrum.resolution * (spectrum.power.size - 2):
                raise DataError(
                    f"a line of {frequency:g} Hz is seen at {seen:.3g} Hz at this sampling rate "
                    f"and length of record, where it cannot be told from an offset."
                )
            exact = spectrum.line(frequency, 1.0) or Line(frequency, seen, 0.0)
            lines = [exact, *(o for o in lines_of(spectrum, frequency) if o.nominal > frequency)]
        if lines:
            values = without_lines(values, time_step, [line.seen for line in lines])
            yield name, LinearOp.of_values(f"lines of the mains{at} taken off", values)


def without_lines(values: np.ndarray, time_step: float, frequencies: Iterable[float]) -> np.ndarray:
    """Samples, shape (n,), without sinusoids of these frequencies in Hz.

    The amplitude a about a sample is what makes x(t) - Re(a exp(i w t)) smallest there, which is
    2 <x exp(-i w t)> where w is fast against the window of the mean <.>. Where the window would
    reach past the record's ends, its size is held and its phase goes on as it did.
    """
    known = ~np.isnan(values)
    size = size_of(values[known])
    left = np.where(known, values / size, 0.0)
    mean = np.sum(left) / known.sum()
    length = min((values.size + 1) // 2, int(STEADY / time_step))
    window = np.hanning(length + 2)[1:-1]
    weight = scipy.signal.fftconvolve(known.astype(float), window, "valid")
    weight = np.maximum(weight, 1e-9 * weight.max())
    place, reach = np.arange(values.size), min(length, weight.size) - 1
    inside = np.clip(place - (values.size - weight.size) // 2, 0, weight.size - 1)
    beyond = place - (values.size - weight.size) // 2 - inside
    for frequency in dict.fromkeys(frequencies):
        turn = np.exp(2j * np.pi * frequency * time_step * place)
        centred = np.where(known, left - mean, 0.0)
        inner = 2 * scipy.signal.fftconvolve(centred * turn.conj(), window, "valid") / weight
        # What the phase advances by from sample to sample, at the start and at the end.
        ends = inner[[reach, -1]] * inner[[0, -1 - reach]].conj()
        first, last = np.exp(1j * np.angle(ends) / max(reach, 1))
        amplitude = inner[inside] * np.where(beyond < 0, first, last) ** beyond
        left = left - np.real(amplitude * turn)
    return np.where(known, left * size, np.nan)

"""Sinusoids of the mains, taken off signals."""

from collections.abc import Iterable
from typing import Literal

import numpy as np

from riecjax.errors import DataError
from riecjax.records.faults.hum import (
    DRIFT,
    MAINS,
    Line,
    Spectrum,
    lines_of,
    spectrum_of,
)
from riecjax.records.preparation.filtering import with_gaps
from riecjax.records.record import Record, samples_with_nan

STEADY = 10.0
"""Seconds over which a line's amplitude and phase are averaged."""


def notch(record: Record, frequency: float | Literal["auto"]) -> Record:
    """Take a frequency in Hz and those of its harmonics that stand out off all signals.

    Each is a sinusoid whose frequency is found from the samples, and whose amplitude and phase, by
    least squares through Hann's window, are steady over 10 s; nothing is lost at ends and gaps.
    `"auto"` takes off the lines of 50, 60 and 16.7 Hz that stand out, and where none does,
    nothing.

    **Raises:** `DataError` for a frequency that is no positive number, or is seen as none.
    """
    if frequency != "auto" and not (np.isfinite(frequency) and frequency > 0):
        raise DataError(f"the frequency to notch is a positive number of Hz; got {frequency}.")
    step, columns = float(record.time_step), {}
    for name in record.arrays:
        values = samples_with_nan(record, name)
        spectrum = spectrum_of(values, step)
        if spectrum is None:
            continue
        lines = _lines(spectrum, frequency)
        if lines:
            columns[name] = without_lines(values, step, [line.seen for line in lines])
    return with_gaps(record, columns, noise=record.noise) if columns else record


def _lines(spectrum: Spectrum, frequency: float | Literal["auto"]) -> list[Line]:
    if frequency == "auto":
        return [line for grid in MAINS for line in lines_of(spectrum, grid)]
    seen = spectrum.folded(frequency)
    if not spectrum.resolution < seen < spectrum.resolution * (spectrum.power.size - 2):
        raise DataError(
            f"a line of {frequency:g} Hz is seen at {seen:.3g} Hz at this sampling rate and length "
            f"of record, where it cannot be told from an offset."
        )
    harmonics = [line for line in lines_of(spectrum, frequency) if line.nominal > frequency]
    exact = spectrum.line(frequency, DRIFT, 1.0)
    return [exact or Line(frequency, seen, 0.0), *harmonics]


def without_lines(values: np.ndarray, time_step: float, frequencies: Iterable[float]) -> np.ndarray:
    """Samples, shape (n,), without sinusoids of these frequencies in Hz.

    The amplitude a about a sample is what makes x(t) - Re(a exp(i w t)) smallest there, which is
    2 <x exp(-i w t)> where w is fast against the window of the mean <.>. Where the window would
    reach past the record's ends, its size is held and its phase goes on as it did.
    """
    known = ~np.isnan(values)
    size = float(np.max(np.abs(values[known]))) or 1.0
    left = np.where(known, values / size, 0.0)
    mean = np.sum(left) / known.sum()
    length = min((values.size + 1) // 2, int(STEADY / time_step))
    window = np.hanning(length + 2)[1:-1]

    from scipy.signal import oaconvolve  # takes half a second, which few records need

    weight = oaconvolve(known.astype(float), window, mode="valid")
    weight = np.maximum(weight, 1e-9 * weight.max())
    before = (values.size - weight.size) // 2
    after = values.size - weight.size - before
    time = np.arange(values.size) * time_step
    for frequency in dict.fromkeys(frequencies):
        turn = np.exp(2j * np.pi * frequency * time)
        centred = np.where(known, left - mean, 0.0)
        inner = 2 * oaconvolve(centred * turn.conj(), window, mode="valid") / weight
        reach = min(length, inner.size) - 1
        first, last = (
            np.exp(1j * np.angle(inner[k + reach] * inner[k].conj()) / max(reach, 1))
            for k in (0, inner.size - 1 - reach)
        )
        amplitude = np.concatenate(
            [
                inner[0] * first ** np.arange(-before, 0),
                inner,
                inner[-1] * last ** np.arange(1, after + 1),
            ]
        )
        left = left - np.real(amplitude * turn)
    return np.where(known, left * size, np.nan)

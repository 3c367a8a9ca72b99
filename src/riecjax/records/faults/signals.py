"""Faults of sensors, converters and loggers, found in the samples alone.

No check fires on what machines do: axes at rest, relays and steps, encoders that show one value for
a while, bumps in a road. The message says what to do about a fault.
"""

from collections.abc import Collection, Iterable, Iterator

import numpy as np

from riecjax.findings import Finding
from riecjax.records.faults.clipping import clipped
from riecjax.records.faults.copies import copied_signals
from riecjax.records.faults.hum import hum
from riecjax.records.faults.missing import missing_samples
from riecjax.records.faults.quantisation import quantised
from riecjax.records.faults.sampled_signal import FEW_LEVELS, SampledSignal, sampled_signal
from riecjax.records.faults.stuck_sensor import stuck
from riecjax.records.record import Record
from riecjax.records.resolution import MOST_OUTLIERS

FEWEST_SAMPLES = 50
"""Present samples below which only missing and constant signals are reported."""
OUTLIER_SCALES = 6.0
"""Robust standard deviations from the running median past which a sample may be an outlier."""
OUTLIER_GAP = 1.5
"""Times that the least outlier stands out further than the most extreme other sample."""
OUTLIER_LOCAL = 1.5
"""Times that an outlier stands out further than its six neighbours range."""


# Values too large to be squared are for the fit to refuse; here they only compare as infinite.
@np.errstate(over="ignore", invalid="ignore")
def check_signals(
    record: Record,
    names: Iterable[str],
    *,
    computed: Collection[str] = (),
    pairs: Iterable[tuple[str, str]] = (),
) -> list[Finding]:
    """Look for faults of sensors, converters and loggers in these signals.

    Codes: `missing_samples`, `constant_signal`, `clipped`, `stuck_sensor`, `outliers`,
    `quantised`, `copied_signal` and `hum`. A signal that is constant, or has fewer than 50 samples,
    is not looked at further. Not under jit.

    **Arguments:** `computed`, signals that no sensor recorded, of which only what a computation
    keeps is reported; `pairs` of a signal and its derivative, which tell hum from motion.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    signals = {name: sampled_signal(record, name) for name in dict.fromkeys(names)}
    others = {name: sampled_signal(record, name) for name in record.arrays if name not in signals}
    findings = list(missing_samples(record, signals.values()))
    for name, signal in signals.items():
        if signal.levels.size == 1:
            findings.append(
                signal.finding(
                    "constant_signal",
                    f"never varies from {signal.with_unit(signal.levels[0])}, so nothing can be "
                    f"identified from it. Check that the channel was connected and is the right "
                    f"one.",
                )
            )
        elif signal.sample_count >= FEWEST_SAMPLES:
            rest = [s for key, s in {**signals, **others}.items() if key != name]
            if name not in computed:
                findings += clipped(signal)
                findings += stuck(signal, rest)
            findings += _outliers(signal)
            findings += quantised(signal)
    recorded = {n: s for n, s in {**signals, **others}.items() if n not in computed}
    recorded = {n: s for n, s in recorded.items() if s.sample_count >= FEWEST_SAMPLES}
    findings += copied_signals([recorded[name] for name in signals if name in recorded])
    findings += hum(recorded, [p for p in pairs if {*p} <= {*recorded}], tuple(signals))
    return findings


def _outliers(signal: SampledSignal) -> Iterator[Finding]:
    """One or two samples that leave their surroundings further than any other sample does."""
    values = signal.values
    if signal.levels.size <= FEW_LEVELS:
        return
    windows = np.lib.stride_tricks.sliding_window_view(values, 5)
    off = np.full(values.size, np.nan)
    off[2:-2] = np.abs(values[2:-2] - np.median(windows, axis=1))
    known = off[~np.isnan(off)]
    if not known.size:
        return
    # Past the steps of its converter, past what is usual, and past the widest gap in between.
    least = max(
        OUTLIER_SCALES * 1.4826 * float(np.median(known)),
        2.0 * float(np.quantile(known, 1 - MOST_OUTLIERS)),
        2.0 * float(np.nanquantile(np.abs(np.diff(values)), 1 - 2 * MOST_OUTLIERS)),
        5.0 * signal.resolution,
    )
    ranked = np.sort(known)[::-1][: int(MOST_OUTLIERS * known.size) + 2]
    gap = (ranked[:-1] > least) & (ranked[:-1] > OUTLIER_GAP * ranked[1:])
    if not gap.any():
        return
    limit = ranked[np.flatnonzero(gap)[-1]]
    far = np.flatnonzero(off >= limit)
    groups = np.split(far, np.flatnonzero(np.diff(far) > 1) + 1)
    if not all(_is_isolated(values, off, group) for group in groups):
        return
    yield signal.finding(
        "outliers",
        f"{far.size} sample(s) stand out from their neighbours by up to "
        f"{signal.with_unit(float(np.max(off[far])))}, where no other sample does by more than "
        f"{signal.with_unit(float(np.max(known[known < limit])))}, first at "
        f"{signal.time[far[0]]:.4g} s. Unless they really acted, mark them as missing (NaN): least "
        f"squares follow them.",
    )


def _is_isolated(values: np.ndarray, off: np.ndarray, group: np.ndarray) -> bool:
    """Up to two samples, between neighbours that agree with each other."""
    if group.size > 2:
        return False
    near = np.concatenate([values[group[0] - 3 : group[0]], values[group[-1] + 1 :][:3]])
    return bool(np.min(off[group]) > OUTLIER_LOCAL * np.ptp(near[~np.isnan(near)]))

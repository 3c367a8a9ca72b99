"""Faults of sensors, converters and loggers, found in the samples alone.

No check fires on what machines do: axes at rest, relays and steps, encoders that show one value for
a while, bumps in a road. The message says what to do about a fault.
"""

from collections.abc import Collection, Iterable

import numpy as np

from riecjax.findings import Finding
from riecjax.records.faults.clipping import clipped
from riecjax.records.faults.copies import copied_signals
from riecjax.records.faults.hum import hum
from riecjax.records.faults.missing import missing_samples
from riecjax.records.faults.outliers import outliers
from riecjax.records.faults.quantisation import quantised
from riecjax.records.faults.sampled_signal import sampled_signal
from riecjax.records.faults.saturation import saturated
from riecjax.records.faults.stuck_sensor import stuck
from riecjax.records.record import Record

FEWEST_SAMPLES = 50
"""Present samples below which only missing and constant signals are reported."""


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
                findings += [*clipped(signal, rest)] or [*saturated(signal, rest)]
                findings += stuck(signal, rest)
            findings += outliers(signal, rest)
            findings += quantised(signal)
    recorded = {n: s for n, s in {**signals, **others}.items() if n not in computed}
    recorded = {n: s for n, s in recorded.items() if s.sample_count >= FEWEST_SAMPLES}
    findings += copied_signals([recorded[name] for name in signals if name in recorded])
    findings += hum(recorded, [p for p in pairs if {*p} <= {*recorded}], tuple(signals))
    return findings

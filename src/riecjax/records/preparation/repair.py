"""Spikes replaced by what the samples around them say; what a sensor could not show left out."""

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.errors import DataError
from riecjax.findings import Finding
from riecjax.records.faults.held import held
from riecjax.records.faults.outliers import DONE, Treatment, finding_of, too_many
from riecjax.records.faults.sampled_signal import sampled_signal
from riecjax.records.faults.spikes import find_spikes
from riecjax.records.preparation.filtering import with_gaps
from riecjax.records.reading.selected import Selection
from riecjax.records.record import Record, samples_with_nan
from riecjax.records.time_base import SHORTEST_PAUSE


class Treated(NamedTuple):
    """Samples without their spikes, what was done in words, and what is amiss with them."""

    values: Float[np.ndarray, " n"]
    words: str = ""
    finding: Finding | None = None


def repair_outliers(record: Record, *signals: str, how: Treatment = "repair") -> Record:
    """Replace spikes of one to three samples by what the samples around them say.

    A spike is found against the noise around it: its sixth differences stand out by 4.5 standard
    deviations, and it lies 6 off a polynomial of degree 3, 5 or 7 through the 8 samples to each
    side, weighed by Tukey's biweight. Steps, corners and pulses of commands stay. Of a signal of
    which more than 5 % are spikes nothing is changed: that is a fault of its channel.

    **Arguments:** the signals to repair, all if none is named; `how`: `"repair"`, `"missing"` to
    mark spikes as missing, or `"keep"`.

    **Raises:** `DataError` for a signal that the record lacks, or another treatment.
    """
    time, units = np.asarray(record.elapsed), dict(record.units)
    treated = {
        name: treat(name, samples_with_nan(record, name), time, how, units.get(name, ""))
        for name in signals or record.arrays
    }
    changed = {name: each.values for name, each in treated.items() if each.words}
    return with_gaps(record, changed, noise=record.noise.of(*changed)) if changed else record


def leave_out(record: Record, *signals: str) -> Record:
    """Mark as missing what a stuck sensor showed, or one at the end of its range.

    These are the samples of which `stuck_sensor` and `clipped` speak: a long run of one value, and
    a limit into which the signal ran. Windows that touch one count no more.

    **Raises:** `DataError` for no signal, one that the record lacks, or one of which nothing would
    be left.
    """
    if not signals:
        raise DataError(f"name the signals to leave out of; there are: {', '.join(record.arrays)}.")
    every = {
        name: sampled_signal(record, name) for name in {**dict.fromkeys(signals), **record.arrays}
    }
    columns = {}
    for name in signals:
        others = [signal for other, signal in every.items() if other != name]
        places = held(every[name], others)
        if places.any():
            columns[name] = np.where(places, np.nan, every[name].values)
            if np.isnan(columns[name]).all():
                raise DataError(
                    f"nothing would be left of '{name}': it is at its limit throughout."
                )
    return with_gaps(record, columns, noise=record.noise)


def treat_all(
    columns: Mapping[str, Float[np.ndarray, " n"]],
    times: Mapping[str, Float[np.ndarray, " n"]],
    selection: Selection,
    units: Mapping[str, str],
) -> tuple[dict[str, np.ndarray], list[str], list[Finding]]:
    """Columns of a file without their spikes, what was done in words, and what is amiss with them.

    A finding concerns what is computed from a column too.

    **Arguments:** `times` of those that have stamps, the others are at the selection's time step.

    **Raises:** `DataError` for another treatment.
    """
    values, words, findings = {}, [], []
    for name, column in columns.items():
        even = (selection.time_step or 1.0) * np.arange(column.size)
        stamps = times.get(name, even)
        found = treat(name, column, stamps, selection.outliers, units.get(name, ""))
        values[name] = found.values
        if found.finding is not None:
            used = [k for k, f in selection.derive.items() if name in re.findall(r"\w+", f)]
            words.append(found.words)
            findings.append(found.finding._replace(signals=(name, *used)))
    return values, words, findings


def treat(
    name: str,
    values: Float[np.ndarray, " n"],
    time: Float[np.ndarray, " n"],
    how: Treatment = "repair",
    unit: str = "",
) -> Treated:
    """A signal without its spikes; as it is where there are none or too many.

    **Raises:** `DataError` for another treatment.
    """
    if how not in DONE:
        raise DataError(f"outliers are for {', '.join(DONE)}; got '{how}'.")
    if how == "keep":
        return Treated(values)
    steps = np.diff(time) if time.size > 1 else np.ones(1)
    pauses = np.flatnonzero(steps > SHORTEST_PAUSE * np.median(steps)) + 1
    # No polynomial reaches across a pause.
    spikes = find_spikes(np.insert(values, pauses, np.nan))
    if not spikes.places.size:
        return Treated(values)
    places = spikes.places - np.searchsorted(pauses + np.arange(pauses.size), spikes.places)
    spikes = spikes._replace(places=places)
    if too_many(spikes, values):
        return Treated(values)
    changed = values.copy()
    changed[places] = spikes.repaired if how == "repair" else np.nan
    done = "repaired" if how == "repair" else "marked as missing"
    words = f"{name}: {places.size} outlier{'s' * (places.size > 1)} {done}"
    return Treated(changed, words, finding_of(name, spikes, values, time - time[0], unit, how))

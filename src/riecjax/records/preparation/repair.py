"""Spikes replaced by what the samples around them say; what a sensor could not show left out."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.errors import DataError
from riecjax.findings import Finding
from riecjax.records.faults.answered import are_answered
from riecjax.records.faults.held import held
from riecjax.records.faults.outliers import DONE, Treatment, finding_of, too_many
from riecjax.records.faults.sampled_signal import sampled_signal
from riecjax.records.faults.spikes import Spikes, find_spikes
from riecjax.records.faults.wrapped import unwrapped
from riecjax.records.preparation.filtering import with_gaps
from riecjax.records.record import Record, samples_with_nan
from riecjax.records.time_base import SHORTEST_PAUSE


class Treated(NamedTuple):
    """Samples as they are after treatment; spikes among them as they were recorded, if there were
    some, and whether they acted: then they are still there."""

    values: Float[np.ndarray, " n"]
    spikes: Spikes | None = None
    acted: bool = False


def repair_outliers(record: Record, *signals: str, how: Treatment = "repair") -> Record:
    """Replace spikes of one to three samples by what the samples around them say.

    A spike is found against the noise around it: its sixth differences stand out by 4.5 standard
    deviations, and it lies 6 off a polynomial of degree 3, 5 or 7 through the 8 samples to each
    side, weighed by Tukey's biweight. Steps, corners and pulses of commands stay, and blows to
    which another signal answers. Of a signal of which more than 5 % are spikes nothing is changed:
    that is a fault of its channel.

    **Arguments:** the signals to repair, all if none is named; `how`: `"repair"`, `"missing"` to
    mark spikes as missing, or `"keep"`.

    **Raises:** `DataError` for a signal that the record lacks, or another treatment.
    """
    every = {**dict.fromkeys(signals), **record.arrays}
    columns = {name: samples_with_nan(record, name) for name in every}
    times = dict.fromkeys(columns, np.asarray(record.elapsed))
    treated = _treated(signals or tuple(columns), columns, times, how)
    changed = {n: one.values for n, one in treated.items() if one.spikes and not one.acted}
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
    units: Mapping[str, str],
    step: float | None,
    how: Treatment,
    formulas: Mapping[str, str],
) -> tuple[dict[str, np.ndarray], list[str], list[Finding]]:
    """Columns of a file without their spikes, what was done in words, and what is amiss with them.

    Angles that begin anew with each turn go on, or each would be a spike or a jump. A finding
    concerns what is computed from a column too.

    **Arguments:** `times` of those that have stamps, the others are at time `step`; `how`, what
    becomes of spikes; `formulas` of signals that are computed of columns.

    **Raises:** `DataError` for another treatment.
    """
    turns = {name: unwrapped(column) for name, column in columns.items()}
    columns = {name: column for name, (column, _) in turns.items()}
    even = {name: (step or 1.0) * np.arange(column.size) for name, column in columns.items()}
    every, findings = {**even, **times}, []
    words = [f"{n}: unwrapped, {count} times" for n, (_, count) in turns.items() if count]
    treated = _treated(tuple(columns), columns, every, how)
    for name, one in treated.items():
        if one.spikes is None:
            continue
        count, time = one.spikes.places.size, every[name]
        if one.acted:
            words.append(f"{name}: {count} samples of short pulses kept, which other signals show")
            continue
        done = "repaired" if how == "repair" else "marked as missing"
        words.append(f"{name}: {count} outlier{'s' * (count > 1)} {done}")
        used = [k for k, f in formulas.items() if name in re.findall(r"\w+", f)]
        unit = units.get(name, "")
        found = finding_of(name, one.spikes, columns[name], time - time[0], unit, how)
        findings.append(found._replace(signals=(name, *used)))
    return {name: one.values for name, one in treated.items()}, words, findings


def _treated(
    names: Sequence[str],
    columns: Mapping[str, Float[np.ndarray, " n"]],
    times: Mapping[str, Float[np.ndarray, " n"]],
    how: Treatment,
) -> dict[str, Treated]:
    """These signals without spikes; as they are where there are none, too many, or they acted.

    **Raises:** `DataError` for another treatment.
    """
    if how not in DONE:
        raise DataError(f"outliers are for {', '.join(DONE)}; got '{how}'.")
    treated = {name: Treated(columns[name]) for name in names}
    if how == "keep":
        return treated
    for name in names:
        treated[name] = _of_signal(columns[name], times[name], how)
    without = {**columns, **{name: one.values for name, one in treated.items()}}
    for name, one in treated.items():
        if one.spikes is None:
            continue
        others = [
            values
            for other, values in without.items()
            if other != name and np.array_equal(times[other], times[name])
        ]
        if are_answered(one.spikes.places, others):
            treated[name] = Treated(columns[name], one.spikes, acted=True)
    return treated


def _of_signal(
    values: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"], how: Treatment
) -> Treated:
    steps = np.diff(time) if time.size > 1 else np.ones(1)
    pauses = np.flatnonzero(steps > SHORTEST_PAUSE * np.median(steps)) + 1
    # No polynomial reaches across a pause.
    spikes = find_spikes(np.insert(values, pauses, np.nan))
    if not spikes.places.size or too_many(spikes, values):
        return Treated(values)
    places = spikes.places - np.searchsorted(pauses + np.arange(pauses.size), spikes.places)
    changed = values.copy()
    changed[places] = spikes.repaired if how == "repair" else np.nan
    return Treated(changed, spikes._replace(places=places))

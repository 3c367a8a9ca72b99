"""Spikes replaced by what the samples around them say; what a sensor could not show left out."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.errors import DataError
from riecjax.findings import Finding
from riecjax.records.faults.sampled_signal import sampled_signal
from riecjax.records.faults.signals import dropouts, limits, long_runs
from riecjax.records.faults.spikes import (
    DONE,
    Spikes,
    Treatment,
    are_answered,
    find_spikes,
    finding_of,
    too_many,
)
from riecjax.records.linear_op import LinearOp, Operations, step
from riecjax.records.record import Record
from riecjax.records.time_base import SHORTEST_PAUSE

TURNS = (2 * np.pi, 360.0)
"""A turn in radians and in degrees."""
QUICKEST = 0.25
"""Turns from sample to sample past which nothing tells which way it went."""
MOST = 0.05
"""Share of samples that begin a turn at most."""
REGISTERS = (16, 32)
"""Bits of registers of signed numbers."""


def unwrapped(values: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], int]:
    """An angle that goes on from turn to turn, and how often it began anew; 0 if it never did.

    It is one whose values fill a turn, and jump from one end of it to the other, and nowhere else.
    """
    known = np.flatnonzero(~np.isnan(values))
    steps = np.diff(values[known])
    sizes = np.abs(steps)
    for turn in TURNS:
        jumps = sizes > turn / 2
        if not jumps.any() or np.mean(jumps) > MOST:
            continue
        usual, reach = np.max(sizes[~jumps], initial=0.0), np.ptp(values[known])
        around = np.abs(sizes[jumps] - turn) <= 2 * usual
        if usual < QUICKEST * turn and turn - 2 * usual <= reach <= turn + usual and around.all():
            whole = values.copy()
            whole[known] -= turn * np.cumsum(np.append(0, np.where(jumps, np.sign(steps), 0)))
            return whole, int(jumps.sum())
    return values, 0


def signed(values: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], int]:
    """A register of signed numbers that was read as unsigned put right, and its bits; 0 if none.

    Below zero it counts down from 2^bits: it holds whole numbers, and leaps from one end of that
    range to the other where the signed number passes zero by no more than it steps elsewhere.
    """
    known = values[~np.isnan(values)]
    for bits in REGISTERS:
        count = 2.0**bits
        inside = known.size > 1 and known.min() >= 0 and count / 2 < known.max() < count
        if not inside or (known != np.floor(known)).any():
            continue
        whole = np.where(values >= count / 2, values - count, values)
        leaps = np.abs(np.diff(known)) > count / 2
        steps = np.abs(np.diff(whole[~np.isnan(values)]))
        usual = np.max(steps[~leaps], initial=0.0)
        if leaps.any() and usual < count / 4 and np.max(steps[leaps]) <= 2 * usual:
            return whole, bits
    return values, 0


class Treated(NamedTuple):
    """Samples as they are after treatment, their spikes as they were recorded, and whether these
    acted: then they are still there."""

    values: Float[np.ndarray, " n"]
    spikes: Spikes
    acted: bool = False


@step
def repair_outliers(record: Record, *signals: str, how: Treatment = "repair") -> Operations:
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
    columns = {n: record.signal(n).with_nan for n in {**dict.fromkeys(signals), **record.arrays}}
    times = dict.fromkeys(columns, np.asarray(record.elapsed))
    for name, one in _treated(signals or tuple(columns), columns, times, how).items():
        if not one.acted:
            yield name, LinearOp.of_values("{}: without outliers", one.values)


@step
def leave_out(record: Record, *signals: str) -> Operations:
    """Mark as missing what a stuck sensor showed, or one at the end of its range.

    These are the samples of which `stuck_sensor` and `clipped` speak: a long run of one value, and
    a limit into which the signal ran. Windows that touch one count no more.

    **Raises:** `DataError` for no signal, one that the record lacks, or one of which nothing would
    be left.
    """
    if not signals:
        raise DataError(f"name the signals to leave out of; there are: {', '.join(record.arrays)}.")
    every = {
        name: sampled_signal(record, name) for name in dict.fromkeys([*signals, *record.arrays])
    }
    for name in signals:
        signal = every[name]
        others = [every[other] for other in record.arrays if other != name]
        values = signal.values.copy()
        stuck = np.zeros(signal.run_starts.size, bool)
        stuck[[*long_runs(signal, others), *dropouts(signal)]] = True
        values[np.repeat(stuck, signal.run_lengths)] = np.nan
        # Limits that may be real among them.
        for side in limits(signal):
            values[side.sign * (signal.values - side.extreme) >= -signal.rounding] = np.nan
        if np.isnan(values).all():
            raise DataError(f"nothing would be left of '{name}': it is at its limit throughout.")
        yield name, LinearOp.of_values("{}: left out where it is stuck or at its limit", values)


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
    every = {n: times.get(n, (step or 1.0) * np.arange(v.size)) for n, v in columns.items()}
    words = [f"{n}: unwrapped, {count} times" for n, (_, count) in turns.items() if count]
    treated, findings = _treated(tuple(columns), columns, every, how), []
    for name, (_, spikes, acted) in treated.items():
        count = spikes.places.size
        if acted:
            words.append(f"{name}: {count} samples of short pulses kept, which other signals show")
        else:
            done = "repaired" if how == "repair" else "marked as missing"
            words.append(f"{name}: {count} outlier{'s' * (count > 1)} {done}")
            used = [k for k, f in formulas.items() if name in re.findall(r"\w+", f)]
            time, unit = every[name] - every[name][0], units.get(name, "")
            finding = finding_of(name, spikes, columns[name], time, unit, how)
            findings.append(finding._replace(signals=(name, *used)))
    return {**columns, **{name: one.values for name, one in treated.items()}}, words, findings


def _treated(
    names: Sequence[str],
    columns: Mapping[str, Float[np.ndarray, " n"]],
    times: Mapping[str, Float[np.ndarray, " n"]],
    how: Treatment,
) -> dict[str, Treated]:
    """Of these signals those with spikes, unless there are too many.

    **Raises:** `DataError` for another treatment.
    """
    if how not in DONE:
        raise DataError(f"outliers are for {', '.join(DONE)}; got '{how}'.")
    treated: dict[str, Treated] = {}
    for name in names if how != "keep" else ():
        values, time = columns[name], times[name]
        steps = np.diff(time) if time.size > 1 else np.ones(1)
        pauses = np.flatnonzero(steps > SHORTEST_PAUSE * np.median(steps)) + 1
        # No polynomial reaches across a pause.
        spikes = find_spikes(np.insert(values, pauses, np.nan))
        if spikes.places.size and not too_many(spikes, values):
            places = spikes.places - np.searchsorted(pauses + np.arange(pauses.size), spikes.places)
            changed = values.copy()
            changed[places] = spikes.repaired if how == "repair" else np.nan
            treated[name] = Treated(changed, spikes._replace(places=places))
    without = {**columns, **{name: one.values for name, one in treated.items()}}
    for name, (_, spikes, _) in treated.items():
        others = (n for n in without if n != name and np.array_equal(times[n], times[name]))
        if are_answered(spikes.places, [without[other] for other in others]):
            treated[name] = Treated(columns[name], spikes, acted=True)
    return treated

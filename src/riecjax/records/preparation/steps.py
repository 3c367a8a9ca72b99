"""From a record as read to the records that a model's equations are estimated and validated on."""

import contextlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from riecjax.errors import DataError
from riecjax.records.faults.hum import notch
from riecjax.records.faults.signals import holding, leave_out
from riecjax.records.linear_op import Step, words_of
from riecjax.records.noise_judgement import judged
from riecjax.records.preparation.filtering import (
    differentiate,
    local_slope,
    low_pass,
    remove_drift,
    remove_line,
    remove_offset,
    unfilter,
)
from riecjax.records.preparation.resampling import set_clocks, shift, upsample
from riecjax.records.reading.units import readings
from riecjax.records.record import Record
from riecjax.records.time_base import STEP_TOLERANCE
from riecjax.settings import Prepare, Read


def halves(preparation: Prepare) -> tuple[Prepare, Prepare]:
    """What comes before signals are aligned, and what comes after."""
    names = list(Prepare.options())
    at = names.index("align")
    first, last = ({n: getattr(preparation, n) for n in part} for part in (names[:at], names[at:]))
    return Prepare(**first), Prepare(**last)


def idle_cuts(preparation: Prepare, record: Record) -> dict[str, str]:
    """Of `start` and `stop`, those that cut nothing off a record, and that in words."""
    time = np.asarray(record.elapsed)
    idle = {}
    if preparation.start is not None and preparation.start <= time[0]:
        idle["start"] = f"a cut from {preparation.start:g} s on removes nothing: {_lasts(record)}"
    if preparation.stop is not None and preparation.stop >= time[-1]:
        idle["stop"] = f"a cut up to {preparation.stop:g} s removes nothing: {_lasts(record)}"
    return idle


def prepare(
    record: Record, derivatives: Mapping[str, str], preparation: Prepare
) -> tuple[Record, list[str]]:
    """Take the steps; add `derivatives` (new signal to its signal) that are still missing.

    Those are added before the record is thinned, which would coarsen their differences, but for
    signals that are held from row to row: of a noisy sensor's signal by local polynomials; of what
    is filtered already, is a derivative itself or has no noise, by differences.

    **Returns:** the prepared record, and the steps that were taken, in words.

    **Raises:** `DataError` for a missing signal or settings that the record does not allow.
    """
    p = replace(preparation, **dict.fromkeys(idle_cuts(preparation, record)))
    words = []
    if p.start is not None or p.stop is not None:
        record = cut(p.start, p.stop, record)
        low = "the start" if p.start is None else f"{p.start:g} s"
        high = "the end" if p.stop is None else f"{p.stop:g} s"
        words.append(f"cut from {low} to {high}")
    # In the order in which they are taken, each of the record that those before it made, but for
    # alignment and missing derivatives, which depend on what is found.
    steps: list[tuple[Step[...], Sequence[Any]]] = [
        *((leave_out, (name,)) for name in p.left_out),
        (shift, (p.shifts,)),
        (set_clocks, (p.clocks,)),
        (unfilter, (p.lags,)),
        (remove_line, (p.zeros, p.slopes)),
        *((remove_offset, (name,)) for name in p.offsets),
        *((remove_drift, (name,)) for name in p.drifts),
        *((notch, (hertz,)) for hertz in p.notches),
        (low_pass, (p.cutoffs,)),
        (upsample, (p.upsample,)),
        *((differentiate, (signal, name)) for name, signal in p.derivatives.items()),
    ]
    for step, asked in steps:
        if not any(asked):  # of no signal
            continue
        ops = dict(step.ops(record, *asked))
        record = record.through(ops)
        words += words_of(ops)
    missing = {name: of for name, of in derivatives.items() if name not in record.arrays}
    held = holding(record, {*missing.values()} & {*record.arrays}) if p.every > 1 else set[str]()
    # What a held signal's derivative is the signal of is held with it.
    for name, of in missing.items():
        held |= {name} if of in held else set[str]()
    record, early = _with_derivatives(record, missing.keys() - held, derivatives)
    if p.every > 1:
        record, early = record.every(p.every), [*early, f"one sample of {p.every}"]
    record, late = _with_derivatives(record, missing.keys() & held, derivatives)
    return record, [*words, *early, *late]


def _with_derivatives(
    record: Record, names: Collection[str], derivatives: Mapping[str, str]
) -> tuple[Record, list[str]]:
    """The record with derivatives of these `names`, of all `derivatives`, and how each was formed,
    in words."""
    words = []
    for name, of in ((name, of) for name, of in derivatives.items() if name in names):
        record = judged(record, "auto", of)
        record.signal(of)  # without it there is a helpful error, and no noise to look up
        kernel = record.noise.kernels[of].get(of)
        if of not in derivatives and kernel is not None and kernel.shape[-1] == 1:
            with contextlib.suppress(DataError):  # too short for them
                slope = local_slope(record, of)
                record = record.through({name: slope})
                words += words_of({name: slope})
        if name not in record.arrays:
            differences = dict(differentiate.ops(record, of, name))
            record = record.through(differences)
            words += words_of(differences)
    return record, words


def undone(record: Record, remedies: Iterable[tuple[str, ...]]) -> Record:
    """A record as these options of the command line make it, names and what each takes in turn;
    the first of several that an option takes for one signal."""
    said: dict[str, dict[str, str]] = {}
    for option, text in (pair for remedy in remedies for pair in zip(remedy[::2], remedy[1::2])):
        said.setdefault(option, {}).setdefault(text.partition("=")[0], text)
    options = {**Read.options(), **Prepare.options()}.items()
    given = {
        name: option.parsed(*said[option.flag].values())
        for name, option in options
        if option.flag in said
    }
    factors = dict[str, float](given.pop("scale", {}))
    for name, unit in given.pop("units", {}).items():
        (one, *_) = readings(unit).values()
        factors[name] = factors.get(name, 1.0) * one.factor
    record = record.with_signals({n: by * record.signal(n) for n, by in factors.items()})
    return prepare(record, {}, Prepare(**given))[0]


def cut(start: float | None, stop: float | None, record: Record) -> Record:
    """The samples between two times in seconds from the recording's first sample, both included.

    **Raises:** `DataError` if fewer than two samples lie there.
    """
    time = np.asarray(record.elapsed)
    # Stamps since 1970 are rounded to a quarter of a microsecond, and the time step with them.
    rounding = STEP_TOLERANCE * float(record.time_step)
    first = 0 if start is None else int(np.searchsorted(time, start - rounding))
    last = time.size if stop is None else int(np.searchsorted(time, stop + rounding))
    if last - first < 2:
        raise DataError(f"there are no two samples between these times; {_lasts(record)}")
    return record.part(first, last)


def _lasts(record: Record) -> str:
    first, last = (float(time) for time in np.asarray(record.elapsed)[[0, -1]])
    stamp = float(np.asarray(record.time)[0])
    stamped = f", stamped {stamp - first:.15g}" if stamp != first else ""
    return (
        f"the record lasts from {first:.6g} to {last:.6g} s, counted from its first sample"
        f"{stamped}."
    )


def split(record: Record, share: float) -> tuple[Record, Record]:
    """Hold out the last `share` of a record's samples, 0 < share < 1.

    The end, and not samples drawn at random: a drawn sample follows from its neighbours in the
    estimation part almost exactly, so that validating on it would prove nothing.

    **Returns:** the part to estimate from, and the part to validate on.

    **Raises:** `DataError` for another share, or one that leaves a part without two samples or
    without any sample of a signal.
    """
    if not 0 < share < 1:
        raise DataError(f"the share to hold out must lie between 0 and 1; got {share:g}.")
    at = record.sample_count - round(share * record.sample_count)
    if min(at, record.sample_count - at) < 2:
        raise DataError(
            f"splitting {record.sample_count} samples into {at} and {record.sample_count - at} "
            f"leaves a part without two samples. The record lasts from "
            f"{float(record.time[0]):.12g} to {float(record.time[-1]):.12g} s."
        )
    parts = record.part(0, at), record.part(at, record.sample_count)
    for part, which in zip(parts, ("estimation", "validation")):
        for name in part.arrays:
            if not part.segments([name]):
                raise DataError(
                    f"the {which} part holds no sample of '{name}'. Split elsewhere, or leave that "
                    f"signal out."
                )
    return parts

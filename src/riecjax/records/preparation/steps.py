"""From a record as read to the records that a model's equations are estimated and validated on."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from riecjax.errors import DataError
from riecjax.records.noise_judgement import judged
from riecjax.records.preparation import (
    differentiate,
    leave_out,
    low_pass,
    notch,
    remove_drift,
    remove_offset,
    set_clocks,
    shift,
    unfilter,
    upsample,
    with_local_derivative,
)
from riecjax.records.record import Record
from riecjax.records.time_base import STEP_TOLERANCE
from riecjax.settings import Prepare


class Step(NamedTuple):
    """One step, in words for the result's provenance, and what it does."""

    words: str
    apply: Callable[[Record], Record]


def halves(preparation: Prepare) -> tuple[Prepare, Prepare]:
    """What comes before signals are aligned, and what comes after."""
    names = ("start", "stop", "left_out", "shifts", "clocks", "lags")
    first = Prepare(**{name: getattr(preparation, name) for name in names})
    last = {n: getattr(preparation, n) for n in Prepare.options() if n not in names}
    return first, Prepare(**last)


def idle_cuts(preparation: Prepare, record: Record) -> dict[str, str]:
    """Of `start` and `stop`, those that cut nothing off a record, and that in words."""
    time = np.asarray(record.elapsed)
    idle = {}
    if preparation.start is not None and preparation.start <= time[0]:
        idle["start"] = f"a cut from {preparation.start:g} s on removes nothing: {_lasts(record)}"
    if preparation.stop is not None and preparation.stop >= time[-1]:
        idle["stop"] = f"a cut up to {preparation.stop:g} s removes nothing: {_lasts(record)}"
    return idle


def steps_of(preparation: Prepare) -> list[Step]:
    """The steps in the order in which they are taken, but for alignment, which depends on what is
    found."""
    steps = []
    if preparation.start is not None or preparation.stop is not None:
        low = "the start" if preparation.start is None else f"{preparation.start:g} s"
        high = "the end" if preparation.stop is None else f"{preparation.stop:g} s"
        steps.append(
            Step(f"cut from {low} to {high}", partial(cut, preparation.start, preparation.stop))
        )
    steps += _each(preparation.left_out, "left out where it is stuck or at its limit", leave_out)
    steps += _together(preparation.shifts, "advanced: {} by {:g} s", shift)
    steps += _together(preparation.clocks, "clocks: {} by {:g} ppm", set_clocks)
    steps += _together(preparation.lags, "low-pass undone: {} of {:g} s", unfilter)
    steps += _each(preparation.offsets, "mean removed", remove_offset)
    steps += _each(preparation.drifts, "straight line removed", remove_drift)
    for hertz in preparation.notches:
        at = "" if hertz == "auto" else f" at {hertz:g} Hz"
        taken_off = partial(_with, notch, hertz)
        steps.append(Step(f"lines of the mains{at} taken off", taken_off))
    butterworth = "zero-phase 4th-order Butterworth low-pass: {} at {:g} Hz"
    steps += _together(preparation.cutoffs, butterworth, low_pass)
    if preparation.upsample > 1:
        words = f"band-limited up-sampling by {preparation.upsample}"
        steps.append(Step(words, partial(_with, upsample, preparation.upsample)))
    steps += [_derivative(name, of) for name, of in preparation.derivatives.items()]
    if preparation.every > 1:
        tens, ones = divmod(preparation.every % 100, 10)
        ending = {1: "st", 2: "nd", 3: "rd"}.get(ones, "th") if tens != 1 else "th"
        steps.append(
            Step(f"every {preparation.every}{ending} sample", lambda r: r.every(preparation.every))
        )
    return steps


def _with(step: Callable[..., Record], setting: Any, record: Record) -> Record:
    return step(record, setting)


def _each(names: Sequence[str], words: str, step: Callable[..., Record]) -> list[Step]:
    """A step for each of these signals."""
    return [Step(f"{name}: {words}", partial(_with, step, name)) for name in names]


def _together(settings: Mapping[str, float], words: str, step: Callable[..., Record]) -> list[Step]:
    """One step for all signals that have a setting."""
    what, form = words.split("{", 1)
    listed = ", ".join(f"{{{form}".format(*setting) for setting in settings.items())
    return [Step(what + listed, partial(_with, step, dict(settings)))] if settings else []


def prepare(
    record: Record, derived: Mapping[str, str], preparation: Prepare
) -> tuple[Record, list[str]]:
    """Take the steps; add derivatives (`derived`: new signal to its signal) that are still missing.

    Those are added before the record is thinned, which would coarsen their differences.

    **Returns:** the prepared record, and the steps that were taken, in words.

    **Raises:** `DataError` for a missing signal or settings that the record does not allow.
    """
    preparation = replace(preparation, **dict.fromkeys(idle_cuts(preparation, record)))
    steps = steps_of(preparation)
    thinning = steps[-1:] if preparation.every > 1 else []
    words = []
    for step in steps[: len(steps) - len(thinning)]:
        record = step.apply(record)
        words.append(step.words)
    for name, of in derived.items():
        if name not in record.signals:
            measured = of not in derived
            record, step_words = _missing_derivative(record, name, of, measured)
            words.append(step_words)
    for step in thinning:
        record = step.apply(record)
        words.append(step.words)
    return record, words


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


def _missing_derivative(record: Record, name: str, of: str, measured: bool) -> tuple[Record, str]:
    """A derivative that the model names and the file lacks.

    Of a noisy sensor's signal by local polynomials; of what is filtered already, is a derivative
    itself or has no noise, by differences.
    """
    record = judged(record, "auto", of)
    record.signals[of]  # without it there is a helpful error, and no noise to look up
    kernel = record.noise.kernels[of].get(of)
    if measured and kernel is not None and kernel.shape[-1] == 1:
        try:
            record, width = with_local_derivative(record, of, name)
            words = f"{name}: slope of {of} by local polynomials, {width:.3g} s to each side"
            return record, words
        except DataError:
            pass  # too short for them
    step = _derivative(name, of)
    return step.apply(record), step.words


def _derivative(name: str, of: str) -> Step:
    return Step(
        f"{name}: central differences of {of}", lambda record: differentiate(record, of, name)
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
    return _split(record, record.sample_count - round(share * record.sample_count))


def split_at(record: Record, seconds: float) -> tuple[Record, Record]:
    """Split a record before the first sample at or after this time, on the record's clock (`time`).

    **Returns:** the part to estimate from, and the part to validate on.

    **Raises:** `DataError` for a time that leaves a part without two samples or without any sample
    of a signal.
    """
    # A time in decimals stands for the sample nearest to it within rounding.
    rounding = 1e-6 * float(record.time_step)
    return _split(record, int(np.searchsorted(np.asarray(record.time), seconds - rounding)))


def _split(record: Record, at: int) -> tuple[Record, Record]:
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

"""Signals brought forward in time, by what is asked or by what recorded derivatives tell."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from riecjax.errors import DataError
from riecjax.findings import Finding
from riecjax.records.consistency import compared
from riecjax.records.faults.derivative_pairs import (
    LATE,
    PPM,
    Pairs,
    Relation,
    relations,
    with_sum,
)
from riecjax.records.faults.rows import cut_rows
from riecjax.records.linear_op import (
    SAME_TIME,
    LinearOp,
    Operations,
    convolved_with,
    longest_stretch,
    step,
)
from riecjax.records.preparation.resampling import band_limited, reach_beyond, response
from riecjax.records.record import Record

POINTS = np.arange(-3, 5)
"""Samples around a place that a polynomial of degree 7 goes through."""
MOST_LOST = 20
"""Times the samples lost at both ends that a stretch must hold to be interpolated band-limited."""

MOST_PPM = 1e5
"""Millionths past which it is no clock that is off."""


class Aligned(NamedTuple):
    """A record, what was shifted in words, and what was found amiss and put right."""

    record: Record
    words: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()


@step
def shift(record: Record, seconds: Mapping[str, float]) -> Operations:
    """Advance signals by so many seconds: those that are late by as much are in time then.

    By whole samples as they are; between samples band-limited, which loses 44 at both ends, and
    in a stretch of fewer than 1760 by polynomials of degree 7, which lose 4. What is lost beside
    gaps joins them.

    **Arguments:** `seconds` by signal; negative ones delay it.

    **Raises:** `DataError` for a signal that the record lacks, a time that is no number, or a
    record or stretches too short for it.
    """
    reach = reach_beyond(1.0)
    for name, late in seconds.items():
        record.signal(name)  # an error that helps, if there is none
        by = late / float(record.time_step)
        if not abs(by) < record.sample_count / 2:
            raise DataError(
                f"cannot shift '{name}' by {late:g} s, which is {by:.4g} samples of "
                f"{record.sample_count}. Give seconds, less than half the record."
            )
        whole = int(np.floor(by + SAME_TIME))
        between, at, taps = by - whole, np.zeros(1, int), np.ones(1)
        if between >= 2 * SAME_TIME and longest_stretch(record, name) >= 2 * MOST_LOST * reach:
            at = np.arange(1 - reach, reach + 1)
            taps = response(at - between, 1.0)
        elif between >= 2 * SAME_TIME:
            at = POINTS
            taps = np.array([np.prod((between - at[at != k]) / (k - at[at != k])) for k in at])
        taps = taps / taps.sum()
        # A shift between samples leaves white noise nearly white, but a little less of it.
        noise = convolved_with(float(np.linalg.norm(taps)))
        words = f"advanced: {{}} by {late:g} s"
        yield name, LinearOp.of_taps(words, taps, whole + int(at[0]), noise=noise)


@step
def set_clocks(record: Record, ppm: Mapping[str, float]) -> Operations:
    """Bring signals to the record's time of which a clock runs slow or fast.

    What falls behind evenly, by so many millionths of the time since the recording's first sample,
    is in time then. Band-limited, which loses 44 samples at both ends; what is lost beside gaps
    joins them.

    **Arguments:** `ppm` by signal; negative ones of a signal that gets ahead.

    **Raises:** `DataError` for a signal that the record lacks, a clock that is off by more than
    10 %, or stretches too short for it.
    """
    reach = reach_beyond(1.0)
    # The interpolator's gain of white noise, over all places between two samples.
    phases = response(np.arange(1 - reach, reach + 1) - np.linspace(0, 1, 21)[:, None], 1.0)
    white = np.sqrt(np.mean(np.sum(phases**2, axis=1)))
    for name, rate in ppm.items():
        if not abs(rate) < MOST_PPM:
            raise DataError(
                f"the clock of '{name}' is off by {rate:g} ppm, which is no clock. Give millionths "
                f"of the time, less than {MOST_PPM:g}."
            )
        late = PPM * rate * np.asarray(record.elapsed) / float(record.time_step)
        lost = reach + int(np.ceil(np.max(np.abs(late[[0, -1]]))))
        yield (
            name,
            LinearOp.of_stretches(
                f"clocks: {{}} by {rate:g} ppm",
                lambda x, places, first, late=late: band_limited(
                    x, places - first + late[places], 1.0
                ),
                lost=(lost, lost),
                noise=convolved_with(float(white)),
                shortest=2 * reach + 1,
            ),
        )


def align(record: Record, pairs: Pairs, how: str | Sequence[str] = "auto") -> Aligned:
    """Bring the later one of each signal and its recorded derivative forward.

    Of two signals one sees which is later, not which is wrong; but sensors, filters and loggers
    delay, and nothing comes before its time. So the earliest of signals that are derivatives of
    each other is taken to be in time, and the others are advanced to it. Only a delay whose
    interval of 4 standard errors excludes zero counts, and of at least 0.02 samples.

    **Arguments:** `pairs` of a signal and its derivative, or relations; `how`: `"auto"`;
    `"none"`; or the signals to shift, by whatever delay is found.

    **Raises:** `DataError` for a signal that belongs to no pair in the record.
    """
    names = () if isinstance(how, str) else tuple(how)
    if isinstance(how, str) and how not in ("auto", "none"):
        raise DataError(f"align is 'auto', 'none' or a tuple of signals; got '{how}'.")
    every = [one for one in relations(pairs) if {*one.names} <= {*record.arrays}]
    for name in names:
        if not any(name in one.names for one in every):
            raise DataError(
                f"'{name}' cannot be aligned: the model knows no recorded derivative of it, nor "
                f"what it is the derivative of. Shift it by a known time (--shift {name}=SECONDS)."
            )
    if how == "none":
        return Aligned(record)
    found = []
    for relation in every:
        # Signals that belong to each other, and of which no lost rows look like a delay.
        _, pair = compared(record, relation)
        if pair is not None and not pair.is_gross:
            lost = pair.is_late and cut_rows(*with_sum(record, relation))
            found += [] if lost else [pair]
    late: dict[str, float] = {}
    # By which each of these signals is later than the first one it is paired with.
    for name, pair in itertools.product(names, found):
        if name in pair.relation.names:
            mine, _ = pair.relation.side(pair.suspect)
            seconds = pair.fit.delay * pair.step
            late.setdefault(name, seconds if name in mine else -seconds)
    if not names:
        # By which signals are later than the earliest of those that they belong to.
        groups: list[dict[str, float]] = []
        for pair in found:
            group = next((g for g in groups if {*pair.late} & {*g}), None)
            if group is None:
                groups.append(group := {})
            # By a signal that both know.
            ahead = next((group[name] - s for name, s in pair.late.items() if name in group), 0.0)
            for name, seconds in pair.late.items():
                group.setdefault(name, ahead + seconds)
        after = ((name, s - min(g.values())) for g in groups for name, s in g.items())
        late = {name: seconds for name, seconds in after if seconds > LATE * found[0].step}
    if not late:
        return Aligned(record)
    told = []
    for name, seconds in late.items():
        holding = [pair for pair in found if name in pair.relation.names]
        pair = next((pair for pair in holding if pair.delay), holding[0])
        mine, others = pair.relation.side(pair.suspect)
        other = " and ".join(others if name in mine else mine)
        message = (
            f"{name} came {seconds / pair.step:.3g} \u00b1 {pair.fit.errors[0]:.1g} samples "
            f"({1e3 * seconds:.3g} ms) late against {other}, and was brought forward by that; "
            f"--align none leaves it. Whether both are late against other signals the two cannot "
            f"tell."
        )
        told.append(Finding("late_signal", message, (name,)))
    words = tuple(f"{name}: advanced by {seconds:.4g} s" for name, seconds in late.items())
    return Aligned(shift(record, late), words, tuple(told))


def declared_pairs(model: Any) -> list[tuple[str, str] | Relation]:
    """Signals and their derivatives, as a `Model` or its equations call them."""
    pairs: list[Any] = [(of, name) for name, of in getattr(model, "derived", {}).items()]
    pairs += model.derivatives if hasattr(model, "stages") else ()
    return list(dict.fromkeys(pairs))

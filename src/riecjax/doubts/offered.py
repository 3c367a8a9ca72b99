"""What is doubted of the sensors that a model's equations read.

Plausible sizes, beyond which a doubt is no cause, are shares of what a signal does: a zero or drift
of `REACH` times its range, a delay of `LONGEST` samples and of a part of the record.
"""

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from riecjax.doubts.columns import Doubt, Samples
from riecjax.equations.hidden_elements import accelerated
from riecjax.equations.model import Model
from riecjax.records.record import Record

LONGEST = 32
"""Samples of the longest delay that is looked for."""
LONGEST_SHARE = 20
"""It is at most this part of a record."""
REACH = 3.0
"""Ranges of a signal, its mean included, that its zero is off by at the most."""
GAIN = 0.5
"""The most that a gain is off by: other units and signs are seen before."""
JUMPS = 7
"""Places along a record at which rows may have been lost."""


def clocks_of(model: Model, read: set[str]) -> list[tuple[str, ...]]:
    """Signals that are shifted together: inputs one by one, a motion with its derivatives.

    All at once cannot be late against an equation, so that the first body's motion is left out, or
    the first signal.
    """
    groups: list[set[str]] = [{name} for name in sorted(read)]
    for equation in model.equations:
        for pair in equation.derivatives:
            one = set().union(*(g for g in groups if g & {*pair}))
            groups = [g for g in groups if not g & {*pair}] + ([one] if one else [])
    bodies = [name for e in model.equations for name in accelerated(e)]
    groups.sort(key=lambda g: (not g & {*bodies[:1]}, sorted(g)))
    return [tuple(sorted(g)) for g in groups[1:]]


def longest_delay(records: Sequence[Record]) -> int:
    """Samples of the longest delay that is looked for in records."""
    return min(LONGEST, min(each.sample_count for each in records) // LONGEST_SHARE)


def delay_of(signals: tuple[str, ...], step: float) -> Doubt:
    """That signals come late, in seconds."""

    def course(samples: Samples, time: Samples) -> Samples:
        return -np.gradient(samples, step)

    return Doubt(f"delay of {' and '.join(signals)}", "delay", signals, course)


def courses_of(signals: tuple[str, ...], record: Record) -> Iterator[Doubt]:
    """That their delay changes along a record, steadily or by a jump: by one second over it."""
    step, name = float(record.time_step), " and ".join(signals)

    def changing(by: Callable[[Samples], Samples], samples: Samples, time: Samples) -> Samples:
        return -np.gradient(samples, step) * by(time / np.ptp(time))

    clock = functools.partial(changing, lambda share: share)
    yield Doubt(f"clock of {name}", "clock", signals, clock)
    for place in np.linspace(-0.5, 0.5, JUMPS + 2)[1:-1]:
        jump = functools.partial(changing, lambda share, place=place: (share > place) * 1.0)
        yield Doubt(f"rows of {name} at {place:.3f}", "rows", signals, jump)


def sensors(model: Model, records: Sequence[Record], read: set[str]) -> list[Doubt]:
    """What may be amiss with the sensors of the signals that are read, inputs first."""
    step, found = float(records[0].time_step), []
    for signals in clocks_of(model, read):
        found.append(delay_of(signals, step))
        found += courses_of(signals, records[0]) if len(records) == 1 else []
    known = {t.signal for e in model.equations for t in e.terms if not t.parameters}
    for name in sorted(read, key=lambda name: (name not in known, name)):
        found.append(
            Doubt(f"zero of {name}", "zero", (name,), lambda samples, time: np.ones_like(samples))
        )
        # That of a whole target scales the parameters.
        if not _is_target(model, name):
            found.append(Doubt(f"gain of {name}", "gain", (name,), lambda samples, time: samples))
        if len(records) == 1:
            found.append(
                Doubt(
                    f"drift of {name}", "drift", (name,), lambda samples, time: time / np.ptp(time)
                )
            )
    return found


def _is_target(model: Model, name: str) -> bool:
    """Whether a signal alone is what the equations that know terms of it have to explain."""
    known = [[t.signal for t in e.terms if not t.parameters] for e in model.equations]
    return any({*signals} == {name} for signals in known)


def plausible(doubts: Sequence[Doubt], records: Sequence[Record]) -> Mapping[str, float]:
    """The largest size of each doubt of a sensor."""
    step, sizes = float(records[0].time_step), {}
    for doubt in doubts:
        samples = [np.asarray(r.arrays[s], float) for r in records for s in doubt.signals]
        if doubt.kind in ("zero", "drift"):
            sizes[doubt.name] = REACH * max(np.ptp(one) + abs(np.mean(one)) for one in samples)
        elif doubt.kind == "gain":
            sizes[doubt.name] = GAIN
        elif doubt.kind != "term":
            sizes[doubt.name] = longest_delay(records) * step
    return sizes

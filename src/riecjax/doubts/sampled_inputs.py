"""What the sampling of an input leaves in doubt: its course from one sample to the next.

An input that changes between samples, as the pulse of a hammer, has an impulse that no rule of
integration knows: every linear one gives a pulse the same. Nothing in the recording tests it, so
that it is an assumption, and goes into the doubt by its size. Integrals over every third sample
alone, the first, second or third of each three, are those of a third of the rate. Where they agree,
samples of the whole rate hold all there is of the input; where they differ, the error of the whole
rate is a part of that difference. With an input s these are the columns of the faults

    d = 2 cos(2 pi t / 3) s,  d = 2 sin(2 pi t / 3) s

of size one, which leave every third sample; the root of the sum of both squares is the same
wherever pulses begin between samples.

What an input that moves all the time does between samples is random, and part of scatter. Pulses,
between which it rests, may all begin at one place between samples, as of a trigger, and no scatter
shows what that does.

Harmonics of an input that lie above half the rate fold back. Those of a jump fall off as 1 / f, of
a kink as 1 / f^2: the whole rate leaves a third and a ninth of the error of a third of it.
"""

import functools
from collections.abc import Callable, Sequence

import numpy as np

from riecjax.doubts.columns import Asked, Doubt, Samples, folds_of
from riecjax.equations.model import Model
from riecjax.estimation.estimate import Estimate
from riecjax.findings import FINEST, Finding, in_percent, joined
from riecjax.records.record import Record

LEFT = 1 / 6
"""Share of the error of a third of the rate that the whole rate is taken to leave: between that of
jumps and that of kinks."""
RESTS = 0.1
"""Usual deviation of an input from its median, over its root mean square, of one that rests most of
the time: of a steady one it is a half or more."""


def _third(shape: Callable[[Samples], Samples], samples: Samples, *_: Samples) -> Samples:
    """A signal's part by which samples of a third of the rate differ."""
    return 2 * samples * shape(2 * np.pi / 3 * np.arange(samples.size))


def _is_of_pulses(name: str, records: Sequence[Record]) -> bool:
    """Whether an input rests most of the time in each record."""
    every = [np.asarray(record.arrays[name], float) for record in records]
    away = [values - np.median(values) for values in every]
    return all(np.median(np.abs(one)) < RESTS * np.sqrt(np.mean(one**2)) for one in away)


def between_samples(model: Model, records: Sequence[Record], estimate: Estimate) -> list[Finding]:
    """`sampled_input`, where the course of inputs between samples may move parameters (not under
    jit)."""
    asked, moved = Asked.of(model, estimate), dict[str, float]()
    known = {t.signal for e in model.equations for t in e.terms if not t.parameters}
    doubts = [
        Doubt(f"{part.__name__} of {name}", "sampling", (name,), functools.partial(_third, part))
        for name in sorted(name for name in known if name and _is_of_pulses(name, records))
        for part in (np.cos, np.sin)
    ]
    if not doubts:
        return []
    folds = folds_of(asked, records, doubts, "")
    base = [name for name in folds.parameters if name not in {doubt.name for doubt in doubts}]
    total, at = folds.motion.sum(0), folds.columns(base)
    signals = []
    for doubt, quadrature in zip(doubts[::2], doubts[1::2]):
        if doubt.name not in folds.parameters:
            continue
        both = folds.columns([doubt.name, quadrature.name])
        # Of each fold by itself: pulses lie otherwise in threes of samples, and alike in one.
        inverse = np.linalg.pinv(total[np.ix_(at, at)], hermitian=True)
        along = inverse @ folds.motion[:, at[:, None], both]
        shares = {}
        for name, move in zip(base, np.hypot(along[..., 0], along[..., 1]).sum(0).tolist()):
            name = name.partition(".")[2]
            if name in estimate.parameters and LEFT * abs(move) > estimate.standard_error(name):
                shares.setdefault(name, LEFT * abs(move / asked.values[name]))
        if max(shares.values(), default=0.0) > FINEST:
            signals += doubt.signals
            moved |= {name: max(share, moved.get(name, 0.0)) for name, share in shares.items()}
    if not signals:
        return []
    worst = max(moved, key=lambda name: moved[name])
    message = (
        f"{joined(signals)} changes so fast that integrals over every third sample differ: its "
        f"course from one sample to the next, which nothing recorded tells, may move {worst} by "
        f"{in_percent(moved[worst])}. Sample faster, or behind a filter that keeps the impulse."
    )
    return [Finding("sampled_input", message, tuple(signals), tuple(moved), doubts=moved)]

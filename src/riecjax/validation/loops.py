"""Loops of what a model leaves: a force that depends on the way that the motion came.

A function of velocity or of position that the model has wrong leaves something too. So what any
such function explains is taken out first: straight lines between knots of each, the direction of
motion, and the acceleration, which also stands for what is a little late. Where hysteresis is
missing, a state that goes with the displacement explains most of the rest; where a signal that the
model does not read changes a force, that signal times the velocity or its direction does. Each is
judged on parts of the recordings that it was not fitted to.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy.signal
from jaxtyping import Float

from riecjax.equations.memories import BoucWen, Dahl, pieces_of_way, usual_widths
from riecjax.equations.motions import Motion
from riecjax.findings import Finding
from riecjax.records.record import Record, samples_with_nan
from riecjax.validation.equation_errors import EquationError, joined, with_pads
from riecjax.validation.time_series import moving_average

KNOTS = 9
"""Of the straight lines that stand for any function of one signal."""
PARTS = 40
"""Parts of the recordings, every other of which is explained by the rest."""
NOTABLE_GAIN = 0.5
"""Share of what no function explains, from which on it is a loop."""
MOST_VALUES = 2**16
"""Values that are enough."""

Series = list[Float[np.ndarray, " n"]]
"""A signal of each record."""


class Loop(NamedTuple):
    """What explains most of what no function of velocity or position does.

    **Fields:** `law`, of hysteresis, or empty where the signal `by` changes a force; `motion`;
    `width` within which it turns round; `gain`, share of the rest that it explains; `size`, root
    mean square of that relative to the target; `dry`, whether it is dry friction that is changed.
    """

    law: str
    motion: Motion
    width: float
    by: str
    gain: float
    size: float
    dry: bool = False

    def describe(self) -> dict[str, object]:
        """Plain data for JSON."""
        return {**self._asdict(), "motion": self.motion._asdict()}

    def finding(self, time_step: float) -> Finding:
        """`hysteresis`, or `residual_follows_signal` of one that the model does not read."""
        v, x = self.motion.velocity, self.motion.position
        of_both = f"{v} and {x}" if x else v
        size = f"{100 * self.size:.2g} % of the target"
        share = f"{100 * self.gain:.0f} % of what no function of {of_both} explains"
        if self.by:
            changed = f"the direction of {v}" if self.dry else v
            return Finding(
                "residual_follows_signal",
                f"what the model leaves follows {self.by} times {changed}, which explains {share}, "
                f"{size}: {self.by} changes a {'friction' if self.dry else 'damping'} force and "
                f"the model does not use it. Add a term in it (riecjax discover).",
                (self.by,),
            )
        windows = f"--alpha {2 * time_step:.3g} --beta {10 * time_step:.3g}"
        width = f"{self.width:.2g} {self.motion.unit}".rstrip()
        return Finding(
            "hysteresis",
            f"what the model leaves runs in loops over {v}: a state that turns round within about "
            f"{width} of displacement ({self.law}) explains {share}, {size}. Hysteresis is "
            f"missing: find its law by windows that are no longer than it takes to turn (riecjax "
            f"discover {windows}).",
            step=f"Find the law of the hysteresis: riecjax discover, with {windows}",
        )


def loop_of(
    errors: list[EquationError],
    records: list[Record],
    motions: Sequence[Motion],
    unread: Sequence[str],
    count: int,
) -> Loop | None:
    """The largest loop of an equation's error, if any is notable.

    **Arguments:** `errors` of the equation, one for each of `records`; `motions` that it reads, and
    signals that the model leaves `unread`; error and regressors are averaged over `count` samples.
    """
    error = joined(errors, count)
    present = np.asarray(error.present)

    def averaged(values: np.ndarray) -> np.ndarray:
        found, whole = moving_average(values, present, count)
        return found[whole]

    ends = [averaged(np.asarray(one)) for one in (error.error, error.target)]
    loops = []
    for motion in (one for one in motions if one.velocity):
        kinds, columns = [], list(ends)
        for kind, signals in _regressors(motion, unread, records):
            values = [np.asarray(of.centred(np.asarray(one))) for of, one in zip(errors, signals)]
            columns.append(averaged(with_pads(values, count)))
            kinds.append(kind)
        loops.append(largest(columns, kinds))
    return max(filter(None, loops), key=lambda one: one.size, default=None)


def _regressors(
    motion: Motion, unread: Sequence[str], records: Sequence[Record]
) -> Iterator[tuple[Loop | None, Series]]:
    """What is taken out first, and each that may explain the rest, as signals of each record."""
    v = _each(records, motion.velocity)
    # Without a recorded position a spring would pass for a state that goes with the displacement.
    if motion.position:
        x = _each(records, motion.position)
    else:
        ways = [np.cumsum(pieces_of_way(motion.velocity, record)) for record in records]
        x = [scipy.signal.detrend(np.concatenate([[0.0], way])) for way in ways]
    for signals in (v, x):
        every = np.concatenate(signals)
        knots = np.linspace(every.min(), every.max(), KNOTS)
        for i in range(KNOTS):
            yield None, [np.interp(one, knots, np.eye(KNOTS)[i]) for one in signals]
    yield None, [np.sign(one) for one in v]
    yield None, [np.gradient(one) for one in v]
    for law in (Dahl, BoucWen):
        for width in usual_widths(motion.velocity, records):
            memory = law("state", motion.velocity, float(width))
            found = Loop(law.__name__, motion, float(width), "", 0.0, 0.0)
            yield found, [memory.course(record) for record in records]
    for name in unread:
        s = _each(records, name)
        for dry in (False, True):
            found = Loop("", motion, 0.0, name, 0.0, 0.0, dry)
            yield found, [one * (np.sign(w) if dry else w) for one, w in zip(s, v)]


def largest(columns: list[Float[np.ndarray, " n"]], kinds: Sequence[Loop | None]) -> Loop | None:
    """The one that explains most of what those without a kind leave of the first, if it is most.

    **Arguments:** `columns`: the error, the target, and the regressors; `kinds` of the latter.
    """
    every = max(len(columns[0]) // MOST_VALUES, 1)
    thinned = np.stack([column[::every] for column in columns], axis=1)
    part = np.arange(len(thinned)) * PARTS // max(len(thinned), 1) % 2
    error, energy = np.delete(thinned, 1, axis=1), float(np.sum(thinned[:, 1] ** 2))
    grams = [error[part == i].T @ error[part == i] for i in (0, 1)]
    base = [1 + i for i, kind in enumerate(kinds) if kind is None]
    before = _left(grams, base)
    best: Loop | None = None
    for i, kind in enumerate(kinds):
        if kind is None or not before > 0 or not energy > 0:
            continue
        gained = before - _left(grams, [*base, 1 + i])
        found = kind._replace(gain=gained / before, size=float(np.sqrt(max(gained, 0) / energy)))
        if found.gain > max(NOTABLE_GAIN, 0.0 if best is None else best.gain):
            best = found
    return best


def _left(grams: Sequence[np.ndarray], columns: Sequence[int]) -> float:
    """Energy that columns leave of the first, each half by coefficients from the other."""
    at, total = np.array([0, *columns]), 0.0
    for fitted, held in (grams, grams[::-1]):
        gram, moment = fitted[np.ix_(at[1:], at[1:])], fitted[at[1:], 0]
        size = np.sqrt(np.diagonal(gram))
        scale = 1 / np.where(size > 0, size, 1.0)
        theta = np.linalg.pinv(gram * np.outer(scale, scale), 1e-9, hermitian=True)
        v = np.concatenate([[1.0], -scale * (theta @ (scale * moment))])
        total += float(v @ held[np.ix_(at, at)] @ v)
    return total


def _each(records: Sequence[Record], name: str) -> Series:
    return [np.nan_to_num(samples_with_nan(record, name)) for record in records]

"""How the delay between two signals changes along a record: steadily, by a step, or not."""

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.findings import option_for
from riecjax.records.faults.pair_fit import Left, PairFit, Piece, fit_pair

FEWEST_PARTS = 5
"""Parts of a record that must tell a delay for its course to be looked at."""
UNEVEN = 25.0
"""Chi-square that a course must explain of the delays' scatter, in terms of what it leaves."""
CHANGE = 0.1
"""Samples by which a delay must change along the record."""
FINEST = 0.01
"""Samples to which the delay of a part is known at best."""
LOST = 0.5
"""Samples of a sudden change past which rows were lost."""
SURE = 4.0
"""Standard errors past which a difference is no chance."""


class Course(NamedTuple):
    """How a delay changes along the record.

    **Fields:** `kind`: "steady", "clocks" for one that grows evenly, "rows" for a sudden change;
    `change` over the record in samples and its standard error; `place` of a sudden change, first
    and last sample; `first`, the delay at the start.
    """

    kind: str = "steady"
    change: float = 0.0
    error: float = 0.0
    place: tuple[int, int] = (0, 0)
    first: float = 0.0

    def in_time(self, start: float, stop: float) -> tuple[str, str]:
        """Options for the part with the least delay, of those before and after a sudden change.

        What lost rows is early from there on; what agrees with it there is no better for it.
        """
        before = abs(self.first) <= abs(self.first + self.change)
        return ("--to", f"{start:.7g}") if before else ("--from", f"{stop:.7g}")

    def by_one_clock(
        self, late: Sequence[str], ppm: float, step: float, start: float
    ) -> tuple[str, ...]:
        """Options that bring what falls behind by so many millionths to the time of the others.

        Clocks are set from the recording's first sample on, `start` seconds before what was
        looked at.
        """
        first = self.first * step - 1e-6 * ppm * start
        shifted = late if abs(first) > CHANGE * step else ()
        return (
            *option_for("--shift", shifted, f"{first:.4g}"),
            *option_for("--clock", late, f"{ppm:.5g}"),
        )

    @property
    def way(self) -> str:
        """What the signal does whose delay changes evenly."""
        return "falls behind" if self.change > 0 else "gets ahead of"


def delay_course(
    parts: Sequence[Sequence[Piece]],
    edges: Sequence[int],
    count: int,
    whole: PairFit,
    alone: Sequence[PairFit | None] | None = None,
) -> tuple[Course, float]:
    """How the delay changes from part to part, and how much more it scatters than its errors say.

    **Arguments:** `parts` of the record between these `edges`; `whole`, the fit to all of it;
    `alone`, those to the parts, where they are known to differ.
    """
    fits = [fit_pair(part, count, start=whole, known=whole.left, steps=1) for part in parts]
    delays = _delays(fits, edges)
    steady, spread = _steady(delays)
    if delays.shape[1] < FEWEST_PARTS or (alone is None and steady < UNEVEN):
        return Course(), spread
    # Too far apart for one step from the same start.
    alone = [fit_pair(part, count) for part in parts] if alone is None else alone
    again = _pooled([fit for fit in alone if fit is not None])
    fits = [
        None if fit is None else fit_pair(part, count, start=fit, known=again(fit), steps=2)
        for fit, part in zip(alone, parts)
    ]
    delays = _delays(fits, edges)
    if delays.shape[1] < FEWEST_PARTS:
        return Course(), spread
    steady, spread = _steady(delays)
    found, left = changing(delays, edges)
    more = float(np.sqrt(max(1.0, left / (delays.shape[1] - 3))))
    error = found.error * more
    if steady - left > UNEVEN * more**2 and abs(found.change) > max(
        LOST if found.kind == "rows" else CHANGE, SURE * error
    ):
        return found._replace(error=error), more
    return Course(), spread


def _steady(delays: Float[np.ndarray, "4 parts"]) -> tuple[float, float]:
    """Chi-square of delays about their mean; and times that they scatter more than they should."""
    size = delays.shape[1]
    if size < 2:
        return 0.0, 1.0
    left = _left(delays, np.ones((1, size)))[0]
    return left, float(np.sqrt(max(1.0, left / (size - 1))))


def _delays(fits: Sequence[PairFit | None], edges: Sequence[int]) -> Float[np.ndarray, "4 parts"]:
    """Delay and its error of each part that tells it, and the part's first and last sample."""
    told = [
        (fit.delay, np.hypot(fit.errors[0], FINEST), *ends)
        for fit, ends in zip(fits, itertools.pairwise(edges))
        if fit is not None and 0 < fit.errors[0] < np.inf
    ]
    return np.array(told, float).reshape(-1, 4).T


def _pooled(fits: Sequence[PairFit]) -> Callable[[PairFit], Left]:
    """What is left of all parts, for each of them: of one alone it is known too roughly."""
    omega = np.concatenate([fit.left.omega for fit in fits])
    order = np.argsort(omega, kind="stable")
    power = np.concatenate([fit.left.power for fit in fits])[order]
    groups = max(omega.size // 64, 1)
    means = [
        np.array([some.mean() for some in np.array_split(column, groups)])
        for column in (omega[order], power)
    ]
    return lambda fit: Left(fit.left.levels, *means)


def changing(delays: Float[np.ndarray, "4 parts"], edges: Sequence[int]) -> tuple[Course, float]:
    """The course that explains the delays best, and the chi-square that it leaves."""
    first, last = delays[2:]
    ones, size = np.ones(first.size), first.size
    time = 0.5 * (first + last) / edges[-1]
    left, coefficients, errors = _left(delays, np.array([ones, time]))
    best = Course("clocks", coefficients[1], errors[1], (0, edges[-1]), coefficients[0]), left
    for k in range(2, size - 1):
        # The change lies between two parts, or within one, which then says nothing.
        for within in (0, 1):
            after = np.arange(size) >= k + within
            if after.sum() < 2:
                continue
            alone = np.eye(size)[[k]] if within else np.zeros((0, size))
            left, coefficients, errors = _left(delays, np.array([ones, after, *alone]))
            if left + 4 < best[1]:
                place = int(first[k - 1 + within]), int(last[k])
                best = Course("rows", coefficients[1], errors[1], place, coefficients[0]), left
    return best


def _left(
    delays: np.ndarray, rows: np.ndarray
) -> tuple[float, Float[np.ndarray, " rows"], Float[np.ndarray, " rows"]]:
    """Chi-square that a weighted least-squares fit leaves; its coefficients and their errors."""
    values, errors = delays[:2]
    inverse = np.linalg.pinv((rows / errors).T)
    coefficients = inverse @ (values / errors)
    left = (values - coefficients @ rows) / errors
    return float(left @ left), coefficients, np.sqrt(np.sum(inverse**2, axis=1))

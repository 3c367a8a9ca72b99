"""An amplifier at the end of its range, with the noise of a converter on top."""

import functools
import shlex
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from riecjax.findings import Finding
from riecjax.records.faults.clipping import Visits, is_real
from riecjax.records.faults.sampled_signal import (
    SampledSignal,
    percent,
)
from riecjax.records.noise import noise_level

QUIETEST, LOUDEST = 1e-5, 0.2
"""Noise over a signal's deviation between which a limit under noise is looked for."""
AVERAGED = 5
"""Samples to an average in which a limit stands out of the noise."""
BAND = 3.0
"""Standard errors of such an average to either side of a limit."""
FEWEST, MOST, CORNER = 6, 100, 2
"""Samples to a visit at least; visits that are looked at; samples of a corner that are left out."""
SIDES = (80, 20, 8, 5)
"""Samples to each side of a visit in which slopes are looked at, at most: tried in turn."""
TOLD = 60.0
"""Times the noise's variance, of squares, by which slopes that end at a limit fit all visits better
than polynomials with as many coefficients."""
FITS = 1.5
"""Mean square over the noise's variance that they leave at most."""
ABRUPT = 4.0
"""Times the deceleration of a signal by which it stops at a limit. What comes to rest there keeps
it: s^2 = 2 a d with a slope s at the distance d."""
JUMP = 2 * CORNER
"""Samples within which slopes that go on reach a limit."""
ALIKE = 0.1
"""Scatter of slopes, over their mean, up to which they may be a command's."""
SURE = 3.0
"""Standard errors."""


def saturated(signal: SampledSignal, others: Sequence[SampledSignal] = ()) -> Iterator[Finding]:
    """Where a signal's slope ends at a level, about which it then only scatters by its noise.

    A crest of the motion is smooth, and what comes to rest decelerates on its way. What runs up to
    its limit and away from it evenly, each time alike, is a command that is followed.
    """
    for side in (one for one in limits_under_noise(signal) if not is_real(signal, one, others)):
        share, remedy = side.samples / signal.sample_count, ("--leave-out", signal.name)
        yield signal.finding(
            "clipped",
            f"stays within its noise at its {side.which} of {signal.with_unit(side.extreme)} in "
            f"{side.starts.size} place(s), {percent(share, 1)} of the samples, first at "
            f"{signal.time[side.starts[0]]:.4g} s, where its slope ends abruptly, as an amplifier "
            f"at the end of its range does. Record with a larger range, or leave them out (on the "
            f"command line: {shlex.join(remedy)}), unless the limit is real.",
            doubt=share,
            remedy=remedy,
            step=f"Leave out what {signal.name} shows at the end of its range",
        )


def limits_under_noise(signal: SampledSignal) -> list[Visits]:
    """Levels at which a signal's slope ends, real limits too."""
    missing = np.isnan(signal.values)
    if signal.is_command or missing.all():
        return []
    rms, noise = float(np.nanstd(signal.values)), float(noise_level(signal.values, ~missing))
    if not QUIETEST * rms < noise < LOUDEST * rms:
        return []
    found = []
    for which, sign in (("maximum", 1.0), ("minimum", -1.0)):
        limit = _limit(sign * signal.values / noise)
        if limit is not None:
            level, visits = limit
            samples, starts = int(np.sum(visits[:, 1] - visits[:, 0])), visits[:, 0]
            extreme = sign * level * noise
            found.append(Visits(which, extreme, starts, samples, len(visits), BAND * noise))
    # Of some fifteen crests one may look like it.
    return found if sum(side.starts.size for side in found) > 1 else []


def _limit(values: np.ndarray) -> tuple[float, np.ndarray] | None:
    """The upper limit of values in units of their noise, if there is one, and visits to it."""
    error = AVERAGED**-0.5
    averages = uniform_filter1d(values, AVERAGED)
    known = averages[~np.isnan(averages)]
    if known.size < 10 * FEWEST:
        return None
    # Most averages to one level, of those near the highest but a few.
    highest = np.partition(known, -FEWEST)[-FEWEST]
    top = np.sort(known[known > highest - 2 * BAND])
    ends = np.searchsorted(top, top + 2 * error)
    first = int(np.argmax(ends - np.arange(top.size)))
    limit = float(np.mean(top[first : ends[first]]))
    inside = np.concatenate([[False], averages > limit - BAND * error, [False]])
    edges = np.flatnonzero(np.diff(inside.astype(np.int8))).reshape(-1, 2)
    visits = edges[np.diff(edges)[:, 0] >= FEWEST - AVERAGED + 1]
    visits = np.array([_widened(values > limit - BAND, *visit) for visit in visits]).reshape(-1, 2)
    visits = visits[np.diff(visits)[:, 0] >= FEWEST]
    some = visits[:: max(len(visits) // MOST, 1)]
    told = any(_ends_there(values, some, side, BAND * error) for side in SIDES)
    return (limit, visits) if told else None


def _widened(near: np.ndarray, start: int, stop: int) -> tuple[int, int]:
    """A visit with the samples beside it that are near the limit, which averages hide."""
    for _ in range(AVERAGED // 2):
        start -= bool(start > 0 and near[start - 1])
        stop += bool(stop < near.size and near[stop])
    return start, stop


def _ends_there(values: np.ndarray, visits: np.ndarray, most: int, distance: float) -> bool:
    """Whether slopes to both sides of visits end where these begin, rather than pass over."""
    left, count, near, missed, smooth = 0.0, 0, [], [], []
    for start, stop in visits:
        side = int(min(stop - start, most))
        some = values[max(start - side - CORNER, 0) : stop + side + CORNER]
        if some.size < stop - start + 2 * (side + CORNER) or np.isnan(some).any():
            continue
        design = _design(some.size, side)
        parts = np.array([some[:side], some[: -side - 1 : -1]]).T
        ramps = design.inverse @ parts
        beside = (parts - design.powers @ ramps).ravel()
        flat = some[side + CORNER : -side - CORNER]
        height = flat.sum() / flat.size
        within = flat - height
        left += float(beside @ beside + within @ within)
        count += int(design.kept.size) - 7
        near += [(slope, -2 * bend, *design.errors) for _, slope, bend in ramps.T]
        missed += [height - ramps[0]]
        smooth += [(some, design)]
    if not near or left > FITS * count:
        return False
    # What jumps to a level does not run into it.
    edges, short = np.array(near), float(np.mean(missed))
    runs_up = bool(short < JUMP * np.mean(edges[:, 0]) + BAND)
    if not runs_up or not _is_abrupt(edges, distance):
        return False
    return sum(design.left_by_polynomials(some) for some, design in smooth) - left >= TOLD


class _Design(NamedTuple):
    """Of a visit with what lies beside it, on each side some samples for a slope.

    **Fields:** `powers` of their time, and the `inverse`; `errors` of slope and deceleration; the
    samples that are `kept`, no corner; an `orthonormal` basis of polynomials of degree 6 over them.
    """

    powers: np.ndarray
    inverse: np.ndarray
    errors: tuple[float, float]
    kept: np.ndarray
    orthonormal: np.ndarray

    def left_by_polynomials(self, some: np.ndarray) -> float:
        """Sum of squares that these leave of a visit's samples."""
        beside = some[self.kept]
        return float(np.sum((beside - self.orthonormal @ (self.orthonormal.T @ beside)) ** 2))


@functools.lru_cache(64)
def _design(size: int, side: int) -> _Design:
    powers = np.vander(np.arange(-side, 0) - CORNER + 0.5, 3, increasing=True)
    kept = np.ones(size, bool)
    kept[side : side + CORNER] = kept[-side - CORNER : -side] = False
    smooth = np.polynomial.legendre.legvander(np.linspace(-1, 1, size)[kept], 6)
    inverse = np.linalg.pinv(powers)
    errors = float(np.linalg.norm(inverse[1])), 2 * float(np.linalg.norm(inverse[2]))
    return _Design(powers, inverse, errors, np.flatnonzero(kept), np.linalg.qr(smooth)[0])


def _is_abrupt(edges: np.ndarray, distance: float) -> bool:
    """Whether slopes end faster than they decelerate before, and are not those of a command.

    **Arguments:** `edges`: of each its slope and deceleration by samples, and errors of both.
    """
    slope, deceleration, *errors = np.median(edges, axis=0)
    error, bend = (1.25 * each / len(edges) ** 0.5 for each in errors)
    surely = ABRUPT * (max(deceleration, 0.0) + SURE * bend)

    def stops(speed: float, slows: float) -> bool:
        """Whether this slope at the distance of a visit's edge ends faster."""
        return bool(speed**2 > 2 * min(distance + AVERAGED // 2 * speed, BAND) * slows)

    # What arrives by and by may yet leave by a jump.
    sides = (np.median(edges[which::2], axis=0) for which in (0, 1))
    steep = stops(slope, surely) and all(stops(*side[:2]) and side[0] > 0 for side in sides)
    if not slope > SURE * error or not steep:
        return False
    scatter = 1.48 * np.median(np.abs(edges[:, 0] - slope))
    return bool(scatter > max(ALIKE * slope, 2 * errors[0]) or abs(deceleration) > SURE * bend)

"""What is amiss between a signal and its recorded derivative, in time, size and zero.

A pair shows differences alone: whether v is late or x early, whether v has an offset or x drifts,
it cannot tell, nor what both have in common, as a delay of both against the force. How v follows x,
in delay, gain, lag, offset and drift, has errors, and the delay may change along the record,
steadily or by a step.

Let x = p + e_x and v = G p'(t - tau) + b + d t + e_v, with white noise e_x and e_v. For a taper w
that vanishes at both ends of a stretch, integration by parts gives at every frequency

    V = int w v exp(-i omega t) dt = G D(tau) + b W_0 + d W_1 + noise,
    D = exp(-i omega tau) int [i omega w(t + tau) - w'(t + tau)] exp(-i omega t) x dt,

where W_0 and W_1 are the transforms of w and w t. It holds for any motion, periodic or not, and no
sample is differentiated; sums are integrals as nearly as w p is smooth. So G, tau, b and d follow
from least squares over frequencies, each weighted by the inverse of what is left there, smoothed
over its neighbours: no level or colour of noise needs to be known. Noise in D biases G alone, by a
known amount, and is taken off.

A first-order low-pass of v is D / (1 + i omega T) in place of a delayed D: the same phase at low
frequencies, and a loss at high ones, by which the two are told apart. A low-pass of x shows as its
inverse, here a negative T.

Of a derivative that is a sum of signals, x' = v - u with known u, D has int w(t + tau) u exp(-i
omega t) dt besides: what v is held against is x' + u, none of which is differentiated either.

Time is in samples; v and u are in units of x per sample.

**In increments.** Wrong units, signs and channels show in increments of the signal beside integrals
of its derivative; what is less than that in the fit over frequencies.

**Computed, not measured.** A derivative may be no sensor's, but computed from the signal:
differences, slopes of polynomials, or any other filter of some dozens of samples. Such a derivative
has the position's noise, many times as large and of one source with it. Taken for a sensor's own,
white and independent, it biases every estimate.
"""

import dataclasses
import itertools
import shlex
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy
from jaxtyping import Bool, Complex, Float, Int

from riecjax.arrays import is_concrete
from riecjax.errors import DataError
from riecjax.findings import Finding, line_taken_off, option_for
from riecjax.records.faults.rows import cut_rows
from riecjax.records.faults.sampled_signal import ENOUGH, once
from riecjax.records.preparation.filtering import with_local_derivative
from riecjax.records.preparation.resampling import shift
from riecjax.records.reading.units import readings
from riecjax.records.record import Record, run_lengths, runs
from riecjax.records.signal import Noise, Samples, Taps, noise_level
from riecjax.records.time_base import PPM, SHORTEST_PAUSE

EDGE = 100
"""Samples, at most, over which a taper rises: smooth enough for sums to be integrals."""
MARGIN = 4
"""Samples at both ends outside the taper, for its shifts."""
SHORTEST_PIECE = 64
"""Samples of a stretch below which its taper leaves little of it."""
NEIGHBOURS, RATIO = 8, 1.25
"""Bins to each side, and ratio of frequencies, over which what is left is smoothed."""
CARRIED = 3.0
"""Times what is left that a frequency's power must be to count."""
LOWEST_BINS = 8
"""Lowest bins of each piece that count always: they tell offset and drift."""
MOST_NOISE = 0.2
"""Share of what tells the gain that may be noise."""
ITERATIONS, ROUGH_ITERATIONS = 14, 4
"""Steps of a fit at the most, and the first of them, which weigh all frequencies as `ROUGHLY`
noisy."""
ROUGHLY = 0.01
"""Share of a signal's deviation."""
NEAR = 0.7
"""Share of a correlation's peak: the cosine of the turn from which a fit finds it."""


class Piece(NamedTuple):
    """An unbroken stretch of x, v and u, and the place of its first sample in the record."""

    start: int
    x: Samples
    v: Samples
    u: Samples


class Left(NamedTuple):
    """What a fit leaves.

    **Fields:** `levels` of noise of x, v and u; `omega`, frequencies, and there the power of what
    is left over that of this noise, `smoothed` and as it is; `unlike`, the former's power for
    a taper of energy 1, less what a gain or filter does to the noise.
    """

    levels: Float[np.ndarray, "3"]
    omega: Float[np.ndarray, " bins"]
    smoothed: Float[np.ndarray, " bins"]
    power: Float[np.ndarray, " bins"] = np.zeros(0)
    unlike: Float[np.ndarray, " bins"] = np.zeros(0)


class PairFit(NamedTuple):
    """How v follows x.

    **Fields:** `delay` in samples, of a low-pass where it is `lagged`; `gain`; `offset` of v at
    the middle of the record, and `drift` of v over the record; `errors`, the standard errors of
    these four; `left` by frequency, and whether that `counted`.
    """

    delay: float
    gain: float
    offset: float
    drift: float
    errors: Float[np.ndarray, "4"]
    left: Left
    counted: Bool[np.ndarray, " bins"]
    lagged: bool = False


def fit_pair(
    pieces: Sequence[Piece],
    count: int,
    *,
    lagged: bool = False,
    start: PairFit | None = None,
    known: Left | None = None,
    steps: int = ITERATIONS,
) -> PairFit | None:
    """Least squares over frequencies; `None` where the pieces tell too little.

    **Arguments:** `count`, samples of the record; `lagged`: fit a low-pass instead of a delay;
    `start` from this fit, not afresh; `known`, what will be left, from elsewhere.
    """
    if not pieces:
        return None
    levels, rough = _levels(pieces) if known is None else (known.levels, known.levels)
    even = Left(rough, np.array([0.0, np.pi]), np.ones(2))
    whole, fit = 0, None
    theta = np.array([0.0, 1.0, 0.0, 0.0] if start is None else start[:4])
    first = start is None and known is None
    steady, at = None, 0
    if start is None and not lagged:
        # From the peak of the longest piece's correlation; 0 where the correlation there is near
        # the peak: what is so near needs no start nearer.
        longest = max(pieces, key=lambda p: p.x.size)
        size, steady = longest.x.size, _Steady.of([longest], count)
        there = steady.delayed(0.0, rough)
        correlation = np.fft.irfft(np.append(steady.rate * there.motion.conj() / there.noise, 0.0))
        lags = np.arange(-(size // 8), size // 8 + 1)
        penalised = correlation[lags] * (1 - np.abs(lags) / size)
        if penalised[size // 8] <= NEAR * np.max(penalised):
            whole = int(lags[np.argmax(penalised)])
        # Of a single piece as it is, transforms are there already.
        steady = steady if len(pieces) == 1 else None
    for iteration in range(steps):
        first = first and iteration < ROUGH_ITERATIONS
        if abs(theta[0]) > 1 and not lagged:
            whole, theta[0] = whole + round(theta[0]), theta[0] - round(theta[0])
        if steady is None or at != whole:
            moved = [p for p in (_shifted(p, whole) for p in pieces) if p.x.size >= SHORTEST_PIECE]
            if not moved:
                return None
            steady, at = _Steady.of(moved, count), whole
        expected, noise = (even, rough) if first else (known, levels)
        fit = _step(steady, theta, lagged, expected, noise)
        if fit is None:
            return None
        step, theta = fit[:4] - theta, np.array(fit[:4])
        if np.all(np.abs(step) < 1e-3 * fit.errors):
            if not first:
                break
            first = False
    return fit and fit._replace(delay=whole + fit.delay)


def _levels(pieces: Sequence[Piece]) -> tuple[np.ndarray, np.ndarray]:
    """Noise of x, v and u, and what to begin with: of none, whatever is left is trusted."""
    _, *every = zip(*pieces)
    levels = np.array([np.median([noise_level(one) for one in some]) for some in every])
    sizes = [max(map(np.std, some)) for some in every]
    return levels, np.maximum(levels, ROUGHLY * np.array(sizes))


def _step(
    bins: "_Steady", theta: np.ndarray, lagged: bool, known: Left | None, levels: np.ndarray
) -> PairFit | None:
    """The fit after one step of Gauss and Newton."""
    motion, slope, noise, of_motion = bins.delayed(0.0 if lagged else theta[0], levels)
    rate, zero = bins.rate, bins.zero
    if lagged and theta[0] >= 0:
        # v + T v' is what came in; divided by 1 + i omega T its noise stays what it was.
        pole = 1 / (1 + 1j * bins.omega * theta[0])
        rate, zero = pole * (rate + theta[0] * bins.second), pole[:, None] * zero
        motion, slope = pole * motion, pole**2 * slope
    elif lagged:
        motion = motion + theta[0] * slope
    error = rate - theta[1] * motion - zero @ theta[2:]
    left = _power(error) / noise
    smoothed = (
        _smoothed(bins.near, left)
        if known is None
        else np.interp(bins.omega, known.omega, known.smoothed)
    )
    smoothed = np.maximum(smoothed, 1e-26 * np.max(_power(rate) / noise))
    power = _smoothed(bins.near, _power(motion) / noise)
    counted = (power > CARRIED * smoothed) | bins.lowest
    # Real and imaginary part have half the power each; at frequency zero all of it is real.
    weight = np.where(counted, np.where(bins.omega > 0, 2, 1) / (smoothed * noise), 0.0)
    rows = np.array([theta[1] * slope, motion, *zero.T, error])[:, counted]
    # The real part of what conjugates make is that of real and imaginary parts by themselves.
    rows = np.concatenate([np.real(rows), np.imag(rows)], axis=1)
    products = (rows * np.tile(weight[counted], 2)) @ rows.T
    normal, right = products[:-1, :-1], products[:-1, -1]
    # Of a signal without noise the level expected is that of its own curvature.
    of_noise = float(weight @ np.minimum(of_motion, smoothed * noise))
    scale = np.sqrt(np.diag(normal))
    if not (np.isfinite(scale).all() and scale.all()) or of_noise > MOST_NOISE * normal[1, 1]:
        return None
    right[1] += theta[1] * of_noise
    normal[1, 1] -= of_noise
    covariance = np.linalg.pinv(normal / np.outer(scale, scale), 1e-12) / np.outer(scale, scale)
    step = covariance @ right
    # Phases are straight over an eighth of a turn of the usual frequency.
    usual = np.sqrt(normal[1, 1] / max(normal[0, 0], np.finfo(float).tiny)) * abs(theta[1])
    step[0] = np.clip(step[0], -0.8 * usual, 0.8 * usual)
    # The noise of the motion goes with the gain, and through the filter.
    size = (1 + (bins.omega * theta[0]) ** 2) ** -np.sign(theta[0]) if lagged else 1.0
    more = (size * theta[1] ** 2 - 1) * of_motion
    unlike = smoothed * noise / bins.energy / (1 + more / noise)
    errors = np.sqrt(np.diag(covariance) * bins.shared)
    after = Left(levels, bins.omega, smoothed, left, unlike)
    delay, gain, offset, drift = (theta + step).tolist()
    return PairFit(delay, gain, offset, drift, errors, after, counted, lagged)


def _power(values: Complex[np.ndarray, " bins"]) -> Float[np.ndarray, " bins"]:
    return np.real(values) ** 2 + np.imag(values) ** 2


def _shifted(piece: Piece, whole: int) -> Piece:
    """The same with v so many samples earlier."""
    first, size = max(whole, 0), max(piece.x.size - abs(whole), 0)
    x, u = (column[first - whole :][:size] for column in (piece.x, piece.u))
    return Piece(piece.start + first, x, piece.v[first:][:size], u)


RISE = np.polynomial.Polynomial([0, 1, -1]) ** 3
RISE /= RISE.integ()(1)
"""The slope of a step from 0 to 1, which is smooth at both ends."""
_STEPS = (each.coef for each in (RISE.integ(), RISE, RISE.deriv()))
STEP = np.array([*itertools.zip_longest(*_STEPS, fillvalue=0.0)])
"""Coefficients of that step, of its slope and of its curvature, by power."""


def _taper(n: int, shift: float) -> Float[np.ndarray, "3 n"]:
    """A taper `shift` samples on, its slope and its curvature: a step of degree 7 at either end.

    **Arguments:** `shift`, of less than `MARGIN` samples.
    """
    edge = min(max(n // 8, 16), EDGE)
    reach, last = edge + 2 * MARGIN, n - 1 - 2 * MARGIN
    taper = np.zeros((3, n))
    taper[0, reach : n - reach] = 1.0
    ends = np.concatenate([np.arange(reach), np.arange(n - reach, n)])
    at = ends + shift - MARGIN
    u = np.clip(np.minimum(at, last - at) / edge, 0.0, 1.0)
    side = np.where(2 * at < last, 1, -1) / edge
    taper[:, ends] = np.polynomial.polynomial.polyval(u, STEP) * side ** np.arange(3)[:, None]
    return taper


class _Steady(NamedTuple):
    """Of the transforms of all pieces, by ascending frequency, what no delay changes.

    **Fields:** transforms of v, the `rate`, of its derivative, the `second`, and of an offset and a
    drift, `zero`; `energy` of the tapers, and what their slope adds to it at each frequency,
    `sloped`; whether a bin is among the `lowest` of its piece; `shared`, times by which variances
    grow as tapers tie neighbouring bins together; `order`, frequencies of all pieces one after the
    other, sorted; `near`, the first and last neighbour over which each is smoothed.
    """

    pieces: Sequence[Piece]
    sizes: list[int]
    omega: Float[np.ndarray, " bins"]
    rate: Complex[np.ndarray, " bins"]
    second: Complex[np.ndarray, " bins"]
    zero: Complex[np.ndarray, "bins 2"]
    energy: Float[np.ndarray, " bins"]
    sloped: Float[np.ndarray, " bins"]
    lowest: Bool[np.ndarray, " bins"]
    shared: float
    order: Int[np.ndarray, " bins"]
    near: Int[np.ndarray, "2 bins"]

    @classmethod
    def of(cls, pieces: Sequence[Piece], count: int) -> "_Steady":
        """Of pieces of a record of so many samples."""
        parts, tapers, sizes = [], [], []
        for start, x, v, _ in pieces:
            size = int(scipy.fft.next_fast_len(x.size, real=True) or x.size)
            omega = 2 * np.pi * np.arange(size // 2) / size
            (w, slope, _), course = _taper(x.size, 0.0), (start + np.arange(x.size)) / count - 0.5
            columns = np.array([w * v, slope * v, w, w * course])
            rate, falling, zero, first = np.fft.rfft(columns, size)[:, : size // 2]
            energy, ones = np.sum(w**2), np.ones(omega.size)
            lowest = np.arange(omega.size) < LOWEST_BINS
            second, zeros = 1j * omega * rate - falling, np.transpose([zero, first])
            sloped = np.sum(slope**2) * ones
            parts.append((omega, rate, second, zeros, energy * ones, sloped, lowest))
            tapers.append((size, energy, np.sum(w**4)))
            sizes.append(size)
        joined = [np.concatenate(columns) for columns in zip(*parts)]
        order = np.argsort(joined[0], kind="stable")
        total, squares, fourth = map(sum, zip(*tapers))
        sorted_columns = [column[order] for column in joined]
        near = _neighbours(sorted_columns[0])
        shared = float(total * fourth / squares**2)
        return cls._make([pieces, sizes, *sorted_columns, shared, order, near])

    def delayed(self, delay: float, levels: np.ndarray) -> "_Delayed":
        """What of them changes with v so late, and noise of these levels."""
        parts = []
        for (_, x, _, u), size in zip(self.pieces, self.sizes):
            moved = _taper(x.size, delay)
            known = moved[:2] * u if u.any() else np.zeros((0, x.size))
            transforms = np.fft.rfft(np.concatenate([moved * x, known]), size)[:, : size // 2]
            omega = 2 * np.pi * np.arange(size // 2) / size
            turned, i_omega = np.exp(-1j * omega * delay), 1j * omega
            (whole, sloping, curved), known = np.split(transforms, [len(moved)])
            motion = i_omega * whole - sloping
            turning = i_omega * (motion - sloping) + curved
            if len(known):
                motion, turning = motion + known[0], turning + i_omega * known[0] - known[1]
            parts.append((turned * motion, -turned * turning))
        motion, slope = (np.concatenate(columns)[self.order] for columns in zip(*parts))
        of_motion = levels[0] ** 2 * (self.omega**2 * self.energy + self.sloped)
        of_motion += levels[2] ** 2 * self.energy
        noise = of_motion + (levels[1] ** 2 + 1e-30) * self.energy
        return _Delayed(motion, slope, noise, of_motion)


class _Delayed(NamedTuple):
    """Transforms of what v should be at a delay, their `slope` over it, and the power of noise that
    is expected of them, and of it that of the `motion`."""

    motion: Complex[np.ndarray, " bins"]
    slope: Complex[np.ndarray, " bins"]
    noise: Float[np.ndarray, " bins"]
    noise_of_motion: Float[np.ndarray, " bins"]


def _neighbours(omega: np.ndarray) -> Int[np.ndarray, "2 bins"]:
    """The neighbours of each of ascending frequencies over which it is smoothed."""
    at = np.arange(omega.size)
    low = np.minimum(np.searchsorted(omega, omega / RATIO), at - NEIGHBOURS).clip(0)
    high = np.maximum(np.searchsorted(omega, omega * RATIO), at + NEIGHBOURS + 1)
    return np.array([low, high.clip(max=omega.size)])


def _smoothed(near: Int[np.ndarray, "2 bins"], power: np.ndarray) -> np.ndarray:
    """Mean over neighbours in frequency."""
    sums, (low, high) = np.concatenate([[0.0], np.cumsum(power)]), near
    return (sums[high] - sums[low]) / (high - low)


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
        first = self.first * step - PPM * ppm * start
        shifted = late if abs(first) > CHANGE * step else ()
        return (
            *option_for("--shift", shifted, f"{first:.4g}"),
            *option_for("--clock", late, f"{ppm:.5g}"),
        )

    @property
    def way(self) -> str:
        """What the signal does whose delay changes evenly."""
        return "falls behind" if self.change > 0 else "gets ahead of"

    @property
    def lasts(self) -> str:
        """The delay at the start and at the end, in words."""
        return f"from {self.first:.3g} to {self.first + self.change:.3g} samples"


def delay_course(
    parts: Sequence[Sequence[Piece]], edges: Sequence[int], count: int, whole: PairFit
) -> tuple[Course, float]:
    """How the delay changes from part to part, and how much more it scatters than its errors say.

    **Arguments:** `parts` of the record between these `edges`; `whole`, the fit to all of it.
    """
    fits = [fit_pair(part, count, start=whole, known=whole.left, steps=1) for part in parts]
    delays = _delays(fits, edges)
    steady, spread = _steady(delays)
    if delays.shape[1] < FEWEST_PARTS or steady < UNEVEN:
        return Course(), spread
    # Too far apart for one step from the same start.
    alone = [fit_pair(part, count) for part in parts]
    # What is left of one part is known too roughly: that of all parts, by frequency, is for each.
    left = [(fit.left.omega, fit.left.power) for fit in alone if fit is not None]
    omega, power = (np.concatenate(columns) for columns in zip(*left))
    order = np.argsort(omega, kind="stable")
    groups = max(omega.size // SHORTEST_PIECE, 1)
    means = [
        np.array([some.mean() for some in np.array_split(column[order], groups)])
        for column in (omega, power)
    ]
    fits = [
        None
        if fit is None
        else fit_pair(part, count, start=fit, known=Left(fit.left.levels, *means), steps=2)
        for fit, part in zip(alone, parts)
    ]
    delays = _delays(fits, edges)
    if delays.shape[1] < FEWEST_PARTS:
        return Course(), spread
    steady, spread = _steady(delays)
    course, left = changing(delays, edges)
    more = float(np.sqrt(max(1.0, left / (delays.shape[1] - 3))))
    course = course._replace(error=course.error * more)
    least = max(LOST if course.kind == "rows" else CHANGE, SURE * course.error)
    uneven = steady - left > UNEVEN * more**2 and abs(course.change) > least
    return (course, more) if uneven else (Course(), spread)


def _steady(delays: Float[np.ndarray, "4 parts"]) -> tuple[float, float]:
    """Chi-square of delays about their mean; and times that they scatter more than they should."""
    left = _left(delays, np.ones_like(delays[:1]))[0]
    return left, float(np.sqrt(max(1.0, left / max(delays.shape[1] - 1, 1))))


def _delays(fits: Sequence[PairFit | None], edges: Sequence[int]) -> Float[np.ndarray, "4 parts"]:
    """Delay and its error of each part that tells it, and the part's first and last sample."""
    told = [
        (fit.delay, np.hypot(fit.errors[0], FINEST), *ends)
        for fit, ends in zip(fits, itertools.pairwise(edges))
        if fit is not None and 0 < fit.errors[0] < np.inf
    ]
    return np.array(told, float).reshape(-1, 4).T


def changing(delays: Float[np.ndarray, "4 parts"], edges: Sequence[int]) -> tuple[Course, float]:
    """The course that explains the delays best, and the chi-square that it leaves."""
    first, last = delays[2:]
    ones, size = np.ones(first.size), first.size
    left, coefficients, errors = _left(delays, np.array([ones, 0.5 * (first + last) / edges[-1]]))
    best = Course("clocks", coefficients[1], errors[1], (0, edges[-1]), coefficients[0]), left
    # The change lies between two parts, or within one, which then says nothing; two are behind it.
    for k, stop in ((k, k + within) for k in range(2, size - 1) for within in (0, 1)):
        if stop <= size - 2:
            rows = np.array([ones, np.arange(size) >= stop, *np.eye(size)[k:stop]])
            left, coefficients, errors = _left(delays, rows)
            if left + 4 < best[1]:
                place = int(first[stop - 1]), int(last[k])
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


class Relation(NamedTuple):
    """The time derivative of `signal` is the sum `of` signals, each times its factor."""

    signal: str
    of: tuple[tuple[str, float], ...]

    @property
    def terms(self) -> tuple[str, ...]:
        """Names in the sum."""
        return tuple(name for name, _ in self.of)

    @property
    def names(self) -> tuple[str, ...]:
        """All signals."""
        return (self.signal, *self.terms)

    @property
    def is_plain(self) -> bool:
        """Whether the derivative is one signal as it is."""
        return len(self.of) == 1 and self.of[0][1] == 1

    @property
    def suspects(self) -> tuple[str, ...]:
        """Signals each of which may alone be wrong: of a signal and its derivative it is moot
        which."""
        return self.terms if len(self.of) == 1 else self.names

    def words(self, suspect: str) -> tuple[str, str]:
        """What a term is called, or the whole sum; and what it should be equal to."""
        if suspect not in self.terms:
            return summed(self.of), f"the derivative of {self.signal}"
        factor = dict(self.of)[suspect]
        if len(self.of) == 1:
            times = "" if factor == 1 else f"{1 / factor:.4g} times "
            return suspect, f"{times}the derivative of {self.signal}"
        rest = [(name, -c / factor) for name, c in self.of if name != suspect]
        return suspect, summed([*rest, (f"{self.signal}'", 1 / factor)])


Pairs: TypeAlias = Iterable[tuple[str, str] | Relation]
"""Signals and their derivatives."""


def relations(pairs: Pairs) -> Iterator[Relation]:
    """Each of them once."""
    for signal, of in dict.fromkeys(pairs):
        yield Relation(signal, ((of, 1.0),) if isinstance(of, str) else of)


def with_sum(record: Record, relation: Relation) -> tuple[Record, str, str]:
    """A record with the sum as a signal, the name of the signal it is the derivative of, its own.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    if relation.is_plain:
        return record, relation.signal, relation.terms[0]
    label = summed(relation.of)
    first, *rest = (c * record.signal(name) for name, c in relation.of)
    # No column holds it, whose unit could be another one.
    total = dataclasses.replace(sum(rest, first), unit="")
    return record.with_signals({label: total}), relation.signal, label


def summed(terms: Iterable[tuple[str, float]]) -> str:
    """A sum as it is written, positive terms first."""
    words = ""
    for name, factor in sorted(terms, key=lambda term: term[1] < 0):
        size = name if abs(factor) == 1 else f"{abs(factor):.4g} {name}"
        sign = "-" if factor < 0 else "+"
        words += f" {sign} {size}" if words else f"{sign if factor < 0 else ''}{size}"
    return words


LATE = 0.02
"""Samples of delay past which it matters. Between samples a motion under an input as fast as they
are goes its own way, as that of a simulated road, by up to 0.013 of them."""
GROSS = 0.1
"""Share by which sensors of one motion may differ in gain: more than any calibration leaves."""
GAIN = 0.01
"""Share by which a gain must be off; more than a calibration leaves is 2 %."""
OFFSET = 0.002
"""Share of the derivative's rms past which its offset, or its drift over the record, matters."""
TAILS = 1.5
"""Times `SURE` that an offset or drift must be. Few slow motions tell of it, and its error less
well than others: of 400 sound records at 5 % noise a drift was 5.2 of its standard errors."""
LIKELIER = 12.0
"""Gain in log-likelihood past which a delay is a filter's lag."""
ROUGH = 0.5
"""Mean square of a signal's steps, over its variance, past which none is looked at in a sum: of
white noise it is 2, of noise up to an eighth of the sampling rate 0.2."""
FEWEST_CYCLES, CYCLES_OF_WINDOW = 1.0, 1.5
"""Of the motion, in a record and in a part of it: on less, offset, drift and delay are alike."""
WINDOWS, SHORTEST_WINDOW = 12, 250
"""Parts of the record whose delays are compared, and the fewest samples of one."""
MOST_SAMPLES, LONGEST_PIECE = 2**15, 2**13
"""Of a long record, samples that are looked at, in pieces evenly spread."""
SHORT_GAP = 5
"""Samples of a gap that is filled in."""
SPIKE = 5.0
"""Times that a spike leaves the median of five samples further than its neighbours range."""
MOST_SPIKES = 0.05
"""Share of samples past which these are no spikes."""


class Pair(NamedTuple):
    """How a signal follows what it should be by a relation, the derivative of another at its
    simplest.

    **Fields:** `relation`; `suspect`, the one of its signals that alone explains best what is
    amiss; `fit` of it, or of the sum if it is the signal that is differentiated, in samples and
    the derivative's unit, lagged where a low-pass describes it better than a delay; `course` of the
    delay; `rms` of the derivative; `step` of time in seconds; `alike`, signals that explain it
    hardly worse.
    """

    relation: Relation
    suspect: str
    fit: PairFit
    course: Course
    rms: float
    step: float
    alike: tuple[str, ...] = ()

    @property
    def is_gross(self) -> bool:
        """Whether the gain is no calibration's."""
        return abs(self.fit.gain - 1) > GROSS

    @property
    def scaling(self) -> float:
        """What the suspect has to be multiplied by."""
        return self.fit.gain ** (1 if self.suspect == self.relation.signal else -1)

    @property
    def zeroed(self) -> tuple[str, float]:
        """A signal whose offset would explain the fit's, and how many of it that is.

        The suspect if it is a term, else the last one.
        """
        factors = dict(self.relation.of)
        name = self.suspect if self.suspect in factors else self.relation.terms[-1]
        return name, factors.get(self.suspect, 1.0) / factors[name]

    @property
    def sides(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of what is held against each other: a term against all else, or all terms."""
        terms = self.relation.terms
        mine = (self.suspect,) if self.suspect in terms else terms
        return mine, tuple(name for name in self.relation.names if name not in mine)

    @property
    def late(self) -> dict[str, float]:
        """Seconds by which each signal is later than the others, 0 unless surely and steadily."""
        mine, others = self.sides
        return dict.fromkeys(others, 0.0) | dict.fromkeys(mine, self.delay)

    @property
    def delay(self) -> float:
        """Seconds by which the derivative is surely late and steadily so, else 0."""
        return self.fit.delay * self.step if self.is_late and not self.fit.lagged else 0.0

    @property
    def is_late(self) -> bool:
        """Whether the derivative is surely late, or early, or lags, throughout the record."""
        return self.course.kind == "steady" and self._is_sure(self.fit.delay, LATE, 0)

    @property
    def gain_is_off(self) -> bool:
        """Whether the derivative's size is surely wrong."""
        return self.course.kind == "steady" and self._is_sure(self.fit.gain - 1, GAIN, 1)

    @property
    def offset(self) -> float:
        """Of the derivative, in its unit, 0 unless it surely matters."""
        sure = self._is_sure(self.fit.offset, OFFSET * self.rms, 2, TAILS)
        return self.fit.offset if sure else 0.0

    @property
    def drift(self) -> float:
        """Of the derivative over the record, in its unit, 0 unless it surely matters."""
        sure = self._is_sure(self.fit.drift, 2 * OFFSET * self.rms, 3, TAILS)
        return self.fit.drift if sure else 0.0

    def _is_sure(self, size: float, least: float, which: int, times: float = 1.0) -> bool:
        """Whether it matters and is no chance; twice as surely where several may be wrong and none
        stands out."""
        several = len(self.alike) + 1 == len(self.relation.names) > 2
        sure = times * (2 * SURE if several else SURE)
        return abs(size) > max(least, sure * self.fit.errors[which])


def compare(record: Record, relation: Relation) -> Pair | None:
    """Fit each signal of a relation to what the others say it should be; `None` if the record does
    not tell.

    What is left tells which of them is wrong: with that one put right, nothing but noise. Not under
    jit.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    columns = {name: record.signal(name).with_nan for name in relation.names}
    return _compared(relation, columns, np.asarray(record.elapsed), float(record.time_step))


@once
@np.errstate(all="ignore")
def _compared(
    relation: Relation, columns: dict[str, Samples], time: Samples, step: float
) -> Pair | None:
    """The same of columns by name, at these times, so many seconds apart."""
    x, count = columns[relation.signal], time.size
    terms = {name: columns[name] for name in relation.terms}
    # What is too fast has an integral that depends on what it does between samples.
    rough = (np.nanmean(np.diff(v) ** 2) > ROUGH * np.nanvar(v) for v in terms.values())
    if (len(terms) > 1 and any(rough)) or np.isnan(x).all():
        return None
    centre = np.nanmedian(x)
    scale = float(np.nanquantile(np.abs(x - centre), 0.9))
    if not 0 < scale < np.inf:
        return None
    x, terms = (x - centre) / scale, {n: v / scale * step for n, v in terms.items()}
    # Samples that follow a pause.
    breaks = np.flatnonzero(np.diff(time) > SHORTEST_PAUSE * step) + 1
    every = (_held(relation, name, x, terms, breaks) for name in relation.suspects)
    if not (held := {one.suspect: one for one in every if one is not None}):
        return None
    excess = _excess(held, {name: one.fit for name, one in held.items()})
    suspect = min(excess, key=excess.__getitem__)
    cycles = held[suspect].rms * count / (2 * np.pi)
    windows = min(WINDOWS, count // SHORTEST_WINDOW, int(cycles / CYCLES_OF_WINDOW))
    if max(excess.values()) > LIKELIER:
        # Where it matters which one is wrong, low-passes are looked at as well.
        filtered = {n: _low_pass(one.pieces, count, one.fit) or one.fit for n, one in held.items()}
        excess = _excess(held, filtered)
        suspect = min(excess, key=excess.__getitem__)
    one, edges = held[suspect], np.linspace(0, count, windows + 1).astype(int).tolist()
    parts = [
        list(_pieces(one.columns, first, last, breaks, MOST_SAMPLES // windows))
        for first, last in itertools.pairwise(edges)
    ]
    course, spread = delay_course(parts, edges, count, one.fit)
    fit, unit = one.fit._replace(errors=one.fit.errors * spread), scale / step
    rms = one.rms * abs(one.size) * unit
    alike = tuple(n for n, more in excess.items() if n != suspect and more < LIKELIER)
    pair = Pair(relation, suspect, one.sized(fit, unit), course, rms, step, alike)
    lag = _low_pass(one.pieces, count, fit) if pair.is_late else None
    return pair if lag is None else pair._replace(fit=one.sized(lag, unit))


class _Held(NamedTuple):
    """A suspect against what the others say it should be.

    **Fields:** `columns`, x, v and u of the fit, v divided by the `size` it seems to have; `unit`
    of the fit in units of the sum; `rms` of the derivative of x.
    """

    suspect: str
    columns: np.ndarray
    size: float
    unit: float
    pieces: list[Piece]
    rms: float
    fit: PairFit

    def sized(self, fit: PairFit, unit: float) -> PairFit:
        """A fit of v as it is, offset and drift in their unit of which the fit's is so many."""
        factors = self.size * np.array([1.0, unit, unit])
        gain, offset, drift = (factors * fit[1:4]).tolist()
        errors = fit.errors * np.abs([1.0, *factors])
        return fit._replace(gain=gain, offset=offset, drift=drift, errors=errors)


def _held(
    relation: Relation,
    suspect: str,
    x: np.ndarray,
    terms: dict[str, np.ndarray],
    breaks: np.ndarray,
) -> _Held | None:
    factors, count, u, size = dict(relation.of), x.size, np.zeros(x.size), 1.0
    if suspect in terms:
        rest = (-c / factors[suspect] * terms[n] for n, c in relation.of if n != suspect)
        x, v, u = x / factors[suspect], terms[suspect], sum(rest, u)
    else:
        v = sum((c * terms[n] for n, c in relation.of), u)
    several, columns = len(relation.suspects) > 1, np.array([x, v, u])
    pieces = list(_pieces(columns, 0, count, breaks, MOST_SAMPLES // (1 + several)))
    if several and pieces:
        # Size of v over that of what it should be, with its sign, to begin with; 1 unless far off.
        bins = _Steady.of(pieces, pieces[0].x.size)
        expected, *_, of_motion = bins.delayed(0.0, _levels(pieces)[1])
        weight = np.where(bins.lowest, 0.0, 1 / of_motion)
        both = float(np.real(weight @ (bins.rate * expected.conj())))
        motion, rate = (float(weight @ np.abs(one) ** 2) for one in (expected, bins.rate))
        size = both / motion
        size = size if both**2 > NEAR**2 * motion * rate and not 0.5 < size < 2 else 1.0
        columns[1] /= size
        pieces = [p._replace(v=p.v / size) for p in pieces]
    every = [p.v - p.u for p in pieces]
    rms = float(np.sqrt(np.mean(np.concatenate(every) ** 2))) if every else 0.0
    if not FEWEST_CYCLES < rms * count / (2 * np.pi) < np.inf:
        return None
    fit = fit_pair(pieces, count)
    if fit is None or not np.isfinite(fit.errors).all():
        return None
    return _Held(suspect, columns, size, factors.get(suspect, size), pieces, rms, fit)


def _excess(held: dict[str, _Held], fits: dict[str, PairFit]) -> dict[str, float]:
    """By how much less likely it is that each signal alone is wrong, in log-likelihood."""
    if len(fits) == 1:
        return dict.fromkeys(fits, 0.0)
    omega = next(iter(fits.values())).left.omega
    powers = [
        held[name].unit ** 2 * np.interp(omega, fit.left.omega, fit.left.unlike)
        for name, fit in fits.items()
    ]
    counted = [np.interp(omega, fit.left.omega, fit.counted) > 0.5 for fit in fits.values()]
    logs = np.sum(np.log(powers), axis=1, where=np.any(counted, axis=0))
    return dict(zip(fits, (logs - logs.min()).tolist()))


def _pieces(
    columns: Float[np.ndarray, "3 n"], start: int, stop: int, breaks: np.ndarray, most: int
) -> Iterator[Piece]:
    """Unbroken stretches of all, short gaps and spikes filled in; of many samples some."""
    size = stop - start
    starts = [start]
    if size > most:
        size = min(LONGEST_PIECE, most)
        starts = np.linspace(start, stop - size, most // size).astype(int)
    for first in starts:
        every = [_filled(column) for column in columns[:, first : first + size]]
        known = ~np.isnan(np.sum(every, axis=0))
        cuts = np.union1d(np.flatnonzero(np.diff(known)) + 1, breaks - first)
        for piece in np.split(np.arange(size), cuts[(cuts > 0) & (cuts < size)]):
            if piece.size >= SHORTEST_PIECE and known[piece[0]]:
                yield Piece(first + piece[0], *(column[piece] for column in every))


def _filled(values: np.ndarray) -> np.ndarray:
    """Spikes and short gaps replaced by local cubics."""
    found, half = values.copy(), 4
    if values.size > 2 * half + 1:
        around = np.lib.stride_tricks.sliding_window_view(values, 2 * half + 1).T
        off = np.abs(values[half:-half] - _median_of_five(*around[2:-2]))
        near = np.delete(around, half + np.arange(-1, 2), axis=0)
        spikes = np.flatnonzero(off > SPIKE * np.ptp(near, axis=0)) + half
        if spikes.size <= MOST_SPIKES * values.size:
            found[spikes] = np.nan
    gaps = np.isnan(found)
    known, short = np.flatnonzero(~gaps), np.flatnonzero(gaps & (run_lengths(gaps) <= SHORT_GAP))
    behind = np.searchsorted(known, short)
    # Two samples on each side, by Lagrange. Splines of SciPy's take a fifth of a second to import.
    inside = (behind >= 2) & (behind <= known.size - 2)
    near = known[behind[inside, None] + np.arange(-2, 2)]
    to, apart = short[inside, None, None] - near[:, None], near[..., None] - near[:, None]
    shares = np.divide(to, apart, out=np.ones(apart.shape), where=apart != 0)
    found[short[inside]] = np.sum(np.prod(shares, axis=2) * found[near], axis=1)
    return found


def _median_of_five(a: Samples, b: Samples, c: Samples, d: Samples, e: Samples) -> Samples:
    """Of each sample's; twenty times as fast as by sorting. NaN where one is."""
    # Neither the least of two pairs nor the largest is the middle of five: of each two pairs the
    # larger of the lower ones and the smaller of the upper ones are left, and the fifth.
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))


def _low_pass(pieces: Sequence[Piece], count: int, delayed: PairFit) -> PairFit | None:
    """The fit of a low-pass, if it describes the pair better than a delay."""
    lag = fit_pair(pieces, count, lagged=True)
    if lag is None or not np.isfinite(lag.errors).all() or abs(lag.delay) < SURE * lag.errors[0]:
        return None
    # The likelihood of noise whose power is what is left. A filter makes less of that of terms.
    known = any(piece.u.any() for piece in pieces)
    before, after = (fit.left.unlike if known else fit.left.smoothed for fit in (delayed, lag))
    power, counted = (
        np.interp(delayed.left.omega, lag.left.omega, column) for column in (after, lag.counted)
    )
    both = delayed.counted & (counted > 0.5)
    return lag if np.sum(np.log(before / power)[both]) > LIKELIER else None


SHORTEST, LONGEST_SHARE = 4, 8
"""Lags: from this many samples to this part of the record, each four times the one before."""
FEWEST_LAGS = 50
"""Pairs of samples below which nothing is said."""
EXTREME = 0.99
"""Quantile past which increments are cut off, so that single spikes do not decide."""
ALIKE = 0.95
"""Correlation of increments, of either sign, past which they belong to one motion."""
UNRELATED = 0.5
"""Correlation below which two signals do not belong to each other."""
TOLD = 10.0
"""Standard errors that a gain has to be for one signal to explain what is amiss with several."""
LOGGED = (
    *("mm", "cm", "um", "in", "ft", "deg", "mrad", "mm/s", "cm/s", "in/s", "ft/s", "km/h", "mph"),
    *("deg/s", "rpm", "mm/s2", "g", "deg/s2"),
)
"""Units of motion that loggers write beside those of SI."""
CALIBRATED = 0.03
"""Share by which a gain may be off that of a unit."""


def check_derivatives(record: Record, pairs: Pairs) -> list[Finding]:
    """Compare the increments of signals with the integrals of their derivatives.

    Each pair names a signal and the signal that holds its derivative, or is a relation with
    several whose sum does. The comparison is made over
    the lag at which they agree best: noise hides short increments of a position, and an offset
    that drifts spoils long integrals of a velocity. Constant offsets do not matter. Where they
    agree but for little, a fit over frequencies tells how little. Codes: `not_its_derivative`,
    `lost_rows`, `two_clocks`, `late_signal`, `low_passed`, `wrong_gain`, `drifting_signal` and
    `velocity_offset`. A derivative that was computed from the signal is not compared. Not under
    jit.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    findings: dict[tuple[str, tuple[str, ...]], Finding] = {}
    for relation in relations(pairs):
        if not any(record.noise.is_made_of(name, relation.signal) for name in relation.terms):
            wrong, pair = compared(record, relation)
            every = [wrong] if wrong else [] if pair is None else pair_findings(record, pair)
            for finding in every:
                key = finding.code, finding.signals
                findings[key] = findings.pop(key, finding)
    return list(findings.values())


def compared(record: Record, relation: Relation) -> tuple[Finding | None, Pair | None]:
    """What is grossly wrong with a relation, or else how its signals fit each other.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    if relation.is_plain:
        wrong = disagreement(record, relation.signal, relation.terms[0])
        return wrong, compare(record, relation) if wrong is None else None
    pair = compare(record, relation)
    if pair is not None and abs(pair.fit.gain) > TOLD * pair.fit.errors[1]:
        return None, pair
    wrong = disagreement(*with_sum(record, relation))
    return wrong and wrong._replace(signals=relation.names), None


def disagreement(record: Record, signal: str, derivative: str) -> Finding | None:
    """`not_its_derivative` of a signal and what is read as its derivative, if they do not fit."""
    pair = {name: record.signal(name) for name in (signal, derivative)}
    x, dx = (one.with_nan for one in pair.values())
    best = _best_lag(x, dx, float(record.time_step))
    if best is None:
        return None
    (correlation, gain), units, likely = best, [], ""
    # No share of noise in either signal explains every gain that is not 1. Noise in the integrals
    # lowers the slope of increments on integrals, cov / var(integrals) = gain x correlation, below
    # the true gain; noise in the increments raises the inverse of the other regression's slope,
    # var(increments) / cov = gain / correlation, above it. So the two enclose the true gain.
    if abs(correlation) < ALIKE and correlation < UNRELATED:
        what = (
            f"does not move with {signal} (the increments of {signal} and the integral of "
            f"{derivative} correlate by {correlation:.2f} at best)"
        )
        doubt = 1.0
    elif _is_gross(correlation, gain):
        # A step takes place in a few samples, in which a late signal has another size.
        if (late := _late(x, dx, float(record.time_step))) is not None:
            seconds, fits = late
            remedy = option_for(
                "--shift", [derivative if seconds > 0 else signal], f"{abs(seconds):.3g}"
            )
            return Finding(
                "late_signal",
                f"{derivative} comes about {1e3 * abs(seconds):.3g} ms "
                f"{'late' if seconds > 0 else 'early'} against {signal}: in time, {signal} changes "
                f"by {fits:.4g} times the integral of {derivative}, as they are by {gain:.4g}. "
                f"{shlex.join(remedy)} brings the later one forward.",
                (derivative, signal) if seconds > 0 else (signal, derivative),
                doubt=min(max(gain**2, gain**-2) - 1, 1.0),
                remedy=remedy,
            )
        what = (
            f"does not fit the size, sign or time of {signal}: {signal} changes by "
            f"{gain:.4g} times the integral of {derivative}"
        )
        # Columns that a logger may have written in another unit, and no one converted.
        factors = {derivative: gain, signal: 1 / gain if gain else 0.0}
        stated = {name: readings(pair[name].unit).values() for name in factors}
        units = [
            f"{name}={unit}"
            for name, factor in factors.items()
            for unit in LOGGED
            for one in readings(unit).values()
            for known in stated[name]
            if known.powers == one.powers
            and abs(factor * known.factor / one.factor - 1) < CALIBRATED
        ]
        if units:
            likely = f" It fits where {' or '.join(u.replace('=', ' is in ') for u in units)}."
        elif abs(gain + 1) < CALIBRATED:
            likely = f" One of them points the other way: scale {derivative} or {signal} by -1."
        # A term may hold the signal squared, as drag does.
        doubt = min(max(gain**2, gain**-2) - 1, 1.0)
    else:
        return None
    remedy = ("--unit", *units) if len(units) == 1 else ()
    return Finding(
        "not_its_derivative",
        f"{derivative}, which is read as the derivative of {signal}, {what}.{likely} Check which "
        f"columns they are, their units and signs, and that time is in seconds (on the command "
        f"line: --map, --unit and --scale).",
        (signal, derivative),
        doubt=doubt,
        remedy=remedy,
        step="Convert " + " from ".join(units[0].split("=")) if remedy else "",
    )


def _is_gross(correlation: float, gain: float) -> bool:
    """Whether noise explains no gain of 1."""
    return gain < 0 or gain * correlation > 1 + GROSS or gain / correlation < 1 - GROSS


def _late(values: np.ndarray, rates: np.ndarray, step: float) -> tuple[float, float] | None:
    """Seconds that rates come late, and their gain, where it is one once they are in time.

    Rates that are tau late make increments of the values their integral, times the gain, and tau
    times their own increments: a column of its own, as long as means are not taken off.
    """
    known = ~(np.isnan(values) | np.isnan(rates))
    first, last = (int(end) for end in np.flatnonzero(known)[[0, -1]])
    if not known[first : last + 1].all():
        return None
    values, rates = values[first : last + 1], rates[first : last + 1]
    area = np.concatenate([[0.0], np.cumsum(0.5 * step * (rates[1:] + rates[:-1]))])
    lag = max(values.size // LONGEST_SHARE, SHORTEST)
    increments, integrals, turned = (one[lag:] - one[:-lag] for one in (values, area, rates))
    columns = np.column_stack([integrals, turned])
    (gain, turn), *_ = np.linalg.lstsq(columns, increments)
    left = increments - columns @ np.array([gain, turn])
    explained = float(left @ left) < (1 - ALIKE**2) * float(increments @ increments)
    if not explained or abs(gain - 1) > GROSS or abs(turn / gain) > MOST_LATE * step:
        return None
    return float(turn / gain), float(gain)


def is_motion(record: Record, signal: str, others: Iterable[str]) -> bool:
    """Whether one of the other signals is the recorded derivative of this one."""
    values, step = record.signal(signal).with_nan, float(record.time_step)
    lags = (_best_lag(values, record.signal(other).with_nan, step) for other in others)
    return any(lag and lag[0] > ALIKE and abs(lag[1] - 1) < GROSS for lag in lags)


# Values too large to be squared are for the fit to refuse.
@once
@np.errstate(over="ignore", invalid="ignore")
def _best_lag(values: np.ndarray, rates: np.ndarray, step: float) -> tuple[float, float] | None:
    """The highest correlation of increments with integrals of their rates over any lag, and there
    the increments' standard deviation over that of the integrals, with their common sign.

    `None` if there are too few pairs. Increments at all lags are differences of the same two
    columns, the values and the running integral of the rates, so that each lag costs one pass.
    """
    unknown = np.isnan(values) | np.isnan(rates)
    unknown_before = np.concatenate([[0], np.cumsum(unknown)])
    rates = np.where(unknown, 0.0, rates)
    area = np.concatenate([[0.0], np.cumsum(0.5 * step * (rates[1:] + rates[:-1]))])
    found = []
    lag, noise = SHORTEST, float(noise_level(np.where(unknown, np.nan, values)))
    while lag <= values.size // LONGEST_SHARE:
        whole = unknown_before[lag + 1 :] == unknown_before[: values.size - lag]
        if whole.sum() >= FEWEST_LAGS:
            increments = _winsorised((values[lag:] - values[:-lag])[whole])
            integrals = _winsorised((area[lag:] - area[:-lag])[whole])
            size, other = np.std(increments), np.std(integrals)
            # Increments that are mostly noise tell nothing of the motion.
            if size > 2 * noise and other > 0 and np.isfinite(size) and np.isfinite(other):
                correlation = float(np.mean(increments / size * integrals / other))
                found.append((correlation, float(np.sign(correlation) * size / other)))
        lag *= 4
    return max(found, key=lambda each: abs(each[0]), default=None)


def _winsorised(increments: np.ndarray) -> np.ndarray:
    """Increments about their mean, those past the quantile `EXTREME` of their size cut to it."""
    centred = increments - np.median(increments)
    limit = np.quantile(np.abs(centred), EXTREME)
    cut = np.clip(centred, -limit, limit)
    return cut - np.mean(cut)


def pair_findings(record: Record, pair: Pair) -> Iterator[Finding]:
    """What is amiss with a pair; codes as in the docs of [`check_derivatives`][].

    The doubt is the share of the derivative that is wrong: of a delay, the turn of its phase.
    """
    relation, fit, step = pair.relation, pair.fit, pair.step
    if pair.course.kind != "rows" and (cut := cut_rows(*with_sum(record, relation))):
        yield cut._replace(signals=relation.names)
        return
    # Which other signals may be the wrong one.
    or_else = f" Or {' or '.join(pair.alike)} is, which explains it as well." if pair.alike else ""
    # The usual frequency, from how much better a gain is known than a delay.
    turn = fit.errors[1] / max(fit.errors[0], np.finfo(float).tiny)
    if pair.course.kind != "steady":
        yield _uneven(record, pair, min(turn * abs(pair.course.change), 1.0), or_else)
    if pair.is_late:
        names, others = pair.sides if fit.delay > 0 else pair.sides[::-1]
        late, other = " and ".join(names), " and ".join(others)
        samples, seconds = abs(fit.delay), abs(fit.delay) * step
        size = f"{samples:.3g} \u00b1 {fit.errors[0]:.1g} samples ({1e3 * seconds:.3g} ms)"
        remedy = option_for("--unfilter" if fit.lagged else "--shift", names, f"{seconds:.4g}")
        how = shlex.join(remedy)
        said, next_step = (
            (
                f"{late} went through a first-order low-pass that {other} did not, with a time "
                f"constant of {size}, a cut-off at {1 / (2 * np.pi * seconds):.3g} Hz: it lags, "
                f"and loses what is fast. Record both alike, or undo it ({how}).{or_else}",
                f"Undo the low-pass of {late}",
            )
            if fit.lagged
            else (
                f"{late} {'are' if len(names) > 1 else 'is'} {size} late against {other}.{or_else} "
                f"{how} brings it forward, as --align auto does when the file is read. Whether "
                f"both are late against other signals the two cannot tell.",
                f"Bring {late} forward by {seconds:.3g} s",
            )
        )
        yield Finding(
            "low_passed" if fit.lagged else "late_signal",
            said,
            names,
            doubt=min(turn * samples, 1.0),
            remedy=remedy,
            step=next_step,
        )
    if pair.gain_is_off:
        gain, gross = fit.gain, pair.is_gross
        derivative, motion = relation.words(pair.suspect)
        size = f"{derivative} is {gain:.4g} \u00b1 {fit.errors[1]:.1g} times {motion}."
        several = len(relation.of) > 1
        remedy = ("--scale", f"{pair.suspect}={pair.scaling:.5g}")
        how = shlex.join(remedy)
        yield Finding(
            "not_its_derivative" if several and gross else "wrong_gain",
            f"{size} {pair.suspect} is calibrated wrongly, or has another "
            f"{'sign or unit' if gross else 'unit'}: scale it ({how}).{or_else}"
            if several
            else f"{size} Which of the two is calibrated wrongly they cannot tell: scale that one "
            f"({how}, or --scale {relation.signal}={gain:.5g}).",
            (pair.suspect,) if several else (derivative, relation.signal),
            # A term may hold the signal squared, as drag does.
            doubt=min(max(gain**2, gain**-2) - 1, 1.0),
            remedy=remedy,
            step=f"Scale {pair.suspect}"
            if several
            else f"Scale {derivative} or {relation.signal}, whichever sensor is off",
        )
    if not (value := pair.drift or pair.offset):
        return
    names, time = relation.names, np.asarray(record.time)
    derivative, factor = pair.zeroed
    signal = relation.signal if len(names) == 2 else relation.words(derivative)[1]
    share = abs(value) / pair.rms
    size = f"{value * factor:.3g} {record.signal(derivative).unit}".rstrip()
    lasts, change = f"over {time[-1] - time[0]:.4g} s", fit.drift * factor if pair.drift else 0.0
    what = f"drifts by {size} {lasts}" if pair.drift else f"has an offset of {size}"
    whose = "" if pair.drift else f" Or {signal} drifts by that per second."
    # Whose it is one relation cannot tell.
    if others := " or ".join(n for n in names if n not in (derivative, relation.signal)):
        whose = f" Or {others} has it, or {relation.signal} drifts."
    remedy = line_taken_off(derivative, time, fit.offset * factor, change)
    yield Finding(
        "drifting_signal" if pair.drift else "velocity_offset",
        f"{derivative} {what} against {signal}, {100 * share:.2g} % of its rms. Take it off (on "
        f"the command line: {shlex.join(remedy)}).{whose}",
        (derivative, *(n for n in names if n != derivative)),
        doubt=min(share, 1.0),
        remedy=remedy,
        step=f"Take the {'straight line' if pair.drift else 'offset'} off {derivative}",
    )


def _uneven(record: Record, pair: Pair, doubt: float, or_else: str) -> Finding:
    """Of a delay that changes along the record."""
    course, step, time = pair.course, pair.step, np.asarray(record.elapsed)
    sides = pair.sides
    mine, others = map(" and ".join, sides)
    both = (*sides[0], *sides[1])
    if course.kind == "clocks":
        per = step / PPM / float(time[-1] - time[0])
        rate, start = per * course.change, float(time[0])
        remedy = course.by_one_clock(sides[0], rate, step, start)
        reverse = course._replace(first=-course.first)
        other = reverse.by_one_clock(sides[1], -rate, step, start)
        return Finding(
            "two_clocks",
            f"{mine} {course.way} {others} evenly, {course.lasts} over the record: their clocks "
            f"differ by {rate:.3g} \u00b1 {per * course.error:.1g} ppm. Record both by one logger, "
            f"or set the clock that is off ({shlex.join(remedy)}, or {shlex.join(other)})."
            f"{or_else}",
            both,
            doubt=doubt,
            remedy=remedy,
            step=f"Set the clock of {mine}, if it is the one that is off",
        )
    first, last = (time[min(place, time.size - 1)] for place in course.place)
    return Finding(
        "lost_rows",
        f"The delay of {mine} against {others} jumps {course.lasts} between {first:.4g} "
        f"and {last:.4g} s: {others if course.change > 0 else mine} has lost "
        f"{abs(course.change):.3g} \u00b1 {course.error:.1g} samples "
        f"({1e3 * abs(course.change) * step:.3g} ms) there. Use the record up to there "
        f"(--to {first:.4g}) or from there on (--from {last:.4g}), where both agree in time."
        f"{or_else}",
        both,
        doubt=doubt,
        remedy=course.in_time(first, last),
        step="Use the part of the record in which both agree in time",
    )


HALVES = (1, 2, 5, 10, 30)
"""Samples to each side of filters that are tried, the longest first as the test of all."""
LEFT = 0.1
"""What such a filter leaves at most, in terms of the position's noise through it. A sensor's own
noise is left whole: a filter of the position cannot tell it."""
MOST_THROUGH = 2.0
"""Noise through a filter, in terms of all that there is of it and of motion, past which the filter
is none."""
LEAST_NOISE = 1e-5
"""Noise of differences, as a share of these, below which it matters to nothing: what looks like it
may be motion that no difference is of the order to take off."""
CONSTANT = 0.3
"""Share of its taps that a filter's sum may reach: a derivative of what is constant is zero. What
copies the position, or smooths it, is no derivative, and to take it for one would hide that."""
MOST_LATE = 6
"""Samples to either side by which a gross disagreement may be a delay."""
ROUNDS, FAR = 3, 10.0
"""Fits, each without rows that the one before left so many times its median."""
SHARPENED = 2
"""Order of the differences that are looked at, in which motion hides noise less."""


def without_computed(
    record: Record, pairs: Pairs, known: Collection[str] = ()
) -> tuple[Record, list[str]]:
    """Slopes of local polynomials in place of derivatives that are filters of their signals.

    A signal's own sensor is all that such a derivative knows of; the polynomials are as wide as its
    motion allows. Not under jit, where the record stays as it is.

    **Arguments:** `pairs` of a signal and its derivative; `known`, signals whose noise was given:
    a sensor's, then.

    **Returns:** the record, and what was done, in words.
    """
    if not is_concrete(record):
        return record, []
    words, judging = [], record
    for signal, derivative in (p for p in pairs if not isinstance(p, Relation)):
        noise = judging.noise
        judged = noise.kernels.get(signal) and {signal, derivative} <= {*record.arrays}
        # Some are made of their signals by a step of preparation.
        if derivative in known or not judged or noise.is_made_of(derivative, signal):
            continue
        # As they were recorded: the record has polynomials in place of some already.
        position, rate = (judging.signal(name).with_nan for name in (signal, derivative))
        taps = filter_between(position, rate, float(noise.std(signal)))
        if taps is None:
            continue
        judging = _with_noise_of(judging, signal, derivative, taps)
        said = f"{derivative}: computed from {signal}, by a filter of {taps.size} samples"
        try:
            record, width = with_local_derivative(record, signal, derivative)
            said = f"{said}; in its place slopes of local polynomials, {width:.3g} s to each side"
        except DataError:  # too short for them
            record = _with_noise_of(record, signal, derivative, taps)
        words.append(said)
    return record, words


def _with_noise_of(record: Record, signal: str, derivative: str, taps: np.ndarray) -> Record:
    """The record, of whose derivative the noise is the signal's through these taps."""
    return record.with_noise(Noise.of({derivative: record.noise[signal].convolved(taps)}))


@np.errstate(over="ignore", invalid="ignore")
def filter_between(signal: Samples, other: Samples, noise: float) -> Taps | None:
    """Taps of the shortest filter that makes one signal of another, whose noise has this standard
    deviation; `None` if none does."""
    stretches = runs(~(np.isnan(signal) | np.isnan(other))).T.tolist()
    first, stop = max(stretches, key=lambda ends: ends[1] - ends[0], default=(0, 1))
    # Differences are one-sided at the ends.
    position, rate = (each[first + 1 : stop - 1][:ENOUGH] for each in (signal, other))
    x, y = (np.diff(each, SHARPENED) for each in (position, rate))
    if position.size < 8 * HALVES[-1]:
        return None
    least, scale = LEAST_NOISE * np.std(np.diff(position)), np.std(x)
    # What is not finite squared, no sensor shows.
    if not (noise / np.sqrt(2) > least and np.isfinite(scale + np.std(y))):
        return None
    columns = np.lib.stride_tricks.sliding_window_view(x / scale, 2 * HALVES[-1] + 1)
    target = y[HALVES[-1] : y.size - HALVES[-1]]
    found = None
    for half in reversed(HALVES):
        inner = slice(HALVES[-1] - half, HALVES[-1] + half + 1)
        # Least squares, and what is left where no spike was repaired in one of the two.
        kept, left, taps = np.ones(target.size, bool), target, np.zeros(0)
        for _ in range(ROUNDS):
            some = columns[kept, inner]
            taps = np.linalg.lstsq(some.T @ some, some.T @ target[kept], rcond=1e-14)[0]
            left = target - columns[:, inner] @ taps
            before, kept = kept, np.abs(left) <= FAR * np.median(np.abs(left[kept]))
            if (kept == before).all():
                break
        through = noise / scale * np.linalg.norm(np.convolve(taps, [1, -2, 1]))
        # Taps that make more noise than there is fit motion alone, which few waves are.
        there = np.sqrt(np.mean(target**2))
        made = np.sqrt(np.mean(left[kept] ** 2)) < LEFT * through
        if not (made and through < MOST_THROUGH * there):
            break
        found = taps[::-1] / scale
    if found is not None and abs(found.sum()) > CONSTANT * np.abs(found).sum():
        return None
    return found


class Aligned(NamedTuple):
    """A record, what was shifted in words, and what was found amiss and put right."""

    record: Record
    words: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()


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
            seconds = pair.fit.delay * pair.step
            late.setdefault(name, seconds if name in pair.sides[0] else -seconds)
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
        mine, others = pair.sides
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

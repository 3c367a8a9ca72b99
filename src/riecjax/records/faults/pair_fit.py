"""How a recorded derivative follows its signal: delay, gain, lag, offset and drift, with errors.

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
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float

from riecjax.records.noise import noise_level

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
ITERATIONS, ROUGH = 14, 4
"""Steps of a fit, and the first of them, which weigh all frequencies as `ROUGHLY` noisy."""
ROUGHLY = 0.01
"""Share of a signal's deviation."""
NEAR = 0.7
"""Share of a correlation's peak: the cosine of the turn from which a fit finds it."""
EVEN = (np.array([0.0, np.pi]), np.ones(2))


class Piece(NamedTuple):
    """An unbroken stretch of the signals, and the place of its first sample in the record."""

    start: int
    x: Float[np.ndarray, " n"]
    v: Float[np.ndarray, " n"]
    u: Float[np.ndarray, " n"] | None = None


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

    **Fields:** `delay` or `lag` in samples, the other being 0; `gain`; `offset` of v at the middle
    of the record, and `drift` of v over the record; `errors`, the standard errors of delay or lag,
    gain, offset and drift; `left` by frequency, and whether that `counted`.
    """

    delay: float
    lag: float
    gain: float
    offset: float
    drift: float
    errors: Float[np.ndarray, "4"]
    left: Left
    counted: Bool[np.ndarray, " bins"]


class _Bins(NamedTuple):
    """Transforms of all pieces by ascending frequency, and the power of noise expected there."""

    omega: Float[np.ndarray, " bins"]
    motion: Complex[np.ndarray, " bins"]
    slope: Complex[np.ndarray, " bins"]
    """Of `motion` over the delay."""
    rate: Complex[np.ndarray, " bins"]
    second: Complex[np.ndarray, " bins"]
    """Of v's derivative."""
    zero: Complex[np.ndarray, "bins 2"]
    noise: Float[np.ndarray, " bins"]
    noise_of_motion: Float[np.ndarray, " bins"]
    energy: Float[np.ndarray, " bins"]
    """Of the taper."""
    lowest: Bool[np.ndarray, " bins"]
    levels: Float[np.ndarray, "3"]
    shared: float
    """Times by which variances grow as tapers tie neighbouring bins together."""


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
    pieces = [p for p in pieces if p.x.size >= SHORTEST_PIECE]
    if not pieces:
        return None
    levels, rough = _levels(pieces)
    levels = levels if known is None else known.levels
    afresh = start is None and known is None
    whole, theta, found = 0, np.array([0.0, 1.0, 0.0, 0.0]), None
    if start is not None:
        theta[:] = start.delay + start.lag, start.gain, start.offset, start.drift
    elif not lagged:
        whole = _whole_delay(pieces, rough)
    for iteration in range(steps):
        first = afresh and iteration < ROUGH
        if abs(theta[0]) > 1 and not lagged:
            whole, theta[0] = whole + round(theta[0]), theta[0] - round(theta[0])
        moved = [p for p in (_shifted(p, whole) for p in pieces) if p.x.size >= SHORTEST_PIECE]
        if not moved:
            return None
        expected = Left(rough, *EVEN) if first else known
        bins = _bins(moved, 0.0 if lagged else theta[0], count, rough if first else levels)
        stepped = _step(bins, theta, lagged, expected)
        if stepped is None:
            return None
        step, covariance, left, counted = stepped
        theta = theta + step
        errors = np.sqrt(np.diag(covariance) * bins.shared)
        gain, offset, drift = theta[1:].tolist()
        delay, lag = (0.0, float(theta[0])) if lagged else (whole + float(theta[0]), 0.0)
        found = PairFit(delay, lag, gain, offset, drift, errors, left, counted)
        if not first and np.all(np.abs(step) < 1e-3 * errors):
            break
    return found


def _levels(pieces: Sequence[Piece]) -> tuple[np.ndarray, np.ndarray]:
    """Noise of x, v and u, and what to begin with: of none, whatever is left is trusted."""
    every = [[one for p in pieces if (one := getattr(p, a)) is not None] for a in "xvu"]
    levels = np.array([np.median([noise_level(one) for one in some] or [0.0]) for some in every])
    sizes = [max((np.std(one) for one in some), default=0.0) for some in every]
    return levels, np.maximum(levels, ROUGHLY * np.array(sizes))


def _step(
    bins: _Bins, theta: np.ndarray, lagged: bool, known: Left | None
) -> tuple[np.ndarray, np.ndarray, Left, np.ndarray] | None:
    """One step of Gauss and Newton, its covariance, what is left, and whether a bin counts."""
    motion, rate, zero, slope = bins.motion, bins.rate, bins.zero, bins.slope
    if lagged and theta[0] >= 0:
        # v + T v' is what came in; divided by 1 + i omega T its noise stays what it was.
        pole = 1 / (1 + 1j * bins.omega * theta[0])
        rate, zero = pole * (rate + theta[0] * bins.second), pole[:, None] * zero
        motion, slope = pole * motion, pole**2 * slope
    elif lagged:
        motion = motion + theta[0] * slope
    error = rate - theta[1] * motion - zero @ theta[2:]
    left = np.abs(error) ** 2 / bins.noise
    smoothed = (
        _smoothed(bins.omega, left)
        if known is None
        else np.interp(bins.omega, known.omega, known.smoothed)
    )
    smoothed = np.maximum(smoothed, 1e-26 * np.max(np.abs(rate) ** 2 / bins.noise))
    power = _smoothed(bins.omega, np.abs(motion) ** 2 / bins.noise)
    counted = (power > CARRIED * smoothed) | bins.lowest
    # Real and imaginary part have half the power each; at frequency zero all of it is real.
    weight = np.where(counted, np.where(bins.omega > 0, 2, 1) / (smoothed * bins.noise), 0.0)
    columns = np.column_stack([theta[1] * slope, motion, zero])[counted]
    weighted = columns.conj().T * weight[counted]
    normal, right = np.real(weighted @ columns), np.real(weighted @ error[counted])
    # Of a signal without noise the level expected is that of its own curvature.
    of_noise = float(weight @ np.minimum(bins.noise_of_motion, smoothed * bins.noise))
    scale = np.sqrt(np.diag(normal))
    if not (np.isfinite(scale).all() and scale.all()) or of_noise > MOST_NOISE * normal[1, 1]:
        return None
    right[1] += theta[1] * of_noise
    normal[1, 1] -= of_noise
    covariance = np.linalg.pinv(normal / np.outer(scale, scale), 1e-12) / np.outer(scale, scale)
    step = covariance @ right
    # Phases are straight over an eighth of a turn of the usual frequency.
    usual = np.sqrt(normal[1, 1] / max(normal[0, 0], 1e-300)) * abs(theta[1])
    step[0] = np.clip(step[0], -0.8 * usual, 0.8 * usual)
    # The noise of the motion goes with the gain, and through the filter.
    size = (1 + (bins.omega * theta[0]) ** 2) ** -np.sign(theta[0]) if lagged else 1.0
    more = (size * theta[1] ** 2 - 1) * bins.noise_of_motion
    unlike = smoothed * bins.noise / bins.energy / (1 + more / bins.noise)
    found = Left(bins.levels, bins.omega, smoothed, left, unlike)
    return step, covariance, found, counted


def _shifted(piece: Piece, whole: int) -> Piece:
    """The same with v so many samples earlier."""
    start, x, v, u = piece
    size = max(x.size - abs(whole), 0)
    x, u = (None if one is None else one[max(-whole, 0) :][:size] for one in (x, u))
    assert x is not None
    return Piece(start + max(whole, 0), x, v[max(whole, 0) :][:size], u)


def _taper(n: int, shift: float) -> Float[np.ndarray, "3 n"]:
    """A taper `shift` samples on, its slope and its curvature: a step of degree 7 at either end."""
    edge = min(max(n // 8, 16), EDGE)
    at, last = np.arange(n) + shift - MARGIN, n - 1 - 2 * MARGIN
    u = np.clip(np.minimum(at, last - at) / edge, 0, 1)
    side = np.where(2 * at < last, 1, -1) / edge
    return np.array(
        [
            u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3),
            140 * u**3 * (1 - u) ** 3 * side,
            420 * u**2 * (1 - u) ** 2 * (1 - 2 * u) / edge**2,
        ]
    )


def _bins(pieces: Sequence[Piece], delay: float, count: int, levels: np.ndarray) -> _Bins:
    from scipy.fft import next_fast_len, rfft  # of records alone

    parts, total, squares, fourth = [], 0, 0.0, 0.0
    for start, x, v, u in pieces:
        size = int(next_fast_len(x.size, real=True) or x.size)
        omega = 2 * np.pi * np.arange(size // 2) / size
        (w, slope, _), course = _taper(x.size, 0.0), (start + np.arange(x.size)) / count - 0.5
        moved = _taper(x.size, delay)
        known = [] if u is None else list(moved[:2] * u)
        columns = np.array([*moved * x, w * v, slope * v, w, w * course, *known])
        transforms = np.asarray(rfft(columns, size))[:, : size // 2]
        whole, sloping, curved, rate, falling, zero, first, *known = transforms
        turned, i_omega = np.exp(-1j * omega * delay), 1j * omega
        motion, turning = i_omega * whole - sloping, i_omega * (i_omega * whole - 2 * sloping)
        if known:
            motion, turning = motion + known[0], turning + i_omega * known[0] - known[1]
        energy = np.sum(w**2)
        noise = levels[0] ** 2 * (omega**2 * energy + np.sum(slope**2)) + levels[2] ** 2 * energy
        parts.append(
            (
                omega,
                turned * motion,
                -turned * (turning + curved),
                rate,
                i_omega * rate - falling,
                np.transpose([zero, first]),
                noise + (levels[1] ** 2 + 1e-30) * energy,
                noise,
                np.full(omega.size, energy),
                np.arange(omega.size) < LOWEST_BINS,
            )
        )
        total, squares, fourth = total + size, squares + energy, fourth + np.sum(w**4)
    joined = [np.concatenate(columns) for columns in zip(*parts)]
    order = np.argsort(joined[0], kind="stable")
    shared = float(total * fourth / squares**2)
    return _Bins._make([*(column[order] for column in joined), levels, shared])


def _whole_delay(pieces: Sequence[Piece], levels: np.ndarray) -> int:
    """Samples by which the longest piece's v is late, from the peak of its correlation.

    0 where the correlation there is near the peak: what is so near needs no start nearer.
    """
    longest = max(pieces, key=lambda p: p.x.size)
    bins = _bins([longest], 0.0, longest.x.size, levels)
    correlation = np.fft.irfft(np.append(bins.rate * bins.motion.conj() / bins.noise, 0.0))
    reach = longest.x.size // 8
    lags = np.arange(-reach, reach + 1)
    penalised = correlation[lags] * (1 - np.abs(lags) / longest.x.size)
    best = int(lags[np.argmax(penalised)])
    return 0 if penalised[reach] > NEAR * np.max(penalised) else best


def apparent_gain(pieces: Sequence[Piece]) -> float:
    """Size of v over that of what it should be, with its sign, to begin with; 1 unless far off."""
    _, rough = _levels(pieces)
    bins = _bins(pieces, 0.0, pieces[0].x.size, rough)
    weight = np.where(bins.lowest, 0.0, 1 / bins.noise_of_motion)
    both = float(np.real(weight @ (bins.rate * bins.motion.conj())))
    motion, rate = (float(weight @ np.abs(one) ** 2) for one in (bins.motion, bins.rate))
    gain = both / motion
    far = both**2 > NEAR**2 * motion * rate and not 0.5 < gain < 2
    return gain if far else 1.0


def _smoothed(omega: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Mean over neighbours in frequency."""
    at = np.arange(omega.size)
    low = np.minimum(np.searchsorted(omega, omega / RATIO), at - NEIGHBOURS).clip(0)
    high = np.maximum(np.searchsorted(omega, omega * RATIO), at + NEIGHBOURS + 1).clip(
        max=omega.size
    )
    sums = np.concatenate([[0.0], np.cumsum(power)])
    return (sums[high] - sums[low]) / (high - low)

"""What is amiss between a signal and its recorded derivative, in time, size and zero.

A pair shows differences alone: whether v is late or x early, whether v has an offset or x drifts,
it cannot tell, nor what both have in common, as a delay of both against the force.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.records.faults.delay_course import SURE, Course, delay_course
from riecjax.records.faults.pair_fit import (
    SHORTEST_PIECE,
    PairFit,
    Piece,
    apparent_gain,
    fit_pair,
)
from riecjax.records.faults.relations import Relation
from riecjax.records.record import Record, samples_with_nan
from riecjax.records.remembered import remembered

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
UNLIKE = 4.0
"""Times the expected noise past which what is left is looked at part by part."""
FEWEST_CYCLES, CYCLES_OF_WINDOW = 1.0, 1.5
"""Of the motion, in a record and in a part of it: on less, offset, drift and delay are alike."""
WINDOWS, SHORTEST_WINDOW = 12, 250
"""Parts of the record whose delays are compared, and the fewest samples of one."""
MOST_SAMPLES, LONGEST_PIECE = 2**15, 2**13
"""Of a long record, samples that are looked at, in pieces evenly spread."""
SHORT_GAP = 5
"""Missing samples in a row that are filled in."""
SPIKE = 5.0
"""Times that a spike leaves the median of five samples further than its neighbours range."""
MOST_SPIKES = 0.05
"""Share of samples past which these are no spikes."""


class Pair(NamedTuple):
    """How a signal follows what it should be by a relation, the derivative of another at its
    simplest.

    **Fields:** `relation`; `suspect`, the one of its signals that alone explains best what is
    amiss; `fit` of it, or of the sum if it is the signal that is differentiated, in samples and
    units of the signal's `scale`; `lagged` where a low-pass describes it better than a delay;
    `course` of the delay; `rms` of the derivative, in the fit's unit; `step` of time in seconds;
    `alike`, signals that explain it hardly worse.
    """

    relation: Relation
    suspect: str
    fit: PairFit
    lagged: bool
    course: Course
    scale: float
    rms: float
    step: float
    alike: tuple[str, ...] = ()

    @property
    def signal(self) -> str:
        """What the derivative is of."""
        return self.relation.signal

    @property
    def derivative(self) -> str:
        """The suspect, or the sum, in words."""
        return self.relation.words(self.suspect)[0]

    @property
    def is_gross(self) -> bool:
        """Whether the gain is no calibration's."""
        return abs(self.fit.gain - 1) > GROSS

    @property
    def scaling(self) -> float:
        """What the suspect has to be multiplied by."""
        return self.fit.gain ** (1 if self.suspect == self.signal else -1)

    @property
    def zeroed(self) -> tuple[str, float]:
        """A signal whose offset would explain the fit's, and how many of it that is.

        The suspect if it is a term, else the last one.
        """
        factors = dict(self.relation.of)
        name = self.suspect if self.suspect in factors else self.relation.terms[-1]
        return name, factors.get(self.suspect, 1.0) / factors[name]

    @property
    def late(self) -> dict[str, float]:
        """Seconds by which each signal is later than the others, 0 unless surely and steadily."""
        mine, others = self.relation.side(self.suspect)
        return dict.fromkeys(others, 0.0) | dict.fromkeys(mine, self.delay)

    @property
    def delay(self) -> float:
        """Seconds by which the derivative is surely late and steadily so, else 0."""
        return self.fit.delay * self.step if self.is_late and not self.lagged else 0.0

    @property
    def _sure(self) -> float:
        """Standard errors that count: more where several may be wrong and none stands out."""
        several = len(self.alike) + 1 == len(self.relation.names) > 2
        return 2 * SURE if several else SURE

    @property
    def is_late(self) -> bool:
        """Whether the derivative is surely late, or early, or lags, throughout the record."""
        by, error = self.fit.delay + self.fit.lag, self.fit.errors[0]
        return self.course.kind == "steady" and abs(by) > max(LATE, self._sure * error)

    @property
    def gain_is_off(self) -> bool:
        """Whether the derivative's size is surely wrong."""
        return self.course.kind == "steady" and abs(self.fit.gain - 1) > max(
            GAIN, self._sure * self.fit.errors[1]
        )

    @property
    def offset(self) -> float:
        """Of the derivative, in its unit, 0 unless it surely matters."""
        sure = abs(self.fit.offset) > max(
            OFFSET * self.rms, TAILS * self._sure * self.fit.errors[2]
        )
        return self.fit.offset * self.scale / self.step if sure else 0.0

    @property
    def drift(self) -> float:
        """Of the derivative over the record, in its unit, 0 unless it surely matters."""
        sure = abs(self.fit.drift) > max(
            2 * OFFSET * self.rms, TAILS * self._sure * self.fit.errors[3]
        )
        return self.fit.drift * self.scale / self.step if sure else 0.0


def compare_pair(record: Record, signal: str, derivative: str) -> Pair | None:
    """Fit a recorded derivative to its signal; `None` if the record does not tell. Not under jit.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    return compare(record, Relation(signal, ((derivative, 1.0),)))


def _compared(record: Record, relation: Relation) -> tuple[Any, ...]:
    signals = (samples_with_nan(record, name) for name in relation.names)
    return relation, *signals, np.asarray(record.elapsed), float(record.time_step)


@remembered(32, _compared)
@np.errstate(all="ignore")
def compare(record: Record, relation: Relation) -> Pair | None:
    """The same of any relation: each of its signals is fitted to what the others say it should be.

    What is left tells which of them is wrong: with that one put right, nothing but noise.
    """
    x = samples_with_nan(record, relation.signal)
    terms = {name: samples_with_nan(record, name) for name in relation.terms}
    step, count = float(record.time_step), x.size
    if len(terms) > 1 and any(_is_rough(v) for v in terms.values()):
        return None
    centre = np.nanmedian(x) if not np.isnan(x).all() else 0.0
    scale = float(np.nanquantile(np.abs(x - centre), 0.9)) if np.isfinite(centre) else 0.0
    if not (np.isfinite(scale) and scale > 0):
        return None
    x, terms = (x - centre) / scale, {n: v / scale * step for n, v in terms.items()}
    breaks = _pauses(record)
    every = (_held(relation, name, x, terms, breaks) for name in relation.suspects)
    held = {one.suspect: one for one in every if one is not None}
    if not held:
        return None
    excess, alone = _excess(held, {name: one.fit for name, one in held.items()}), None
    suspect = min(excess, key=lambda name: excess[name])
    windows = min(WINDOWS, count // SHORTEST_WINDOW, int(held[suspect].cycles / CYCLES_OF_WINDOW))
    edges = np.linspace(0, count, windows + 1).astype(int).tolist() if windows > 1 else []
    if len(held) > 1:
        suspect, excess, alone = _suspected(held, edges, excess, breaks)
    one = held[suspect]
    course, spread = Course(), 1.0
    if edges:
        parts = one.parts(edges, breaks)
        course, spread = delay_course(parts, edges, count, one.fit, alone)
    fit, rms = one.fit._replace(errors=one.fit.errors * spread), one.rms * abs(one.size)
    alike = tuple(n for n, more in excess.items() if n != suspect and more < LIKELIER)
    pair = Pair(relation, suspect, one.sized(fit), False, course, scale, rms, step, alike)
    if pair.is_late and (lag := _low_pass(one.pieces, count, fit)) is not None:
        pair = pair._replace(fit=one.sized(lag), lagged=True)
    return pair


class _Held(NamedTuple):
    """A suspect against what the others say it should be.

    **Fields:** `columns`, x, v and u of the fit, v divided by the `size` it seems to have; `unit`
    of the fit in units of the sum; `rms` of the derivative of x and its `cycles`.
    """

    suspect: str
    columns: tuple[np.ndarray, np.ndarray, np.ndarray | None]
    size: float
    unit: float
    pieces: list[Piece]
    rms: float
    fit: PairFit

    @property
    def cycles(self) -> float:
        return self.rms * self.columns[0].size / (2 * np.pi)

    def parts(self, edges: Sequence[int], breaks: np.ndarray) -> list[list[Piece]]:
        """Pieces between the edges."""
        most = MOST_SAMPLES // (len(edges) - 1)
        ends = itertools.pairwise(edges)
        return [list(_pieces(*self.columns, a, b, breaks, most)) for a, b in ends]

    def sized(self, fit: PairFit) -> PairFit:
        """A fit of v as it is."""
        size, errors = self.size, fit.errors * [1, *np.full(3, abs(self.size))]
        gain, offset, drift = size * fit.gain, size * fit.offset, size * fit.drift
        return fit._replace(gain=gain, offset=offset, drift=drift, errors=errors)


def _held(
    relation: Relation,
    suspect: str,
    x: np.ndarray,
    terms: dict[str, np.ndarray],
    breaks: np.ndarray,
) -> _Held | None:
    factors, count, u, size = dict(relation.of), x.size, None, 1.0
    if suspect in terms:
        rest = [-c / factors[suspect] * terms[n] for n, c in relation.of if n != suspect]
        x, v, u = x / factors[suspect], terms[suspect], sum(rest[1:], rest[0]) if rest else None
    else:
        v = sum((c * terms[n] for n, c in relation.of), np.zeros(count))
    several = len(relation.suspects) > 1
    pieces = list(_pieces(x, v, u, 0, count, breaks, MOST_SAMPLES // (1 + several)))
    if several and pieces:
        size = apparent_gain(pieces)
        v, pieces = v / size, [p._replace(v=p.v / size) for p in pieces]
    every = [p.v if p.u is None else p.v - p.u for p in pieces]
    rms = float(np.sqrt(np.mean(np.concatenate(every) ** 2))) if every else 0.0
    if not FEWEST_CYCLES < rms * count / (2 * np.pi) < np.inf:
        return None
    fit = fit_pair(pieces, count)
    if fit is None or not np.isfinite(fit.errors).all():
        return None
    return _Held(suspect, (x, v, u), size, factors.get(suspect, size), pieces, rms, fit)


def _suspected(
    held: dict[str, _Held],
    edges: list[int],
    excess: dict[str, float],
    breaks: np.ndarray,
) -> tuple[str, dict[str, float], list[PairFit | None] | None]:
    """Which signal alone is wrong, by how much less likely others are, and fits of its parts.

    Where it matters, low-passes are looked at as well; and part by part, where a delay that does
    not change leaves more than noise.
    """
    count = next(iter(held.values())).columns[0].size
    best, alone = min(excess, key=lambda name: excess[name]), None
    if max(excess.values()) > LIKELIER:
        fits = {n: _low_pass(one.pieces, count, one.fit) or one.fit for n, one in held.items()}
        excess = _excess(held, fits)
        best = min(excess, key=lambda name: excess[name])
    if edges and np.mean(held[best].fit.left.smoothed) > UNLIKE:
        parts = {name: one.parts(edges, breaks) for name, one in held.items()}
        fits = {name: [fit_pair(part, count) for part in some] for name, some in parts.items()}
        told = [
            _excess(held, {n: f for n, f in zip(fits, each) if f is not None})
            for each in zip(*fits.values())
            if None not in each
        ]
        if told:
            sums = {name: sum(one[name] for one in told) for name in held}
            excess = {name: more - min(sums.values()) for name, more in sums.items()}
            best = min(excess, key=lambda name: excess[name])
            alone = fits[best]
    return best, excess, alone


def _excess(held: dict[str, _Held], fits: dict[str, PairFit]) -> dict[str, float]:
    """By how much less likely it is that each signal alone is wrong, in log-likelihood."""
    if len(fits) == 1:
        return dict.fromkeys(fits, 0.0)
    omega = next(iter(fits.values())).left.omega
    powers, counted = [], np.zeros(omega.size, bool)
    for name, fit in fits.items():
        powers.append(held[name].unit ** 2 * np.interp(omega, fit.left.omega, fit.left.unlike))
        counted |= np.interp(omega, fit.left.omega, fit.counted) > 0.5
    logs = np.sum(np.log(powers), axis=1, where=counted)
    return dict(zip(fits, (logs - logs.min()).tolist()))


def _is_rough(values: np.ndarray) -> bool:
    """Whether a signal is so fast that its integral depends on what it does between samples."""
    return bool(np.nanmean(np.diff(values) ** 2) > ROUGH * np.nanvar(values))


def _pauses(record: Record) -> Float[np.ndarray, " pauses"]:
    """Samples that follow a pause."""
    steps = np.diff(np.asarray(record.elapsed))
    return np.flatnonzero(steps > 1.5 * float(record.time_step)) + 1


def _pieces(
    x: np.ndarray,
    v: np.ndarray,
    u: np.ndarray | None,
    start: int,
    stop: int,
    breaks: np.ndarray,
    most: int,
) -> Iterator[Piece]:
    """Unbroken stretches of all, short gaps and spikes filled in; of many samples some."""
    ranges = [(start, stop)]
    if stop - start > most:
        size = min(LONGEST_PIECE, most)
        starts = np.linspace(start, stop - size, most // size).astype(int)
        ranges = [(first, first + size) for first in starts]
    for first, last in ranges:
        every = [_filled(column[first:last]) for column in (x, v, u) if column is not None]
        known = ~np.isnan(np.sum(every, axis=0))
        cuts = np.flatnonzero(np.diff(known)) + 1
        within = breaks[(breaks > first) & (breaks < last)] - first
        for piece in np.split(np.arange(last - first), np.union1d(cuts, within)):
            if piece.size >= SHORTEST_PIECE and known[piece[0]]:
                yield Piece(first + piece[0], *(column[piece] for column in every))


def _filled(values: np.ndarray) -> np.ndarray:
    """Spikes and short gaps replaced by local cubics."""
    found = values.copy()
    if values.size > 9:
        around = np.lib.stride_tricks.sliding_window_view(values, 9)
        off = np.abs(values[4:-4] - np.median(around[:, 2:7], axis=1))
        near = around[:, [0, 1, 2, 6, 7, 8]]
        spikes = np.flatnonzero(off > SPIKE * np.ptp(near, axis=1)) + 4
        if spikes.size <= MOST_SPIKES * values.size:
            found[spikes] = np.nan
    missing = np.isnan(found)
    if missing.any() and np.sum(~missing) > 4:
        from scipy.interpolate import Akima1DInterpolator  # half a second, which few records need

        at = np.arange(found.size)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]])))
        short = np.zeros(found.size, bool)
        for first, last in edges.reshape(-1, 2):
            short[first:last] = last - first <= SHORT_GAP
        found[short] = Akima1DInterpolator(at[~missing], found[~missing])(at[short])
    return found


def _low_pass(pieces: Sequence[Piece], count: int, delayed: PairFit) -> PairFit | None:
    """The fit of a low-pass, if it describes the pair better than a delay."""
    lag = fit_pair(pieces, count, lagged=True)
    if lag is None or not np.isfinite(lag.errors).all() or abs(lag.lag) < SURE * lag.errors[0]:
        return None
    # The likelihood of noise whose power is what is left. A filter makes less of that of terms.
    known = any(piece.u is not None for piece in pieces)
    power, counted = (
        np.interp(delayed.left.omega, lag.left.omega, column)
        for column in (lag.left.unlike if known else lag.left.smoothed, lag.counted)
    )
    both = delayed.counted & (counted > 0.5)
    left = delayed.left.unlike if known else delayed.left.smoothed
    return lag if np.sum(np.log(left / power)[both]) > LIKELIER else None

"""Sensors of one motion measure each other's noise.

Where v is the derivative of x, both recorded with noise, a rule of numerical differentiation

    sum_j s_j v[t + j] = sum_j e_j x[t + j] / h

holds for the motion up to an error far below that of any sensor, so that what the two sides differ
by is noise alone, of the spectrum |S|^2 var(v) + |E|^2 var(x) / h^2. The first part is flat and the
second rises with the square of the frequency, so that their sum tells both variances, however broad
the motion is. Low frequencies tell the derivative's noise, high ones the signal's. The same holds
for a position and its acceleration with the second difference, and for a sum of signals.

What differs by more than white noise (a sensor elsewhere, a filter, a drift) fits no such sum, and
then nothing is said.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from riecjax import tails
from riecjax.records.record import Record, runs
from riecjax.records.relations import Pairs, Relation, relations
from riecjax.records.signal import Taps

HALF = 2
"""Samples to each side in the sum over the derivative; the other one reaches a sample further."""
FEWEST, MOST = 2**8, 2**17
"""Samples of a stretch that tells anything, and that are looked at."""
SLOWEST = 8
"""Periods in the record from which a difference is no drift."""
FINEST = 0.5
"""Share of half the rate up to which the rule is exact enough: its error is 1e-3 of the motion, and
where that is more than `TOLERATED` of the residual's power, a band tells nothing."""
BANDS = 12
"""Of equal width on a logarithmic scale, over which spectra are averaged."""
BY_CHANCE, TOLERATED = 1e-4, 0.1
"""Probability by which white noise is taken for something else, and the share by which a band may
be off its fit in any case: noise is never quite white."""
APART = 0.1
"""Share by which the gains of two sides differ at most."""
LEAST = 1e-6
"""Share of a spectrum, and of what is best told, that is nothing."""
LITTLE = 30.0
"""Standard error, over itself, of a variance that is only limited."""
GUESSES, ROUNDS, HALVINGS = 4, 30, 10
"""Of gain and delay; steps of scoring at the most, and how often one is halved."""


class Residual(NamedTuple):
    """Spectrum of what a relation's two sides differ by, averaged over bands of frequencies.

    **Fields:** `power`; `gains`: signal to the power that noise of unit variance has there;
    `counts`, how many independent frequencies each band has.
    """

    power: Float[np.ndarray, " bands"]
    gains: Mapping[str, Float[np.ndarray, " bands"]]
    counts: Float[np.ndarray, " bands"]


class Variance(NamedTuple):
    """What is known of the variance of a signal's noise, and the standard error of that."""

    variance: float
    error: float


def variances(
    record: Record, pairs: Pairs, own: Mapping[str, Variance], given: Collection[str] = ()
) -> dict[str, Variance]:
    """The variance of the white noise of each signal that relations tell of.

    Not under jit.

    **Arguments:** `pairs` of a signal and its derivative, or relations; `own`, what signals seem to
    have by themselves, of which some are `given`. The others count as further measurements; where
    they are unsure to within their own size, noise is no larger. A relation that contradicts any of
    these tells nothing: signals of which one is computed from the other have their noise in common,
    and what is quick between samples is no noise.
    """
    known = {name: own[name] for name in given if name in own}
    free = {name: one for name, one in own.items() if one.variance > 0 and name not in known}
    sure = {name: one for name, one in free.items() if one.error < one.variance}
    limits = {name: 2 * one.variance for name, one in free.items() if name not in sure}
    found = (_residual(record, relation, order) for relation, order in _related(record, pairs))
    sound = [one for one in found if one is not None and _is_noise(one, known | sure, limits)]
    # What is only limited decides on no more than what a sum alone tells.
    little = {name: one._replace(error=LITTLE * one.variance) for name, one in free.items()}
    told = _fitted(sound, known, little | sure) if sound else {}
    for name, (variance, error) in told.items():
        if error >= variance:
            most = min(variance + 2 * error, own[name].variance)
            told[name] = Variance(most, most)
    return told


def _related(record: Record, pairs: Pairs) -> Iterator[tuple[Relation, int]]:
    """Relations between recorded signals, and the order of the derivative in each: the second of a
    position whose acceleration is recorded and whose velocity is not."""
    every, there = [*relations(pairs)], {*record.arrays}
    for relation in every:
        if {*relation.names} <= there:
            yield relation, 1
        elif relation.is_plain and relation.terms[0] in there:
            below = (r for r in every if r.is_plain and r.terms[0] == relation.signal)
            yield from ((relation._replace(signal=r.signal), 2) for r in below if r.signal in there)


def rule(order: int) -> tuple[Taps, Taps]:
    """Weights s of a derivative and e of its signal, at unit step, of the highest degree.

    That they agree for a power of time is a linear equation, as in compact (Padé) schemes.

    **Returns:** `2 HALF + 1` taps, the middle one 1, and `2 HALF + 3`.
    """
    inner, outer = np.arange(-HALF, HALF + 1.0), np.arange(-HALF - 1, HALF + 2.0)
    powers = np.arange(inner.size + outer.size - 1)[:, None]
    factors = np.prod([np.maximum(powers - k, 0) for k in range(order)], axis=0)
    derived = factors * inner ** np.maximum(powers - order, 0)
    columns = np.concatenate([np.delete(derived, HALF, axis=1), -(outer**powers)], axis=1)
    s, e = np.split(np.linalg.solve(columns, -derived[:, HALF]), [2 * HALF])
    return np.insert(s, HALF, 1.0), e


def _residual(record: Record, relation: Relation, order: int) -> Residual | None:
    """The spectrum of a relation's residual over the longest stretch without a gap; `None` of too
    few samples, or where there is no residual."""
    step, (s, e) = float(record.time_step), rule(order)
    signal = record.signal(relation.signal).with_nan
    total: Any = sum(c * record.signal(name).with_nan for name, c in relation.of)
    stretches = runs(~np.isnan(signal + total)).T.tolist()
    first, stop = max(stretches, key=lambda ends: ends[1] - ends[0], default=(0, 0))
    stop = min(stop, first + MOST)
    size = stop - first - e.size + 1
    if size < FEWEST:
        return None
    top = int(FINEST * size / 2)
    edges = np.geomspace(SLOWEST, top, BANDS + 1).astype(int)
    taper = np.hanning(size + 2)[1:-1]
    taper /= np.sqrt(np.mean(taper**2))

    def spectrum(values: np.ndarray, taps: Taps) -> Complex[np.ndarray, " frequencies"]:
        return np.fft.rfft(taper * np.convolve(values, taps[::-1], "valid")) / np.sqrt(size)

    def mean(values: np.ndarray) -> Any:
        return np.add.reduceat(values[:top], edges[:-1]) / np.diff(edges)

    responses = [
        np.fft.rfft(np.roll(np.pad(t, (0, size - t.size)), -(t.size // 2))) for t in (s, e)
    ]
    of_total, of_signal = (mean(np.abs(response) ** 2) for response in responses)
    of_signal /= step ** (2 * order)
    gains = {name: c**2 * of_total for name, c in relation.of} | {relation.signal: of_signal}
    derivative = spectrum(total[first + 1 : stop - 1], s)
    change = spectrum(signal[first:stop], e / step**order)
    # Gain and delay between the two sides are no noise. Their cross spectrum tells them, weighted
    # as noise leaves it, and of the derivative's own power what is noise counts for neither.
    angles = 2 * np.pi * np.arange(size // 2 + 1) / size
    cross = np.conj(derivative) * change
    both, ahead = mean(np.real(cross)), mean(angles * np.imag(cross))
    own, faster = mean(np.abs(derivative) ** 2), mean((angles * np.abs(derivative)) ** 2)
    squares = mean(angles**2)
    # Sums over later samples turn phases the other way.
    exact = responses[0] * (-1j * angles) ** order
    wrong = np.abs(responses[1] - exact) / np.maximum(np.abs(responses[1]), LEAST)
    by_rule = mean((wrong * np.abs(change)) ** 2)
    # Neighbouring frequencies behind a taper tell the same.
    counts, weight, noise = np.diff(edges) / np.mean(taper**4), 1 / of_signal, 0.0 * of_total
    residual, times, late = None, 1.0, 0.0
    for _ in range(GUESSES):
        share = counts * weight
        times = np.sum(share * both) / np.sum(share * (own - noise))
        late = np.sum(share * ahead) / np.sum(share * (faster - squares * noise))
        power = mean(np.abs(change - derivative * (times + 1j * late * angles)) ** 2)
        if not (np.isfinite(power).all() and np.any(power)):
            return None
        telling = by_rule < TOLERATED * power
        if np.sum(telling) < BANDS / 2:
            return None
        told_by = {name: gain[telling] for name, gain in gains.items()}
        residual = Residual(power[telling], told_by, counts[telling])
        told = _fitted([residual])
        noise = of_total * sum(c**2 * told[name].variance for name, c in relation.of)
        weight = 1 / (noise + of_signal * told[relation.signal].variance)
    return residual if abs(times - 1) <= APART and abs(late) <= 1 else None


def _is_noise(one: Residual, known: Mapping[str, Variance], most: Mapping[str, float]) -> bool:
    """Whether white noise on its signals, of which some is known and some has a `most`, explains a
    residual's spectrum band by band.

    The cube root of a mean of n powers over their expectation is nearly normal, of mean 1 - 1/(9 n)
    and variance 1/(9 n) (Wilson and Hilferty 1931, PNAS 17).
    """
    told = {**_fitted([one], known), **known}
    fit = sum(told[name].variance * gain for name, gain in one.gains.items())
    if any(told[n].variance - 2 * told[n].error > most.get(n, np.inf) for n in one.gains):
        return False
    scatter = 1 / (9 * one.counts)
    off = np.abs(np.cbrt(one.power / fit) - (1 - scatter)) - TOLERATED / 3
    squares = np.sum(np.maximum(off, 0) ** 2 / scatter)
    return bool(squares < tails.chi_square(BY_CHANCE, one.counts.size))


def _fitted(
    residuals: Sequence[Residual],
    known: Mapping[str, Variance] = {},
    own: Mapping[str, Variance] = {},
) -> dict[str, Variance]:
    """Variances with which white noise has the residuals' spectra, none below zero; see
    [`variances`][].

    Each mean of n powers over its expectation, and each variance of 2 n degrees of freedom that a
    signal seems to have, is a gamma variable; scoring finds the largest likelihood. Steps are
    halved until it grows: weights of the inverse squares of the fit may else go round in circles.
    """
    names = sorted({name for one in residuals for name in one.gains})
    free = [name for name in names if name not in known]
    if not free:
        return {}
    columns = {
        name: np.concatenate([one.gains.get(name, 0.0 * one.power) for one in residuals])
        for name in names
    }
    power = np.concatenate([one.power for one in residuals])
    given = sum((columns[n] * known[n].variance for n in names if n in known), 0.0 * power)
    # In units in which each alone would explain it all.
    units = np.array([np.median(power[c > 0] / c[c > 0]) for c in (columns[n] for n in free)])
    seeming = [(place, own[name]) for place, name in enumerate(free) if name in own]
    gains = np.concatenate(
        [
            units * np.stack([columns[name] for name in free], axis=1),
            np.eye(len(free))[[place for place, _ in seeming]],
        ]
    )
    power = np.append(power, [one.variance / units[place] for place, one in seeming])
    given = np.append(given, np.zeros(len(seeming)))
    errors = [max(one.error / one.variance, LEAST) for _, one in seeming]
    counts = np.concatenate([*(one.counts for one in residuals), 1 / np.square(errors)])

    def fit(values: np.ndarray) -> np.ndarray:
        return given + gains @ np.maximum(values, LEAST)

    def unlikely(values: np.ndarray) -> float:
        return float(np.sum(counts * (power / fit(values) + np.log(fit(values)))))

    values = np.ones(len(free))
    for _ in range(ROUNDS):
        weight = np.sqrt(counts) / fit(values)
        weighed, target = gains * weight[:, None], (power - given) * weight
        aim, kept = np.zeros(len(free)), np.ones(len(free), bool)
        while kept.any():
            aim[kept] = np.linalg.lstsq(weighed[:, kept], target, rcond=None)[0]
            if (aim >= 0).all():
                break
            kept, aim = kept & (aim > 0), np.zeros(len(free))
        steps = (values + share * (aim - values) for share in 0.5 ** np.arange(HALVINGS))
        if (better := next((v for v in steps if unlikely(v) < unlikely(values)), None)) is None:
            break
        values = better
    weighed = gains * (np.sqrt(counts) / fit(values))[:, None]
    information = weighed.T @ weighed
    size = np.sqrt(np.diagonal(information))
    inverse = np.linalg.pinv(information / np.outer(size, size), rcond=LEAST, hermitian=True)
    errors = units * np.sqrt(np.diagonal(inverse)) / size
    return {n: Variance(float(v), float(e)) for n, v, e in zip(free, values * units, errors)}

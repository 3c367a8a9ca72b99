"""Which columns belong: forward selection with exchange, and what of it chance does not explain.

Terms are added by what they gain on blocks of time that their coefficients were not fitted to,
whether or not the gain is sure: half of a law may say little before the other half is there. Each
time, those chosen before are exchanged for others, or left out, where that predicts as well. Then
terms are taken away again, the least sure first, until each of the rest

- is further from zero than chance makes any one of all that were offered, at the stated rate,
- makes up for `SHARE` of what is unexplained without it, noise included,
- and for `LEAST` of the whole, unless told otherwise.

How sure a choice of terms is: it is made again from blocks of time that are drawn again.

An interval of a parameter holds for a given structure. Which terms there are was read off the same
data, so that the usual interval of what stayed is too narrow, and says nothing of what nearly was
chosen. Drawing folds with replacement and searching again lets the choice vary as it would on other
recordings (Efron, 2014); a parameter's variance over these searches includes that of the choice.

Blocks of time of one Gram matrix of all columns, and what structures say of those left out.

With M the sums of products of target and columns over one fold and N what sensor noise adds to
them, C = M - N is that of the signals. A structure is a set of columns. Its coefficients come from
the sum of C over all folds but one, and are held against the one: v^T C v with v = (1, -theta) is
what it leaves unexplained of the motion there, v^T M v of the samples, noise included. No sample
is read, so that a structure costs one solve of p equations a fold.

Sums of a model and of all that it may lack, summed anew as widths come closer.

A law with a width stands in the sums for each of a few widths. Once one of them is chosen, they are
moved together around it, beside what else was chosen, until neighbours differ by a few parts in a
thousand. Widths are arrays, so that no sum is compiled anew.

A model with terms that it may lack.
"""

import itertools
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.discovery.candidate import AnyCandidate, Candidate, Shaped, renamed
from riecjax.equations.bases import DeadZone, Saturation
from riecjax.equations.memories import with_memories
from riecjax.equations.model import Model
from riecjax.equations.term import AbstractTerm
from riecjax.records.recording import Recording
from riecjax.summaries.normal_equations import NormalEquations, sum_of_equations
from riecjax.summaries.summarise import summarise
from riecjax.summaries.summary import Summary

FOLDS = 20
"""At most: more would make little difference to what is left out of each fit."""
COLLINEAR = 1e-6
"""Least eigenvalue of the columns' correlations, that of one column as many as there are."""


class Left(NamedTuple):
    """What a structure leaves of each fold that it was not fitted to.

    **Fields:** `motion`, of the signals less their noise; `samples`, noise included.
    """

    motion: Float[np.ndarray, " folds"]
    samples: Float[np.ndarray, " folds"]


class Folds(NamedTuple):
    """Moments of target and columns by folds of time.

    **Fields:** `samples`, and `motion`, the same less what noise adds, shape
    `(folds, 1 + p, 1 + p)`; `parameters`, names of the p columns.
    """

    samples: Float[np.ndarray, "folds columns columns"]
    motion: Float[np.ndarray, "folds columns columns"]
    parameters: tuple[str, ...]

    @classmethod
    def of(cls, equations: NormalEquations, most: int = FOLDS) -> "Folds":
        """Of normal equations with leading axes `(records, blocks)`, empty blocks left out."""
        size = len(equations.parameters) + 1
        moments = np.asarray(equations.moments, float).reshape(-1, size, size)
        clean = np.asarray(equations.clean, float).reshape(-1, size, size)
        used = np.flatnonzero(np.asarray(equations.count).ravel() > 0)
        count = min(most, used.size)
        place = np.arange(used.size) * count // max(used.size, 1)
        samples, motion = np.zeros((2, count, size, size))
        np.add.at(samples, place, moments[used])
        np.add.at(motion, place, clean[used])
        return cls(samples, motion, equations.parameters)

    @property
    def number(self) -> int:
        """Of folds."""
        return len(self.motion)

    @property
    def energy(self) -> float:
        """Of the target, all folds together."""
        return float(self.samples[:, 0, 0].sum())

    def drawn(self, index: Sequence[int] | np.ndarray) -> "Folds":
        """These folds instead: one that is drawn several times weighs as often, and is left out as
        a whole, since its copies would tell of it."""
        place, times = np.unique(index, return_counts=True)
        weights = times[:, None, None]
        return Folds(self.samples[place] * weights, self.motion[place] * weights, self.parameters)

    def columns(self, names: Sequence[str]) -> np.ndarray:
        """Places of columns, that of the target being 0."""
        return np.array([1 + self.parameters.index(name) for name in names], int)

    def told_apart(self, names: Sequence[str]) -> bool:
        """Whether columns are far enough from collinear to have a coefficient each."""
        at = self.columns(names)
        gram = self.motion.sum(0)[np.ix_(at, at)]
        size = np.diagonal(gram)
        if not np.all(np.isfinite(gram)) or not np.all(size > 0):
            return False
        scale = 1 / np.sqrt(size)
        return bool(np.linalg.eigvalsh(gram * np.outer(scale, scale))[0] > COLLINEAR)

    def fitted(self, names: Sequence[str]) -> Float[np.ndarray, " p"]:
        """Coefficients from all folds."""
        at = self.columns(names)
        total = self.motion.sum(0)
        return _solved(total[np.ix_(at, at)], total[at, 0])

    def left(self, names: Sequence[str]) -> Left:
        """What is unexplained of each fold by coefficients from all others."""
        at = np.concatenate([[0], self.columns(names)])
        motion, samples = (of[:, at[:, None], at] for of in (self.motion, self.samples))
        others = motion.sum(0) - motion
        theta = _solved(others[:, 1:, 1:], others[:, 1:, 0])
        v = np.concatenate([np.ones((self.number, 1)), -theta], axis=1)
        return Left(*(np.einsum("fi,fij,fj->f", v, of, v) for of in (motion, samples)))

    def chance(self, names: Sequence[str], column: str) -> float:
        """Probability that a column of a structure that explains nothing is as far from zero.

        By Student's t of its coefficient. With s_f the score of what is the column's own, all
        others fitted, and g_f its energy in fold f, the coefficient's variance is `sum s^2 / (sum
        g)^2`, whatever errors are like in each fold. Where a few folds have most of the energy
        that has few degrees of freedom, and `mean(s^2 / g) / sum g`, which holds where errors are
        alike all along, has one a fold. The larger of both is taken.
        """
        at = self.columns(names)
        gram, moment = self.motion[:, at[:, None], at], self.motion[:, at, 0]
        inverse = np.linalg.pinv(gram.sum(0), hermitian=True)
        own = list(names).index(column)
        theta = inverse @ moment.sum(0)
        alone = inverse[:, own] / inverse[own, own]
        scores = (moment - gram @ theta) @ alone
        energy = np.einsum("i,fij,j->f", alone, gram, alone)
        total, freedom = float(energy.sum()), self.number - 1
        some = energy > 1e-6 * total
        if not total > 0 or freedom < 1 or not some.any():
            return 1.0
        apart = np.sum(scores**2) / total**2
        alike = np.mean(scores[some] ** 2 / energy[some]) / total
        error = np.sqrt(max(apart, alike) * self.number / freedom)
        away = abs(theta[own]) / error if error > 0 else np.inf
        return float(2 * scipy.stats.t.sf(away, freedom))


def _solved(
    gram: Float[np.ndarray, "*folds p p"], moment: Float[np.ndarray, "*folds p"]
) -> Float[np.ndarray, "*folds p"]:
    """Least squares of columns that are scaled to unit length."""
    size = np.sqrt(np.abs(np.diagonal(gram, axis1=-2, axis2=-1)))
    scale = 1 / np.where(size > 0, size, 1.0)
    scaled = gram * scale[..., :, None] * scale[..., None, :]
    try:
        found = np.linalg.solve(scaled, (moment * scale)[..., None])[..., 0]
    except np.linalg.LinAlgError:
        found = (np.linalg.pinv(scaled) @ (moment * scale)[..., None])[..., 0]
    return found * scale


RATE = 0.05
"""Of searches that add anything where there is nothing to add."""
SHARE = 0.01
"""Of what is unexplained: less is not worth a term, and within reach of what sums leave undone."""
LEAST = 2e-5
"""Of the target's energy, 0.4 % of its size: of exact data, less is within reach of what sampling,
integration and sensors do, and each of the many small things that a machine does is worth a term.
"""
MOST = 12
"""Terms that are added at most."""


class Offer(NamedTuple):
    """Columns that enter together. Of one `family` a structure takes one: they are one law with
    other widths, of which they have that of this `number`; `None` without a width."""

    name: str
    columns: tuple[str, ...]
    family: str
    number: int | None = None

    @property
    def simple(self) -> bool:
        """Whether they have no width."""
        return self.number is None


class Step(NamedTuple):
    """One line of the path.

    **Fields:** `added`; `unexplained`, share of the target's energy in blocks left out, and
    `of_motion`, what of it noise does not explain; `std_error` of its difference to the line
    before; `chance` that a term that explains nothing stands out as much, any one of those offered.
    """

    added: str
    unexplained: float
    of_motion: float
    std_error: float
    chance: float


class Search:
    """A search for the columns that belong beside those that are kept.

    `trials`, how many offers there were to choose from, where these are some of them; `least`,
    share of what is unexplained that a term must make up for; `smallest`, share of the whole.
    """

    def __init__(
        self,
        folds: Folds,
        kept: Sequence[str],
        offers: Sequence[Offer],
        trials: int | None = None,
        least: float = SHARE,
        smallest: float = LEAST,
    ):
        self.folds, self.kept = folds, tuple(kept)
        self.every = tuple(offers)
        self.offers = [one for one in offers if folds.told_apart(self._names([one]))]
        self.least, self.smallest = least, smallest
        self._trials = max(len(self.offers) if trials is None else trials, 1)
        self._known: dict[frozenset[str], Left | None] = {}

    def _names(self, chosen: Sequence[Offer]) -> tuple[str, ...]:
        return (*self.kept, *(column for offer in chosen for column in offer.columns))

    def left(self, chosen: Sequence[Offer]) -> Left | None:
        """What offers leave of each fold; `None` where they cannot be told apart."""
        key = frozenset(offer.name for offer in chosen)
        if key not in self._known:
            names = self._names(chosen)
            good = not chosen or self.folds.told_apart(names)
            self._known[key] = self.folds.left(names) if good else None
        return self._known[key]

    def unexplained(self, chosen: Sequence[Offer]) -> float:
        """What offers leave of the motion, infinite where they cannot be told apart."""
        left = self.left(chosen)
        return float("inf") if left is None else float(left.motion.sum())

    def chance(self, chosen: Sequence[Offer], one: Offer) -> float:
        """That an offer which explains nothing stands out as much, any one of all."""
        names = self._names(chosen)
        each = min(self.folds.chance(names, column) for column in one.columns)
        return min(each * len(one.columns) * self._trials, 1.0)

    def found(self) -> list[Offer]:
        """The offers that belong."""
        chosen: list[Offer] = []
        seen = {frozenset[str]()}
        while len(chosen) < MOST and (grown := self._grown(chosen)) is not None:
            settled = self._settled(grown)
            # What is added and taken away again would be added for ever.
            if (names := frozenset(one.name for one in settled)) in seen:
                break
            seen.add(names)
            chosen = settled
        found = self._pruned(chosen)
        # What gained most may have been left to chance, and hidden what is sure and gains less.
        while (grown := self._grown(found, sure=True)) is not None:
            more = self._pruned(self._settled(grown))
            if len(more) <= len(found):
                break
            found = more
        return found

    def _free(self, chosen: Sequence[Offer]) -> Iterator[Offer]:
        families = {offer.family for offer in chosen}
        return (offer for offer in self.offers if offer.family not in families)

    def _grown(self, chosen: list[Offer], sure: bool = False) -> list[Offer] | None:
        """With what gains most, if that is worth a term; of what chance does not explain, if it is
        to be `sure`."""
        before, best, most = self.left(chosen), None, 0.0
        for offer in self._free(chosen):
            after = self.left([*chosen, offer])
            gain = self._gain(before, after)
            if not gain > most:
                continue
            if not sure or (
                self._is_worth(before, after) and self.chance([*chosen, offer], offer) < RATE
            ):
                best, most = offer, gain
        if best is None:
            return None
        grown = self._simpler([*chosen, best])
        return grown if self._is_worth(before, self.left(grown)) else None

    def _simpler(self, chosen: list[Offer]) -> list[Offer]:
        """With a law without a width instead of the last one, where it predicts about as well and
        is as sure."""
        *rest, last = chosen
        if last.simple:
            return chosen
        now, is_doubtful = self.left(chosen), self.chance(chosen, last) >= RATE
        alike = [
            (left.motion.sum(), i)
            for i, one in enumerate(self.offers)
            if one.simple
            and one not in rest
            and (left := self.left([*rest, one])) is not None
            and not self._is_worth(left, now)
            and (is_doubtful or self.chance([*rest, one], one) < RATE)
        ]
        return [*rest, self.offers[min(alike)[1]]] if alike else chosen

    def _gain(self, before: Left | None, after: Left | None) -> float:
        """What more is explained of the motion: a term's own noise is no fault of it."""
        if before is None or after is None:
            return -np.inf
        return float(before.motion.sum() - after.motion.sum())

    def _is_worth(self, before: Left | None, after: Left | None) -> bool:
        if before is None:
            return True
        if after is None:
            return False
        gain = self._gain(before, after)
        return gain > max(self.least * before.samples.sum(), self.smallest * self.folds.energy)

    def _settled(self, chosen: list[Offer]) -> list[Offer]:
        """Without what is worth no term beside the rest, and others where these predict better."""
        for _ in range(MOST):
            if (other := self._better(chosen)) is None:
                break
            chosen = other
        return chosen

    def _better(self, chosen: list[Offer]) -> list[Offer] | None:
        now = self.left(chosen)
        for offer in chosen:
            rest = [one for one in chosen if one is not offer]
            if not self._is_worth(self.left(rest), now):
                return rest
        # Of two terms the one law that says the same: a spring and what it lacks within a gap.
        for pair in itertools.combinations(chosen, 2):
            rest = [one for one in chosen if one not in pair]
            for other in self._free(rest):
                fewer = [*rest, other]
                if other not in pair and not self._is_worth(self.left(fewer), now):
                    return fewer
        for offer in chosen:
            rest = [one for one in chosen if one is not offer]
            simpler = self._simpler([*rest, offer])
            if not offer.simple and simpler[-1] is not offer:
                return simpler
        best, most = None, 0.0
        for offer in chosen:
            rest = [one for one in chosen if one is not offer]
            for other in self._free(rest):
                changed = [*rest, other]
                gain = self._gain(now, self.left(changed))
                if other is not offer and gain > most and self._is_worth(now, self.left(changed)):
                    best, most = changed, gain
        return best

    def _pruned(self, chosen: list[Offer]) -> list[Offer]:
        while chosen:
            chances = [self.chance(chosen, offer) for offer in chosen]
            doubtful = int(np.argmax(chances))
            if chances[doubtful] < RATE:
                break
            chosen = [one for i, one in enumerate(chosen) if i != doubtful]
            chosen = self._settled(chosen)
        return chosen

    def path(self, chosen: Sequence[Offer]) -> list[Step]:
        """What is left without any, and with one more at a time, what gains most first."""
        energy = self.folds.energy or 1.0
        before = self.left([])
        assert before is not None
        steps = [self._step("", before, before, energy, 0.0)]
        added: list[Offer] = []
        waiting = list(chosen)
        while waiting:
            after = [(one, self.left([*added, one])) for one in waiting]
            sure = [(one, left) for one, left in after if left is not None]
            if not sure:
                break
            one, left = min(sure, key=lambda pair: pair[1].motion.sum())
            chance = self.chance(chosen, one)
            steps.append(self._step(one.family, before, left, energy, chance))
            added.append(one)
            waiting.remove(one)
            before = left
        return steps

    def _step(self, name: str, before: Left, left: Left, energy: float, chance: float) -> Step:
        gain = before.samples - left.samples
        error = np.sqrt(gain.size) * np.std(gain, ddof=1) if gain.size > 1 else np.nan
        whole, of_motion = (float(of.sum() / energy) for of in (left.samples, left.motion))
        return Step(name, whole, of_motion, float(error / energy), chance)

    def next_best(self, chosen: Sequence[Offer], most: int = 5) -> list[tuple[Offer, float, float]]:
        """Offers that were not taken: share that each would gain, and by what chance."""
        before = self.left(chosen)
        if before is None:
            return []
        found = []
        for offer in self._free(chosen):
            after = self.left([*chosen, offer])
            if after is None:
                continue
            gain = self._gain(before, after) / before.samples.sum()
            if gain > 0:
                found.append((offer, float(gain), self.chance([*chosen, offer], offer)))
        return sorted(found, key=lambda one: -one[1])[:most]


AGAIN = 40
"""Searches."""
AMONG = 40
"""Offers at most that are searched again: those that leave least, alone or beside the chosen."""


class Again(NamedTuple):
    """What searches of folds that were drawn again found.

    **Fields:** `shares` of the searches that chose each family; `errors`, the standard deviation of
    each parameter over those that hold it.
    """

    shares: dict[str, float]
    errors: dict[str, float]


def again(search: Search, chosen: Sequence[Offer], seed: int, times: int = AGAIN) -> Again:
    """Search again from folds drawn with replacement."""
    rng = np.random.default_rng(seed)
    folds = search.folds
    among = _among(search, chosen)
    trials = len(search.offers)
    families: Counter[str] = Counter()
    values: dict[tuple[str, int], list[float]] = {}
    # Of a law the same coefficient, whatever its width.
    place_of = {
        name: (offer.family, i) for offer in search.every for i, name in enumerate(offer.columns)
    }
    for _ in range(times):
        drawn = folds.drawn(rng.integers(folds.number, size=folds.number))
        one = Search(drawn, search.kept, among, trials, search.least, search.smallest)
        found = one.found()
        families.update(offer.family for offer in found)
        names = (*search.kept, *(name for offer in found for name in offer.columns))
        for name, value in zip(names, drawn.fitted(names)):
            values.setdefault(place_of.get(name, (name, 0)), []).append(float(value))
    errors = {place: float(np.std(each)) for place, each in values.items() if len(each) > 1}
    kept = (*search.kept, *(name for offer in chosen for name in offer.columns))
    held = {name: errors.get(place_of.get(name, (name, 0)), np.nan) for name in kept}
    shares = {offer.family: families[offer.family] / times for offer in chosen} if times else {}
    return Again(shares, held)


def _among(search: Search, chosen: Sequence[Offer]) -> list[Offer]:
    """The offers that come into question, those that were chosen first."""
    if len(search.offers) <= AMONG:
        return search.offers
    others = [one for one in search.offers if one not in chosen]

    def rank(beside: Sequence[Offer]) -> dict[str, int]:
        sizes = {one.name: search.unexplained([*beside, one]) for one in others}
        return {name: i for i, name in enumerate(sorted(sizes, key=lambda n: sizes[n]))}

    first, second = rank([]), rank(chosen)
    others.sort(key=lambda one: min(first[one.name], second[one.name]))
    return [*chosen, *others[: AMONG - len(chosen)]]


def by_equation(
    model: Model, candidates: Iterable[Candidate]
) -> Mapping[str, Sequence[AbstractTerm]]:
    """The terms of candidates by the equation that each is for, the first one by default."""
    first = model.equation_names[0][0]
    found: dict[str, list[AbstractTerm]] = {}
    for one in candidates:
        found.setdefault(one.equation or first, []).extend(one.terms)
    return found


def extended(model: Model, candidates: Iterable[Candidate]) -> Model:
    """The same equations with the terms of candidates.

    **Raises:** `ModelError` as [`Model.with_terms`][].
    """
    return model.with_terms(by_equation(model, candidates))


def members(candidates: Iterable[AnyCandidate]) -> list[Candidate]:
    """Candidates as they are summed: of a law with a width one for each width."""
    return [
        each
        for one in candidates
        for each in (map(one.at, range(one.widths.size)) if isinstance(one, Shaped) else [one])
    ]


def without_twins(
    candidates: Sequence[AnyCandidate], model: Model, chosen: Container[str] = ()
) -> list[AnyCandidate]:
    """Candidates without what saturates where a line or a dead zone of the same signal is.

    A line is what saturates at a width, and what is beyond it. Of two of these the third is a sum,
    and one law would have three names: it is written as a line and what is beyond.

    **Arguments:** `chosen`, names of those candidates that are in the equations too.
    """
    names = [name for stage in model.equation_names for name in stage]
    own = zip(names, (equation.terms for equation in model.equations), strict=True)
    there = [(name, term) for name, terms in own for term in terms]
    offered = [(one, (one.equation or names[0], members([one])[0].terms[0])) for one in candidates]
    beyond = {_signal(pair) for _, pair in offered if isinstance(pair[1].basis, DeadZone)}
    there += [pair for one, pair in offered if one.name in chosen]
    straight = {
        _signal((name, term))
        for name, term in there
        if isinstance(term.basis, DeadZone) or (term.is_linear and not term.derivative)
    }
    return [
        one
        for one, pair in offered
        if not (isinstance(pair[1].basis, Saturation) and _signal(pair) in straight & beyond)
    ]


def _signal(place: tuple[str, AbstractTerm]) -> tuple[str, object]:
    """Of which equation and of what a term is."""
    equation, term = place
    return equation, term.of


def without_taken(
    candidates: Iterable[AnyCandidate], parameters: Sequence[str]
) -> list[AnyCandidate]:
    """Candidates whose coefficient the model has one of that name of: under another name."""
    found: list[AnyCandidate] = []
    for one in candidates:
        columns = {name for each in members([one]) for name in each.columns}
        found.append(renamed(one, f"{one.name}_2") if columns & {*parameters} else one)
    return found


CLOSER = 10
"""Times at most that widths are moved together; each divides what lies between by 2.5."""
ALIKE = 0.1
"""Part of the least share of what is unexplained, that neighbouring widths differ by in the end."""
SEVERAL = 4
"""Laws with widths that are looked into, one after the other."""


@dataclass
class Sums:
    """Sums of a model's equations with candidates.

    **Fields:** `candidates`, whose widths change; `known`, coefficients that are held; `least`
    and `smallest` as of a [`Search`][riecjax.discovery.search.Search].
    """

    model: Model
    recordings: list[Recording]
    criterion: AbstractCriterion
    candidates: list[AnyCandidate]
    known: Mapping[str, float]
    least: float = SHARE
    smallest: float = LEAST
    summary: Summary = field(init=False)

    def __post_init__(self):
        self.sum_up()

    def sum_up(self) -> None:
        """Read the recordings and sum them up, for the widths as they are."""
        every = members(self.candidates)
        memories = [memory for one in every for memory in one.memories]
        # What is known of noise was judged before, and widths must not change it.
        carrying = [
            replace(one, record=with_memories(one.record, memories)) for one in self.recordings
        ]
        self.summary = summarise(extended(self.model, every), carrying, self.criterion)

    def search(self, stage: int, found: Mapping[str, float]) -> Search:
        """A search of one stage, as the sums are now, what earlier ones found being known."""
        equations = self.summary.equations()[stage]
        names = tuple(dict.fromkeys(name for e in equations for name in e.parameters))
        folds = Folds.of(sum_of_equations(equations, names).fix({**self.known, **found}))
        # What may be chosen: of a law with a width, one for each.
        offered = [
            Offer(each.name, each.columns, one.name, i if isinstance(one, Shaped) else None)
            for one in self.candidates
            for i, each in enumerate(members([one]))
            if {*each.columns} <= {*folds.parameters}
        ]
        columns = {name for offer in offered for name in offer.columns}
        kept = [name for name in folds.parameters if name not in columns]
        return Search(folds, kept, offered, least=self.least, smallest=self.smallest)

    def candidate(self, family: str) -> AnyCandidate:
        """The candidate of this name, with the widths that are summed."""
        return next(one for one in self.candidates if one.name == family)

    def shape(self, family: str) -> Shaped:
        """The same of a law with a width."""
        one = self.candidate(family)
        assert isinstance(one, Shaped)
        return one

    def settled(self, stage: int, found: Mapping[str, float]) -> tuple[Search, list[Offer]]:
        """What belongs to one stage, with widths as near as samples tell them."""
        near: set[str] = set()
        while True:
            search = self.search(stage, found)
            chosen = search.found()
            rough = [one for one in chosen if not one.simple and one.family not in near]
            if not rough or len(near) >= SEVERAL:
                families = {one.family for one in chosen}
                fewer = without_twins(self.candidates, self.model, families)
                if len(fewer) == len(self.candidates):
                    return search, chosen
                self.candidates = fewer
                self.sum_up()
                continue

            without = [search.unexplained([o for o in chosen if o is not one]) for one in rough]
            strongest = rough[int(np.argmax(without))]
            beside = [one for one in chosen if one not in rough]
            # Of laws with a memory all of the same signal: rough widths tell none from the others.
            law = self.shape(strongest.family)
            families = [strongest.family]
            if law.remember is not None:
                shapes = [each for each in self.candidates if isinstance(each, Shaped)]
                families = [s.name for s in shapes if s.remember is not None and s.of == law.of]
            for family in families:
                self.narrow(stage, found, family, beside)
                near.add(family)

    def narrow(
        self, stage: int, found: Mapping[str, float], family: str, beside: Sequence[Offer]
    ) -> None:
        """Move the widths of a law to where it leaves least."""
        for _ in range(CLOSER):
            search = self.search(stage, found)
            each = [[*beside, offer] for offer in search.every if offer.family == family]
            left = np.array([search.unexplained(chosen) for chosen in each])
            best = int(np.argmin(left))
            if (at_best := search.left(each[best])) is None:
                return
            near = left[max(best - 1, 0) : best + 2] - left[best]
            if np.all(near < ALIKE * self.least * at_best.samples.sum()):
                return
            closer = self.shape(family).closer(best)
            self.candidates = [closer if one.name == family else one for one in self.candidates]
            self.sum_up()

    def width_error(self, search: Search, chosen: Sequence[Offer], one: Offer) -> float:
        """Standard error of a law's width; nan where it lies at the end of what was tried.

        The width makes the sum over folds of what is unexplained least: with L_f' its slope in fold
        f, the variance is sum L_f'^2 / (sum L_f'')^2 (Huber's sandwich), slopes by differences.
        """
        if (number := one.number) is None:
            return float("nan")
        widths = self.shape(one.family).widths
        beside = [other for other in chosen if other is not one]
        near = {o.number: o for o in search.every if o.family == one.family}
        each = [[*beside, near[i]] for i in range(widths.size)]
        # Of widths that leave alike the one that was chosen may stand at an end, and not the least.
        if not 0 < number < widths.size - 1:
            number = int(np.argmin([search.unexplained(chosen) for chosen in each]))
        # At an end there are fewer.
        left = map(search.left, each[max(number - 1, 0) : number + 2])
        three = [each.motion for each in left if each is not None]
        if len(three) < 3:
            return float("nan")
        below, at, above = three
        low, high = widths[number] - widths[number - 1], widths[number + 1] - widths[number]
        # Of a parabola through three points, wherever its least is.
        slopes = ((above - at) * low / high + (at - below) * high / low) / (low + high)
        bend = 2 * np.sum((above - at) / high - (at - below) / low) / (low + high)
        return float(np.sqrt(np.sum(slopes**2)) / bend) if bend > 0 else float("nan")

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

A law with a width stands in the sums for each of a few widths. Once one of them is chosen, they are
moved together around it, beside what else was chosen, until neighbours differ by a few parts in a
thousand. Widths are arrays, so that no sum is compiled anew.
"""

import itertools
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.discovery.candidate import AnyCandidate, Candidate, Shaped, members
from riecjax.equations.bases import DeadZone, Saturation
from riecjax.equations.model import Model
from riecjax.equations.term import AbstractTerm
from riecjax.errors import DataError
from riecjax.folds import Folds, Left
from riecjax.records.recording import Recording
from riecjax.settings import Discover
from riecjax.summaries.normal_equations import sum_of_equations
from riecjax.summaries.summarise import summarise
from riecjax.uncertainty.intervals import AbstractIntervals

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


@dataclass(frozen=True)
class Rejected:
    """A candidate that was not taken: share of what is unexplained that it would gain, and the
    chance that one which explains nothing stands out as much, any one of those offered."""

    name: str
    gain: float
    chance: float | None


@dataclass(eq=False)
class Search:
    """A search for the columns that belong beside those that are kept.

    Columns of a candidate enter together. Of a law with a width a structure takes one.

    **Fields:** `folds`; names of the columns that are `kept`; `every` candidate; `least`, share of
    what is unexplained that a term must make up for; `smallest`, share of the whole.
    """

    folds: Folds
    kept: tuple[str, ...]
    every: Sequence[Candidate]
    least: float = SHARE
    smallest: float = LEAST

    def __post_init__(self):
        self._alone = self.folds.left(self.kept)
        self._offer(self.every)
        # What repeats the columns that are kept cannot be told apart from these.
        apart = np.isfinite(self.beside([[]])[0].motion[:-1, 0])
        self._offer(list(itertools.compress(self.every, apart)))

    def _offer(self, offers: Sequence[Candidate]):
        self.offers, self._beside = offers, dict[frozenset[str], Left]()
        self._at = {offer.name: number for number, offer in enumerate(offers)}
        self._families = np.array([offer.family for offer in offers], object)
        # Places of each one's columns, and of none in the last row, filled up with zeros.
        rows = itertools.zip_longest(*(self.folds.columns(o.columns) for o in offers), fillvalue=0)
        places = np.array([*rows], int).reshape(-1, len(offers))
        self._places = np.pad(places.T, ((0, 1), (0, 0)))

    def names(self, chosen: Sequence[Candidate]) -> tuple[str, ...]:
        """Of the columns that are kept and those of candidates."""
        return (*self.kept, *(column for offer in chosen for column in offer.columns))

    def beside(self, structures: Sequence[Sequence[Candidate]]) -> list[Left]:
        """What each structure leaves with one offer more, and in the last row with none."""
        keys = [frozenset(offer.name for offer in chosen) for chosen in structures]
        new = {key: chosen for key, chosen in zip(keys, structures) if key not in self._beside}
        if new:
            named = [self.names(chosen) for chosen in new.values()]
            every = tuple(dict.fromkeys(itertools.chain(*named)))
            there = np.array([[name in names for name in every] for names in named], bool)
            left = self.folds.left_with(self.folds.columns(every), there, self._places)
            self._beside |= {key: Left(*each) for key, *each in zip(new, *left)}
        return [self._beside[key] for key in keys]

    def left(self, chosen: Sequence[Candidate]) -> Left:
        """What candidates leave of each fold; infinite where they cannot be told apart."""
        if not chosen:
            return self._alone
        key = frozenset(offer.name for offer in chosen)
        for name in key & self._at.keys() if key not in self._beside else ():
            if (known := self._beside.get(key - {name})) is not None:
                return known.of(self._at[name])
        return self.beside([chosen])[0].of(-1)

    def unexplained(self, chosen: Sequence[Candidate]) -> float:
        """What candidates leave of the motion."""
        return float(self.left(chosen).motion.sum())

    def chance(self, chosen: Sequence[Candidate], offer: Candidate) -> float:
        """That a candidate which explains nothing stands out as much, any one of all."""
        names = self.names(chosen)
        each = min(self.folds.told(names, column).chance for column in offer.columns)
        return min(each * len(offer.columns) * max(len(self.offers), 1), 1.0)

    def found(self) -> list[Candidate]:
        """The candidates that belong."""
        chosen: list[Candidate] = []
        seen = {frozenset[str]()}
        while len(chosen) < MOST and (grown := self._grown(chosen)) is not None:
            settled = self._settled(grown)
            # What is added and taken away again would be added for ever.
            if (names := frozenset(offer.name for offer in settled)) in seen:
                break
            seen.add(names)
            chosen = settled
        return self._pruned(chosen)

    def _further(
        self, structures: Sequence[list[Candidate]]
    ) -> tuple[Left, Bool[np.ndarray, "structures offers"]]:
        """What structures leave with one offer more, and which ones are of no law that is there."""
        tables = self.beside(structures)
        left = Left(*(np.stack(part)[:, :-1] for part in zip(*tables)))
        families = [[offer.family for offer in chosen] for chosen in structures]
        return left, np.stack([~np.isin(self._families, there) for there in families])

    def _least_first(self, left: Left, may: Bool[np.ndarray, "structures offers"]) -> np.ndarray:
        """Places of those that may join, by what is left of the motion; by their order where that
        is the same to rounding."""
        places = np.argwhere(may)
        shares = left.motion.sum(-1)[may] / (self.folds.energy or 1.0)
        return places[np.argsort(np.round(shares, 12), kind="stable")]

    def _grown(self, chosen: list[Candidate]) -> list[Candidate] | None:
        """With what gains most, if that is worth a term."""
        before = self.left(chosen)
        left, may = self._further([chosen])
        may &= left.motion.sum(-1) < before.motion.sum()
        for _, number in self._least_first(left, may)[:1]:
            grown = self._simpler([*chosen, self.offers[number]])
            return grown if self._is_worth(before, self.left(grown)) else None
        return None

    def _simpler(self, chosen: list[Candidate]) -> list[Candidate]:
        """With a law without a width instead of the last one, where it predicts about as well."""
        *rest, last = chosen
        if last.law is None:
            return chosen
        left, may = self._further([rest])
        may &= ~self._is_worth(left, self.left(chosen))
        may &= [offer.law is None for offer in self.offers]
        for _, number in self._least_first(left, may)[:1]:
            return [*rest, self.offers[number]]
        return chosen

    def _is_worth(self, before: Left, after: Left) -> Any:
        """Whether terms explain enough more of the motion: their own noise is no fault of them."""
        with np.errstate(invalid="ignore"):
            gain = before.motion.sum(-1) - after.motion.sum(-1)
        return gain > np.maximum(
            self.least * before.samples.sum(-1), self.smallest * self.folds.energy
        )

    def _settled(self, chosen: list[Candidate]) -> list[Candidate]:
        """Without what is worth no term beside the rest, and others where these predict better."""
        for _ in range(MOST):
            if (other := self._better(chosen)) is None:
                break
            chosen = other
        return chosen

    def _better(self, chosen: list[Candidate]) -> list[Candidate] | None:
        if not chosen:
            return None
        now = self.left(chosen)
        rests = [[other for other in chosen if other is not offer] for offer in chosen]
        fewer = [
            [offer for offer in chosen if offer not in pair]
            for pair in itertools.combinations(chosen, 2)
        ]
        left, may = self._further([*rests, *fewer])
        may[:, [self._at[offer.name] for offer in chosen]] = False
        for rest in rests:
            if not self._is_worth(self.left(rest), now):
                return rest
        # Of two terms the one law that says the same: a spring and what it lacks within a gap.
        alike = may & ~self._is_worth(left, now)
        for structure, number in np.argwhere(alike[len(rests) :])[:1]:
            return [*fewer[structure], self.offers[number]]
        for offer, rest in zip(chosen, rests, strict=True):
            if (simpler := self._simpler([*rest, offer]))[-1] is not offer:
                return simpler
        may[len(rests) :] = False
        for structure, number in self._least_first(left, may & self._is_worth(now, left)):
            return [*rests[structure], self.offers[number]]
        return None

    def _pruned(self, chosen: list[Candidate]) -> list[Candidate]:
        while chosen:
            chances = [self.chance(chosen, offer) for offer in chosen]
            doubtful = int(np.argmax(chances))
            if chances[doubtful] < RATE:
                break
            chosen = self._settled([*chosen[:doubtful], *chosen[doubtful + 1 :]])
        return chosen

    def in_order(self, chosen: Sequence[Candidate]) -> list[Candidate]:
        """What gains most first, beside those before it."""
        ordered: list[Candidate] = []
        while waiting := [offer for offer in chosen if offer not in ordered]:
            ordered = min(([*ordered, offer] for offer in waiting), key=self.unexplained)
        return ordered

    def path(self, chosen: Sequence[Candidate]) -> list[Step]:
        """What is left without any, and with one more at a time in this order."""
        energy, before, steps = self.folds.energy or 1.0, self.left([]), []
        for number, added in enumerate([None, *chosen]):
            left = self.left(chosen[:number])
            gain = (before.samples - left.samples) / energy
            error = np.sqrt(gain.size) * np.std(gain, ddof=1) if gain.size > 1 else np.nan
            whole, motion = (float(part.sum() / energy) for part in (left.samples, left.motion))
            name, chance = (added.family, self.chance(chosen, added)) if added else ("", 0.0)
            steps.append(Step(name, whole, motion, float(error), chance))
            before = left
        return steps

    def next_best(self, chosen: Sequence[Candidate], most: int = 5) -> list[Rejected]:
        """Candidates that were not taken and would gain most."""
        now = self.left(chosen)
        left, may = self._further([[*chosen]])
        gains = (now.motion.sum() - left.motion.sum(-1)) / now.samples.sum()
        nearest = self._least_first(left, may & (gains > 0))[:most]
        larger = [(number, [*chosen, self.offers[number]]) for _, number in nearest]
        return [
            Rejected(more[-1].family, float(gains[0, number]), self.chance(more, more[-1]))
            for number, more in larger
        ]

    def width_error(self, chosen: Sequence[Candidate], offer: Candidate) -> float:
        """Standard error of a law's width; nan where it lies at the end of what was tried.

        The width makes the sum over folds of what is unexplained least: with L_f' its slope in fold
        f, the variance is sum L_f'^2 / (sum L_f'')^2 (Huber's sandwich), slopes by differences.
        """
        if offer.law is None:
            return float("nan")
        beside, widths = [other for other in chosen if other is not offer], offer.law.widths
        each = [[*beside, other] for other in self.every if other.law is offer.law]
        number = offer.number
        # Of widths that leave alike the one that was chosen may stand at an end, and not the least.
        if not 0 < number < widths.size - 1:
            number = int(np.argmin([self.unexplained(structure) for structure in each]))
        # At an end there are fewer.
        near = [self.left(structure) for structure in each[max(number - 1, 0) : number + 2]]
        if len(near) < 3 or not np.isfinite([left.motion for left in near]).all():
            return float("nan")
        below, at, above = (left.motion for left in near)
        low, high = widths[number] - widths[number - 1], widths[number + 1] - widths[number]
        # Of a parabola through three points, wherever its least is.
        slopes = ((above - at) * low / high + (at - below) * high / low) / (low + high)
        bend = 2 * np.sum((above - at) / high - (at - below) / low) / (low + high)
        return float(np.sqrt(np.sum(slopes**2)) / bend) if bend > 0 else float("nan")


def again(
    search: Search, chosen: Sequence[Candidate], seed: int, times: int
) -> tuple[dict[str, float], dict[str, float]]:
    """Search again from folds drawn with replacement.

    **Returns:** shares of the searches that chose each family again, and the standard deviation of
    each parameter over those that hold it. Of a law it is the same one, whatever its width.
    """
    rng, folds = np.random.default_rng(seed), search.folds
    final = {
        column: name
        for offer in search.every
        for column, name in zip(offer.columns, offer.settled.columns, strict=True)
    }
    families: Counter[str] = Counter()
    values: dict[str, list[float]] = {}
    for _ in range(times):
        drawn = folds.drawn(rng.integers(folds.number, size=folds.number))
        trial = replace(search, folds=drawn, every=search.offers)
        belonging = trial.found()
        families.update(offer.family for offer in belonging)
        names = trial.names(belonging)
        for name, value in zip(names, drawn.fitted(names)):
            values.setdefault(final.get(name, name), []).append(float(value))
    shares = {offer.family: families[offer.family] / times for offer in chosen} if times else {}
    held = {final.get(name, name) for name in search.names(chosen)}
    errors = {name: float(np.std(v)) for name, v in values.items() if name in held and len(v) > 1}
    return shares, errors


def extended(model: Model, candidates: Sequence[Candidate]) -> Model:
    """The same equations with the terms of candidates, the first one's by default.

    **Raises:** `ModelError` as [`Model.with_terms`][].
    """
    if not candidates:
        return model
    added: dict[str, list[AbstractTerm]] = {}
    for candidate in candidates:
        name = candidate.equation or model.equation_names[0][0]
        added.setdefault(name, []).extend(candidate.terms)
    elements = dict.fromkeys(element for one in candidates for element in one.elements)
    meanings = {name: one.meaning for one in candidates for name in one.columns}
    return model.with_terms(added, elements=list(elements), meanings=meanings)


def without_twins(
    candidates: Sequence[AnyCandidate], model: Model, chosen: Container[str] = ()
) -> list[AnyCandidate]:
    """Candidates without what saturates where a line or a dead zone of the same signal is.

    A line is what saturates at a width, and what is beyond it. Of two of these the third is a sum,
    and one law would have three names: it is written as a line and what is beyond.

    **Arguments:** `chosen`, names of those candidates that are in the equations too.
    """
    names = [name for stage in model.equation_names for name in stage]
    laws = {one.name: (one.equation or names[0], members([one])[0].terms[0]) for one in candidates}
    there = [(n, term) for n, e in zip(names, model.equations, strict=True) for term in e.terms]
    there += [law for name, law in laws.items() if name in chosen]
    beyond = {(name, term.of) for name, term in laws.values() if isinstance(term.basis, DeadZone)}
    straight = {
        (name, term.of)
        for name, term in there
        if isinstance(term.basis, DeadZone) or (term.is_linear and not term.derivative)
    }
    twins = {
        law
        for law, (name, term) in laws.items()
        if isinstance(term.basis, Saturation) and (name, term.of) in straight & beyond
    }
    return [candidate for candidate in candidates if candidate.name not in twins]


FEWEST = 6
"""Folds of time that a choice is made from at the least."""
CLOSER = 10
"""Times at most that widths are moved together; each divides what lies between by 2.5."""
ALIKE = 0.1
"""Part of the least share of what is unexplained, that neighbouring widths differ by in the end."""
SEVERAL = 4
"""Laws with widths that are looked into, one after the other."""


class Question(NamedTuple):
    """What is asked of recordings, however often they are searched.

    **Fields:** `model`, and the candidates that are `offered`; `criterion`; `known`, coefficients
    that are held; `intervals` of estimates; `settings` of the search.
    """

    model: Model
    offered: list[AnyCandidate]
    criterion: AbstractCriterion
    known: Mapping[str, float]
    intervals: AbstractIntervals | None
    settings: Discover

    def parts(self, recordings: list[Recording]) -> tuple[list[Recording], list[Recording]]:
        """What is searched, and what values are from."""
        if self.settings.hold_out is None:
            return recordings, recordings
        first, last = zip(*(each.split(self.settings.hold_out) for each in recordings))
        return list(first), list(last)


class Sums:
    """Sums of a model's equations with candidates, whose widths change.

    `known`: coefficients that are held, and those that earlier stages found.
    """

    def __init__(self, question: Question, recordings: list[Recording]):
        self.question, self.recordings = question, recordings
        self.known = dict(question.known)
        self.sum_up(question.offered)

    def sum_up(self, candidates: list[AnyCandidate]) -> None:
        """Read the recordings and sum them up, for candidates with the widths that they have."""
        self.candidates = candidates
        model = extended(self.question.model, members(candidates))
        self.summary = summarise(model, self.recordings, self.question.criterion)

    def stages(self) -> list[tuple[Search, list[Candidate]]]:
        """A search of each stage, and what belongs to it, what gains most first."""
        stages = []
        for number, _ in enumerate(self.question.model.stages):
            search, chosen = self.settled(number)
            if search.folds.number < FEWEST:
                raise DataError(
                    f"the recordings hold {search.folds.number} blocks of time, of which terms are "
                    f"to be chosen by leaving some out: {FEWEST} are needed. Record for longer, or "
                    f"choose a smaller beta."
                )
            names = search.names(chosen)
            self.known |= search.folds.values(names)
            stages.append((search, search.in_order(chosen)))
        return stages

    def search(self, stage: int) -> Search:
        """A search of one stage, as the sums are now."""
        equations = sum_of_equations(self.summary.equations()[stage])
        blocks, settings = equations.fix(self.known).flattened(), self.question.settings
        folds = Folds.of(blocks.moments, blocks.clean, blocks.count, blocks.parameters)
        there = {*folds.parameters}
        offered = [offer for offer in members(self.candidates) if {*offer.columns} <= there]
        columns = {name for offer in offered for name in offer.columns}
        kept = tuple(name for name in folds.parameters if name not in columns)
        return Search(folds, kept, offered, settings.least, settings.smallest)

    def settled(self, stage: int) -> tuple[Search, list[Candidate]]:
        """What belongs to one stage, with widths as near as samples tell them."""
        near: set[str] = set()
        while True:
            search = self.search(stage)
            chosen = search.found()
            rough = [one for one in chosen if one.law is not None and one.family not in near]
            if not rough or len(near) >= SEVERAL:
                families = {offer.family for offer in chosen}
                fewer = without_twins(self.candidates, self.question.model, families)
                if len(fewer) == len(self.candidates):
                    return search, chosen
                self.sum_up(fewer)
                continue
            without = [search.unexplained([o for o in chosen if o is not one]) for one in rough]
            law = rough[int(np.argmax(without))].law
            assert law is not None
            beside = [offer for offer in chosen if offer not in rough]
            # Of laws with a memory all of the same signal: rough widths tell none from the others.
            for shape in self.candidates:
                if isinstance(shape, Shaped) and (
                    shape is law or (shape.of == law.of and shape.remember and law.remember)
                ):
                    self.narrow(stage, shape.name, beside)
                    near.add(shape.name)

    def narrow(self, stage: int, family: str, beside: Sequence[Candidate]) -> None:
        """Move the widths of a law to where it leaves least."""
        for _ in range(CLOSER):
            search = self.search(stage)
            each = [[*beside, offer] for offer in search.every if offer.family == family]
            left = np.array([search.unexplained(chosen) for chosen in each])
            best = int(np.argmin(left))
            most = left[best] + ALIKE * search.least * search.left(each[best]).samples.sum()
            if np.all(left[max(best - 1, 0) : best + 2] <= most):
                return
            self.sum_up(
                [
                    one.closer(best) if isinstance(one, Shaped) and one.name == family else one
                    for one in self.candidates
                ]
            )

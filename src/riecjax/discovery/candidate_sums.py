"""Sums of a model and of all that it may lack, summed anew as widths come closer.

A law with a width stands in the sums for each of a few widths. Once one of them is chosen, they are
moved together around it, beside what else was chosen, until neighbours differ by a few parts in a
thousand. Widths are arrays, so that no sum is compiled anew.

A model with terms that it may lack.
"""

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.discovery.candidate import AnyCandidate, Candidate, Shaped, renamed
from riecjax.discovery.search import LEAST, SHARE, Folds, Offer, Search
from riecjax.equations.bases import AbstractShape, DeadZone, Saturation
from riecjax.equations.memories import with_memories
from riecjax.equations.procedure import Procedure
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.records.recording import Recording
from riecjax.summaries.stage_sums import sum_of_equations
from riecjax.summaries.summarise import summarise
from riecjax.summaries.summary import Summary


def by_equation(
    procedure: Procedure, candidates: Iterable[Candidate]
) -> Mapping[str, Sequence[AbstractTerm]]:
    """The terms of candidates by the equation that each is for, the first one by default."""
    first = procedure.equation_names[0][0]
    found: dict[str, list[AbstractTerm]] = {}
    for one in candidates:
        found.setdefault(one.equation or first, []).extend(one.terms)
    return found


def extended(procedure: Procedure, candidates: Iterable[Candidate]) -> Procedure:
    """The same equations with the terms of candidates.

    **Raises:** `ModelError` as [`Procedure.with_terms`][].
    """
    return procedure.with_terms(by_equation(procedure, candidates))


def members(candidates: Iterable[AnyCandidate]) -> list[Candidate]:
    """Candidates as they are summed: of a law with a width one for each width."""
    found: list[Candidate] = []
    for one in candidates:
        if isinstance(one, Shaped):
            found += [one.at(i) for i in range(one.widths.size)]
        else:
            found.append(one)
    return found


def without_twins(
    candidates: Sequence[AnyCandidate], procedure: Procedure, chosen: Container[str] = ()
) -> list[AnyCandidate]:
    """Candidates without what saturates where a line or a dead zone of the same signal is.

    A line is what saturates at a width, and what is beyond it. Of two of these the third is a sum,
    and one law would have three names: it is written as a line and what is beyond.

    **Arguments:** `chosen`, names of those candidates that are in the equations too.
    """
    names = [name for stage in procedure.equation_names for name in stage]
    own = zip(names, (equation.terms for equation in procedure.equations), strict=True)
    there = [(name, term) for name, terms in own for term in terms]
    offered = [(one, (one.equation or names[0], members([one])[0].terms[0])) for one in candidates]
    beyond = {_signal(pair) for _, pair in offered if _has_shape(pair[1], DeadZone)}
    there += [pair for one, pair in offered if one.name in chosen]
    straight = {
        _signal((name, term))
        for name, term in there
        if _has_shape(term, DeadZone) or (isinstance(term, Term) and not term.derivative)
    }
    return [
        one
        for one, pair in offered
        if not (_has_shape(pair[1], Saturation) and _signal(pair) in straight & beyond)
    ]


def _signal(place: tuple[str, AbstractTerm]) -> tuple[str, object]:
    """Of which equation and of what a term is."""
    equation, term = place
    return equation, getattr(term, "of", None)


def _has_shape(term: AbstractTerm, kind: type[AbstractShape]) -> bool:
    return isinstance(term, Terms) and isinstance(term.basis, kind)


def offers(candidates: Iterable[AnyCandidate], names: Container[str]) -> list[Offer]:
    """What a search among coefficients of these names may choose: of a law with a width, one for
    each."""
    found: list[Offer] = []
    for one in candidates:
        for each in members([one]):
            if all(name in names for name in each.columns):
                simple = not isinstance(one, Shaped)
                found.append(Offer(each.name, each.columns, one.name, simple))
    return found


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
    """Sums of a procedure's equations with candidates.

    **Fields:** `candidates`, whose widths change; `known`, coefficients that are held; `least`
    and `smallest` as of a [`Search`][riecjax.discovery.search.Search].
    """

    procedure: Procedure
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
        self.summary = summarise(extended(self.procedure, every), carrying, self.criterion)

    def folds(self, stage: int, found: Mapping[str, float]) -> Folds:
        """Of one stage, what earlier ones found being known."""
        equations = self.summary.equations()[stage]
        names = tuple(dict.fromkeys(name for e in equations for name in e.parameters))
        return Folds.of(sum_of_equations(equations, names).fix({**self.known, **found}))

    def search(self, stage: int, found: Mapping[str, float]) -> Search:
        """A search of one stage, as the sums are now."""
        folds = self.folds(stage, found)
        offered = offers(self.candidates, {*folds.parameters})
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
                fewer = without_twins(self.candidates, self.procedure, families)
                if len(fewer) == len(self.candidates):
                    return search, chosen
                self.candidates = fewer
                self.sum_up()
                continue
            strongest = max(rough, key=lambda one: _without(search, chosen, one))
            beside = [one for one in chosen if one.simple or one.family in near]
            for family in self._kin(strongest.family):
                self._narrow(stage, found, family, beside)
                near.add(family)

    def width_error(self, search: Search, chosen: Sequence[Offer], one: Offer) -> float:
        """Standard error of a law's width; nan where it lies at the end of what was tried.

        The width makes the sum over folds of what is unexplained least: with L_f' its slope in fold
        f, the variance is sum L_f'^2 / (sum L_f'')^2 (Huber's sandwich), slopes by differences.
        """
        if one.simple:
            return float("nan")
        number = int(one.name.rpartition("@")[2])
        widths = self.shape(one.family).widths
        if not 0 < number < widths.size - 1:
            return float("nan")
        beside = [other for other in chosen if other is not one]
        near = {o.name: o for o in search.every if o.family == one.family}
        offers = [near[f"{one.family}@{i}"] for i in (number - 1, number, number + 1)]
        left = [search.left([*beside, offer]) for offer in offers]
        if any(each is None for each in left):
            return float("nan")
        below, at, above = (each.motion for each in left if each is not None)
        low, high = widths[number] - widths[number - 1], widths[number + 1] - widths[number]
        # Of a parabola through three points, wherever its least is.
        slopes = ((above - at) * low / high + (at - below) * high / low) / (low + high)
        bend = 2 * np.sum((above - at) / high - (at - below) / low) / (low + high)
        return float(np.sqrt(np.sum(slopes**2)) / bend) if bend > 0 else float("nan")

    def _kin(self, family: str) -> list[str]:
        """A law, and of laws with a memory all of the same signal: rough widths tell none of them
        from the others."""
        one = self.shape(family)
        if one.remember is None:
            return [family]
        shapes = [each for each in self.candidates if isinstance(each, Shaped)]
        return [s.name for s in shapes if s.remember is not None and s.of == one.of]

    def _narrow(
        self, stage: int, found: Mapping[str, float], family: str, beside: Sequence[Offer]
    ) -> None:
        """Move the widths of a law to where it leaves least."""
        for _ in range(CLOSER):
            search = self.search(stage, found)
            each = [search.left([*beside, o]) for o in search.every if o.family == family]
            left = np.array([np.inf if one is None else one.motion.sum() for one in each])
            best = int(np.argmin(left))
            at_best = each[best]
            if at_best is None:
                return
            near = left[max(best - 1, 0) : best + 2] - left[best]
            if np.all(near < ALIKE * self.least * at_best.samples.sum()):
                return
            closer = self.shape(family).closer(best)
            self.candidates = [closer if one.name == family else one for one in self.candidates]
            self.sum_up()


def _without(search: Search, chosen: Sequence[Offer], one: Offer) -> float:
    left = search.left([other for other in chosen if other is not one])
    return float("inf") if left is None else float(left.motion.sum())

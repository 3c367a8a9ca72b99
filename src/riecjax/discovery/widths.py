"""Sums of a model and of all that it may lack, summed anew as widths come closer.

A law with a width stands in the sums for each of a few widths. Once one of them is chosen, they are
moved together around it, beside what else was chosen, until neighbours differ by a few parts in a
thousand. Widths are arrays, so that no sum is compiled anew.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.discovery.candidate import AnyCandidate, Shaped
from riecjax.discovery.extended import extended, members, offers, without_twins
from riecjax.discovery.folds import Folds
from riecjax.discovery.search import LEAST, SHARE, Offer, Search
from riecjax.equations.memories import with_memories
from riecjax.equations.procedure import Procedure
from riecjax.records.recording import Recording
from riecjax.summaries.stage_sums import sum_of_equations
from riecjax.summaries.summarise import summarise
from riecjax.summaries.summary import Summary

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

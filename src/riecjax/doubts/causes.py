"""What of all that may be amiss the data demand: by blocks of time that it was not fitted to.

A doubt is the cause of what is left, where its column is no chance (one level for the answer, over
all that were tried), is of a size that a machine or a sensor may have, and explains nearly all that
is left beyond noise. Whatever is wrong makes everything that correlates with it significant: a mode
that the model leaves out makes a force look late. It explains a third, and is no cause. What
explains nearly as much as the cause is *equivalent*: the recordings hardly tell which it is. Where
no doubt is the cause alone, two or three may be: the best is admitted, and the rest are tested
beside it.

What no column of its own remains of beside the regressors, cannot be tested, as a delay that all
signals have; nor can the target's own gain, whose column explains it whole, at no plausible size.
"""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from riecjax.doubts.columns import STATES, Doubt
from riecjax.equations.expressions import constant
from riecjax.folds import Folds, Told
from riecjax.leaves import size_of

LEVEL = 1e-3
"""Probability by chance, over all doubts, below which one is told."""
UNEXPLAINED = 0.1
"""Share of the energy left beyond noise that a cause leaves at most."""
OF_NOISE = 0.07
"""The same as a share of what noise leaves: no closer is known how much that is."""
LOST = 0.03
"""Energy left, as a share, from which a delay may be too large to be found from where it is."""
CLEARER = 4.0
"""Times as much energy that others leave where the cause is certain."""
NO_DELAYS = ("zero", "gain", "drift", "term")
"""Kinds of doubts other than delays and their courses, and states."""
FEWEST = 6
"""Folds of time below which their scatter says too little."""
MOST = 3
"""Doubts that are the cause together at the most."""
OWN = 1e-7
"""Share of a column that is its own beside regressors and target, below which rounding makes it."""
OWN_NOISE = 2.0
"""The same over the noise in it, which is not known closely: a delay of a position is to first
order the damping of the velocity beside it, and what is its own of that is what sensors add."""


@dataclass(eq=False)
class Causes:
    """Doubts, weighed by what they explain of each fold.

    **Fields:** `folds` of parameters and doubts; `every` doubt that stands in them and can be
    tested; `plausible` sizes of doubts by name, above which none is a cause; how many there were
    to choose from, `trials`.
    """

    folds: Folds
    every: Sequence[Doubt]
    plausible: Mapping[str, float]
    trials: int = 0

    def __post_init__(self):
        doubted = {doubt.name for doubt in self.every}
        self.trials = self.trials or len(self.every)
        self.base = tuple(name for name in self.folds.parameters if name not in doubted)
        left = self.folds.left(self.base)
        self.before = float(left.motion.sum())
        self.noise = max(float(left.samples.sum()) - self.before, 0.0)
        there = {*self.folds.parameters}
        self.every = [doubt for doubt in self.every if doubt.name in there]
        self._known: dict[tuple[str, ...], dict[Doubt, Told]] = {}
        self._left: dict[frozenset[str], float] = {}
        # A column that is its own beyond rounding and noise.
        self.offered = [
            doubt
            for doubt, told in self.beside([]).items()
            if told.own > max(OWN, OWN_NOISE * told.noise)
        ]

    def of(self, *kinds: str) -> list[Doubt]:
        """The doubts of some kinds that can be tested."""
        return [doubt for doubt in self.offered if doubt.kind in kinds]

    def names(self, doubts: Sequence[Doubt]) -> tuple[str, ...]:
        """Of the parameters' columns, and those of doubts."""
        return (*self.base, *(doubt.name for doubt in doubts))

    def beside(self, chosen: Sequence[Doubt]) -> dict[Doubt, Told]:
        """How much of every doubt there is, beside the parameters and those that are chosen."""
        names = self.names(chosen)
        if names not in self._known:
            told = self.folds.beside(names, [doubt.name for doubt in self.every])
            self._known[names] = dict(zip(self.every, told, strict=True))
        return self._known[names]

    def left(self, doubts: Sequence[Doubt]) -> float:
        """Energy that is left beyond noise with doubts let in, of folds that they were not fitted
        to."""
        key = frozenset(doubt.name for doubt in doubts)
        if key not in self._left:
            self._left[key] = float(self.folds.left(self.names(doubts)).motion.sum())
        return self._left[key]

    def settle(self, doubt: Doubt, left: float) -> None:
        """Say what is left once a doubt is undone, which its column tells to first order alone."""
        self._left[frozenset([doubt.name])] = left

    def rms(self, left: float) -> float:
        """An energy that is left, as rms over the target's."""
        return float(np.sqrt(max(left, 0.0) / size_of(self.folds.energy)))

    def is_little(self, left: float) -> bool:
        """Whether an energy that is left is hardly more than noise."""
        return left <= max(UNEXPLAINED * self.before, OF_NOISE * self.noise)

    def is_sure(self, doubt: Doubt, beside: Sequence[Doubt] = ()) -> bool:
        """Whether neither chance nor rounding makes a doubt, and it is of a plausible size."""
        told = self.beside(beside)[doubt]
        likely = abs(told.value) < self.plausible.get(doubt.name, np.inf)
        return likely and told.own > OWN and told.chance * self.trials < LEVEL

    @property
    def is_promising(self) -> bool:
        """Whether any doubt may be a cause, or one of several; or so much is left that a delay may
        be too large for its column."""
        sure = filter(self.is_sure, self.offered)
        most = max((self.beside([])[doubt].gained for doubt in sure), default=0.0)
        # Of several causes the best gains half by itself.
        enough = max(self.before, OF_NOISE * self.noise) / 2
        return most > enough or self.before > LOST * self.folds.energy

    def nearest(self, most: int) -> list[Doubt]:
        """All delays; of the other doubts those that gain most by themselves, and beside the best,
        of a state all widths; and of what drifts the zero as well."""
        others, near = self.of(*NO_DELAYS, STATES), self.of("delay")
        best: list[Doubt] = []
        for _ in range(2):
            told = self.beside(best)
            sure = [
                doubt
                for doubt in others
                if doubt not in near and (self.is_sure(doubt, best) or self._zero_hiding(doubt))
            ]
            sure.sort(key=lambda doubt: -told[doubt].gained)
            sure = [doubt for doubt in sure if doubt not in _states(sure)[1:]]
            near += sure[:most]
            best = sure[:1]
            if not best:
                break
        turning = [doubt.elements[0].place for doubt in _states(near)]
        near += [doubt for doubt in self.of(STATES) if doubt.elements[0].place in turning]
        drifting = {doubt.signals for doubt in near if doubt.kind == "drift"}
        near += [doubt for doubt in self.of("zero") if doubt.signals in drifting]
        return [doubt for doubt in self.every if doubt in near]

    def demanded(self, among: Sequence[Doubt], sure: Container[Doubt] = ()) -> list[Doubt]:
        """Of some doubts those that are the cause of what is left, none where nothing explains it;
        that some are no chance is known, of those that are `sure`."""
        chosen, among = list[Doubt](), [*among]
        while self.folds.number >= FEWEST and len(chosen) < MOST:
            others = [doubt for doubt in among if doubt.kind != STATES or not _states(chosen)]
            best = self._best(others, chosen, sure)
            if best is None:
                break
            if self.is_little(self.left([*chosen, best])) and self._reproduces([*chosen, best]):
                among.remove(best)
                continue
            chosen.append(min(self._alike(best, chosen, among), key=_simplicity))
            # Of a state the width that leaves least beside the others.
            found = ([a if one.kind == STATES else one for one in chosen] for a in _states(among))
            chosen = min([chosen, *found], key=self.left)
            if self.is_little(self.left(chosen)):
                return self._pruned(chosen)
        # What drifts hides its zero, and is hidden by it.
        pairs = [[zero, one] for one in among for zero in self._zero_hiding(one)]
        best = min(pairs, key=self.left, default=[])
        return self._pruned(best) if best and self.is_little(self.left(best)) else []

    def admitted(self, beside: Sequence[Doubt] = ()) -> list[Doubt]:
        """Doubts that are let in beside some one after the other, each the one with which least is
        left of blocks that it was not fitted to, as long as it is no chance and less is left with
        it; those that they are beside come first."""
        chosen = [*beside]
        while self.folds.number >= FEWEST and len(chosen) < MOST:
            best = self._best([one for one in self.offered if one.kind != STATES], chosen)
            if best is None or self._reproduces([*chosen, best]):
                break
            chosen.append(best)
        return chosen

    def _best(
        self, among: Sequence[Doubt], chosen: Sequence[Doubt], sure: Container[Doubt] = ()
    ) -> Doubt | None:
        """The doubt with which least is left beside those that are chosen, if less is with it."""
        some = [one for one in among if one not in chosen]
        some = [one for one in some if one in sure or self.is_sure(one, chosen)]
        best = min(some, key=lambda doubt: self.left([*chosen, doubt]), default=None)
        return best if best and self.left([*chosen, best]) < self.left(chosen) else None

    def _zero_hiding(self, doubt: Doubt) -> list[Doubt]:
        """The zero of a signal beside which it surely drifts, if that is doubted."""
        zeros = self.of("zero") if doubt.kind == "drift" else []
        return [one for one in zeros if one.signals == doubt.signals and self.is_sure(doubt, [one])]

    def _alike(self, best: Doubt, beside: Sequence[Doubt], among: Sequence[Doubt]) -> list[Doubt]:
        """The best doubt, those that say the same, and of those that leave hardly more: terms,
        which are likelier than what looks like them; and drifts of other signals, if it is one,
        which are taken off an input as well as off any other. What a state is not, the shape of a
        cause to the last, a term in its place has to be."""
        left = self.left([*beside, best])
        most = max(CLEARER * left, OF_NOISE * self.noise)
        explained = best.kind == STATES and self.is_little(left)
        same = self.same_as(best, among)
        return [
            doubt
            for doubt in among
            if doubt is best
            or doubt in same
            or (
                (doubt.kind == "term" or doubt.kind == best.kind == "drift")
                and self.left([*beside, doubt]) <= most
                and (not explained or self.is_little(self.left([*beside, doubt])))
                and self.is_sure(doubt, beside)
            )
        ]

    def same_as(self, doubt: Doubt, among: Sequence[Doubt]) -> list[Doubt]:
        """The other doubts whose columns are the same, whatever the recording: the zero of a force
        and a constant force."""
        told = self.beside([doubt])
        return [one for one in among if one is not doubt and not told[one].own > OWN]

    def instead(self, chosen: Sequence[Doubt], cause: Doubt) -> list[Doubt]:
        """Doubts that explain what is left in the place of a cause, best first."""
        beside = [doubt for doubt in chosen if doubt is not cause]
        others = [
            doubt
            for doubt in self.of("delay", *NO_DELAYS)
            if doubt not in chosen
            and self.is_little(self.left([*beside, doubt]))
            and self.is_sure(doubt, beside)
        ]
        return sorted(others, key=lambda doubt: self.left([*beside, doubt]))

    def is_zero_of(self, doubt: Doubt, drifting: Sequence[Doubt]) -> bool:
        """Whether a doubt is the zero of a signal that drifts, or a constant that is the same."""
        zeros = [one for one in self.of("zero") if any(one.signals == d.signals for d in drifting)]
        return any(one is doubt or one in self.same_as(doubt, [one]) for one in zeros)

    def is_certain(self, chosen: Sequence[Doubt], cause: Doubt, others: Sequence[Doubt]) -> bool:
        """Whether all others in the place of a cause are the same, drift as well, or leave clearly
        more."""
        beside = [doubt for doubt in chosen if doubt is not cause]
        least = max(CLEARER * self.left(chosen), OF_NOISE * self.noise)
        same = self.same_as(cause, others)
        return all(
            other in same
            or other.kind == cause.kind == "drift"
            or self.left([*beside, other]) > least
            for other in others
        )

    def _reproduces(self, doubts: Sequence[Doubt]) -> bool:
        """Whether doubts alone make the target, all parameters zero: a law of the known force."""
        alone = float(self.folds.left([doubt.name for doubt in doubts]).motion.sum())
        return alone <= max(CLEARER * self.left(doubts), OF_NOISE * self.noise)

    def _pruned(self, chosen: list[Doubt]) -> list[Doubt]:
        """Without those without which the rest explains as much."""
        for doubt in chosen[:-1]:
            rest = [other for other in chosen if other is not doubt]
            left = self.left(rest)
            if self.is_little(left) and left <= CLEARER * self.left(chosen):
                return self._pruned(rest)
        return chosen


def _states(doubts: Sequence[Doubt]) -> list[Doubt]:
    return [doubt for doubt in doubts if doubt.kind == STATES]


def _simplicity(doubt: Doubt) -> int:
    """What is said first of doubts that are alike: a constant, a zero, any other term, what else,
    a state; of these, what comes first."""
    if doubt.kind == STATES:
        return 4
    if doubt.term is not None:
        return 0 if doubt.term.of is constant else 2
    return 1 if doubt.kind == "zero" else 3

"""Which columns belong: forward selection with exchange, and what of it chance does not explain.

Terms are added by what they gain on blocks of time that their coefficients were not fitted to,
whether or not the gain is sure: half of a law may say little before the other half is there. Each
time, those chosen before are exchanged for others, or left out, where that predicts as well. Then
terms are taken away again, the least sure first, until each of the rest

- is further from zero than chance makes any one of all that were offered, at the stated rate,
- makes up for `SHARE` of what is unexplained without it, noise included,
- and for `LEAST` of the whole, unless told otherwise.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from riecjax.discovery.folds import Folds, Left

RATE = 0.05
"""Of searches that add anything where nothing is missing."""
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
    other widths. `simple`, no such width."""

    name: str
    columns: tuple[str, ...]
    family: str
    simple: bool = True


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

    def among(self, folds: Folds, offers: Sequence[Offer]) -> "Search":
        """A search of other folds, among some of these offers and as strict as this one."""
        trials = len(self.offers)
        return Search(folds, self.kept, offers, trials, self.least, self.smallest)

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
            if gain > most and not (sure and self._is_doubtful(chosen, offer, before, after)):
                best, most = offer, gain
        if best is None:
            return None
        grown = self._simpler([*chosen, best])
        return grown if self._is_worth(before, self.left(grown)) else None

    def _is_doubtful(
        self, chosen: list[Offer], offer: Offer, before: Left | None, after: Left | None
    ) -> bool:
        worth = self._is_worth(before, after)
        return not worth or self.chance([*chosen, offer], offer) >= RATE

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
            steps.append(self._step(one.name, before, left, energy, chance))
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

"""How sure a choice of terms is: it is made again from blocks of time that are drawn again.

An interval of a parameter holds for a given structure. Which terms there are was read off the same
data, so that the usual interval of what stayed is too narrow, and says nothing of what nearly was
chosen. Drawing folds with replacement and searching again lets the choice vary as it would on other
recordings (Efron, 2014); a parameter's variance over these searches includes that of the choice.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from riecjax.discovery.folds import Left
from riecjax.discovery.search import Offer, Search

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
    folds, among = search.folds, _among(search, chosen)
    families: Counter[str] = Counter()
    values: dict[tuple[str, int], list[float]] = {}
    # Of a law the same coefficient, whatever its width.
    place_of = {
        name: (offer.family, i) for offer in search.every for i, name in enumerate(offer.columns)
    }
    for _ in range(times):
        drawn = folds.drawn(rng.integers(folds.number, size=folds.number))
        one = search.among(drawn, among)
        found = one.found()
        families.update(offer.family for offer in found)
        names = (*search.kept, *(name for offer in found for name in offer.columns))
        for name, value in zip(names, drawn.fitted(names)):
            values.setdefault(place_of.get(name, (name, 0)), []).append(float(value))
    errors = {place: float(np.std(each)) for place, each in values.items() if len(each) > 1}
    held = {
        name: errors.get(place_of.get(name, (name, 0)), np.nan) for name in _held(search, chosen)
    }
    shares = {offer.family: families[offer.family] / times for offer in chosen} if times else {}
    return Again(shares, held)


def _held(search: Search, chosen: Sequence[Offer]) -> tuple[str, ...]:
    return (*search.kept, *(name for offer in chosen for name in offer.columns))


def _among(search: Search, chosen: Sequence[Offer]) -> list[Offer]:
    """The offers that come into question, those that were chosen first."""
    if len(search.offers) <= AMONG:
        return search.offers
    others = [one for one in search.offers if one not in chosen]
    alone = {one.name: search.left([one]) for one in others}
    beside = {one.name: search.left([*chosen, one]) for one in others}

    def rank(left: Mapping[str, Left | None]) -> dict[str, int]:
        sizes = {
            n: float("inf") if of is None else float(of.motion.sum()) for n, of in left.items()
        }
        return {name: i for i, name in enumerate(sorted(sizes, key=lambda n: sizes[n]))}

    first, second = rank(alone), rank(beside)
    others.sort(key=lambda one: min(first[one.name], second[one.name]))
    return [*chosen, *others[: AMONG - len(chosen)]]

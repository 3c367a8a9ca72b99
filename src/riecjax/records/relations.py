"""Signals whose time derivatives are recorded: alone, or as a sum of signals."""

import dataclasses
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, TypeAlias

from riecjax.records.record import Record


class Relation(NamedTuple):
    """The time derivative of `signal` is the sum `of` signals, each times its factor."""

    signal: str
    of: tuple[tuple[str, float], ...]

    @property
    def terms(self) -> tuple[str, ...]:
        """Names in the sum."""
        return tuple(name for name, _ in self.of)

    @property
    def names(self) -> tuple[str, ...]:
        """All signals."""
        return (self.signal, *self.terms)

    @property
    def is_plain(self) -> bool:
        """Whether the derivative is one signal as it is."""
        return len(self.of) == 1 and self.of[0][1] == 1

    def words(self, suspect: str) -> tuple[str, str]:
        """What a term is called, or the whole sum; and what it should be equal to."""
        if suspect not in self.terms:
            return summed(self.of), f"the derivative of {self.signal}"
        factor = dict(self.of)[suspect]
        if len(self.of) == 1:
            times = "" if factor == 1 else f"{1 / factor:.4g} times "
            return suspect, f"{times}the derivative of {self.signal}"
        rest = [(name, -c / factor) for name, c in self.of if name != suspect]
        return suspect, summed([*rest, (f"{self.signal}'", 1 / factor)])


Pairs: TypeAlias = Iterable[tuple[str, str] | Relation]
"""Signals and their derivatives."""


def relations(pairs: Pairs) -> Iterator[Relation]:
    """Each of them once."""
    for signal, of in dict.fromkeys(pairs):
        yield Relation(signal, ((of, 1.0),) if isinstance(of, str) else of)


def with_sum(record: Record, relation: Relation) -> tuple[Record, str, str]:
    """A record with the sum as a signal, the name of the signal it is the derivative of, its own.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    if relation.is_plain:
        return record, relation.signal, relation.terms[0]
    label = summed(relation.of)
    first, *rest = (c * record.signal(name) for name, c in relation.of)
    # No column holds it, whose unit could be another one.
    total = dataclasses.replace(sum(rest, first), unit="")
    return record.with_signals({label: total}), relation.signal, label


def summed(terms: Iterable[tuple[str, float]]) -> str:
    """A sum as it is written, positive terms first."""
    words = ""
    for name, factor in sorted(terms, key=lambda term: term[1] < 0):
        size = name if abs(factor) == 1 else f"{abs(factor):.4g} {name}"
        sign = "-" if factor < 0 else "+"
        words += f" {sign} {size}" if words else f"{sign if factor < 0 else ''}{size}"
    return words


def declared_pairs(model: Any) -> list[tuple[str, str] | Relation]:
    """Signals and their derivatives, as a `Model` or its equations call them."""
    return [*model.derivatives] if hasattr(model, "stages") else []

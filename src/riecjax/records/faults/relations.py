"""The derivative of a signal as a sum of signals: x2' = x3 - x4, or just x' = v."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np

from riecjax.records.record import Record, samples_with_nan


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

    @property
    def suspects(self) -> tuple[str, ...]:
        """Signals each of which may alone be wrong: of a signal and its derivative it is moot
        which."""
        return self.terms if len(self.of) == 1 else self.names

    def side(self, suspect: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of what is held against each other: a term against all else, or all terms."""
        mine = (suspect,) if suspect in self.terms else self.terms
        return mine, tuple(name for name in self.names if name not in mine)

    def words(self, suspect: str) -> tuple[str, str]:
        """What a term is called, or the whole sum; and what it should be equal to."""
        if suspect not in self.terms:
            return summed(self.of), f"the derivative of {self.signal}"
        factor = dict(self.of)[suspect]
        rest = [(name, -c / factor) for name, c in self.of if name != suspect]
        of = f"the derivative of {self.signal}"
        if not rest:
            return suspect, of if factor == 1 else f"{1 / factor:.4g} times {of}"
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
    columns = [c * samples_with_nan(record, name) for name, c in relation.of]
    total = np.sum(columns, axis=0)
    gaps = np.isnan(total)
    values, missing = jnp.asarray(np.nan_to_num(total)), {label: jnp.asarray(gaps)}
    added = record.with_signals({label: values}, missing=missing if gaps.any() else {})
    return added, relation.signal, label


def summed(terms: Iterable[tuple[str, float]]) -> str:
    """A sum as it is written, positive terms first."""
    words = ""
    for name, factor in sorted(terms, key=lambda term: term[1] < 0):
        size = name if abs(factor) == 1 else f"{abs(factor):.4g} {name}"
        sign = "-" if factor < 0 else "+"
        words += f" {sign} {size}" if words else f"{sign if factor < 0 else ''}{size}"
    return words

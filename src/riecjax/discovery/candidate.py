"""What a model may lack: terms that enter together, by a name, a meaning and units.

A candidate of a file, by its name: what a discovered model's file asks for.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from riecjax.equations.memories import Memory
from riecjax.equations.term import AbstractTerm, Term
from riecjax.errors import ModelError, require
from riecjax.models.catalogue import object_of_file


@dataclass(frozen=True, eq=False)
class Candidate:
    """Terms that a model may lack, which enter it together or not at all.

    **Fields:**

    - `name` in tables, and `terms`, with signs as if they stood beside the inertia: the coefficient
      of what resists motion is positive. One coefficient is called like the candidate.
    - `meaning`, in words.
    - `equation`, the name of the one that it may belong to; the first by default.
    - `memories`, states that its terms read and recordings lack.

    **Raises:** `ModelError` without terms, or for what is no term.
    """

    name: str
    terms: tuple[AbstractTerm, ...]
    meaning: str = ""
    equation: str = ""
    memories: tuple[Memory, ...] = ()

    def __post_init__(self):
        for term in self.terms:
            example = "rx.discovery.Candidate('drag', (rx.Term('drag', rx.odd('dx', 2)),))"
            require(f"{self.name}: a term", term, AbstractTerm, example)
        if not self.terms or not self.columns:
            raise ModelError(f"the candidate '{self.name}' has no term with a coefficient.")

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its coefficients."""
        return tuple(name for term in self.terms for name in term.parameters)


@dataclass(frozen=True, eq=False)
class Shaped:
    """A law with a width, which the coefficients are not linear in: a candidate for each of some.

    **Fields:** `name`, `meaning`, `equation` as of a [`Candidate`][]; `build`, which makes the term
    of a name and a width; `widths` that are tried, in the `unit` of the signal; `of`, that signal;
    `remember`, of a law with a memory, which makes the state that the term reads.
    """

    name: str
    build: Callable[[str, float], AbstractTerm]
    widths: Float[np.ndarray, " widths"]
    of: str
    unit: str = ""
    meaning: str = ""
    equation: str = ""
    remember: Callable[[str, float], Memory] | None = None

    def at(self, number: int) -> Candidate:
        """The candidate of one of the widths."""
        return self._candidate(f"{self.name}@{number}", float(self.widths[number]))

    def chosen(self, width: float) -> Candidate:
        """The candidate of this width, by its own name."""
        return self._candidate(self.name, width)

    def _candidate(self, name: str, width: float) -> Candidate:
        memories = () if self.remember is None else (self.remember(name, width),)
        term = self.build(name, width)
        return Candidate(name, (term,), self.meaning, self.equation, memories)

    def with_widths(self, widths: Float[np.ndarray, " widths"]) -> "Shaped":
        """The same for other widths, of which there are as many."""
        return replace(self, widths=widths)

    def closer(self, number: int) -> "Shaped":
        """The same for widths between the two beside one of them, which stays among them."""
        widths = self.widths
        centre = widths[number]
        low = widths[number - 1] if number else 0.5 * centre
        high = widths[number + 1] if number + 1 < widths.size else 1.5 * centre
        spread = np.linspace(low, high, widths.size)
        spread[np.argmin(np.abs(spread - centre))] = centre
        return self.with_widths(spread)


AnyCandidate = Candidate | Shaped


def as_candidates(given: object) -> list[AnyCandidate]:
    """What a user gives as candidates: these, or terms, each a candidate by itself.

    **Raises:** `ModelError` for anything else, and for two of one name.
    """
    listed: Sequence[object] = given if isinstance(given, list | tuple) else [given]
    found: list[AnyCandidate] = []
    for one in listed:
        if isinstance(one, AbstractTerm):
            found.append(Candidate(" + ".join(one.parameters) or "a known term", (one,)))
            continue
        example = "candidates=[rx.Term('drag', rx.odd('dx', 2))]"
        require("a candidate", one, (Candidate, Shaped), example)
        assert isinstance(one, Candidate | Shaped)
        found.append(one)
    if not found:
        raise ModelError("no candidate is given: leave candidates out for the usual ones.")
    names = [one.name for one in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ModelError(f"two candidates are called {', '.join(twice)}: give each its own name.")
    return found


def renamed(one: AnyCandidate, name: str) -> AnyCandidate:
    """The same by another name, and so a coefficient that is called like it."""
    if isinstance(one, Shaped):
        return replace(one, name=name)
    return replace(one, name=name, terms=tuple(_called(t, one.name, name) for t in one.terms))


def _called(term: AbstractTerm, before: str, name: str) -> AbstractTerm:
    if not isinstance(term, Term) or term.name != before:
        return term
    return Term(
        name,
        term.of,
        derivative=term.derivative,
        measured=term.measured,
        unit=term.unit,
        sign=term.number,
    )


def named(reference: str, name: str) -> Candidate:
    """The candidate of this name among those that `path/to/file.py:object` holds.

    **Raises:** `ModelError` if there is no such file, object or candidate, or it has a width.
    """
    for one in as_candidates(object_of_file(reference)):
        if one.name == name and isinstance(one, Candidate):
            return one
    raise ModelError(f"{reference} holds no candidate '{name}'.")

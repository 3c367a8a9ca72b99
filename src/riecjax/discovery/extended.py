"""A model with terms that it may lack."""

from collections.abc import Container, Iterable, Mapping, Sequence

from riecjax.discovery.candidate import AnyCandidate, Candidate, Shaped, renamed
from riecjax.discovery.search import Offer
from riecjax.equations.procedure import Procedure
from riecjax.equations.term import AbstractTerm


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

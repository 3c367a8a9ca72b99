"""A model with terms that it may lack."""

from collections.abc import Container, Iterable, Mapping, Sequence

from riecjax.discovery.candidate import AnyCandidate, Candidate, Shaped, renamed
from riecjax.discovery.search import Offer
from riecjax.equations.procedure import Procedure
from riecjax.equations.shapes import AbstractShape, DeadZone, Saturation
from riecjax.equations.term import AbstractTerm, Term, Terms


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

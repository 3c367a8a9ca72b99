"""A constant input beside an offset: a fit that is exact, and says nothing of the machine.

With a force that never varies, an unknown offset alone explains all of it: the offset takes the
force's value, every other parameter zero, and the residual vanishes, while the regressors are not
collinear at all. A step that begins before the record does is the usual case.
"""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from jaxtyping import Array

from riecjax.equations.equation import Equation
from riecjax.equations.term import AbstractTerm
from riecjax.errors import IdentifiabilityError
from riecjax.estimation.noise import noise_level
from riecjax.estimation.procedure import Procedure
from riecjax.records.record import Record

SMALL = 0.02
"""Share of its mean by which a constant input may waver, if that is no more than noise."""


def raise_if_only_constant(
    procedure: Procedure, records: list[Record], known: Mapping[str, Array]
) -> None:
    """Refuse equations whose known terms are constant while an offset is unknown (not under jit).

    **Raises:** `IdentifiabilityError` naming the offset and what it hides.
    """
    for message in constant_sides(procedure, records, known):
        raise IdentifiabilityError(message)


def constant_sides(
    procedure: Procedure, records: list[Record], known: Iterable[str]
) -> Iterator[str]:
    """In words, each equation whose known terms an unknown offset alone explains."""
    found = set(known)
    for stage in procedure.stages:
        for equation in stage:
            if message := constant_side(equation, records, found):
                yield message
        found |= {name for equation in stage for name in equation.parameters}


def constant_side(equation: Equation, records: list[Record], known: Iterable[str]) -> str:
    """In words, that an unknown offset alone explains the known terms; empty if it does not."""
    held = set(known)
    unknown = [term for term in equation.terms if set(term.parameters) - held]
    given = [term for term in equation.terms if not set(term.parameters) - held]
    # Signals by name first: most often one of them varies, and no expression need be computed.
    given.sort(key=lambda term: not isinstance(term.of, str))
    acting = []
    for term in given:
        if not all(_is_constant(term, record) for record in records):
            return ""
        if not all(_is_zero(term, record) for record in records):
            acting.append(term)
    offsets = [
        term
        for term in unknown
        if len(term.parameters) == 1 and all(_is_constant(term, record) for record in records)
    ]
    others = [name for term in unknown if term not in offsets for name in term.parameters]
    if not (offsets and others and acting):
        return ""
    offset = offsets[0].parameters[0]
    hidden = ", ".join(dict.fromkeys(others))
    return (
        f"{equation.name}: the input never varies, so {offset} alone explains all of it and leaves "
        f"{hidden} at zero: the record cannot tell {offset} from the rest. Record from before the "
        f"step on, excite the system more richly, or hold {offset} at a known value (on the "
        f"command line: --set {offset}=VALUE)."
    )


def _samples(term: AbstractTerm, record: Record) -> np.ndarray:
    values, present = term.samples(record, 0)
    return np.asarray(values) if present is None else np.asarray(values)[:, np.asarray(present)]


def _is_zero(term: AbstractTerm, record: Record) -> bool:
    return bool(np.all(_samples(term, record) == 0))


# Values too large to be squared are for the fit to refuse.
@np.errstate(over="ignore", invalid="ignore")
def _is_constant(term: AbstractTerm, record: Record) -> bool:
    """Whether a term without a derivative does not vary but for noise."""
    if term.derivative > 0:
        return False
    for samples in _samples(term, record):
        spread, mean = float(np.std(samples)), abs(float(np.mean(samples)))
        if spread > SMALL * mean or spread > max(2 * noise_level(samples), 1e-9 * mean):
            return False
    return True

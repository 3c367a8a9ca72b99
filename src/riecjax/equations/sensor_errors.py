"""Unknown offsets and gains of sensors, as coefficients of the equations that read them.

A sensor that shows `z = x + b` turns a term `k x` into `k z - k b`: a constant beside it. Where k
is a known number the offset b itself is the coefficient; where k is estimated too, only the product
`k b` is, in the unit of the equation. A sensor that shows `z = F / g` turns a known term `a F` into
`g a z`, of the coefficient g. Either way the equations stay linear, and are those of the signals as
measured: what is simulated of them is what the sensors would show.
"""

from collections.abc import Callable, Iterable
from typing import TypeGuard

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import constant, read_expression
from riecjax.equations.term import AbstractTerm, Term
from riecjax.errors import ModelError
from riecjax.records.signals import Signals


def with_unknown_offset(equations: Iterable[Equation], signal: str, unit: str) -> list[Equation]:
    """The same equations for a sensor of `signal` whose zero is unknown.

    A derivative of the signal has no offset. Coefficients are called `offset_SIGNAL`, in the
    signal's `unit`, where the term's own is known, else `k_offset_SIGNAL`, that is k times it.

    **Raises:** `ModelError` where no equation has a term of the signal itself, reads it in a
    function, or has a constant term already, from which no offset can be told apart.
    """

    def changed(equation: Equation) -> list[AbstractTerm]:
        _refuse_functions(equation, signal)
        own = [t for t in equation.terms if _is_of(t, signal) and t.derivative == 0]
        if not own:
            return []
        if taken := [n for t in equation.terms if t.of is constant for n in t.parameters]:
            raise ModelError(
                f"{equation.name}: an offset of '{signal}' cannot be told apart from '{taken[0]}', "
                f"which is constant too; give {signal}'s offset, or leave that term out."
            )
        if len(own) > 1:
            raise ModelError(f"{equation.name} has several terms of '{signal}'; add them up.")
        name = own[0].name
        label = f"offset_{signal}" if name is None else f"{name}_offset_{signal}"
        number = -own[0].number
        return [Term(label, constant, unit=unit if name is None else equation.unit, sign=number)]

    return _each(
        equations,
        lambda equation: [*equation.terms, *changed(equation)],
        f"no equation has a term of '{signal}' itself, so that none tells of its offset.",
    )


def with_unknown_gain(equations: Iterable[Equation], signal: str) -> list[Equation]:
    """The same equations for a sensor whose readings of `signal` are to be multiplied by
    `gain_SIGNAL`.

    **Raises:** `ModelError` where a term of the signal has a coefficient that is estimated too,
    where one reads it in a function, or where no equation reads it.
    """

    def changed(term: AbstractTerm) -> AbstractTerm:
        if not _is_of(term, signal):
            return term
        if term.name is not None:
            raise ModelError(
                f"the gain of '{signal}' cannot be told apart from '{term.name}', which multiplies "
                f"it: {term.name} comes out multiplied by the gain."
            )
        return Term(
            f"gain_{signal}",
            term.of,
            derivative=term.derivative,
            measured=term.measured,
            sign=term.number,
        )

    def terms(equation: Equation) -> list[AbstractTerm]:
        _refuse_functions(equation, signal)
        return list(map(changed, equation.terms))

    return _each(equations, terms, f"no equation reads '{signal}', so that none tells of its gain.")


def _is_of(term: AbstractTerm, signal: str) -> TypeGuard[Term]:
    return isinstance(term, Term) and term.of == signal


class _AnySignals(Signals):
    """Whatever signals are asked for, to see which these are."""

    def __getitem__(self, name: str) -> Array:
        self.read.add(name)
        return jnp.ones(4)


def _refuse_functions(equation: Equation, signal: str) -> None:
    """Refuse a function of the signal: in it, an offset or a gain is no coefficient."""
    for term in equation.terms:
        read = _AnySignals({})
        read_expression(term.of, read)
        if signal in read.read and not _is_of(term, signal):
            raise ModelError(
                f"{equation.name}: the term of {' and '.join(term.parameters) or 'no coefficient'} "
                f"is a function of '{signal}', in which an unknown offset or gain is no "
                f"coefficient of its own; calibrate that sensor."
            )


def _each(
    equations: Iterable[Equation], terms: Callable[[Equation], list[AbstractTerm]], unread: str
) -> list[Equation]:
    """Equations with other terms; an error where that changes none."""
    before = list(equations)
    after = [eqx.tree_at(lambda e: e.terms, one, tuple(terms(one))) for one in before]
    if all(a.parameters == b.parameters for a, b in zip(after, before)):
        raise ModelError(unread)
    return after

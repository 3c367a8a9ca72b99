"""Unknown zeros and gains of sensors, as coefficients of the equations that read them.

A sensor that shows `z = x + b` turns a term `k x` into `k z - k b`: a constant beside it. Where k
is a known number the zero b itself is the coefficient; where k is estimated too, only the product
`k b` is, in the unit of the equation. A sensor that shows `z = F / g` turns a known term `a F` into
`g a z`, of the coefficient g. Either way the equations stay linear, and are those of the signals as
measured: what is simulated of them is what the sensors would show.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import equinox as eqx

from riecjax.equations.element import Element
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import constant, signals_read
from riecjax.equations.term import AbstractTerm, Term
from riecjax.errors import ModelError, require


class SensorError(Element):
    """Something that a sensor gets wrong."""

    signal: str = eqx.field(static=True)
    meaning: ClassVar = "of a sensor"

    def __check_init__(self):
        example = f"rx.elements.{type(self).__name__}('F')"
        require("what a sensor shows", self.signal, str, example)

    def terms(self, equation: Equation) -> list[AbstractTerm]:
        """Terms of the signal.

        **Raises:** `ModelError` for a function that reads it.
        """
        for term in equation.terms:
            if self.signal in signals_read(term.of) and term.signal != self.signal:
                named = " and ".join(term.parameters) or "no coefficient"
                raise ModelError(
                    f"{equation.name}: the term of {named} is a function of '{self.signal}', in "
                    f"which an unknown offset or gain is no coefficient of its own; calibrate "
                    f"that sensor."
                )
        return [term for term in equation.terms if term.signal == self.signal]


class SensorZero(SensorError):
    """The unknown zero of a sensor: what it shows of nothing.

    A derivative of a signal has none. Its coefficient is called `offset_SIGNAL`, in the signal's
    unit, where the term's own is known, else `k_offset_SIGNAL`, that is k times it.

    **Arguments:** the `signal` that the sensor shows.

    **Raises:** `ModelError` where no equation has a term of the signal itself, or reads it in a
    function, and where it has a constant term already, from which no zero can be told apart.
    """

    kind: ClassVar = "zero"
    words: ClassVar = "the zero of a sensor"

    @classmethod
    def option(cls) -> str:
        """`--unknown-offset`."""
        return "--unknown-offset"

    @property
    def described(self) -> str:
        """`an unknown zero of F`."""
        return f"an unknown zero of {self.signal}"

    def require(self, equations: Sequence[Equation], others: Sequence[Element]) -> None:
        """Raise `ModelError` where no equation tells of it."""
        if not any(not term.derivative for e in equations for term in self.terms(e)):
            raise ModelError(
                f"no equation has a term of '{self.signal}' itself, so that none tells of its "
                f"offset."
            )

    def in_equation(self, equation: Equation, units: Mapping[str, str]) -> Equation:
        """The equation with a constant beside its term of the signal."""
        own = [term for term in self.terms(equation) if not term.derivative]
        if not own:
            return equation
        if taken := [n for t in equation.terms if t.of is constant for n in t.parameters]:
            raise ModelError(
                f"{equation.name}: an offset of '{self.signal}' cannot be told apart from "
                f"'{taken[0]}', which is constant too; give {self.signal}'s offset, or leave that "
                f"term out."
            )
        if len(own) > 1:
            raise ModelError(f"{equation.name} has several terms of '{self.signal}'; add them up.")
        (term,) = own
        name, unit = f"offset_{self.signal}", units.get(self.signal) or str(term.unit)
        if term.name is not None:
            name, unit = f"{term.name}_{name}", equation.unit
        return equation.of_terms(
            *equation.terms, Term(name, constant, unit=unit, sign=-term.factor)
        )


class SensorGain(SensorError):
    """The unknown gain of a sensor: the factor by which its readings are to be multiplied.

    Its coefficient is called `gain_SIGNAL`.

    **Arguments:** the `signal` that the sensor shows.

    **Raises:** `ModelError` where no equation reads the signal, or one in a function, and where a
    term of it has a coefficient that is estimated too.
    """

    kind: ClassVar = "gain"
    words: ClassVar = "the gain of a sensor"

    @classmethod
    def option(cls) -> str:
        """`--unknown-gain`."""
        return "--unknown-gain"

    @property
    def described(self) -> str:
        """`an unknown gain of F`."""
        return f"an unknown gain of {self.signal}"

    def require(self, equations: Sequence[Equation], others: Sequence[Element]) -> None:
        """Raise `ModelError` where no equation tells of it."""
        if not any(self.terms(equation) for equation in equations):
            raise ModelError(f"no equation reads '{self.signal}', so that none tells of its gain.")

    def in_equation(self, equation: Equation, units: Mapping[str, str]) -> Equation:
        """The equation with the gain for a coefficient of each term of the signal."""
        own = self.terms(equation)
        if named := [term.name for term in own if term.name is not None]:
            raise ModelError(
                f"the gain of '{self.signal}' cannot be told apart from '{named[0]}', which "
                f"multiplies it: {named[0]} comes out multiplied by the gain."
            )

        def with_gain(term: AbstractTerm) -> AbstractTerm:
            gain = Term(f"gain_{self.signal}", term.of, sign=term.factor)
            return gain.with_fields(derivative=term.derivative, measured=term.measured)

        return equation.of_terms(
            *(with_gain(t) if t.signal == self.signal else t for t in equation.terms)
        )

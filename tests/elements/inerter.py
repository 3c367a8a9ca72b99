"""An element of somebody else: an inerter between two bodies (Smith 2002)."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import equinox as eqx

import riecjax as rx


class Inerter(rx.Element):
    """A device whose force is the inertance b times the acceleration across it.

    **Arguments:** `between`, the velocities of both bodies, as `v1-v2`.
    """

    between: str = eqx.field(static=True)
    kind: ClassVar = "inerter"
    meaning: ClassVar = "inertance"

    @property
    def described(self) -> str:
        """`an inerter between v1 and v2`."""
        return f"an inerter between {' and '.join(self.between.split('-'))}"

    def require(self, equations: Sequence[rx.Equation], others: Sequence[rx.Element]) -> None:
        """Raise `ModelError` for a body that no equation accelerates."""
        for body in self.between.split("-"):
            if not any(equation.inertia_of(body) for equation in equations):
                raise rx.ModelError(f"no equation accelerates {body}.")

    def in_equation(self, equation: rx.Equation, units: Mapping[str, str]) -> rx.Equation:
        """The equation of a body with b (a - a'), of the other's acceleration a'."""
        for body, other in (pair := self.between.split("-"), pair[::-1]):
            if inertia := equation.inertia_of(body):
                own = rx.Term("b", body, derivative=1, unit="kg", sign=inertia.factor)
                return equation.of_terms(*equation.terms, own, -own.with_fields(of=other))
        return equation

"""Springs in series with force elements, which an equation leaves out.

A damper pulls through its bushings, whose spring K gives way: of the velocity v across both, the
damper's own is v - f' / K, with f the force that both carry. So the force follows late, by c / K
for a linear damper c. Where windows are long beside that, it is a share of some percent of a
damper's force; where they are not, it bends masses and maps that have to make up for it.
"""

from collections.abc import Iterable

import equinox as eqx

from riecjax.equations.equation import Equation
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.errors import require

KNOWN_UNITS = {"N s/m": "N/m", "N": "N/m", "N m s/rad": "N m/rad", "N m": "N m/rad"}
"""Unit of a spring by that of the element's coefficients."""


class SeriesSpring(eqx.Module):
    """A spring in series with a force element, a Maxwell element.

    Its stiffness `K_series`, of a further one `K_series_2`, is a parameter of every equation that
    holds the element. It makes the equation nonlinear in its parameters: they are found by
    [`refine`][riecjax.refine], started from what [`identify`][riecjax.identify] finds without it.

    **Arguments:** `of`, the element: the name of its coefficient, or of one of its basis, as `F_1`
    of a damper's map.
    """

    of: str = eqx.field(static=True)

    def __check_init__(self):
        require("what a spring is in series with", self.of, str, "rx.SeriesSpring(of='c')")

    def element(self, equation: Equation) -> AbstractTerm | None:
        """The element's term in an equation, if it has one."""
        return next((term for term in equation.terms if self.of in term.parameters), None)

    def unit(self, equations: Iterable[Equation]) -> str:
        """Unit of the stiffness, by that of the element's coefficient."""
        named = [e.units[self.of] for e in equations if self.of in e.units]
        return KNOWN_UNITS.get(named[0], "") if named else ""


def stiffness_name(number: int) -> str:
    """Of the spring with this number, from 0."""
    return "K_series" if number == 0 else f"K_series_{number + 1}"


def element_sign(element: AbstractTerm):
    """What an element's force is multiplied by in its equation."""
    assert isinstance(element, Term | Terms)
    return element.number if isinstance(element, Term) else element.sign

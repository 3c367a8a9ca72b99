"""Springs in series with force elements, which an equation leaves out.

A damper pulls through its bushings, whose spring K gives way: of the velocity v across both, the
damper's own is v - f' / K, with f the force that both carry. So the force follows late, by c / K
for a linear damper c. Where windows are long beside that, it is a share of some percent of a
damper's force; where they are not, it bends masses and maps that have to make up for it.

A linear element c v with its spring is c / (1 + tau s) v, tau = c / K, s standing for d/dt. An
equation times 1 + tau s is linear again in its coefficients: the terms gain a derivative each but
for the element's own. Of a map F(v) no multiplication rids the equation, since F(v - f' / K) is not
linear in K.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import constant
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.errors import require
from riecjax.leaves import Leaf

KNOWN_UNITS = {"N s/m": "N/m", "N": "N/m", "N m s/rad": "N m/rad", "N m": "N m/rad"}
"""Unit of a spring by that of the element's coefficients."""
MASSES, STIFFNESSES = ("kg", "kg m^2"), ("N/m", "N m/rad")
"""Units of coefficients whose terms are no force elements."""


class SeriesSpring(eqx.Module):
    """A spring in series with a force element, a Maxwell element.

    Its stiffness `K_series`, of a further one `K_series_2`, is a parameter of every equation that
    holds the element. In series with a `Term` it is found by [`identify`][riecjax.identify]; with a
    map, as of a damper, the equation is not linear in its parameters, and they are found by
    [`refine`][riecjax.refine], started from what `identify` finds without the spring.

    **Arguments:** `of`, the element, a damper: the name of its coefficient, or of one of its basis,
    as `F_1` of a damper's map.

    **Raises:** `ModelError` for what is no name.
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


class SpringParameters(NamedTuple):
    """Names of a linear element's coefficient and of the stiffness in series with it."""

    coefficient: str
    stiffness: str

    @classmethod
    def of(cls, number: int, spring: SeriesSpring) -> "SpringParameters":
        """Of the spring with this number, from 0."""
        return cls(spring.of, stiffness_name(number))

    @property
    def linear(self) -> str:
        """The parameter that the force is proportional to, for a given lag."""
        return self.coefficient

    @property
    def order(self) -> int:
        """Of the polynomial D, which has as many coordinates in a search."""
        return 1

    @property
    def judged(self) -> tuple[str, ...]:
        """Parameters that are positive, and sure, where such an element is found."""
        return (self.stiffness,)

    def doubted(self, values: Mapping[str, Array], band: tuple[Leaf, Leaf]) -> Float[Array, "1"]:
        """The error of the stiffness that counts as one: that of a lag by 1 / band[1] seconds.

        From tau = c / K follows d tau = -tau dK / K.
        """
        lag = jnp.abs(self.shape(values).tau)
        return jnp.stack([values[self.stiffness] / (lag * jnp.asarray(band[1]))])

    def shape(self, values: Mapping[str, Array]) -> "Lag":
        """The lag with these values."""
        return Lag(values[self.coefficient] / values[self.stiffness])

    @staticmethod
    def shape_at(at: Float[Array, "1"] | None) -> "Lag":
        """Of the logarithm of the corner 1 / (2 pi tau) in hertz; `None`: rigid."""
        return Lag(jnp.zeros(()) if at is None else jnp.exp(-at[0]) / (2 * jnp.pi))

    def values_at(self, at: Float[Array, "1"], values: Mapping[str, Array]) -> dict[str, Array]:
        """The stiffness of the lag there, the coefficient being among the values."""
        return {self.stiffness: values[self.coefficient] / self.shape_at(at).tau}


class Lag(NamedTuple):
    """Polynomials 1 and D = 1 + tau s of an element that follows late, by tau = c / K in s."""

    tau: Array

    @property
    def numerator(self) -> Float[Array, "2"]:
        """Coefficients, lowest first."""
        return jnp.stack([jnp.ones_like(self.tau), jnp.zeros_like(self.tau)])

    @property
    def denominator(self) -> Float[Array, "2"]:
        """Coefficients of D, lowest first."""
        return jnp.stack([jnp.ones_like(self.tau), self.tau])

    @property
    def decay(self) -> Array:
        """Seconds in which what is free falls to 1 / e: it is exp(-t / tau)."""
        return self.tau


def why_no_element(term: AbstractTerm, equations: Iterable[Equation]) -> str:
    """Why a spring in series with a term makes no force late; empty where it may.

    A term's unit tells, and where it has none its derivative: of a signal x that some term
    differentiates twice, x' is a velocity; of another one x' may as well be an acceleration.
    """
    units = set(term.units.values())
    twice = {t.of for e in equations for t in e.terms if t.derivative == 2}
    guessed = term.derivative == 1 and isinstance(term.of, str) and term.of not in twice
    guessed = guessed and units == {""}
    if term.of is constant:
        return "is a constant, whose force never follows anything"
    if term.derivative == 2 or units <= {*MASSES} or guessed:
        unless = " (a damper's term says so by its unit: unit='N s/m')" if guessed else ""
        return f"is of an acceleration, a mass, whose force no spring makes late{unless}"
    if units <= {*STIFFNESSES} or (term.derivative == 0 and term.of in twice):
        return (
            "is of a position, a stiffness: with a spring in series it is only a softer spring, "
            "and no recording tells the two apart"
        )
    return ""


def force_elements(
    equations: Sequence[Equation], among: Sequence[Equation]
) -> dict[str, Term | Terms]:
    """Unknown terms of some equations that a spring may be in series with, by their first
    coefficient; `equations` are all of the model, which tell what is a velocity."""
    terms = (t for e in among for t in e.terms if isinstance(t, Term | Terms) and t.parameters)
    return {t.parameters[0]: t for t in terms if not why_no_element(t, equations)}


def stiffness_name(number: int) -> str:
    """Of the spring with this number, from 0."""
    return "K_series" if number == 0 else f"K_series_{number + 1}"


def is_stiffness_name(name: str) -> bool:
    """Whether a parameter is called as springs are."""
    first = stiffness_name(0)
    return name == first or name.removeprefix(f"{first}_").isdigit()


def element_sign(element: AbstractTerm):
    """What an element's force is multiplied by in its equation."""
    assert isinstance(element, Term | Terms)
    return element.number if isinstance(element, Term) else element.sign

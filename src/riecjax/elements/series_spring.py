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

from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.equations.bases import RoofFunctions
from riecjax.equations.element import (
    Absence,
    Attached,
    Band,
    CarriedState,
    Element,
    Shape,
    Values,
)
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import constant, label_of, signals_read
from riecjax.equations.quantity import Quantity
from riecjax.equations.term import AbstractTerm, Term
from riecjax.errors import ModelError, require, users_code
from riecjax.leaves import Leaf
from riecjax.records.record import Signals

KNOWN_UNITS = {"N s/m": "N/m", "N": "N/m", "N m s/rad": "N m/rad", "N m": "N m/rad"}
"""Unit of a spring by that of the element's coefficients."""
MASSES, STIFFNESSES = ("kg", "kg m^2"), ("N/m", "N m/rad")
"""Units of coefficients whose terms are no force elements."""
LEAST_SLOPE = 0.01
"""Of a map, as a share of its mean slope."""
TOLD_LAG = 8
"""Standard errors from which on a lag is told from none, and its inverse has an interval.

Of c / (1 + tau s) v = c v - c tau v' + c tau^2 v'' - ... a mass beside the damper takes up the
second term, so that tau^2 is what is told of. Its error is 2 tau times tau's: 8 of these are 4 of
its own.
"""


class SeriesSpring(Element):
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
    kind: ClassVar = "spring"
    words: ClassVar = "the spring in series"
    order: ClassVar = 1
    coordinates: ClassVar = 1
    is_discovered: ClassVar = True
    absence: ClassVar = Absence(
        "series_spring_not_carried",
        TOLD_LAG,
        "the lag behind {name} is {away:.2g} standard errors away from none: any stiffer spring "
        "would do, whatever the interval says. Leave it out.",
    )

    def __check_init__(self):
        require("what a spring is in series with", self.of, str, "rx.SeriesSpring(of='c')")

    @classmethod
    def option(cls) -> str:
        """`--add-spring`."""
        return "--add-spring"

    @classmethod
    def places(cls, equation: Equation, equations: Sequence[Equation]) -> tuple[str, ...]:
        """First coefficients of an equation's force elements."""
        return tuple(force_elements(equations, [equation]))

    @classmethod
    def suggested(
        cls, equation: Equation, equations: Sequence[Equation], others: Sequence[Element]
    ) -> Element | None:
        """In series with a force element of an equation that has no spring, a linear one first."""
        sprung = {spring.of for spring in others if isinstance(spring, cls)}
        elements = force_elements(equations, [equation])
        free = [t for t in elements.values() if sprung.isdisjoint(t.parameters)]
        best = min(free, key=lambda term: not term.is_linear, default=None)
        return None if best is None else cls(best.parameters[0])

    @property
    def to_find(self) -> str:
        """What to do to find it, in words."""
        return "Find a spring in series with a damper, which the model leaves out"

    @property
    def described(self) -> str:
        """`a spring in series with c`."""
        return f"a spring in series with {self.of}"

    def require(self, equations: Sequence[Equation], others: Sequence[Element]) -> None:
        """Raise `ModelError` for what is no one force element, or has such a spring already."""
        every = [t for e in equations for t in e.terms if self.of in t.parameters]
        if not every:
            names = dict.fromkeys(name for equation in equations for name in equation.parameters)
            raise ModelError(
                f"no equation has a coefficient '{self.of}' that a spring could be in series "
                f"with; there are: {', '.join(names)}."
            )
        springs = [other.of for other in others if isinstance(other, SeriesSpring)]
        if not {*springs}.isdisjoint(every[0].parameters):
            raise ModelError(f"'{self.of}' has a spring in series already.")
        if any((t.of, t.derivative) != (every[0].of, every[0].derivative) for t in every):
            raise ModelError(
                f"{self.of} is of other signals in one term than in another, so that it is "
                f"no one element that a spring could be in series with."
            )
        if wrong := why_no_element(every[0], equations):
            fitting = force_elements(equations, equations)
            raise ModelError(
                f"'{self.of}' {wrong}. A spring is in series with a damper, a term of a "
                f"velocity or a map of one: {', '.join(fitting) or 'no equation has any'}."
            )

    def require_known(self, given: Values) -> None:
        """Raise `ModelError` where its stiffness is given alone."""
        if self.stiffness in given and self.of not in given:
            raise ModelError(
                f"of a spring in series {self.stiffness} is known only where {self.of} is; "
                f"leave it out, or give both."
            )

    def require_linear(self, equations: Sequence[Equation]) -> None:
        """Raise `ModelError` where it is in series with a map."""
        if any((term := self.term_in(e)) and not term.is_linear for e in equations):
            raise ModelError(
                f"a spring in series with the map of '{self.of}' makes the model nonlinear in "
                f"its parameters: identify it without (on the command line: without --add-spring), "
                f"and refine it from there, in Python: rx.refine(model, record, "
                f"{{**estimate.values, '{self.stiffness}': stiff}}, rx.OutputError())."
            )

    @property
    def linear(self) -> str:
        """The coefficient of what it is in series with."""
        return self.of

    @property
    def stiffness(self) -> str:
        """The name of the stiffness in series with it."""
        return self.named("K_series")

    @property
    def hidden(self) -> tuple[str, ...]:
        """The stiffness."""
        return (self.stiffness,)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the element's coefficient and of the stiffness."""
        return self.of, self.stiffness

    def quantities(self, equations: Sequence[Equation]) -> list[Quantity]:
        """The stiffness, in a unit by the element's coefficient."""
        named = [e.units[self.of] for e in equations if self.of in e.units]
        unit = KNOWN_UNITS.get(named[0], "") if named else ""
        return [Quantity(self.stiffness, unit, "spring in series")]

    def doubted(self, values: Values, band: Band) -> Float[Array, "1"]:
        """The error of the stiffness that counts as one: that of a lag by 1 / band[1] seconds.

        From tau = c / K follows d tau = -tau dK / K. Relative errors of lags would choose the
        lengths of windows in which noise looks like one.
        """
        lag = xp.abs(values[self.of] / values[self.stiffness])
        return xp.stack([values[self.stiffness] / (lag * band[1])])

    def shape(self, values: Values) -> Shape:
        """The lag with these values."""
        return Shape.filtering(values[self.of] / values[self.stiffness])

    def shape_at(self, at: Float[Array, "1"] | None) -> Shape:
        """Of the logarithm of the corner 1 / (2 pi tau) in hertz; `None`: rigid."""
        return Shape.filtering(np.zeros(()) if at is None else xp.exp(-at[..., 0]) / (2 * np.pi))

    def values_at(self, at: Float[Array, "1"], values: Values) -> dict[str, Array]:
        """The stiffness of the lag there, the coefficient being among the values."""
        return {self.stiffness: values[self.of] / self.shape_at(at).denominator[..., 1]}

    def band(self, longest: Leaf, step: Leaf) -> Band:
        """Corners in hertz: a lag, which shows below its corner, is looked for down to a sixth of a
        sample."""
        return 0.5 / longest, 1 / step

    def moved(self, equation: Equation, values: Values, following: Any) -> Equation:
        """The equation whose element reads what passes 1 / (1 + tau s).

        **Raises:** `ModelError` for a map.
        """
        terms = list(equation.terms)
        for i, term in enumerate(terms):
            if self.of not in term.parameters:
                continue
            if not term.is_linear:
                raise ModelError(
                    f"what the map of '{self.of}' does behind its spring is not known from the "
                    f"motion across both alone: simulate the model, "
                    f"rx.validation.validate_held_out."
                )
            of, *measured = following(term, f"behind {self.stiffness}", self.shape(values))
            terms[i] = term.with_fields(of=of, measured=tuple(measured))
        return equation.of_terms(*terms)

    def attached(self, equations: tuple[Equation, ...]) -> Attached:
        """Equations with the force of both, a state, in the element's place.

        **Raises:** `ModelError` for an element whose law has no inverse that is known.
        """
        first, unit = next((t, e.unit) for e in equations if (t := self.term_in(e)) is not None)
        if not (first.is_linear or isinstance(first.basis, RoofFunctions)):
            raise ModelError(
                f"a spring in series with {first.name} needs the inverse of its law, which is "
                f"known of one coefficient and of roof functions (rx.roof) only."
            )
        force = SpringForce(f"{self.named('series')}_force", unit, "", first, self.stiffness)
        placed = {*first.parameters}

        def with_force(equation: Equation) -> Equation:
            terms = (
                Term(t.factor, force.name) if placed & {*t.parameters} else t
                for t in equation.terms
            )
            return equation.of_terms(*terms)

        return Attached(tuple(map(with_force, equations)), {}, (force,))


def why_no_element(term: AbstractTerm, equations: Iterable[Equation]) -> str:
    """Why a spring in series with a term makes no force late; empty where it may.

    A term's unit tells, and where it has none its derivative: of a signal x that some term
    differentiates twice, x' is a velocity; of another one x' may as well be an acceleration.
    """
    units = set(term.units.values())
    if not term.is_linear and term.basis is None:
        return "is a function of a kind that no spring's force is known of"
    twice = {t.of for e in equations for t in e.terms if t.derivative == 2}
    guessed = term.derivative == 1 and term.signal is not None and term.signal not in twice
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
) -> dict[str, AbstractTerm]:
    """Unknown terms of some equations that a spring may be in series with, by their first
    coefficient; `equations` are all of the model, which tell what is a velocity."""
    terms = (t for e in among for t in e.terms if t.parameters)
    return {t.parameters[0]: t for t in terms if not why_no_element(t, equations)}


class SpringForce(CarriedState):
    """The force of a force element with a spring in series, as a state of a simulation.

    With f the force of both, v the velocity across them and v_in(f) that across the element alone,

        f' = K (v - v_in(f)),

    v_in being the inverse of the element's law: f / c of a linear one, and of a piecewise linear
    map through (v_i, F_i) the map through (F_i, v_i). The law must rise; where values tried on the
    way to an answer do not, a least slope stands in for them.

    **Further field:** `stiffness`, the name of the spring's parameter.
    """

    stiffness: str = eqx.field(static=True, default="")

    def rate(self, signals: Values, values: Values, read: Array) -> Array:
        """Time derivative of the force, with the velocity across both."""
        force, (points, forces) = signals[self.name], self._law(values)
        if points is None:
            inner = force / forces[0]
        else:
            inner = RoofFunctions(forces).interpolate(points, force)
        return values[self.stiffness] * (read - inner)

    def at_rest(self, signals: Values, values: Values) -> dict[str, Array]:
        """The force at a velocity that does not change, where signals tell it: the spring takes up
        none of it."""
        assert self.term is not None
        of = self.term.of
        if self.term.derivative or not set(signals_read(of)) <= signals.keys():
            return {}
        with users_code(f"the expression {label_of(of)}"):
            across = signals[of] if isinstance(of, str) else of(Signals(dict(signals)))
        velocity, (points, forces) = xp.asarray(across), self._law(values)
        if points is None:
            return {self.name: forces[0] * velocity}
        return {self.name: RoofFunctions(points).interpolate(forces, velocity)}

    def why_not(self, values: Values) -> str:
        """Where its element, being linear, is zero."""
        assert self.term is not None
        (which, *_), law = self.term.parameters, self.term
        no_force = law.is_linear and float(values[which]) == 0
        return f"{which}, a spring in series, is zero" if no_force else ""

    def _law(
        self, values: Values
    ) -> tuple[Float[Array, " points"] | None, Float[Array, " points"]]:
        """Break points of the element's law and forces there; of a linear one, `None` and its
        coefficient. Where the map does not rise it has a least slope."""
        assert self.term is not None
        basis, forces = self.term.basis, xp.stack([values[n] for n in self.term.parameters])
        if not isinstance(basis, RoofFunctions):
            return None, forces
        at = basis.points
        mean = xp.abs((forces[-1] - forces[0]) / (at[-1] - at[0]))
        least = LEAST_SLOPE * xp.where(mean > 0, mean, 1.0) * xp.diff(at)
        rises = xp.maximum(xp.diff(forces), least)
        return at, forces[0] + xp.concatenate([np.zeros(1, forces.dtype), xp.cumsum(rises)])

"""Oscillators that an equation leaves out, and what they make of its terms.

A mass M on a spring K and a damper B, carried by a body with velocity v, adds to the body's
equation of motion the force that moves the mass,

    M (1 + q s) / D v',    D = 1 + q s + p s^2,    q = B / K,  p = M / K,

s standing for d/dt. The state of the mass is not recorded. Multiplied by D the equation is linear
again in the coefficients theta, of known target y and columns a,

    D y = sum_j theta_j D a_j + M (1 + q s) a_v,

with every term at derivatives 0 to 2 higher, which a smooth test function takes off. Its columns
for any mode are combinations of the same few, so that one Gram matrix holds all. With several
modes D is the product of theirs, and each mode's own column has those of the others in front.

D is 1 at rest, so that the equation keeps its unit, and for a stiff mode it is the equation as it
was: M then joins the body's mass.

A spring in series with a linear element is a hidden element of the same form (see
below): c a becomes c N / D a with N = 1 and D = 1 + tau s, where a mode adds M N / D a.

Springs in series with force elements, which an equation leaves out.

A damper pulls through its bushings, whose spring K gives way: of the velocity v across both, the
damper's own is v - f' / K, with f the force that both carry. So the force follows late, by c / K
for a linear damper c. Where windows are long beside that, it is a share of some percent of a
damper's force; where they are not, it bends masses and maps that have to make up for it.

A linear element c v with its spring is c / (1 + tau s) v, tau = c / K, s standing for d/dt. An
equation times 1 + tau s is linear again in its coefficients: the terms gain a derivative each but
for the element's own. Of a map F(v) no multiplication rids the equation, since F(v - f' / K) is not
linear in K.
"""

import functools
import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.equations.bases import RoofFunctions
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import (
    Expression,
    constant,
    difference,
    label_of,
    signals_read,
)
from riecjax.equations.quantity import Quantity
from riecjax.equations.term import AbstractTerm, Column, Term
from riecjax.errors import ModelError, require, users_code
from riecjax.leaves import Leaf, is_number
from riecjax.records.record import Record, Signals
from riecjax.records.signal import Signal

KNOWN_UNITS = {"N s/m": "N/m", "N": "N/m", "N m s/rad": "N m/rad", "N m": "N m/rad"}
"""Unit of a spring by that of the element's coefficients."""
Values = Mapping[str, Array]
MASSES, STIFFNESSES = ("kg", "kg m^2"), ("N/m", "N m/rad")
"""Units of coefficients whose terms are no force elements."""


def _ending(number: int) -> str:
    """Of the names that an element with this number has, from 0: `_2` of the second."""
    return "" if number == 0 else f"_{number + 1}"


class Shape(NamedTuple):
    """Polynomials N and D in s, their coefficients lowest first, by which an element follows.

    **Fields:** `numerator`, filled up with zeros to the length of the `denominator`.
    """

    numerator: Float[Array, "*shapes powers"]
    denominator: Float[Array, "*shapes powers"]

    @classmethod
    def of_mode(cls, p: Array, q: Array) -> "Shape":
        """1 + q s and 1 + q s + p s^2: p = M / K in s^2, q = B / K in s."""
        one, none = xp.ones_like(p), xp.zeros_like(p)
        return cls(*(xp.stack([one, q, last], axis=-1) for last in (none, p)))

    @classmethod
    def of_lag(cls, tau: Array) -> "Shape":
        """1 and 1 + tau s of an element that follows late, by tau = c / K in s."""
        one, none = xp.ones_like(tau), xp.zeros_like(tau)
        return cls(*(xp.stack([one, last], axis=-1) for last in (none, tau)))

    @property
    def decay(self) -> Array:
        """Seconds in which what is free falls to 1 / e, by exp(-t / tau) or exp(-q t / (2 p))."""
        _, q, *p = self.denominator
        return xp.where(q > 0, 2 * p[0] / xp.where(q > 0, q, 1.0), xp.inf) if p else q


class SeriesSpring(eqx.Module):
    """A spring in series with a force element, a Maxwell element.

    Its stiffness `K_series`, of a further one `K_series_2`, is a parameter of every equation that
    holds the element. In series with a `Term` it is found by [`identify`][riecjax.identify]; with a
    map, as of a damper, the equation is not linear in its parameters, and they are found by
    [`refine`][riecjax.refine], started from what `identify` finds without the spring.

    **Arguments:** `of`, the element, a damper: the name of its coefficient, or of one of its basis,
    as `F_1` of a damper's map; `number` among a model's springs, from 0, which the model gives it.

    **Raises:** `ModelError` for what is no name.
    """

    of: str = eqx.field(static=True)
    number: int = eqx.field(static=True, default=0)
    order: ClassVar = 1
    """Of the polynomial D, which has as many coordinates in a search."""
    words: ClassVar = "the spring in series"
    option: ClassVar = "--add-spring"

    def __check_init__(self):
        require("what a spring is in series with", self.of, str, "rx.SeriesSpring(of='c')")

    @property
    def linear(self) -> str:
        """The parameter that the force is proportional to, for a given lag: the coefficient."""
        return self.of

    @property
    def stiffness(self) -> str:
        """The name of the stiffness in series with it."""
        return f"K_series{_ending(self.number)}"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the element's coefficient and of the stiffness."""
        return self.of, self.stiffness

    @property
    def hidden(self) -> tuple[str, ...]:
        """Those that are no coefficient of the equations."""
        return (self.stiffness,)

    judged = hidden
    """Parameters that are positive, and sure, where such an element is found."""

    def doubted(self, values: Values, band: tuple[Leaf, Leaf]) -> Float[Array, "1"]:
        """The error of the stiffness that counts as one: that of a lag by 1 / band[1] seconds.

        From tau = c / K follows d tau = -tau dK / K.
        """
        lag = xp.abs(values[self.of] / values[self.stiffness])
        return xp.stack([values[self.stiffness] / (lag * band[1])])

    def shape(self, values: Values) -> Shape:
        """The lag with these values."""
        return Shape.of_lag(values[self.of] / values[self.stiffness])

    @staticmethod
    def shape_at(at: Float[Array, "1"] | None) -> Shape:
        """Of the logarithm of the corner 1 / (2 pi tau) in hertz; `None`: rigid."""
        tau = np.zeros(()) if at is None else xp.exp(-at[..., 0]) / (2 * np.pi)
        return Shape.of_lag(tau)

    def values_at(self, at: Float[Array, "1"], values: Values) -> dict[str, Array]:
        """The stiffness of the lag there, the coefficient being among the values."""
        return {self.stiffness: values[self.of] / self.shape_at(at).denominator[..., 1]}

    def term_in(self, equation: Equation) -> AbstractTerm | None:
        """The element's term in an equation, if it has one."""
        return next((term for term in equation.terms if self.of in term.parameters), None)

    def quantities(self, equations: Sequence[Equation]) -> list[Quantity]:
        """The stiffness, in a unit by the element's coefficient."""
        named = [e.units[self.of] for e in equations if self.of in e.units]
        unit = KNOWN_UNITS.get(named[0], "") if named else ""
        return [Quantity(self.stiffness, unit, "spring in series")]


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


class HiddenState(NamedTuple):
    """A state of a hidden element: `name`, `unit`, and the signal that it `follows` at rest, if it
    does."""

    name: str
    unit: str
    follows: str = ""


LEAST_SLOPE = 0.01
"""Of a map, as a share of its mean slope."""


class SpringElement(eqx.Module):
    """A force element with a spring in series, whose force is a state of a simulation.

    With f the force of both, v the velocity across them and v_in(f) that across the element alone,

        f' = K (v - v_in(f)),

    v_in being the inverse of the element's law: f / c of a linear one, and of a piecewise linear
    map through (v_i, F_i) the map through (F_i, v_i). The law must rise; where values tried on the
    way to an answer do not, a least slope stands in for them.

    **Fields:** `element`, its term; `state`, its force; `stiffness`, the name of the spring's
    parameter.
    """

    element: AbstractTerm
    state: HiddenState = eqx.field(static=True)
    stiffness: str = eqx.field(static=True)

    @classmethod
    def of(cls, spring: SeriesSpring, equations: Sequence[Equation]) -> "SpringElement":
        """Of a spring that some of the equations have.

        **Raises:** `ModelError` for an element whose law has no inverse that is known.
        """
        first, force = next((t, e.unit) for e in equations if (t := spring.term_in(e)) is not None)
        if not (first.is_linear or isinstance(first.basis, RoofFunctions)):
            raise ModelError(
                f"a spring in series with {first.name} needs the inverse of its law, which is "
                f"known of one coefficient and of roof functions (rx.roof) only."
            )
        state = HiddenState(f"series{_ending(spring.number)}_force", force)
        return cls(first, state, spring.stiffness)

    def written_out(self, equation: Equation) -> Equation:
        """The equation with the force in the element's place."""
        placed, force = {*self.element.parameters}, self.state.name
        return equation.of_terms(
            *(Term(t.factor, force) if placed & {*t.parameters} else t for t in equation.terms)
        )

    def rate(self, signals: Values, values: Values, across: Array) -> Array:
        """Time derivative of the force, with the velocity across both."""
        force, (points, forces) = signals[self.state.name], self._law(values)
        if points is None:
            inner = force / forces[0]
        else:
            inner = RoofFunctions(forces).interpolate(points, force)
        return values[self.stiffness] * (across - inner)

    def at_rest(self, signals: Values, values: Values) -> dict[str, Array]:
        """The force at a velocity that does not change, where signals tell it: the spring takes up
        none of it."""
        of = self.element.of
        if self.element.derivative or not set(signals_read(of)) <= signals.keys():
            return {}
        with users_code(f"the expression {label_of(of)}"):
            across = signals[of] if isinstance(of, str) else of(Signals(dict(signals)))
        velocity, (points, forces) = xp.asarray(across), self._law(values)
        if points is None:
            return {self.state.name: forces[0] * velocity}
        return {self.state.name: RoofFunctions(points).interpolate(forces, velocity)}

    def _law(
        self, values: Values
    ) -> tuple[Float[Array, " points"] | None, Float[Array, " points"]]:
        """Break points of the element's law and forces there; of a linear one, `None` and its
        coefficient. Where the map does not rise it has a least slope."""
        basis, forces = self.element.basis, xp.stack([values[n] for n in self.element.parameters])
        if not isinstance(basis, RoofFunctions):
            return None, forces
        at = basis.points
        mean = xp.abs((forces[-1] - forces[0]) / (at[-1] - at[0]))
        least = LEAST_SLOPE * xp.where(mean > 0, mean, 1.0) * xp.diff(at)
        rises = xp.maximum(xp.diff(forces), least)
        return at, forces[0] + xp.concatenate([np.zeros(1, forces.dtype), xp.cumsum(rises)])


TARGET = "target"
"""What a known term is called once it is differentiated."""


class HiddenMode(eqx.Module):
    """An oscillator that a model leaves out, on the body whose velocity is named.

    Its mass `M_mode`, stiffness `K_mode` and damping `B_mode` are parameters of every equation that
    holds the derivative of that velocity; a further mode's end in `_2`, `_3`.

    **Arguments:** `on`, the signal: a velocity of which a term holds the first derivative, or a
    position of which one holds the second; `hz`, near which frequency in hertz to look, everywhere
    if it is not given; `number` among a model's modes, from 0, which the model gives it.

    **Raises:** `ModelError` for a frequency that is not positive.
    """

    on: str = eqx.field(static=True)
    hz: float | None = eqx.field(static=True, default=None)
    number: int = eqx.field(static=True, default=0)
    order: ClassVar = 2
    """Of the polynomial D, which has as many coordinates in a search."""
    words: ClassVar = "the hidden mode"
    option: ClassVar = "--add-mode"

    def __check_init__(self):
        require("what a hidden mode is on", self.on, str, "rx.HiddenMode(on='x4'), a signal")
        if self.hz is not None and not (
            is_number(self.hz) and np.isfinite(self.hz) and self.hz > 0
        ):
            raise ModelError(f"a mode's frequency is a positive number of hertz; got {self.hz}.")

    def term_in(self, equation: Equation) -> AbstractTerm | None:
        """The term of an equation that accelerates the body, if it has one."""
        for term in equation.terms:
            velocity = term.measured[0] if term.measured else f"d{term.signal}"
            if term.signal is not None and (
                (term.derivative == 1 and term.signal == self.on)
                or (term.derivative == 2 and self.on in (term.signal, velocity))
            ):
                return term
        return None

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of mass, stiffness and damping."""
        return tuple(f"{part}_mode{_ending(self.number)}" for part in "MKB")

    hidden = parameters
    """Those that are no coefficient of the equations."""

    @property
    def linear(self) -> str:
        """The parameter that the force is proportional to, for a given shape: the mass."""
        return self.parameters[0]

    @property
    def stiffness(self) -> str:
        """The name of the stiffness."""
        return self.parameters[1]

    @property
    def judged(self) -> tuple[str, ...]:
        """Parameters that are positive, and sure, where such an element is found."""
        return self.parameters[:2]

    def doubted(self, values: Values, band: tuple[Leaf, Leaf]) -> Float[Array, "2"]:
        """Errors of what is judged that count as one: its values."""
        return xp.stack([values[name] for name in self.judged])

    def shape(self, values: Values) -> Shape:
        """Of p and q with these values."""
        mass, stiffness, damping = (values[name] for name in self.parameters)
        return Shape.of_mode(mass / stiffness, damping / stiffness)

    @staticmethod
    def shape_at(at: Float[Array, "2"] | None) -> Shape:
        """Of the logarithm of the frequency in hertz and the damping ratio; `None`: rigid."""
        if at is None:
            return Shape.of_mode(np.zeros(()), np.zeros(()))
        rate = 2 * np.pi * xp.exp(at[..., 0])
        return Shape.of_mode(1 / rate**2, 2 * at[..., 1] / rate)

    def values_at(self, at: Float[Array, "2"], values: Values) -> dict[str, Array]:
        """Stiffness and damping of the shape there, the mass being among the values."""
        _, q, p = xp.moveaxis(self.shape_at(at).denominator, -1, 0)
        mass, stiffness, damping = self.parameters
        found = values[mass] / p
        return {stiffness: found, damping: found * q}

    def quantities(self, equations: Sequence[Equation]) -> list[Quantity]:
        """The parameters, in units by the body's own."""
        terms = [term for e in equations if (term := self.term_in(e)) is not None]
        mass = next((str(term.unit) for term in terms if term.unit), "")
        known = {"kg": ("N/m", "N s/m"), "kg m^2": ("N m/rad", "N m s/rad"), "": ("", "")}
        others = known.get(mass, (f"{mass}/s^2", f"{mass}/s"))
        parts = zip(self.parameters, (mass, *others), ("mass", "stiffness", "damping"))
        words = f"of the hidden mode on {self.on}"
        return [Quantity(name, unit, f"{part} {words}") for name, unit, part in parts]

    def written_out(
        self, equations: Sequence[Equation]
    ) -> tuple[tuple[Equation, ...], dict[str, Expression], tuple[HiddenState, ...]]:
        """The motion of the mode among some equations, for a simulation.

        With velocity v of the body, w of the mass, and deflection d, body minus mass,

            d' = v - w,    M w' = f,    f = K d + B (v - w),

        and every equation that accelerates the body gains f, with the sign of its inertia. No
        acceleration is in f. At rest the mass moves as its body does.

        **Returns:** the equations, rates of states that none of them has, and the mode's states.
        """
        inertias = [self.term_in(equation) for equation in equations]
        inertia = next(term for term in inertias if term is not None)
        body = self.on
        if inertia.derivative != 1:
            terms = [t for e in equations for t in e.terms if t.of == inertia.of]
            named = (t for t in terms if t.derivative and t.measured)
            body = next((t.measured[0] for t in named), f"d{inertia.of}")
        mass, stiffness, damping = self.parameters
        states = ("deflection", "velocity")
        deflection, velocity = (f"mode{_ending(self.number)}_{state}" for state in states)
        stretching = difference(body, velocity)

        def force(sign: float | Leaf) -> tuple[Term, Term]:
            return Term(stiffness, deflection, sign=sign), Term(damping, stretching, sign=sign)

        loaded = (
            equation if t is None else equation.of_terms(*equation.terms, *force(inertia_sign(t)))
            for equation, t in zip(equations, inertias)
        )
        moved = Equation(Term(mass, velocity, derivative=1), *force(-1.0))
        unit = self.quantities(equations)[0].unit
        units = {"kg": ("m", "m/s"), "kg m^2": ("rad", "rad/s")}.get(unit, ("", ""))
        states = HiddenState(deflection, units[0]), HiddenState(velocity, units[1], body)
        return (*loaded, moved), {deflection: stretching}, states


HiddenElement = HiddenMode | SeriesSpring
"""What equations leave out: modes come before springs."""


class Expanded(eqx.Module):
    """An equation with hidden elements, linear in more columns than it has parameters.

    **Fields:** `equation`, linear, whose terms are those of the equation differentiated 0 to `most`
    times; `parameters` of the equation without hidden elements; `elements`, of each hidden element
    the column that it filters, of a mode its body's acceleration, among `columns`, the equation's
    own, which begin with the target. Modes come before springs.
    """

    equation: Equation
    parameters: tuple[str, ...] = eqx.field(static=True)
    columns: tuple[str, ...] = eqx.field(static=True)
    elements: tuple[tuple[HiddenElement, str], ...] = eqx.field(static=True)

    @classmethod
    def of(cls, equation: Equation, hidden: Iterable[HiddenElement]) -> "Expanded":
        """An equation with those modes whose bodies it accelerates, and those springs that are in
        series with a linear element of it."""
        terms, carried = list(equation.terms), []
        for element in hidden:
            term = element.term_in(equation)
            if term is None or not term.is_linear:
                continue
            column = term.name
            if column is None:
                # A known mass is part of the target: the acceleration needs a column of its own.
                assert isinstance(element, HiddenMode), "a spring is behind a named coefficient"
                column = f"acceleration of {element.on}"
                order, measured, sign = term.derivative, term.measured, inertia_sign(term)
                terms.append(Term(column, term.of, derivative=order, measured=measured, sign=sign))
            carried.append((element, column))
        own = Equation(*terms, name=equation.name)
        columns = (TARGET, *own.parameters) if own.has_target else own.parameters
        most = sum(element.order for element, _ in carried)
        raised = [Differentiated(t, k) for k in range(1, most + 1) for t in terms]
        linear = equation.of_terms(*terms, *raised)
        return cls(linear, equation.parameters, columns, tuple(carried))

    @property
    def most(self) -> int:
        """Derivatives that hidden elements put in front of every term."""
        return sum(element.order for element, _ in self.elements)

    @property
    def all_parameters(self) -> tuple[str, ...]:
        """Parameters of the equation and then of its modes and springs."""
        # A spring's coefficient is the equation's own.
        hidden = (name for element, _ in self.elements for name in element.parameters)
        return tuple(dict.fromkeys((*self.parameters, *hidden)))

    def residual(self, values: Values, shapes: Sequence[Shape]) -> Float[Array, "*batch columns"]:
        """The residual as a combination of the linear equation's columns, the target first.

        It is affine in the coefficients and in the modes' masses, for elements of given shapes.

        **Arguments:** `values` of coefficients and masses, zero where there is none, with any axes.
        """
        each = [shape.denominator for shape in shapes]
        whole = _product(each) if each else np.ones(1)
        # What a spring is in series with does not act by itself.
        own = {TARGET: 1.0} | {c: 0.0 for element, c in self.elements if element.linear == c}
        weights = [own[n] if n in own else -values.get(n, 0.0) for n in self.columns]
        weights += [values.get(element.linear, 0.0) for element, _ in self.elements]
        *weights, _ = xp.broadcast_arrays(*weights, whole[..., 0])
        powers = [weight[..., None] * whole for weight in weights[: len(self.columns)]]
        for i, (_, column) in enumerate(self.elements):
            filtered = _product([shapes[i].numerator, *each[:i], *each[i + 1 :]])
            place = self.columns.index(column)
            powers[place] = powers[place] - weights[len(powers) + i][..., None] * filtered
        return xp.concatenate(xp.broadcast_arrays(*powers), axis=-1) @ self._places.T

    @property
    def _places(self) -> Float[np.ndarray, "linear_columns columns_and_orders"]:
        """Which column of the linear equation each derivative of a column is."""
        columns = dict.fromkeys(c for term in self.equation.terms for c in term.columns)
        linear = [Column(TARGET), *columns]
        found = np.zeros((len(linear), len(self.columns), self.most + 1))
        for i, name in enumerate(self.columns):
            for order in range(self.most + 1):
                # A known term that is differentiated has not changed sides.
                sign = -1.0 if name == TARGET and order else 1.0
                found[linear.index(Column(name, order)), i, order] = sign
        return found.reshape(len(linear), -1)

    def linearised(self, values: Values) -> Float[Array, "1+p columns"]:
        """Target and regressors of the equation linearised about these values, as combinations.

        Shapes depend on ratios of parameters only, and for given shapes r - D y is linear in the
        others: r - D y is homogeneous of degree one in all parameters together. By Euler's theorem
        the target r - sum theta dr/dtheta is D y, and values that are held fixed join it as in any
        equation.
        """
        names = self.all_parameters
        at = {name: xp.asarray(values[name], float) for name in names}

        def residual(values: Values) -> Array:
            return self.residual(values, [element.shape(values) for element, _ in self.elements])

        slopes = xp.jacobian(residual, at)
        target = residual(at) - sum(at[name] * slopes[name] for name in names)
        return xp.stack([target, *(-slopes[name] for name in names)])


def _product(polynomials: Sequence[Float[Array, "*batch p"]]) -> Float[Array, "*batch powers"]:
    """Coefficients of a product of polynomials."""

    def times(one: Array, other: Array) -> Array:
        room = other.shape[-1] - 1
        padded = xp.pad(one, [(0, 0)] * (one.ndim - 1) + [(room, room)])
        size = one.shape[-1] + room
        parts = (
            other[..., k, None] * padded[..., room - k : room - k + size] for k in range(room + 1)
        )
        return functools.reduce(operator.add, parts)

    return functools.reduce(times, polynomials)


def mode_frequency(values: Values, mode: HiddenMode) -> tuple[Array, Array]:
    """Natural frequency in hertz and damping ratio of a mode on a body at rest."""
    mass, stiffness, damping = (values[name] for name in mode.parameters)
    root = xp.sqrt(xp.abs(stiffness / mass))
    return root / (2 * np.pi), damping / (2 * mass * root)


def accelerated(equation: Equation) -> tuple[str, ...]:
    """Signals of bodies on which an equation could hide a mode."""
    signals = dict.fromkeys(t.signal for t in equation.terms if t.derivative and t.signal)
    return tuple(of for of in signals if HiddenMode(of).term_in(equation) is not None)


def inertia_sign(inertia: AbstractTerm) -> Leaf:
    """What a mode's mass is multiplied by beside this inertia."""
    factor = inertia.factor
    return factor if inertia.parameters else xp.sign(factor)


class Differentiated(AbstractTerm):
    """A term differentiated further, of columns under names of their own; known ones too."""

    term: AbstractTerm
    by: int = eqx.field(static=True)

    def __init__(self, term: AbstractTerm, by: int):
        self.term, self.by = term, by
        self.of, self.measured, self.unit = term.of, term.measured, term.unit
        self.derivative = term.derivative + by
        self.factor, self.basis = term.factor, term.basis

    @property
    def columns(self) -> tuple[Column, ...]:
        """Those of the term, that often differentiated."""
        return tuple(Column(name, self.by) for name in self.term.parameters or (TARGET,))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the columns, with a prime for each derivative."""
        return tuple(map(str, self.columns))

    @property
    def is_linear(self) -> bool:
        """As of the term."""
        return self.term.is_linear

    def functions(self, x: Float[Array, " n"]) -> Float[Array, "columns n"]:
        """Those of the term."""
        return self.term.functions(x)

    def samples(self, record: Record, order: int) -> Signal:
        """Those of the term."""
        return self.term.samples(record, order)

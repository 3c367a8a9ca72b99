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
`series_springs`): c a becomes c N / D a with N = 1 and D = 1 + tau s, where a mode adds M N / D a.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.equations.bases import AbstractBasis
from riecjax.equations.equation import Equation
from riecjax.equations.series_springs import (
    Lag,
    SeriesSpring,
    SpringParameters,
    is_stiffness_name,
)
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.errors import ModelError, require
from riecjax.leaves import Leaf, is_number

TARGET = "target"
"""What a known term is called once it is differentiated."""
Values = Mapping[str, Array]


class HiddenMode(eqx.Module):
    """An oscillator that a model leaves out, on the body whose velocity is named.

    Its mass `M_mode`, stiffness `K_mode` and damping `B_mode` are parameters of every equation that
    holds the derivative of that velocity; a further mode's end in `_2`, `_3`.

    **Arguments:** `on`, the signal: a velocity of which a term holds the first derivative, or a
    position of which one holds the second; `hz`, near which frequency in hertz to look, everywhere
    if it is not given.

    **Raises:** `ModelError` for a frequency that is not positive.
    """

    on: str = eqx.field(static=True)
    hz: float | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        require("what a hidden mode is on", self.on, str, "rx.HiddenMode(on='x4'), a signal")
        if self.hz is not None and not (
            is_number(self.hz) and np.isfinite(self.hz) and self.hz > 0
        ):
            raise ModelError(f"a mode's frequency is a positive number of hertz; got {self.hz}.")

    def inertia(self, equation: Equation) -> Term | None:
        """The term of an equation that accelerates the body, if it has one."""
        for term in equation.terms:
            if not (isinstance(term, Term) and isinstance(term.of, str)):
                continue
            velocity = term.measured[0] if term.measured else f"d{term.of}"
            if (term.derivative == 1 and term.of == self.on) or (
                term.derivative == 2 and self.on in (term.of, velocity)
            ):
                return term
        return None

    def units(self, number: int, equations: Sequence[Equation]) -> dict[str, str]:
        """Units of the parameters of the mode with this number, by the body's own."""
        terms = [term for e in equations if (term := self.inertia(e)) is not None]
        mass = next((term.unit for term in terms if term.unit), "")
        known = {"kg": ("N/m", "N s/m"), "kg m^2": ("N m/rad", "N m s/rad"), "": ("", "")}
        others = known.get(mass, (f"{mass}/s^2", f"{mass}/s"))
        return dict(zip(ModeParameters.of(number), (mass, *others)))


class ModeParameters(NamedTuple):
    """Names of a mode's mass, stiffness and damping."""

    mass: str
    stiffness: str
    damping: str

    @classmethod
    def of(cls, number: int) -> "ModeParameters":
        """Of the mode with this number, from 0."""
        ending = "" if number == 0 else f"_{number + 1}"
        return cls(f"M_mode{ending}", f"K_mode{ending}", f"B_mode{ending}")

    @property
    def linear(self) -> str:
        """The parameter that the force is proportional to, for a given shape."""
        return self.mass

    @property
    def order(self) -> int:
        """Of the polynomial D, which has as many coordinates in a search."""
        return 2

    @property
    def judged(self) -> tuple[str, ...]:
        """Parameters that are positive, and sure, where such an element is found."""
        return self.mass, self.stiffness

    def doubted(self, values: Values, band: tuple[Leaf, Leaf]) -> Float[Array, "2"]:
        """Errors of what is judged that count as one: its values."""
        return jnp.stack([values[name] for name in self.judged])

    def shape(self, values: Values) -> "Shape":
        """p and q with these values."""
        mass, stiffness, damping = (values[name] for name in self)
        return Shape(mass / stiffness, damping / stiffness)

    @staticmethod
    def shape_at(at: Float[Array, "2"] | None) -> "Shape":
        """Of the logarithm of the frequency in hertz and the damping ratio; `None`: rigid."""
        if at is None:
            return Shape(jnp.zeros(()), jnp.zeros(()))
        rate = 2 * jnp.pi * jnp.exp(at[0])
        return Shape(1 / rate**2, 2 * at[1] / rate)

    def values_at(self, at: Float[Array, "2"], values: Values) -> dict[str, Array]:
        """Stiffness and damping of the shape there, the mass being among the values."""
        shape = self.shape_at(at)
        stiffness = values[self.mass] / shape.p
        return {self.stiffness: stiffness, self.damping: stiffness * shape.q}


class Shape(NamedTuple):
    """Polynomials 1 + q s and D = 1 + q s + p s^2 of a mode: p = M / K in s^2, q = B / K in s."""

    p: Array
    q: Array

    @property
    def numerator(self) -> Float[Array, "3"]:
        """Coefficients, lowest first."""
        return jnp.stack([jnp.ones_like(self.p), self.q, jnp.zeros_like(self.p)])

    @property
    def denominator(self) -> Float[Array, "3"]:
        """Coefficients of D, lowest first."""
        return jnp.stack([jnp.ones_like(self.p), self.q, self.p])

    @property
    def decay(self) -> Array:
        """Seconds in which what is free falls to 1 / e: it is exp(-q t / (2 p))."""
        return jnp.where(self.q > 0, 2 * self.p / jnp.where(self.q > 0, self.q, 1.0), jnp.inf)


HiddenParameters = ModeParameters | SpringParameters


class Expanded(eqx.Module):
    """An equation with hidden elements, linear in more columns than it has parameters.

    **Fields:** `equation`, linear, whose terms are those of the equation differentiated 0 to `most`
    times; `parameters` of the equation without hidden elements; `elements`, of each hidden element
    its parameters and the column that it filters, of a mode its body's acceleration, among
    `columns`, the equation's own, which begin with the target. Modes come before springs.
    """

    equation: Equation
    parameters: tuple[str, ...] = eqx.field(static=True)
    columns: tuple[str, ...] = eqx.field(static=True)
    elements: tuple[tuple[HiddenParameters, str], ...] = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        equation: Equation,
        modes: Sequence[HiddenMode],
        springs: Sequence[SeriesSpring] = (),
    ) -> "Expanded":
        """An equation with those of some modes whose bodies it accelerates, and of some springs
        those that are in series with a linear element of it."""
        terms, carried = list(equation.terms), []
        for number, mode in enumerate(modes):
            inertia = mode.inertia(equation)
            if inertia is None:
                continue
            column = inertia.name
            if column is None:
                # A known mass is part of the target: the acceleration needs a column of its own.
                column = f"acceleration of {mode.on}"
                terms.append(_unit_inertia(inertia, column))
            carried.append((ModeParameters.of(number), column))
        for number, spring in enumerate(springs):
            if isinstance(spring.element(equation), Term):
                carried.append((SpringParameters.of(number, spring), spring.of))
        own = Equation(*terms, name=equation.name)
        columns = (TARGET, *own.parameters) if own.has_target else own.parameters
        most = sum(names.order for names, _ in carried)
        raised = [_raised(t, k) for k in range(1, most + 1) for t in terms]
        linear = Equation(
            *terms, *raised, name=equation.name, unit=equation.unit, where=equation.where
        )
        return cls(linear, equation.parameters, columns, tuple(carried))

    @property
    def most(self) -> int:
        """Derivatives that hidden elements put in front of every term."""
        return sum(names.order for names, _ in self.elements)

    @property
    def all_parameters(self) -> tuple[str, ...]:
        """Parameters of the equation and then of its modes and springs."""
        # A spring's coefficient is the equation's own.
        hidden = (name for names, _ in self.elements for name in names)
        return tuple(dict.fromkeys((*self.parameters, *hidden)))

    def residual(self, values: Values, shapes: Sequence[Shape | Lag]) -> Float[Array, " columns"]:
        """The residual as a combination of the linear equation's columns, the target first.

        It is affine in the coefficients and in the modes' masses, for elements of given shapes.

        **Arguments:** `values` of the equation's coefficients and of the modes' masses, zero where
        there is none.
        """
        each = [shape.denominator for shape in shapes]
        whole = _product(each)
        # What a spring is in series with does not act by itself.
        own = {TARGET: 1.0} | {c: 0.0 for names, c in self.elements if names.linear == c}
        weights = [own[n] if n in own else -values.get(n, 0.0) for n in self.columns]
        powers = jnp.stack([jnp.asarray(w, whole.dtype) for w in weights])[:, None] * whole[None, :]
        for i, (names, column) in enumerate(self.elements):
            filtered = _product([shapes[i].numerator, *each[:i], *each[i + 1 :]])
            size = values.get(names.linear, 0.0)
            powers = powers.at[self.columns.index(column)].add(-size * filtered)
        return jnp.asarray(self._places) @ powers.ravel()

    @property
    def _places(self) -> Float[np.ndarray, "linear_columns columns_and_orders"]:
        """Which column of the linear equation each derivative of a column is."""
        names = ("", *self.equation.parameters)
        found = np.zeros((len(names), len(self.columns), self.most + 1))
        for i, name in enumerate(self.columns):
            for order in range(self.most + 1):
                own = "" if (name, order) == (TARGET, 0) else name + "'" * order
                # A known term that is differentiated has not changed sides.
                found[names.index(own), i, order] = -1.0 if name == TARGET and order else 1.0
        return found.reshape(len(names), -1)

    def linearised(self, values: Values) -> Float[Array, "1+p columns"]:
        """Target and regressors of the equation linearised about these values, as combinations.

        Shapes depend on ratios of parameters only, and for given shapes r - D y is linear in the
        others: r - D y is homogeneous of degree one in all parameters together. By Euler's theorem
        the target r - sum theta dr/dtheta is D y, and values that are held fixed join it as in any
        equation.
        """
        names = self.all_parameters
        at = {name: jnp.asarray(values[name], jnp.result_type(float)) for name in names}

        def residual(values: Values) -> Array:
            return self.residual(values, [names.shape(values) for names, _ in self.elements])

        slopes = jax.jacfwd(residual)(at)
        target = residual(at) - sum(at[name] * slopes[name] for name in names)
        return jnp.stack([target, *(-slopes[name] for name in names)])


def _product(polynomials: Sequence[Float[Array, " powers"]]) -> Float[Array, " powers"]:
    """Coefficients of a product of polynomials; 1 of none."""
    found = jnp.ones(1)
    for number, one in enumerate(polynomials):
        found = one if number == 0 else jnp.convolve(found, one)
    return found


def mode_frequency(values: Values, names: ModeParameters) -> tuple[Array, Array]:
    """Natural frequency in hertz and damping ratio of a mode on a body at rest."""
    mass, stiffness, damping = (values[name] for name in names)
    root = jnp.sqrt(jnp.abs(stiffness / mass))
    return root / (2 * np.pi), damping / (2 * mass * root)


def is_mode_name(name: str) -> bool:
    """Whether a parameter is called as those of modes are."""
    first = ModeParameters.of(0)
    return any(name == own or name.removeprefix(f"{own}_").isdigit() for own in first)


def is_hidden_name(name: str) -> bool:
    """Whether a parameter is called as those of modes and of springs are."""
    return is_mode_name(name) or is_stiffness_name(name)


def accelerated(equation: Equation) -> tuple[str, ...]:
    """Signals of bodies on which an equation could hide a mode."""
    moving = (t.of for t in equation.terms if isinstance(t, Term) and t.derivative)
    signals = dict.fromkeys(of for of in moving if isinstance(of, str))
    return tuple(of for of in signals if HiddenMode(of).inertia(equation) is not None)


def inertia_sign(inertia: Term) -> Leaf:
    """What a mode's mass is multiplied by beside this inertia."""
    number = inertia.number
    if inertia.name is not None:
        return number
    return np.sign(number) if isinstance(number, np.ndarray) else jnp.sign(number)


def _unit_inertia(term: Term, name: str) -> Term:
    sign = inertia_sign(term)
    return Term(name, term.of, derivative=term.derivative, measured=term.measured, sign=sign)


def _raised(term: AbstractTerm, by: int) -> AbstractTerm:
    """A term differentiated `by` times, under a name of its own."""
    changes: dict[str, object] = {"derivative": term.derivative + by}
    if isinstance(term, Terms):
        changes["basis"] = _Labelled(term.basis, "'" * by)
    else:
        assert isinstance(term, Term)
        changes |= {"name": (term.name or TARGET) + "'" * by, "known": None}
    raised = object.__new__(type(term))
    for field in type(term).__dataclass_fields__:
        object.__setattr__(raised, field, changes.get(field, getattr(term, field)))
    return raised


class _Labelled(AbstractBasis):
    """A basis whose labels end in something more."""

    basis: AbstractBasis
    ending: str = eqx.field(static=True)

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(label + self.ending for label in self.basis.labels)

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "functions n"]:
        return self.basis(x)

"""Equations with searched elements, linear in more columns than they have parameters."""

import functools
import operator
from collections.abc import Iterable, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.equations.element import Element, Shape, Values
from riecjax.equations.equation import Equation
from riecjax.equations.term import AbstractTerm, Column, Term
from riecjax.leaves import Leaf
from riecjax.records.record import Record
from riecjax.records.signal import Signal

TARGET = "target"
"""What a known term is called once it is differentiated."""


class Expanded(eqx.Module):
    """An equation with searched elements, linear in more columns than it has parameters.

    **Fields:** `equation`, linear, whose terms are those of the equation differentiated 0 to `most`
    times; `parameters` of the equation without hidden ones; `columns`, the equation's own, which
    begin with the target; `elements`, each with those of the columns that it filters or weighs.
    """

    equation: Equation
    parameters: tuple[str, ...] = eqx.field(static=True)
    columns: tuple[str, ...] = eqx.field(static=True)
    elements: tuple[tuple[Element, tuple[str, ...]], ...] = eqx.field(static=True)

    @classmethod
    def of(cls, equation: Equation, searched: Iterable[Element]) -> "Expanded":
        """An equation with those elements that act on a linear term of it."""
        terms, acting = list(equation.terms), []
        for element in searched:
            term = element.term_in(equation)
            if term is None or not term.is_linear:
                continue
            if term.name is None:
                # A known coefficient is part of the target: its element needs a column of its own.
                sign = inertia_sign(term)
                own = Term(f"{term.signal} of {element.linear}", term.of, sign=sign)
                own = own.with_fields(derivative=term.derivative, measured=term.measured)
                terms.append(own)
                acting.append((element, own.parameters))
                continue
            columns = element.columns(term)
            if columns != (term,):
                place = terms.index(term)
                terms[place : place + 1] = columns
            acting.append((element, tuple(name for each in columns for name in each.parameters)))
        own = Equation(*terms, name=equation.name)
        columns = (TARGET, *own.parameters) if own.has_target else own.parameters
        most = sum(element.order for element, _ in acting)
        raised = [Differentiated(t, k) for k in range(1, most + 1) for t in terms]
        linear = equation.of_terms(*terms, *raised)
        return cls(linear, equation.parameters, columns, tuple(acting))

    @property
    def most(self) -> int:
        """Derivatives that elements put in front of every term."""
        return sum(element.order for element, _ in self.elements)

    @property
    def all_parameters(self) -> tuple[str, ...]:
        """Parameters of the equation and then of its elements."""
        # What an element acts on may be a coefficient of the equation's own.
        hidden = (name for element, _ in self.elements for name in element.parameters)
        return tuple(dict.fromkeys((*self.parameters, *hidden)))

    def residual(self, values: Values, shapes: Sequence[Shape]) -> Float[Array, "*batch columns"]:
        """The residual as a combination of the linear equation's columns, the target first.

        It is affine in the coefficients and in what elements are linear in, for given shapes.

        **Arguments:** `values` of these, zero where there is none, with any axes.
        """
        each = [shape.denominator for shape in shapes]
        whole = _product(each) if each else np.ones(1)
        # What an element acts on does not act by itself.
        behind = {c for element, columns in self.elements if element.linear in columns
                  for c in columns}  # fmt: skip
        own = {TARGET: 1.0} | dict.fromkeys(behind, 0.0)
        weights = [own[n] if n in own else -values.get(n, 0.0) for n in self.columns]
        weights += [values.get(element.linear, 0.0) for element, _ in self.elements]
        *weights, _ = xp.broadcast_arrays(*weights, whole[..., 0])
        powers = [weight[..., None] * whole for weight in weights[: len(self.columns)]]
        for i, (_, columns) in enumerate(self.elements):
            filtered = _product([shapes[i].numerator, *each[:i], *each[i + 1 :]])
            force = weights[len(powers) + i][..., None] * filtered
            for number, column in enumerate(columns):
                place = self.columns.index(column)
                weight = shapes[i].weights[..., number, None]
                powers[place] = powers[place] - weight * force
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


def inertia_sign(inertia: AbstractTerm) -> Leaf:
    """What the mass that an element adds to this inertia is multiplied by."""
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

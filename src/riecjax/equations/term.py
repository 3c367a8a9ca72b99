"""One term of an equation of motion: a coefficient times a derivative of a signal expression."""

from collections.abc import Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.equations.bases import AbstractBasis
from riecjax.equations.expressions import Expression, Sampled, evaluate
from riecjax.errors import DataError, ModelError, require
from riecjax.leaves import Leaf, as_leaf
from riecjax.records.record import Record


class AbstractTerm(eqx.Module):
    """Something with samples on a record: one or several columns of an equation."""

    of: eqx.AbstractVar[Expression]
    derivative: eqx.AbstractVar[int]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the unknown coefficients, one for each column; empty for a known term."""
        raise NotImplementedError

    @property
    def units(self) -> dict[str, str]:
        """Unit of each unknown coefficient."""
        raise NotImplementedError

    def expression(self, record: Record, order: int) -> Expression:
        """What holds the expression differentiated `order` times on this record.

        **Raises:** `DataError` where that needs a derivative that the record does not hold.
        """
        raise NotImplementedError

    def samples(self, record: Record, order: int) -> Sampled:
        """Samples of the expression differentiated `order` times, for every column.

        **Raises:** `DataError` where that needs a derivative that the record does not hold.
        """
        raise NotImplementedError

    def __neg__(self) -> "AbstractTerm":
        raise NotImplementedError


class Term(AbstractTerm):
    """`coefficient x d^k/dt^k (signal expression)`.

    A derivative is never formed numerically here. An integral criterion moves it onto its test
    function; a pointwise one needs it recorded, and `measured` says under which name.

    **Arguments:**

    - `coefficient`: a name for an unknown coefficient, or a number for a known one.
    - `of`: signal name or function of the signals.
    - `derivative`: k, one of 0, 1, 2.
    - `measured`: names of the signals that hold the first, second, ... derivative of `of`.
    - `unit`: unit of the coefficient.
    - `known`: a value for a named coefficient, which is then not estimated.
    - `sign`: factor in front, 1 or -1.

    **Raises:** `ModelError` for a derivative other than 0, 1, 2 or a known value without a name.
    """

    name: str | None = eqx.field(static=True)
    number: Leaf
    of: Expression = eqx.field(static=True)
    derivative: int = eqx.field(static=True)
    measured: tuple[str, ...] = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    known: Leaf | None

    def __init__(
        self,
        coefficient: str | float | Leaf,
        of: Expression,
        *,
        derivative: int = 0,
        measured: tuple[str, ...] = (),
        unit: str = "",
        known: float | Leaf | None = None,
        sign: float | Leaf = 1.0,
    ):
        require(
            "a term's coefficient",
            coefficient,
            (str, int, float, np.ndarray, np.number, jax.Array),
            "a name or, for a known one, a number: rx.Term('m', 'x')",
        )
        if not callable(of):
            require(
                "what a term is of", of, str, "a signal's name or a function: rx.Term('m', 'x')"
            )
        require(
            "measured",
            measured,
            (tuple, list),
            f"measured=('{measured}',): a tuple of names, of the first derivative on",
        )
        named = isinstance(coefficient, str)
        self.name = coefficient if isinstance(coefficient, str) else None
        self.number = as_leaf(sign if isinstance(coefficient, str) else coefficient * sign)
        self.of = of
        self.derivative = derivative
        self.measured = tuple(measured)
        self.unit = unit
        self.known = None if known is None else as_leaf(known)
        if derivative not in (0, 1, 2):
            raise ModelError(f"a term's derivative must be 0, 1 or 2; got {derivative}.")
        if known is not None and not named:
            raise ModelError("a known value belongs to a named coefficient.")

    def of_its_derivative(self) -> "Term":
        """The same term, of the recorded derivative that `measured` names first."""
        return Term(
            self.number if self.name is None else self.name,
            self.measured[0],
            derivative=self.derivative - 1,
            measured=self.measured[1:],
            unit=self.unit,
            known=self.known,
            sign=1.0 if self.name is None else self.number,
        )

    @property
    def parameters(self) -> tuple[str, ...]:
        """The coefficient's name, if it has one."""
        return () if self.name is None else (self.name,)

    @property
    def units(self) -> dict[str, str]:
        """The coefficient's unit."""
        return {name: self.unit for name in self.parameters}

    def expression(self, record: Record, order: int) -> Expression:
        """`of`, or the name of the signal that holds its derivative; see the base class."""
        return self.of if order == 0 else _derivative_name(self, record, order)

    def samples(self, record: Record, order: int) -> Sampled:
        """Samples of `number x d^order/dt^order (of)`; see the base class."""
        values, present = evaluate(self.expression(record, order), record)
        return Sampled((jnp.asarray(self.number) * values)[None], present)

    def __neg__(self) -> "Term":
        return eqx.tree_at(lambda term: term.number, self, -self.number)


class Terms(AbstractTerm):
    """One term for each function of a basis: `sum_i prefix_i basis_i(of)`.

    **Arguments:**

    - `prefix`: coefficients are named `prefix_label`, with the labels of the basis.
    - `basis`: such as [`roof`][] functions.
    - `of`: signal name or function of the signals, in which the basis is evaluated.
    - `unit`: unit of the coefficients; several, one for each function, where they differ.

    **Raises:** `ModelError` if there are several units and not one for each function, or for what
    is no basis.
    """

    prefix: str = eqx.field(static=True)
    basis: AbstractBasis
    of: Expression = eqx.field(static=True)
    unit: str | tuple[str, ...] = eqx.field(static=True)
    sign: Leaf
    derivative: int = eqx.field(static=True)

    def __init__(
        self,
        prefix: str,
        basis: AbstractBasis,
        of: Expression,
        *,
        unit: str | tuple[str, ...] = "",
        sign: float | Array = 1.0,
    ):
        called = getattr(basis, "__name__", "").lower() == "friction"
        example = "rx.friction()" if called else "rx.roof([-1, 0, 1])"
        require("the basis", basis, AbstractBasis, f"rx.Terms('F', {example}, 'v')")
        self.prefix = prefix
        self.basis = basis
        self.of = of
        self.unit = unit
        self.sign = as_leaf(sign)
        self.derivative = 0
        if not isinstance(unit, str) and len(unit) != len(basis.labels):
            raise ModelError(
                f"{prefix}: {len(unit)} units for {len(basis.labels)} functions of the basis."
            )

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return tuple(f"{self.prefix}_{label}" for label in self.basis.labels)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each coefficient."""
        names = self.parameters
        units = (self.unit,) * len(names) if isinstance(self.unit, str) else self.unit
        return dict(zip(names, units))

    def expression(self, record: Record, order: int) -> Expression:
        """`of`, whose basis functions have no recorded derivative; see the base class."""
        if order != 0:
            raise DataError(f"the derivative of the basis '{self.prefix}' is not recorded.")
        return self.of

    def samples(self, record: Record, order: int) -> Sampled:
        """Samples of every function; see the base class."""
        values, present = evaluate(self.expression(record, order), record)
        return Sampled(jnp.asarray(self.sign) * self.basis(values), present)

    def __neg__(self) -> "Terms":
        return eqx.tree_at(lambda terms: terms.sign, self, -self.sign)


def _derivative_name(term: Term, record: Record, order: int) -> str:
    label = term.of if isinstance(term.of, str) else "an expression"
    which = {1: "first", 2: "second"}[order]
    if order > len(term.measured):
        if isinstance(term.of, str):
            _ = record.signals[term.of]
        raise DataError(
            f"this criterion needs the {which} time derivative of {label}, and the equation names "
            f"no signal that holds it. Use windows that need no derivative, rx.Hat() (on the "
            f"command line: --test-function hat), or name the recorded derivative: "
            f"derivative={term.derivative}, measured={('dx', 'ddx')[: term.derivative]}."
        )
    name = term.measured[order - 1]
    if name not in record.signals:
        raise DataError(
            f"this criterion needs the {which} time derivative of {label}, as signal '{name}'; the "
            f"record has: {', '.join(record.signals)}. Rename a column to it (on the command line: "
            f"--map {name}=COLUMN), form it (--differentiate {name}={_below(term, order)}), or use "
            f"windows that need no derivative, rx.Hat() (on the command line: --test-function hat)."
        )
    return name


def _below(term: Term, order: int) -> str:
    """The signal whose first derivative the derivative of this order is."""
    return (term.of if isinstance(term.of, str) else "SIGNAL", *term.measured)[order - 1]


def sum_columns(
    terms: Iterable[tuple[AbstractTerm, Float[Array, "columns n"]]], parameters: tuple[str, ...]
) -> Float[Array, "1+parameters n"]:
    """Add up the columns that belong to one coefficient; the first row takes the known terms.

    The row of a coefficient that has no term here is zero.
    """
    rows: dict[str | None, Array] = {}
    for term, block in terms:
        for name, column in zip(term.parameters or (None,), block):
            rows[name] = rows[name] + column if name in rows else column
    zero = jnp.zeros_like(next(iter(rows.values())))
    # The terms sum to zero, so the known ones change sides and are regressed on the rest.
    return jnp.stack([-rows.get(None, zero), *(rows.get(name, zero) for name in parameters)])

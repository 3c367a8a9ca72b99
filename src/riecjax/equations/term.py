"""Terms of an equation of motion: factor x d^k/dt^k (functions of a signal expression).

Each function has a named coefficient, or a single one has none and is known. What the house asks of
a term it asks by the methods of `AbstractTerm`, which a class from elsewhere answers as well.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple, Self, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.equations.bases import AbstractBasis
from riecjax.equations.expressions import Expression, called, combined, evaluate, source_of
from riecjax.errors import DataError, ModelError, require, users_code
from riecjax.leaves import Leaf, PlainMethods, as_leaf, is_number
from riecjax.records.record import Record, Signals
from riecjax.records.signal import Signal


class Column(NamedTuple):
    """A column of an equation: of a coefficient, differentiated `order` times more."""

    name: str
    order: int = 0

    def __str__(self) -> str:
        return self.name + "'" * self.order


def _number(what: str, value: Any) -> Leaf:
    """One number, as a leaf."""
    if not is_number(value) or (xp.is_concrete(value) and not np.isfinite(value)):
        raise ModelError(f"{what} must be one finite number; got {value!r}.")
    return as_leaf(value)


_factor = partial(_number, "the factor in front of a term")


class AbstractTerm(PlainMethods, eqx.Module):
    """One or several columns of an equation: `factor x d^k/dt^k f_j(of)`, of a coefficient each.

    A class of your own names its `parameters` and says what its columns are: by `functions` of
    samples of the expression, or by `samples` of a record, from which equations are identified and
    not simulated.

    **Fields:** keywords of every such class:

    - `of`: signal name or function of the signals.
    - `derivative`: k.
    - `measured`: names of the signals that hold the first, second, ... derivative of `of`.
    - `unit` of the coefficients; several, one for each function, where they differ.
    - `factor` in front.
    - `basis`: the functions, where they are a family.
    """

    of: Expression = eqx.field(static=True, kw_only=True)
    derivative: int = eqx.field(static=True, kw_only=True, default=0)
    measured: tuple[str, ...] = eqx.field(static=True, kw_only=True, default=())
    unit: str | tuple[str, ...] = eqx.field(static=True, kw_only=True, default="")
    factor: Leaf = eqx.field(converter=_factor, kw_only=True, default=1.0)  # pyright: ignore
    basis: AbstractBasis | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self):
        if type(self.derivative) is not int or self.derivative < 0:
            raise ModelError(
                f"a term's derivative must be a whole number from 0 on; got {self.derivative}."
            )
        if not callable(self.of):
            write = "a signal's name or a function: rx.Term('m', 'x')"
            require("what a term is of", self.of, str, write)
        require(f"what {type(self).__name__} calls parameters", self.parameters, tuple, "('m',)")
        require("a term's unit", self.unit, (str, tuple, list), "unit='kg'")
        if not isinstance(self.unit, str) and len(self.unit) != len(self.parameters):
            raise ModelError(
                f"{self.name}: {len(self.unit)} units for {len(self.parameters)} coefficients."
            )

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the coefficients, one for each column; empty for a known term."""
        raise NotImplementedError

    @property
    def columns(self) -> tuple[Column, ...]:
        """A column for each coefficient; of a known term there is none."""
        return tuple(map(Column, self.parameters))

    @property
    def is_linear(self) -> bool:
        """Whether the one column is the factor times the expression itself."""
        return False

    def functions(self, x: Float[Array, " n"]) -> Float[Array, "columns n"]:
        """What the term makes of samples of its expression, but for the factor.

        **Raises:** `ModelError` where the class does not say.
        """
        if self.basis is not None:
            return self.basis(x)
        if self.is_linear:
            return x[None]
        raise ModelError(
            f"{type(self).__name__} does not say what it makes of its expression: give the class "
            f"functions(x), of samples x, with a row for each coefficient."
        )

    def force(self, values: Sequence[Array], x: Float[Array, " n"]) -> Float[Array, " n"]:
        """What a simulation has of it at samples x of its expression, but for the factor.

        **Arguments:** `values` of its parameters, in their order; a class whose parameters are no
        coefficients says here what it makes of them.
        """
        if self.basis is not None:
            return self.basis.interpolate(xp.stack(values), x)
        if len(values) > 1:
            return xp.stack(values) @ self.functions(x)
        return (values[0] if values else 1.0) * self.functions(x)[0]

    @property
    def unweighted(self) -> "AbstractTerm":
        """The term itself, of one that weighs another."""
        return self

    @property
    def name(self) -> str | None:
        """What the term is called: its coefficient, or how those of its family begin."""
        return next(iter(self.parameters), None)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each coefficient."""
        if isinstance(self.unit, str):
            return dict.fromkeys(self.parameters, self.unit)
        return dict(zip(self.parameters, self.unit))

    @property
    def known_values(self) -> Mapping[str, Leaf]:
        """Of the coefficients that are known in advance."""
        return {}

    @property
    def signal(self) -> str | None:
        """The signal that the term is linear in; `None` of any function of signals."""
        return self.of if self.is_linear and isinstance(self.of, str) else None

    def words(self, of: str) -> list[str]:
        """Its summands but for the factor, in words, with these of the expression."""
        return [" ".join((*self.parameters[:1], f"{type(self).__name__}({of})"))]

    @property
    def source(self) -> str | None:
        """As it is written after `import riecjax as rx`; `None` where that is not known."""
        return None

    def expression(self, record: Record, order: int) -> Expression:
        """What holds the expression differentiated `order` times on this record.

        **Raises:** `DataError` where that needs a derivative that the record does not hold.
        """
        if order == 0:
            return self.of
        if not self.is_linear:
            kind = "function" if self.basis is None else "basis"
            raise DataError(f"the derivative of the {kind} '{self.name}' is not recorded.")
        label = self.of if isinstance(self.of, str) else "an expression"
        which = {1: "first", 2: "second", 3: "third"}.get(order, f"{order}th")
        if order > len(self.measured):
            if isinstance(self.of, str):
                _ = record.signals[self.of]
            raise DataError(
                f"this criterion needs the {which} time derivative of {label}, and the equation "
                f"names no signal that holds it. Use windows that need no derivative, rx.Hat() (on "
                f"the command line: --test-function hat), or name the recorded derivative: "
                f"derivative={self.derivative}, measured={('dx', 'ddx')[: self.derivative]}."
            )
        name = self.measured[order - 1]
        if name not in record.signals:
            below = (self.of if isinstance(self.of, str) else "SIGNAL", *self.measured)[order - 1]
            raise DataError(
                f"this criterion needs the {which} time derivative of {label}, as signal '{name}'; "
                f"the record has: {', '.join(record.signals)}. Rename a column to it (on the "
                f"command line: --map {name}=COLUMN), form it (--differentiate {name}={below}), or "
                f"use windows that need no derivative, rx.Hat() (on the command line: "
                f"--test-function hat)."
            )
        return name

    def samples(self, record: Record, order: int) -> Signal:
        """Samples of every column, differentiated `order` times.

        **Raises:** `DataError` where that needs a derivative that the record does not hold.
        """
        expression = evaluate(self.expression(record, order), record)
        return combined(lambda x: self.factor * self.functions(x), expression)

    def with_fields(self, **changes: object) -> Self:
        """The same term with other values of some fields, which are not checked anew."""
        changed = object.__new__(type(self))
        for name in type(self).__dataclass_fields__:
            object.__setattr__(changed, name, changes.get(name, getattr(self, name)))
        return changed

    def __neg__(self) -> Self:
        return eqx.tree_at(lambda term: term.factor, self, -self.factor)


def from_elsewhere(kind: type) -> list[type]:
    """A term's class and those that it is derived from, as far as they are not this package's."""
    return [k for k in kind.__mro__ if k.__module__.partition(".")[0] not in _AT_HOME]


_AT_HOME = ("riecjax", "equinox", "builtins", "collections", "abc", "typing")
Made = TypeVar("Made", Array, Signal)


def made_by(term: AbstractTerm, make: Callable[[], Made], samples: int) -> Made:
    """What a term's class makes, a row for each coefficient and a column for each sample.

    **Raises:** `ModelError` for a class from elsewhere that fails or makes another shape.
    """
    kind, rows = type(term).__name__, max(len(term.parameters), 1)
    with users_code(kind):
        made = make()
    values: Any = made.values if isinstance(made, Signal) else made
    shape = np.shape(values)
    if shape != (rows, samples):
        raise ModelError(
            f"{kind} must make a row for each of {rows} coefficient(s), a column for each sample: "
            f"shape {(rows, samples)}; it made {shape}."
        )
    return made


def samples_of(term: AbstractTerm, record: Record, order: int) -> Signal:
    """[`AbstractTerm.samples`][], looked at.

    **Raises:** as that and as [`made_by`][] do.
    """
    arrays = record.arrays.values()

    def make() -> Signal:
        return xp.in_double(lambda *_: term.samples(record, order), *arrays)

    return made_by(term, make, record.sample_count)


class Term(AbstractTerm):
    """`coefficient x d^k/dt^k (signal expression)`.

    A derivative is never formed numerically here. An integral criterion moves it onto its test
    function; a pointwise one needs it recorded, and `measured` says under which name.

    **Arguments:**

    - `coefficient`: a name for an unknown coefficient, or a number for a known one.
    - `of`: signal name or function of the signals.
    - `derivative`: k.
    - `measured`: names of the signals that hold the first, second, ... derivative of `of`.
    - `unit`: unit of the coefficient.
    - `known`: a value for a named coefficient, which is then not estimated.
    - `sign`: factor in front, 1 or -1.
    - `basis`: functions of the expression in its place, with a coefficient each, see
      [`Terms`][riecjax.Terms].

    **Raises:** `ModelError` for a derivative that is no whole number from 0 on, for what is no
    finite number, and for a known value, or several functions of a basis, without a name.
    """

    coefficient: str | None = eqx.field(static=True)
    known: Leaf | None

    def __init__(
        self,
        coefficient: str | float | Leaf,
        of: Expression,
        *,
        derivative: int = 0,
        measured: tuple[str, ...] = (),
        unit: str | tuple[str, ...] = "",
        known: float | Leaf | None = None,
        sign: float | Leaf = 1.0,
        basis: AbstractBasis | None = None,
    ):
        require(
            "a term's coefficient",
            coefficient,
            (str, int, float, np.ndarray, np.number, jax.Array),
            "a name or, for a known one, a number: rx.Term('m', 'x')",
        )
        require(
            "measured",
            measured,
            (tuple, list),
            f"measured=('{measured}',): a tuple of names, of the first derivative on",
        )
        named = isinstance(coefficient, str)
        self.coefficient = coefficient if isinstance(coefficient, str) else None
        sign = _number("a term's sign", sign)
        self.factor = sign if named else _number("a term's coefficient", coefficient * sign)
        self.of = of
        self.derivative = derivative
        self.measured = tuple(measured)
        self.unit = unit
        self.known = None if known is None else _number(f"the known value of {coefficient}", known)
        self.basis = basis if basis is None else _checked(basis)
        if known is not None and not named:
            raise ModelError("a known value belongs to a named coefficient.")
        if self.basis is not None and len(self.basis.labels) > 1 and not named:
            raise ModelError("several functions of a basis need a name that theirs begin with.")

    @property
    def name(self) -> str | None:
        """The coefficient's name, if it has one, or what those of the basis begin with."""
        return self.coefficient

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the coefficients: none, one, or one for each function of the basis."""
        if self.coefficient is None:
            return ()
        if self.basis is None:
            return (self.coefficient,)
        return tuple(f"{self.coefficient}_{label}" for label in self.basis.labels)

    @property
    def known_values(self) -> Mapping[str, Leaf]:
        """The value of a coefficient that is known."""
        return {} if self.known is None else dict.fromkeys(self.parameters, self.known)

    @property
    def is_linear(self) -> bool:
        """Whether there is no basis."""
        return self.basis is None

    def words(self, of: str) -> list[str]:
        """Those of the basis."""
        assert self.basis is not None
        return self.basis.words(str(self.name), of)

    @property
    def source(self) -> str | None:
        """As it is written, of a named coefficient with nothing in front."""
        basis = () if self.basis is None else (self.basis.source,)
        words = [written(self.coefficient), *basis, source_of(self.of)]
        is_plain = self.known is None and float(np.asarray(self.factor)) == 1
        if self.coefficient is None or None in words or not is_plain:
            return None
        settings = {"derivative": self.derivative, "measured": self.measured, "unit": self.unit}
        words += [f"{name}={written(value)}" for name, value in settings.items() if value]
        return f"rx.{'Terms' if basis else 'Term'}({', '.join(map(str, words))})"


def Terms(
    prefix: str,
    basis: AbstractBasis,
    of: Expression,
    *,
    unit: str | tuple[str, ...] = "",
    sign: float | Array = 1.0,
) -> Term:
    """A term of every function of a basis: `sum_i prefix_i basis_i(of)`.

    **Arguments:**

    - `prefix`: coefficients are named `prefix_label`, with the labels of the basis.
    - `basis`: such as [`roof`][] functions.
    - `of`: signal name or function of the signals, in which the basis is evaluated.
    - `unit`: unit of the coefficients; several, one for each function, where they differ.

    **Raises:** `ModelError` if there are several units and not one for each function, or for what
    is no basis.
    """
    return Term(prefix, of, unit=unit, sign=sign, basis=_checked(basis))


def _checked(basis: AbstractBasis) -> AbstractBasis:
    called = getattr(basis, "__name__", "").lower() == "friction"
    example = "rx.friction()" if called else "rx.roof([-1, 0, 1])"
    require("the basis", basis, AbstractBasis, f"rx.Terms('F', {example}, 'v')")
    return basis


def written(value: object) -> str:
    """As Python writes it, texts in double quotes."""
    if isinstance(value, tuple):
        return f"({', '.join(map(written, value))}{',' * (len(value) == 1)})"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


ASIDE, JUMP = 1e-9, 1e-4
"""A velocity to either side of zero, and the share of itself that a function jumps by there."""


def reversing_states(
    terms: Iterable[AbstractTerm], states: Sequence[str], signals: Sequence[str]
) -> tuple[str, ...]:
    """States at whose zero a term jumps, as dry friction does of a velocity.

    **Arguments:** terms of `signals`, the states among these.
    """
    jumping: set[str] = set()
    for term in terms:
        continuous = term.is_linear or (term.basis is not None and term.basis.is_continuous)
        if not continuous:
            jumping |= _jumping(term.of, term.functions, tuple(states), tuple(signals))
        elif callable(term.of):
            jumping |= _jumping_alone(term.of, None, tuple(states), tuple(signals))
    return tuple(state for state in states if state in jumping)


@np.errstate(all="ignore")  # what is not finite does not jump
def _jumping(
    of: Expression,
    functions: Callable[[Array], Array] | None,
    states: tuple[str, ...],
    signals: tuple[str, ...],
) -> set[str]:
    """The states at whose zero one function jumps (none of a function that is not concrete)."""
    # Four samples for each state: next to its zero and well away, on both sides.
    places = np.array([ASIDE, -ASIDE, 1.0, -1.0])
    levels = np.random.default_rng(0).uniform(0.2, 0.9, (len(signals), 1))
    at = dict(zip(signals, np.repeat(levels, len(states) * places.size, axis=1)))
    for i, state in enumerate(states):
        at[state][i * places.size : (i + 1) * places.size] = places
    try:
        with jax.ensure_compile_time_eval():
            samples = np.asarray(at[of] if isinstance(of, str) else called(of, Signals(at)))
            values = np.asarray(samples if functions is None else functions(samples))
    except Exception:  # whatever is wrong with a user's function is said where it is used
        return set()
    if not values.shape or values.shape[-1] != len(states) * places.size:
        return set()
    above, below, far, other = np.moveaxis(values.reshape(-1, len(states), places.size), -1, 0)
    jumps = np.abs(above - below) > JUMP * np.maximum(np.abs(far), np.abs(other))
    return {state for state, jump in zip(states, np.atleast_1d(jumps.any(axis=0))) if jump}


_jumping_alone = lru_cache(_jumping)

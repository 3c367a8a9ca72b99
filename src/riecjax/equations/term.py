"""One term of an equation of motion: a coefficient times a derivative of a signal expression.

Expressions of signals: what a term or a mask is made of, and common ones.

Two of the common ones that say the same compare equal, so that building an equation anew compiles
nothing anew, as a fresh `lambda` would.

Families of functions of one signal, each function with its own coefficient.

Laws with a width, each one function of one signal: dead zone, saturation, Stribeck's friction.

They are linear in their coefficient and not in the width, which is an array: sums for another width
compile nothing anew.
"""

import functools
import json
import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike

from riecjax.errors import DataError, ModelError, require, users_code
from riecjax.leaves import Leaf, as_leaf, is_concrete
from riecjax.records.record import Record, Signals

Expression = str | Callable[[Signals], Array]
"""A signal's name, or a function of the signals such as `lambda s: s["x3"] - s["x4"]`.

A function returns one number for each sample, which depends on that sample alone (long records are
worked through in chunks), or one for all if it reads no signal.
Write functions once, at module level: a new function object each time compiles anew.
"""


class Sampled(NamedTuple):
    """Samples of one or several columns, and where they are present (`None`: everywhere)."""

    values: Float[Array, "columns n"]
    present: Bool[Array, " n"] | None


def evaluate(
    expression: Expression, record: Record
) -> tuple[Float[Array, " n"], Bool[Array, " n"] | None]:
    """Samples of an expression on a record, and where every signal that it reads is present.

    **Raises:** `DataError` for a missing signal, `ModelError` if a function of the user's own
    fails or does not return one number for each sample.
    """
    signals = record.signals
    if isinstance(expression, str):
        return signals[expression], record.present((expression,))
    name = getattr(expression, "__name__", "an expression")
    with users_code(f"the expression {name}"):
        samples = jnp.asarray(expression(signals))
    # One number of the signals, such as their sum, is a slip; one of no signal is a constant.
    if samples.shape == () and not signals.read:
        samples = jnp.broadcast_to(samples, (record.sample_count,))
    if samples.shape != (record.sample_count,):
        raise ModelError(
            f"the expression {name} must return one number for each of the {record.sample_count} "
            f"samples; it returned shape {samples.shape}."
        )
    return samples, record.present(signals.read)


def read_expression(expression: Expression, signals: Signals) -> None:
    """Note in `signals.read` what an expression reads, without computing anything."""
    if isinstance(expression, str):
        _ = signals[expression]
        return
    with users_code(f"the expression {getattr(expression, '__name__', 'of a term')}"):
        jax.eval_shape(lambda: expression(signals))


class _AnySignals(Signals):
    """Signals of any name, which note in what order they are read."""

    def __init__(self):
        # An expression may ask for some signal, no matter which, to learn the number of samples.
        super().__init__({"": jnp.zeros(1)})
        self.order: list[str] = []

    def __getitem__(self, name: str) -> Array:
        if name not in self.data:
            self.order.append(name)
        return jnp.full(1, 0.5)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str)


def signals_read(expression: Expression) -> tuple[str, ...]:
    """Signals that an expression reads, in order.

    **Raises:** `ModelError` for a function that fails, or returns other than a number a sample.
    """
    if isinstance(expression, str):
        return (expression,)
    signals = _AnySignals()
    with users_code(f"the expression {label_of(expression)}"):
        shape = jax.eval_shape(lambda: jnp.asarray(expression(signals))).shape
    if shape != (1,) and (shape != () or signals.order):
        raise ModelError(
            f"the expression {label_of(expression)} must return one number for each sample; for "
            f"one sample it returned shape {shape}."
        )
    return tuple(dict.fromkeys(signals.order))


def label_of(expression: Expression) -> str:
    """What an expression is called in messages."""
    return expression if isinstance(expression, str) else getattr(expression, "__name__", "given")


def both_present(
    one: Bool[Array, " n"] | None, other: Bool[Array, " n"] | None
) -> Bool[Array, " n"] | None:
    """Where both are present."""
    if one is None or other is None:
        return other if one is None else one
    return one & other


def constant(signals: Signals) -> Array:
    """1 at every sample: `Term("offset", constant, unit="N")` is a constant force."""
    return jnp.ones(())


@dataclass(frozen=True)
class _Product:
    factors: tuple[Expression, ...]

    @property
    def __name__(self) -> str:
        return " ".join(of if isinstance(of, str) else of.__name__ for of in self.factors)

    @property
    def source(self) -> str | None:
        """As it is written, if its factors can be."""
        written = [source_of(of) for of in self.factors]
        return None if None in written else f"product({', '.join(map(str, written))})"

    def __call__(self, signals: Signals) -> Array:
        values = (signals[of] if isinstance(of, str) else of(signals) for of in self.factors)
        return functools.reduce(operator.mul, values)


@dataclass(frozen=True)
class _Difference:
    first: str
    second: str

    @property
    def __name__(self) -> str:
        return f"{self.first} - {self.second}"

    @property
    def source(self) -> str:
        """As it is written."""
        return f"difference({json.dumps(self.first)}, {json.dumps(self.second)})"

    def __call__(self, signals: Signals) -> Array:
        return signals[self.first] - signals[self.second]


@dataclass(frozen=True)
class _FasterThan:
    name: str
    threshold: float

    @property
    def __name__(self) -> str:
        return f"|{self.name}| > {self.threshold:g}"

    def __call__(self, signals: Signals) -> Array:
        return jnp.abs(signals[self.name]) > self.threshold


@dataclass(frozen=True)
class _Power:
    name: str
    power: int
    odd: bool

    @property
    def __name__(self) -> str:
        size = f"|{self.name}|"
        power = "" if self.power == 1 else f"^{self.power}"
        if self.power == 0:
            return f"sign({self.name})" if self.odd else "1"
        if self.odd == bool(self.power % 2):  # a plain power has that sign
            return f"{self.name}{power}"
        if self.odd:
            rest = "" if self.power == 2 else f"^{self.power - 1}"
            return f"{self.name} {size}{rest}"
        return f"{size}{power}"

    @property
    def source(self) -> str:
        """As it is written."""
        return f"{'odd' if self.odd else 'even'}({json.dumps(self.name)}, {self.power})"

    def __call__(self, signals: Signals) -> Array:
        x = signals[self.name]
        if self.odd == bool(self.power % 2):
            return x**self.power
        size = jnp.abs(x) ** self.power
        return jnp.sign(x) * size if self.odd else size


def odd(name: str, power: int) -> _Power:
    """sign(x) |x|^power of a signal x: dry friction of a velocity (0), drag (2), a cubic (3)."""
    return _Power(name, power, odd=True)


def even(name: str, power: int) -> _Power:
    """|x|^power of a signal x, the same in both directions."""
    return _Power(name, power, odd=False)


def source_of(of: Expression) -> str | None:
    """An expression as it is written after `import riecjax as rx`; `None` for a function of the
    user's own."""
    if isinstance(of, str):
        return json.dumps(of, ensure_ascii=False)
    if of is constant:
        return "rx.constant"
    source = getattr(of, "source", None)
    return None if source is None else f"rx.{source}"


def product(*factors: Expression) -> _Product:
    """The product of signals and expressions, such as `product("current", "flux")`."""
    return _Product(factors)


def difference(first: str, second: str) -> _Difference:
    """One signal minus another, such as the velocity across a damper."""
    return _Difference(first, second)


def faster_than(name: str, threshold: float) -> _FasterThan:
    """A mask: True where the signal's magnitude is above a threshold, in the signal's unit.

    Near standstill the sign of a measured velocity is noise, and so is Coulomb friction
    computed from it.
    """
    return _FasterThan(name, threshold)


class AbstractBasis(eqx.Module):
    """A family of functions of one variable."""

    @property
    def labels(self) -> tuple[str, ...]:
        """What is appended to a coefficient's name, one for each function."""
        raise NotImplementedError

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "functions n"]:
        """Every function at every sample."""
        raise NotImplementedError

    def interpolate(self, values: Float[Array, " functions"], x: Float[Array, " n"]) -> Array:
        """`sum values_i f_i(x)`, which some know without forming their functions."""
        return values @ self(x)


class RoofFunctions(AbstractBasis):
    """Piecewise linear roof functions R_i on break points, eq. (22) and Fig. 6.

    R_i is 1 at its break point, 0 at the others and linear between them, so that
    `sum F_i R_i(x)` interpolates the forces F_i linearly. Outside the break points the end
    segments are continued. Everywhere the functions sum to 1 and `sum v_i R_i(x) = x`.

    **Raises:** `ModelError` unless there are at least two break points in increasing order.
    """

    break_points: Float[Array, " points"]

    def __init__(self, break_points: Sequence[float] | ArrayLike | Array):
        self.break_points = jnp.asarray(break_points, jnp.result_type(float))

    def __check_init__(self):
        points = self.break_points
        if points.ndim != 1 or points.shape[0] < 2:
            raise ModelError("roof functions need at least two break points.")
        if is_concrete(points) and not bool(np.all(np.diff(points) > 0)):
            raise ModelError(f"break points must increase; got {points.tolist()}.")

    @property
    def labels(self) -> tuple[str, ...]:
        """`1`, `2`, ... in the order of the break points."""
        return tuple(str(i + 1) for i in range(self.break_points.shape[0]))

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "points n"]:
        """R_i(x) for every i."""
        # Each roof looks at x by itself: to look up the segment of x takes four times as long.
        points, widths, x = self.break_points, jnp.diff(self.break_points), x[None, :]
        one, inner = jnp.ones(1, points.dtype), points[1:-1]
        far = jnp.inf * one
        falls = ~(x < jnp.concatenate([-far, inner, far])[:, None])
        ended = x >= jnp.concatenate([inner, far, far])[:, None]
        begun = ~(x < jnp.concatenate([-far, -far, inner])[:, None])
        start = jnp.where(falls, points[:, None], jnp.pad(points, (1, 0))[:-1, None])
        width = jnp.concatenate([one, widths, one])
        share = (x - start) / jnp.where(falls, width[1:, None], width[:-1, None])
        return jnp.where(falls, jnp.where(ended, 0.0, 1 - share), jnp.where(begun, share, 0.0))

    def interpolate(self, values: Float[Array, " points"], x: Array) -> Array:
        """`sum values_i R_i(x)`, without forming the functions; x of any shape."""
        # The segment that x lies on (the nearest one outside), and its share along it.
        points = self.break_points
        last = points.shape[0] - 2
        # Comparing with the inner points vectorises where a binary search does not.
        inside = [(x >= points[i]).astype(jnp.int32) for i in range(1, last + 1)]
        below = sum(inside, start=jnp.zeros(jnp.shape(x), jnp.int32))
        share = (x - points[below]) / (points[below + 1] - points[below])
        return values[below] * (1 - share) + values[below + 1] * share


class Polynomial(AbstractBasis):
    """Powers x^p of a signal for the given exponents."""

    exponents: tuple[int, ...] = eqx.field(static=True, converter=tuple)

    @property
    def labels(self) -> tuple[str, ...]:
        """The exponents."""
        return tuple(str(p) for p in self.exponents)

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "exponents n"]:
        """x^p for every exponent p."""
        return jnp.stack([x**p for p in self.exponents])


def roof(break_points: Sequence[float]) -> RoofFunctions:
    """Roof functions on these break points; see [`RoofFunctions`][]."""
    return RoofFunctions(break_points)


class Friction(AbstractBasis):
    """Viscous and Coulomb friction, shared by both directions or separate, and Stribeck's.

    The functions of the velocity v, with the labels that are appended to a coefficient's name:

    - `viscous`: v, and `coulomb`: sign(v); or, if asymmetric, `viscous_pos`, `coulomb_pos` for
      v > 0 and `viscous_neg`, `coulomb_neg` for v < 0. Each has the sign of v, so all
      coefficients of a passive friction are positive.
    - `stribeck`: sign(v) exp(-(v / speed)^2), what is added near standstill.

    **Arguments:**

    - `asymmetric`: separate coefficients for each direction.
    - `stribeck`: Stribeck speed in the velocity's unit, or `None` for none.
    - `smooth`: width over which sign(v) goes from -1 to 1, as tanh(v / smooth), in the
      velocity's unit; `None` for the sign itself.

    **Raises:** `ModelError` unless speeds are positive.
    """

    asymmetric: bool = eqx.field(static=True)
    stribeck: Leaf | None
    smooth: Leaf | None

    def __init__(
        self,
        *,
        asymmetric: bool = False,
        stribeck: float | Array | None = None,
        smooth: float | Array | None = None,
    ):
        self.asymmetric = asymmetric
        self.stribeck = None if stribeck is None else as_leaf(stribeck)
        self.smooth = None if smooth is None else as_leaf(smooth)
        for name, speed in (("Stribeck speed", self.stribeck), ("smoothing width", self.smooth)):
            if speed is not None and is_concrete(speed) and not float(speed) > 0:
                raise ModelError(f"the {name} must be positive; got {float(speed):g}.")

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the functions; see the class."""
        sliding = ("viscous", "coulomb")
        if self.asymmetric:
            sliding = ("viscous_pos", "coulomb_pos", "viscous_neg", "coulomb_neg")
        return sliding if self.stribeck is None else (*sliding, "stribeck")

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "functions n"]:
        """Every function at every velocity."""
        direction = jnp.sign(x) if self.smooth is None else jnp.tanh(x / self.smooth)
        if self.asymmetric:
            forward, backward = x > 0, x < 0
            functions = [
                jnp.where(forward, x, 0.0),
                jnp.where(forward, direction, 0.0),
                jnp.where(backward, x, 0.0),
                jnp.where(backward, direction, 0.0),
            ]
        else:
            functions = [x, direction]
        if self.stribeck is not None:
            functions.append(direction * jnp.exp(-((x / self.stribeck) ** 2)))
        return jnp.stack(functions)


def friction(
    *, asymmetric: bool = False, stribeck: float | None = None, smooth: float | None = None
) -> Friction:
    """A basis of friction functions; see [`Friction`][]."""
    return Friction(asymmetric=asymmetric, stribeck=stribeck, smooth=smooth)


class AbstractShape(AbstractBasis):
    """A function of one signal with a width in that signal's unit.

    **Raises:** `ModelError` unless the width is positive.
    """

    width: Leaf = eqx.field(converter=as_leaf)
    label: ClassVar[str]
    """What the coefficient is of."""

    def __check_init__(self):
        if is_concrete(self.width) and not float(self.width) > 0:
            raise ModelError(f"a width must be positive; got {float(self.width):g}.")

    @property
    def labels(self) -> tuple[str, ...]:
        """What the coefficient is of."""
        return (self.label,)


class DeadZone(AbstractShape):
    """Nothing within +-width, and what is beyond it outside: play, a gap, a stop."""

    label = "stiffness"

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "1 n"]:
        """x - clip(x, -width, width)."""
        return (x - jnp.clip(x, -self.width, self.width))[None]


class Saturation(AbstractShape):
    """Linear within +-width, and constant outside."""

    label = "slope"

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "1 n"]:
        """clip(x, -width, width)."""
        return jnp.clip(x, -self.width, self.width)[None]


class Stribeck(AbstractShape):
    """What dry friction is more near standstill: sign(v) exp(-(v / width)^2)."""

    label = "force"

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "1 n"]:
        """sign(x) exp(-(x / width)^2)."""
        return (jnp.sign(x) * jnp.exp(-((x / self.width) ** 2)))[None]


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
        if order == 0:
            return self.of
        label = self.of if isinstance(self.of, str) else "an expression"
        which = {1: "first", 2: "second"}[order]
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

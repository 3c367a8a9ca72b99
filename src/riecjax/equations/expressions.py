"""Expressions of signals: what a term or a mask is made of, and common ones.

Two of the common ones that say the same compare equal, so that building an equation anew compiles
nothing anew, as a fresh `lambda` would.
"""

import functools
import json
import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from riecjax.errors import ModelError, users_code
from riecjax.records.record import Record
from riecjax.records.signals import Signals

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

"""Common functions of the signals, for terms and masks.

Two of them that say the same compare equal, so that building an equation anew compiles nothing
anew, as a fresh `lambda` would.
"""

import functools
import operator
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from riecjax.equations.equation import Equation
from riecjax.equations.term import Expression, evaluate
from riecjax.records.record import Record, Signals


def constant(signals: Signals) -> Array:
    """1 at every sample: `Term("offset", constant, unit="N")` is a constant force."""
    return jnp.ones(())


@dataclass(frozen=True)
class _Product:
    names: tuple[str, ...]

    def __call__(self, signals: Signals) -> Array:
        return functools.reduce(operator.mul, (signals[name] for name in self.names))


@dataclass(frozen=True)
class _Difference:
    first: str
    second: str

    def __call__(self, signals: Signals) -> Array:
        return signals[self.first] - signals[self.second]


@dataclass(frozen=True)
class _FasterThan:
    name: str
    threshold: float

    def __call__(self, signals: Signals) -> Array:
        return jnp.abs(signals[self.name]) > self.threshold


def product(*names: str) -> _Product:
    """The product of signals, such as `product("current", "flux")`."""
    return _Product(names)


def difference(first: str, second: str) -> _Difference:
    """One signal minus another, such as the velocity across a damper."""
    return _Difference(first, second)


def faster_than(name: str, threshold: float) -> _FasterThan:
    """A mask: True where the signal's magnitude is above a threshold, in the signal's unit.

    Near standstill the sign of a measured velocity is noise, and so is Coulomb friction
    computed from it.
    """
    return _FasterThan(name, threshold)


PROBE = 64
"""Samples that an expression is tried on."""


def mixing_expressions(equations: list[Equation], record: Record) -> list[str]:
    """Expressions whose value at one sample depends on others, as `equation: name` (not under jit).

    A mean, a difference between neighbours or a filter would see only a chunk of the record, or
    what fills it up. Each is tried on samples from all over the record, and on halves of these.
    """
    functions = [(e.name, f) for e in equations for f in _functions(e)]
    if not functions:
        return []
    at = np.linspace(0, record.sample_count - 1, PROBE).astype(int)
    probe = Record(
        {name: np.asarray(values)[at] for name, values in record.arrays.items()},
        record.time_step,
    )
    alone = _each_by_itself(tuple(f for _, f in functions), probe)
    return [
        f"{label}: {getattr(function, '__name__', 'an expression')}"
        for (label, function), good in zip(functions, np.asarray(alone))
        if not good
    ]


def _functions(equation: Equation) -> list[Expression]:
    found: list[Expression] = [term.of for term in equation.terms]
    if equation.where is not None:
        found.append(equation.where)
    return [expression for expression in found if not isinstance(expression, str)]


@eqx.filter_jit
def _each_by_itself(
    functions: tuple[Expression, ...], record: Record
) -> Bool[Array, " expressions"]:
    half = PROBE // 2
    parts = [record.part(0, half), record.part(half, PROBE)]

    def alone(function: Expression) -> Bool[Array, ""]:
        whole, _ = evaluate(function, record)
        halves = jnp.concatenate([evaluate(function, part)[0] for part in parts])
        # Of differences of large numbers, compilers may round halves otherwise than the whole.
        size = jnp.max(jnp.abs(whole), where=jnp.isfinite(whole), initial=0.0)
        return jnp.all(jnp.isclose(whole, halves, rtol=1e-9, atol=1e-9 * size, equal_nan=True))

    return jnp.stack([alone(function) for function in functions])

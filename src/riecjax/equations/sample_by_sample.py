"""Whether expressions take each sample by itself, as records in chunks or filled up need."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from riecjax.equations.equation import Equation
from riecjax.equations.term import Expression, evaluate
from riecjax.records.record import Record

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

"""Whether expressions take each sample by itself, as long records chunk by chunk need."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Array

from riecjax.equations.equation import Equation
from riecjax.equations.term import Expression, evaluate
from riecjax.errors import ModelError
from riecjax.records.record import Record, Signals

PROBE = 64
"""Samples that an expression is tried on."""


def raise_if_samples_mix(equation: Equation, record: Record) -> None:
    """Refuse expressions whose value at one sample depends on others (not under jit).

    A mean, a difference between neighbours or a filter would see only a chunk of the record.

    **Raises:** `ModelError` naming the expression.
    """
    for expression in _functions(equation):
        whole = record.part(0, PROBE)
        halves = [record.part(0, PROBE // 2), record.part(PROBE // 2, PROBE)]
        parts = np.concatenate([np.asarray(evaluate(expression, half)[0]) for half in halves])
        if not np.allclose(evaluate(expression, whole)[0], parts, rtol=1e-9, equal_nan=True):
            name = getattr(expression, "__name__", "an expression")
            raise ModelError(
                f"{equation.name}: {name} mixes samples (a mean, a difference, a filter), and a "
                f"record this long is worked through in chunks. Compute it beforehand as a signal "
                f"of the record."
            )


def _functions(equation: Equation) -> list[Callable[[Signals], Array]]:
    found: list[Expression] = [term.of for term in equation.terms]
    if equation.where is not None:
        found.append(equation.where)
    return [expression for expression in found if not isinstance(expression, str)]

"""What tells recordings and models apart: digests of all that sums depend on."""

import dataclasses
import hashlib
import json
import re
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Key, UInt32

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.laws import LengthBins
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.leaves import is_concrete
from riecjax.records.record import Record


class Outline(eqx.Module):
    """The equations that recordings are summed for, as far as sums depend on them.

    **Fields:** `stages`, each equation's name and its columns; `parameters`, the columns but for
    those that hidden elements add; `units` by parameter; `fingerprint` of the equations' terms,
    empty where their numbers were traced.
    """

    stages: tuple[tuple[tuple[str, tuple[str, ...]], ...], ...] = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True)
    units: tuple[tuple[str, str], ...] = eqx.field(static=True)
    fingerprint: str = eqx.field(static=True)

    @classmethod
    def of(cls, model: Model) -> "Outline":
        """Of a model."""
        stages = tuple(tuple((e.name, e.parameters) for e in stage) for stage in model.stages)
        fingerprint = ""
        if is_concrete(model):
            equations = [[_described(e) for e in stage] for stage in model.stages]
            written = json.dumps(equations, sort_keys=True, default=_without_address)
            fingerprint = hashlib.sha256(written.encode()).hexdigest()
        columns = (c for e in model.equations for t in e.terms for c in t.columns)
        parameters = tuple(dict.fromkeys(c.name for c in columns if not c.order))
        return cls(stages, parameters, tuple(model.units.items()), fingerprint)

    def is_of(self, other: "Outline") -> bool:
        """Whether both are of the same equations, as far as that is known."""
        known = bool(self.fingerprint and other.fingerprint)
        return self.stages == other.stages and (not known or self.fingerprint == other.fingerprint)


def digest_of(
    model: Model,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    bins: LengthBins | None,
) -> UInt32[np.ndarray, "8"]:
    """SHA-256 of a recording's samples and of all settings (not under jit).

    Functions of the signals count by their name and what they were compiled to, so that other
    versions of Python may tell recordings apart that are the same.
    """
    digest = hashlib.sha256()
    masks = {n: s.present for n, s in record.by_name.items() if s.present is not None}
    for arrays in (record.arrays, {name: ~np.asarray(mask) for name, mask in masks.items()}):
        for name, values in sorted(arrays.items()):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(values).data)
    settings = {
        "time_step": float(record.time_step),
        "criterion": criterion.describe(),
        "equations": [[_described(e) for e in stage] for stage in model.stages],
        "key": None if key is None else jax.random.key_data(key).tolist(),
        "bins": None if bins is None else bins.edges.tolist(),
        "noise": jax.tree.map(lambda taps: np.asarray(taps).tolist(), record.noise.kernels),
    }
    digest.update(json.dumps(settings, sort_keys=True, default=_without_address).encode())
    return np.frombuffer(digest.digest(), ">u4").astype(np.uint32)


def _described(equation: Equation) -> list[object]:
    """What an equation's sums depend on, as far as it has a name, a number or code."""
    return [equation.name, [_written(term) for term in equation.terms], _function(equation.where)]


def _written(value: Any) -> object:
    """A term, or a part of it, field by field. What is known of a coefficient moves no sum."""
    if isinstance(value, eqx.Module):
        fields = [field.name for field in dataclasses.fields(value)]
        parts = {name: getattr(value, name) for name in fields if name not in ("known", "unit")}
        return [type(value).__name__, {name: _written(part) for name, part in parts.items()}]
    if eqx.is_array(value):
        return np.asarray(value).tolist()
    return _function(value) if callable(value) else value


def _function(expression: str | Callable | None) -> object:
    """A signal's name, or a function's name with its code and what that refers to."""
    code = getattr(expression, "__code__", None)
    if code is None:
        return expression
    cells = [cell.cell_contents for cell in getattr(expression, "__closure__", None) or ()]
    constants = [value for value in code.co_consts if not hasattr(value, "co_code")]
    return [code.co_name, code.co_code.hex(), constants, list(code.co_names), cells]


def _without_address(value: object) -> str:
    """What is printed of an object but for where it lies in memory: elsewhere in other processes,
    which would then count a recording that two of them summed as two."""
    return re.sub(r" at 0x[0-9a-fA-F]+", "", str(value))

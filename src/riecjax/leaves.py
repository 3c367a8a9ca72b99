"""Numbers as leaves of pytrees.

A Python float in a jitted function's arguments is part of what is compiled: a new value compiles
anew. Numbers that users set therefore become arrays at the border; NumPy ones, so that building a
model at import time makes no JAX array.
"""

import dataclasses
import math
import numbers
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike

Leaf = Array | np.ndarray
Tree = TypeVar("Tree")
TINY = 1e-300
"""In place of a size of zero, which nothing is a share of."""


class PlainMethods:
    """What a module of Equinox's derives from for methods as Python binds them.

    Equinox makes a pytree of each method that is looked up, so that it may be an argument of what
    is traced; that takes fifty times as long, and what is asked hundreds of times of a recording
    is called, not passed on: `jax.jit(type(term).functions)(term, x)` in place of
    `jax.jit(term.functions)(x)`.
    """

    __getattribute__ = object.__getattribute__


def as_leaf(value: ArrayLike | Array) -> Leaf:
    """A float array of the value; JAX arrays pass unchanged."""
    if isinstance(value, jax.Array):
        return value
    return np.asarray(value, float)


def size_of(value: ArrayLike) -> float:
    """Size of a value, for shares of it."""
    return max(float(np.abs(value)), TINY)


def is_number(value: Any) -> bool:
    """Whether this is one number, traced or not."""
    kinds = numbers.Real | np.ndarray | jax.Array
    return isinstance(value, kinds) and getattr(value, "shape", ()) == ()


def finite(value: ArrayLike | Sequence[Any] | Mapping[Any, Any] | None) -> Any:
    """The number, or `None` where JSON has no word for it; of an array, nested lists of them; of a
    mapping, and of the fields of a record, the same of all that it holds; a text as it is."""
    if value is None or isinstance(value, str):
        return value
    if dataclasses.is_dataclass(value):
        value = vars(value)
    if isinstance(value, Mapping):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, tuple | list) or np.ndim(value):
        return [finite(each) for each in value]  # type: ignore[union-attr]
    number = np.asarray(value).item()
    return number if math.isfinite(number) else None


def told(thing: object, *names: str) -> dict[str, Any]:
    """Attributes of an object that are numbers, texts or arrays of them, by name."""
    return {name: finite(getattr(thing, name)) for name in names}

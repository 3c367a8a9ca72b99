"""Numbers as leaves of pytrees.

A Python float in a jitted function's arguments is part of what is compiled: a new value compiles
anew. Numbers that users set therefore become arrays at the border; NumPy ones, so that building a
model at import time makes no JAX array.
"""

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array
from numpy.typing import ArrayLike

Leaf = Array | np.ndarray


def as_leaf(value: ArrayLike | Array) -> Leaf:
    """A float array of the value; JAX arrays pass unchanged."""
    if isinstance(value, jax.Array):
        return value
    return np.asarray(value, float)


def is_concrete(*trees: object) -> bool:
    """Whether no leaf is being traced, so that values can be looked at."""
    return not any(
        isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees) if eqx.is_array(leaf)
    )

"""Numbers as leaves of pytrees.

A Python float in a jitted function's arguments is part of what is compiled: a new value compiles
anew. Numbers that users set therefore become arrays at the border; NumPy ones, so that building a
model at import time makes no JAX array.
"""

import numbers
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array
from numpy.typing import ArrayLike

Leaf = Array | np.ndarray
Tree = TypeVar("Tree")


def as_leaf(value: ArrayLike | Array) -> Leaf:
    """A float array of the value; JAX arrays pass unchanged."""
    if isinstance(value, jax.Array):
        return value
    return np.asarray(value, float)


def is_number(value: Any) -> bool:
    """Whether this is one number, traced or not."""
    kinds = numbers.Real | np.ndarray | jax.Array
    return isinstance(value, kinds) and getattr(value, "shape", ()) == ()


def on_host(tree: Tree) -> Tree:
    """The tree with NumPy arrays in place of JAX's, from which single numbers are cheap to read.

    JAX compiles a slice for each of them.
    """
    return jax.tree.map(lambda leaf: np.asarray(leaf) if eqx.is_array(leaf) else leaf, tree)


def held_still(tree: Tree) -> Tree:
    """The tree with no derivative by its arrays; what else it holds, as solvers do, is kept."""
    return jax.tree.map(
        lambda leaf: jax.lax.stop_gradient(leaf) if eqx.is_array(leaf) else leaf, tree
    )


def namespace(*trees: object) -> Any:
    """`numpy` where every number is known, `jax.numpy` where one is being traced.

    For little arithmetic on results: done by JAX, each operation would be compiled.
    """
    return np if is_concrete(*trees) else jnp


def is_concrete(*trees: object) -> bool:
    """Whether no leaf is being traced, so that values can be looked at."""
    return not any(
        isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees) if eqx.is_array(leaf)
    )


def is_under_trace() -> bool:
    """Whether JAX is tracing what runs now, so that known numbers are traced as well."""
    return not is_concrete(jnp.zeros(()))

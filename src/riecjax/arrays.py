"""One formula, run in two ways: eagerly on NumPy, or traced on JAX.

    from riecjax import arrays as xp

A function that NumPy and JAX both have goes by its usual name, `xp.where(mask, a, b)`, and runs on
NumPy unless one of its arguments is traced or lives on an accelerator. NumPy starts at once and
compiles nothing, whatever the lengths; four operations of JAX on a new length take a third of a
second. Under `jax.jit`, `jax.vmap` and `jax.grad` the same formulas are traced, with what is known
in them folded by NumPy.

What the two do differently has a name here: loops, running extremes, sums by block, entries that
are replaced. A loop takes `beside`, all that its body closes over, lest a traced number be met in a
loop that was begun by NumPy.
"""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

# Of arithmetic between the two, the types that either library declares do not know of the other.
if TYPE_CHECKING:
    Array: TypeAlias = Any
else:
    Array = jax.Array | np.ndarray
Tree = TypeVar("Tree")
KNOWN = frozenset((np.ndarray, np.float64, float, int, bool, str, slice, type(None)))
"""Types of what is no array of JAX's, which is asked thousands of times."""


def is_traced(value: Any) -> bool:
    """Whether this array, or one of these, is traced or lives elsewhere than on the host."""
    if type(value) in KNOWN:
        return False
    if isinstance(value, tuple | list):
        return any(map(is_traced, value))
    if isinstance(value, Tracer):
        return True
    return isinstance(value, jax.Array) and next(iter(value.devices())).platform != "cpu"


def are_traced(*trees: Any) -> bool:
    """Whether any leaf of some pytrees is; see [`is_traced`][riecjax.arrays.is_traced]."""
    return any(map(is_traced, jax.tree.leaves(trees)))


def is_concrete(*trees: Any) -> bool:
    """Whether no leaf is being traced, so that values can be looked at: on an accelerator too."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))


class _Functions:
    """The functions of a part of NumPy, each beside JAX's."""

    def __init__(self, host: Any, traced: Any) -> None:
        self._host, self._traced = host, traced

    def __getattr__(self, name: str) -> Any:
        host = getattr(self._host, name)
        traced: Any = getattr(self._traced, name, None)
        if not callable(host) or isinstance(host, type):
            found = host
        else:

            def found(*args: Any, **kwargs: Any) -> Any:
                if any(map(is_traced, args)) or (kwargs and any(map(is_traced, kwargs.values()))):
                    return traced(*args, **kwargs)
                # NumPy leaves an array of JAX's to that array's own methods.
                return host(*map(on_host, args), **kwargs)

            found.__name__ = name
        setattr(self, name, found)
        return found


_of_arrays = _Functions(np, jnp)
linalg = _Functions(np.linalg, jnp.linalg)
fft = _Functions(np.fft, jnp.fft)


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    return getattr(_of_arrays, name)


def on_host(value: Any) -> Any:
    """An array of JAX's as NumPy's, unless it is traced; anything else as it is."""
    if type(value) in KNOWN or not isinstance(value, jax.Array) or is_traced(value):
        return value
    return np.asarray(value)


def hosted(tree: Tree, *, double: bool = False) -> Tree:
    """A pytree with NumPy's arrays for JAX's that are known (keys stay), in `double` precision."""

    def moved(leaf: Any) -> Any:
        is_key = isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        host = leaf if is_key else on_host(leaf)
        return host.astype(float) if double and getattr(host, "dtype", None) == np.float32 else host

    is_there = any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(tree))
    return jax.tree.map(moved, tree) if is_there else tree


def products(left: Any, right: Any) -> Any:
    """Sums of left right^T over the last axis, shapes `(..., a, n)` and `(..., b, n)`."""
    if are_traced((left, right)):
        # Accelerators would otherwise multiply 32-bit numbers with ten bits.
        highest = jax.lax.Precision.HIGHEST
        return jnp.einsum("...an,...bn->...ab", left, right, precision=highest)
    return np.matmul(left, np.swapaxes(right, -1, -2))


def fft_size(least: int) -> int:
    """A size without large factors, for fast Fourier transforms, that is no smaller."""
    odd = (3**i * 5**j for i in range(4) for j in range(3))
    return min(one * 2 ** math.ceil(math.log2(max(least / one, 1))) for one in odd)


def in_double(function: Callable[..., Tree], *given: Any) -> Tree:
    """What a function that may be of JAX's makes of arrays: of known ones in double precision, and
    NumPy's."""
    if are_traced(given):
        return function(*given)
    with jax.enable_x64(True):
        return jax.tree.map(on_host, function(*given))


def jacobian(function: Callable[[Any], Any], at: dict[str, Any]) -> dict[str, Any]:
    """Derivatives of an array by each of some numbers, beside which the function closes over none.

    Of known numbers by an imaginary step: exact to rounding, if analytic (Squire and Trapp 1998).
    """
    if are_traced(at):
        return jax.jacfwd(function)(at)
    steps = {name: 1e-30 * max(abs(value), 1e-200) for name, value in at.items()}
    return {
        name: np.imag(function({**at, name: at[name] + 1j * step})) / step
        for name, step in steps.items()
    }


def stop_gradient(tree: Tree) -> Tree:
    """The tree with no derivative by its arrays."""
    return jax.tree.map(lambda leaf: jax.lax.stop_gradient(leaf) if is_traced(leaf) else leaf, tree)


def each(function: Callable[[Any], Any], items: Any, *, beside: Any = ()) -> Any:
    """What a function makes of each of some items, the leading axis of arrays, stacked.

    **Arguments:** `beside`, what the function closes over.
    """
    if are_traced(items, beside):
        return jax.lax.map(function, items)
    count = jax.tree.leaves(items)[0].shape[0]
    parts = [function(jax.tree.map(lambda leaf, at=at: leaf[at], items)) for at in range(count)]
    return stacked(parts)


def running_max(values: Any, *, reverse: bool = False) -> Any:
    """The largest value up to each along the last axis, or from each on in `reverse`."""
    if is_traced(values):
        return jax.lax.cummax(values, axis=values.ndim - 1, reverse=reverse)
    if reverse:
        return np.maximum.accumulate(values[..., ::-1], axis=-1)[..., ::-1]
    return np.maximum.accumulate(values, axis=-1)


def sum_by_block(values: Any, block: Any, number: int) -> Any:
    """Sums along the first axis over those of each of `number` blocks; others count nowhere."""
    if are_traced((values, block)):
        return jax.ops.segment_sum(values, block, num_segments=number)
    values, block = np.asarray(values), np.asarray(block)
    total = np.zeros((number, *values.shape[1:]), values.dtype)
    inside = (block >= 0) & (block < number)
    if not inside.all():
        values, block = values[inside], block[inside]
    if not block.size:
        return total
    order = np.argsort(block, kind="stable")
    block = block[order]
    first = np.flatnonzero(np.diff(block, prepend=-1))
    total[block[first]] = np.add.reduceat(values[order], first, axis=0)
    return total


def products_by_block(columns: Any, block: Any, number: int) -> Any:
    """Sums of the outer products of columns, shape `(p, n)`, over those of each block."""
    if are_traced((columns, block)):
        return sum_by_block(columns.T[:, :, None] * columns.T[:, None], block, number)
    total = np.zeros((number, columns.shape[0], columns.shape[0]), columns.dtype)
    order = np.argsort(block, kind="stable")
    rows, block = columns.T[order], np.asarray(block)[order]
    for one in np.split(np.arange(block.size), np.flatnonzero(np.diff(block)) + 1):
        if one.size:
            part = rows[one[0] : one[-1] + 1]
            total[block[one[0]]] = part.T @ part
    return total


def cut(values: Any, first: Any, count: int) -> Any:
    """`count` entries along the last axis from `first` on, which all must lie in it."""
    if are_traced((values, first)):
        return jax.lax.dynamic_slice_in_dim(values, first, count, axis=-1)
    first = int(first)
    return values[..., first : first + count]


def take(values: Any, places: Any, axis: int = -1) -> Any:
    """Entries along an axis, by whole numbers that lie in it."""
    if are_traced((values, places)):
        return jnp.take(values, places, axis=axis, mode="clip")
    return np.take(on_host(values), on_host(places), axis=axis)


def with_entries(array: Any, index: Any, values: Any) -> Any:
    """The array with other values at an index, `array[index] = values`."""
    if are_traced((array, index, values)):
        return jnp.asarray(array).at[index].set(values)
    changed = np.array(array)
    changed[index] = values
    return changed


def repeated(step: Callable[[Any], Tree], start: Tree, times: int, *, beside: Any = ()) -> Tree:
    """What a step makes of a start, over and over."""
    if are_traced(start, beside):
        return jax.lax.fori_loop(0, times, lambda _, state: step(state), start)
    for _ in range(times):
        before, start = start, step(start)
        # A step that changes nothing never does again.
        if all(map(np.array_equal, jax.tree.leaves(before), jax.tree.leaves(start))):
            break
    return start


def repeated_while(
    goes_on: Callable[[Tree], Any], step: Callable[[Tree], Tree], start: Tree, *, beside: Any = ()
) -> Tree:
    """What a step makes of a start, over and over while that goes on."""
    if are_traced(start, beside):
        return jax.lax.while_loop(goes_on, step, start)
    while goes_on(start):
        start = step(start)
    return start


def stacked(trees: Sequence[Tree]) -> Tree:
    """Pytrees of one structure as one, along a new leading axis."""
    return jax.tree.map(lambda *leaves: _of_arrays.stack(leaves), *trees)

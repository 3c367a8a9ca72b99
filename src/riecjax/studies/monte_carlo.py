"""One experiment repeated over many random keys, vmapped in chunks, on all devices.

XLA keeps small batched operations on one core of a CPU. With the CPU as several devices (see
`riecjax.start_jax`) each takes its part of a chunk.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Key


def over_keys(
    experiment: Callable[..., Any],
    key: Key[Array, ""],
    count: int,
    *args: Any,
    chunk: int = 8,
    progress: Callable[[int], None] | None = None,
) -> Any:
    """`experiment(key_i, *args)` for `count` keys made of `key`, stacked along a leading axis.

    Chunks of one size compile once and bound the memory; the surplus of the last is cut off.
    The i-th key, `jax.random.fold_in(key, i)`, does not depend on `count` or `chunk`, so more
    repetitions extend a study.

    **Arguments:**

    - `experiment`: a function at module level (a new function object compiles anew).
    - `args`: passed on, not batched.
    - `progress`: called with the number of finished repetitions after each chunk.
    """
    chunk = min(chunk, count)
    numbers = jnp.arange(-(-count // chunk) * chunk, dtype=jnp.uint32)
    keys = jax.vmap(lambda number: jax.random.fold_in(key, number))(numbers)
    parts = []
    for start in range(0, count, chunk):
        part = _batch(experiment, keys[start : start + chunk], args)
        parts.append(jax.block_until_ready(part))
        if progress is not None:
            progress(min(start + chunk, count))
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves)[:count], *parts)


@eqx.filter_jit
def _batch(
    experiment: Callable[..., Any], keys: Key[Array, " chunk"], args: tuple[Any, ...]
) -> Any:
    arrays, others = eqx.partition(args, eqx.is_array)

    def all_of(keys: Key[Array, " some"], arrays: tuple[Any, ...]) -> Any:
        given = eqx.combine(arrays, others)
        return jax.vmap(lambda key: experiment(key, *given))(keys)

    devices = jax.local_devices()
    if len(devices) == 1 or keys.shape[0] % len(devices):
        return all_of(keys, arrays)
    mesh = Mesh(np.array(devices), ("device",))
    shared = PartitionSpec("device")
    return jax.shard_map(
        all_of,
        mesh=mesh,
        in_specs=(shared, PartitionSpec()),
        out_specs=shared,
        # Nothing is exchanged between devices, so there is nothing to check.
        check_vma=False,
    )(keys, arrays)

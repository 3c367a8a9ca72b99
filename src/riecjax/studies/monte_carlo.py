"""One experiment repeated over many random keys, vmapped in chunks, on all devices.

XLA keeps small batched operations on one core of a CPU. With the CPU as several devices (see
`riecjax.start_jax`) each takes its part of a chunk.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Float, Key

from riecjax import RIEC, Estimate, ModelError, Naive, Record, Recording, identify
from riecjax.errors import require


def over_keys(
    experiment: Callable[..., Any],
    key: Key[Array, ""],
    count: int,
    *args: Any,
    first: int = 0,
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
    - `first`: number of the first of these keys, to go on from where another call ended.
    - `progress`: called with the number of finished repetitions after each chunk.
    """
    chunk = min(chunk, count)
    numbers = first + jnp.arange(-(-count // chunk) * chunk, dtype=jnp.uint32)
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


class SeedScatter(eqx.Module):
    """Estimates from many draws of windows.

    **Fields:** `theta`, shape `(seeds, p)`; `parameters`.
    """

    theta: Float[Array, "seeds p"]
    parameters: tuple[str, ...] = eqx.field(static=True)

    @property
    def spread(self) -> Float[Array, " p"]:
        """Standard deviation over the draws: of the sampling, not of the parameters."""
        return jnp.std(self.theta, axis=0, ddof=1)


def seed_scatter(
    model: Any,
    records: Record | Recording | Sequence[Record] | Sequence[Recording],
    criterion: RIEC,
    *,
    key: Key[Array, ""],
    known: Mapping[str, float | Array] | None = None,
    per_record: Sequence[str] = (),
    seeds: int = 32,
) -> SeedScatter:
    """Identify with `seeds` draws of random windows, vmapped; other arguments as for `identify`.

    Sums are taken as they are: no noise is taken off.

    **Raises:** `ModelError` for a criterion that draws nothing, or fewer than two seeds.
    """
    require("the criterion", criterion, RIEC, "rx.RIEC(rx.RandomWindows(0.05, 0.5, 8000))")
    require("the key", key, jax.Array, f"key=jax.random.key({key})")
    if not criterion.needs_key:
        raise ModelError("only random windows scatter from seed to seed; this criterion has none.")
    if seeds < 2:
        raise ModelError(f"scatter needs at least two seeds; got {seeds}.")
    values = {name: jnp.asarray(value) for name, value in (known or {}).items()}
    estimates = _estimates(
        jax.random.split(key, seeds), model, records, criterion, values, tuple(per_record)
    )
    return SeedScatter(estimates.theta, estimates.parameters)


@eqx.filter_jit
def _estimates(
    keys: Key[Array, " seeds"],
    model: Any,
    records: Any,
    criterion: RIEC,
    known: Mapping[str, Array],
    per_record: tuple[str, ...],
) -> Estimate:
    settings = {"known": known, "per_record": per_record, "intervals": Naive(), "noise": "none"}
    # Some at a time: rows of all draws at once would need their memory many times over.
    return jax.lax.map(
        lambda key: identify(model, records, criterion, key=key, **settings), keys, batch_size=4
    )

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

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import HasProcedure, Procedure, as_procedure
from riecjax.errors import ModelError, renamed, require
from riecjax.estimation.parameters import Sharing, plan_parameters
from riecjax.estimation.stages import all_normal_equations, solve_stages
from riecjax.records.record import Record, Records, as_records
from riecjax.summaries.task import record_keys, require_key


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


@renamed(own="per_record")
def seed_scatter(
    model: Equation | Procedure | HasProcedure,
    records: Records,
    criterion: AbstractCriterion,
    *,
    key: Key[Array, ""],
    known: Mapping[str, float | Array] | None = None,
    per_record: Sequence[str] = (),
    seeds: int = 32,
) -> SeedScatter:
    """Identify with `seeds` draws of random windows, vmapped; other arguments as for `identify`.

    **Raises:** `ModelError` for a criterion that draws nothing, or fewer than two seeds.
    """
    procedure = as_procedure(model)
    require(
        "the criterion", criterion, AbstractCriterion, "rx.RIEC(rx.RandomWindows(0.05, 0.5, 8000))"
    )
    require_key(key)
    if not criterion.needs_key:
        raise ModelError("only random windows scatter from seed to seed; this criterion has none.")
    if seeds < 2:
        raise ModelError(f"scatter needs at least two seeds; got {seeds}.")
    recordings = as_records(records)
    sharing, given, plan = plan_parameters(procedure, len(recordings), known, per_record)
    keys = jax.random.split(key, seeds)
    theta = _estimates(procedure, sharing, recordings, criterion, keys, given)
    return SeedScatter(theta, tuple(name for _, names in plan for name in names))


@eqx.filter_jit
def _estimates(
    procedure: Procedure,
    sharing: Sharing,
    records: list[Record],
    criterion: AbstractCriterion,
    keys: Key[Array, " seeds"],
    known: Mapping[str, Array],
) -> Float[Array, "seeds p"]:
    def with_key(key: Key[Array, ""]) -> Float[Array, " p"]:
        own_keys = record_keys(key, len(records))
        stages = all_normal_equations(procedure, sharing, records, criterion, own_keys)
        solutions = solve_stages([stage.flattened() for stage in stages], known)
        return jnp.concatenate([stage.solution.theta for stage in solutions])

    # Some at a time: rows of all draws at once would need their memory many times over.
    return jax.lax.map(with_key, keys, batch_size=4)

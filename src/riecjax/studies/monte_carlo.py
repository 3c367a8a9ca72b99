"""One experiment repeated over many random keys, vmapped in chunks, on all devices.

XLA keeps small batched operations on one core of a CPU. With the CPU as several devices (see
`riecjax.start_jax`) each takes its part of a chunk.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Bool, Float, Int, Key

import riecjax as rx
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
    records: rx.Record | rx.Recording | Sequence[rx.Record] | Sequence[rx.Recording],
    criterion: rx.RIEC,
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
    require("the criterion", criterion, rx.RIEC, "rx.RIEC(rx.RandomWindows(0.05, 0.5, 8000))")
    require("the key", key, jax.Array, f"key=jax.random.key({key})")
    if not criterion.needs_key:
        raise rx.ModelError(
            "only random windows scatter from seed to seed; this criterion has none."
        )
    if seeds < 2:
        raise rx.ModelError(f"scatter needs at least two seeds; got {seeds}.")
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
    criterion: rx.RIEC,
    known: Mapping[str, Array],
    per_record: tuple[str, ...],
) -> rx.Estimate:
    settings = {"known": known, "per_record": per_record, "intervals": rx.Naive(), "noise": "none"}
    # Some at a time: rows of all draws at once would need their memory many times over.
    return jax.lax.map(
        lambda key: rx.identify(model, records, criterion, key=key, **settings), keys, batch_size=4
    )


# The basin of attraction of a refinement's optimum, mapped by random starts.


class RecoveryMap(eqx.Module):
    """Refinements from random starts.

    **Fields:**

    - `start` and `theta` of each, shape `(starts, p)`, in the order of `parameters`.
    - `distance` of each start: the largest factor by which one of its values is off.
    - `cost` and `steps` of each.
    - `recovered`: whether it ended at the optimum, see [`recovery_map`][].
    """

    start: Float[Array, "starts p"]
    theta: Float[Array, "starts p"]
    distance: Float[Array, " starts"]
    cost: Float[Array, " starts"]
    steps: Int[Array, " starts"]
    recovered: Bool[Array, " starts"]
    parameters: tuple[str, ...] = eqx.field(static=True)

    def shares(self, edges: Sequence[float]) -> list[tuple[float, float, int, float]]:
        """(nearest, farthest, number of starts, share that recovered) between factors `edges`."""
        distance, good = np.asarray(self.distance), np.asarray(self.recovered)
        found = []
        for low, high in itertools.pairwise(edges):
            inside = (distance >= low) & (distance < high)
            share = float(np.mean(good[inside])) if inside.any() else float("nan")
            found.append((low, high, int(inside.sum()), share))
        return found


def recovery_map(
    model: Any,
    record: rx.Record,
    optimum: rx.Estimate,
    objectives: Sequence[rx.OutputError | rx.IntegralError],
    *,
    key: Key[Array, ""],
    starts: int = 100,
    farthest: float = 10.0,
    tolerance: float = 0.1,
    max_steps: int = 100,
    progress: Callable[[int], None] | None = None,
) -> RecoveryMap:
    """Refine from random starts, each value off by a factor, and see which reach the optimum.

    A start's `distance` is log-uniform from 1 to `farthest`; one value is off by all of it, up or
    down, the others by log-uniform parts of it.

    **Arguments:**

    - `optimum`: the refinement that all should end at.
    - `objectives`: refined by in turn, each from where the one before ended: short windows first
      bring poor starts near.
    - `tolerance`: how far from the optimum, in its standard errors, is still called recovered.
    - `progress`: called with the number of finished starts.

    **Raises:** `ModelError` for an optimum with a value of zero, which no factor leads away from.
    """
    if not bool(jnp.all(optimum.theta != 0)):
        raise rx.ModelError("a parameter is zero at the optimum: no factor leads away from it.")
    start, theta, distance, cost, steps = over_keys(
        _from_random_start,
        key,
        starts,
        model,
        record,
        optimum,
        tuple(objectives),
        farthest,
        max_steps,
        chunk=32,
        progress=progress,
    )
    off = jnp.abs(theta - optimum.theta[None, :]) / optimum.standard_errors[None, :]
    recovered = jnp.all(off < tolerance, axis=1)
    return RecoveryMap(start, theta, distance, cost, steps, recovered, optimum.parameters)


def _from_random_start(
    key: Key[Array, ""],
    model: Any,
    record: rx.Record,
    optimum: rx.Estimate,
    objectives: tuple[rx.OutputError | rx.IntegralError, ...],
    farthest: float,
    max_steps: int,
) -> tuple[Array, Array, Array, Array, Array]:
    far, parts, signs, which = jax.random.split(key, 4)
    p = optimum.theta.shape[0]
    distance = farthest ** jax.random.uniform(far)
    share = jax.random.uniform(parts, (p,)).at[jax.random.randint(which, (), 0, p)].set(1.0)
    sign = jnp.where(jax.random.bernoulli(signs, shape=(p,)), 1.0, -1.0)
    start = optimum.theta * distance ** (sign * share)
    theta, steps, cost = start, jnp.array(0), jnp.zeros(())
    for objective in objectives:
        values = dict(zip(optimum.parameters, theta))
        refined = rx.refine(
            model, record, values, objective, known=dict(optimum.known), max_steps=max_steps
        )
        theta, steps, cost = refined.theta, steps + refined.search.steps, refined.search.cost
    return start, theta, distance, cost, steps

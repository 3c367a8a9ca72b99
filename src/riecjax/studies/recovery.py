"""The basin of attraction of a refinement's optimum, mapped by random starts."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from riecjax import IntegralError, ModelError, OutputError, Record, Refined, refine
from riecjax.studies.monte_carlo import over_keys


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
    record: Record,
    optimum: Refined,
    objectives: Sequence[OutputError | IntegralError],
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
        raise ModelError("a parameter is zero at the optimum: no factor leads away from it.")
    found = over_keys(
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
    start, theta, distance, cost, steps = found
    off = jnp.abs(theta - optimum.theta[None, :]) / optimum.standard_errors[None, :]
    recovered = jnp.all(off < tolerance, axis=1)
    return RecoveryMap(start, theta, distance, cost, steps, recovered, optimum.parameters)


def _from_random_start(
    key: Key[Array, ""],
    model: Any,
    record: Record,
    optimum: Refined,
    objectives: tuple[OutputError | IntegralError, ...],
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
        refined = refine(
            model, record, values, objective, known=dict(optimum.known), max_steps=max_steps
        )
        theta, steps, cost = refined.theta, steps + refined.steps, refined.cost
    return start, theta, distance, cost, steps

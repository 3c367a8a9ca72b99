"""How far blocks of time move the estimates of all stages: scores, and the slope they act against.

The stages' equations are solved in turn, each with what earlier ones found. Together they are one
system of estimating equations, whose slope holds the cross terms between stages: what is uncertain
in the masses reaches the stiffness found with them.
"""

from collections.abc import Callable, Mapping

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.linear_algebra import solve_scaled
from riecjax.summaries.normal_equations import NormalEquations

Unknowns = list[tuple[int, tuple[str, ...]]]
"""Place of each stage that finds something, and the parameters it finds."""


def unknowns(stages: list[NormalEquations], known: Mapping[str, Array]) -> Unknowns:
    """What each stage finds, given what is known beforehand."""
    found = set(known)
    plan = []
    for i, equations in enumerate(stages):
        names = tuple(name for name in equations.parameters if name not in found)
        if names:
            plan.append((i, names))
            found |= set(names)
    return plan


def staged_values(
    totals: list[NormalEquations],
    plan: Unknowns,
    known: Mapping[str, Array],
    solver: Callable[[NormalEquations], Float[Array, " p"]],
) -> dict[str, Array]:
    """Every parameter by name, from the stages' normal equations (without an axis of blocks)."""
    found = dict(known)
    for i, names in plan:
        found |= dict(zip(names, solver(totals[i].fix(found))))
    return found


def in_order(plan: Unknowns, values: Mapping[str, Array]) -> Float[Array, " p"]:
    """The parameters that are found, in the order in which they are."""
    return jnp.stack([values[name] for _, names in plan for name in names])


def scores(
    stages: list[NormalEquations], plan: Unknowns, values: Mapping[str, Array]
) -> Float[Array, "blocks p"]:
    """For each block of the leading axis, the sum of regressors times residuals."""
    parts = []
    for i, names in plan:
        blocks = stages[i]
        own = jnp.array([blocks.parameters.index(name) for name in names])
        at = jnp.stack([jnp.asarray(values[name]) for name in blocks.parameters])
        parts.append(blocks.moment[..., own] - blocks.gram[..., own, :] @ at)
    return jnp.concatenate(parts, axis=-1)


def slope(totals: list[NormalEquations], plan: Unknowns) -> Float[Array, "p p"]:
    """Derivative of the scores' sum with respect to all parameters that are found, negated."""
    names = [name for _, found in plan for name in found]
    rows = []
    for i, found in plan:
        equations = totals[i]
        own = jnp.array([equations.parameters.index(name) for name in found])
        held = [name for name in equations.parameters if name in names]
        place = jnp.array([names.index(name) for name in held])
        source = jnp.array([equations.parameters.index(name) for name in held])
        empty = jnp.zeros((len(found), len(names)), equations.moments.dtype)
        rows.append(empty.at[:, place].set(equations.gram[own][:, source]))
    return jnp.concatenate(rows)


def against(
    slope: Float[Array, "p p"], scores: Float[Array, "blocks p"]
) -> Float[Array, "blocks p"]:
    """Slope^-1 times each score."""
    return solve_scaled(slope, scores.T).T


def block_influence(
    stages: list[NormalEquations], known: Mapping[str, Array], values: Mapping[str, Array]
) -> Float[Array, "blocks p"]:
    """How far each block of time moves each parameter of all stages, slope^-1 times its score."""
    plan = unknowns(stages, known)
    totals = [stage.total() for stage in stages]
    return against(slope(totals, plan), scores(stages, plan, values))

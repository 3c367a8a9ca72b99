"""How long a refinement would take, estimated from what it simulates rather than by a clock.

A step of the search expands the residuals once: every step of every simulation is taken with a
tangent for each parameter and initial state. Counted are the operations of the system's derivative,
as JAX traces it, times all of that; what one of them takes was measured
(`python -m benchmarks.refinement_gate --work`).
"""

import math
from typing import Any

import jax
import jax.numpy as jnp

from riecjax.refinement.objective import Specification
from riecjax.refinement.output_misfit import OutputMisfit
from riecjax.simulation.method import FixedStep

SECONDS_PER_OPERATION = 2e-9
"""Of a scalar operation of a derivative with its share of one tangent."""
USUAL_STEPS = 12
"""Steps that a search takes if its start is fair."""
STAGES = 4
"""Evaluations of the derivative in a step of Runge and Kutta's method."""


def estimated_seconds(misfit: OutputMisfit, specified: Specification) -> float:
    """Seconds of computing that a refinement may take, without compiling it."""
    system = misfit.system.build(specified.of_record(0))
    state, level = (
        jax.ShapeDtypeStruct((len(quantities),), jnp.result_type(float))
        for quantities in (system.states, system.inputs)
    )
    operations = _operations(jax.make_jaxpr(system.derivative)(state, level).jaxpr)
    steps = misfit.method.steps_per_sample if isinstance(misfit.method, FixedStep) else 8
    samples = sum(math.prod(part.levels.shape[:2]) for part in misfit.recorded)
    tangents = 1 + len(misfit.names) + len(misfit.estimated)
    expansion = samples * steps * STAGES * operations * tangents * SECONDS_PER_OPERATION
    return USUAL_STEPS * expansion


def _operations(jaxpr: Any) -> int:
    """Scalar operations of a traced function, those of functions that it calls included."""
    found = 0
    for equation in jaxpr.eqns:
        inner = [
            leaf
            for value in equation.params.values()
            for leaf in jax.tree.leaves(value, is_leaf=lambda v: hasattr(v, "jaxpr"))
            if hasattr(leaf, "jaxpr") or hasattr(leaf, "eqns")
        ]
        if inner:
            found += sum(_operations(getattr(one, "jaxpr", one)) for one in inner)
        else:
            found += max((math.prod(out.aval.shape) for out in equation.outvars), default=1)
    return found

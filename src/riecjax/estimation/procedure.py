"""In which order equations are solved: one by one, or together.

Both are lists of stages. A stage is a group of equations whose normal equations are added; what
earlier stages found is known to later ones. The paper's three stages are `staged(...)` of three
equations; its remark that all parameters may be estimated at once is `simultaneous(...)`.
"""

from collections.abc import Iterable, Mapping
from typing import Protocol

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.criteria.criterion import Rows
from riecjax.equations.equation import Equation
from riecjax.errors import ModelError
from riecjax.estimation.least_squares import Solution, solve, solve_rows
from riecjax.estimation.normal_equations import NormalEquations
from riecjax.leaves import Leaf


class Procedure(eqx.Module):
    """Stages of equations; see [`staged`][] and [`simultaneous`][]."""

    stages: tuple[tuple[Equation, ...], ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all coefficients, in order of first appearance."""
        return tuple(dict.fromkeys(name for names in self.stage_parameters for name in names))

    @property
    def stage_parameters(self) -> list[tuple[str, ...]]:
        """Names of the coefficients of each stage, in order of first appearance."""
        return [
            tuple(dict.fromkeys(name for equation in stage for name in equation.parameters))
            for stage in self.stages
        ]

    @property
    def units(self) -> dict[str, str]:
        """Unit of each coefficient."""
        units: dict[str, str] = {}
        for stage in self.stages:
            for equation in stage:
                units |= {k: v for k, v in equation.units.items() if v or k not in units}
        return units

    @property
    def known(self) -> Mapping[str, Leaf]:
        """Values that the equations themselves call known."""
        known: dict[str, Leaf] = {}
        for stage in self.stages:
            for equation in stage:
                known |= equation.known
        return known

    def plan(self, known: set[str]) -> list[tuple[str, tuple[str, ...]]]:
        """(stage name, parameters it finds) for each stage, given what is known beforehand.

        **Raises:** `ModelError` if a stage has nothing to set its scale: every coefficient in it
        is unknown and no term is known, so that zero would solve it.
        """
        found: set[str] = set(known)
        plan = []
        for stage, names in zip(self.stages, self.stage_parameters):
            unknown = tuple(name for name in names if name not in found)
            label = " + ".join(equation.name for equation in stage)
            if unknown and not all(_anchored(stage, found)):
                raise ModelError(
                    f"{label}: every coefficient is unknown, so all of them zero would fit. "
                    f"Fix one of {', '.join(unknown)} (on the command line: --set NAME=VALUE)."
                )
            plan.append((label, unknown))
            found |= set(unknown)
        return plan


def _anchored(stage: tuple[Equation, ...], found: set[str]) -> list[bool]:
    """For each equation, whether a known term sets its scale, if through shared parameters."""
    reached, size = set(found), -1
    while len(reached) > size:
        size = len(reached)
        for equation in stage:
            if equation.has_target or set(equation.parameters) & reached:
                reached |= set(equation.parameters)
    return [bool(set(equation.parameters) & reached) for equation in stage]


class HasProcedure(Protocol):
    """Something that builds a procedure, such as a built-in `Model`."""

    def build_procedure(self) -> Procedure:
        """The procedure."""
        ...


def as_procedure(model: Equation | Procedure | HasProcedure) -> Procedure:
    """The procedure of an equation, of a model, or itself."""
    if isinstance(model, Procedure):
        return model
    return staged(model) if isinstance(model, Equation) else model.build_procedure()


def staged(*equations: Equation) -> Procedure:
    """Solve equations one after the other; each takes what came before as known."""
    return Procedure(tuple((equation,) for equation in equations))


def simultaneous(*equations: Equation) -> Procedure:
    """Solve equations together for all their parameters: one Gram matrix, summed over them.

    The equations' residuals are weighted alike, so they should be in the same unit.
    """
    return Procedure((equations,))


class StageSolution(eqx.Module):
    """What one stage found.

    **Fields:** `solution`; `relative_rms` of the residual against the target, `residual_rms` in
    the unit of the rows; `count` of rows; `relative_size` of each regressor against the target,
    per unit of its parameter; `parameters` found here; `stage` its place in the
    procedure.
    """

    solution: Solution
    relative_rms: Float[Array, ""]
    residual_rms: Float[Array, ""]
    count: Float[Array, ""]
    relative_size: Float[Array, " p"]
    parameters: tuple[str, ...] = eqx.field(static=True)
    stage: int = eqx.field(static=True)


def found_values(
    solutions: Iterable[StageSolution], known: Mapping[str, Array]
) -> dict[str, Array]:
    """Every parameter by name: what is known, and what the stages found."""
    values = dict(known)
    for stage in solutions:
        values |= dict(zip(stage.parameters, stage.solution.theta))
    return values


def solve_stages(
    stages: list[NormalEquations],
    known: Mapping[str, Array],
    rows: list[Rows] | None = None,
) -> list[StageSolution]:
    """Solve each stage's normal equations (blocks along the leading axis) in turn.

    Given `rows`, they are solved instead of the Gram matrices, which is slower and more accurate.
    """
    found = dict(known)
    solutions = []
    for i, blocks in enumerate(stages):
        equations = blocks.total().fix(found)
        if not equations.parameters:
            continue
        solution = solve(equations) if rows is None else solve_rows(rows[i].fix(found))
        residual = equations.residual_energy(solution.theta)
        positive = equations.energy > 0
        share = jnp.where(positive, residual / jnp.where(positive, equations.energy, 1.0), 0.0)
        solutions.append(
            StageSolution(
                solution,
                jnp.sqrt(share),
                jnp.sqrt(residual / jnp.maximum(equations.count, 1)),
                equations.count,
                jnp.sqrt(jnp.diagonal(equations.gram) / jnp.where(positive, equations.energy, 1.0)),
                equations.parameters,
                i,
            )
        )
        found |= dict(zip(equations.parameters, solution.theta))
    return solutions

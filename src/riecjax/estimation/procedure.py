"""In which order equations are solved: one by one, or together.

Both are lists of stages. A stage is a group of equations whose normal equations are added; what
earlier stages found is known to later ones. The paper's three stages are `staged(...)` of three
equations; its remark that all parameters may be estimated at once is `simultaneous(...)`.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.criteria.criterion import Rows
from riecjax.equations.equation import Equation
from riecjax.errors import ModelError, require
from riecjax.estimation.elimination import solve_scaled
from riecjax.estimation.least_squares import Solution, solve, solve_rows
from riecjax.estimation.normal_equations import NormalEquations
from riecjax.leaves import Leaf
from riecjax.records.record import Record


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
    def equation_names(self) -> list[tuple[str, ...]]:
        """Names of the equations of each stage, numbered where several are called the same."""
        names = iter(told_apart([e.name for stage in self.stages for e in stage]))
        return [tuple(next(names) for _ in stage) for stage in self.stages]

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
    """The procedure of an equation, of a model, or itself.

    **Raises:** `ModelError` for anything else, saying what to write.
    """
    if isinstance(model, Procedure):
        return model
    if isinstance(model, Equation):
        return staged(model)
    require_no_slip(model)
    if not hasattr(model, "build_procedure"):
        require("the model", model, (Equation, Procedure), SOME_MODEL)
    return model.build_procedure()


SOME_MODEL = "an rx.Equation(...), rx.staged(...) of several, or rx.find_model('quarter-car')"


def require_no_slip(model: object) -> None:
    """Raise `ModelError` for what is often taken for a model, saying what to write."""
    if isinstance(model, str):
        write = f"rx.find_model('{model}') for a built-in model or one of a file"
    elif isinstance(model, list | tuple):
        write = "rx.staged(*equations), or rx.simultaneous(*equations) to solve them together"
    elif isinstance(model, Record):
        write = "the model first, then its records"
    elif isinstance(model, type) and (
        issubclass(model, Equation | Procedure) or hasattr(model, "build_procedure")
    ):
        write = SOME_MODEL
    else:
        return
    require("the model", model, (), write)


def staged(*equations: Equation) -> Procedure:
    """Solve equations one after the other; each takes what came before as known.

    **Raises:** `ModelError` for what is no `Equation`.
    """
    _require_equations(equations, "staged")
    return Procedure(tuple((equation,) for equation in equations))


def simultaneous(*equations: Equation) -> Procedure:
    """Solve equations together for all their parameters: one Gram matrix, summed over them.

    The equations' residuals are weighted alike, so they should be in the same unit. An equation
    all of whose terms are unknown pulls its coefficients towards zero, where its residual vanishes:
    by how much is a finding, `no_known_term`, and solving it after the others by [`staged`][]
    avoids it.

    **Raises:** `ModelError` for what is no `Equation`.
    """
    _require_equations(equations, "simultaneous")
    return Procedure((equations,))


def _require_equations(equations: tuple[object, ...], name: str) -> None:
    for equation in equations:
        require(
            f"an equation of {name}(...)",
            equation,
            Equation,
            f"rx.{name}(first, second): equations one by one, rx.{name}(*equations) of a list",
        )
    if not equations:
        raise ModelError(f"{name}(...) needs at least one equation.")


def told_apart(names: Sequence[str]) -> tuple[str, ...]:
    """The names, numbered where several are equal: `spring (1)`, `spring (2)`."""
    place = {name: 0 for name in names}
    unique = []
    for name in names:
        place[name] += 1
        unique.append(f"{name} ({place[name]})" if names.count(name) > 1 else name)
    return tuple(unique)


class EquationFit(eqx.Module):
    """What is left of one equation, in a stage that may have several.

    **Fields:** `relative_rms` of the residual against the equation's target, or against its largest
    term where it has none (or nothing in it is unknown); `residual_rms` in the unit of the rows;
    `count` of rows; `shrinkage`: of an equation without a target, share by which it makes its
    coefficients smaller than the stage's other equations would have them; `parameters` found here.
    """

    relative_rms: Float[Array, ""]
    residual_rms: Float[Array, ""]
    count: Float[Array, ""]
    shrinkage: Float[Array, ""]
    parameters: tuple[str, ...] = eqx.field(static=True)


class StageSolution(eqx.Module):
    """What one stage found.

    **Fields:** `solution`; `relative_rms` of the residual against the target, `residual_rms` in
    the unit of the rows; `count` of rows; `relative_size` of each regressor against the target,
    per unit of its parameter, and where it acts if that is in bursts; `equations`, what is left of
    each; `parameters` found here; `stage` its place in the procedure.
    """

    solution: Solution
    relative_rms: Float[Array, ""]
    residual_rms: Float[Array, ""]
    count: Float[Array, ""]
    relative_size: Float[Array, " p"]
    equations: tuple[EquationFit, ...]
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
    apart: list[list[NormalEquations]] | None = None,
) -> list[StageSolution]:
    """Solve each stage's normal equations (blocks along the leading axis) in turn.

    Given `rows`, they are solved instead of the Gram matrices, which is slower and more accurate.
    Of a stage of several equations what each leaves is told if they are given `apart`.
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
        relative, absolute = _rms(residual, equations.energy, equations.count)
        alone = EquationFit(
            relative, absolute, equations.count, jnp.zeros_like(relative), equations.parameters
        )
        before = found
        found = found | dict(zip(equations.parameters, solution.theta))
        several = apart[i] if apart else []
        fits = [_equation_fit(part.total(), equations, before, found) for part in several]
        solutions.append(
            StageSolution(
                solution,
                relative,
                absolute,
                equations.count,
                jnp.sqrt(jnp.diagonal(equations.gram) / jnp.where(positive, equations.energy, 1.0)),
                tuple(fits) or (alone,),
                equations.parameters,
                i,
            )
        )
    return solutions


def _rms(energy: Array, reference: Array, count: Array) -> tuple[Array, Array]:
    """Root mean squares relative to a reference (0 where that is silent), and absolute."""
    positive = reference > 0
    share = jnp.where(positive, energy / jnp.where(positive, reference, 1.0), 0.0)
    return jnp.sqrt(share), jnp.sqrt(energy / jnp.maximum(count, 1))


def _equation_fit(
    part: NormalEquations,
    stage: NormalEquations,
    before: Mapping[str, Array],
    found: Mapping[str, Array],
) -> EquationFit:
    """What a stage leaves of one of its equations.

    **Arguments:** `part`, the equation with all its coefficients; `stage`, with those that it
    finds; `before` and `found`, what is known before the stage and after it.
    """
    equation = part.fix(before)
    unknown = equation.parameters
    theta = jnp.stack([found[name] for name in unknown]) if unknown else jnp.zeros(0)
    energy = equation.residual_energy(theta)
    values = jnp.stack([jnp.asarray(found[name]) for name in part.parameters])
    largest = jnp.maximum(part.energy, jnp.max(values**2 * jnp.diagonal(part.gram)))
    has_target = (equation.energy > 0) & bool(unknown)
    relative, absolute = _rms(
        energy, jnp.where(has_target, equation.energy, largest), equation.count
    )
    shrinkage = jnp.zeros_like(relative)
    if unknown:
        shrinkage = jnp.where(has_target, 0.0, _shrinkage(equation, stage, theta, energy))
    return EquationFit(relative, absolute, equation.count, shrinkage, unknown)


def _shrinkage(
    equation: NormalEquations, stage: NormalEquations, theta: Float[Array, " own"], energy: Array
) -> Float[Array, ""]:
    """Share by which an equation without a target shrinks its coefficients theta.

    Its residual A theta is homogeneous: scaled with s, theta costs s^2 |A theta|^2, and the minimum
    of the sum trades that against what the stage's other equations ask for. With S their curvature
    along theta, all other parameters following, the sum's slope vanishes at s = 1 and theirs alone
    at 1 + |A theta|^2 / S.
    """
    own = np.array([stage.parameters.index(name) for name in equation.parameters])
    others = np.setdiff1d(np.arange(len(stage.parameters)), own)
    rest = stage.gram - equation.embed(stage.parameters).gram
    pulled = rest[:, own] @ theta
    curvature = theta @ pulled[own]
    if others.size:
        follow = solve_scaled(rest[np.ix_(others, others)], pulled[others][:, None])[:, 0]
        curvature = curvature - pulled[others] @ follow
    both = energy + jnp.maximum(curvature, 0.0)
    return jnp.where(both > 0, energy / jnp.where(both > 0, both, 1.0), 0.0)

"""Linear least squares with scaled columns, and what can be said of its conditioning."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.criteria.criterion import Rows
from riecjax.estimation.constraints import (
    NONE,
    Constraints,
    constrained_blocks,
    diagonal_block,
    holding,
    prior_curvature,
    sides_of_bounds,
)
from riecjax.estimation.parameters import ParameterTable
from riecjax.leaves import Leaf
from riecjax.linear_algebra import solve_scaled, symmetric_eigen, unit_diagonal, unit_scale
from riecjax.summaries.normal_equations import (
    NormalEquations,
    ShortBlocks,
    sum_of_equations,
)
from riecjax.uncertainty.covariances import BlockStatistics, scores


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """A least-squares solution.

    **Fields:**

    - `theta`: parameters, shape `(p,)`; of least norm in scaled columns where they are not unique.
    - `condition_number`: of the regressor matrix with its columns scaled to unit length.
    - `rank`: numerical rank of that matrix.
    - `weakest_direction`: unit vector over the parameters, each in units of one over its column's
      length, along which the residual changes least: the combination the data tells least about.
    """

    theta: Float[Array, " p"]
    condition_number: Float[Array, ""]
    rank: Int[Array, ""]
    weakest_direction: Float[Array, " p"]


def solve(equations: NormalEquations) -> Solution:
    """Solve normal equations (without a leading axis of blocks).

    Columns are scaled to unit length first, which makes the condition number independent of units
    and, among diagonal scalings, close to the least possible. The derivative with respect to the
    equations is the implicit one, of any order, also where the rank is deficient.
    """
    # G theta = m differentiates to G dtheta = dm - dG theta: one more solve with the same G, here
    # with its eigenvectors, which are not differentiated themselves (their derivative divides by
    # differences of eigenvalues). Where the rank is deficient, the pseudo-inverse keeps theta in
    # the range of G. lax's linear solve rather than lineax's: the latter's derivative raises on
    # numbers that are not finite, which optimisers and diverged lanes of a batch may pass through.
    gram, scale = unit_diagonal(equations.gram)
    # Rounding of the Gram matrix hides singular values of A below sqrt(eps) of the largest.
    tolerance = float(xp.finfo(gram.dtype).eps) * gram.shape[0]
    eigenvalues, vectors = symmetric_eigen(xp.stop_gradient(gram))
    valid = eigenvalues > tolerance * eigenvalues[-1]
    inverse = xp.where(valid, 1 / xp.where(valid, eigenvalues, 1.0), 0.0)

    def solved(_: Any, right: Array) -> Array:
        return vectors @ (inverse * (vectors.T @ right))

    moment = equations.moment * scale
    if xp.are_traced((gram, moment)):
        theta = jax.lax.custom_linear_solve(lambda x: gram @ x, moment, solved, symmetric=True)
    else:
        theta = solved(None, moment)
    singular_values = xp.sqrt(xp.maximum(eigenvalues, 0))
    return _solution(theta * scale, singular_values, vectors[:, 0], tolerance**0.5)


FACTORED = 2**13
"""Rows whose rounding a triangular factor may hold, and which decides about its rank."""


def solve_rows(rows: Rows) -> Solution:
    """Solve rows by a singular value decomposition: slower, accurate to eps times cond (not under
    jit)."""
    scale = unit_scale(np.sum(rows.regressors**2, axis=0))
    matrix = rows.regressors * scale[None, :]
    tolerance = float(np.finfo(matrix.dtype).eps) * max(*matrix.shape, FACTORED)
    # With fewer rows than parameters the further singular values are zero.
    further = max(matrix.shape[1] - matrix.shape[0], 0)
    matrix, target = np.pad(matrix, [(0, further), (0, 0)]), np.pad(rows.target, (0, further))
    left, sizes, right = np.linalg.svd(matrix, full_matrices=False)
    valid = sizes > tolerance * sizes[0]
    theta = np.where(valid, left.T @ target / np.where(valid, sizes, 1.0), 0.0) @ right
    return _solution(theta * scale, sizes[::-1], right[-1], tolerance)


def _solution(
    theta: Array, ascending: Float[Array, " p"], weakest: Array, tolerance: float
) -> Solution:
    largest, smallest = ascending[-1], ascending[0]
    floor = xp.finfo(ascending.dtype).tiny
    rank = xp.sum(ascending > tolerance * largest)
    return Solution(theta, largest / xp.maximum(smallest, floor), rank, weakest)


# Normal equations of stages over records, solved in turn, and what is left of every equation.


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class EquationFit:
    """What is left of one equation, in a stage that may have several.

    **Fields:** `relative_rms` of the residual against the equation's target, or against its largest
    term where it has none (or nothing in it is unknown); `residual_rms` in the unit of the rows;
    `count` of rows; `noise_rms`: what of `relative_rms` the sensors' known noise makes (their
    squares subtract); `shrinkage`: of an equation without a target, share by which it makes its
    coefficients smaller than the stage's other equations would have them; `parameters` found here.
    """

    relative_rms: Float[Array, ""]
    residual_rms: Float[Array, ""]
    noise_rms: Float[Array, ""]
    count: Float[Array, ""]
    shrinkage: Float[Array, ""]
    parameters: tuple[str, ...] = dataclasses.field(metadata={"static": True})

    @property
    def model_rms(self) -> Float[Array, ""]:
        """What of `relative_rms` the sensors' known noise does not make."""
        return xp.sqrt(xp.maximum(xp.square(self.relative_rms) - xp.square(self.noise_rms), 0.0))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class StageSolution(EquationFit):
    """What one stage found, and what is left of its rows.

    **Further fields:** `solution`; `relative_size` of each regressor against the target, per unit
    of its parameter, and where it acts if that is in bursts; `equations`, what is left of each;
    `prior_curvature`, what priors add to the curvature; which are `at_bound`; `stage` its place in
    the model.
    """

    solution: Solution
    relative_size: Float[Array, " p"]
    equations: tuple[EquationFit, ...]
    prior_curvature: Float[Array, " p"]
    at_bound: Bool[Array, " p"]
    stage: int = dataclasses.field(metadata={"static": True})

    def constrain(
        self, blocks: NormalEquations, values: Mapping[str, Array], constraints: Constraints
    ) -> NormalEquations:
        """Blocks of the stage with what priors and bounds of its parameters add."""
        if not {*self.parameters} & {*constraints.priors, *constraints.bounds}:
            return blocks
        place = np.array([blocks.parameters.index(name) for name in self.parameters])
        at = xp.stack([values[name] for name in blocks.parameters])
        held = xp.with_entries(np.zeros(at.shape, bool), place, self.at_bound)
        curvature = xp.with_entries(np.zeros(at.shape, at.dtype), place, self.prior_curvature)
        return constrained_blocks(blocks, at, held, curvature)


def _constrained(
    equations: NormalEquations,
    rows: Rows | None,
    constraints: Constraints,
    curvature: Float[Array, " p"],
) -> tuple[Solution, Bool[Array, " p"]]:
    """The solution with priors and within bounds, and which parameters are held at one.

    Rank and conditioning are those without bounds, which tell nothing apart.

    **Arguments:** `curvature` of the priors.
    """
    names = equations.parameters

    def solved(held: Array, values: Array, curvature: Array, moment: Array) -> Solution:
        mix, block = holding(held, values), diagonal_block(names, curvature, moment)
        if rows is None:
            return solve(equations.mixed(mix, names) + block)
        root = xp.sqrt(curvature)
        further = xp.where(root > 0, moment / xp.where(root > 0, root, 1.0), 0.0)
        further = xp.concatenate([further[None], xp.diag(root)])
        columns = xp.concatenate([mix @ rows.columns, further], axis=1)
        return solve_rows(Rows(columns, np.arange(columns.shape[1]), names))

    held, moment = np.zeros(len(names), bool), curvature * constraints.prior(names)[0]
    solution = solved(held, moment, curvature, moment)
    if {*names} & {*constraints.bounds}:
        side = sides_of_bounds(equations + diagonal_block(names, curvature, moment), constraints)
        lower, upper = constraints.limits(names)
        held, bound = side != 0, xp.where(side < 0, lower, upper)
        curvature, moment = xp.where(held, 1.0, curvature), xp.where(held, bound, moment)
        theta = xp.where(held, bound, solved(held, bound, curvature, moment).theta)
        solution = dataclasses.replace(solution, theta=xp.clip(theta, lower, upper))
    return solution, held


def solve_stages(
    stages: list[NormalEquations],
    known: Mapping[str, Array],
    rows: list[Rows] | None = None,
    apart: list[list[NormalEquations]] | None = None,
    constraints: Constraints = NONE,
    short: ShortBlocks | None = None,
) -> tuple[list[StageSolution], dict[str, Array]]:
    """Solve each stage's normal equations (blocks along the leading axis) in turn.

    Given `rows`, they are solved instead of the Gram matrices, which is slower and more accurate.
    Of a stage of several equations what each leaves is told if they are given `apart`. Priors of
    `constraints` are weighed by `short` blocks of all records, which are then the leading axis.

    **Returns:** what each finds, and every parameter by name, what is known among them.
    """
    found = dict(known)
    solutions: list[StageSolution] = []
    informed: list[NormalEquations] = []
    for i, blocks in enumerate(stages):
        equations = blocks.total().fix(found)
        informed.append(blocks)
        names = equations.parameters
        if not names:
            continue
        of_stage = None if rows is None else rows[i].fix(found)
        solution = solve(equations) if of_stage is None else solve_rows(of_stage)
        before, curvature = found, xp.zeros_like(solution.theta)
        held = np.zeros(curvature.shape, bool)
        if {*names} & {*constraints.priors}:
            assert short is not None
            curvature = prior_curvature(
                informed,
                known,
                found | dict(zip(names, solution.theta)),
                constraints,
                [stage.prior_curvature for stage in solutions],
                short,
            )
        if {*names} & {*constraints.priors, *constraints.bounds}:
            solution, held = _constrained(equations, of_stage, constraints, curvature)
            curvature = xp.where(held, 0.0, curvature)
        found = found | dict(zip(names, solution.theta))
        whole = _fit(equations, solution.theta, equations.energy)
        several = apart[i] if apart else []
        fits = [_fit_of_part(part.total(), equations, before, found) for part in several]
        reference = xp.where(equations.energy > 0, equations.energy, 1.0)
        size = xp.sqrt((xp.diagonal(equations.gram) + curvature) / reference)
        solutions.append(
            StageSolution(
                **vars(whole),
                solution=solution,
                relative_size=size,
                equations=tuple(fits) or (whole,),
                prior_curvature=curvature,
                at_bound=held,
                stage=i,
            )
        )
        informed[-1] = solutions[-1].constrain(blocks, found, constraints)
    return solutions, found


def _fit(equations: NormalEquations, theta: Float[Array, " p"], reference: Array) -> EquationFit:
    """What is left at theta, relative to the energy of a reference (0 where that is silent)."""
    positive = reference > 0
    size = xp.where(positive, reference, 1.0)
    left = equations.residual_energy(theta)
    relative, noise = (
        xp.sqrt(xp.where(positive, energy / size, 0.0))
        for energy in (left, equations.noise_energy(theta))
    )
    absolute = xp.sqrt(left / xp.maximum(equations.count, 1))
    nothing = xp.zeros_like(relative)
    return EquationFit(relative, absolute, noise, equations.count, nothing, equations.parameters)


def _fit_of_part(
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
    theta = xp.stack([found[name] for name in unknown]) if unknown else np.zeros(0)
    values = xp.stack([found[name] for name in part.parameters])
    largest = xp.maximum(part.energy, xp.max(values**2 * xp.diagonal(part.gram)))
    has_target = (equation.energy > 0) & bool(unknown)
    fit = _fit(equation, theta, xp.where(has_target, equation.energy, largest))
    if not unknown:
        return fit
    # The share by which an equation without a target shrinks its coefficients theta. Its residual
    # A theta is homogeneous: scaled with s, theta costs s^2 |A theta|^2, and the minimum of the sum
    # trades that against what the stage's other equations ask for. With S their curvature along
    # theta, all other parameters following, the sum's slope vanishes at s = 1 and theirs alone at
    # 1 + |A theta|^2 / S.
    own = np.array([stage.parameters.index(name) for name in unknown])
    others = np.setdiff1d(np.arange(len(stage.parameters)), own)
    rest = stage.gram - equation.embed(stage.parameters).gram
    pulled = rest[:, own] @ theta
    curvature = theta @ pulled[own]
    if others.size:
        follow = solve_scaled(rest[np.ix_(others, others)], pulled[others][:, None])[:, 0]
        curvature = curvature - pulled[others] @ follow
    energy = equation.residual_energy(theta)
    both = energy + xp.maximum(curvature, 0.0)
    share = xp.where(both > 0, energy / xp.where(both > 0, both, 1.0), 0.0)
    return dataclasses.replace(fit, shrinkage=xp.where(has_target, 0.0, share))


def stages_over_records(
    equations: list[list[NormalEquations]], table: ParameterTable
) -> tuple[list[NormalEquations], list[list[NormalEquations]]]:
    """Normal equations of stages, and of each equation, among the parameters of all records.

    **Arguments:** `equations` of each stage, with a leading axis of records.
    """
    apart = [[over_records(e, table) for e in stage] for stage in equations]
    return [sum_of_equations(stage) for stage in apart], apart


def over_records(equations: NormalEquations, table: ParameterTable) -> NormalEquations:
    """Normal equations with a leading axis of records, among the parameters of all of them."""
    names = equations.parameters
    if not table.per_record:
        return equations
    every = []
    for i in range(len(equations.count)):
        record = jax.tree.map(lambda leaf, i=i: leaf[i], equations)
        record = dataclasses.replace(record, parameters=table.of_record(names, i))
        every.append(record.embed(table.everywhere(names)))
    return xp.stacked(every)


# How far an equation's sums bear out the noise that is taken off them, and what is unsure of it.
#
# **Bound.** Less what noise adds, the moments of target and regressors are those of the signals,
# which no combination of columns can make negative. So C <= M: the largest eigenvalue of C against
# M is at most one, and one if the model is right, since then nothing but noise is left of the
# equation. Noise that comes out larger is not there: the motion itself, or a command, reached up to
# half the sampling rate and was taken for it. Then C is taken as large as it can be, and no larger.

SCATTER = 1.25
"""Eigenvalue up to which noise that is judged right may come out, by chance."""
MOST = 0.9
"""Share of the regressors' moments that is taken off at most."""


def largest_share(
    noise: Float[Array, "q q"], moments: Float[Array, "q q"]
) -> tuple[Float[Array, ""], Float[Array, " q"]]:
    """The largest eigenvalue of one matrix against another, and its vector over the columns."""
    scaled, scale = unit_diagonal(moments)
    ridge = 100 * float(np.finfo(scaled.dtype).eps)
    values, vectors = symmetric_eigen(scaled)
    # Square roots of the eigenvalues bring the moments to the unit matrix.
    root = vectors / xp.sqrt(xp.maximum(values, 0.0) + ridge)[None, :]
    shares, mixed = symmetric_eigen(root.T @ (noise * scale[:, None] * scale[None, :]) @ root)
    return shares[-1], scale * (root @ mixed[:, -1])


def borne_out(equations: NormalEquations) -> NormalEquations:
    """The same, with leading axes `(records, blocks)`, and no more noise than moments bear out."""
    if equations.noise is None:
        return equations
    total = equations.flattened().total()
    assert total.noise is not None
    noise, moments = xp.stop_gradient((total.noise, total.moments))
    with_target = largest_share(noise, moments)[0]
    regressors = largest_share(noise[1:, 1:], moments[1:, 1:])[0]
    least = xp.finfo(noise.dtype).tiny
    share = xp.where(with_target > SCATTER, 1 / xp.maximum(with_target, least), 1.0)
    share = xp.minimum(share, MOST / xp.maximum(regressors, least))
    of_source = None if equations.noise_of_source is None else share * equations.noise_of_source
    return equations.with_noise(share * equations.noise, of_source)


def level_covariance(
    statistics: BlockStatistics, freedom: Float[Leaf, "records sources"]
) -> Float[Array, "p p"]:
    """Covariance of the estimates because the noise's variances were themselves estimated.

    A variance with nu degrees of freedom scatters by sqrt(2 / nu) of itself, and takes with it what
    is subtracted from the scores.

    **Arguments:** `freedom` of the variances of each source.
    """
    # Sources of all records, one after the other, in place of blocks.
    of_source = []
    for stage in statistics.short_stages:
        assert stage.noise_of_source is not None
        moments = stage.noise_of_source.reshape(-1, *stage.moments.shape[-2:])
        of_source.append(NormalEquations(moments, np.zeros(len(moments)), stage.parameters))
    moved = scores(of_source, statistics.unknowns, statistics.values)
    moved = solve_scaled(statistics.slope, moved.T)
    spread = moved * xp.sqrt(2 / xp.asarray(freedom)).ravel()[None, :]
    return spread @ spread.T

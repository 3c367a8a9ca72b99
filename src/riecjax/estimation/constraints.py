"""Bounds and priors of parameters, and what least squares make of them.

**A prior is one more block** of the normal equations H theta = m of the stage that finds its
parameter: curvature l_j = v_j / std_j^2 on the diagonal, and the moment l_j mean_j. That is what a
row of variance v_j adds which tells of theta_j alone, by mean_j with the error std_j. All hangs on
v_j, the variance of rows if they were independent: windows overlap and errors are autocorrelated,
so that their own variance says little. It is asked of blocks of time. With B the covariance of the
scores and R = (H + ridge)^-1,

    v_j = (R B R)_jj / (R H R)_jj,

the sandwich's variance over that which independent rows of unit variance would give.

- Where B = v H, as of independent rows, every v_j is v, whatever the ridge: the posterior of linear
  regression with that variance.
- With one prior, and all other parameters eliminated, data tell of theta_j by a curvature
  h_j = 1 / (H^-1)_jj and with the variance V_jj = (H^-1 B H^-1)_jj. So v_j = V_jj h_j, and
  l_j / h_j = V_jj / std_j^2: precision weighting of the sandwich with the prior, whatever B is.
  Several priors are weighed so as well where errors are alike in all that they are of; elsewhere
  their weights are not the best, and the covariance below holds all the same.
- H may be singular. Along a combination that data do not tell, H and B are rounding, eps of the
  rest, and R is one over the ridge. At a ridge of the cube root of eps their share in either
  product is eps over its square, which is little, and v_j is the variance of all else. A column of
  zeros takes that of the rows: nothing weighs against its prior.

B and R are of the scores at the solution without the stage's priors, and count what is uncertain in
earlier stages. Data that fit to their last digit have no variance; a least curvature then keeps a
prior on what they do not tell.

**Covariance.** Curvature and moment are spread over all blocks by their rows, so that resampling
never takes them away, and scores add up to zero. What scatters besides is the prior's mean: its
score has the variance (l_j std_j)^2, which goes between slope^-1 and slope^-T as B does. For one
parameter, H = h and B = v h, that makes

    (v h + l^2 std^2) / (h + l)^2 = v / (h + l) = 1 / (h / v + 1 / std^2),

the posterior's variance.

**Bounds.** Least squares between bounds are a convex quadratic programme: on what is free there is
no slope, and what is held lies on a bound that the slope pushes against. Block principal pivoting
finds which are held: all that violate one of the two conditions change sides at once, as long as
they grow fewer, and otherwise the last of them alone, which ends for any positive definite matrix
(Murty's rule; Judice and Pires, 1992). To all else what is held is known.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.errors import ModelError, require
from riecjax.estimation.parameters import ParameterTable
from riecjax.leaves import Leaf, as_leaf, is_number
from riecjax.linear_algebra import eliminate, solve_scaled, unit_diagonal, unit_scale
from riecjax.summaries.normal_equations import NormalEquations, ShortBlocks
from riecjax.uncertainty.covariances import BlockStatistics, block_statistics
from riecjax.uncertainty.intervals import Uncertainty

Bounds = tuple[float | None, float | None]
TIGHT = 1e8
"""Curvature of a prior, as a multiple of that of its parameter's column, past which it is as good
as a known value: it leaves data a share of 1e-8, and more would drown them in rounding."""


class Prior(NamedTuple):
    """What is known of a parameter beforehand: a normal distribution, in its unit."""

    mean: float
    std: float


class Constraints(eqx.Module):
    """Bounds and priors of free parameters, by name.

    **Fields:** `bounds`, infinite where there is none to one side; `priors`, mean and standard
    deviation. Both hold arrays, which may be traced.
    """

    bounds: dict[str, tuple[Leaf, Leaf]] = eqx.field(default_factory=dict)
    priors: dict[str, tuple[Leaf, Leaf]] = eqx.field(default_factory=dict)

    @classmethod
    def of(
        cls,
        table: ParameterTable,
        bounds: Mapping[str, Bounds] | None = None,
        priors: Mapping[str, tuple[float, float]] | None = None,
        start: Mapping[str, Leaf] | None = None,
        refined: bool = False,
    ) -> "Constraints":
        """Checked, also against the values that a search starts from.

        Without a start they are of a linear estimate, whose hidden elements are found by a search
        of its own, which knows of neither: those are passed over where it is to be `refined`.

        **Raises:** `ModelError` for a parameter that is not free, or that is hidden, what is no
        pair of numbers, bounds in the wrong order or that the start does not lie between, a prior
        without a finite mean and a positive standard deviation.
        """
        names = table.free
        one_by_one = ((bounds, "bounds", "(0, None)"), (priors, "priors", "(30.0, 0.5)"))
        for given, what, value in one_by_one:
            write = f"{what}={{'{names[0] if names else 'k'}': {value}}}, by name"
            require(what, given, (Mapping, type(None)), write)

        def of_free(what: str, given: Mapping[str, Any]) -> dict[str, Any]:
            if unknown := [name for name in given if not {*names} & {*table.everywhere([name])}]:
                raise ModelError(f"{what} given for '{unknown[0]}'; free are: {', '.join(names)}.")
            free = {name: value for name, value in table.values(given).items() if name in names}
            hidden = [n for n in free if start is None and table[n].element is not None]
            if hidden and not refined:
                raise ModelError(
                    f"{what} given for {hidden[0]}, of a hidden element: only a refinement knows "
                    f"of it, rx.refine, or on the command line --refine output-error."
                )
            return {name: value for name, value in free.items() if name not in hidden}

        limits, known = of_free("bounds are", bounds or {}), of_free("a prior is", priors or {})
        for name, given in limits.items():
            if not is_pair(given, or_none=True):
                raise ModelError(
                    f"the bounds of {name} are {given!r}. Write (lower, upper), None where there "
                    f"is none."
                )
            low, high = (end if at is None else at for end, at in zip((-np.inf, np.inf), given))
            limits[name] = as_leaf(low), as_leaf(high)
            if xp.is_concrete(low, high) and not low < high:
                raise ModelError(
                    f"the bounds of {name} are equal or in the wrong order: {low:g} to {high:g}."
                )
            if start is None or not xp.is_concrete(low, high, start[name]):
                continue
            at = np.asarray(start[name])
            if at != np.clip(at, np.asarray(low, at.dtype), np.asarray(high, at.dtype)):
                raise ModelError(
                    f"{name} starts at {at:g}, which is not between its bounds {low:g} and "
                    f"{high:g}. Widen them, or start between them."
                )
        for name, prior in known.items():
            if not is_pair(prior) or (
                xp.is_concrete(prior[0]) and not np.isfinite(float(prior[0]))
            ):
                raise ModelError(
                    f"the prior of {name} is {prior!r}. Write (mean, standard deviation), a finite "
                    f"mean."
                )
            if xp.is_concrete(prior[1]) and not prior[1] > 0:
                raise ModelError(f"the prior of {name} needs a positive standard deviation.")
            known[name] = as_leaf(prior[0]), as_leaf(prior[1])
        return cls(limits, known)

    def limits(self, names: Sequence[str]) -> tuple[Float[Leaf, " p"], Float[Leaf, " p"]]:
        """Lower and upper bounds of some parameters, infinite where there is none, and NaN where
        they are in the wrong order, which is refused where values can be looked at."""
        low, high = _columns([self.bounds.get(name, (-np.inf, np.inf)) for name in names])
        return xp.where(low < high, low, xp.nan), xp.where(low < high, high, xp.nan)

    def prior(self, names: Sequence[str]) -> tuple[Float[Leaf, " p"], Float[Leaf, " p"]]:
        """Means of the priors of some parameters, and one over their standard deviations: 0 where
        there is no prior, and NaN where the deviation is none."""
        mean, std = _columns([self.priors.get(name, (0.0, np.inf)) for name in names])
        return mean, xp.where(std > 0, 1 / xp.where(std > 0, std, 1.0), xp.nan)


NONE = Constraints()


def _columns(pairs: Sequence[tuple[Any, Any]]) -> tuple[Leaf, Leaf]:
    first, second = (xp.stack([xp.asarray(v, float) for v in values]) for values in zip(*pairs))
    return first, second


def diagonal_block(
    names: tuple[str, ...],
    curvature: Float[Array, " p"],
    moment: Float[Array, " p"],
    energy: Float[Array, ""] | float = 0.0,
) -> NormalEquations:
    """Normal equations that tell of each parameter by itself, from no row."""
    first = xp.concatenate([xp.reshape(energy, 1), moment])[None]
    others = xp.concatenate([moment[:, None], xp.diag(curvature)], axis=1)
    moments = xp.concatenate([first, others])
    return NormalEquations(moments, np.zeros((), moments.dtype), names)


def holding(held: Bool[Array, " p"], values: Float[Array, " p"]) -> Float[Array, "columns columns"]:
    """What makes columns of what is held zero, and joins them at these values to the target."""
    target = xp.concatenate([np.ones(1, values.dtype), -xp.where(held, values, 0.0)])
    kept = xp.diag(xp.where(held, 0.0, 1.0).astype(values.dtype))
    return xp.concatenate([target[None], xp.pad(kept, ((0, 0), (1, 0)))])


def constrained_blocks(
    blocks: NormalEquations,
    at: Float[Array, " p"],
    held: Bool[Array, " p"],
    curvature: Float[Array, " p"],
) -> NormalEquations:
    """Blocks with what priors add to them, spread over all by their rows, so that scores at a
    solution add up to zero. Of what is held nothing is left but its value."""
    names, mix = blocks.parameters, holding(held, at)
    blocks = blocks.mixed(mix, names)
    total, curvature = blocks.flattened().total(), xp.where(held, 1.0, curvature)
    pull = xp.where(curvature > 0, curvature * at - (total.moment - total.gram @ at), 0.0)
    prior = diagonal_block(names, curvature, pull, 2 * pull @ at - curvature @ at**2)
    share = blocks.count / xp.maximum(xp.sum(blocks.count), 1)
    moments = blocks.moments + xp.tensordot(share, prior.moments, axes=0)
    return dataclasses.replace(blocks, moments=moments)


def constrained_uncertainty(
    uncertainty: Uncertainty,
    statistics: BlockStatistics,
    constraints: Constraints,
    curvature: Float[Array, " p"],
    held: Bool[Array, " p"],
) -> Uncertainty:
    """With what the means of priors scatter by; nothing is said of what is held.

    **Arguments:** `statistics` of blocks with priors; `curvature` of these.
    """
    if constraints.priors:
        curvature = xp.where(held, 0.0, curvature)
        _, weight = constraints.prior(statistics.names)
        scatter = scatter_of_priors(statistics.slope, curvature, weight)
        uncertainty = uncertainty.with_priors(*scatter)
    covariance = xp.where(held[:, None] | held[None, :], xp.nan, uncertainty.covariance)
    return dataclasses.replace(uncertainty, covariance=covariance)


def scatter_of_priors(
    slope: Float[Array, "p p"],
    curvature: Float[Array, " p"],
    weight: Float[Leaf, " p"],
    ridge: float = 0.0,
) -> tuple[Float[Array, "p p"], Float[Array, " p"]]:
    """Covariance of estimates because the means of their priors scatter; see the module.

    **Returns:** also by how much an estimate follows its prior's mean, of a single one l / (h + l):
    the prior's share of what is known of it.
    """
    score = xp.where(weight > 0, curvature / xp.where(weight > 0, weight, 1.0), 0.0)
    moved = solve_scaled(slope, xp.diag(score), ridge)
    return moved @ moved.T, xp.diagonal(moved) * weight


def prior_curvature(
    stages: list[NormalEquations],
    known: Mapping[str, Array],
    values: Mapping[str, Array],
    constraints: Constraints,
    earlier: Sequence[Float[Array, " earlier"]],
    short: ShortBlocks,
) -> Float[Array, " p"]:
    """Curvature of each prior of the last of some stages, 0 where there is none; see the module.

    **Arguments:** `stages`, short blocks of all records along the leading axis, all but the last
    with their priors; `values`, their solution, of the last one without priors; `earlier`
    curvatures, of each stage before that finds something.
    """
    records = short.number.shape[0]
    by_record = [s.in_blocks(lambda v: v.reshape(records, -1, *v.shape[1:])) for s in stages]
    ridge = float(np.cbrt(xp.finfo(stages[-1].moments.dtype).eps))
    statistics = block_statistics(by_record, known, values, short, ridge)
    total, used = stages[-1].total(), xp.sum(statistics.used)
    weight = constraints.prior(statistics.names)[1]
    whole, place = statistics.slope, slice(sum(map(len, earlier)), None)
    # Influences of n blocks sum to zero, which takes one of n squares.
    variance = xp.sum(statistics.influence**2, axis=0) * used / xp.maximum(used - 1, 1)
    before = xp.concatenate([*earlier, xp.zeros_like(variance[place])])
    variance = variance + xp.diagonal(scatter_of_priors(whole, before, weight, ridge)[0])
    gram = whole[place, place]
    inverse = solve_scaled(gram, np.eye(gram.shape[0], dtype=gram.dtype), ridge)
    unit = xp.diagonal(inverse @ gram @ inverse)
    at = xp.stack([values[name] for name in total.parameters])
    energies = total.residual_energy(at), total.energy * xp.finfo(whole.dtype).eps
    of_rows, rounding = (energy / xp.maximum(total.count, 1) for energy in energies)
    of_row = xp.where(unit > 0, variance[place] / xp.where(unit > 0, unit, 1.0), of_rows)
    column = 1 / unit_scale(xp.diagonal(gram)) ** 2
    curvature = xp.where(of_row > 0, xp.minimum(of_row * weight[place] ** 2, TIGHT * column), 0.0)
    least = xp.where((of_row <= rounding) & (weight[place] > 0), ridge**2 * column, 0.0)
    return xp.maximum(curvature, least)


def sides_of_bounds(equations: NormalEquations, constraints: Constraints) -> Float[Array, " p"]:
    """Which parameters least squares hold at their lower (-1) or upper (1) bound; 0 for the others.

    By block principal pivoting; see the module.
    """
    names = equations.parameters
    problem = equations.gram, equations.moment, *constraints.limits(names)
    gram, moment, low, high = xp.stop_gradient(problem)
    gram, scale = unit_diagonal(gram)
    moment, low, high = moment * scale, low / scale, high / scale
    size, count = len(names), len({*names} & {*constraints.bounds})
    rounding = size * float(xp.finfo(gram.dtype).eps)
    # Collinear columns leave no more than rounding to tell sides by.
    gram = gram + rounding * np.eye(size, dtype=gram.dtype)

    def wanted(side: Float[Array, " p"]) -> Float[Array, " p"]:
        """The sides that a solution with these ones asks for."""
        held = side != 0
        at = xp.where(side < 0, low, xp.where(side > 0, high, 0.0))
        free = xp.where(held, 0.0, 1.0)
        matrix = gram * free[:, None] * free[None, :] + xp.diag(1 - free)
        right = xp.where(held, at, moment - gram @ at)
        x = eliminate(matrix, right[:, None])[:, 0]
        push = moment - gram @ x
        slack = rounding * (xp.abs(moment) + xp.abs(gram) @ xp.abs(x))
        beyond = xp.where(x < low - slack, -1.0, xp.where(x > high + slack, 1.0, 0.0))
        return xp.where(held, xp.where(push * side < -slack, 0.0, side), beyond)

    def pivot(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        side, fewest, patience = state
        other = wanted(side)
        wrong = other != side
        fewer = xp.sum(wrong) < fewest
        last = np.arange(size) == size - 1 - xp.argmax(wrong[::-1])
        chosen = wrong & (fewer | (patience > 0) | last)
        patience = xp.where(fewer, 2, patience - 1)
        return xp.where(chosen, other, side), xp.minimum(fewest, xp.sum(wrong)), patience

    start = xp.zeros_like(moment), np.asarray(size + 1), np.asarray(2)
    return xp.repeated(pivot, start, (count + 1) ** 2, beside=problem)[0]


def is_pair(given: Any, or_none: bool = False) -> bool:
    """Whether this is two numbers, or `None` in place of one if that is allowed."""
    if not isinstance(given, Sequence | np.ndarray | jax.Array) or len(given) != 2:
        return False
    return all(is_number(end) or (or_none and end is None) for end in given)

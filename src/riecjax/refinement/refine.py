"""Refine parameters from a start, of models that need not be linear in them.

Whether the steps of a simulation are part of the answer, told by halving them at the optimum.

A simulation in steps of length h errs by about c h^p, p the method's order, and so does the sum of
squares E_h that is made of it. To first order halving tells all: with c h^p the error at h, the
change by halving is (1 - 2^-p) c h^p, of order 4 fifteen sixteenths of the error itself.

What moves is not E but its optimum. At the optimum theta of E_h the slope vanishes,

    m_h - q = 0,      m = -J^T r, q the slope of priors,

while in half the steps m_{h/2} - q = m_{h/2} - m_h is left, which one Gauss-Newton step takes up:

    change = (G_{h/2} + information)^-1 (m_{h/2} - m_h).

So one expansion more says how far the optimum would move, where another search would say it at
several times the cost. Initial states are projected out of G and m, and follow.

Subtracting m_h and not q also leaves out what a search that ended early, or at a bound, left of the
slope: that is no matter of steps. A change matters beside the standard error; of nearly exact data,
whose standard errors are themselves made of such changes, beside the parameter.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from riecjax.compilation import kept_jit
from riecjax.errors import require
from riecjax.estimation.constraints import Bounds, Constraints
from riecjax.estimation.estimate import Estimate, RefinementStatus, Search
from riecjax.estimation.parameters import require_settings
from riecjax.leaves import Leaf, held_still, is_concrete, namespace, on_host
from riecjax.records.record import Records, as_records
from riecjax.refinement.objective import AbstractObjective, AbstractResiduals, Initial, Theta
from riecjax.refinement.optimum import SearchResult, Solver, begun, search
from riecjax.refinement.output_error import OutputError
from riecjax.uncertainty.intervals import AbstractIntervals, Sandwich

OF_AN_ERROR = 0.2
"""Change in standard errors up to which steps do not matter: it adds 2 % to a root mean square."""
OF_A_VALUE = 1e-4
"""Change as a share of the parameter up to which they do not, however small its standard error."""
OF_A_SIMULATION = 1e-5
"""Likewise, of what moves the simulation by its own size: of a parameter that is zero."""
ORDER = 4
"""Of the method whose steps are chosen here."""
LEAST_FACTOR = 4
"""By which steps are made shorter: each time, all is compiled anew."""
MOST_EXCESS = 1e8
"""Excess of a change beyond which it no longer says how many steps are needed."""
HELPED = 0.5
"""Share of a change that may be left after steps were made shorter."""


def in_finer_steps(residuals: AbstractResiduals, factor: int) -> AbstractResiduals | None:
    """These simulated in steps so many times as short; `None` where there are no steps."""
    method = None if residuals.method is None else residuals.method.finer(factor)
    return None if method is None else eqx.tree_at(lambda those: those.method, residuals, method)


# Where a search diverged no number is finite, and the result says so.
@np.errstate(all="ignore")
def halve_steps(residuals: AbstractResiduals, at: SearchResult) -> SearchResult:
    """With what halving the steps of the simulation does to the optimum; nothing where there are
    none.

    Parameters that are not determined are passed over.
    """
    start, theta, finer = residuals.start, at.theta, in_finer_steps(residuals, 2)
    xp = namespace(at, start)
    if finer is None:
        zero = xp.zeros(theta.shape, theta.dtype)
        return at._replace(step_change=zero, allowed=zero, coarse=zero > 0)
    # A check changes no derivative, and need not have one.
    finer, here, start = held_still((finer, at, start)) if xp is jnp else (finer, at, start)
    halved = _normal_equations(finer, here.theta, here.initial)
    if xp is np:
        here, halved, start = on_host((here, halved, start))
    (gram, moment, rows), theta = halved, here.theta
    finfo = np.finfo(theta.dtype)
    curvature = gram + here.information
    scale = 1 / xp.sqrt(xp.maximum(xp.diagonal(curvature), finfo.tiny))
    identity = xp.eye(scale.shape[0], dtype=curvature.dtype)
    scaled = curvature * scale[:, None] * scale[None, :] + finfo.eps * identity
    finite = xp.all(xp.isfinite(scaled))
    slope = scale * (moment - here.moment)
    change = scale * xp.linalg.solve(xp.where(finite, scaled, identity), slope)
    change = xp.where(finite, change, np.nan)
    of_value = max(OF_A_VALUE, float(np.sqrt(finfo.eps)))
    # G_ii theta_i^2 = rows: so large a theta_i moves each residual by 1, a channel by its sigma.
    whole = xp.sqrt(rows / xp.maximum(xp.diagonal(gram), finfo.tiny))
    size = xp.maximum(xp.abs(theta), xp.abs(start))
    size = xp.maximum(size, OF_A_SIMULATION / OF_A_VALUE * whole)
    errors = xp.sqrt(xp.diagonal(here.uncertainty.covariance))
    converged = xp.asarray(here.status == RefinementStatus.converged)
    tested = converged & xp.isfinite(errors)
    allowed = xp.maximum(of_value * size, xp.where(tested, OF_AN_ERROR * errors, np.inf))
    coarse = ~(xp.abs(change) <= allowed) & tested
    return at._replace(step_change=change, allowed=allowed, coarse=coarse)


@kept_jit
def _normal_equations(
    residuals: AbstractResiduals, theta: Theta, initial: Initial
) -> tuple[Float[Array, "p p"], Float[Array, " p"], Float[Array, ""]]:
    blocks, _ = residuals.blocks(residuals.expansion(theta, initial))
    total = blocks.flattened().total()
    return total.gram, total.moment, residuals.independent_rows()


def with_finer_steps(
    residuals: AbstractResiduals, at: SearchResult, before: SearchResult | None
) -> AbstractResiduals | None:
    """The residuals in steps that are short enough, or `None` to leave them as they are.

    Of order p, steps k times as short leave k^-p of a change: k is the p-th root of the excess.
    They are left where they do not matter, where the user chose them, at their limit, and where
    shortening them after `before` did not help: no step ends at a kink.
    """
    steps = getattr(residuals.method, "steps_per_sample", 1)
    limit = max(residuals.most_steps // steps, 1)
    if not is_concrete(at) or limit == 1 or not np.any(at.coarse):
        return None
    excess = worst_excess(at.step_change, at.allowed)
    if before is not None:
        earlier = worst_excess(before.step_change, before.allowed)
        if worst_excess(at.step_change, before.allowed) > HELPED * earlier:
            return None
    factor = np.ceil(min(excess, MOST_EXCESS) ** (1 / ORDER))
    return in_finer_steps(residuals, int(min(max(factor, LEAST_FACTOR), limit)))


# What diverged has no finite change, which counts as coarse.
@np.errstate(all="ignore")
def worst_excess(change: Float[Leaf, " p"], allowed: Float[Leaf, " p"]) -> float:
    """Changes at their worst, in what is allowed of each (not under jit)."""
    share = np.abs(change) / np.asarray(allowed)
    return float(np.max(np.where(np.isfinite(share), share, np.inf)))


FURTHER_ROUNDS = 2
"""Fits after the first where there are priors, weighed against the scatter that was left before."""


def refine(
    model: Any,
    records: Records,
    start: Estimate | Mapping[str, float | Array],
    by: AbstractObjective | None = None,
    *,
    known: Mapping[str, float | Array] | None = None,
    bounds: Mapping[str, Bounds] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    per_record: Sequence[str] = (),
    key: Key[Array, ""] | None = None,
    intervals: AbstractIntervals | None = None,
    solver: Solver | None = None,
    max_steps: int = 100,
    progress: Callable[[float], None] | None = None,
) -> Estimate:
    """Refine parameters by non-linear least squares, from a start.

    Works eagerly, with every check, and under `jax.jit`, `jax.vmap` and `jax.grad`. The result's
    `theta` differentiates with respect to records, windows and known values, by the implicit
    function theorem.

    **Arguments:**

    - `model`: what `by` needs. For [`OutputError`][], something to simulate: an `Equation`
      or a `Model`, an `AbstractSystem` whose fields are the parameters, or a function of the
      parameters by name that returns a system. For [`IntegralError`][], equations of motion:
      `Equation`s, a `Model`, `AbstractBalance`s.
    - `records`: one record or several, of any lengths.
    - `start`: an estimate, or values by name. What it names is free; of an estimate, what it
      estimated.
    - `by`: what is made small, [`OutputError`][] by default.
    - `known`: values held fixed. Parameters named nowhere keep the model's own values.
    - `bounds`: (lower, upper) by name, `None` where there is none.
    - `priors`: normal distributions (mean, standard deviation) by name, weighed against the scatter
      that the fit leaves.
    - `per_record`: names of parameters that take a value of their own in each record, by default
      those of an estimate that it starts from. What is given for `offset` holds in every record,
      but for those given by their own name, `offset[2]`.
    - `key`: for random windows.
    - `intervals`: how uncertainty is judged, [`Sandwich`][] by default; [`BlockBootstrap`][]
      resamples the problem linearised at the optimum.
    - `solver`: an optimistix solver; Levenberg-Marquardt by default. With bounds, one that damps
      its steps: what is held has no slope.
    - `max_steps`: steps that the search may take; fewer than it needs is a status of the result.
    - `progress`: called with the sum of squares after each step.

    **Raises:** `ModelError` for unknown names, values that are absent or out of bounds, a model
    that cannot be simulated; `DataError` for absent signals or records that are too short. A
    search that fails raises nothing: see `search.status` of the result.
    """
    recordings = as_records(records)
    require_settings(key, known, per_record)
    by, intervals = by or OutputError(), intervals or Sandwich()
    require("start", start, (Estimate, Mapping), "the result of rx.identify, or {'m': 2.0}")
    require("by", by, AbstractObjective, "by=rx.OutputError(), an object")
    require("intervals", intervals, AbstractIntervals, "intervals=rx.Sandwich()")
    if solver is not None:
        write = "solver=optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8), or leave it out"
        require("the solver", solver, Solver, write)
    if isinstance(model, type):
        write = f"{model.__name__}(...), with a value for each of its fields"
        require("the model", model, (), write)
    objective = by.suited(model)
    residuals = objective.residuals(model, recordings, start, known or {}, per_record, key)
    table = residuals.table
    constraints = Constraints.of(
        table, bounds, priors, start=dict(zip(table.free, residuals.start))
    )
    settings = intervals, solver, max_steps, progress
    # Searches, in ever shorter steps for as long as these change the answer. With priors each
    # search is followed by others: the variance that priors are weighed against is that of the
    # residuals at the optimum, which the first search knows only from its start; the next ones take
    # it from the search before, a fixed-point iteration.
    initial, before = residuals.initial, None
    rounds = FURTHER_ROUNDS if constraints.priors else 0
    while True:
        first = begun(residuals, initial)
        optimum = search(residuals, constraints, (before or first).place, *settings)
        for _ in range(rounds):
            optimum = search(residuals, constraints, optimum.place, *settings)
        optimum = halve_steps(residuals, optimum)
        if (finer := with_finer_steps(residuals, optimum, before)) is None:
            break
        residuals, before = finer, optimum
    return Estimate(
        theta=optimum.theta,
        uncertainty=optimum.uncertainty,
        table=table.holding({name: jnp.asarray(value) for name, value in table.known.items()}),
        inflation=optimum.inflation,
        at_bound=optimum.at_bound,
        block_count=optimum.block_count,
        block_length=optimum.block_length,
        search=Search(
            status=optimum.status,
            steps=optimum.steps,
            rms_before=first.rms,
            rms=optimum.rms,
            cost_before=jnp.sum(first.energy),
            cost=jnp.sum(optimum.energy),
            initial_states=optimum.initial,
            step_change=optimum.step_change,
            coarse=optimum.coarse,
            residuals=residuals if is_concrete(residuals, optimum) else None,
            steps_label="" if residuals.method is None else residuals.method.label,
            quantities=residuals.labels,
            quantity_units=residuals.units,
            initial_state_names=residuals.initial_state_names,
            by=tuple(objective.describe().items()),
        ),
    )

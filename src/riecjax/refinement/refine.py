"""Refine parameters from a start, of models that need not be linear in them."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Key

from riecjax.arrays import is_concrete
from riecjax.errors import require
from riecjax.estimation.constraints import Bounds, Constraints
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.parameters import require_settings
from riecjax.records.noise_judgement import ABOVE_NOISE
from riecjax.records.record import Record, Records, as_records, deviation
from riecjax.refinement.objective import AbstractObjective, AbstractResiduals
from riecjax.refinement.optimum import Found, Place, Solver, begun, search
from riecjax.refinement.output_error import LEAST_NOISE, OutputError, noise_levels
from riecjax.simulation.system import PREDICTS_WELL
from riecjax.uncertainty.intervals import AbstractIntervals, Sandwich

ORDER = 4
"""Of the method whose steps are chosen here."""
LEAST_FACTOR = 4
"""By which steps are made shorter: each time, all is compiled anew."""
HELPED = 0.5
"""Share of a change that may be left after steps were made shorter."""


# What diverged has no finite change, which counts as coarse.
@np.errstate(all="ignore")
def with_finer_steps(
    residuals: AbstractResiduals, found: Found, before: Found | None
) -> AbstractResiduals | None:
    """The residuals in steps that are short enough, or `None` to leave them as they are.

    Of order p, steps k times as short leave k^-p of a change: k is the p-th root of the excess, and
    whatever the limit allows where the start itself is lost. They are left where they do not
    matter, where the user chose them, at their limit, and where shortening them after `before` did
    not help: no step ends at a kink.
    """

    def excess(found: Found, allowed: Array) -> float:
        share = np.abs(found.estimate.search.step_change) / np.asarray(allowed)
        return float(np.max(np.nan_to_num(share, nan=np.inf, posinf=np.inf)))

    steps = getattr(residuals.method, "steps_per_sample", 1)
    limit = max(residuals.most_steps // steps, 1)
    if not is_concrete(found) or limit == 1:
        return None
    if not (found.place.lost or np.any(found.estimate.search.coarse)):
        return None
    allowed = found.allowed if before is None else before.allowed
    if before is not None and excess(found, allowed) > HELPED * excess(before, allowed):
        return None
    factor = np.ceil(excess(found, found.allowed) ** (1 / ORDER))
    finer = residuals.method.finer(int(min(max(factor, LEAST_FACTOR), limit)))
    return dataclasses.replace(residuals, method=finer)


def is_followed(found: Estimate, records: list[Record], *, to_noise: bool = False) -> bool:
    """Whether a search converged where every channel is predicted well, or none is left well above
    its noise."""
    names = found.search.quantities
    spread = np.array([deviation(records, name) for name in names])
    most = (1 - PREDICTS_WELL / 100) * spread
    if to_noise:
        most = ABOVE_NOISE * np.maximum(noise_levels(records, names), LEAST_NOISE * spread)
    return bool(found.search.converged and np.all(np.asarray(found.search.rms) <= most))


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
    - `solver`: an optimistix solver in place of the search's own Levenberg-Marquardt. Beside bounds
      it must damp its steps.
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
    by = by.suited(model)

    def formed(by: AbstractObjective) -> AbstractResiduals:
        return by.residuals(model, recordings, start, known or {}, per_record, key)

    settings = bounds, priors, intervals, solver, max_steps, progress
    return refined(by, formed(by), formed, recordings, *settings)[0]


def refined(
    by: AbstractObjective,
    residuals: AbstractResiduals,
    formed: Callable[[AbstractObjective], AbstractResiduals],
    records: list[Record],
    bounds: Mapping[str, Bounds] | None,
    priors: Mapping[str, tuple[float, float]] | None,
    intervals: AbstractIntervals,
    solver: Solver | None,
    max_steps: int,
    progress: Callable[[float], None] | None,
) -> tuple[Estimate, AbstractObjective]:
    """[`refine`][] of residuals that were `formed` by an objective along records.

    A search goes on in shorter steps for as long as these change the answer; and where it is lost,
    over segments from its start again, ever longer ones for as long as the model follows them as
    well.

    **Returns:** the estimate, and the objective of which it is the optimum.
    """
    table = residuals.table
    start = dict(zip(table.free, residuals.start))
    constraints = Constraints.of(table, bounds, priors, start)
    settings = intervals, solver, max_steps, progress
    rounds = FURTHER_ROUNDS if constraints.priors else 0

    def searched(residuals: AbstractResiduals, place: Place | None) -> Found:
        # With priors each search is followed by others: the variance that priors are weighed
        # against is that of the residuals at the optimum, which the first search knows only from
        # its start; the next ones take it from the search before, a fixed-point iteration.
        first = begun(residuals)
        place = first if place is None else place._replace(expansion=None, lost=first.lost)
        found = search(residuals, constraints, first, place, *settings)
        for _ in range(rounds):
            found = search(residuals, constraints, first, found.place, *settings)
        return found

    def settled(residuals: AbstractResiduals, found: Found) -> tuple[AbstractResiduals, Found]:
        before = None
        while (finer := with_finer_steps(residuals, found, before)) is not None:
            residuals, before = finer, found
            found = searched(residuals, found.place)
        return residuals, found

    def follows(found: Found, shorter: Found | None) -> bool:
        told = shorter is None or np.all(found.place.rms <= 2 * shorter.place.rms)
        return bool(told) and is_followed(found.estimate, records, to_noise=True)

    found, longest, place = searched(residuals, None), None, None
    segments: list[OutputError] = []
    if isinstance(by, OutputError) and is_concrete(found):
        segments = [] if is_followed(found.estimate, records) else by.by_segments(records[0])
    for part in segments:
        pieces = formed(part)
        tried = searched(pieces, place and place._replace(initial=pieces.initial))
        shorter = longest and longest[2]
        if follows(tried, shorter):
            pieces, tried = settled(pieces, tried)
        if not follows(tried, shorter):
            break
        longest, place = (part, pieces, tried), tried.place
    by, residuals, found = longest or (by, *settled(residuals, found))
    estimate = found.estimate
    kept = residuals if is_concrete(residuals, estimate) else None
    described = tuple(by.describe().items())
    done = dataclasses.replace(estimate.search, residuals=kept, by=described)
    return dataclasses.replace(estimate, search=done), by

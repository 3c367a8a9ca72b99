"""Refine parameters from a start, of models that need not be linear in them.

What a refinement found, and how far it can be trusted.

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

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from riecjax.compilation import kept_jit
from riecjax.errors import require
from riecjax.estimation.estimate import AbstractEstimate
from riecjax.estimation.parameters import require_settings
from riecjax.findings import Finding
from riecjax.leaves import Leaf, held_still, is_concrete, namespace, on_host
from riecjax.records.record import Records, as_records
from riecjax.refinement.objective import (
    AbstractMisfit,
    AbstractObjective,
    Initial,
    Specification,
    Theta,
)
from riecjax.refinement.optimum import (
    Bounds,
    Constraints,
    Optimum,
    Prior,
    Reached,
    RefinementStatus,
    Solver,
    search,
)
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


class StepHalving(NamedTuple):
    """How parameters change by halving the steps.

    **Fields:** `change` of each; what of that is `allowed`; `coarse`, where it is more than that.
    """

    change: Float[Leaf, " p"]
    allowed: Float[Leaf, " p"]
    coarse: Bool[Leaf, " p"]

    # What diverged has no finite change, which counts as coarse.
    @np.errstate(all="ignore")
    def excess(self, change: Float[Leaf, " p"]) -> float:
        """A change at its worst, in what is allowed here (not under jit)."""
        share = np.abs(change) / np.asarray(self.allowed)
        return float(np.max(np.where(np.isfinite(share), share, np.inf)))


# Where a search diverged no number is finite, and the result says so.
@np.errstate(all="ignore")
def halve_steps(misfit: AbstractMisfit, at: Optimum, start: Theta) -> StepHalving:
    """What halving the steps of the simulation does to the optimum; nothing where there are none.

    Parameters that are not determined are passed over.
    """
    theta, finer, xp = at.reached.theta, misfit.finer(2), namespace(at, start)
    if finer is None:
        zero = xp.zeros(theta.shape, theta.dtype)
        return StepHalving(zero, zero, zero > 0)
    # A check changes no derivative, and need not have one.
    if xp is jnp:
        finer, at, start = held_still((finer, at, start))
    again = _normal_equations(finer, at.reached.theta, at.reached.initial)
    if xp is np:
        at, again, start = on_host((at, again, start))
    (gram, moment, rows), theta = again, at.reached.theta
    finfo = np.finfo(theta.dtype)
    curvature = gram + at.information
    scale = 1 / xp.sqrt(xp.maximum(xp.diagonal(curvature), finfo.tiny))
    identity = xp.eye(scale.shape[0], dtype=curvature.dtype)
    scaled = curvature * scale[:, None] * scale[None, :] + finfo.eps * identity
    finite = xp.all(xp.isfinite(scaled))
    slope = scale * (moment - at.moment)
    change = scale * xp.linalg.solve(xp.where(finite, scaled, identity), slope)
    change = xp.where(finite, change, np.nan)
    of_value = max(OF_A_VALUE, float(np.sqrt(finfo.eps)))
    # G_ii theta_i^2 = rows: so large a theta_i moves each residual by 1, a channel by its sigma.
    whole = xp.sqrt(rows / xp.maximum(xp.diagonal(gram), finfo.tiny))
    size = xp.maximum(xp.abs(theta), xp.abs(start))
    size = xp.maximum(size, OF_A_SIMULATION / OF_A_VALUE * whole)
    errors = xp.sqrt(xp.diagonal(at.uncertainty.covariance))
    tested = at.converged & xp.isfinite(errors)
    allowed = xp.maximum(of_value * size, xp.where(tested, OF_AN_ERROR * errors, np.inf))
    return StepHalving(change, allowed, ~(xp.abs(change) <= allowed) & tested)


@kept_jit
def _normal_equations(
    misfit: AbstractMisfit, theta: Theta, initial: Initial
) -> tuple[Float[Array, "p p"], Float[Array, " p"], Float[Array, ""]]:
    blocks, _ = misfit.blocks(misfit.expansion(theta, initial))
    total = blocks.flattened().total()
    return total.gram, total.moment, misfit.independent_rows()


def with_finer_steps(
    misfit: AbstractMisfit, halving: StepHalving, before: StepHalving | None
) -> AbstractMisfit | None:
    """The misfit in steps that are short enough, or None to leave them as they are.

    Of order p, steps k times as short leave k^-p of a change: k is the p-th root of the excess.
    They are left where they do not matter, where the user chose them, at their limit, and where
    shortening them after `before` did not help: no step ends at a kink.
    """
    limit = misfit.step_factor_limit
    if not is_concrete(halving) or limit == 1 or not np.any(halving.coarse):
        return None
    excess = halving.excess(halving.change)
    if before is not None and before.excess(halving.change) > HELPED * before.excess(before.change):
        return None
    factor = np.ceil(min(excess, MOST_EXCESS) ** (1 / ORDER))
    return misfit.finer(int(min(max(factor, LEAST_FACTOR), limit)))


class Refined(AbstractEstimate):
    """Refined parameters with units and uncertainty, and how they were found.

    A pytree that differentiates and vmaps; values are read one by one as from a mapping, of a
    batch with the batch's shape.

    **Fields:**

    - `theta`, `uncertainty`, `table`, `inflation`, `block_count`, `block_length`: as of an
      [`Estimate`][].
    - `status`: how the search ended; `steps` that it took.
    - `rms_before`, `rms`: root mean square of what is left of each of `quantities` (channels, or
      equations), with the start's parameters and now, in `quantity_units`. Both over the same
      windows, in the same steps, and from initial states that were estimated for each.
    - `cost_before`, `cost`: sums of squared residuals, likewise.
    - `initial_states` that were estimated, one row for each window, columns `initial_state_names`.
    - `at_bound`: which parameters sit on a bound; nothing is said of their uncertainty.
    - `step_change`: change of `theta`, to first order, if the steps of the simulation are halved;
      `coarse`, where that matters beside the standard error; `steps_label`, the method.
    - `by`: what was made small, in plain data.
    """

    status: RefinementStatus
    steps: Int[Array, ""]
    rms_before: Float[Array, " quantities"]
    rms: Float[Array, " quantities"]
    cost_before: Float[Array, ""]
    cost: Float[Array, ""]
    initial_states: Float[Array, "windows s"]
    at_bound: Bool[Array, " p"]
    step_change: Float[Leaf, " p"]
    coarse: Bool[Leaf, " p"]
    steps_label: str = eqx.field(static=True)
    quantities: tuple[str, ...] = eqx.field(static=True)
    quantity_units: tuple[str, ...] = eqx.field(static=True)
    initial_state_names: tuple[str, ...] = eqx.field(static=True)
    by: tuple[tuple[str, Any], ...] = eqx.field(static=True)

    @property
    def converged(self) -> Bool[Array, "*batch"]:
        """Whether the search ended at an optimum."""
        return self.status == RefinementStatus.converged

    @property
    def basis(self) -> str:
        """What `rms_before` and `rms` are of, in words: windows, initial states, steps."""
        by = dict(self.by)
        if "starts" not in by:
            return "impulses over the same windows"
        windows = "the whole record" if by.get("windows") == "whole record" else "the same windows"
        starts = {
            "estimated": "initial states estimated for each",
            "measured": "initial states as recorded",
        }
        return f"{windows}, {starts.get(by['starts'], 'known initial states')}, {self.steps_label}"

    @property
    def reason(self) -> str:
        """How the search ended, in words, of a batch with numbers of members (not under jit)."""
        if not self.batch_shape:
            return RefinementStatus[self.status]
        ended = (self.member(*place).reason for place in np.ndindex(self.batch_shape))
        return ", ".join(f"{number} x {words}" for words, number in Counter(ended).items())

    def _findings(self) -> Iterator[Finding]:
        if not bool(self.converged):
            yield Finding(
                "refinement_not_converged", f"the refinement did not converge: {self.reason}"
            )
        shares = self.step_change / self.standard_errors
        changes = {
            name: f"{name} by {float(change):.3g} ({abs(float(share)):.2g} standard errors)"
            for name, change, share, coarse in zip(
                self.parameters, self.step_change, shares, self.coarse
            )
            if bool(coarse)
        }
        if changes:
            yield Finding(
                "coarse_steps",
                f"the steps of the simulation, {self.steps_label}, are part of the answer: halving "
                f"them changes {', '.join(changes.values())}. Take shorter ones "
                f"(OutputError(method=FixedStep(n))) or record faster; a stiff model needs "
                f"Adaptive with an implicit solver, a force that jumps as sign(v) a width.",
                parameters=tuple(changes),
            )
        if names := [n for n, reached in zip(self.parameters, self.at_bound) if bool(reached)]:
            yield Finding(
                "at_bound",
                f"{', '.join(names)} sit(s) on a bound: the data would go further. The intervals "
                f"of the others take it for known.",
                parameters=tuple(names),
            )
        # What the data hardly determine, or not at all.
        silent = []
        ends = self.interval_by_name()
        for name, reached in zip(self.parameters, self.at_bound):
            low, high = ends[name]
            if bool(reached):
                continue
            if not (np.isfinite(low) and np.isfinite(high)):
                silent.append(name)
            elif high - low > 2 * abs(float(self[name])):
                yield Finding(
                    "interval_wider_than_estimate",
                    f"the refined interval of {name} reaches from {low:.4g} to {high:.4g}: these "
                    f"data hardly determine it.",
                    parameters=(name,),
                )
        if len(silent) == 1:
            message = f"these data say nothing about {silent[0]}."
            yield Finding("undetermined", message, parameters=(silent[0],))
        elif silent:
            yield Finding(
                "undetermined",
                f"what is compared stays as it is when {', '.join(silent)} change together, so it "
                f"tells none of them alone, as motion without a force does not tell how heavy a "
                f"machine is. Hold one at a known value (on the command line: --set "
                f"{silent[0]}=VALUE), or compare another signal.",
                parameters=tuple(silent),
            )
        yield from (*self.negative_values(), *self.few_blocks())
        yield from (*self.rarely_excited(), *self.disagreement())


FURTHER_ROUNDS = 2
"""Fits after the first where there are priors, weighed against the scatter that was left before."""


def refine(
    model: Any,
    records: Records,
    start: AbstractEstimate | Mapping[str, float | Array],
    by: AbstractObjective | None = None,
    *,
    known: Mapping[str, float | Array] | None = None,
    bounds: Mapping[str, Bounds] | None = None,
    priors: Mapping[str, Prior] | None = None,
    per_record: Sequence[str] = (),
    key: Key[Array, ""] | None = None,
    intervals: AbstractIntervals | None = None,
    solver: Solver | None = None,
    max_steps: int = 100,
    progress: Callable[[float], None] | None = None,
) -> Refined:
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
    - `solver`: an optimistix solver; Levenberg-Marquardt by default.
    - `max_steps`: steps that the search may take; fewer than it needs is a status of the result.
    - `progress`: called with the sum of squares after each step.

    **Raises:** `ModelError` for unknown names, values that are absent or out of bounds, a model
    that cannot be simulated; `DataError` for absent signals or records that are too short. A
    search that fails raises nothing: see `status` of the result.
    """
    recordings = as_records(records)
    require_settings(key, known, per_record)
    require("start", start, (AbstractEstimate, Mapping), "the result of rx.identify, or {'m': 2.0}")
    require("by", by or OutputError(), AbstractObjective, "by=rx.OutputError(), an object")
    require("intervals", intervals or Sandwich(), AbstractIntervals, "intervals=rx.Sandwich()")
    if solver is not None:
        write = "solver=optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8), or leave it out"
        require("the solver", solver, Solver, write)
    if isinstance(model, type):
        write = f"{model.__name__}(...), with a value for each of its fields"
        require("the model", model, (), write)
    objective = (by or OutputError()).suited(model)
    held, own = dict(known or {}), tuple(per_record)
    specified = objective.specify(model, recordings, start, held, own, key)
    constraints = Constraints.of(specified.table, specified.values, bounds or {}, priors or {})
    settings = (intervals or Sandwich(), solver, max_steps, progress)
    return refined_of(objective, specified, constraints, *settings)[0]


def refined_of(
    objective: AbstractObjective,
    specified: Specification,
    constraints: Constraints,
    intervals: AbstractIntervals,
    solver: Solver | None,
    max_steps: int,
    progress: Callable[[float], None] | None,
) -> tuple[Refined, AbstractMisfit]:
    """Of a problem that is specified, with the misfit of the last search, which knows what is left.

    See [`refine`][] for the settings of each search.
    """
    table, settings = specified.table, (intervals, solver, max_steps, progress)
    # Searches, in ever shorter steps for as long as these change the answer. With priors each
    # search is followed by others: the variance that priors are weighed against is that of the
    # residuals at the optimum, which the first search knows only from its start; the next ones take
    # it from the search before, a fixed-point iteration.
    misfit, theta = objective.misfit(specified), specified.theta
    first = misfit.first_initial()
    reached = halving = None
    while True:
        begun, rms = _begin(misfit, theta, first)
        optimum = search(misfit, constraints, theta, reached or begun, *settings)
        for _ in range(FURTHER_ROUNDS if constraints.has_priors else 0):
            optimum = search(misfit, constraints, theta, optimum.reached, *settings)
        before, halving = halving, halve_steps(misfit, optimum, theta)
        reached, finer = optimum.reached, with_finer_steps(misfit, halving, before)
        if finer is None:
            break
        misfit = finer
    refined = Refined(
        theta=reached.theta,
        uncertainty=optimum.uncertainty,
        table=table.holding({name: jnp.asarray(value) for name, value in table.known.items()}),
        status=reached.status,
        steps=reached.steps,
        rms_before=rms,
        rms=optimum.rms,
        cost_before=jnp.sum(begun.energy),
        cost=jnp.sum(reached.energy),
        initial_states=reached.initial,
        at_bound=optimum.at_bound,
        inflation=optimum.inflation,
        step_change=halving.change,
        coarse=halving.coarse,
        block_count=optimum.block_count,
        block_length=optimum.block_length,
        steps_label=misfit.steps_label,
        quantities=misfit.labels,
        quantity_units=misfit.units,
        initial_state_names=misfit.initial_state_names,
        by=tuple(objective.describe().items()),
    )
    return refined, misfit


@kept_jit
def _begin(
    misfit: AbstractMisfit, theta: Theta, first: Initial
) -> tuple[Reached, Float[Array, " quantities"]]:
    """What the start leaves at the initial states that suit it best, in all and as rms."""
    energy = misfit.profiled_energy(theta, first)
    status = RefinementStatus.where(
        jnp.isfinite(jnp.sum(energy)), RefinementStatus.converged, RefinementStatus.not_finite
    )
    return Reached(theta, first, energy, status, jnp.array(0)), misfit.rms(energy)

"""Refine parameters from a start, of models that need not be linear in them.

What a refinement found, and how far it can be trusted.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from riecjax.compilation import kept_jit
from riecjax.errors import renamed, require
from riecjax.estimation.estimate import AbstractEstimate
from riecjax.estimation.parameters import require_settings
from riecjax.findings import Finding
from riecjax.leaves import Leaf
from riecjax.records.record import Records, as_records
from riecjax.refinement.coordinates import Bounds, Constraints, Prior
from riecjax.refinement.objective import AbstractMisfit, AbstractObjective, Specification
from riecjax.refinement.optimum import Reached, RefinementStatus, Solver, search
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.step_halving import halve_steps, with_finer_steps
from riecjax.uncertainty.intervals import AbstractIntervals, Sandwich, Uncertainty


class Refined(AbstractEstimate):
    """Refined parameters with units and uncertainty, and how they were found.

    A pytree that differentiates and vmaps; values are read one by one as from a mapping, of a
    batch with the batch's shape.

    **Fields:**

    - `theta`, `uncertainty`, `known`, `parameters`, `units`, `inflation`, `block_count`,
      `block_length`: as of an [`Estimate`][].
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

    theta: Float[Array, "*batch p"]
    uncertainty: Uncertainty
    known: dict[str, Array]
    status: RefinementStatus
    steps: Int[Array, ""]
    rms_before: Float[Array, " quantities"]
    rms: Float[Array, " quantities"]
    cost_before: Float[Array, ""]
    cost: Float[Array, ""]
    initial_states: Float[Array, "windows s"]
    at_bound: Bool[Array, " p"]
    inflation: Float[Array, " p"]
    step_change: Float[Leaf, " p"]
    coarse: Bool[Leaf, " p"]
    block_count: Int[Array, ""]
    block_length: Float[Array, ""]
    steps_label: str = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True)
    units: tuple[tuple[str, str], ...] = eqx.field(static=True)
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

    def _findings(self) -> list[Finding]:
        return [
            *self._not_converged(),
            *self._coarse_steps(),
            *self._bounds(),
            *self._undetermined(),
            *self.negative_values(),
            *self.few_blocks(),
            *self.leaning(),
            *self.rarely_excited(),
            *self.disagreement(),
        ]

    def _not_converged(self) -> Iterator[Finding]:
        if not bool(self.converged):
            yield Finding(
                "refinement_not_converged", f"the refinement did not converge: {self.reason}"
            )

    def _coarse_steps(self) -> Iterator[Finding]:
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

    def _bounds(self) -> Iterator[Finding]:
        if names := [n for n, reached in zip(self.parameters, self.at_bound) if bool(reached)]:
            yield Finding(
                "at_bound",
                f"{', '.join(names)} sit(s) on a bound: the data would go further. The intervals "
                f"of the others take it for known.",
                parameters=tuple(names),
            )

    def _undetermined(self) -> Iterator[Finding]:
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


FURTHER_ROUNDS = 2
"""Fits after the first where there are priors, weighed against the scatter that was left before."""


@renamed(own="per_record")
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

    - `model`: what `by` needs. For [`OutputError`][], something to simulate: an `Equation`,
      `Procedure` or `Model`, an `AbstractSystem` whose fields are the parameters, or a function of
      the parameters by name that returns a system. For [`IntegralError`][], equations of motion:
      `Equation`s, a `Procedure`, `AbstractBalance`s.
    - `records`: one record or several, of any lengths.
    - `start`: an estimate, or values by name. What it names is free; of an estimate, what it
      estimated.
    - `by`: what is made small, [`OutputError`][] by default.
    - `known`: values held fixed. Parameters named nowhere keep the model's own values.
    - `bounds`: (lower, upper) by name, `None` where there is none.
    - `priors`: normal distributions (mean, standard deviation) by name, weighed against the scatter
      that the fit leaves.
    - `per_record`: names of parameters that take a value of their own in each record. What is
      given for `offset` holds in every record, but for those given by their own name, `offset[2]`.
    - `key`: for random windows.
    - `intervals`: how uncertainty is judged, [`Sandwich`][] by default; [`BlockBootstrap`][]
      resamples the problem linearised at the optimum.
    - `solver`: an optimistix solver; Levenberg-Marquardt by default.
    - `max_steps`: steps that the search may take; fewer than it needs is a status of the result.
    - `progress`: called with the sum of squares after each step.

    **Raises:** `ModelError` for unknown names, values that are missing or out of bounds, a model
    that cannot be simulated; `DataError` for missing signals or records that are too short. A
    search that fails raises nothing: see `status` of the result.
    """
    given = (known, bounds, priors, per_record, key, intervals, solver, max_steps, progress)
    return refine_with_misfit(model, records, start, by, *given)[0]


def refine_with_misfit(
    model: Any,
    records: Records,
    start: AbstractEstimate | Mapping[str, float | Array],
    by: AbstractObjective | None = None,
    known: Mapping[str, float | Array] | None = None,
    bounds: Mapping[str, Bounds] | None = None,
    priors: Mapping[str, Prior] | None = None,
    per_record: Sequence[str] = (),
    key: Key[Array, ""] | None = None,
    intervals: AbstractIntervals | None = None,
    solver: Solver | None = None,
    max_steps: int = 100,
    progress: Callable[[float], None] | None = None,
) -> tuple[Refined, AbstractMisfit]:
    """As [`refine`][], with the misfit of the last search, which knows what is left."""
    recordings = as_records(records)
    require_settings(key, known, per_record)
    _require_kinds(model, start, by, intervals, solver)
    objective = (by or OutputError()).suited(model)
    held, own = dict(known or {}), tuple(per_record)
    specified = objective.specify(model, recordings, start, held, own, key)
    constraints = Constraints.of(
        specified.names,
        specified.values,
        specified.of_free(bounds or {}),
        specified.of_free(priors or {}),
    )
    settings = (specified.sharing, intervals or Sandwich(), solver, max_steps, progress)
    return _refined(objective, specified, constraints, settings)


def _require_kinds(model: Any, start: Any, by: Any, intervals: Any, solver: Any) -> None:
    require("start", start, (AbstractEstimate, Mapping), "the result of rx.identify, or {'m': 2.0}")
    require("by", by or OutputError(), AbstractObjective, "by=rx.OutputError(), an object")
    require("intervals", intervals or Sandwich(), AbstractIntervals, "intervals=rx.Sandwich()")
    if solver is not None:
        write = "solver=optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8), or leave it out"
        require("the solver", solver, Solver, write)
    if isinstance(model, type):
        require(
            "the model", model, (), f"{model.__name__}(...), with a value for each of its fields"
        )


def _refined(
    objective: AbstractObjective,
    specified: Specification,
    constraints: Constraints,
    settings: tuple[Any, ...],
) -> tuple[Refined, AbstractMisfit]:
    """Searches, in ever shorter steps for as long as these change the answer.

    With priors each search is followed by others. The variance that priors are weighed against is
    that of the residuals at the optimum, which the first search knows only from its start; the next
    ones take it from the search before, a fixed-point iteration.
    """
    misfit, theta = objective.misfit(specified), specified.theta
    first = misfit.first_initial()
    begun, rms = _begin(misfit, theta, first)
    reached, halving = begun, None
    while True:
        optimum = search(misfit, constraints, theta, reached, *settings)
        for _ in range(FURTHER_ROUNDS if constraints.has_priors else 0):
            optimum = search(misfit, constraints, theta, optimum.reached, *settings)
        before, halving = halving, halve_steps(misfit, optimum, theta)
        reached, finer = optimum.reached, with_finer_steps(misfit, halving, before)
        if finer is None:
            break
        misfit, (begun, rms) = finer, _begin(finer, theta, first)
    refined = Refined(
        theta=reached.theta,
        uncertainty=optimum.uncertainty,
        known={name: jnp.asarray(value) for name, value in specified.fixed.items()},
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
        parameters=specified.names,
        units=tuple(specified.sharing.values(specified.units).items()),
        quantities=misfit.labels,
        quantity_units=misfit.units,
        initial_state_names=misfit.initial_state_names,
        by=tuple(objective.describe().items()),
    )
    return refined, misfit


@kept_jit
def _begin(
    misfit: AbstractMisfit, theta: Float[Array, " p"], first: Float[Array, "windows s"]
) -> tuple[Reached, Float[Array, " quantities"]]:
    """What the start leaves at the initial states that suit it best, in all and as rms."""
    energy = misfit.profiled_energy(theta, first)
    status = RefinementStatus.where(
        jnp.isfinite(jnp.sum(energy)), RefinementStatus.converged, RefinementStatus.not_finite
    )
    return Reached(theta, first, energy, status, jnp.array(0)), misfit.rms(energy)

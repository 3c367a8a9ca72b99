"""What a refinement found, and how far it can be trusted."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from riecjax.estimation.estimate import AbstractEstimate
from riecjax.findings import Finding
from riecjax.leaves import Leaf
from riecjax.refinement.optimum import RefinementStatus
from riecjax.uncertainty.intervals import Uncertainty


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

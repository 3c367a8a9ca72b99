"""Whether a record tells a model's parameters apart, known before any of them is estimated."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.estimation.estimate import combination
from riecjax.estimation.identify import not_excited, raise_if_nothing_to_fit
from riecjax.estimation.parameters import ParameterPlan
from riecjax.estimation.stages import stages_over_records
from riecjax.findings import Finding
from riecjax.leaves import on_host
from riecjax.linear_algebra import symmetric_eigen, unit_diagonal
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.summary import Summary

UNIDENTIFIABLE = 1e-6
"""Share of a regressor that is its own, below which no sensor could see it."""
NEARLY_COLLINEAR = 0.02
"""Share below which a sensor error of a few percent would turn the estimate over."""
NOISE_MARGIN = 2.0
"""How many times the noise of the signals the own part of a regressor should be."""


class Excitation(eqx.Module):
    """How one stage's regressors are excited.

    **Fields:**

    - `size`: root mean square of each regressor, in the unit of the rows over the parameter's.
    - `own_share`: share of each regressor that no combination of the others explains: 1 if
      orthogonal to them, 0 if collinear (one over the root of the variance inflation factor).
    - `noise_share`: share of each regressor that is noise of its signals, estimated from what
      changes from sample to sample.
    - `weakest_direction`, `weakest_share`: unit vector over the scaled regressors whose
      combination is smallest, and its size.
    """

    size: Float[Array, " p"]
    own_share: Float[Array, " p"]
    noise_share: Float[Array, " p"]
    weakest_direction: Float[Array, " p"]
    weakest_share: Float[Array, ""]
    parameters: tuple[str, ...] = eqx.field(static=True)
    stage_name: str = eqx.field(static=True)

    def findings(self) -> list[Finding]:
        """What stands against identifying this stage (not under jit)."""
        silent = [n for n, size in zip(self.parameters, self.size) if float(size) == 0]
        if silent:
            return [not_excited(self.stage_name, name) for name in silent]
        direction = np.asarray(self.weakest_direction)
        share = float(self.weakest_share)
        noise = float(np.sqrt(np.sum(np.square(direction * np.asarray(self.noise_share)))))
        remedy = (
            f"Excite the system more richly, or hold one of them at a known value (on the command "
            f"line: --set {self.parameters[int(np.argmax(np.abs(direction)))]}=VALUE)."
        )
        if share < UNIDENTIFIABLE:
            why = Finding("unidentifiable", "the record cannot tell these apart")
        elif share < NOISE_MARGIN * noise and share < 0.5:
            why = Finding(
                "unidentifiable",
                f"what tells these apart is no larger than the noise of the signals "
                f"({100 * share:.2g} % of the regressors, noise {100 * noise:.2g} %)",
            )
        elif share < NEARLY_COLLINEAR:
            why = Finding(
                "nearly_collinear",
                f"only {100 * share:.2g} % of the regressors tells these apart, so a small error "
                f"of a sensor moves them far",
            )
        else:
            return []
        which = combination(self.parameters, direction)
        scale = f"{which}, in units of each regressor's size"
        weak = np.abs(direction) > 0.1 * np.max(np.abs(direction))
        names = tuple(name for name, part in zip(self.parameters, weak) if part)
        message = f"{self.stage_name}: {why.message}: {scale}. {remedy}"
        return [why._replace(message=message, parameters=names)]


def excitations(summary: Summary, plan: ParameterPlan) -> list[Excitation]:
    """How each stage's regressors are excited, by a Summary with a survey (not under jit).

    The noise of a signal is estimated from its differences of sixth order, which no smooth motion
    survives, and sent through the equation once: rows with that noise less rows without.

    **Raises:** `DataError` for a stage without rows, or with terms that are not finite.
    """
    equations = summary.equations()
    counts, sums = (
        [sum(getattr(e, of).sum() for e in stage) for stage in equations]
        for of in ("count", "moments")
    )
    raise_if_nothing_to_fit(plan, counts, sums)

    def noise(i: int, j: int) -> NormalEquations:
        e = equations[i][j]
        found = [one.stages[i][j].survey for one in summary.recordings]
        count = e.count.sum(1)
        each: Any = np.stack([np.asarray(s.noise) for s in found if s is not None])
        return NormalEquations(each * count[:, None, None], count, e.parameters)

    noises = [[noise(i, j) for j in range(len(stage))] for i, stage in enumerate(equations)]
    totals = [[e.in_blocks_of_records() for e in stage] for stage in equations]
    return on_host(_excitations(totals, noises, plan))


@eqx.filter_jit
def _excitations(
    equations: list[list[NormalEquations]],
    noise: list[list[NormalEquations]],
    plan: ParameterPlan,
) -> list[Excitation]:
    stages, _ = stages_over_records(equations, plan.sharing)
    noises, _ = stages_over_records(noise, plan.sharing)
    found = []
    for stage, own, (label, unknown) in zip(stages, noises, plan.stages):
        if unknown:
            summed, added = stage.total(), own.total()
            mean = added.moments / jnp.where(added.count > 0, added.count, 1.0)
            found.append(excitation_of(summed, mean, unknown, label))
    return found


def excitation_of(
    total: NormalEquations,
    noise: Float[Array, "columns columns"],
    unknown: tuple[str, ...],
    label: str,
) -> Excitation:
    """How a stage's regressors are excited, by its normal equations.

    With the regressors scaled to unit length their Gram matrix is G = V diag(s^2) V^T: s_1, the
    least singular value, is the size of the smallest combination of them (`weakest_share`), and
    v_1 is that combination. What of regressor j no others explain has the square 1 / (G^-1)_jj, as
    the inverse of a block of one shows, and (G^-1)_jj = sum_i v_ij^2 / s_i^2 is large where a weak
    direction holds j. Noise that is a share n_j of each column adds sum_j v_1j^2 n_j^2 to s_1^2;
    `findings` compares the two.

    **Arguments:** `total`, in one block; `noise`, mean outer product of what the signals' noise
    adds to a row, `(target, *total.parameters)`; `unknown`, which of the parameters the stage
    finds; `label`, its name.
    """
    index = np.array([total.parameters.index(name) for name in unknown])
    mean = total.gram[np.ix_(index, index)] / jnp.where(total.count > 0, total.count, 1.0)
    size = jnp.sqrt(jnp.diagonal(mean))
    scaled, scale = unit_diagonal(mean)
    squares, directions = symmetric_eigen(scaled)
    # Rounding of the Gram matrix hides shares below the root of eps.
    squares = jnp.maximum(squares, 0.0)
    floor = jnp.finfo(size.dtype).eps * len(unknown)
    inverse = jnp.sum(directions**2 / jnp.maximum(squares, floor)[None, :], axis=1)
    return Excitation(
        size=size,
        own_share=jnp.where(size > 0, 1 / jnp.sqrt(inverse), 0.0),
        noise_share=jnp.where(size > 0, jnp.sqrt(jnp.diagonal(noise)[1 + index]) * scale, 0.0),
        weakest_direction=directions[:, 0],
        weakest_share=jnp.sqrt(squares[0]),
        parameters=unknown,
        stage_name=label,
    )

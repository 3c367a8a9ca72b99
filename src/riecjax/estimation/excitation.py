"""Whether a record tells a model's parameters apart, known before any of them is estimated."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from riecjax.criteria.criterion import AbstractCriterion, Rows
from riecjax.equations.equation import Equation
from riecjax.estimation.assembly import all_rows
from riecjax.estimation.estimate import combination
from riecjax.estimation.identify import not_excited, pose, raise_if_nothing_to_fit
from riecjax.estimation.noise import with_noise
from riecjax.estimation.procedure import HasProcedure, Procedure
from riecjax.findings import Finding
from riecjax.records.record import Record

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
        which = combination(self.parameters, direction)
        remedy = (
            f"Excite the system more richly, or hold one of them at a known value (on the command "
            f"line: --set {self.parameters[int(np.argmax(np.abs(direction)))]}=VALUE)."
        )
        if share < UNIDENTIFIABLE:
            return [
                Finding(
                    "unidentifiable",
                    f"{self.stage_name}: the record cannot tell these apart: {which}, in units of "
                    f"each regressor's size. {remedy}",
                )
            ]
        if share < NOISE_MARGIN * noise and share < 0.5:
            return [
                Finding(
                    "unidentifiable",
                    f"{self.stage_name}: what tells these apart is no larger than the noise of "
                    f"the signals ({100 * share:.2g} % of the regressors, noise "
                    f"{100 * noise:.2g} %): {which}, in units of each regressor's size. {remedy}",
                )
            ]
        if share < NEARLY_COLLINEAR:
            return [
                Finding(
                    "nearly_collinear",
                    f"{self.stage_name}: only {100 * share:.2g} % of the regressors tells these "
                    f"apart, so a small error of a sensor moves them far: {which}, in units of "
                    f"each regressor's size. {remedy}",
                )
            ]
        return []


def excitation(
    model: Equation | Procedure | HasProcedure,
    records: Record | Sequence[Record],
    criterion: AbstractCriterion,
    *,
    key: Key[Array, ""] | None = None,
    known: Mapping[str, float | Array] | None = None,
    own: Sequence[str] = (),
) -> list[Excitation]:
    """How each stage's regressors are excited by these records; arguments as for `identify`.

    The noise of a signal is estimated from its differences of sixth order, which no smooth motion
    survives, and sent through the equation once: rows with that noise less rows without.

    **Raises:** as `identify`, but for what a fit alone shows.
    """
    asked = pose(model, records, criterion, key=key, known=known, own=own)
    procedure, recordings, criterion, sharing, _, plan, keys = asked
    noisy = [with_noise(record, seed) for seed, record in enumerate(recordings)]
    clean_rows = all_rows(procedure, sharing, recordings, criterion, keys)
    noisy_rows = all_rows(procedure, sharing, noisy, criterion, keys)
    with np.errstate(over="ignore", invalid="ignore"):
        energies = [np.sum(np.square(np.asarray(rows.columns))) for rows in clean_rows]
    raise_if_nothing_to_fit(plan, [rows.count() for rows in clean_rows], energies)
    return [
        _excitation(clean, disturbed, unknown, label)
        for clean, disturbed, (label, unknown) in zip(clean_rows, noisy_rows, plan)
        if unknown
    ]


@eqx.filter_jit
def _excitation(clean: Rows, disturbed: Rows, unknown: tuple[str, ...], label: str) -> Excitation:
    index = jnp.array([clean.parameters.index(name) for name in unknown])
    regressors = clean.regressors[:, index]
    count = jnp.maximum(clean.count(), 1)
    size = jnp.sqrt(jnp.sum(regressors**2, axis=0) / count)
    filled = size > 0
    scale = jnp.where(filled, 1 / jnp.where(filled, size, 1.0), 0.0)
    gram = (regressors.T @ regressors) * scale[:, None] * scale[None, :] / count
    squares, directions = jnp.linalg.eigh(gram)
    # Rounding of the Gram matrix hides shares below the root of eps.
    squares = jnp.maximum(squares, 0.0)
    # (G^-1)_jj = sum_i v_ij^2 / lambda_i: large where a weak direction holds the parameter.
    floor = jnp.finfo(size.dtype).eps * len(unknown)
    inverse = jnp.sum(directions**2 / jnp.maximum(squares, floor)[None, :], axis=1)
    noise = disturbed.regressors[:, index] - regressors
    return Excitation(
        size=size,
        own_share=jnp.where(filled, 1 / jnp.sqrt(inverse), 0.0),
        noise_share=jnp.sqrt(jnp.sum(noise**2, axis=0) / count) * scale,
        weakest_direction=directions[:, 0],
        weakest_share=jnp.sqrt(squares[0]),
        parameters=unknown,
        stage_name=label,
    )

"""What a fit refuses once the sums are there: no rows, no numbers, or nothing to tell by."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.compilation import kept_jit
from riecjax.equations.model import Model
from riecjax.errors import DataError, IdentifiabilityError
from riecjax.estimation.constant_target import constant_targets
from riecjax.estimation.estimate import Estimate, combination, weighing
from riecjax.estimation.parameters import Parameter, ParameterTable
from riecjax.estimation.stages import largest_share, stages_over_records
from riecjax.findings import Finding
from riecjax.leaves import on_host
from riecjax.linear_algebra import symmetric_eigen, unit_diagonal
from riecjax.summaries.normal_equations import NormalEquations, sum_of_equations
from riecjax.summaries.summary import Summary


def raise_if_nothing_to_fit(table: ParameterTable, totals: Sequence[NormalEquations]) -> None:
    """Refuse a stage without rows, or with sums that are not finite numbers (not under jit).

    **Arguments:** `totals` of each stage of the table.

    **Raises:** `DataError` naming the stage.
    """
    for (label, unknown), total in zip(table.stages, totals):
        if unknown and not bool(np.asarray(total.count) > 0):
            raise DataError(
                f"{label}: every window touches a missing or masked sample. Choose a smaller beta, "
                f"or repair the record's gaps."
            )
    for (label, _), total in zip(table.stages, totals):
        if not bool(np.all(np.isfinite(total.moments))):
            raise DataError(
                f"{label}: its terms are not finite numbers on this record: a division by zero, a "
                f"root of a negative number, or values too large to be squared. Scale the signals "
                f"to SI units and check the equation's expressions."
            )


def not_excited(stage_name: str, row: Parameter) -> Finding:
    """That a parameter's regressor is zero throughout."""
    return Finding(
        "not_excited",
        f"{stage_name}: nothing in the record tells of {row.name}; its regressor is zero "
        f"throughout. {excite_or_hold([row], row.name)}",
        parameters=(row.name,),
    )


def raise_if_constant(model: Model, fit: Estimate, summary: Summary) -> None:
    """Raise `IdentifiabilityError` for a target that says nothing of the parameters that data tell,
    unless sums that were made under jit have no constant to tell means from motion by."""
    if all(one.stages[0][0].constant is not None for one in summary.recordings):
        for finding in constant_targets(model, fit.told_by_data, summary):
            raise IdentifiabilityError(finding.message, finding.code)


def raise_if_unidentifiable(fit: Estimate) -> None:
    """Raise `IdentifiabilityError` for a stage whose regressors are collinear."""
    for stage in fit.stages:
        if int(stage.solution.rank) == len(stage.parameters):
            continue
        label, _ = fit.table.stages[stage.stage]
        for name, size in zip(stage.parameters, np.asarray(stage.relative_size)):
            if size == 0:
                silent = not_excited(label, fit.table[name])
                raise IdentifiabilityError(silent.message, silent.code)
        direction = np.asarray(stage.solution.weakest_direction)
        which = combination(stage.parameters, direction)
        rows = [fit.table[name] for name in weighing(stage.parameters, direction)]
        raise IdentifiabilityError(
            f"{label}: the record cannot tell these apart (collinear regressors): {which}, in "
            f"units of each regressor's size. {excite_or_hold(rows)}"
        )


# What to do where recordings do not tell of some parameters, or not of one by itself.


def excite_or_hold(rows: Sequence[Parameter], hold: str = "") -> str:
    """A sentence on parameters that cannot be told apart.

    Parts of a hidden element are known together or not at all, and where nothing tells of them the
    likeliest reason is that there is none: it is left out rather than held.

    **Arguments:** `hold`, the one that is named to hold; by default none is.
    """
    elements = (row.element for row in rows)
    hidden = dict.fromkeys((e.words, e.option) for e in elements if e is not None)
    if hidden:
        what, options = (" and ".join(words) for words in zip(*hidden))
        return (
            f"Leave {what} out (on the command line: without {options}): the recordings may carry "
            f"none; if there is one, excite the system more richly."
        )
    if len(rows) == 1:
        name = rows[0].name
        return f"Excite it, or hold it at a known value (on the command line: --set {name}=VALUE)."
    return (
        f"Excite the system more richly, or hold one of them at a known value (on the command "
        f"line: --set {hold or 'NAME'}=VALUE)."
    )


# Whether a record tells a model's parameters apart, known before any of them is estimated.

UNIDENTIFIABLE = 1e-6
"""Share of a regressor that is its own, below which no sensor could see it."""
NEARLY_COLLINEAR = 0.02
"""Share below which a sensor error of a few percent would turn the estimate over."""
DOMINATES = 0.3
"""Share of noise in a combination of regressors, as energy, past which an estimate rests on what is
known of the noise."""
DROWNED = 0.9
"""The same past which the combination is lost; a quarter where the noise is not taken off."""


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
    - `noisiest_direction`, `noisiest_share`: the same of the combination that noise makes up most
      of, and the noise's share of its energy; `noisiest` signal in it, empty if none is known.
    - `corrected`: whether what noise adds is taken off before estimation.
    """

    size: Float[Array, " p"]
    own_share: Float[Array, " p"]
    noise_share: Float[Array, " p"]
    weakest_direction: Float[Array, " p"]
    weakest_share: Float[Array, ""]
    noisiest_direction: Float[Array, " p"]
    noisiest_share: Float[Array, ""]
    rows: tuple[Parameter, ...] = eqx.field(static=True)
    stage_name: str = eqx.field(static=True)
    corrected: bool = eqx.field(static=True, default=False)
    noisiest: str = eqx.field(static=True, default="")

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the regressors' coefficients."""
        return tuple(row.name for row in self.rows)

    def findings(self) -> list[Finding]:
        """What stands against identifying this stage (not under jit)."""
        silent = [row for row, size in zip(self.rows, self.size) if float(size) == 0]
        if silent:
            return [not_excited(self.stage_name, row) for row in silent]
        noise, drowned = float(self.noisiest_share), DROWNED if self.corrected else 0.25
        direction, share = np.asarray(self.weakest_direction), float(self.weakest_share)
        of_noise = share >= UNIDENTIFIABLE and noise > min(DOMINATES, drowned)
        direction = np.asarray(self.noisiest_direction) if of_noise else direction
        names = weighing(self.parameters, direction)
        hold = self.parameters[int(np.argmax(np.abs(direction)))]
        remedy = excite_or_hold([row for row in self.rows if row.name in names], hold)
        whose = f"noise of {self.noisiest}" if self.noisiest else "noise of the signals"
        if share < UNIDENTIFIABLE:
            why = Finding("unidentifiable", "the record cannot tell these apart")
        elif noise > drowned:
            why = Finding(
                "unidentifiable",
                f"what tells these apart is {100 * noise:.0f} % {whose}",
                (self.noisiest,) if self.noisiest else (),
            )
        elif noise > DOMINATES:
            why = Finding(
                "noise_dominates",
                f"{100 * noise:.0f} % of what tells these apart is {whose}, so that they rest on "
                f"how well that is known",
                (self.noisiest,) if self.noisiest else (),
            )
            remedy = (
                f"Take longer windows (--beta), refine by output error (--refine output-error), or "
                f"give the noise if it is known (--noise {self.noisiest or 'SIGNAL'}=SD)."
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
        message = f"{self.stage_name}: {why.message}: {scale}. {remedy}"
        return [why._replace(message=message, parameters=names)]


def excitations(summary: Summary, table: ParameterTable) -> list[Excitation]:
    """How each stage's regressors are excited (not under jit).

    Noise is what is taken off the sums; of a criterion that takes off none, what noise of each
    signal's size adds to rows, sent through the equation once, if the Summary has a survey.

    **Raises:** `DataError` for a stage without rows, or with terms that are not finite.
    """
    equations = summary.equations()
    totals = [sum_of_equations([e.flattened().total() for e in stage]) for stage in equations]
    raise_if_nothing_to_fit(table, totals)

    def with_surveyed_noise(i: int, j: int) -> NormalEquations:
        blocks = equations[i][j]
        records = blocks.in_blocks(lambda values: values.sum(1))
        if records.noise is not None:
            return records.with_noise(records.noise, blocks.noise_of_source)
        found = [one.stages[i][j].survey for one in summary.recordings]
        # Sums without a survey say nothing of the noise in their rows.
        nothing = np.zeros(np.shape(records.moments)[-2:])
        each: Any = np.stack([nothing if s is None else np.asarray(s.noise) for s in found])
        return records.with_noise(each * records.count[:, None, None], blocks.noise_of_source)

    of_records = [
        [with_surveyed_noise(i, j) for j, _ in enumerate(stage)]
        for i, stage in enumerate(equations)
    ]
    found, added = on_host(_excitations(of_records, table))
    if all(e.noise is None for stage in equations for e in stage):
        return found
    names = [list(one.noise.sources) for one in summary.recordings]
    places = (np.unravel_index(int(np.argmax(of_stage)), of_stage.shape) for of_stage in added)
    return [
        dataclasses.replace(stage, corrected=True, noisiest=names[record][source])
        for stage, (record, source) in zip(found, places)
    ]


@kept_jit
def _excitations(
    equations: list[list[NormalEquations]], table: ParameterTable
) -> tuple[list[Excitation], list[Float[Array, "records sources"]]]:
    """Of each stage that finds something, and what each of the noise's sources adds to its noisiest
    combination.

    With the regressors scaled to unit length their Gram matrix is G = V diag(s^2) V^T: s_1, the
    least singular value, is the size of the smallest combination of them (`weakest_share`), and
    v_1 is that combination. What of regressor j no others explain has the square 1 / (G^-1)_jj, as
    the inverse of a block of one shows, and (G^-1)_jj = sum_i v_ij^2 / s_i^2 is large where a weak
    direction holds j. Noise that is a share n_j of each column adds sum_j v_1j^2 n_j^2 to s_1^2;
    `findings` compares the two.

    **Arguments:** `equations`, in one block for each record, with their noise.
    """
    stages, _ = stages_over_records(equations, table)
    found, added = [], []
    for stage, (label, unknown) in zip(stages, table.stages):
        if not unknown:
            continue
        total, of_source = stage.total(), stage.noise_of_source
        assert total.noise is not None
        assert of_source is not None
        index = 1 + np.array([total.parameters.index(name) for name in unknown])
        count = jnp.where(total.count > 0, total.count, 1.0)
        mean, noise = (m[np.ix_(index, index)] / count for m in (total.moments, total.noise))
        size = jnp.sqrt(jnp.diagonal(mean))
        scaled, scale = unit_diagonal(mean)
        squares, directions = symmetric_eigen(scaled)
        # Rounding of the Gram matrix hides shares below the root of eps.
        squares = jnp.maximum(squares, 0.0)
        floor = jnp.finfo(size.dtype).eps * len(unknown)
        dominance, noisiest = largest_share(noise, mean)
        of_source = of_source[..., index, :][..., index]
        added.append(jnp.einsum("i,rsij,j->rs", noisiest, of_source, noisiest))
        noisiest = noisiest * size
        length = jnp.sqrt(jnp.sum(noisiest**2))
        inverse = jnp.sum(directions**2 / jnp.maximum(squares, floor)[None, :], axis=1)
        found.append(
            Excitation(
                size=size,
                own_share=jnp.where(size > 0, 1 / jnp.sqrt(inverse), 0.0),
                noise_share=jnp.where(size > 0, jnp.sqrt(jnp.diagonal(noise)) * scale, 0.0),
                weakest_direction=directions[:, 0],
                weakest_share=jnp.sqrt(squares[0]),
                noisiest_direction=noisiest / jnp.where(length > 0, length, 1.0),
                noisiest_share=dominance,
                rows=tuple(table[name] for name in unknown),
                stage_name=label,
            )
        )
    return found, added

"""What a fit refuses once the sums are there: no rows, no numbers, or nothing to tell by."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax.errors import DataError, IdentifiabilityError
from riecjax.estimation.parameters import (
    Parameter,
    ParameterTable,
    combination,
    excite_or_hold,
    not_excited,
    weighing,
)
from riecjax.estimation.stages import largest_share, stages_over_records
from riecjax.findings import CODES, Finding, in_percent
from riecjax.leaves import Leaf
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
        if not bool(np.all(np.isfinite(total.moments))):
            raise DataError(
                f"{label}: its terms are not finite numbers on this record: a division by zero, a "
                f"root of a negative number, or values too large to be squared. Scale the signals "
                f"to SI units and check the equation's expressions."
            )


def refusal_by(findings: Iterable[Finding]) -> Finding | None:
    """What rules an answer out, or else why; `None` if nothing does."""
    findings, importance = list(findings), [*CODES].index
    refusals = [finding for finding in findings if finding.about.refuses]
    first = min(refusals, key=lambda finding: importance(finding.code), default=None)
    reasons = (finding for finding in findings if finding.about.explains_refusal)
    return None if first is None else next(reasons, first)


def raise_if_refused(findings: Iterable[Finding]) -> None:
    """Raise what findings rule out.

    **Raises:** `IdentifiabilityError` with the message and code of the most important.
    """
    if refusal := refusal_by(findings):
        raise IdentifiabilityError(refusal.message, refusal.code)


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


class Excitation(NamedTuple):
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

    size: Float[Leaf, " p"]
    own_share: Float[Leaf, " p"]
    noise_share: Float[Leaf, " p"]
    weakest_direction: Float[Leaf, " p"]
    weakest_share: float
    noisiest_direction: Float[Leaf, " p"]
    noisiest_share: float
    rows: tuple[Parameter, ...]
    stage_name: str
    corrected: bool = False
    noisiest: str = ""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the regressors' coefficients."""
        return tuple(row.name for row in self.rows)

    def findings(self) -> list[Finding]:
        """What stands against identifying this stage (not under jit)."""
        silent = [row for row, size in zip(self.rows, self.size) if size == 0]
        if silent:
            return [not_excited(self.stage_name, row) for row in silent]
        noise, drowned = self.noisiest_share, DROWNED if self.corrected else 0.25
        share = self.weakest_share
        of_noise = share >= UNIDENTIFIABLE and noise > min(DOMINATES, drowned)
        direction = np.asarray(self.noisiest_direction if of_noise else self.weakest_direction)
        names = weighing(self.parameters, direction)
        hold = self.parameters[int(np.argmax(np.abs(direction)))]
        remedy = excite_or_hold([row for row in self.rows if row.name in names], hold)
        whose = f"noise of {self.noisiest}" if self.noisiest else "noise of the signals"
        signals = (self.noisiest,) if self.noisiest else ()
        if share < UNIDENTIFIABLE:
            code, why, signals = "unidentifiable", "the record cannot tell these apart", ()
            remedy = f"Leave out what multiplies the same function of the signals. {remedy}"
        elif noise > drowned:
            code = "unidentifiable"
            why = f"what tells these apart is {in_percent(noise, '.0f')} {whose}"
        elif noise > DOMINATES:
            code = "noise_dominates"
            why = (
                f"{in_percent(noise, '.0f')} of what tells these apart is {whose}, so that they "
                f"rest on how well that is known"
            )
            remedy = (
                f"Take longer windows (--beta), refine by output error (--refine output-error), or "
                f"give the noise if it is known (--noise {self.noisiest or 'SIGNAL'}=SD)."
            )
        elif share < NEARLY_COLLINEAR:
            code, signals = "nearly_collinear", ()
            why = (
                f"only {in_percent(share)} of the regressors tells these apart, so a small error "
                f"of a sensor moves them far"
            )
        else:
            return []
        which = combination(self.parameters, direction)
        scale = f"{which}, in units of each regressor's size"
        message = f"{self.stage_name}: {why}: {scale}. {remedy}"
        return [Finding(code, message, signals, names)]


@np.errstate(divide="ignore", invalid="ignore")
def excitations(summary: Summary, table: ParameterTable) -> list[Excitation]:
    """How the regressors are excited of each stage that finds something (not under jit).

    Noise is what is taken off the sums; of a criterion that takes off none, what noise of each
    signal's size adds to rows, sent through the equation once, if the Summary has a survey.

    With the regressors scaled to unit length their Gram matrix is G = V diag(s^2) V^T: s_1, the
    least singular value, is the size of the smallest combination of them (`weakest_share`), and
    v_1 is that combination. What of regressor j no others explain has the square 1 / (G^-1)_jj, as
    the inverse of a block of one shows, and (G^-1)_jj = sum_i v_ij^2 / s_i^2 is large where a weak
    direction holds j. Noise that is a share n_j of each column adds sum_j v_1j^2 n_j^2 to s_1^2;
    `findings` compares the two.

    **Raises:** `DataError` for a stage without rows, or with terms that are not finite.
    """
    equations = summary.equations()
    totals = [sum_of_equations([e.flattened().total() for e in stage]) for stage in equations]
    raise_if_nothing_to_fit(table, totals)

    def with_surveyed_noise(i: int, j: int) -> NormalEquations:
        """In one block for each record."""
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
    corrected = any(e.noise is not None for stage in equations for e in stage)
    sources = [list(one.noise.sources) for one in summary.recordings]
    stages, found = stages_over_records(of_records, table)[0], []
    for stage, (label, unknown) in zip(stages, table.stages):
        if not unknown:
            continue
        total, of_source = stage.total(), stage.noise_of_source
        assert total.noise is not None
        assert of_source is not None
        index = 1 + np.array([total.parameters.index(name) for name in unknown])
        count = np.where(total.count > 0, total.count, 1.0)
        mean, noise = (m[np.ix_(index, index)] / count for m in (total.moments, total.noise))
        size = np.sqrt(np.diagonal(mean))
        scaled, scale = unit_diagonal(mean)
        squares, directions = symmetric_eigen(scaled)
        # Rounding of the Gram matrix hides shares below the root of eps.
        squares = np.maximum(squares, 0.0)
        floor = np.finfo(size.dtype).eps * len(unknown)
        dominance, noisiest = largest_share(noise, mean)
        signal, of_source = "", of_source[..., index, :][..., index]
        if corrected:
            added = np.einsum("i,rsij,j->rs", noisiest, of_source, noisiest)
            record, source = np.unravel_index(int(np.argmax(added)), added.shape)
            signal = sources[record][source]
        noisiest = noisiest * size
        length = np.sqrt(np.sum(noisiest**2))
        inverse = np.sum(directions**2 / np.maximum(squares, floor)[None, :], axis=1)
        found.append(
            Excitation(
                size=size,
                own_share=np.where(size > 0, 1 / np.sqrt(inverse), 0.0),
                noise_share=np.where(size > 0, np.sqrt(np.diagonal(noise)) * scale, 0.0),
                weakest_direction=directions[:, 0],
                weakest_share=float(np.sqrt(squares[0])),
                noisiest_direction=noisiest / np.where(length > 0, length, 1.0),
                noisiest_share=float(dominance),
                rows=tuple(table[name] for name in unknown),
                stage_name=label,
                corrected=corrected,
                noisiest=signal,
            )
        )
    return found

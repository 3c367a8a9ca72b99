"""Estimates against window length: the standard test of whether a model is exact enough.

With an exact model every window length finds the same parameters, up to scatter. Where a model
leaves something out, that weighs differently at different lengths, and the estimates drift.
"""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from riecjax import tails
from riecjax.criteria.criterion import RIEC
from riecjax.equations.equation import Equation
from riecjax.errors import DataError, require
from riecjax.estimation.assembly import all_normal_equations, short_blocks
from riecjax.estimation.blocks import FEWEST_WINDOWS, blocks_in_use, put_together
from riecjax.estimation.identify import (
    known_values,
    plan_stages,
    record_keys,
    require_settings,
)
from riecjax.estimation.influence import block_influence
from riecjax.estimation.procedure import (
    HasProcedure,
    Procedure,
    as_procedure,
    found_values,
    solve_stages,
)
from riecjax.estimation.sharing import Sharing
from riecjax.findings import Finding
from riecjax.leaves import namespace
from riecjax.records.record import Record, as_records

FEWEST_SAMPLES = 4
"""Samples that the shortest window of a sweep spans at least."""
FEWEST_STRETCHES = 10
"""Longest windows that the records hold at least, end to end."""
SMALLEST_DRIFT = 0.005
"""Share of a parameter below which a drift is nobody's concern."""
SHARE_OF_BLOCKS = 0.5
"""Share of the blocks of time with windows at some length below which another has no estimate."""
LEVEL = 0.05


class WindowSweep(eqx.Module):
    """Estimates at several window lengths, from the same records.

    **Fields:**

    - `alpha`, `beta`: shortest and longest window of each band in seconds, shape `(bands,)`.
    - `theta`: estimates, shape `(bands, p)`; NaN at lengths that hardly fit between the record's
      gaps.
    - `influence`: how far each block of time moves each estimate, shape `(bands, blocks, p)`; the
      blocks are the same at every length, so that estimates can be compared pairwise.
    - `relative_rms`: residual of each stage, shape `(bands, stages)`.
    - `block_count`: blocks that hold rows.
    - `parameters`, `units`, `stage_names`: as in an estimate.
    """

    alpha: Float[Array, " bands"]
    beta: Float[Array, " bands"]
    theta: Float[Array, "bands p"]
    influence: Float[Array, "bands blocks p"]
    relative_rms: Float[Array, "bands stages"]
    block_count: Int[Array, ""]
    parameters: tuple[str, ...] = eqx.field(static=True)
    units: tuple[tuple[str, str], ...] = eqx.field(static=True)
    stage_names: tuple[str, ...] = eqx.field(static=True)

    @property
    def standard_errors(self) -> Float[Array, "bands p"]:
        """Standard error of each estimate."""
        xp = namespace(self.influence)
        return xp.sqrt(self._factor * xp.sum(xp.square(self.influence), axis=1))

    @property
    def _factor(self) -> Array:
        # The scores of n blocks sum to zero at the solution.
        xp = namespace(self.block_count)
        return xp.divide(self.block_count, xp.maximum(self.block_count - 1, 1))

    def drift(self, name: str) -> tuple[int, int, float, float]:
        """The two lengths between which a parameter differs most significantly (not under jit).

        Lengths without an estimate are skipped.

        **Returns:** their indices, the difference of the estimates, and its standard error, in
        which what is common to both lengths cancels.
        """
        j = self.parameters.index(name)
        theta, influence = np.asarray(self.theta[:, j]), np.asarray(self.influence[:, :, j])
        difference = theta[None, :] - theta[:, None]
        apart = influence[None, :, :] - influence[:, None, :]
        error = np.sqrt(float(self._factor) * np.sum(apart**2, axis=-1))
        significance = np.where(error > 0, np.abs(difference) / np.where(error > 0, error, 1), 0)
        largest = np.max(np.abs(theta), where=np.isfinite(theta), initial=0.0)
        relevant = np.abs(difference) > SMALLEST_DRIFT * largest
        first, last = np.unravel_index(np.argmax(significance * relevant), difference.shape)
        first, last = sorted((int(first), int(last)))
        return first, last, float(difference[first, last]), float(error[first, last])

    def findings(self) -> list[Finding]:
        """`window_sensitive` for each parameter that drifts by more than its uncertainty.

        A paired test at the 5 % level, corrected for the number of pairs (Bonferroni), of a drift
        of at least half a percent.
        """
        bands = self.theta.shape[0]
        pairs = bands * (bands - 1) / 2
        dof = max(int(self.block_count) - 1, 1)
        limit = float(tails.student(LEVEL / (2 * pairs), dof))
        units = dict(self.units)
        found = []
        for j, name in enumerate(self.parameters):
            _, _, difference, error = self.drift(name)
            if abs(difference) > limit * error and error > 0:
                theta = np.asarray(self.theta[:, j])
                low, high = int(np.nanargmin(theta)), int(np.nanargmax(theta))
                low, high = sorted((low, high))
                unit = f" {units[name]}" if units.get(name) else ""
                found.append(
                    Finding(
                        "window_sensitive",
                        f"{name} goes from {float(self.theta[low, j]):.4g} with windows of "
                        f"{self._band(low)} to {float(self.theta[high, j]):.4g}{unit} with "
                        f"{self._band(high)}, a drift of up to {abs(difference) / error:.0f} "
                        f"standard errors: the model leaves something out, or short windows show "
                        f"the sensors' noise.",
                    )
                )
        return found

    def _band(self, index: int) -> str:
        return f"{float(self.alpha[index]):.3g} to {float(self.beta[index]):.3g} s"


def window_sweep(
    model: Equation | Procedure | HasProcedure,
    records: Record | Sequence[Record],
    criterion: RIEC,
    *,
    key: Key[Array, ""] | None = None,
    known: Mapping[str, float | Array] | None = None,
    own: Sequence[str] = (),
    shortest: float | None = None,
    longest: float | None = None,
    bands: int = 10,
) -> WindowSweep:
    """Identify a model again and again, with windows from short to long (not under jit).

    Each band reaches from a length to twice that length.

    **Arguments:** as for [`identify`][], and

    - `shortest`, `longest`: ends of the sweep in seconds; by default a tenth of the criterion's
      alpha, at least four samples, to twice its beta, at most a tenth of all records together.
    - `bands`: number of lengths.

    **Raises:** as `identify`, and `DataError` if the records are too short for any sweep.
    """
    procedure = as_procedure(model)
    require(
        "the criterion", criterion, RIEC, "rx.RIEC(rx.AllWindows(0.05, 0.5)), which has windows"
    )
    require_settings(key, known, own)
    recordings = as_records(records)
    sharing = Sharing(procedure.parameters, own, len(recordings))
    given = known_values(procedure, sharing, known or {})
    plan = plan_stages(procedure, sharing, given)
    low, high = _reach(recordings, criterion, shortest, longest)
    alpha = np.geomspace(low, high / 2, bands)
    beta = 2 * alpha
    # Blocks are those of the longest windows at every length, so that estimates compare pairwise.
    lengthy = _with_windows(criterion, alpha[-1], beta[-1]).fitted(recordings)
    used = blocks_in_use(short_blocks(recordings, lengthy), np.asarray(FEWEST_WINDOWS * beta[-1]))
    theta, influence, residual = _estimates(
        procedure,
        sharing,
        recordings,
        lengthy,
        record_keys(key, len(recordings)),
        given,
        used,
        (jnp.asarray(alpha), jnp.asarray(beta)),
    )
    units = sharing.values(procedure.units)
    stages = [(label, unknown) for label, unknown in plan if unknown]
    return WindowSweep(
        alpha=jnp.asarray(alpha),
        beta=jnp.asarray(beta),
        theta=theta,
        influence=influence,
        relative_rms=residual,
        block_count=namespace(used).sum(used),
        parameters=tuple(name for _, unknown in stages for name in unknown),
        units=tuple(units.items()),
        stage_names=tuple(label for label, _ in stages),
    )


def _reach(
    records: list[Record], criterion: RIEC, shortest: float | None, longest: float | None
) -> tuple[float, float]:
    coarsest = max(float(record.time_step) for record in records)
    multiple = criterion.test_function.smoothness
    low = max(float(criterion.windows.alpha) / 10, multiple * FEWEST_SAMPLES * coarsest)
    recorded = sum(float(record.duration) for record in records) / FEWEST_STRETCHES
    each = min(float(record.duration) for record in records) / 2
    high = min(2 * float(criterion.windows.beta), recorded, each)
    low = low if shortest is None else shortest
    high = high if longest is None else longest
    if not 0 < low < high / 2:
        raise DataError(
            f"too short for a sweep over window lengths: from {low:.3g} to {high:.3g} s there are "
            f"not two bands. Record for longer, or choose a larger beta."
        )
    return low, high


def _with_windows(criterion: RIEC, alpha: Array | float, beta: Array | float) -> RIEC:
    return RIEC(criterion.windows.between(alpha, beta), criterion.test_function)


@eqx.filter_jit
def _estimates(
    procedure: Procedure,
    sharing: Sharing,
    records: list[Record],
    criterion: RIEC,
    keys: list[Key[Array, ""] | None],
    given: Mapping[str, Array],
    used: Int[Array, " records"],
    lengths: tuple[Float[Array, " bands"], Float[Array, " bands"]],
) -> tuple[Float[Array, "bands p"], Float[Array, "bands blocks p"], Float[Array, "bands stages"]]:
    def at_length(length: tuple[Array, Array]) -> tuple[Array, Array, Array, Array]:
        fine = all_normal_equations(
            procedure, sharing, records, _with_windows(criterion, *length), keys
        )
        stages = [put_together(stage, fine.short, used) for stage in fine.stages]
        solutions = solve_stages(stages, given)
        return (
            jnp.concatenate([stage.solution.theta for stage in solutions]),
            block_influence(stages, given, found_values(solutions, given)),
            jnp.stack([stage.relative_rms for stage in solutions]),
            jnp.min(jnp.stack([jnp.sum(stage.count > 0) for stage in stages])),
        )

    # One length after the other: rows of all of them at once would need ten times the memory.
    theta, influence, residual, held = jax.lax.map(at_length, lengths)
    known = (held >= SHARE_OF_BLOCKS * jnp.max(held)) & (held > 0)
    return (
        jnp.where(known[:, None], theta, jnp.nan),
        jnp.where(known[:, None, None], influence, jnp.nan),
        jnp.where(known[:, None], residual, jnp.nan),
    )

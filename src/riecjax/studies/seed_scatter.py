"""How far random windows move estimates from one draw to the next, on the same records.

Scatter of the sampling, which more windows (or all of them) make as small as one likes. It says
nothing of how uncertain the parameters are: another recording would move them much further.
"""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.equation import Equation
from riecjax.errors import ModelError, require
from riecjax.estimation.assembly import all_normal_equations
from riecjax.estimation.influence import in_order, staged_values, unknowns
from riecjax.estimation.least_squares import solve
from riecjax.estimation.procedure import HasProcedure, Procedure, as_procedure
from riecjax.estimation.question import question, record_keys, require_key
from riecjax.estimation.sharing import Sharing
from riecjax.records.record import Record, as_records


class SeedScatter(eqx.Module):
    """Estimates from many draws of windows.

    **Fields:** `theta`, shape `(seeds, p)`; `parameters`.
    """

    theta: Float[Array, "seeds p"]
    parameters: tuple[str, ...] = eqx.field(static=True)

    @property
    def spread(self) -> Float[Array, " p"]:
        """Standard deviation over the draws: of the sampling, not of the parameters."""
        return jnp.std(self.theta, axis=0, ddof=1)


def seed_scatter(
    model: Equation | Procedure | HasProcedure,
    records: Record | Sequence[Record],
    criterion: AbstractCriterion,
    *,
    key: Key[Array, ""],
    known: Mapping[str, float | Array] | None = None,
    per_record: Sequence[str] = (),
    seeds: int = 32,
) -> SeedScatter:
    """Identify with `seeds` draws of random windows, vmapped; other arguments as for `identify`.

    **Raises:** `ModelError` for a criterion that draws nothing, or fewer than two seeds.
    """
    procedure = as_procedure(model)
    require(
        "the criterion", criterion, AbstractCriterion, "rx.RIEC(rx.RandomWindows(0.05, 0.5, 8000))"
    )
    require_key(key)
    if not criterion.needs_key:
        raise ModelError("only random windows scatter from seed to seed; this criterion has none.")
    if seeds < 2:
        raise ModelError(f"scatter needs at least two seeds; got {seeds}.")
    recordings = as_records(records)
    sharing, given, plan = question(procedure, len(recordings), known, per_record)
    keys = jax.random.split(key, seeds)
    theta = _estimates(procedure, sharing, recordings, criterion, keys, given)
    return SeedScatter(theta, tuple(name for _, names in plan for name in names))


@eqx.filter_jit
def _estimates(
    procedure: Procedure,
    sharing: Sharing,
    records: list[Record],
    criterion: AbstractCriterion,
    keys: Key[Array, " seeds"],
    known: Mapping[str, Array],
) -> Float[Array, "seeds p"]:
    def with_key(key: Key[Array, ""]) -> Float[Array, " p"]:
        own_keys = record_keys(key, len(records))
        stages = all_normal_equations(procedure, sharing, records, criterion, own_keys)
        flat = [stage.flattened() for stage in stages]
        totals = [stage.total() for stage in flat]
        plan = unknowns(flat, known)
        return in_order(plan, staged_values(totals, plan, known, lambda e: solve(e).theta))

    # Some at a time: rows of all draws at once would need their memory many times over.
    return jax.lax.map(with_key, keys, batch_size=4)

"""From normal equations in short blocks of time to how far their solution can be trusted."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.estimation.blocks import (
    MOST_BLOCKS,
    ShortBlocks,
    block_length,
    blocks_in_use,
    gathered,
    politis_white,
    put_together,
)
from riecjax.estimation.heterogeneity import record_inflation
from riecjax.estimation.influence import block_influence, unknowns
from riecjax.estimation.intervals import AbstractIntervals, Evidence, Uncertainty
from riecjax.estimation.normal_equations import NormalEquations


class Judged(NamedTuple):
    """Uncertainty, grown by `inflation` where records disagree, and the evidence behind it."""

    uncertainty: Uncertainty
    inflation: Float[Array, " p"]
    evidence: Evidence


def judge(
    stages: Sequence[NormalEquations],
    known: Mapping[str, Array],
    values: Mapping[str, Array],
    short: ShortBlocks,
    longest_window: Float[Array, ""],
    shared: Bool[np.ndarray, " p"],
    intervals: AbstractIntervals,
) -> Judged:
    """Uncertainty of the solution `values` of all stages.

    **Arguments:** `stages`, normal equations with leading axes `(records, short blocks)`;
    `shared`, which of the parameters found hold for all records: others cannot disagree.
    """
    flat = [stage.flattened() for stage in stages]
    fine = block_influence(flat, known, values)
    fine = fine.reshape(short.number.shape[0], -1, fine.shape[-1])
    length = block_length(short, longest_window, politis_white(fine, short))
    used = blocks_in_use(short, length)
    blocks = [put_together(stage, short, used) for stage in stages]
    influence = gathered(fine, short, used)
    evidence = Evidence(
        blocks,
        unknowns(blocks, known),
        dict(known),
        dict(values),
        used,
        influence,
        fine,
        short,
        length,
        list(stages),
    )
    per_record = influence.reshape(short.number.shape[0], MOST_BLOCKS, -1)
    inflation = jnp.where(shared, record_inflation(per_record, used), 1.0)
    return Judged(intervals.uncertainty(evidence).grown(inflation), inflation, evidence)

"""How large a term is where it acts, which a mean over all windows does not show."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from jaxtyping import Array, Float

from riecjax.equations.equation import Equation
from riecjax.estimation.sharing import Sharing
from riecjax.records.record import Record

STEADY = 3.0
"""Kurtosis of a signal without bursts: a Gaussian's. A sinusoid's is half of it."""


def sizes_in_bursts(
    stage: Sequence[Equation],
    sharing: Sharing,
    records: Sequence[Record],
    values: Mapping[str, Array],
    found: Collection[str],
    names: Collection[str],
) -> dict[str, float]:
    """r.m.s. of terms where they act over the target's, sample by sample (not under jit).

    Each sample of a term weighs as much as its energy: 10 times the plain r.m.s. for what acts 1 %
    of the time, and no more than it for what is as steady as noise. A friction that differs just
    before and just after a reversal cancels in windows, and not here. Terms under a derivative are
    left out: differentiated noise comes in bursts as well.

    **Arguments:** `values` of all parameters; of `found`, which this stage finds, those of `names`
    are asked for.
    """
    powers = {name: np.zeros(3) for name in names}
    for i, record in enumerate(records):
        for equation in stage:
            target = np.zeros(record.sample_count)
            for term in equation.terms:
                sampled, present = term.samples(record, 0)
                columns = np.asarray(sampled, float)
                if present is not None:
                    columns = np.where(np.asarray(present), columns, np.nan)
                known = sharing.of_record(term.parameters, i) or (None,)
                for name, column in zip(known, columns):
                    if name not in found:
                        factor = 1.0 if name is None else float(values[name])
                        target = target + factor * _derivative(column, record, term.derivative)
                    elif name in powers and not term.derivative:
                        powers[name][:2] += np.nansum(column**2), np.nansum(column**4)
            size = np.nanmean(target**2)
            for name in set(sharing.of_record(equation.parameters, i)) & powers.keys():
                powers[name][2] = max(powers[name][2], size)
    return {
        name: float(np.sqrt(fourth / STEADY / square / size)) if square * size > 0 else 0.0
        for name, (square, fourth, size) in powers.items()
    }


def _derivative(column: Float[np.ndarray, " n"], record: Record, order: int) -> np.ndarray:
    for _ in range(order):
        column = np.gradient(column, float(record.time_step))
    return column

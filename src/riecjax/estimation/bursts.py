"""How large a term is where it acts, which a mean over all windows does not show."""

from collections.abc import Collection, Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

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
    powers = dict.fromkeys(names, (0.0, 0.0, 0.0))
    for i, record in enumerate(records):
        for equation in stage:
            bare = {name: sharing.of_record((name,), i)[0] for name in equation.parameters}
            unknown = tuple(name for name, full in bare.items() if full in found)
            known = {n: jnp.asarray(values[full]) for n, full in bare.items() if full not in found}
            terms, target = _powers(equation, record, known, unknown)
            for name, (square, fourth) in terms.items():
                if (full := bare[name]) in powers:
                    before = powers[full]
                    both = before[0] + float(square), before[1] + float(fourth)
                    powers[full] = (*both, max(before[2], float(target)))
    return {
        name: float(np.sqrt(fourth / STEADY / square / target)) if square * target > 0 else 0.0
        for name, (square, fourth, target) in powers.items()
    }


@eqx.filter_jit
def _powers(
    equation: Equation, record: Record, known: dict[str, Array], unknown: tuple[str, ...]
) -> tuple[dict[str, tuple[Array, Array]], Array]:
    """Sums of squares and fourth powers of unknown terms, and the target's mean square."""
    target = jnp.zeros(record.sample_count)
    terms: dict[str, tuple[Array, Array]] = {}
    for term in equation.terms:
        columns, present = term.samples(record, 0)
        if present is not None:
            columns = jnp.where(present[None, :], columns, jnp.nan)
        for name, column in zip(term.parameters or ("",), columns):
            if name not in unknown:
                for _ in range(term.derivative):
                    column = jnp.asarray(jnp.gradient(column)) / record.time_step
                target = target + known.get(name, 1.0) * column
            elif not term.derivative:
                square, fourth = terms.get(name, (0.0, 0.0))
                terms[name] = square + jnp.nansum(column**2), fourth + jnp.nansum(column**4)
    return terms, jnp.nanmean(target**2)

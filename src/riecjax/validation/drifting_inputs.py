"""Whether what an equation leaves grows evenly along a record: an input's sensor that drifts."""

import shlex
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import scipy.stats

from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.findings import Finding
from riecjax.records.record import Record
from riecjax.validation.equation_errors import EquationError

PARTS = 20
"""Parts of a record whose mean errors are compared."""
LEVEL = 1e-5
"""Probability by chance below which a drift is told."""
EVEN = 0.7
"""Share of the scatter of the parts' means that a straight line explains at least."""
NOTABLE = 0.02
"""Change along the record, over the target's rms, from which it matters."""
FOLLOWS = 0.999
"""Correlation of an equation's target with its input past which it is that input."""


# Values too large to be squared drift nowhere.
@np.errstate(over="ignore", invalid="ignore")
def drifting_inputs(
    equations: Sequence[Equation],
    records: Sequence[Record],
    errors: Sequence[Sequence[EquationError]],
) -> Iterator[Finding]:
    """`drifting_signal` of an equation's only input, where a line in time is left.

    What else changes evenly with time, such as friction of a machine that warms up, looks the same.

    **Arguments:** `errors` of each equation on each record, of which there is to be one.
    """
    for equation, of_records in zip(equations, errors, strict=True):
        inputs = [t.of for t in equation.terms if not t.parameters and isinstance(t, Term)]
        if len(records) != 1 or len(inputs) != 1 or not isinstance(inputs[0], str):
            continue
        name, record, error = inputs[0], records[0], of_records[0]
        change = _change(error, np.asarray(error.centred(record[name])))
        if change is None:
            continue
        time, unit = np.asarray(record.time), dict(record.units).get(name, "")
        rate, middle = change / float(time[-1] - time[0]), 0.5 * (time[0] + time[-1])
        formula = f"{name}-({rate:.6g})*(t-{middle:.15g})"
        remedy = ("--derive", f"{name}={formula}") if name.isidentifier() else ()
        yield Finding(
            "drifting_signal",
            f"what {equation.name} leaves grows evenly with time, as if {name} drifted by "
            f"{change:.3g} {unit}".rstrip()
            + f" along the record. Take it off (on the command "
            f"line: {shlex.join(remedy)}), or look for what else changes with time, such as "
            f"friction of a machine that warms up.",
            (name,),
            equation.parameters,
            remedy=remedy,
            step=f"Take the straight line off {name}",
        )


def _change(error: EquationError, signal: np.ndarray) -> float | None:
    """By how much the input seems to change from the record's first to its last sample."""
    present, values, target = (np.asarray(v) for v in (error.present, error.error, error.target))
    parts = np.array_split(np.flatnonzero(present), PARTS)
    if present.sum() < 10 * PARTS or not np.ptp(target[present]) > 0:
        return None
    scale = np.cov(target[present], signal[present])
    if not scale[0, 1] ** 2 > FOLLOWS**2 * scale[0, 0] * scale[1, 1]:
        return None
    time = [float(np.mean(part)) / values.size - 0.5 for part in parts]
    means = [float(np.mean(values[part])) for part in parts]
    line: Any = scipy.stats.linregress(time, means)
    slope, correlation, chance = line.slope, line.rvalue, line.pvalue
    size = float(np.sqrt(np.mean(target[present] ** 2)))
    if chance > LEVEL or correlation**2 < EVEN or abs(slope) < NOTABLE * size:
        return None
    return float(slope * scale[1, 1] / scale[0, 1])

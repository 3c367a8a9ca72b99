"""Whether what an equation leaves grows evenly along a record: an input's sensor that drifts."""

import shlex
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from riecjax.equations.equation import Equation
from riecjax.equations.procedure import Procedure
from riecjax.equations.term import Term
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding
from riecjax.records.record import Record
from riecjax.validation.equation_errors import EquationError, errors_over_records

PARTS = 20
"""Parts of a record whose mean errors are compared."""
EVEN = 0.7
"""Share of the scatter of the parts' means that a straight line explains at least; of 20 means by
chance once in 250,000 records."""
NOTABLE = 0.02
"""Change along the record, over the target's rms, from which it matters."""
MOST_TAKEN = 0.8
"""Part of a drift that regressors take up at most."""
FOLLOWS = 0.999
"""Correlation of an equation's target with its input past which it is that input."""


# Values too large to be squared drift nowhere.
@np.errstate(over="ignore", invalid="ignore")
def drifting_inputs(
    procedure: Procedure,
    records: Sequence[Record],
    errors: Sequence[Sequence[EquationError]],
    estimate: Estimate,
    again: Callable[[list[Record]], Estimate],
) -> Iterator[Finding]:
    """`drifting_signal` of an equation's only input, where a line in time is left.

    Regressors take up a part of a drift, so that less of it is left than there is. Estimates are
    linear in the input: what is left once a first line is taken off tells which part.

    What else changes evenly with time, such as friction of a machine that warms up, looks the same.

    **Arguments:** `errors` of each equation on each record, of which there is to be one; `again`:
    the estimate from other records.
    """
    if len(records) != 1:
        return
    (record,) = records
    time = np.asarray(record.time)
    line = (time - 0.5 * (time[0] + time[-1])) / (time[-1] - time[0])
    for index, (equation, (error,)) in enumerate(zip(procedure.equations, errors, strict=True)):
        inputs = [t.of for t in equation.terms if not t.parameters and isinstance(t, Term)]
        if len(inputs) != 1 or not isinstance(inputs[0], str):
            continue
        name = inputs[0]
        left = _line(error, np.asarray(error.centred(record[name])))
        if left is None or not left.stands_out:
            continue
        less = record.with_signals({name: record[name] - jnp.asarray(left.change * line)})
        other = again([less])
        (still,) = errors_over_records(procedure, [less], other.values)[index]
        rest = _line(still, np.asarray(still.centred(less[name])))
        part = 0.0 if rest is None else float(np.clip(rest.change / left.change, 0.0, MOST_TAKEN))
        moved = {
            n: abs(float(other[n]) / float(estimate[n]) - 1) / (1 - part)
            for n in equation.parameters
            if n in estimate.parameters and float(estimate[n])
        }
        yield _finding(equation, record, name, left.change / (1 - part), moved)


def _finding(
    equation: Equation, record: Record, name: str, change: float, moved: dict[str, float]
) -> Finding:
    time, unit = np.asarray(record.time), dict(record.units).get(name, "")
    rate, middle = change / float(time[-1] - time[0]), 0.5 * (time[0] + time[-1])
    formula = f"{name}-({rate:.6g})*(t-{middle:.15g})"
    remedy = ("--derive", f"{name}={formula}") if name.isidentifier() else ()
    most = max(moved, key=lambda n: moved[n], default="")
    without = f"; without it {most} changes by {100 * moved[most]:.2g} %" if moved else ""
    return Finding(
        "drifting_signal",
        f"what {equation.name} leaves grows evenly with time, as if {name} drifted by "
        f"{f'{change:.3g} {unit}'.rstrip()} along the record{without}. Take it off (on the command "
        f"line: {shlex.join(remedy)}), or look for what else changes with time, such as friction "
        f"of a machine that warms up.",
        (name,),
        equation.parameters,
        doubts=moved,
        remedy=remedy,
        step=f"Take the straight line off {name}",
    )


class _Line(NamedTuple):
    """A line in time that is left, as `change` of the input along the record."""

    change: float
    stands_out: bool


def _line(error: EquationError, signal: np.ndarray) -> _Line | None:
    """The line in what is left; `None` of an equation whose target is more than the input."""
    present, values, target = (np.asarray(v) for v in (error.present, error.error, error.target))
    parts = np.array_split(np.flatnonzero(present), PARTS)
    if present.sum() < 10 * PARTS or not np.ptp(target[present]) > 0:
        return None
    scale = np.cov(target[present], signal[present])
    if not scale[0, 1] ** 2 > FOLLOWS**2 * scale[0, 0] * scale[1, 1]:
        return None
    time = [float(np.mean(part)) / values.size - 0.5 for part in parts]
    scatter = np.cov(time, [float(np.mean(values[part])) for part in parts])
    slope = scatter[0, 1] / scatter[0, 0]
    even = slope * scatter[0, 1] > EVEN * scatter[1, 1]
    size = np.sqrt(np.mean(target[present] ** 2))
    change = float(slope * scale[1, 1] / scale[0, 1])
    return _Line(change, bool(even and abs(slope) > NOTABLE * size))

"""Whether what an equation leaves grows evenly along a record: an input's sensor that drifts.

Whether an input says nothing while the motion moves: a sensor that was not connected.
"""

import shlex
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Float

from riecjax.criteria.windows import AbstractWindows
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding, line_taken_off
from riecjax.records.record import Record
from riecjax.records.signal import noise_level
from riecjax.validation.equation_errors import EquationError, errors_over_records
from riecjax.validation.residuals import window_errors

PARTS = 20
"""Parts of a record whose mean errors are compared."""
EVEN = 0.7
"""Share of the scatter of the parts' means that a straight line explains at least; of 20 means by
chance once in 250,000 records."""
NOTABLE = 0.02
"""Change along the record, over the target's rms, from which it matters."""
MOST_TAKEN = 0.05
"""Part of a drift that regressors leave at the least, for it to be known."""
FOLLOWS = 0.999
"""Correlation of an equation's target with its input past which it is that input."""


# Values too large to be squared drift nowhere.
@np.errstate(over="ignore", invalid="ignore")
def drifting_inputs(
    model: Model,
    records: Sequence[Record],
    errors: Sequence[Sequence[EquationError]],
    estimate: Estimate,
    again: Callable[[list[Record]], Estimate],
) -> Iterator[Finding]:
    """`drifting_signal` of an equation's only input, where a line in time is left.

    Regressors take up a part of a drift, so that less of it is left than there is. Estimates are
    linear in the input: what is left once a known line, or a constant, is taken off tells which.
    A constant term takes up a constant wholly, which is then none of the drift's.

    What else changes evenly with time, such as friction of a machine that warms up, looks the same.

    **Arguments:** `errors` of each equation on each record, of which there is to be one; `again`:
    the estimate from other records.
    """
    if len(records) != 1:
        return
    (record,) = records
    time = np.asarray(record.time)
    line = (time - 0.5 * (time[0] + time[-1])) / (time[-1] - time[0])
    for index, (equation, (error,)) in enumerate(zip(model.equations, errors, strict=True)):
        if (name := _only_input(equation)) is None:
            continue
        left = _left(error, np.asarray(error.centred(record[name])))
        if left is None or not left[1]:
            continue
        # How much less is left of a line and of a constant, for each that is taken off.
        shown, unit, response, others = left[0], abs(left[0][0]), [], []
        for shape in (line, np.ones_like(line)):
            less = record.with_signals({name: record.signal(name) - unit * shape})
            others.append(again([less]))
            (still,) = errors_over_records(model, [less], others[-1].values)[index]
            rest = _left(still, np.asarray(still.centred(less[name])))
            response.append(np.zeros(2) if rest is None else (shown - rest[0]) / unit)
        drift = np.linalg.lstsq(np.transpose(response), shown, MOST_TAKEN)[0]
        moved = {
            n: abs(float(drift @ [float(o[n]) / float(estimate[n]) - 1 for o in others])) / unit
            for n in equation.parameters
            if n in estimate.parameters and float(estimate[n])
        }
        change, offset = drift.tolist()
        unit = record.signal(name).unit
        offset = offset if abs(offset) > 1e-3 * abs(change) else 0.0
        remedy = line_taken_off(name, time, offset, change)
        most = max(moved, key=lambda n: moved[n], default="")
        without = f"; without it {most} changes by {100 * moved[most]:.2g} %" if moved else ""
        yield Finding(
            "drifting_signal",
            f"what {equation.name} leaves grows evenly with time, as if {name} drifted by "
            f"{f'{change:.3g} {unit}'.rstrip()} along the record{without}. Take it off (on the "
            f"command line: {shlex.join(remedy)}), or look for what else changes with time, such "
            f"as friction of a machine that warms up.",
            (name,),
            equation.parameters,
            doubts=moved,
            remedy=remedy,
            step=f"Take the straight line off {name}",
        )


def _only_input(equation: Equation) -> str | None:
    """The signal of an equation's only known term."""
    inputs = [t.signal for t in equation.terms if not t.parameters]
    return inputs[0] if len(inputs) == 1 else None


def _left(error: EquationError, signal: np.ndarray) -> tuple[Float[np.ndarray, "2"], bool] | None:
    """What is left of a line along the record and of a constant, as changes of the input, and
    whether the line stands out; `None` of an equation whose target is more than the input."""
    present, values, target = (np.asarray(v) for v in (error.present, error.error, error.target))
    parts = np.array_split(np.flatnonzero(present), PARTS)
    if present.sum() < 10 * PARTS or not np.ptp(target[present]) > 0:
        return None
    scale = np.cov(target[present], signal[present])
    if not scale[0, 1] ** 2 > FOLLOWS**2 * scale[0, 0] * scale[1, 1]:
        return None
    time = [float(np.mean(part)) / values.size - 0.5 for part in parts]
    means = [float(np.mean(values[part])) for part in parts]
    scatter = np.cov(time, means)
    slope = scatter[0, 1] / scatter[0, 0]
    even = slope * scatter[0, 1] > EVEN * scatter[1, 1]
    size = np.sqrt(np.mean(target[present] ** 2))
    line = np.array([slope, np.mean(means) - slope * np.mean(time)]) * scale[1, 1] / scale[0, 1]
    return line, bool(even and abs(slope) > NOTABLE * size)


NOISE_ALONE = 0.8
"""Share of a signal's deviation past which all of it is noise. A force of white noise is as well,
and drives the motion, which the equation then explains."""
NOTHING_EXPLAINED = 0.8
"""Share of the target, rms over windows, past which no motion answers to it."""


def silent_inputs(
    equations: Sequence[Equation],
    records: Sequence[Record],
    errors: Sequence[Sequence[EquationError]],
    windows: AbstractWindows | None,
) -> Iterator[Finding]:
    """`silent_input` of recorded inputs that are constant or only noise, and that explain nothing.

    **Arguments:** `errors` of each equation on each record.
    """
    for equation, of_records in zip(equations, errors, strict=True):
        if (name := _only_input(equation)) is None:
            continue
        for number, (record, error) in enumerate(zip(records, of_records, strict=True), 1):
            # In words, that a signal says nothing; values too large to be squared are no silence.
            with np.errstate(over="ignore", invalid="ignore"):
                values = record.signal(name).with_nan
                known = values[~np.isnan(values)]
                spread = float(np.std(known))
                said = ""
                if not spread > 1e-12 * float(np.max(np.abs(known))):
                    said = "never varies"
                elif float(noise_level(values)) > NOISE_ALONE * spread:
                    said = "is noise alone"
            if not said:
                continue
            over_windows = None if windows is None else window_errors([error], windows)
            left = error.relative_rms if over_windows is None else over_windows.relative_rms
            if not float(left) > NOTHING_EXPLAINED:
                continue
            where = f" in recording {number}" if len(records) > 1 else ""
            yield Finding(
                "silent_input",
                f"{name} {said}{where}, while the motion of {equation.name} moves: nothing sets "
                f"the scale of {', '.join(equation.parameters)}, which come out next to zero. "
                f"Check the sensor of {name}, its cable and its column.",
                (name,),
                equation.parameters,
                doubt=1.0,
                step=f"Check the sensor of {name}, its cable and its column",
            )

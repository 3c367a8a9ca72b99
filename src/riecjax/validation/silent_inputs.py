"""Whether an input says nothing while the motion moves: a sensor that was not connected."""

from collections.abc import Iterator, Sequence

import numpy as np

from riecjax.criteria.windows import AbstractWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.findings import Finding
from riecjax.records.noise import noise_level
from riecjax.records.record import Record
from riecjax.validation.equation_errors import EquationError
from riecjax.validation.window_errors import window_errors

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
        inputs = [t.of for t in equation.terms if not t.parameters and isinstance(t, Term)]
        if len(inputs) != 1 or not isinstance(inputs[0], str):
            continue
        name = inputs[0]
        for number, (record, error) in enumerate(zip(records, of_records, strict=True), 1):
            said = _silence(record, name)
            if not said or _explained(error, windows):
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


# Values too large to be squared are no silence.
@np.errstate(over="ignore", invalid="ignore")
def _silence(record: Record, name: str) -> str:
    """In words, that a signal says nothing; empty if it says something."""
    values = np.asarray(record[name], float)
    missing = record.missing.get(name)
    present = np.ones(values.size, bool) if missing is None else ~np.asarray(missing)
    spread = float(np.std(values[present]))
    if not spread > 1e-12 * float(np.max(np.abs(values))):
        return "never varies"
    return "is noise alone" if float(noise_level(values, present)) > NOISE_ALONE * spread else ""


def _explained(error: EquationError, windows: AbstractWindows | None) -> bool:
    found = None if windows is None else window_errors([error], windows)
    left = float(error.relative_rms) if found is None else found.relative_rms
    return not left > NOTHING_EXPLAINED

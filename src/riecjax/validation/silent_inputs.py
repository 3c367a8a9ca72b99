"""Whether an input says nothing while the motion moves: a sensor that was not connected."""

from collections.abc import Iterator, Sequence

import numpy as np

from riecjax.criteria.windows import AbstractWindows
from riecjax.equations.equation import Equation
from riecjax.findings import Finding
from riecjax.records.record import Record
from riecjax.records.signal import noise_level
from riecjax.validation.equation_errors import EquationError
from riecjax.validation.residuals import window_errors

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


def _only_input(equation: Equation) -> str | None:
    """The signal of an equation's only known term."""
    inputs = [t.signal for t in equation.terms if not t.parameters]
    return inputs[0] if len(inputs) == 1 else None

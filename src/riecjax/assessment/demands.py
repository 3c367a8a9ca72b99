"""What an answer demands: inputs that say nothing, causes of what is left, and what is assumed."""

from collections.abc import Iterator, Sequence

import numpy as np

from riecjax.criteria.windows import AbstractWindows
from riecjax.doubts.check import Check
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.estimation.estimate import Estimate
from riecjax.findings import FINEST, Finding, in_percent, joined
from riecjax.leaves import size_of
from riecjax.records.record import Record
from riecjax.records.signal import noise_level
from riecjax.validation.equation_errors import EquationError
from riecjax.validation.residuals import window_errors

SPOILT = 0.1
"""Share of a value that a sensor's fault moves it by, from which no equation is asked for more."""
ENOUGH = 12
"""Blocks of time from which nothing that is demanded tells that nothing is."""


def causes_found(
    checked: Check,
    model: Model,
    records: Sequence[Record],
    errors: Sequence[Sequence[EquationError]],
    estimate: Estimate,
) -> tuple[list[Finding], bool]:
    """What explains most of what a model leaves: inputs that say nothing; else faults of sensors,
    and terms that it lacks; and what the course of inputs between samples may do.

    Of signals that contradict each other, or are not what their sensors saw, an equation blames the
    wrong one: then nothing is looked for.

    **Arguments:** what was `checked` before the fit; `errors` of each equation on each record.

    **Returns:** the findings, and whether causes could be weighed.
    """
    # Not earlier: who only checks recordings waits for none of these.
    from riecjax.discovery.candidate import lacked
    from riecjax.doubts.equation_faults import demanded, finding_of, why_not_weighed
    from riecjax.doubts.sampled_inputs import between_samples

    silent = [*silent_inputs(model.equations, records, errors, estimate.criterion.windows)]
    silent = silent or [*reversed_inputs(model.equations, estimate)]
    why = why_not_weighed(model, records, estimate)
    if silent or why:
        return silent or [*not_weighed(estimate, why)], not why
    assumed = between_samples(model, records, estimate)
    if any(
        (finding.about.disorder or finding.about.holds or finding.about.undo)
        and max(finding.doubts.values(), default=finding.doubt) > SPOILT
        for finding in checked.findings
    ):
        return assumed, True
    causes = demanded(model, records, estimate, lacked)
    if not causes and int(estimate.block_count) < ENOUGH:
        assumed += not_weighed(estimate, "from so short a record")
    return [*assumed, *(finding_of(cause, model, records) for cause in causes)], True


def not_weighed(estimate: Estimate, why: str) -> Iterator[Finding]:
    """`not_weighed` of equations that leave more than noise where no cause of that can be told, and
    why.

    What is left is taken to have moved each parameter by as much of it as it is of the term: all
    of what is left may have been of the term's own shape.
    """
    for stage, names in zip(estimate.stages, estimate.equation_names):
        sizes = dict(zip(stage.parameters, np.asarray(stage.relative_size, float)))
        for equation, fit in zip(names, stage.equations):
            left = float(fit.model_rms)
            doubts = {
                name: min(left / size_of(sizes[name] * float(estimate[name])), 1.0)
                for name in fit.parameters
            }
            if left > FINEST and doubts:
                yield Finding(
                    "not_weighed",
                    f"{equation}: the model leaves {in_percent(left)} of what it was to explain "
                    f"beyond noise. What that is cannot be told {why}.",
                    parameters=fit.parameters,
                    doubts=doubts,
                )


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
    """`silent_input` of recorded inputs that are constant or only noise, and that explain nothing
    by the `errors` of each equation on each record."""
    for equation, of_records in zip(equations, errors, strict=True):
        if (name := _only_input(equation)) is None:
            continue
        for number, (record, error) in enumerate(zip(records, of_records, strict=True), 1):
            # In words, that a signal says nothing; values too large to be squared are no silence.
            with np.errstate(over="ignore", invalid="ignore"):
                values = record.signal(name).with_nan
                known = values[~np.isnan(values)]
                spread = float(np.std(known))
                varies = spread > 1e-12 * float(np.max(np.abs(known)))
                if varies and not float(noise_level(values)) > NOISE_ALONE * spread:
                    continue
            said = "is noise alone" if varies else "never varies"
            left = (windows and window_errors([error], windows)) or error
            if not float(left.relative_rms) > NOTHING_EXPLAINED:
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


def reversed_inputs(equations: Sequence[Equation], estimate: Estimate) -> Iterator[Finding]:
    """`reversed_input` of equations in which all masses and dampers are surely below zero."""
    below = dict(zip(estimate.parameters, np.asarray(estimate.below_zero).tolist()))
    for equation in equations:
        names = [name for name in equation.parameters if name in below]
        signed = [name for name in names if estimate.table[name].sign]
        if (name := _only_input(equation)) and signed and all(below[one] for one in signed):
            yield Finding(
                "reversed_input",
                f"{equation.name}: {joined(signed)} come out below zero, as where {name} points "
                f"the other way: then all parameters have the opposite sign. Turn it (on the "
                f"command line: --scale {name}=-1), or check the direction of the motion.",
                (name,),
                tuple(names),
                # From one sign to the other.
                doubt=2.0,
                remedy=("--scale", f"{name}=-1"),
                step=f"Turn the sign of {name}",
            )


def _only_input(equation: Equation) -> str | None:
    """The signal of an equation's only known term."""
    inputs = [t.signal for t in equation.terms if not t.parameters]
    return inputs[0] if len(inputs) == 1 else None

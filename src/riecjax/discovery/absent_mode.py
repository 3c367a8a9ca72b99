"""A hidden mode that is missing, and no term.

An oscillator on a body rings in the body's equation. Terms of its velocity and position explain a
part of that, one more for each thing that it does, and are no forces of the machine. Its three
coefficients do not stand in the sums of candidates: [`identify`][riecjax.identify] finds them, and
what both leave beyond noise says which it is.
"""

from collections.abc import Callable
from dataclasses import replace

from riecjax.discovery.discovery import Discovery
from riecjax.discovery.search import Step
from riecjax.equations.hidden_modes import (
    HiddenMode,
    ModeParameters,
    accelerated,
    mode_frequency,
)
from riecjax.equations.procedure import told_apart
from riecjax.errors import RiecjaxError
from riecjax.estimation.estimate import EquationFit, Estimate
from riecjax.models.model import Model

LEAVES = 0.3
"""Of the error beyond noise that terms leave, rms, what a mode leaves at most that is missing
instead: a tenth of the energy."""

Identified = Callable[[Model], Estimate]


def with_mode(found: Discovery, identified: Identified) -> Discovery:
    """The same, or where a hidden mode explains much more than the terms, with it instead.

    **Arguments:** `identified`, of a model its estimate from what values are from.
    """
    equations = found.start.build_procedure().equations
    names = told_apart([equation.name for equation in equations])
    bodies = {name: accelerated(one) for name, one in zip(names, equations, strict=True)}
    fits = found.estimate.equations
    for name in sorted((n for n in names if bodies[n]), key=lambda n: -float(fits[n].model_rms)):
        most = LEAVES * float(fits[name].model_rms)
        for on in reversed(bodies[name]):
            model = found.start.with_modes(HiddenMode(on))
            try:
                estimate = identified(model)
            except RiecjaxError:  # no mode is to be found on this body
                continue
            if float(estimate.equations[name].model_rms) < most:
                before = identified(found.start).equations[name]
                return _instead(found, on, model, estimate, (name, before))
    return found


def _instead(
    found: Discovery, on: str, model: Model, estimate: Estimate, before: tuple[str, EquationFit]
) -> Discovery:
    name, own = before
    frequency, _ = mode_frequency(estimate.values, ModeParameters.of(len(found.start.modes)))
    stage = next((key for key in found.paths if name in key.split(" + ")), name)
    steps = (_step("", own), _step("mode", estimate.equations[name]))
    return replace(
        found,
        model=model,
        chosen=(),
        rejected=(),
        mode=HiddenMode(on, float(f"{float(frequency):.4g}")),
        paths={stage: steps},
        estimate=estimate,
        errors=dict(zip(estimate.parameters, map(float, estimate.standard_errors), strict=True)),
    )


def _step(added: str, fit: EquationFit) -> Step:
    """What a fit leaves, of all that it was fitted to."""
    whole, of_motion = (float(of) ** 2 for of in (fit.relative_rms, fit.model_rms))
    return Step(added, whole, of_motion, float("nan"), float("nan"))

"""A hidden mode that is missing, instead of terms or beside them.

An oscillator on a body rings in the body's equation. Terms of its velocity and position explain a
part of that, one more for each thing that it does, and are no forces of the machine. Its three
coefficients do not stand in the sums of candidates: [`identify`][riecjax.identify] finds them, and
what both leave beyond noise says which it is.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from riecjax.discovery.discovery import Chosen, Discovery, is_more_than_noise
from riecjax.discovery.search import Step
from riecjax.equations.hidden_elements import (
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
"""Of the error beyond noise that terms leave, rms, what is left with a mode at most that is
missing: a tenth of the energy."""
TOLD = 3.0
"""Standard errors from zero of a term that stays beside a mode; without the mode it may have stood
for it."""

Identified = Callable[[Model], Estimate]
WithTerms = Callable[[Sequence[Chosen]], Model]


def with_mode(
    found: Discovery, identified: Identified, by_blocks: Identified, with_terms: WithTerms
) -> Discovery:
    """The same, or where much less is left with a hidden mode, with it: instead of all terms, or
    beside those that are still told from zero.

    **Arguments:** `identified`, of a model its estimate from what values are from; `by_blocks`, the
    same with standard errors by blocks of time, whatever intervals were asked for; `with_terms`,
    the model that was given with some of what was chosen.
    """
    equations = found.start.build_procedure().equations
    names = told_apart([equation.name for equation in equations])
    bodies = {name: accelerated(one) for name, one in zip(names, equations, strict=True)}
    fits, both = found.estimate.equations, (identified, by_blocks)
    for name in sorted((n for n in names if bodies[n]), key=lambda n: -float(fits[n].model_rms)):
        most = LEAVES * float(fits[name].model_rms)
        for on in reversed(bodies[name]):
            try:
                chosen, estimate = _beside(found, on, name, both, with_terms)
            except RiecjaxError:  # no mode is to be found on this body
                continue
            if float(estimate.equations[name].model_rms) < most:
                start = identified(found.start) if found.chosen else found.estimate
                own = start.equations[name]
                return _with(found, on, with_terms(chosen), estimate, chosen, (name, own))
    return found


def _beside(
    found: Discovery,
    on: str,
    name: str,
    by: tuple[Identified, Identified],
    with_terms: WithTerms,
) -> tuple[tuple[Chosen, ...], Estimate]:
    """Terms that stay beside a mode, and the estimate with both."""
    identified, by_blocks = by

    def of(chosen: Sequence[Chosen], by: Identified = identified) -> Estimate:
        return by(with_terms(chosen).with_modes(HiddenMode(on)))

    alone = of(())
    left = _step("mode", alone.equations[name])
    if not found.chosen or not is_more_than_noise(left):
        return (), alone
    both = of(found.chosen, by_blocks)
    errors = dict(zip(both.parameters, map(float, both.standard_errors), strict=True))
    stay = tuple(
        one
        for one in found.chosen
        if any(abs(float(both[n])) > TOLD * errors[n] for n in one.candidate.columns)
    )
    if len(stay) < len(found.chosen) or by_blocks is not identified:
        both = of(stay) if stay else alone
    less = _step("mode", both.equations[name]).of_motion < 0.5 * left.of_motion
    return (stay, both) if less else ((), alone)


def _with(
    found: Discovery,
    on: str,
    model: Model,
    estimate: Estimate,
    chosen: tuple[Chosen, ...],
    before: tuple[str, EquationFit],
) -> Discovery:
    name, own = before
    frequency, _ = mode_frequency(estimate.values, ModeParameters.of(len(found.start.modes)))
    stage = next((key for key in found.paths if name in key.split(" + ")), name)
    terms = " + ".join(one.candidate.name for one in chosen)
    beside = [_step(terms, found.estimate.equations[name])] if chosen else []
    steps = (_step("", own), *beside, _step("mode", estimate.equations[name]))
    mode = HiddenMode(on, float(f"{float(frequency):.4g}"))
    return replace(
        found,
        model=model.with_modes(mode),
        chosen=chosen,
        rejected=(),
        mode=mode,
        paths={stage: steps},
        estimate=estimate,
        errors=dict(zip(estimate.parameters, map(float, estimate.standard_errors), strict=True)),
    )


def _step(added: str, fit: EquationFit) -> Step:
    """What a fit leaves, of all that it was fitted to."""
    whole, of_motion = (float(of) ** 2 for of in (fit.relative_rms, fit.model_rms))
    return Step(added, whole, of_motion, float("nan"), float("nan"))

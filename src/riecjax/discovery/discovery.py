"""What a search for further terms found.

A further hidden mode, instead of terms or beside them.

An oscillator on a body rings in the body's equation. Terms of its velocity and position explain a
part of that, one more for each thing that it does, and are no forces of the machine. Its three
coefficients do not stand in the sums of candidates: [`identify`][riecjax.identify] finds them, and
what both leave beyond noise says which it is.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from riecjax.discovery.candidate import Candidate
from riecjax.discovery.search import Step
from riecjax.equations.hidden_elements import (
    HiddenMode,
    ModeParameters,
    accelerated,
    mode_frequency,
)
from riecjax.equations.model import Model
from riecjax.errors import RiecjaxError
from riecjax.estimation.estimate import EquationFit, Estimate
from riecjax.findings import Finding
from riecjax.shows import Shown

ELSE = 1e-4
"""Share of the energy, 1 % of the size, that is unexplained and no noise, to be told."""


def is_more_than_noise(step: Step) -> bool:
    """Whether noise makes less than half of what a step leaves, and the rest is worth telling."""
    return step.of_motion > max(0.5 * step.unexplained, ELSE)


class Rejected(NamedTuple):
    """A candidate that was not taken: share of what is unexplained that it would gain, and the
    chance that one which explains nothing stands out as much, any one of those offered."""

    name: str
    gain: float
    chance: float


class Chosen(NamedTuple):
    """A candidate that was taken.

    **Fields:** `candidate`; `width` of its law in `width_unit`, `None` of one without, and its
    standard error `width_error`, nan where that is not known; `share` of the searches of data drawn
    again that took it too.
    """

    candidate: Candidate
    width: float | None
    width_unit: str
    width_error: float
    share: float


@dataclass(frozen=True, eq=False, repr=False)
class Discovery(Shown):
    """A model with the terms that it lacked; made by [`discover`][].

    **Fields:**

    - `model`, with what was chosen; `start`, the model that was given.
    - `chosen`, and `rejected`, those nearest to it.
    - `paths` of the stages that terms were offered to: what blocks of time that were left out of
      the fit leave unexplained, with one term more on each line.
    - `estimate` of the model; `errors`, standard errors that include the choice of terms.
    - `held_out`: share of each recording that had no part in the choice and that `estimate` is
      from; 0 where choice and estimate are of all.
    - `offered`: how many candidates could be told apart.
    - `findings`: what is amiss with the recordings, also signals that are late against the
      equations that were found.
    - `delays`, seconds by which such signals were advanced before terms were chosen.
    - `mode`: a further hidden mode, where much less is left with it; `chosen` are then
      those terms that were found without it and are told from zero beside it.
    """

    model: Model
    start: Model
    chosen: tuple[Chosen, ...]
    rejected: tuple[Rejected, ...]
    paths: Mapping[str, tuple[Step, ...]]
    estimate: Estimate
    errors: Mapping[str, float]
    held_out: float
    offered: int
    findings: tuple[Finding, ...] = ()
    delays: Mapping[str, float] = field(default_factory=dict)
    mode: HiddenMode | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what was found: `delay` (of several signals `delay_u`), `mode`, and terms."""
        late = ["delay"] if len(self.delays) == 1 else [f"delay_{name}" for name in self.delays]
        hidden = [] if self.mode is None else ["mode"]
        return (*late, *hidden, *(one.candidate.name for one in self.chosen))

    @property
    def leaves_more(self) -> bool:
        """Whether most of what is left is no noise, so that a model lacks something else."""
        return any(is_more_than_noise(steps[-1]) for steps in self.paths.values())

    @property
    def amiss(self) -> tuple[Finding, ...]:
        """Findings but the delays that were taken off."""
        return tuple(
            f
            for f in self.findings
            if not (f.code == "late_signal" and {*f.signals} <= {*self.delays})
        )


LEAVES = 0.3
"""Of the error beyond noise that terms leave, rms, what is left with a mode at most that is
added: a tenth of the energy."""
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
    model = found.start
    stages = {name: " + ".join(names) for names in model.equation_names for name in names}
    bodies = {n: accelerated(one) for n, one in zip(stages, model.equations, strict=True)}
    fits, both = found.estimate.equations, (identified, by_blocks)
    for name in sorted((n for n in stages if bodies[n]), key=lambda n: -float(fits[n].model_rms)):
        most = LEAVES * float(fits[name].model_rms)
        for on in reversed(bodies[name]):
            try:
                chosen, estimate = _beside(found, on, name, both, with_terms)
            except RiecjaxError:  # no mode is to be found on this body
                continue
            if float(estimate.equations[name].model_rms) < most:
                start = identified(found.start) if found.chosen else found.estimate
                number = ModeParameters.of(len(found.start.modes))
                frequency, _ = mode_frequency(estimate.values, number)
                stage = stages[name] if stages[name] in found.paths else name
                terms = " + ".join(one.candidate.name for one in chosen)
                beside = [_step(terms, fits[name])] if chosen else []
                last = _step("mode", estimate.equations[name])
                mode = HiddenMode(on, float(f"{float(frequency):.4g}"))
                errors = map(float, estimate.standard_errors)
                return replace(
                    found,
                    model=with_terms(chosen).with_modes(mode),
                    chosen=chosen,
                    rejected=(),
                    mode=mode,
                    paths={stage: (_step("", start.equations[name]), *beside, last)},
                    estimate=estimate,
                    errors=dict(zip(estimate.parameters, errors, strict=True)),
                )
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


def _step(added: str, fit: EquationFit) -> Step:
    """What a fit leaves, of all that it was fitted to."""
    whole, of_motion = (float(of) ** 2 for of in (fit.relative_rms, fit.model_rms))
    return Step(added, whole, of_motion, float("nan"), float("nan"))

"""What a search for further terms found."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from riecjax.discovery.candidate import Candidate
from riecjax.discovery.search import Rejected, Step
from riecjax.equations.hidden_elements import HiddenMode
from riecjax.equations.model import Model
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding
from riecjax.shows import Shown

ELSE = 1e-4
"""Share of the energy, 1 % of the size, that is unexplained and no noise, to be told."""


def is_more_than_noise(step: Step) -> bool:
    """Whether noise makes less than half of what a step leaves, and the rest is worth telling."""
    return step.of_motion > max(0.5 * step.unexplained, ELSE)


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
    def of_motion(self) -> float:
        """What is unexplained of all equations, noise not counted."""
        return sum(steps[-1].of_motion for steps in self.paths.values())

    @property
    def amiss(self) -> tuple[Finding, ...]:
        """Findings but the delays that were taken off."""
        return tuple(
            f
            for f in self.findings
            if not (f.code == "late_signal" and {*f.signals} <= {*self.delays})
        )

"""Refinement in an assessment: the one that is asked for, or by default the one that is warranted.

**By default** (`refine="auto"`) output error is tried from the linear estimate, and its answer is
taken only where what it leaves is white noise. There it has the least variance that any estimate
can have. Elsewhere the model leaves out something, which output error makes up for by bending the
parameters, and integrals over windows forgive: the linear estimate stays the answer.
"""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Array

from riecjax.errors import RiecjaxError
from riecjax.estimation.estimate import (
    Estimate,
    intervals_entry,
    parameter_entries,
)
from riecjax.estimation.parameters import values_in_recording
from riecjax.findings import Finding, in_percent
from riecjax.leaves import told
from riecjax.records.noise_judgement import ABOVE_NOISE

# What simulates and refines takes as long to import as a linear answer does: where it is asked for.
if TYPE_CHECKING:
    from riecjax.equations.model import Model
    from riecjax.records.record import Record
    from riecjax.records.recording import Recording
    from riecjax.refinement.objective import AbstractObjective
    from riecjax.settings import Assess
    from riecjax.simulation.system import AbstractSystem
    from riecjax.validation.held_out import HeldOut
    from riecjax.validation.whiteness import Whiteness

LEFT_OUT = 0.05
"""Share of an equation's target that is left, from which no simulation will leave white noise."""
WORSE = 1.0
"""Percent of fit by which a refined model may predict worse what it was not fitted to."""
ASK = "ask for it by refine=rx.OutputError(), on the command line --refine output-error"


class Track(NamedTuple):
    """A recording to simulate along.

    **Fields:** `number` of the recording whose own parameters it takes, if it has some; `horizon`,
    seconds after which simulations start anew, `None` for none.
    """

    recording: "Recording"
    number: int | None = None
    horizon: float | None = None

    def system(self, model: "Model", values: Mapping[str, Array]) -> "AbstractSystem":
        """The model with these values along it."""
        names, number = model.parameter_names, self.number
        own = values if number is None else values_in_recording(names, values, number)
        return model.identified_system({name: own[name] for name in names}, self.recording.record)

    def within(self, given: float | None, model: "Model", values: Mapping[str, Array]) -> "Track":
        """With the horizon given, or where the motion is unstable that in which differences grow by
        e^2.5."""
        from riecjax.simulation.linearisation import growth_horizon

        # What cannot be simulated is said where it is.
        with contextlib.suppress(RiecjaxError):
            given = given or growth_horizon(self.system(model, values), self.recording.record)
        return self._replace(horizon=given)


class Problem(NamedTuple):
    """What is identified: a model, from `fitted` recordings.

    **Fields:** `unseen`, what it is not fitted to, to validate on; `settings`, what else was said.
    """

    model: "Model"
    fitted: "list[Recording]"
    unseen: list[Track]
    settings: "Assess"

    @property
    def records(self) -> "list[Record]":
        """The records to estimate from."""
        return [recording.record for recording in self.fitted]

    @property
    def seen(self) -> list[Track]:
        """What the model is fitted to."""
        return [Track(recording, number) for number, recording in enumerate(self.fitted)]


class ValidationRun(NamedTuple):
    """A simulation along a recording, compared with it in `held`; that with the start of a
    refinement, of one with its result, in `before`."""

    recording: "Recording"
    held: "HeldOut"
    before: "HeldOut" = None  # pyright: ignore[reportAssignmentType]


class Validations(NamedTuple):
    """Simulations with the values of an answer along what it was not fitted to.

    **Fields:** `runs` that could be made; `failures`, why others could not.
    """

    runs: Sequence[ValidationRun]
    failures: Sequence[Finding] = ()
    name = "validation"

    def findings(self) -> list[Finding]:
        """`does_not_predict`, of each recording that is not predicted."""
        return [
            Finding("does_not_predict", f"{run.recording.name}: {run.held.verdict}")
            for run in self.runs
            if not run.held.predicts
        ]

    def entry(self) -> list[dict[str, Any]]:
        """Of each recording how well it is predicted, as plain data for JSON."""
        return [{"on": run.recording.name, **run.held.entry()} for run in self.runs]

    def after(self, start: "Validations") -> list[ValidationRun]:
        """The runs beside those with the start of a refinement, where both could be made."""
        # By recording, not by name: files in different folders may share one.
        before = {run.recording: run.held for run in start.runs}
        runs = (run._replace(before=before.get(run.recording)) for run in self.runs)
        return [run for run in runs if run.before is not None]


class Refinement(NamedTuple):
    """A refinement, whether its values are the answer, and what it did to predictions.

    **Fields:**

    - `start`, the linear estimate.
    - `refined`; `None` where `refine="auto"` found nothing that could be one.
    - `declined`: why its values are not the answer, of `refine="auto"`; empty where they are.
    - `whiteness` of what is left, of output error.
    - `by`, the objective of which it is the optimum.
    - `simulations`, before and after, on held-out parts and further recordings, or if there are
      none, and the refinement was asked for, on those that were fitted (`on_fitted`).
    """

    start: Estimate
    refined: Estimate = None  # pyright: ignore[reportAssignmentType]
    declined: str = ""
    whiteness: "Whiteness | None" = None
    simulations: Sequence[ValidationRun] = ()
    on_fitted: bool = False
    by: "AbstractObjective | None" = None
    name = "refinement"

    @property
    def answer(self) -> Estimate | None:
        """The refined values, where they are the answer."""
        return None if self.declined else self.refined

    @property
    def chosen(self) -> bool:
        """Whether the refined values are the answer."""
        return self.answer is not None

    def findings(self) -> list[Finding]:
        """What a user should know of refined values that are the answer."""
        findings = [] if self.answer is None else self.answer.findings()
        for name, before, after in self.worse() if self.chosen else ():
            message = (
                f"{name}: the refined model predicts worse than the identified one (worst fit "
                f"{before:.1f} % before, {after:.1f} % after): it was bent to the recording that "
                f"it was fitted to. Use shorter windows (--horizon), or keep the estimate."
            )
            findings.append(Finding("refined_predicts_worse", message))
        return findings

    def worse(self) -> list[tuple[str, float, float]]:
        """Recordings that it was not fitted to and predicts worse, with the worst fits of any
        signal before and after."""
        runs = () if self.on_fitted else self.simulations
        fits = [(run.recording.name, run.before.worst_fit, run.held.worst_fit) for run in runs]
        return [(name, before, after) for name, before, after in fits if after < before - WORSE]

    def entry(self) -> dict[str, Any]:
        """All of it, as plain data for JSON; of a search only where there was one."""
        refined, left, search = self.refined, self.whiteness, {}
        if refined is not None:
            done = refined.search
            rms = done.quantities, done.rms_before, done.rms, done.quantity_units
            search = {
                "by": dict(done.by),
                **told(done, "converged", "reason", "steps", "basis"),
                "left": {
                    name: {"before": before, "after": after, "unit": unit}
                    for name, before, after, unit in zip(*rms)
                },
                "intervals": intervals_entry(refined),
                "at_bound": [n for n, there in zip(refined.parameters, refined.at_bound) if there],
            }
        return {
            "chosen": self.chosen,
            "declined": self.declined or None,
            "chi_squared": left and max(each.chi_squared for each in left.channels.values()),
            "whiteness": left and left.entry(),
            "identified": parameter_entries(self.start),
            "refined": None if refined is None else parameter_entries(refined),
            **search,
            "simulations": [
                {
                    "on": run.recording.name,
                    "fitted": self.on_fitted,
                    "before": run.before.entry(),
                    "after": run.held.entry(),
                }
                for run in self.simulations
            ],
        }


def unwarranted(estimate: Estimate) -> str:
    """Why a search by output error is not worth its time; empty where it may be.

    It is where equations leave little but noise.
    """
    for name, fit in estimate.equations.items():
        left, noise = float(fit.model_rms), float(fit.noise_rms)
        if left > max(LEFT_OUT, ABOVE_NOISE * noise):
            return (
                f"{name} leaves {in_percent(left)} of its target and noise {100 * noise:.2g} "
                f"%, so that values would bend to make up for what the model leaves out; {ASK}"
            )
    return ""


def validated(model: "Model", values: Mapping[str, Array], tracks: Sequence[Track]) -> Validations:
    """Simulations with these values that could be made, and why the others could not."""
    if not tracks:
        return Validations([])
    from riecjax.validation.held_out import validate_held_out

    runs, failures = [], []
    for track in tracks:
        # A fit is not lost because its model cannot be simulated.
        try:
            system, record = track.system(model, values), track.recording.record
            held = validate_held_out(system, record, horizon=track.horizon)
            runs.append(ValidationRun(track.recording, held))
        except RiecjaxError as error:
            failures.append(Finding("not_validated", f"{track.recording.name}: {error}"))
    return Validations(runs, failures)


STRANGE = 3.0
"""Standard deviations past which a prior contradicts the data: one time in 370 by chance."""
TELLING = 1e-11
"""Share that is rounding: of what is known of a parameter, or of a target."""


def against_priors(
    estimate: Estimate, priors: Mapping[str, tuple[float, float]]
) -> Iterator[Finding]:
    """Priors from which what is told without them lies further than chance explains.

    An estimate is the mean of both, weighted by the prior's share of what is known.
    """
    shares = estimate.uncertainty.prior_share
    shares = np.zeros(len(estimate.parameters)) if shares is None else np.asarray(shares)
    given = estimate.table.values(priors)
    for name, share in zip(estimate.parameters, shares):
        if name not in given or not (rest := 1 - float(share)) > TELLING:
            continue
        mean, std = given[name]
        value = mean + (float(estimate[name]) - mean) / rest
        variance = float(estimate.standard_error(name)) ** 2 - (share * std) ** 2
        error = max(variance, 0.0) ** 0.5 / rest
        if abs(value - mean) > STRANGE * np.hypot(std, error):
            message = (
                f"the prior of {name}, {mean:.4g} +- {std:.2g}, and the estimate without it, "
                f"{value:.4g} +- {error:.2g}, contradict each other: what was answered lies "
                f"between two values of which one is wrong."
            )
            yield Finding("prior_disagrees", message, parameters=(name,), doubt=1.0)

"""Refinement in an assessment: the one that is asked for, or by default the one that is warranted.

**By default** (`refine="auto"`) output error is tried from the linear estimate, and its answer is
taken only where what it leaves is white noise. There it has the least variance that any estimate
can have. Elsewhere the model leaves out something, which output error makes up for by bending the
parameters, and integrals over windows forgive: the linear estimate stays the answer.
"""

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from riecjax.equations.equation_system import EquationSystem
from riecjax.errors import DataError, RiecjaxError
from riecjax.estimation.estimate import (
    Estimate,
    intervals_entry,
    parameter_entries,
)
from riecjax.estimation.parameters import values_in_recording
from riecjax.findings import Finding
from riecjax.leaves import on_host, told
from riecjax.records.faults.derivative_pairs import is_motion
from riecjax.refinement.integral_error import IntegralError
from riecjax.refinement.objective import AbstractObjective, as_parametric_system
from riecjax.refinement.output_error import (
    OutputError,
    Tiles,
    WholeRecord,
    noise_levels,
)
from riecjax.refinement.refine import refined
from riecjax.simulation.linearisation import growth_horizon, spread_points
from riecjax.simulation.system import (
    AbstractSystem,
    compared_signals,
    input_levels,
    measured_states,
)
from riecjax.uncertainty.intervals import intervals_of
from riecjax.validation.held_out import HeldOut, validate_held_out
from riecjax.validation.whiteness import Whiteness, whiteness

if TYPE_CHECKING:
    from riecjax.equations.model import Model
    from riecjax.records.record import Record
    from riecjax.records.recording import Recording
    from riecjax.settings import Assess, Refine
    from riecjax.simulation.intersample import Course

MOST_STEPS = 200
"""Steps that a refinement may take."""
STEPS_BY_ITSELF = 60
"""Steps that one may take which nobody asked for; right models need about ten."""
MOST_WORK = 10_000_000
"""Steps x states x tangents of an expansion up to which nobody has to ask for a refinement.

Of ten operations for each state's derivative, as built-in models have (6 to 17), a search of twelve
expansions takes ten seconds.
"""
SMALL_SHARE = 1e-2
"""Share of its signal below which a residual need not be the model's."""
LEAST_NOISE = 1e-4
"""Noise, as a share of its signal, that a channel is weighed by at the least."""
LEFT_OUT = 0.05
"""Share of an equation's target that is left, from which no simulation will leave white noise."""
ABOVE_NOISE = 3.0
"""Times what the sensors' noise makes of it, from which what is left is the model's."""
WORSE = 1.0
"""Percent of fit by which a refined model may predict worse what it was not fitted to."""
ASK = "ask for it by refine=rx.OutputError(), on the command line --refine output-error"
EXPECTED = (RiecjaxError, TypeError, ValueError, IndexError)
"""What a model raises that can be identified and not simulated: the last three, expressions that
JAX cannot differentiate."""


class Track(NamedTuple):
    """A recording to simulate along.

    **Fields:** `number` of the recording whose own parameters it takes, if it has some; `horizon`,
    seconds after which simulations start anew, `None` for none.
    """

    recording: "Recording"
    number: int | None = None
    horizon: float | None = None

    def system(self, model: "Model", values: Mapping[str, Array]) -> AbstractSystem:
        """The model with these values along it."""
        names, number = model.parameter_names, self.number
        own = values if number is None else values_in_recording(names, values, number)
        return model.identified_system({name: own[name] for name in names}, self.recording.record)

    def within(self, given: float | None, model: "Model", values: Mapping[str, Array]) -> "Track":
        """With the horizon given, or where the motion is unstable that in which differences grow by
        e^2.5."""
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
    held: HeldOut
    before: HeldOut = None  # pyright: ignore[reportAssignmentType]


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
    - `simulations`, before and after, on held-out parts and further recordings, or if there are
      none, and the refinement was asked for, on those that were fitted (`on_fitted`).
    """

    start: Estimate
    refined: Estimate = None  # pyright: ignore[reportAssignmentType]
    declined: str = ""
    whiteness: Whiteness | None = None
    simulations: Sequence[ValidationRun] = ()
    on_fitted: bool = False
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
            "chi_squared": left and max(left.chi_squared.values(), default=None),
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


class Declined(Exception):
    """Why a refinement that nobody asked for is not the answer."""


def answered(
    problem: Problem, estimate: Estimate, refused: bool
) -> tuple[Refinement | None, Validations]:
    """The refinement of an estimate, which may be no more than a start (it was `refused`), if there
    is one, and the validation of what answers.

    **Raises:** as `refine`, for a refinement that was asked for.
    """
    model, settings, start = problem.model, problem.settings, estimate.values
    by = objective_of(settings)
    asked = not isinstance(by, str | None)
    horizon = None if asked else settings.horizon
    tracks = [track.within(horizon, model, start) for track in problem.unseen]
    before = validated(model, start, tracks)
    if by is None:
        return None, before
    if asked:
        # Over the estimate's windows if no others are asked for; its values are the answer.
        if isinstance(by, IntegralError) and by.criterion is None:
            by = IntegralError(estimate.criterion)
        refinement = _search(problem, estimate, by.suited(model), asked)
    else:
        refinement = _by_itself(problem, estimate, refused)
    if refinement.refined is None:
        return refinement, before
    values = refinement.refined.values
    after = validated(model, values, tracks)
    refinement = refinement._replace(start=estimate, simulations=after.after(before))
    if asked and not tracks:
        seen = [track.within(None, model, start) for track in problem.seen]
        on_fitted = validated(model, values, seen).after(validated(model, start, seen))
        refinement = refinement._replace(on_fitted=True, simulations=on_fitted)
    elif not asked and refinement.chosen and (worse := refinement.worse()):
        # By itself not where it predicts worse what neither answer was fitted to.
        name, earlier, later = worse[0]
        why = f"it predicts {name} worse: a fit of {later:.1f} %, where the linear estimate has"
        refinement = refinement._replace(declined=f"{why} {earlier:.1f} %")
    return refinement, after if refinement.chosen else before


def validated(model: "Model", values: Mapping[str, Array], tracks: Sequence[Track]) -> Validations:
    """Simulations with these values that could be made, and why the others could not."""
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


def objective_of(settings: "Refine") -> AbstractObjective | Literal["auto"] | None:
    """What a refinement makes small; `None` for no refinement."""
    if settings.refine in (None, "none"):
        return None
    if settings.refine == "integral":
        return IntegralError()
    if settings.refine == "output-error":
        shooting = Tiles(seconds=settings.horizon) if settings.horizon else WholeRecord()
        return OutputError(shooting, channels=tuple(settings.channels) or None, loss=settings.loss)
    return settings.refine  # type: ignore[return-value]


def _search(
    problem: Problem, estimate: Estimate, by: AbstractObjective, asked: bool = False
) -> Refinement:
    """A refinement from an estimate, and of output error whether it leaves white noise.

    One that nobody asked for tells nothing of its `progress`: it takes few seconds, and a program
    that calls Python back cannot be kept for the next time.

    **Raises:** `Declined` for one that nobody asked for and that takes long.
    """
    settings, records = problem.settings, problem.records
    residuals = by.residuals(problem.model, records, estimate, key=settings.key)
    if not asked and residuals.work > MOST_WORK:
        raise Declined(
            f"a search would take {residuals.work:.2g} steps x states x tangents, more than "
            f"{MOST_WORK:.0g}; {ASK}"
        )
    given = residuals, settings.bounds, settings.priors, intervals_of(settings.intervals)
    limits = (MOST_STEPS, settings.progress) if asked else (STEPS_BY_ITSELF, None)
    found = on_host(refined(by, *given, None, *limits))
    return Refinement(estimate, found, whiteness=whiteness(found, records))


def _by_itself(problem: Problem, estimate: Estimate, refused: bool) -> Refinement:
    """By output error where that is possible, quick and warranted."""
    horizon = problem.settings.horizon
    try:
        # A search is worth its time where equations leave little but noise.
        for name, fit in {} if refused else estimate.equations.items():
            left, noise = float(fit.model_rms), float(fit.noise_rms)
            if left > max(LEFT_OUT, ABOVE_NOISE * noise):
                raise Declined(
                    f"{name} leaves {100 * left:.2g} % of its target and noise {100 * noise:.2g} "
                    f"%, so that values would bend to make up for what the model leaves out; {ASK}"
                )
        if not np.all(np.isfinite(np.asarray(estimate.theta))):
            raise Declined("the estimate that it would start from is not finite")
        by = _objective(problem, estimate, horizon)
        refinement = _warranted(problem, estimate, by)
        if horizon is None and isinstance(by.shooting, Tiles):
            # A poor start may be unstable where the motion is not.
            better = _objective(problem, refinement.refined, None)
            if better.shooting != by.shooting:
                with contextlib.suppress(Declined):
                    refinement = _warranted(problem, refinement.refined, better)
        return refinement
    except Declined as why:
        return Refinement(estimate, declined=str(why))
    except EXPECTED as error:
        why = f"no output error can be formed: {str(error).rstrip('.')}"
        return Refinement(estimate, declined=why)


def _warranted(problem: Problem, estimate: Estimate, by: OutputError) -> Refinement:
    found = _search(problem, estimate, by)
    if flaw := _flaw(found.refined):
        raise Declined(flaw)
    left = found.whiteness
    if left is None or not (left.vanishing or left.largest == left.largest):
        raise Declined("too few residuals to tell whether they are white")
    straight = {} if left.vanishing else straight_inputs(problem, estimate)
    lines = dataclasses.replace(by, intersample=straight)
    if straight and course_shows(problem, found.refined, lines):
        other = _search(problem, estimate, lines)
        likelier = surely_likelier(other.refined, found.refined)
        if other.whiteness and not _flaw(other.refined) and likelier:
            found, left = other, other.whiteness
    if left.white:
        return found
    name = max(left.statistics, key=lambda channel: left.statistics[channel])
    cause = (
        "so little is left by the input's noise or its course between samples, too"
        if max(left.shares.values()) < SMALL_SHARE
        else "so the model leaves out part of the motion, the noise is coloured, or a recorded "
        "input is noisy"
    )
    return found._replace(
        declined=f"what it leaves of {name}, {100 * left.shares[name]:.2g} % of it, is not white "
        f"noise ({left.largest:.3g}, where noise stays below {left.threshold:.2g}), {cause}"
    )


def _flaw(refined: Estimate) -> str:
    """Why a refinement is no answer, whatever it leaves; empty if it may be one."""
    if not bool(refined.search.converged):
        return f"the search did not converge: {refined.search.reason.rstrip('.')}"
    untold = "simulated motion does not tell {} alone; --set holds one at a known value (known=)"
    for which, words in (
        (refined.at_bound, "{} would sit on a bound"),
        (refined.search.coarse, "the steps of the simulation are part of its {}"),
        (~np.isfinite(np.asarray(refined.standard_errors)), untold),
    ):
        if names := [n for n, there in zip(refined.parameters, np.asarray(which)) if there]:
            return words.format(", ".join(names))
    return ""


def _objective(problem: Problem, estimate: Estimate, horizon: float | None) -> OutputError:
    """Over whole recordings, or windows that an unstable motion, or the caller, asks for."""
    seen = [track.within(horizon, problem.model, estimate.values) for track in problem.seen]
    lengths = [track.horizon for track in seen if track.horizon is not None]
    shooting = Tiles(seconds=min(lengths)) if lengths else WholeRecord()
    records = problem.records
    parametric = as_parametric_system(problem.model, records[0])
    system = parametric.build(estimate.table.values_of(estimate.values, 0))
    channels, levels = _channels(system, records), {}
    for name in channels or ():
        least = LEAST_NOISE * np.sqrt(np.mean([np.var(np.asarray(r[name])) for r in records]))
        levels[name] = max(noise_levels(records, (name,))[0], least)
    # What each channel is weighed by, in its unit, where something tells it.
    sigma: Any = levels if levels and all(level > 0 for level in levels.values()) else None
    return OutputError(shooting, channels=channels, sigma=sigma)


def _channels(system: AbstractSystem, records: "list[Record]") -> tuple[str, ...] | None:
    """Recorded states, and recorded outputs through which no input reaches at once.

    A force F = K x tells K where x is a state. Where x is a recorded input, its noise goes straight
    into F: what is left is white, and K too small. Accelerations, which are often a velocity's
    differences, hold nothing that the velocity does not. Filtered and differentiated signals are
    left out: their noise is not white, whatever the model.

    **Raises:** `DataError` if that leaves nothing.
    """

    def sensed(name: str) -> bool:
        """Whether no filter or difference made it, as far as is known."""
        kernels = (record.noise.kernels.get(name, {}).values() for record in records)
        return all(np.shape(taps)[-1] == 1 for signal in kernels for taps in signal)

    recorded = compared_signals(system, records)
    if not {*recorded} & {*system.state_names}:
        return None
    states = tuple(name for name in recorded if sensed(name))
    if not states:
        raise DataError(
            f"{', '.join(recorded)} are filtered or computed, so that their noise is not white "
            f"and nothing tells it from the model's own errors."
        )
    # Derivatives that equations are solved for.
    motions = system.motions if isinstance(system, EquationSystem) else ()
    leading = {motion[-1] for motion in motions}
    outputs = [name for name, _ in system.outputs if name not in leading and sensed(name)]
    outputs = [name for name in outputs if all(name in record.arrays for record in records)]
    if not (outputs and system.input_names):
        return (*states, *outputs)
    chosen = spread_points(records[0].sample_count)
    levels = np.asarray(input_levels(system, records[0]))[chosen]
    at = np.asarray(measured_states(system, records[0]))[chosen]
    direct = _through(system, at, levels)
    return (*states, *(name for name in outputs if not np.any(np.asarray(direct[name]))))


@eqx.filter_jit
def _through(system: AbstractSystem, states: np.ndarray, levels: np.ndarray) -> dict:
    return dict(jax.vmap(jax.jacfwd(system.output, argnums=1))(states, levels))


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


LIKELIER = float(np.log(100))
"""Odds, as a logarithm, from which inputs are taken for straight lines between samples. Where these
hardly show in what is left, they may still put a parameter off by several standard errors: of the
lesser of two sums of squares, noise would often choose the wrong one."""
SHOWS = 4.0
"""Squared difference of two simulations, in units of what is left, from which they compete."""


def straight_inputs(problem: Problem, estimate: Estimate) -> "dict[str, Course]":
    """Inputs that may be straight lines between samples: not those with a recorded derivative.

    Of a position x that is read as an input, lines lack h^2 / 12 of x'' in every interval. A mass
    that is too small by k h^2 / 12 makes up for that to the last digit, and nothing left shows it.
    """
    system = problem.seen[0].system(problem.model, estimate.values)
    record = problem.records[0]
    rates = [n for n in (*system.state_names, *system.input_names) if n in record.arrays]
    return {
        name: "lines"
        for name in system.input_names
        if not is_motion(record, name, [rate for rate in rates if rate != name])
    }


def course_shows(problem: Problem, refined: Estimate, by: OutputError) -> bool:
    """Whether inputs that go otherwise from one sample to the next would move the answer.

    What they move the simulation by, in units of what is left, is as chi-square: from a few on it
    is more than chance does to the parameters.
    """
    residuals = refined.search.residuals
    other = by.residuals(problem.model, problem.records, refined)
    at = jnp.asarray(refined.theta), jnp.asarray(refined.search.initial_states)
    apart = sum(
        np.sum((np.asarray(one) - np.asarray(two)) ** 2, axis=(0, 1))
        for one, two in zip(residuals.values(*at), other.values(*at))
    )
    left = (np.asarray(refined.search.rms) / np.asarray(residuals.sigma)) ** 2
    return bool(np.sum(apart / np.maximum(left, np.finfo(float).tiny)) > SHOWS)


def surely_likelier(one: Estimate, other: Estimate) -> bool:
    """Whether what was recorded is far likelier by one refinement than by another.

    Of n residuals with white noise of unknown size, the largest likelihood is rms^-n.
    """
    gains = np.log(np.asarray(other.search.rms) / np.asarray(one.search.rms))
    return bool(np.sum(np.asarray(one.search.residuals.counts) * gains) > LIKELIER)

"""Refinement in an assessment: the one that is asked for, or by default the one that is warranted.

**By default** (`refine="auto"`) output error is tried from the linear estimate, and its answer is
taken only where what it leaves is white noise. There it has the least variance that any estimate
can have. Elsewhere the model leaves out something, which output error makes up for by bending the
parameters, and integrals over windows forgive: the linear estimate stays the answer.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Literal

import jax
import numpy as np

from riecjax.assessment.asked import Asked
from riecjax.assessment.assessment import BeforeAfter, Refinement, ValidationRun
from riecjax.assessment.beforehand import Beforehand, against_priors, within
from riecjax.assessment.courses import course_shows, straight_inputs, surely_likelier
from riecjax.assessment.trust import horizons, seen, unseen, validated
from riecjax.compilation import kept_jit
from riecjax.errors import DataError, RiecjaxError
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.estimated_parameters import AbstractEstimate
from riecjax.findings import Finding
from riecjax.leaves import on_host
from riecjax.records.noise_judgement import judged
from riecjax.records.record import Record
from riecjax.refinement.coordinates import Bounds, Prior
from riecjax.refinement.integral_error import IntegralError
from riecjax.refinement.objective import AbstractMisfit, AbstractObjective
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.output_misfit import OutputMisfit
from riecjax.refinement.refine import Refined, refine_with_misfit
from riecjax.refinement.shots import Tiles, WholeRecord
from riecjax.simulation.equation_system import EquationSystem
from riecjax.simulation.linearisation import spread_points
from riecjax.simulation.system import AbstractSystem, measured_states
from riecjax.validation.whiteness import Whiteness, whiteness

MOST_STEPS = 200
"""Steps that a refinement may take."""
STEPS_BY_ITSELF = 60
"""Steps that one may take which nobody asked for; right models need about ten."""
MOST_WORK = 10_000_000
"""Steps x states x tangents of an expansion up to which nobody has to ask for a refinement.

Of ten operations for each state's derivative, as built-in models have (6 to 17), a search of twelve
expansions takes ten seconds (`python -m benchmarks.refinement_gate --work`).
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


Progress = Callable[[float], None] | None
Answered = tuple[Refinement | None, list[ValidationRun], list[Finding]]
"""A refinement, simulations with the answer along what it was not fitted to, and what failed."""


def answered(
    asked: Asked,
    estimate: Estimate,
    refused: bool,
    by: "AbstractObjective | Literal['auto'] | None",
    beforehand: tuple[Mapping[str, Bounds] | None, Mapping[str, Prior] | None],
    horizon: float | None,
    progress: Progress,
) -> Answered:
    """The refinement and the validation of an estimate, which may be no more than a start (it was
    `refused`).

    **Arguments:** `beforehand`, bounds and priors; `progress`, called after each step of a
    refinement that was asked for. One by itself takes few seconds, and a program that calls Python
    back cannot be kept for the next time.

    **Raises:** as `refine`, for a refinement that was asked for.
    """
    known = Beforehand(*beforehand)
    recordings = unseen(asked)
    windows = horizons(asked, estimate, recordings, horizon if by is None or by == "auto" else None)
    before, failed = validated(asked.model, estimate.values, recordings, windows)
    if by is None:
        return None, before, failed
    if isinstance(by, str):
        flaw = "" if refused else _left_out(estimate)
        found = Refinement(declined=flaw) if flaw else _by_itself(asked, estimate, known, horizon)
    else:
        found = _as_asked(asked, estimate, by, known, progress)
        failed = [*failed, *against_priors(estimate, known.priors or {})]
    if found.refined is None:
        return found, before, failed
    after, failed_after = validated(asked.model, found.refined.values, recordings, windows)
    pairs = _pairs(before, after)
    if not recordings and not isinstance(by, str):
        fitted = seen(asked)
        windows = horizons(asked, estimate, fitted, None)
        runs = (
            validated(asked.model, v, fitted, windows)[0]
            for v in (estimate.values, found.refined.values)
        )
        found, pairs = found._replace(on_fitted=True), _pairs(*runs)
    found = found._replace(simulations=pairs)
    if isinstance(by, str) and found.chosen:
        found = _still_chosen(found)
    failed_after = [*failed_after, *(f for f in failed if f.code == "prior_disagrees")]
    return (found, after, failed_after) if found.chosen else (found, before, failed)


def _pairs(before: list[ValidationRun], after: list[ValidationRun]) -> list[BeforeAfter]:
    # By recording, not by name: files in different folders may share one.
    earlier = {id(run.recording): run.held for run in before}
    return [
        BeforeAfter(run.recording, earlier[id(run.recording)], run.held)
        for run in after
        if id(run.recording) in earlier
    ]


def _still_chosen(found: Refinement) -> Refinement:
    """Not where it predicts worse what neither answer was fitted to."""
    for run in found.simulations:
        before, after = run.worst_fits
        if after < before - WORSE:
            return found._replace(
                declined=f"it predicts {run.recording.name} worse: a fit of {after:.1f} %, where "
                f"the linear estimate has {before:.1f} %"
            )
    return found


def _as_asked(
    asked: Asked,
    estimate: Estimate,
    by: AbstractObjective,
    known: Beforehand,
    progress: Progress,
) -> Refinement:
    """Over the estimate's windows if no others are asked for; its values are the answer."""
    if isinstance(by, IntegralError) and by.criterion is None:
        by = IntegralError(estimate.criterion)
    refined, misfit = _search(asked, estimate, by, known, MOST_STEPS, progress)
    return Refinement(refined, whiteness=_left(misfit, refined, asked.records))


def _left(misfit: AbstractMisfit, refined: Refined, records: list[Record]) -> Whiteness | None:
    if not isinstance(misfit, OutputMisfit):
        return None
    return whiteness(misfit, refined.theta, refined.initial_states, records)


def _search(
    asked: Asked,
    estimate: AbstractEstimate,
    by: AbstractObjective,
    known: Beforehand,
    max_steps: int,
    progress: Progress = None,
) -> tuple[Refined, AbstractMisfit]:
    refined, misfit = refine_with_misfit(
        asked.model,
        asked.records,
        within(estimate, known.bounds or {}),
        by,
        per_record=asked.settings["per_record"],
        key=asked.key,
        intervals=asked.intervals,
        bounds=known.bounds,
        priors=known.priors,
        max_steps=max_steps,
        progress=progress,
    )
    return on_host(refined), misfit


def _by_itself(
    asked: Asked,
    estimate: Estimate,
    known: Beforehand,
    horizon: float | None,
) -> Refinement:
    """By output error where that is possible, quick and warranted."""
    try:
        if not np.all(np.isfinite(np.asarray(estimate.theta))):
            return Refinement(declined="the estimate that it would start from is not finite")
        by = _objective(asked, estimate, horizon)
        if (work := _work(asked, estimate, by)) > MOST_WORK:
            return Refinement(
                declined=f"a search would take {work:.2g} steps x states x tangents, more than "
                f"{MOST_WORK:.0g}; {ASK}"
            )
        found = _warranted(asked, estimate, by, known)
        if horizon is None and found.refined is not None and isinstance(by.shooting, Tiles):
            # A poor start may be unstable where the motion is not.
            better = _objective(asked, found.refined, None)
            if better.shooting != by.shooting:
                again = _warranted(asked, found.refined, better, known)
                found = again if again.refined is not None else found
        return found
    except EXPECTED as error:
        return Refinement(declined=f"no output error can be formed: {str(error).rstrip('.')}")


def _work(asked: Asked, estimate: AbstractEstimate, by: OutputError) -> int:
    own = tuple(asked.settings["per_record"])
    specified = by.specify(asked.model, asked.records, estimate, {}, own, None)
    return by.misfit(specified).work


def _left_out(estimate: Estimate) -> str:
    """Why no search is worth its time; empty where the equations leave little but noise."""
    for name, fit in estimate.equations.items():
        left = float(fit.model_rms)
        if left > max(LEFT_OUT, ABOVE_NOISE * float(fit.noise_rms)):
            return (
                f"{name} leaves {100 * left:.2g} % of its target and noise "
                f"{100 * float(fit.noise_rms):.2g} %, so that values would bend to make up for "
                f"what the model leaves out; {ASK}"
            )
    return ""


def _warranted(
    asked: Asked,
    estimate: AbstractEstimate,
    by: OutputError,
    known: Beforehand,
) -> Refinement:
    refined, misfit = _search(asked, estimate, by, known, STEPS_BY_ITSELF)
    left = _left(misfit, refined, asked.records)
    if flaw := _flaw(refined):
        return Refinement(declined=flaw)
    if left is None or not (left.vanishing or left.largest == left.largest):
        return Refinement(declined="too few residuals to tell whether they are white")
    straight = {} if left.vanishing else straight_inputs(asked, estimate)
    lines = dataclasses.replace(by, intersample=straight)
    if straight and course_shows(asked, refined, misfit, lines):
        again, misfit = _search(asked, estimate, lines, known, STEPS_BY_ITSELF)
        left_again = _left(misfit, again, asked.records)
        surely = surely_likelier(again, refined, asked.records)
        if left_again and not _flaw(again) and surely:
            refined, left = again, left_again
    return Refinement(refined, whiteness=left, declined="" if left.white else _coloured(left))


def _coloured(left: Whiteness) -> str:
    name = max(left.statistics, key=lambda n: left.statistics[n])
    share = 100 * left.shares[name]
    cause = (
        "so little is left by the input's noise or its course between samples, too"
        if max(left.shares.values()) < SMALL_SHARE
        else "so the model leaves out part of the motion, the noise is coloured, or a recorded "
        "input is noisy"
    )
    return (
        f"what it leaves of {name}, {share:.2g} % of it, is not white noise ({left.largest:.3g}, "
        f"where noise stays below {left.threshold:.2g}), {cause}"
    )


def _flaw(refined: Refined) -> str:
    """Why a refinement is no answer, whatever it leaves; empty if it may be one."""

    def named(which: np.ndarray) -> str:
        return ", ".join(name for name, there in zip(refined.parameters, which) if there)

    if not bool(refined.converged):
        return f"the search did not converge: {refined.reason.rstrip('.')}"
    if np.any(refined.at_bound):
        return f"{named(np.asarray(refined.at_bound))} would sit on a bound"
    if np.any(refined.coarse):
        return f"the steps of the simulation are part of its {named(np.asarray(refined.coarse))}"
    errors = np.asarray(refined.standard_errors)
    if not np.all(np.isfinite(errors)):
        return (
            f"simulated motion does not tell {named(~np.isfinite(errors))} alone; --set holds one "
            f"at a known value (known=)"
        )
    return ""


def _objective(asked: Asked, estimate: AbstractEstimate, horizon: float | None) -> OutputError:
    """Over whole recordings, or windows that an unstable motion, or the caller, asks for."""
    fitted = seen(asked)
    lengths = [one for one in horizons(asked, estimate, fitted, horizon) if one is not None]
    shooting = Tiles(seconds=min(lengths)) if lengths else WholeRecord()
    specified = OutputError().specify(
        asked.model, asked.records, estimate, {}, tuple(asked.settings["per_record"]), None
    )
    system = specified.model.build(specified.of_record(0))
    channels = _channels(system, asked.records)
    return OutputError(shooting, channels=channels, sigma=_noise(asked.records, channels))


def _noise(records: list[Record], channels: tuple[str, ...] | None) -> dict[str, Any] | None:
    """Noise that each channel is weighed by, in its unit; `None` where nothing tells it."""
    found = {}
    for name in channels or ():
        own = [np.asarray(judged(record, "auto", name).noise.std(name)) for record in records]
        level = np.sqrt(np.mean(np.square(own)))
        least = LEAST_NOISE * np.sqrt(np.mean([np.var(np.asarray(r[name])) for r in records]))
        found[name] = max(level, least)
    return found if found and all(level > 0 for level in found.values()) else None


def _channels(system: AbstractSystem, records: list[Record]) -> tuple[str, ...] | None:
    """Recorded states, and recorded outputs through which no input reaches at once.

    A force F = K x tells K where x is a state. Where x is a recorded input, its noise goes straight
    into F: what is left is white, and K too small. Accelerations, which are often a velocity's
    differences, hold nothing that the velocity does not. Filtered and differentiated signals are
    left out: their noise is not white, whatever the model.

    **Raises:** `DataError` if that leaves nothing.
    """

    def held(name: str) -> bool:
        return all(name in record.arrays and _has_white_noise(record, name) for record in records)

    states = tuple(name for name in system.state_names if held(name))
    if not states:
        recorded = [name for name in system.state_names if name in records[0].arrays]
        if recorded:
            raise DataError(
                f"{', '.join(recorded)} are filtered or computed, so that their noise is not white "
                f"and nothing tells it from the model's own errors."
            )
        return None
    leading = _leading(system)
    outputs = [name for name, _ in system.outputs if held(name) and name not in leading]
    if not outputs:
        return states
    chosen = spread_points(records[0].sample_count)
    levels = [np.asarray(records[0][name])[chosen] for name in system.input_names]
    if not levels:
        return (*states, *outputs)
    at = np.asarray(measured_states(system, records[0]))[chosen]
    direct = _through(system, at, np.stack(levels, axis=-1))
    return (*states, *(name for name in outputs if not np.any(np.asarray(direct[name]))))


def _has_white_noise(record: Record, name: str) -> bool:
    """Whether no filter or difference made this signal, as far as is known."""
    return all(np.shape(taps)[-1] == 1 for taps in record.noise.kernels.get(name, {}).values())


def _leading(system: AbstractSystem) -> set[str]:
    """Derivatives that equations are solved for."""
    if not isinstance(system, EquationSystem):
        return set()
    return {motion.names[-1] for motion in system.structure.motions}


@kept_jit
def _through(system: AbstractSystem, states: np.ndarray, levels: np.ndarray) -> dict:
    return dict(jax.vmap(jax.jacfwd(system.output, argnums=1))(states, levels))

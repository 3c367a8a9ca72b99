"""The search of an assessment by output error, and whether what it leaves is white noise."""

import contextlib
import dataclasses
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np

from riecjax.assessment.refining import ASK, Problem, Refinement
from riecjax.doubts.kinematics import is_derivative
from riecjax.equations.equation_system import EquationSystem
from riecjax.errors import DataError, RiecjaxError
from riecjax.estimation.estimate import Estimate
from riecjax.records.record import deviation
from riecjax.refinement.integral_error import IntegralError
from riecjax.refinement.objective import (
    AbstractObjective,
    AbstractResiduals,
    as_parametric_system,
)
from riecjax.refinement.output_error import OutputError, Tiles, WholeRecord, noise_levels
from riecjax.refinement.refine import refined
from riecjax.simulation.linearisation import spread_points
from riecjax.simulation.system import (
    AbstractSystem,
    compared_signals,
    input_levels,
    measured_states,
)
from riecjax.uncertainty.intervals import intervals_of
from riecjax.validation.whiteness import whiteness

if TYPE_CHECKING:
    from riecjax.records.record import Record
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
EXPECTED = (RiecjaxError, TypeError, ValueError, IndexError)
"""What a model raises that can be identified and not simulated: the last three, expressions that
JAX cannot differentiate."""


class Declined(Exception):
    """Why a refinement that nobody asked for is not the answer."""


def search_asked_for(problem: Problem, estimate: Estimate) -> Refinement:
    """From an estimate, by what settings make small, over the estimate's windows if no others are
    asked for.

    **Raises:** as `refine`.
    """
    settings, by = problem.settings, problem.settings.refine
    if by == "output-error":
        shooting = Tiles(seconds=settings.horizon) if settings.horizon else WholeRecord()
        by = OutputError(shooting, channels=tuple(settings.channels) or None, loss=settings.loss)
    elif by == "integral" or (isinstance(by, IntegralError) and by.criterion is None):
        by = IntegralError(estimate.criterion)
    return _search(problem, estimate, by.suited(problem.model), asked=True)  # type: ignore[union-attr]


def _search(
    problem: Problem, estimate: Estimate, by: AbstractObjective, asked: bool = False
) -> Refinement:
    """A refinement from an estimate, and of output error whether it leaves white noise.

    One that nobody asked for tells nothing of its `progress`: it takes few seconds, and a program
    that calls Python back cannot be kept for the next time.

    **Raises:** `Declined` for one that nobody asked for and that takes long.
    """
    settings, records = problem.settings, problem.records

    def formed(by: AbstractObjective) -> AbstractResiduals:
        return by.residuals(problem.model, records, estimate, key=settings.key)

    residuals: Any = formed(by)
    if not asked and residuals.work > MOST_WORK:
        raise Declined(
            f"a search would take {residuals.work:.2g} steps x states x tangents, more than "
            f"{MOST_WORK:.0g}; {ASK}"
        )
    given = settings.bounds, settings.priors, intervals_of(settings.intervals)
    limits = (MOST_STEPS, settings.progress) if asked else (STEPS_BY_ITSELF, None)
    found, by = refined(by, residuals, formed, records, *given, None, *limits)
    return Refinement(estimate, found, whiteness=whiteness(found, records), by=by)


def search_by_itself(problem: Problem, estimate: Estimate) -> Refinement:
    """By output error where that is possible and quick."""
    horizon = problem.settings.horizon
    try:
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
    lines: Any = found.by and dataclasses.replace(found.by, intersample=straight)
    if straight and course_shows(problem, found.refined, lines):
        other = _search(problem, estimate, lines)
        likelier = surely_likelier(other.refined, found.refined)
        if other.whiteness and not _flaw(other.refined) and likelier:
            found, left = other, other.whiteness
    if left.white:
        return found
    name, loudest = max(left.channels.items(), key=lambda channel: channel[1].statistic)
    cause = (
        "so little is left by the input's noise or its course between samples, too"
        if max(channel.share for channel in left.channels.values()) < SMALL_SHARE
        else "so the model leaves out part of the motion, the noise is coloured, or a recorded "
        "input is noisy"
    )
    return found._replace(
        declined=f"what it leaves of {name}, {100 * loudest.share:.2g} % of it, is not white "
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
    channels = _channels(system, records)
    levels = {
        name: max(noise_levels(records, (name,))[0], LEAST_NOISE * deviation(records, name))
        for name in channels or ()
    }
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
    through = eqx.filter_jit(lambda *given: jax.vmap(jax.jacfwd(system.output, argnums=1))(*given))
    direct = dict(through(at, levels))
    return (*states, *(name for name in outputs if not np.any(np.asarray(direct[name]))))


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
        if not is_derivative(record, name, [rate for rate in rates if rate != name])
    }


def course_shows(problem: Problem, refined: Estimate, by: OutputError) -> bool:
    """Whether inputs that go otherwise from one sample to the next would move the answer.

    What they move the simulation by, in units of what is left, is as chi-square: from a few on it
    is more than chance does to the parameters.
    """
    residuals = refined.search.residuals
    other = by.residuals(problem.model, problem.records, refined)
    at = refined.theta, refined.search.initial_states
    pairs = zip(residuals.at(*at).simulated, other.at(*at).simulated)
    apart = sum(np.sum((one.left - two.left) ** 2, axis=(0, 1)) for one, two in pairs)
    left = (np.asarray(refined.search.rms) / np.asarray(residuals.sigma)) ** 2
    return bool(np.sum(apart / np.maximum(left, np.finfo(float).tiny)) > SHOWS)


def surely_likelier(one: Estimate, other: Estimate) -> bool:
    """Whether what was recorded is far likelier by one refinement than by another.

    Of n residuals with white noise of unknown size, the largest likelihood is rms^-n.
    """
    gains = np.log(np.asarray(other.search.rms) / np.asarray(one.search.rms))
    return bool(np.sum(np.asarray(one.search.residuals.counts) * gains) > LIKELIER)

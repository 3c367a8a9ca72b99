"""Refinement in an assessment: the one that is asked for, or by default the one that is warranted.

**By default** (`refine="auto"`) output error is tried from the linear estimate, and its answer is
taken only where what it leaves is white noise. There it has the least variance that any estimate
can have. Elsewhere the model leaves out something, which output error makes up for by bending the
parameters, and integrals over windows forgive: the linear estimate stays the answer.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from riecjax.assessment.asked import Asked, size_of
from riecjax.assessment.assessment import BeforeAfter, Refinement, ValidationRun
from riecjax.assessment.trust import horizons, system_of, validated
from riecjax.compilation import kept_jit
from riecjax.equations.equation_system import EquationSystem
from riecjax.errors import DataError, RiecjaxError
from riecjax.estimation.estimate import AbstractEstimate, Estimate
from riecjax.findings import Finding
from riecjax.leaves import on_host
from riecjax.records.faults.derivative_pairs import is_motion
from riecjax.records.record import Record
from riecjax.refinement.integral_error import IntegralError
from riecjax.refinement.objective import AbstractMisfit, AbstractObjective
from riecjax.refinement.optimum import Bounds, Constraints, is_pair
from riecjax.refinement.output_error import (
    OutputError,
    OutputMisfit,
    Tiles,
    WholeRecord,
    noise_levels,
)
from riecjax.refinement.refine import Refined, refined_of
from riecjax.simulation.intersample import Course
from riecjax.simulation.linearisation import spread_points
from riecjax.simulation.system import AbstractSystem, measured_states
from riecjax.validation.whiteness import Whiteness, whiteness

if TYPE_CHECKING:
    from riecjax.settings import Refine

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


Progress = Callable[[float], None] | None
Answered = tuple[Refinement | None, list[ValidationRun], list[Finding]]
"""A refinement, simulations with the answer along what it was not fitted to, and what failed."""


def answered(asked: Asked, estimate: Estimate, refused: bool) -> Answered:
    """The refinement and the validation of an estimate, which may be no more than a start (it was
    `refused`).

    **Raises:** as `refine`, for a refinement that was asked for.
    """
    settings, recordings = asked.settings, asked.unseen
    by = objective_of(settings)
    horizon = settings.horizon if by is None or by == "auto" else None
    windows = horizons(asked, estimate, recordings, horizon)
    before, failed = validated(asked.model, estimate.values, recordings, windows)
    if by is None:
        return None, before, failed
    if isinstance(by, str):
        flaw = "" if refused else _left_out(estimate)
        refinement = Refinement(declined=flaw) if flaw else _by_itself(asked, estimate)
    else:
        # Over the estimate's windows if no others are asked for; its values are the answer.
        if isinstance(by, IntegralError) and by.criterion is None:
            by = IntegralError(estimate.criterion)
        refined, _, left = _search(asked, estimate, by, MOST_STEPS, settings.progress)
        refinement = Refinement(refined, whiteness=left)
        failed += against_priors(estimate, settings.priors)
    if refinement.refined is None:
        return refinement, before, failed
    values = refinement.refined.values
    after, failed_after = validated(asked.model, values, recordings, windows)
    pairs = _pairs(before, after)
    if not recordings and not isinstance(by, str):
        windows = horizons(asked, estimate, asked.seen, None)
        runs = (validated(asked.model, v, asked.seen, windows) for v in (estimate.values, values))
        refinement, pairs = refinement._replace(on_fitted=True), _pairs(*(run for run, _ in runs))
    refinement = refinement._replace(simulations=pairs)
    # By itself not where it predicts worse what neither answer was fitted to.
    for run in pairs if isinstance(by, str) else ():
        earlier, later = run.worst_fits
        if later < earlier - WORSE and refinement.chosen:
            refinement = refinement._replace(
                declined=f"it predicts {run.recording.name} worse: a fit of {later:.1f} %, where "
                f"the linear estimate has {earlier:.1f} %"
            )
    if not refinement.chosen:
        return refinement, before, failed
    return refinement, after, [*failed_after, *(f for f in failed if f.code == "prior_disagrees")]


def objective_of(settings: "Refine") -> AbstractObjective | Literal["auto"] | None:
    """What a refinement makes small; `None` for no refinement."""
    if settings.refine in (None, "none"):
        return None
    if settings.refine == "integral":
        return IntegralError()
    if settings.refine == "output-error":
        horizon = settings.horizon
        shooting = WholeRecord() if horizon is None else Tiles(seconds=horizon)
        return OutputError(shooting, channels=tuple(settings.channels) or None, loss=settings.loss)
    return settings.refine  # type: ignore[return-value]


def _pairs(before: list[ValidationRun], after: list[ValidationRun]) -> list[BeforeAfter]:
    # By recording, not by name: files in different folders may share one.
    pairs = ((first, then) for first in before for then in after)
    return [BeforeAfter(*a, b.held) for a, b in pairs if a.recording is b.recording]


def _search(
    asked: Asked,
    estimate: AbstractEstimate,
    by: AbstractObjective,
    max_steps: int,
    progress: Progress = None,
) -> tuple[Refined, AbstractMisfit, Whiteness | None]:
    """A refinement, what it made small, and of output error whether it leaves white noise.

    One that nobody asked for tells nothing of its `progress`: it takes few seconds, and a program
    that calls Python back cannot be kept for the next time.
    """
    settings = asked.settings
    by, start = by.suited(asked.model), within(estimate, settings.bounds)
    specified = by.specify(asked.model, asked.records, start, key=settings.key)
    limits: Any = settings.bounds, settings.priors
    constraints = Constraints.of(specified.table, specified.values, *limits)
    refined, misfit = refined_of(
        by, specified, constraints, asked.intervals, None, max_steps, progress
    )
    refined, left = on_host(refined), None
    if isinstance(misfit, OutputMisfit):
        left = whiteness(misfit, refined.theta, refined.initial_states, asked.records)
    return refined, misfit, left


def _by_itself(asked: Asked, estimate: Estimate) -> Refinement:
    """By output error where that is possible, quick and warranted."""
    horizon = asked.settings.horizon
    try:
        if not np.all(np.isfinite(np.asarray(estimate.theta))):
            return Refinement(declined="the estimate that it would start from is not finite")
        by = _objective(asked, estimate, horizon)
        specified = by.specify(asked.model, asked.records, estimate)
        if (work := by.misfit(specified).work) > MOST_WORK:
            return Refinement(
                declined=f"a search would take {work:.2g} steps x states x tangents, more than "
                f"{MOST_WORK:.0g}; {ASK}"
            )
        refinement = _warranted(asked, estimate, by)
        if horizon is None and refinement.refined is not None and isinstance(by.shooting, Tiles):
            # A poor start may be unstable where the motion is not.
            better = _objective(asked, refinement.refined, None)
            if better.shooting != by.shooting:
                further = _warranted(asked, refinement.refined, better)
                refinement = refinement if further.refined is None else further
        return refinement
    except EXPECTED as error:
        return Refinement(declined=f"no output error can be formed: {str(error).rstrip('.')}")


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


def _warranted(asked: Asked, estimate: AbstractEstimate, by: OutputError) -> Refinement:
    refined, misfit, left = _search(asked, estimate, by, STEPS_BY_ITSELF)
    if flaw := _flaw(refined):
        return Refinement(declined=flaw)
    if left is None or not (left.vanishing or left.largest == left.largest):
        return Refinement(declined="too few residuals to tell whether they are white")
    straight = {} if left.vanishing else straight_inputs(asked, estimate)
    lines = dataclasses.replace(by, intersample=straight)
    if straight and course_shows(asked, refined, misfit, lines):
        other, _, left_by_other = _search(asked, estimate, lines, STEPS_BY_ITSELF)
        likelier = surely_likelier(other, refined, asked.records)
        if left_by_other and not _flaw(other) and likelier:
            refined, left = other, left_by_other
    if left.white:
        return Refinement(refined, whiteness=left)
    name = max(left.statistics, key=lambda channel: left.statistics[channel])
    cause = (
        "so little is left by the input's noise or its course between samples, too"
        if max(left.shares.values()) < SMALL_SHARE
        else "so the model leaves out part of the motion, the noise is coloured, or a recorded "
        "input is noisy"
    )
    declined = (
        f"what it leaves of {name}, {100 * left.shares[name]:.2g} % of it, is not white noise "
        f"({left.largest:.3g}, where noise stays below {left.threshold:.2g}), {cause}"
    )
    return Refinement(refined, declined, left)


def _flaw(refined: Refined) -> str:
    """Why a refinement is no answer, whatever it leaves; empty if it may be one."""
    if not bool(refined.converged):
        return f"the search did not converge: {refined.reason.rstrip('.')}"
    untold = "simulated motion does not tell {} alone; --set holds one at a known value (known=)"
    for which, words in (
        (refined.at_bound, "{} would sit on a bound"),
        (refined.coarse, "the steps of the simulation are part of its {}"),
        (~np.isfinite(np.asarray(refined.standard_errors)), untold),
    ):
        if names := [n for n, there in zip(refined.parameters, np.asarray(which)) if there]:
            return words.format(", ".join(names))
    return ""


def _objective(asked: Asked, estimate: AbstractEstimate, horizon: float | None) -> OutputError:
    """Over whole recordings, or windows that an unstable motion, or the caller, asks for."""
    lengths = [s for s in horizons(asked, estimate, asked.seen, horizon) if s is not None]
    shooting = Tiles(seconds=min(lengths)) if lengths else WholeRecord()
    specified = OutputError().specify(asked.model, asked.records, estimate)
    system = specified.model[0].build(specified.table.values_of(specified.values, 0))
    records = asked.records
    channels, levels = _channels(system, records), {}
    for name in channels or ():
        least = LEAST_NOISE * np.sqrt(np.mean([np.var(np.asarray(r[name])) for r in records]))
        levels[name] = max(noise_levels(records, (name,))[0], least)
    # What each channel is weighed by, in its unit, where something tells it.
    sigma: Any = levels if levels and all(level > 0 for level in levels.values()) else None
    return OutputError(shooting, channels=channels, sigma=sigma)


def _channels(system: AbstractSystem, records: list[Record]) -> tuple[str, ...] | None:
    """Recorded states, and recorded outputs through which no input reaches at once.

    A force F = K x tells K where x is a state. Where x is a recorded input, its noise goes straight
    into F: what is left is white, and K too small. Accelerations, which are often a velocity's
    differences, hold nothing that the velocity does not. Filtered and differentiated signals are
    left out: their noise is not white, whatever the model.

    **Raises:** `DataError` if that leaves nothing.
    """

    def held(name: str) -> bool:
        """Whether all have it, and no filter or difference made it, as far as is known."""
        return all(
            name in record.arrays
            and all(np.shape(k)[-1] == 1 for k in record.noise.kernels.get(name, {}).values())
            for record in records
        )

    states = tuple(name for name in system.state_names if held(name))
    if not states:
        recorded = [name for name in system.state_names if name in records[0].arrays]
        if recorded:
            raise DataError(
                f"{', '.join(recorded)} are filtered or computed, so that their noise is not white "
                f"and nothing tells it from the model's own errors."
            )
        return None
    # Derivatives that equations are solved for.
    motions = system.motions if isinstance(system, EquationSystem) else ()
    leading = {motion[-1] for motion in motions}
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


@kept_jit
def _through(system: AbstractSystem, states: np.ndarray, levels: np.ndarray) -> dict:
    return dict(jax.vmap(jax.jacfwd(system.output, argnums=1))(states, levels))


STRANGE = 3.0
"""Standard deviations past which a prior contradicts the data: one time in 370 by chance."""
INSIDE = 0.1
"""Share of the way between bounds, or of the way to the only one, by which a start stands off."""


def against_priors(
    estimate: Estimate, priors: Mapping[str, tuple[float, float]]
) -> Iterator[Finding]:
    """Priors from which what the data tell without them lies further than chance explains."""
    for name in priors.keys() & {*estimate.parameters}:
        (mean, std), value = priors[name], float(estimate[name])
        error = float(estimate.standard_error(name))
        if abs(value - mean) > STRANGE * np.hypot(std, error):
            message = (
                f"the prior of {name}, {mean:.4g} +- {std:.2g}, and the estimate without it, "
                f"{value:.4g} +- {error:.2g}, contradict each other: what was answered lies "
                f"between two values of which one is wrong."
            )
            yield Finding("prior_disagrees", message, parameters=(name,), doubt=1.0)


def outside_bounds(answer: AbstractEstimate, bounds: Mapping[str, Bounds]) -> Iterator[Finding]:
    """Values of a linear estimate, which knows of no bounds, that lie outside of them."""
    for name, value, nearest, (low, high) in _strays(answer, bounds):
        side = f"below {low:g}" if value < low else f"above {high:g}"
        message = (
            f"{name} is {value:.4g}, {side}, its bound: bounds apply to refined values, and these "
            f"are linear estimates. Ask for refinement (--refine output-error), hold {name} at a "
            f"value (--set), or check the bound."
        )
        doubt = abs(value - nearest) / size_of(value)
        yield Finding("outside_bound", message, parameters=(name,), doubt=doubt)


def within(start: AbstractEstimate, bounds: Mapping[str, Bounds]) -> AbstractEstimate:
    """A start between the bounds, which a search approaches and never crosses."""
    moved = {}
    for name, value, nearest, (low, high) in _strays(start, bounds):
        way = high - low if np.isfinite(high - low) else max(abs(value - nearest), abs(nearest))
        moved[name] = nearest + INSIDE * way * (1 if nearest == low else -1)
    theta = [moved.get(name, start[name]) for name in start.parameters]
    return eqx.tree_at(lambda estimate: estimate.theta, start, jnp.stack(theta)) if moved else start


def _strays(
    estimate: AbstractEstimate, bounds: Mapping[str, Bounds]
) -> Iterator[tuple[str, float, float, tuple[float, float]]]:
    """Parameters out of bounds, with value, nearest bound and both."""
    # What makes no sense is refused by the search.
    given = {n: b for n, b in bounds.items() if is_pair(b, or_none=True)}
    given = estimate.table.values(given)
    for name in (name for name in estimate.parameters if name in given):
        low, high = given[name]
        low = -np.inf if low is None else float(low)
        high = np.inf if high is None else float(high)
        value = float(estimate[name])
        if low < high and not low < value < high:
            yield name, value, low if value <= low else high, (low, high)


LIKELIER = float(np.log(100))
"""Odds, as a logarithm, from which inputs are taken for straight lines between samples. Where these
hardly show in what is left, they may still put a parameter off by several standard errors: of the
lesser of two sums of squares, noise would often choose the wrong one."""
SHOWS = 4.0
"""Squared difference of two simulations, in units of what is left, from which they compete."""


def straight_inputs(asked: Asked, estimate: AbstractEstimate) -> dict[str, Course]:
    """Inputs that may be straight lines between samples: not those with a recorded derivative.

    Of a position x that is read as an input, lines lack h^2 / 12 of x'' in every interval. A mass
    that is too small by k h^2 / 12 makes up for that to the last digit, and nothing left shows it.
    """
    system = system_of(asked.model, estimate.values, *asked.seen[0])
    record = asked.records[0]
    rates = [n for n in (*system.state_names, *system.input_names) if n in record.arrays]
    return {
        name: "lines"
        for name in system.input_names
        if not is_motion(record, name, [rate for rate in rates if rate != name])
    }


def course_shows(asked: Asked, refined: Refined, misfit: AbstractMisfit, by: OutputError) -> bool:
    """Whether inputs that go otherwise from one sample to the next would move the answer.

    What they move the simulation by, in units of what is left, is as chi-square: from a few on it
    is more than chance does to the parameters.
    """
    other = by.misfit(by.specify(asked.model, asked.records, refined))
    if not isinstance(misfit, OutputMisfit):
        return False
    at = jnp.asarray(refined.theta), jnp.asarray(refined.initial_states)
    apart = sum(
        np.sum((np.asarray(one) - np.asarray(two)) ** 2, axis=(0, 1))
        for one, two in zip(misfit.residuals(*at), other.residuals(*at))
    )
    left = (np.asarray(refined.rms) / np.asarray(misfit.sigma)) ** 2
    return bool(np.sum(apart / np.maximum(left, np.finfo(float).tiny)) > SHOWS)


def surely_likelier(one: Refined, other: Refined, records: list[Record]) -> bool:
    """Whether what was recorded is far likelier by one refinement than by another.

    Of n residuals with white noise of unknown size, the largest likelihood is rms^-n.
    """
    counts = [
        sum(int(np.isfinite(record.signal(name).with_nan).sum()) for record in records)
        for name in one.quantities
    ]
    gains = np.log(np.asarray(other.rms) / np.asarray(one.rms))
    return bool(np.sum(np.array(counts) * gains) > LIKELIER)

"""Hidden elements in the windows that tell most of them, and the sums linearised about them.

Windows of every length have sums of their own. In each modes and springs are searched, and promised
a standard error; the length that promises the least one is taken. About what is found there the
stage's equations are linearised, and from then on they are as any others.
"""

import dataclasses
from itertools import zip_longest
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from riecjax.compilation import kept_jit
from riecjax.equations.hidden_elements import (
    Expanded,
    HiddenMode,
    HiddenParameters,
    ModeParameters,
    SpringParameters,
)
from riecjax.equations.model import Model
from riecjax.errors import IdentifiabilityError, ModelError
from riecjax.estimation.hidden_modes import ModeStage, Values, as_asked, search
from riecjax.leaves import Leaf, held_still, is_concrete, is_under_trace, on_host
from riecjax.linear_algebra import solve_scaled
from riecjax.summaries.digest import Outline
from riecjax.summaries.normal_equations import NormalEquations, sum_of_equations
from riecjax.summaries.summary import Summary
from riecjax.summaries.sums import EquationSums, Survey
from riecjax.uncertainty.block_statistics import block_influence


class FoundModes(NamedTuple):
    """Where hidden elements are, what they were found from, and what is left to be solved.

    **Fields:** `equations` of each stage, linearised about them; `mixes`, of each stage the
    combinations of its equations' columns that these are; `at`, the shapes of each stage's
    elements; `bands`, of each stage the bins of window lengths that it is solved from, `None` for
    all or under a trace; whether the elements are `shown` in these at all.
    """

    equations: list[list[NormalEquations]]
    mixes: list[list[Float[Array, "1+p columns"]]]
    at: list[Float[Array, " shapes"]]
    bands: list[tuple[int, int] | None]
    shown: Bool[Array, ""]


def find_modes(model: Model, summary: Summary, given: Values, rank: int = 0) -> FoundModes:
    """The hidden elements of each stage, in the windows that tell most of them.

    Short windows show a fast mode, or a lag, and much noise; which of the lengths tells most is
    seen from the standard errors that each promises. Where lengths were not kept apart all are
    taken.

    **Arguments:** `rank`, 0 for the lengths that tell most, 1 for the next, where there are some.

    **Raises:** `ModelError` where of a mode something is known, and not all, or of a spring its
    stiffness alone, and for a mode above what the sampling shows; `IdentifiabilityError` where a
    signal that tells of an element never moves.
    """
    for names in model.hidden:
        held = [name for name in names if name in given]
        if isinstance(names, ModeParameters) and 0 < len(held) < 3:
            raise ModelError(
                f"of a hidden mode all of {', '.join(names)} are known or none; got "
                f"{', '.join(held)}."
            )
        coefficient, stiffness = names[:2]
        if isinstance(names, SpringParameters) and held == [stiffness]:
            raise ModelError(
                f"of a spring in series {stiffness} is known only where {coefficient} is; leave "
                f"it out, or give both."
            )
    known = {name: jnp.asarray(value) for name, value in given.items()}
    found, shown = [], jnp.array(True)
    equations = summary.equations()
    looked_at = is_concrete(equations, known) and not is_under_trace()
    for i, expanded in enumerate(model.expanded):
        stage = ModeStage.of(expanded, equations[i], known)
        used, at, band = equations[i], jnp.zeros(0), None
        if stage.sought:
            where = tuple(search_band(model, summary, names) for names in stage.sought)
            wanted = tuple(
                element if isinstance(element := model.hidden[names], HiddenMode) else None
                for names in stage.sought
            )
            # The sums over the windows that tell most of the stage's elements.
            first, last = summary.band
            options = [(b, b + 1) for b in range(first, last)] if summary.bins else [summary.band]
            every = [summary.equations(option)[i] for option in options]
            stacked: Any = jax.tree.map(lambda *leaves: jnp.stack(leaves), *every)
            settings = where, wanted, np.asarray(rank)
            best, at, there = _searched(expanded, stacked, known, *settings)
            if is_concrete(best):
                used = every[int(best)]
                band = options[int(best)] if summary.bins else None
            else:
                used = jax.tree.map(lambda leaf, best=best: leaf[best], stacked)
            shown = shown & there
            # Sums that are not finite themselves are for the fit to refuse.
            finite = looked_at and all(bool(np.isfinite(e.moments).all()) for e in equations[i])
            if finite and not bool(np.isfinite(at).all()):
                raise IdentifiabilityError(
                    f"{', '.join(model.equation_names[i])}: nothing in the record tells of the "
                    f"hidden element, as a signal that it acts on never moves. Check that signal's "
                    f"channel, or excite it.",
                    "not_excited",
                )
        # What no later equation with an element asks for is left to the fit.
        later = [e for stage in model.expanded[i:] for e in stage if e.elements]
        asked = {name for e in later for name in e.all_parameters}
        mixes = []
        if any(e.elements for e in expanded) or asked.intersection(stage.linear):
            used, mixes, values = _contracted(expanded, used, known, at, not looked_at)
            known |= values
        found.append((used, mixes, at, band))
    return FoundModes(*map(list, zip(*found)), shown)


@kept_jit
def _searched(
    expanded: tuple[Expanded, ...],
    options: list[NormalEquations],
    known: Values,
    bands: tuple[tuple[Leaf, Leaf], ...],
    wanted: tuple[HiddenMode | None, ...],
    rank: Int[Leaf, ""],
) -> tuple[Array, Float[Array, " shapes"], Bool[Array, ""]]:
    """Which windows tell most of a stage's hidden elements, where they are by these, and whether
    they show any.

    What a length promises is the sum of squared relative standard errors of masses and stiffnesses
    of modes, and of squared standard errors of lags in samples, infinite for what is no oscillator
    and no spring. Relative errors of lags would choose the lengths in which noise looks like one.

    **Arguments:** `options`, sums with a leading axis of window lengths; `wanted`, of each element
    its mode, if it is one.
    """
    # The search is not differentiated: what it finds has the minimum's own derivative.
    options, known, bands = held_still((options, dict(known), bands))

    def tried(sums: list[NormalEquations]) -> tuple[Array, Array]:
        stage = ModeStage.of(expanded, sums, known)
        at = as_asked(search(stage, bands), wanted)
        values = stage.values(at)
        own = [_mixed(e, e.linearised(values), s) for e, s in zip(expanded, sums)]
        names = tuple(dict.fromkeys(name for e in expanded for name in e.all_parameters))
        influence = block_influence([sum_of_equations(own, names).flattened()], known, values)
        found = [name for name in names if name not in known]
        sought = [name for of in stage.sought for name in of.judged]
        size = jnp.stack([values[name] for name in sought])
        place = jnp.array([found.index(name) for name in sought])
        share = jnp.concatenate([of.doubted(values, band) for of, band in zip(stage.sought, bands)])
        doubt = jnp.sum(jnp.sum(influence**2, axis=0)[place] / share**2)
        target = stage.projected(at).target
        good = jnp.all(size > 0) & jnp.isfinite(doubt) & (target > 0)
        for names, part in stage.by_element(at).items():
            if isinstance(names, ModeParameters):
                good = good & (part[1] > 0)
        return jnp.where(good, doubt, jnp.inf), at

    doubt, at = jax.lax.map(tried, options)
    chosen = jnp.argsort(doubt)[jnp.minimum(rank, doubt.shape[0] - 1)]
    return chosen, at[chosen], jnp.isfinite(doubt[chosen])


@kept_jit
def _contracted(
    expanded: tuple[Expanded, ...],
    sums: list[NormalEquations],
    known: Values,
    at: Float[Array, " shapes"],
    moves: bool,
) -> tuple[list[NormalEquations], list[Array], dict[str, Array]]:
    """Normal equations of expanded columns, made those of the model's own parameters; the
    combinations that these are, none of an equation without elements; and the parameters' values,
    about which all are linearised.

    **Arguments:** `moves`, whether anything may be differentiated: else the derivative of `at` is
    not even compiled.
    """
    stage = ModeStage.of(expanded, sums, known)
    if stage.sought and moves:
        # One more Newton step. At the minimum it is zero, and by the implicit function theorem its
        # derivative is that of the minimum, the bend being held still: only derivatives come of it.
        at = jax.lax.stop_gradient(at)
        slope, bend = stage.slope_and_bend(at)
        step = solve_scaled(jax.lax.stop_gradient(bend), slope[:, None])[:, 0]
        at = at - (step - jax.lax.stop_gradient(step)).reshape(at.shape)
    values = stage.values(at) if stage.linear else stage.given
    mixes = [e.linearised(values) if e.elements else jnp.zeros((0, 0)) for e in expanded]
    return [_mixed(*each) for each in zip(expanded, mixes, sums)], mixes, values


def _mixed(expanded: Expanded, mix: Array, sums: NormalEquations) -> NormalEquations:
    if not expanded.elements:
        return sums
    return sums.in_columns(lambda m: mix @ m @ mix.T, expanded.all_parameters)


def search_band(model: Model, summary: Summary, names: HiddenParameters) -> tuple[Leaf, Leaf]:
    """Hertz between which to look for a mode, or for the corner of a spring's lag."""
    hz = model.hidden[names].hz
    if hz is not None:
        steps = [one.time_step for one in summary.recordings]
        rate = 1 / max(map(float, steps)) if is_concrete(steps) else np.inf
        if not hz < rate / 2:
            raise ModelError(
                f"no mode near {hz:g} Hz can be seen at {rate:g} samples a second: give one below "
                f"{rate / 2:g} Hz, or none."
            )
        return np.asarray(hz / 1.5), np.asarray(hz * 1.5)
    windows = summary.criterion.windows
    assert windows is not None
    step = summary.recordings[0].time_step
    # From half a period of the longest window to where a period has a dozen samples, and for a lag,
    # which shows below its corner, to a sixth of a sample.
    highest = 1 / (8 * step) if isinstance(names, ModeParameters) else 1 / step
    return 0.5 / windows.beta, highest


# Sums of a model's own parameters, of which hidden elements make it depend nonlinearly on some.
#
# About its solution such a model is linear, with a regressor for each parameter of its elements.
# Their sums are combinations of the expanded columns' sums, so that whatever asks how regressors
# are excited, drowned in noise or integrated need not know of hidden elements.

Band = tuple[int, int]
"""Bins of window lengths, first and one beyond the last."""


def linearised(model: Model, summary: Summary, known: Values) -> Summary:
    """Sums of regressors about the hidden elements that these sums say (not under jit).

    Of a model without any, and of sums that are linearised already, the Summary itself.

    **Returns:** a Summary of all windows together, each stage's of those it is solved from; without
    the constant, which tells of no combination of columns.
    """
    if not model.has_hidden or summary.outline.is_of(_outline(model)):
        return summary
    found = find_modes(model, summary, known)
    # An equation without elements, or whose values nothing asks for, stays as it is.
    mixes = [
        [mix if e.elements else np.eye(1 + len(e.parameters)) for e, mix in zip_longest(stage, own)]
        for stage, own in zip(model.expanded, on_host(found.mixes))
    ]
    recordings = [
        dataclasses.replace(
            one,
            stages=tuple(
                tuple(
                    _mixed_sums(e, mix, sums, band or summary.band) for e, mix, sums in zip(*parts)
                )
                for *parts, band in zip(model.expanded, mixes, one.stages, found.bands)
            ),
        )
        for one in summary.recordings
    ]
    return dataclasses.replace(
        summary,
        recordings=tuple(recordings),
        outline=_outline(model),
        edges=None,
        in_law=(0, 1),
        band=(0, 1),
    )


def _outline(model: Model) -> Outline:
    stages = tuple(
        tuple((e.equation.name, e.all_parameters) for e in stage) for stage in model.expanded
    )
    return Outline(stages, model.parameter_names, tuple(model.units.items()), "")


def _mixed_sums(
    expanded: Expanded, mix: Float[np.ndarray, "1+p columns"], sums: EquationSums, band: Band
) -> EquationSums:
    """The sums of some bins, of combinations of their columns."""

    def of(matrices: Any) -> Any:
        return mix @ np.asarray(matrices) @ mix.T

    survey = sums.survey
    if survey is not None:
        noise, quadrature = of(survey.noise), of(survey.quadrature)
        survey = Survey(noise, quadrature, survey.rows @ mix.T, survey.start, survey.reach)
    sums = sums.of_bins(*band).in_columns(of, expanded.all_parameters)
    return dataclasses.replace(sums, survey=survey, factor=None, constant=None)

"""What recordings say for elements that were found; see `riecjax.elements.evidence`."""

from typing import Any

import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.elements.evidence import ElementTests, Held
from riecjax.equations.element import Element
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model, as_model
from riecjax.errors import ModelError
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.projection import (
    Bins,
    Projected,
    ShapedStage,
    find_shapes,
    polished,
    search_band,
)
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.summary import Summary

FOLDS = 10
"""Stretches of time that are left out in turn."""


def element_evidence(model: Equation | Model, estimate: Estimate) -> list[Any]:
    """What speaks for the elements of an estimate: of each stage the last one of each class that
    has a test, an [`Evidence`][riecjax.elements.Evidence] of that class (not under jit).

    **Raises:** `ModelError` for an estimate without a Summary or a model without such elements.
    """
    model, summary = as_model(model), estimate.summary
    if summary is None or not any(element.test for element in model.hidden):
        raise ModelError("evidence is of an estimate, made outside jax.jit, of hidden elements.")
    values = estimate.values
    given = {name: np.asarray(value) for name, value in estimate.known.items()}
    found = find_shapes(model, summary, given)
    evidence, known = [], dict(given)
    for i, equations in enumerate(model.expanded):
        sums = summary.equations(found.bands[i])[i]
        stage = ShapedStage.of(equations, sums, known)
        last = {type(element): element for element in stage.sought if element.test}
        for element in last.values():
            own = [estimate.parameters.index(name) for name in element.hidden]
            held = Held(
                element,
                model.plan(set(known))[i][0],
                stage,
                found.at[i],
                search_band(summary, element),
                values,
                np.asarray(estimate.covariance)[np.ix_(own, own)],
                _lengths(summary, found.bands[i]),
                *_held_out(element, stage, sums, found.at[i]),
            )
            evidence.append(element.evidence(held))
        known |= {n: np.asarray(values[n]) for e in equations for n in e.all_parameters}
    return evidence


def is_carried(model: Model, estimate: Estimate) -> bool:
    """Whether every searched element of a model is one, and told from none, by an estimate."""
    hidden = {name for element in model.hidden for name in element.hidden}
    ruled_out = {n for f in estimate.findings() if f.about.rules_out for n in f.parameters}
    if any(float(estimate[name]) <= 0 for name in hidden) or hidden & ruled_out:
        return False
    return all(one.carried for test in element_tests(model, estimate) for one in test.evidence)


def element_tests(model: Model, estimate: Estimate) -> list[ElementTests]:
    """The evidence by the test that it belongs to; none of a model without such elements."""
    if not any(element.test for element in model.hidden):
        return []
    every = element_evidence(model, estimate)
    return [
        ElementTests(test, [one for one in every if one.test == test])
        for test in dict.fromkeys(one.test for one in every)
    ]


def _lengths(summary: Summary, band: Bins | None) -> tuple[float, float]:
    """Of windows in seconds, in some bins of lengths or in all."""
    if summary.bins is not None:
        return summary.lengths_of(band or summary.band)
    windows = summary.criterion.windows
    return (0.0, 0.0) if windows is None else (float(windows.alpha), float(windows.beta))


def _held_out(
    element: Element,
    stage: ShapedStage,
    sums: list[NormalEquations],
    at: Float[Array, " shapes"],
) -> tuple[Array, Array, Array, Array, Array]:
    """What is left of folds with the element and without, noise in it, the gain and its error."""
    # Clean moments of stretches of time, of all recordings one after the other, by windows rather
    # than by blocks, some of which only fill the array up.
    folds = []
    for flat in (one.flattened() for one in sums):
        before = np.cumsum(flat.count) - 0.5 * flat.count
        place = np.clip(FOLDS * before / np.sum(flat.count), 0, FOLDS - 1).astype(int)
        folds.append(xp.sum_by_block(flat.clean, place, FOLDS))

    def without(
        train: ShapedStage, there: Array, fit: Projected
    ) -> tuple[ShapedStage, Array, Projected]:
        """The stage, shapes and fit as if the element were not there."""
        if element.linear not in train.unknown:
            return train, there, fit.without_last()
        # What acts on a coefficient of the equation leaves that alone.
        others = {one: part for one, part in train.by_element(there).items() if one != element}
        train, there = train._replace(sought=tuple(others)), np.concatenate([[], *others.values()])
        return train, there, train.projected(there)

    def of_fold(number: int) -> tuple[Array, Array]:
        others = [whole - fold[number] for whole, fold in zip(stage.moments, folds)]
        train = stage._replace(moments=others)
        there = polished(train, at)
        fit = train.projected(there)
        own = [fold[number] for fold in folds]
        target = stage._replace(moments=own).projected(there).target
        share = np.where(target > 0, target, np.inf)
        left = stage.energy(own, there, fit.theta) / share
        bare, there, fit = without(train, there, fit)
        return left, bare.energy(own, there, fit.theta) / share

    fit = stage.projected(at)
    totals = [one.flattened().total() for one in sums]
    added = [np.zeros_like(t.moments) if t.noise is None else t.noise for t in totals]
    noise = stage.energy(added, at, fit.theta) / np.where(fit.target > 0, fit.target, np.inf)
    left, bare = np.array([of_fold(number) for number in range(FOLDS)]).T
    gain = bare - left
    error = np.std(gain, ddof=1) / np.sqrt(FOLDS)
    return np.mean(left), np.mean(bare), noise, np.mean(gain), error

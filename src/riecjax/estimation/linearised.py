"""Sums of a model's own parameters, of which hidden elements make it depend nonlinearly on some.

About its solution such a model is linear, with a regressor for each parameter of its elements.
Their sums are combinations of the expanded columns' sums, so that whatever asks how regressors are
excited, drowned in noise or integrated need not know of hidden elements.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.compilation import kept_jit
from riecjax.equations.hidden_elements import Expanded
from riecjax.equations.procedure import Procedure
from riecjax.estimation.hidden_modes import ModeStage, Values
from riecjax.estimation.mode_windows import find_modes
from riecjax.leaves import on_host
from riecjax.summaries.digest import Outline
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.summary import Summary
from riecjax.summaries.sums import EquationSums, Survey

Band = tuple[int, int]
"""Bins of window lengths, first and one beyond the last."""


def linearised(procedure: Procedure, summary: Summary, known: Values) -> Summary:
    """Sums of regressors about the hidden elements that these sums say (not under jit).

    Of a model without any, and of sums that are linearised already, the Summary itself.

    **Returns:** a Summary of all windows together, each stage's of those it is solved from; without
    averages and activity, which tell of no combination of columns.
    """
    if not procedure.has_hidden or summary.outline.is_of(_outline(procedure)):
        return summary
    found = find_modes(procedure, summary, known)
    values, mixes = {name: jnp.asarray(value) for name, value in known.items()}, []
    for i, (stage, at, band) in enumerate(zip(procedure.expanded, found.at, found.bands)):
        own, values = _mixes(stage, summary.equations(band)[i], values, at)
        mixes.append(on_host(own))
    recordings = [
        dataclasses.replace(
            one,
            stages=tuple(
                tuple(_mixed(e, mix, sums, band or summary.band) for e, mix, sums in zip(*parts))
                for *parts, band in zip(procedure.expanded, mixes, one.stages, found.bands)
            ),
        )
        for one in summary.recordings
    ]
    return dataclasses.replace(
        summary,
        recordings=tuple(recordings),
        outline=_outline(procedure),
        edges=None,
        in_law=(0, 1),
        band=(0, 1),
    )


def _outline(procedure: Procedure) -> Outline:
    stages = tuple(
        tuple((e.equation.name, e.all_parameters) for e in stage) for stage in procedure.expanded
    )
    return Outline(stages, tuple(procedure.units.items()), "")


@kept_jit
def _mixes(
    expanded: tuple[Expanded, ...],
    sums: list[NormalEquations],
    known: Values,
    at: Float[Array, " shapes"],
) -> tuple[list[Float[Array, "1+p columns"]], dict[str, Array]]:
    """Of each equation, target and regressors as combinations of its columns; and all values."""
    values = ModeStage.of(expanded, sums, known).values(at)
    return [e.linearised(values) for e in expanded], {**known, **values}


def _mixed(
    expanded: Expanded, mix: Float[np.ndarray, "1+p columns"], sums: EquationSums, band: Band
) -> EquationSums:
    """The sums of some bins, of combinations of their columns."""

    def of(moments: Any) -> Any:
        return None if moments is None else mix @ np.asarray(moments) @ mix.T

    def together(bins: Any) -> Any:
        return None if bins is None else bins[slice(*band)].sum(0, keepdims=True)

    survey = sums.survey
    if survey is not None:
        noise, quadrature = of(survey.noise), of(survey.quadrature)
        survey = Survey(noise, quadrature, survey.rows @ mix.T, survey.start, survey.reach)
    return EquationSums(
        of(together(sums.moments)),
        together(sums.count),
        averages=None,
        activity=None,
        survey=survey,
        factor=None,
        parameters=expanded.all_parameters,
        noise=of(together(sums.noise)),
        noise_of_source=of(together(sums.noise_of_source)),
    )

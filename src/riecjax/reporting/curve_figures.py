"""Curves that were identified function by function, such as a damper's force over velocity."""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.assessment.assessment import Assessment
from riecjax.criteria.criterion import DOLS, Rows
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import evaluate
from riecjax.equations.term import Terms
from riecjax.errors import DataError
from riecjax.estimation.estimate import Estimate
from riecjax.records.record import Record
from riecjax.reporting.charts.chart import (
    BLUE,
    GREY,
    RUST,
    Axis,
    Chart,
    Level,
    Line,
    Panel,
    labelled,
)

MOST_POINTS = 4000
GRID = 400


class IdentifiedCurve(NamedTuple):
    """A curve, its standard error, and the samples that it was drawn through.

    **Fields:** `name`, `unit` of its values and `of`, its variable; `x`, `y` and `error` of the
    curve; `samples`: the variable, and what the rest of the equation leaves for the curve there,
    `None` where a derivative is not recorded.
    """

    name: str
    unit: str
    of: str
    x: Float[np.ndarray, " grid"]
    y: Float[np.ndarray, " grid"]
    error: Float[np.ndarray, " grid"]
    samples: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]] | None


def identified_curves(result: Assessment) -> list[IdentifiedCurve]:
    """The curves of a model that has terms in a basis, from the first record."""
    found: dict[str, IdentifiedCurve] = {}
    record = result.recordings[0].record
    for stage in result.estimate.stages:
        for equation in result.procedure.stages[stage.stage]:
            for term in equation.terms:
                shared = all(name in result.estimate for name in term.parameters)
                if isinstance(term, Terms) and shared and term.prefix not in found:
                    found[term.prefix] = _curve(result.estimate, equation, term, record)
    return list(found.values())


def curves_figure(curves: list[IdentifiedCurve]) -> Chart:
    """Each curve with its interval over the samples, and beneath it what it leaves of them."""
    sampled = any(curve.samples is not None for curve in curves)
    rows: list[list[Panel | None]] = [[_over_samples(curve) for curve in curves]]
    if sampled:
        rows.append([_left_of_samples(curve) for curve in curves])
    return Chart(
        rows,
        "Curves with their 95 % interval, over what the equation leaves for them sample by sample"
        f"{', and beneath them what they leave of that' if sampled else ''}. A curve that samples "
        "go round in loops depends on more than its variable.",
        (4.2 * len(curves) + 0.6, 6.2 if sampled else 4.0),
        heights=(3, 2) if sampled else (),
        share_x=True,
    )


def _over_samples(curve: IdentifiedCurve) -> Panel:
    low, high = curve.y - 1.96 * curve.error, curve.y + 1.96 * curve.error
    marks = [Line(curve.x, curve.y, "identified, 95 %", BLUE, width=1.8, low=low, high=high)]
    if curve.samples is not None:
        marks.insert(0, Line(*curve.samples, "what the equation leaves for it", GREY, width=0.5))
    return Panel(marks, Axis(curve.of), Axis(labelled(curve.name, curve.unit)))


def _left_of_samples(curve: IdentifiedCurve) -> Panel | None:
    if curve.samples is None:
        return None
    x, y = curve.samples
    left = Line(x, y - np.interp(x, curve.x, curve.y), color=RUST, width=0.5)
    return Panel([Level(0), left], Axis(curve.of), Axis(labelled("residual", curve.unit)))


def _curve(estimate: Estimate, equation: Equation, term: Terms, record: Record) -> IdentifiedCurve:
    variable, present = evaluate(term.of, record)
    x = np.asarray(variable) if present is None else np.asarray(variable)[np.asarray(present)]
    grid = np.linspace(x.min(), x.max(), GRID)
    functions = np.asarray(eqx.filter_jit(term.basis)(jnp.asarray(grid)))
    values = np.array([float(estimate[name]) for name in term.parameters])
    label = term.of if isinstance(term.of, str) else getattr(term.of, "__name__", "variable")
    name = label.strip("_").replace("_", " ")
    return IdentifiedCurve(
        name=term.prefix,
        # Coefficients of a roof or a step are values of the curve, whose unit is the equation's.
        unit=equation.unit,
        of=labelled(name, dict(record.units).get(name)),
        x=grid,
        y=values @ functions,
        error=_error(estimate, term, functions),
        samples=_samples(estimate, equation, term, record, np.asarray(variable)),
    )


def _error(estimate: Estimate, term: Terms, functions: np.ndarray) -> np.ndarray:
    """sqrt(b(x)^T C b(x)): the covariance of the coefficients, those held at a value left out."""
    free = [i for i, name in enumerate(term.parameters) if name in estimate.parameters]
    at = [estimate.parameters.index(term.parameters[i]) for i in free]
    covariance = np.asarray(estimate.covariance)[np.ix_(at, at)]
    variance = np.einsum("ig,ij,jg->g", functions[free], covariance, functions[free])
    return np.sqrt(np.maximum(variance, 0))


def _samples(
    estimate: Estimate, equation: Equation, term: Terms, record: Record, variable: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The curve's value by the rest of the equation, at every sample.

    With all other coefficients known, sign sum_i c_i b_i = target is what a pointwise row says.
    """
    others = [name for name in equation.parameters if name not in term.parameters]
    try:
        rows = _rows_left(equation, record, {name: estimate[name] for name in others})
    except DataError:
        return None  # a derivative that is not recorded
    valid = slice(None) if rows.valid is None else np.asarray(rows.valid)
    x, y = variable[valid], np.asarray(rows.target)[valid] / float(term.sign)
    return x[:MOST_POINTS], y[:MOST_POINTS]


@eqx.filter_jit
def _rows_left(equation: Equation, record: Record, values: Mapping[str, Array]) -> Rows:
    return DOLS().rows(equation, record).fix(values)

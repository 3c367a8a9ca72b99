"""Curves that were identified function by function, such as a damper's force over velocity."""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.assessment.assessment import Assessment
from riecjax.criteria.criterion import DOLS
from riecjax.equations.bases import AbstractBasis
from riecjax.equations.equation import Equation
from riecjax.equations.term import AbstractTerm, Terms, evaluate
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
    curve; `samples`, where the equation can be looked at sample by sample, else `None`: the
    variable, and what the equation leaves for the curve there.
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
    marks = []
    if curve.samples is not None:
        x, y = curve.samples
        marks.append(Line(x, y, "what the equation leaves for it", GREY, width=0.5))
    reach = 1.96 * curve.error
    identified = Line(
        curve.x,
        curve.y,
        "identified, 95 %",
        BLUE,
        width=1.8,
        low=curve.y - reach,
        high=curve.y + reach,
    )
    return Panel([*marks, identified], Axis(curve.of), Axis(labelled(curve.name, curve.unit)))


def _left_of_samples(curve: IdentifiedCurve) -> Panel | None:
    if curve.samples is None:
        return None
    x, y = curve.samples
    left = y - np.interp(x, curve.x, curve.y)
    return Panel(
        [Level(0), Line(x, left, color=RUST, width=0.5)],
        Axis(curve.of),
        Axis(labelled("residual", curve.unit)),
    )


def _curve(estimate: Estimate, equation: Equation, term: Terms, record: Record) -> IdentifiedCurve:
    variable, present = evaluate(term.of, record)
    x = np.asarray(variable) if present is None else np.asarray(variable)[np.asarray(present)]
    grid = np.linspace(x.min(), x.max(), GRID)
    functions = np.asarray(_functions(term.basis, jnp.asarray(grid)))
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


@eqx.filter_jit
def _functions(basis: AbstractBasis, x: Float[Array, " grid"]) -> Float[Array, "functions grid"]:
    return basis(x)


def _error(estimate: Estimate, term: Terms, functions: np.ndarray) -> np.ndarray:
    covariance = np.zeros((len(term.parameters), len(term.parameters)))
    place = {name: i for i, name in enumerate(estimate.parameters)}
    known = [i for i, name in enumerate(term.parameters) if name in place]
    rows = [place[term.parameters[i]] for i in known]
    covariance[np.ix_(known, known)] = np.asarray(estimate.covariance)[np.ix_(rows, rows)]
    return np.sqrt(np.maximum(np.einsum("ig,ij,jg->g", functions, covariance, functions), 0))


def _samples(
    estimate: Estimate, equation: Equation, term: Terms, record: Record, variable: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The equation at every sample without this term, which is what the curve should give."""
    rest = tuple(other for other in equation.terms if other is not term)
    values = {name: estimate[name] for other in rest for name in other.parameters}
    try:
        total, kept = _at_samples(equation, rest, record, values)
    except DataError:
        return None  # a derivative that is not recorded
    there = slice(None) if kept is None else np.asarray(kept)
    sign = float(term.sign)
    x, y = variable[there], -np.asarray(total)[there] / sign
    last = min(x.size, MOST_POINTS)
    return x[:last], y[:last]


@eqx.filter_jit
def _at_samples(
    equation: Equation,
    terms: tuple[AbstractTerm, ...],
    record: Record,
    values: Mapping[str, Array],
) -> tuple[Float[Array, " n"], Bool[Array, " n"] | None]:
    """Sum of some terms at every sample, and where the whole equation is present."""
    total = sum(
        (_contribution(values, term, record) for term in terms), jnp.zeros(record.sample_count)
    )
    return total, DOLS().rows(equation, record).kept


def _contribution(
    values: Mapping[str, Array], term: AbstractTerm, record: Record
) -> Float[Array, " n"]:
    samples = term.samples(record, term.derivative).values
    factors = jnp.stack([jnp.asarray(values[name]) for name in term.parameters] or [jnp.ones(())])
    return factors @ samples

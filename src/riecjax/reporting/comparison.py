"""Results side by side: parameters, what is left, which model the data prefer, predictions."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from riecjax.charts import Chart
from riecjax.errors import ModelError
from riecjax.extensions import require_packages
from riecjax.reporting.answer import Answer, Fit, Known, Parameter, part_of
from riecjax.reporting.plots import relative_figure
from riecjax.reporting.tables import Table, View, with_error
from riecjax.shows import Drawn

SAME = 1e-6
"""Share by which targets of the same data may differ by rounding."""


# Rows of overlapping windows are not independent: n of them tell as much as m, the effective
# windows, do. The composite likelihood of n rows with residual variance s^2 is n / 2 log s^2, its
# criterion (Varin and Vidoni, 2005) n log s^2 + 2 tr(J H^-1), with sandwich over naive variance in
# the trace: n / m for each parameter. Times m / n that is m log s^2 + 2 p, Akaike's criterion of m
# independent rows. Of several equations the logarithms add up. All are compared with one m.
class Comparison(Drawn):
    """Results side by side; made by [`compare`][].

    **Fields:** `names` of the results; `answers`, what each says;
    `information`: of each, Akaike's criterion above the least, of so many independent rows as
    windows are effective, or `None` where `why_not` says why they do not compare.
    """

    def __init__(self, answers: Mapping[str, Answer]):
        self.answers = dict(answers)
        self.names = tuple(answers)
        self.why_not = _why_not_comparable([*answers.values()])
        self.information = None if self.why_not else _information([*answers.values()])

    def __iter__(self) -> Iterator[str]:
        every = (e for a in self.answers.values() for e in (*a.parameters, *a.known))
        return iter(dict.fromkeys(every))

    def to_frame(self) -> Any:
        """A pandas data frame indexed by parameter and result; columns as of an estimate's.

        **Raises:** `DataError` if pandas is not installed.
        """
        require_packages("frame")
        import pandas

        frames = {name: answer.to_frame() for name, answer in self.answers.items()}
        return pandas.concat(frames, names=["result"]).swaplevel()

    def to_markdown(self) -> str:
        """A table of Markdown: a column for each result."""
        return self.table().markdown()

    def to_latex(self) -> str:
        """A `tabular` of LaTeX: a column for each result."""
        return self.table().latex()

    def view(self) -> View:
        """What is printed of it."""
        line = "ΔAIC: above the least, of as many rows as windows are effective; 0 is best"
        if self.why_not:
            line = f"no information criterion: {self.why_not}"
        return View("", [self.table()], [line])

    def chart(self) -> Chart:
        """Intervals relative to the first result's values."""
        return relative_figure(self.answers)

    def table(self) -> Table:
        """Values and errors of parameters, what is left of each equation, and how well each signal
        is predicted on each recording that was held out: a column for each result."""
        answers = list(self.answers.values())

        def cell(entry: Known | None) -> str:
            if isinstance(entry, Parameter):
                return with_error(entry.value, entry.std_error)
            return "" if entry is None else f"{with_error(entry.value, None)} known"

        rows = []
        for name in self:
            entries = [a.known.get(name) or a.parameters.get(name) for a in answers]
            unit = next(entry.unit for entry in entries if entry)
            rows.append([name, *map(cell, entries), unit])
        residuals = [
            {f"left of {name}": fit.relative_rms for name, fit in _residuals(answer).items()}
            for answer in answers
        ]
        fits = [
            {
                f"fit of {name}, {run.on}": signal.fit_percent
                for run in answer.validation
                for name, signal in run.signals.items()
            }
            for answer in answers
        ]
        rows += _percents(residuals, 100, ".3g")
        if self.information is not None:
            rows.append(["ΔAIC", *(f"{value:.1f}" for value in self.information), ""])
        rows += _percents(fits, 1, ".1f")
        return Table(("parameter", *self.names, "unit"), rows)


def compare(results: Sequence[Any], names: Sequence[str] | None = None) -> Comparison:
    """Results side by side: parameters, residuals, an information criterion, predictions.

    **Arguments:** `results`: of [`identify`][], [`refine`][], [`assess`][] or [`load`][], in any
    mixture; `names` of them, by default their models' or numbers.

    **Raises:** `ModelError` for a batch or what is no result, and for names that are not one each.
    """
    if isinstance(results, str) or not isinstance(results, Sequence) or not results:
        raise ModelError("give results as a list: rx.compare([first, second]).")
    if any(getattr(one, "batch_shape", ()) for one in results):
        raise ModelError("a batch does not compare: take one estimate out of it by member(0).")
    answers = [part_of(result) for result in results]
    called = [answer.model or "result" for answer in answers]
    if len(set(called)) < len(called):
        called = [f"{name} {i + 1}" for i, name in enumerate(called)]
    chosen = called if names is None else list(names)
    if len(set(chosen)) != len(answers):
        raise ModelError(f"names must be {len(answers)} different ones; got {len(chosen)}.")
    return Comparison(dict(zip(chosen, answers)))


def _percents(
    columns: Sequence[Mapping[str, float | None]], scale: float, form: str
) -> Iterator[list[str]]:
    """A row for all that some result has a number of, scaled to percent."""
    for name in dict.fromkeys(name for column in columns for name in column):
        values = [column.get(name) for column in columns]
        yield [name, *("" if v is None else f"{scale * v:{form}}" for v in values), "%"]


def _residuals(answer: Answer) -> Mapping[str, Fit]:
    """What each equation leaves, of values that are the linear estimate's."""
    refined = answer.refinement is not None and answer.refinement.chosen
    return {} if refined else answer.residual.equations


def _why_not_comparable(answers: Sequence[Answer]) -> str:
    """Why residuals are not of the same rows of the same target; empty where they are."""
    residuals = [_residuals(answer) for answer in answers]
    if not all(residuals):
        return "refined values leave nothing in windows to count; compare held-out fits instead."
    if any(answer.criterion != answers[0].criterion for answer in answers):
        return "the criteria differ, and so do their rows."
    if any(set(equations) != set(residuals[0]) for equations in residuals):
        return "the equations differ."
    for name, first in residuals[0].items():
        for fit in (equations[name] for equations in residuals):
            if not (fit.relative_rms and fit.rms and first.relative_rms and first.rms):
                return f"{name} leaves nothing, or no number."
            targets = first.rms / first.relative_rms, fit.rms / fit.relative_rms
            if first.rows != fit.rows or not np.isclose(*targets, rtol=SAME, atol=0):
                return f"they rest on other data, or another known part of {name}."
    return ""


def _information(answers: Sequence[Answer]) -> list[float]:
    """Akaike's criterion of each, above the least."""
    counts = ([p.effective_windows for p in a.parameters.values()] for a in answers)
    shares = ([1 / count for count in some if count] for some in counts)
    windows = min(len(some) / sum(some) if some else math.inf for some in shares)
    criteria = [
        windows * sum(math.log((fit.rms or 0.0) ** 2) for fit in _residuals(answer).values())
        + 2 * len(answer.parameters)
        for answer in answers
    ]
    return [value - min(criteria) for value in criteria]

"""Results side by side: parameters, what is left, which model the data prefer, predictions."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from riecjax.errors import ModelError
from riecjax.extensions import require_packages
from riecjax.reporting.charts.chart import Chart
from riecjax.reporting.document import Document
from riecjax.reporting.exports import document_of, to_dict, to_frame
from riecjax.reporting.plots import relative_figure
from riecjax.reporting.tables import Table, View, in_latex, in_markdown, with_error
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

    **Fields:** `names` of the results; `documents`, what each says in plain data;
    `information`: of each, Akaike's criterion above the least, of so many independent rows as
    windows are effective, or `None` where `why_not` says why they do not compare.
    """

    def __init__(self, documents: Mapping[str, Document]):
        self.documents = dict(documents)
        self.names = tuple(documents)
        self.why_not = _why_not_comparable([*documents.values()])
        self.information = None if self.why_not else _information([*documents.values()])

    def __iter__(self) -> Iterator[str]:
        every = (e for d in self.documents.values() for e in (*d["parameters"], *d["known"]))
        return iter(dict.fromkeys(every))

    def to_frame(self) -> Any:
        """A pandas data frame indexed by parameter and result; columns as of an estimate's.

        **Raises:** `DataError` if pandas is not installed.
        """
        require_packages("frame")
        import pandas

        return pandas.concat(
            {name: to_frame(of) for name, of in self.documents.items()}, names=["result"]
        ).swaplevel()

    def to_markdown(self) -> str:
        """A table of Markdown: a column for each result."""
        return in_markdown(self._table())

    def to_latex(self) -> str:
        """A `tabular` of LaTeX: a column for each result."""
        return in_latex(self._table())

    def view(self) -> View:
        """What is printed of it."""
        line = "ΔAIC: above the least, of as many rows as windows are effective; 0 is best"
        if self.why_not:
            line = f"no information criterion: {self.why_not}"
        return View("", [self._table()], [line])

    def chart(self) -> Chart:
        """Intervals relative to the first result's values."""
        return relative_figure(self.documents)

    def _table(self) -> Table:
        documents = list(self.documents.values())
        every = [to_dict(document) for document in documents]
        rows = []
        for name in self:
            row = [entries.get(name) for entries in every]
            numbers = [e and with_error(e["value"], e["std_error"]) for e in row]
            known = [" known" if e and e["known"] else "" for e in row]
            unit = next(entry["unit"] for entry in row if entry)
            rows.append([name, *(f"{x or ''}{k}" for x, k in zip(numbers, known)), unit])
        # What is left of each equation, and of each signal on each recording that was held out.
        residuals = [
            {f"left of {name}": fit["relative_rms"] for name, fit in _residuals(document).items()}
            for document in documents
        ]
        fits = [
            {
                f"fit of {name}, {run['on']}": signal["fit_percent"]
                for run in document.get("validation", [])
                for name, signal in run["signals"].items()
            }
            for document in documents
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
    documents = [document_of(one) for one in results]
    called = [document.get("model") or "result" for document in documents]
    if len(set(called)) < len(called):
        called = [f"{name} {i + 1}" for i, name in enumerate(called)]
    chosen = called if names is None else list(names)
    if len(set(chosen)) != len(documents):
        raise ModelError(f"names must be {len(documents)} different ones; got {len(chosen)}.")
    return Comparison(dict(zip(chosen, documents)))


def _percents(
    columns: Sequence[Mapping[str, float | None]], scale: float, form: str
) -> Iterator[list[str]]:
    """A row for all that some result has a number of, scaled to percent."""
    for name in dict.fromkeys(name for column in columns for name in column):
        values = [column.get(name) for column in columns]
        yield [name, *("" if v is None else f"{scale * v:{form}}" for v in values), "%"]


def _residuals(document: Document) -> Mapping[str, Any]:
    """What each equation leaves, of values that are the linear estimate's."""
    if (document.get("refinement") or {}).get("chosen"):
        return {}
    return document.get("residual", {}).get("equations", {})


def _why_not_comparable(documents: Sequence[Document]) -> str:
    """Why residuals are not of the same rows of the same target; empty where they are."""
    residuals = [_residuals(document) for document in documents]
    if not all(residuals):
        return "refined values leave nothing in windows to count; compare held-out fits instead."
    if any(document["criterion"] != documents[0]["criterion"] for document in documents):
        return "the criteria differ, and so do their rows."
    if any(set(one) != set(residuals[0]) for one in residuals):
        return "the equations differ."
    for name, first in residuals[0].items():
        for fit in (equations[name] for equations in residuals):
            if None in (fit["relative_rms"], fit["rms"]) or not fit["rms"] > 0:
                return f"{name} leaves nothing, or no number."
            targets = [each["rms"] / each["relative_rms"] for each in (first, fit)]
            if first["rows"] != fit["rows"] or not np.isclose(*targets, rtol=SAME, atol=0):
                return f"they rest on other data, or another known part of {name}."
    return ""


def _information(documents: Sequence[Document]) -> list[float]:
    """Akaike's criterion of each, above the least."""
    counts = ([e["effective_windows"] for e in d["parameters"].values()] for d in documents)
    shares = ([1 / count for count in some if count] for some in counts)
    windows = min(len(some) / sum(some) if some else math.inf for some in shares)
    criteria = [
        windows * sum(math.log(of["rms"] ** 2) for of in _residuals(document).values())
        + 2 * len(document["parameters"])
        for document in documents
    ]
    return [value - min(criteria) for value in criteria]

"""What objects hold as plain documents, and these as dictionaries, frames and tables of a paper."""

from typing import Any

import numpy as np

from riecjax.assessment.assessment import Assessment
from riecjax.errors import ModelError
from riecjax.estimation.estimate import AbstractEstimate, Estimate
from riecjax.extensions import require_packages
from riecjax.leaves import on_host
from riecjax.records.record import Record
from riecjax.reporting import Document, identification_document
from riecjax.reporting.estimate import estimate_entries, known_entries, parameter_entries
from riecjax.reporting.tables import Table, rounded

COLUMNS = ("value", "std_error", "low95", "high95")
"""Numbers of each parameter in a frame."""


def document_of(source: Any) -> Document:
    """`parameters` and `known` of what holds some, as in the document of an identification.

    **Raises:** `ModelError` for anything else.
    """
    match source:
        case dict():
            return source
        case Assessment():
            return identification_document(source)
        case Estimate():
            return estimate_entries("", source)
        case AbstractEstimate():
            return {"parameters": parameter_entries(source), "known": known_entries(source)}
    document = getattr(source, "document", None)
    if document is None:
        kind = type(source).__name__
        raise ModelError(
            f"there are no parameters in a {kind}: give what rx.identify, rx.estimate, rx.refine, "
            f"rx.assess or rx.load return."
        )
    return document


def to_dict(source: Any) -> dict[str, dict[str, Any]]:
    """Of each parameter its numbers, see [`Tabled.to_dict`][riecjax.shows.Tabled.to_dict]."""
    document = document_of(on_host(source))
    return {
        name: {
            "value": entry["value"],
            "std_error": entry.get("std_error"),
            "interval": tuple(entry["interval95"]) if part == "parameters" else None,
            "unit": entry["unit"],
            "known": part == "known",
        }
        for part in ("parameters", "known")
        for name, entry in document[part].items()
    }


def _columns(source: Any) -> tuple[dict[str, np.ndarray], tuple[int, ...], dict[str, Any]]:
    """Each column's numbers, shape `(*batch, parameters)`; the batch's shape; the dictionary."""
    entries = to_dict(source)
    shape = np.shape(next(iter(entries.values()))["value"])
    numbers = {name: np.full((*shape, len(entries)), np.nan) for name in COLUMNS}
    for i, entry in enumerate(entries.values()):
        ends = entry["interval"] or (None, None)
        for name, value in zip(COLUMNS, (entry["value"], entry["std_error"], *ends)):
            if value is not None:
                numbers[name][..., i] = np.array(value, float)
    return numbers, shape, entries


def _axes(shape: tuple[int, ...]) -> list[str]:
    return ["member"] if len(shape) == 1 else [f"member_{i}" for i in range(len(shape))]


def to_frame(source: Any) -> Any:
    """A data frame, see [`Tabled.to_frame`][riecjax.shows.Tabled.to_frame]; or of a record, its
    signals over time in seconds, NaN where there is no sample."""
    require_packages("frame")
    import pandas

    if isinstance(source, Record):
        columns = {name: signal.with_nan for name, signal in source.by_name.items()}
        return pandas.DataFrame(columns, index=pandas.Index(np.asarray(source.time), name="t"))
    numbers, shape, entries = _columns(source)
    index = pandas.Index(list(entries), name="parameter")
    if shape:
        levels = [*map(range, shape), list(entries)]
        index = pandas.MultiIndex.from_product(levels, names=[*_axes(shape), "parameter"])
    frame = pandas.DataFrame({name: column.ravel() for name, column in numbers.items()}, index)
    for name in ("unit", "known"):
        frame[name] = [entry[name] for entry in entries.values()] * int(np.prod(shape))
    return frame


def to_xarray(source: Any) -> Any:
    """A data set, see [`Saved.to_xarray`][riecjax.shows.Saved.to_xarray]."""
    require_packages("data set")
    import xarray

    numbers, shape, entries = _columns(source)
    axes = _axes(shape)
    data = {name: ([*axes, "parameter"], values) for name, values in numbers.items()}
    every = entries.values()
    text = {name: ("parameter", [e[name] for e in every]) for name in ("unit", "known")}
    return xarray.Dataset(data, {"parameter": list(entries), **text})


def paper_table(source: Any) -> Table:
    """Value, standard error and unit of each parameter, rounded by the error.

    **Raises:** `ModelError` for a batch, of which a paper has no room.
    """
    if shape := getattr(source, "batch_shape", ()):
        raise ModelError(
            f"a table shows one estimate, not a batch of shape {shape}: take one out by member(0), "
            f"or all of them by to_frame()."
        )
    rows = []
    for name, entry in to_dict(source).items():
        value, error, power = rounded(entry["value"], entry["std_error"])
        error = "known" if entry["known"] else f"{error}{power}"
        rows.append((name, f"{value}{power}", error, entry["unit"]))
    return Table(("parameter", "value", "±", "unit"), rows)

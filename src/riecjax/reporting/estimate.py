"""An estimate in plain data, and as tables on a terminal."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array
from rich.console import Console

from riecjax.assessment.verdict import percent
from riecjax.estimation.estimate import AbstractEstimate, Estimate
from riecjax.estimation.stages import EquationFit, StageSolution
from riecjax.refinement.refine import Refined
from riecjax.reporting.document import SCHEMA, Document, ends_of, finite, number, told
from riecjax.reporting.tables import Table, in_rich, print_table, say


def estimate_entries(model: str, estimate: Estimate) -> Document:
    """What is known as soon as a model is identified: the first part of the document.

    Numbers of a batch are nested lists of its shape.
    """

    def whole(number: Array) -> Any:
        return np.asarray(number).astype(int).tolist()

    def left(fit: EquationFit | StageSolution) -> Document:
        rms = finite(fit.residual_rms)
        return {**told(fit, "relative_rms"), "rms": rms, "rows": whole(fit.count)}

    stages = [
        {
            "equation": name,
            "parameters": list(stage.parameters),
            **left(stage),
            **told(stage.solution, "condition_number"),
            "rank": whole(stage.solution.rank),
            "equations": list(names),
        }
        for name, names, stage in zip(
            estimate.stage_names, estimate.equation_names, estimate.stages
        )
    ]
    parameters = parameter_entries(estimate)
    # Of each parameter, what only the linear estimate says of its windows too.
    for i, name in enumerate(estimate.parameters):
        parameters[name] |= {
            "naive_std_error": finite(estimate.naive[..., i]),
            "effective_windows": finite(estimate.effective_windows[..., i]),
        }
    return {
        "schema": SCHEMA,
        "model": model,
        "criterion": estimate.criterion.describe(),
        "parameters": parameters,
        "known": known_entries(estimate),
        **told(estimate, "condition_number"),
        "rank": whole(estimate.rank),
        "residual": {
            "relative_rms": stages[-1]["relative_rms"],
            "stages": stages,
            "equations": {name: left(fit) for name, fit in estimate.equations.items()},
        },
    }


def print_estimate(document: Document, console: Console) -> None:
    """Parameters, refined ones where there are, and what each equation leaves."""
    criterion = document["criterion"]
    heading = f"{document['model']}  {criterion['name'].upper()}  {settings_in_words(criterion)}"
    say(console, heading)
    print_table(in_rich(parameter_table(document)), console)
    for name, left in fits_of(document["residual"]):
        told = [f"relative residual {100 * left['relative_rms']:.3g} %"]
        if "condition_number" in left:
            told.append(f"condition number {number(left['condition_number'], 3)}")
        say(console, f"{name}: {', '.join(told)}, {left['rows']} rows")


def settings_in_words(criterion: Mapping[str, Any]) -> str:
    """A criterion's settings, all but its name."""
    return ", ".join(f"{key} {value}" for key, value in criterion.items() if key != "name")


def fits_of(residual: Document) -> Iterator[tuple[str, Document]]:
    """What each stage leaves, and each equation of a stage of several, by name."""
    for stage in residual["stages"]:
        yield stage["equation"], stage
        for name in stage["equations"] if len(stage["equations"]) > 1 else ():
            yield name, residual["equations"][name]


USUAL = ("value", "std error", "95 % interval", "unit")
"""What is told of a parameter where nothing else is asked for."""


def parameter_table(
    document: Mapping[str, Any],
    columns: Sequence[str] = USUAL,
    interval: Callable[[Sequence[float | None]], str] = lambda ends: " .. ".join(ends_of(ends)),
) -> Table:
    """What these columns say of each parameter of a document; `interval` in words.

    If a refinement was made, identified and refined values stand side by side; standard errors and
    intervals are of the answer.
    """
    refinement = document.get("refinement") or {}
    chosen = refinement.get("chosen")
    other = "identified" if chosen else "refined"
    beside = refinement.get(other) or {}
    judged = (document.get("verdict") or {}).get("parameters", {})
    cells: dict[str, Callable[[Document], str]] = {
        "value": lambda entry: number(entry["value"]),
        other: lambda entry: number(entry[other]["value"]) if other in entry else "",
        "std error": lambda entry: number(entry["std_error"], 2) if "std_error" in entry else "",
        "95 % interval": lambda entry: (
            interval(entry["interval95"]) if "interval95" in entry else "known"
        ),
        "unit": lambda entry: entry["unit"],
        "doubt": lambda entry: (
            ""
            if "share" not in entry
            else "?"
            if entry["share"] is None
            else percent(entry["share"])
        ),
        "from .. to": lambda entry: interval(entry["doubt"]),
        "verdict": lambda entry: entry.get("level", ""),
        "because of": lambda entry: entry["reason"],
        "mostly from": lambda entry: entry["reason"],
    }
    if beside and columns == USUAL:
        columns = (other, *USUAL) if chosen else (*USUAL[:-1], other, USUAL[-1])
    entries = {
        name: {
            **judged.get(name, {}),
            **({other: beside[name]} if name in beside else {}),
            **entry,
        }
        for name, entry in (document["parameters"] | document["known"]).items()
    }
    return Table.of("parameter", entries.items(), {header: cells[header] for header in columns})


def known_entries(estimate: AbstractEstimate) -> dict[str, Any]:
    """Value and unit of each parameter that was not estimated; lists of a batch."""
    table = estimate.table
    return {n: {"value": finite(estimate[n]), "unit": table[n].unit} for n in estimate.known}


def intervals_entry(estimate: Estimate | Refined) -> Document:
    """Where the intervals of one estimate come from."""
    return {
        "method": estimate.uncertainty.label,
        "blocks": int(estimate.block_count),
        "block_seconds": float(estimate.block_length),
    }


def parameter_entries(estimate: AbstractEstimate) -> dict[str, Any]:
    """Value, unit, standard error and interval of each estimated parameter; lists of a batch."""
    return {
        name: {
            "value": finite(estimate[name]),
            "unit": estimate.table[name].unit,
            "std_error": finite(estimate.standard_error(name)),
            "interval95": finite(ends),
        }
        for name, ends in estimate.interval_by_name().items()
    }
